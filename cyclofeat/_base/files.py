"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO


def check_parent(path: Path, of: str = "") -> None:
    """Raise FileNotFoundError unless the folder of a file to be written exists; ``of`` names the file."""
    if not path.parent.is_dir():
        named = f" for {of}" if of else ""
        raise FileNotFoundError(f"folder {path.parent}{named} does not exist: make it first")


@contextmanager
def naming(path: str | Path, part: Path | None = None) -> Iterator[None]:
    """Name the file in errors of writing it: of a full disk the system names none, or the one beside it."""
    try:
        yield
    except OSError as error:
        if error.filename not in (None, str(part)):
            raise
        reason = error.strerror or str(error)
        raise OSError(error.errno or errno.EIO, reason, str(path)) from error


def write_whole(path: Path, write: Callable[[IO[bytes]], object], *, durable: bool = False) -> Path:
    """Write to a file beside ``path``, rename it, and return ``path``: nobody ever sees half a file.

    ``write`` is given the open binary file. If ``durable``, the file goes to the disk before it gets its
    name, and its name after that: the old file or the whole new one survives a power cut. A process killed
    meanwhile leaves ``.<name>.<digits>.part``. An OSError names the file.
    """
    check_parent(path)
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        with naming(path, part):
            with part.open("xb") as file:
                write(file)
                if durable:
                    file.flush()
                    os.fsync(file.fileno())
            part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    if durable and os.name == "posix":
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    return path
