"""Files that appear whole or not at all, and the versions and the code that made a result."""

from __future__ import annotations

import errno
import functools
import hashlib
import importlib.metadata
import os
import platform
import secrets
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

# The metadata of a package are parsed once: the card of each model names six versions.
_installed_version = functools.cache(importlib.metadata.version)


def check_parent(path: Path, of: str = "") -> None:
    """Raise FileNotFoundError unless the folder of a file to be written exists; ``of`` names the file."""
    if not path.parent.is_dir():
        named = f" for {of}" if of else ""
        raise FileNotFoundError(f"folder {path.parent}{named} does not exist: make it first")


@contextmanager
def name_in_errors(path: str | Path, part: Path | None = None) -> Iterator[None]:
    """Add the target path to errors of writing; a full disk's error names none, or the file beside it."""
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
        with name_in_errors(path, part):
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


# What a stored model depends on.
MODEL_PACKAGES = ("cyclofeat", "python", "numpy", "scipy", "scikit-learn", "joblib", "numba")


def package_versions(*names: str) -> dict[str, str]:
    """Return installed versions by the name of the distribution; ``"python"`` is the interpreter's."""
    return {
        name: platform.python_version() if name == "python" else _installed_version(name) for name in names
    }


def code_sha256(root: Path, files: Iterable[Path]) -> str:
    """Return the SHA-256 of source files: of their paths below ``root`` and their content, in this order."""
    code = hashlib.sha256()
    for path in files:
        code.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return code.hexdigest()
