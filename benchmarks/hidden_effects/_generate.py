"""Cases as folders that :func:`cyclofeat.datasets.read_folder` reads."""

from __future__ import annotations

import csv
import os
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_effects._cases import Case, make_case

_COLUMNS = ("file", "sampling_rate", "defect_count", "run", "assembly", "speed", "load", "source")


def _write_part(folder: Path, case: Case, part: str, X: NDArray[Any], y: NDArray[Any]) -> None:
    folder.mkdir(parents=True)
    with (folder / "recordings.csv").open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(_COLUMNS)
        for i, (torque, count) in enumerate(zip(X, y, strict=True)):
            name = f"{part}_{i}"
            np.savez(folder / f"{name}.npz", torque=torque, sampling_rate=np.float64(case.sampling_rate))
            stated = (f"{name}.npz", case.sampling_rate, count, name, f"{case.name}_{name}", 500, 22)
            rows.writerow([*stated, "surrogate"])


def write_case(name: str, out: Path) -> bool:
    """Make the folder of one case, complete or not at all; return False if it exists."""
    folder = out / name
    if folder.exists():
        return False
    case = make_case(name)
    unfinished = out / f".{name}.{os.getpid()}"
    shutil.rmtree(unfinished, ignore_errors=True)
    _write_part(unfinished / "fit", case, "fit", case.X_fit, case.y_fit)
    if len(case.y_hold):
        _write_part(unfinished / "hold", case, "hold", case.X_hold, case.y_hold)
    unfinished.rename(folder)
    return True


def generate(names: Sequence[str], out: Path, jobs: int = 2) -> None:
    """Write the missing cases and report progress."""
    out.mkdir(parents=True, exist_ok=True)
    left = [name for name in names if not (out / name).exists()]
    print(f"{len(names)} cases, {len(names) - len(left)} of them there already", flush=True)
    begin = time.monotonic()
    work = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(
        joblib.delayed(write_case)(name, out) for name in left
    )
    for done, _ in enumerate(work, start=1):
        if done % 20 == 0 or done == len(left):
            print(f"{done} of {len(left)} made in {time.monotonic() - begin:.0f} s", flush=True)
