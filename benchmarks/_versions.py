"""Stored results of a benchmark, and what made them: versions of code, settings and processor."""

from __future__ import annotations

import functools
import hashlib
import inspect
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import joblib
import llvmlite.binding as llvm

from cyclofeat._base.files import write_whole
from cyclofeat.gap.simulations import versions

# Read at import, because the files may change on disk while a process works.
_CODE = versions("signal", "gap")
_RECORDINGS = versions("recordings", "../datasets")
Made = TypeVar("Made")


def made_with(**design: Any) -> str:
    """Return a short hash of the code and of the settings that affect a result."""
    stated = [_CODE, {name: repr(value) for name, value in design.items()}]
    return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()[:10]


def stored_answers(
    folder: Path, names: Sequence[str], answer: Callable[[str], object], jobs: int
) -> dict[str, Any]:
    """Return the answer of each name, as JSON holds it; those that the folder has are read.

    As many are made at a time as there are jobs. An interrupted run goes on.
    """
    folder.mkdir(parents=True, exist_ok=True)
    missing = [name for name in names if not (folder / f"{name}.json").exists()]
    began = time.monotonic()

    def run(name: str) -> str:
        content = json.dumps(answer(name), indent=1).encode()
        write_whole(folder / f"{name}.json", lambda stream: stream.write(content))
        return name

    done = joblib.Parallel(jobs, return_as="generator_unordered")(map(joblib.delayed(run), missing))
    for k, name in enumerate(done, start=1):
        print(f"{k} of {len(missing)}: {name}, {(time.monotonic() - began) / 60:.1f} min", flush=True)
    return {name: json.loads((folder / f"{name}.json").read_text(encoding="utf-8")) for name in names}


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
