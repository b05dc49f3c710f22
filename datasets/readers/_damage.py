"""Opening of files by the libraries of their kinds; files may be damaged, or made to fill the memory."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

# Deflate, the strongest compression of these files, packs at most 1032:1. A small file that claims more is
# damaged, or made to fill the memory.
_LARGEST_RATIO, _ALWAYS_ALLOWED = 1100, 2**26
# Records pack at most so tightly; what unpacks to more is refused above a size that memories hold.
_USUAL_RATIO, LARGEST_UNPACKED = 30, 2 * 10**9


def check_claim(path: Path, n_bytes: int) -> None:
    """Raise ``ValueError`` where a file claims more data than one of its size can hold."""
    if n_bytes > max(_LARGEST_RATIO * path.stat().st_size, _ALWAYS_ALLOWED):
        raise ValueError(
            f"{path.name} is damaged: it claims {n_bytes / 1e9:.3g} GB of data in {path.stat().st_size} bytes"
        )


def check_unpacked(path: Path, n_bytes: int, of_it: str = "") -> None:
    """Raise ``ValueError`` where a compressed file unpacks to over 2 GB and over 30 times its size."""
    limit = max(LARGEST_UNPACKED, _USUAL_RATIO * path.stat().st_size)
    if n_bytes > limit:
        raise ValueError(
            f"{path.name} takes {n_bytes / 1e9:.3g} GB when unpacked{of_it}; at most {limit / 1e9:.3g} GB "
            f"are unpacked from {path.stat().st_size / 1e6:.3g} MB: split it, or save it unpacked"
        )


@contextmanager
def explain_damage(path: Path, kind: str) -> Iterator[None]:
    """Raise ``ValueError`` that calls the file damaged for whatever a library raises while it reads."""
    try:
        yield
    except (MemoryError, PermissionError, ImportError):
        raise
    except Exception as error:  # libraries let all kinds of exceptions through where a file is damaged
        if isinstance(error, ValueError) and path.name in str(error):
            raise
        text = " ".join(str(error).split())
        text = text if len(text) <= 200 else f"{text[:200]}..."  # some quote what they found, at any length
        raise ValueError(
            f"{path.name} is damaged, it cannot be read as {kind} ({type(error).__name__}: {text})"
        ) from None


@contextmanager
def open_with(
    path: Path, kind: str, library: str, open_file: Callable[[Any], AbstractContextManager[Any]]
) -> Iterator[Any]:
    """Open a file with the module of a library, which may not be installed; explain damage meanwhile."""
    package = {"nptdms": "npTDMS"}.get(library, library.partition(".")[0])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of libraries that these import
            module = import_module(library)
    except ImportError:
        raise ImportError(f"reading {path.name} as {kind} needs {package}: pip install {package}") from None
    with explain_damage(path, kind), open_file(module) as file:
        yield file
