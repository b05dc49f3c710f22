"""Folders of finished work that an interrupted run continues."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, TypeVar

import joblib

from cyclofeat._base.files import write_whole

T = TypeVar("T")


class ShardStore:
    """Folder of shards, whole or absent, and a JSON file about the work, which can be interrupted."""

    def __init__(self, folder: str | os.PathLike[str], description: str = "") -> None:
        self.folder, self.description = Path(folder), description

    def path_of(self, name: str) -> Path:
        """Return the path of a file."""
        return self.folder / name

    def begin_work(self, content: Mapping[str, Any]) -> None:
        """Make the folder, remove unfinished files, and write the description unless there is one."""
        self.folder.mkdir(parents=True, exist_ok=True)
        for part in self.folder.glob(".*.part"):
            part.unlink()
        if not self.path_of(self.description).exists():
            self.write_json(self.description, content)

    def read_json(self, name: str) -> dict[str, Any]:
        """Return the content of a JSON file; raise ValueError if it is none."""
        path = self.path_of(name)
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except (json.JSONDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{path}: is not valid JSON ({error}): the file was changed") from None
        if not isinstance(content, dict):
            raise ValueError(f"{path}: must hold a JSON object: the file was changed")
        return content

    def write_json(self, name: str, content: Any) -> None:
        """Write a JSON file, to read and to edit."""
        self.write_file(name, lambda file: file.write(json_bytes(content)))

    def write_file(self, name: str, write: Callable[[IO[bytes]], object]) -> Path:
        """Write a file through to the disk, and return its path; ``write`` is given the open binary file."""
        return write_whole(self.path_of(name), write, durable=True)

    def missing_names(self, names: Iterable[str]) -> list[str]:
        """Return the names of the files that are not finished."""
        return [name for name in names if not self.path_of(name).exists()]

    def load_or_compute(self, name: str, call: Callable[[], T]) -> T:
        """Return the result of ``call`` from a file; compute and write it if no such file can be read."""
        result: T
        if self.path_of(name).exists():
            with contextlib.suppress(Exception):  # whatever a damaged pickle raises
                result = joblib.load(self.path_of(name))
                return result
        result = call()
        self.folder.mkdir(parents=True, exist_ok=True)
        self.write_file(name, lambda file: joblib.dump(result, file))
        return result

    @contextlib.contextmanager
    def hold_lock(self, work: str) -> Iterator[None]:
        """Lock the folder, until the end of this process at most; errors name the ``work``."""
        held: int | None = None
        try:
            if sys.platform == "win32":
                # No folder can be opened; the system removes the file with its process.
                held = os.open(self.path_of(".lock"), os.O_CREAT | os.O_EXCL | os.O_TEMPORARY)
            else:
                import fcntl

                held = os.open(self.folder, os.O_RDONLY)
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, FileExistsError):
            if held is not None:
                os.close(held)
            problem = f"{self.folder}: another process is at work on this {work}: wait for its end"
            raise BlockingIOError(errno.EWOULDBLOCK, problem) from None
        except OSError:
            if held is None:
                raise  # else a file system without locks
        try:
            yield
        finally:
            os.close(held)


def json_bytes(content: Any) -> bytes:
    """Return JSON in UTF-8, to read and to edit."""
    return (json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()
