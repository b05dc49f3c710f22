"""Base recordings, the model, and what it says of spoiled recordings."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import joblib
import numpy as np

from benchmarks.spoiled._kind import KINDS, Base, Kind, noisy
from cyclofeat.cli import main as cyclofeat
from cyclofeat.counting import LobeModel
from cyclofeat.datasets import make_rig_recordings, rig_preset
from cyclofeat.models import load_model
from cyclofeat.recordings import Recording
from cyclofeat.simulators import Solver

# What becomes of a recording. One that is wrong with more than 0.9 counts as both of the last two.
RIGHT, REFUSED, WRONG, SURE = "right", "refused", "wrong, not refused", "wrong with > 0.9"
OUTCOMES = (RIGHT, REFUSED, WRONG, SURE)
SPEEDS_RPM = (430.0, 580.0)
UNSPOILED = Kind("unspoiled", "", (0.0,), lambda base, *_: base.recording)
_TURNS = 3.02  # of the output; a little more than three windows
_SEED = 8_302
# Of each number of worn lobes and speed: one machine is spoiled, all are counted unspoiled.
_ASSEMBLIES, _COUNTS = 5, 8


def bases(folder: Path, n_jobs: int) -> list[Base]:
    """Return base recordings of rig R2 with 0 to 7 worn lobes at each speed, from the folder or simulated.

    Those to be spoiled come first, :data:`_COUNTS` of each speed.
    """
    path = folder / "bases.joblib"
    if not path.exists():
        joblib.dump([_simulated(speed, n_jobs) for speed in SPEEDS_RPM], path)
    made, further = [], []
    for output, input_ in joblib.load(path):
        random = np.random.default_rng(_SEED)
        heard = [noisy(one, random) for one in output]
        # The machine with the next count but two is the other one.
        four = [Base(*one) for one in zip(output, heard, heard[3:] + heard[:3], input_, strict=True)]
        made += four[:_COUNTS]
        further += four[_COUNTS:]
    return made + further


def _simulated(speed_rpm: float, n_jobs: int) -> tuple[list[Recording], list[Recording]]:
    """Return output and input torque of the same machines, without noise."""
    output, input_ = (
        make_rig_recordings(
            _ASSEMBLIES, rig=rig_preset("R2").without("noise"), speed_rpm=speed_rpm, output_turns=_TURNS,
            random_state=_SEED, n_jobs=n_jobs, with_angle=True, kernel="auto",
            solver=Solver(integrator="adams_bashforth"), quantity=quantity,
        )
        for quantity in ("output_torque", "input_torque")
    )  # fmt: skip
    return output, input_


def model(folder: Path, path: Path | None = None) -> LobeModel:
    """Return a stored model, by default that of ``cyclofeat train``, trained if the folder has none."""
    stored = path or folder / "model.skops"
    if path is None and not stored.exists():
        assert cyclofeat(["train", "--out", str(stored)]) == 0
    return load_model(stored)


def outcome(model: LobeModel, recording: Recording, truth: int | None) -> list[str]:
    """Return what becomes of a recording; without a truth every count is wrong."""
    try:
        count = model.count(recording)
    except ValueError:
        return [REFUSED]
    if count.refused:
        return [REFUSED]
    if count.defect_count == truth:
        return [RIGHT]
    return [WRONG, SURE] if count.probability[count.defect_count] > 0.9 else [WRONG]


def spoiled(kind: Kind, base: Base, number: int, strength: float) -> Recording:
    """Return the spoiled recording; what is random in it follows from kind, base and strength."""
    random = np.random.default_rng([_SEED, number, zlib.crc32(kind.name.encode())])
    made = kind.spoil(base, strength, random)
    if number % 2 if kind.has_angle is None else kind.has_angle:
        return made
    return made.replace(angle=None, angle_is_absolute=False)


def outcomes(
    model: LobeModel, number: int, base: Base, kinds: Sequence[Kind]
) -> dict[tuple[str, float], list[str]]:
    """Return what becomes of a base spoiled in all strengths of several kinds."""
    found: dict[tuple[str, float], list[str]] = {}
    for kind in kinds:
        truth = base.recording.defect_count if kind.countable else None
        for strength in kind.strengths:
            try:
                recording = spoiled(kind, base, number, strength)
            except ValueError:  # no recording at all
                found[kind.name, strength] = [REFUSED]
                continue
            found[kind.name, strength] = outcome(model, recording, truth)
    return found


def all_outcomes(
    model: LobeModel, bases: Sequence[Base], n_jobs: int
) -> dict[tuple[str, float], Counter[str]]:
    """Return how often each outcome came of each kind and strength, unspoiled recordings among them."""
    n_spoiled = _COUNTS * len(SPEEDS_RPM)
    work = joblib.Parallel(n_jobs=n_jobs)(
        joblib.delayed(outcomes)(
            model, number, base, [UNSPOILED, *(KINDS.values() if number < n_spoiled else ())]
        )
        for number, base in enumerate(bases)
    )
    return {cell: Counter(name for found in work for name in found.get(cell, ())) for cell in work[0]}
