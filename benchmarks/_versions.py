"""Stored results of a benchmark, and what made them: versions of code, settings and processor."""

from __future__ import annotations

import functools
import hashlib
import inspect
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import joblib
import llvmlite.binding as llvm

from cyclofeat.gap.simulations import versions

# Read at import, because the files may change on disk while a process works.
_CODE = versions("signal", "gap")
_RECORDINGS = versions("recordings", "../datasets")
Made = TypeVar("Made")


def made_with(**design: Any) -> str:
    """Return a short hash of the code and of the settings that affect a result."""
    stated = [_CODE, {name: repr(value) for name, value in design.items()}]
    return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()[:10]


def kept_in(folder: Path) -> Callable[[Callable[..., Made]], Callable[..., Made]]:
    """Decorate a simulation: what this version of the code has made before is read from the folder.

    An argument ``n_jobs`` does not matter to the result.
    """

    def decorate(simulate: Callable[..., Made]) -> Callable[..., Made]:
        @functools.wraps(simulate)
        def read_or_made(*arguments: object, **named: object) -> Made:
            memory = joblib.Memory(folder / made_with(recordings=_RECORDINGS), verbose=0)
            ignored = [name for name in inspect.signature(simulate).parameters if name == "n_jobs"]
            result: Made = memory.cache(simulate, ignore=ignored)(*arguments, **named)
            return result

        return read_or_made

    return decorate


def vector_width() -> str:
    """The widest vector instructions that the compiler may use here."""
    features = llvm.get_host_cpu_features()
    for name, text in (
        ("avx512f", "512 bit (AVX-512)"),
        ("avx2", "256 bit (AVX2)"),
        ("avx", "256 bit (AVX)"),
    ):
        if features.get(name):
            return text
    return "128 bit or none"
