"""Copies of models that passed the checks of a ``.skops`` file, from which they are read in a moment."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from cyclofeat._base.files import write_whole
from cyclofeat._base.versions import MODEL_PACKAGES, code_sha256, package_versions

_MOST_COPIES = 8


def user_cache() -> Path:
    """Return the folder for what can be made again: ``$XDG_CACHE_HOME/cyclofeat``, else in ``~/.cache``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cyclofeat"


def read_through(folder: Path, sha256: str, read: Callable[[], Any]) -> Any:
    """Return the model of the file with this sum: its copy in the folder, else what ``read`` returns.

    Copies are pickles, which are code. They are used only in a folder that nobody else can write to.
    """
    package = Path(__file__).parents[1]
    files = (path for room in ("counting", "features", "models") for path in (package / room).glob("*.py"))
    code = code_sha256(package, sorted(files))
    made = json.dumps([sha256, code, package_versions(*MODEL_PACKAGES, "skops")])
    copy = folder / f"{hashlib.sha256(made.encode()).hexdigest()}.pickle"
    with suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not _is_private(folder):
        return read()
    with suppress(Exception):  # none yet, or damaged
        return pickle.loads(copy.read_bytes())
    loaded = read()
    with suppress(OSError):  # of a full disk: only the next start is slower
        write_whole(copy, lambda file: pickle.dump(loaded, file, pickle.HIGHEST_PROTOCOL))
        for old in sorted(folder.glob("*.pickle"), key=lambda path: path.stat().st_mtime)[:-_MOST_COPIES]:
            old.unlink()
    return loaded


def _is_private(folder: Path) -> bool:
    """Return True for a folder that its owner alone, who is this user, can write to."""
    if not folder.is_dir() or os.name != "posix":
        return folder.is_dir()
    status = folder.stat()
    return status.st_uid == os.getuid() and not status.st_mode & 0o022
