"""Sets as folders that :func:`cyclofeat.datasets.read_folder` reads."""

from __future__ import annotations

import csv
import os
import shutil
import time
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_effects._effects import Hidden, Run, nuisance_and_seed, on_signal, record, run_machine
from benchmarks.hidden_effects._machine import SAMPLING_RATE
from benchmarks.hidden_effects._sets import FIT, HOLD, SEED, Definition, Planned, definitions
from cyclofeat.datasets import read_folder
from cyclofeat.gap.summaries.summarise import Kinematics
from cyclofeat.gap.world.cells import turn_samples
from cyclofeat.recordings import Recording

_COLUMNS = ("file", "sampling_rate", "defect_count", "run", "assembly", "speed", "load", "source")
_PARTS = (FIT, HOLD)


def n_samples(speed_rpm: float) -> int:
    """Samples of a recording: one output turn and 3 % more."""
    return turn_samples(Kinematics(SAMPLING_RATE, speed_rpm / 60))


def machine_run(one: Definition, planned: Planned) -> tuple[Run, np.random.SeedSequence]:
    """Run the machine for one recording of a set; sets that share it get the same run.

    Returns the run and the seed of the recording.
    """
    common = np.random.default_rng([SEED, one.machine, 4]).random(4).tolist()
    key = [SEED, one.machine, 5, _PARTS.index(planned.part), planned.number]
    nuisance, seed = nuisance_and_seed(key, decoy=one.decoy, common=common)
    n = n_samples(planned.condition.speed_rpm)
    return run_machine(planned.count, planned.condition, _in_machine(one), seed, nuisance, n), seed


def _in_machine(one: Definition) -> Hidden:
    """Effects that the run needs: those in the machine, and a gain that has to settle."""
    return [part for part in one.hidden if not on_signal(part[0]) or part[0] == "automatic_gain"]


def recordings_of(sets: Sequence[Definition]) -> Iterator[tuple[Planned, list[NDArray[np.float32]]]]:
    """Recordings of sets that share a machine, one by one for all of them."""
    for planned in sets[0].recordings:
        made, _ = machine_run(sets[0], planned)
        torques = []
        for one in sets:
            key = [SEED, one.number, 6, _PARTS.index(planned.part), planned.number]
            seed = np.random.SeedSequence(key)
            torques.append(record(made, one.hidden, seed, n_samples(planned.condition.speed_rpm)))
        yield planned, torques


def write_sets(sets: Sequence[Definition], out: Path) -> None:
    """Make the folders of the sets that share a machine, each complete or not at all."""
    rows: dict[tuple[str, str], list[Any]] = {(one.name, part): [] for one in sets for part in _PARTS}
    unfinished = {one.name: out / f".{one.name}.{os.getpid()}" for one in sets}
    for folder in unfinished.values():
        shutil.rmtree(folder, ignore_errors=True)
    for planned, torques in recordings_of(sets):
        at = planned.condition
        for one, torque in zip(sets, torques, strict=True):
            file, name = f"{planned.part}_{planned.number}.npz", f"{one.name}_{planned.part}_{planned.number}"
            folder = unfinished[one.name] / planned.part
            folder.mkdir(parents=True, exist_ok=True)
            np.savez(folder / file, torque=torque, sampling_rate=np.float64(SAMPLING_RATE))
            stated = (file, SAMPLING_RATE, planned.count, name, name, at.speed_rpm, at.load_nm, "surrogate")
            rows[one.name, planned.part].append(stated)
    for (name, part), stated_rows in rows.items():
        if stated_rows:
            with (unfinished[name] / part / "recordings.csv").open("w", encoding="utf-8", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows([_COLUMNS, *stated_rows])
    for name, folder in unfinished.items():
        folder.rename(out / name)


@cache
def _sharing() -> dict[int, list[Definition]]:
    found: dict[int, list[Definition]] = {}
    for one in definitions().values():
        found.setdefault(one.machine, []).append(one)
    return found


def generate(names: Iterable[str], out: Path, jobs: int = 2) -> None:
    """Write the missing sets, and those that share a machine with them, and report progress.

    A set whose simulation diverges is reported and left out.
    """
    out.mkdir(parents=True, exist_ok=True)
    machines = dict.fromkeys(definitions()[name].machine for name in names if not (out / name).exists())
    groups = [[one for one in _sharing()[machine] if not (out / one.name).exists()] for machine in machines]
    n_sets, begin, made = sum(map(len, groups)), time.monotonic(), 0
    print(f"{n_sets} sets of {len(groups)} machines to make", flush=True)
    work = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(
        joblib.delayed(_attempt)(group, out) for group in groups
    )
    for k, (n, problem) in enumerate(work, start=1):
        made += n
        if problem:
            print(problem, flush=True)
        if k % 20 == 0 or k == len(groups):
            print(f"{made} of {n_sets} made in {time.monotonic() - begin:.0f} s", flush=True)


def _attempt(group: Sequence[Definition], out: Path) -> tuple[int, str]:
    try:
        write_sets(group, out)
    except RuntimeError as error:
        return 0, f"{', '.join(one.name for one in group)}: {error}"
    return len(group), ""


def read_set(name: str, folder: Path) -> tuple[list[Recording], list[Recording]]:
    """Return the recordings of a set to fit and those held out, from the folder of all sets."""
    fit, hold = (folder / name / part for part in _PARTS)
    return list(read_folder(fit)), list(read_folder(hold)) if hold.exists() else []
