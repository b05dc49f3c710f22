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
SPEEDS_RPM = (500.0,)
_TURNS = 3.02  # of the output; a little more than three windows
_SEED = 8_302


def bases(folder: Path, n_jobs: int) -> list[Base]:
    """Return base recordings of rig R2 with 0 to 7 worn lobes at each speed, from the folder or simulated."""
    path = folder / "bases.joblib"
    if not path.exists():
        joblib.dump([_simulated(speed, n_jobs) for speed in SPEEDS_RPM], path)
    made = []
    for output, input_ in joblib.load(path):
        random = np.random.default_rng(_SEED)
        heard = [noisy(one, random) for one in output]
        # The machine with the next count but two is the other one.
        made += [Base(*four) for four in zip(output, heard, heard[3:] + heard[:3], input_, strict=True)]
    return made


def _simulated(speed_rpm: float, n_jobs: int) -> tuple[list[Recording], list[Recording]]:
    """Return output and input torque of the same machines, without noise."""
    output, input_ = (
        make_rig_recordings(
            2, rig=rig_preset("R2").without("noise"), speed_rpm=speed_rpm, output_turns=_TURNS,
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


def outcomes(model: LobeModel, kind: Kind, strength: float, bases: Sequence[Base]) -> Counter[str]:
    """Return how often each outcome came of one kind in one strength."""
    found: Counter[str] = Counter()
    for number, base in enumerate(bases):
        try:
            recording = spoiled(kind, base, number, strength)
        except ValueError:  # no recording at all
            found[REFUSED] += 1
            continue
        found.update(outcome(model, recording, base.recording.defect_count if kind.countable else None))
    return found


def unspoiled(model: LobeModel, bases: Sequence[Base]) -> Counter[str]:
    """Return how often each outcome came of the bases themselves, every second one without its angle."""
    as_is = Kind("unspoiled", "", (0, 0, 0), lambda base, *_: base.recording)
    return outcomes(model, as_is, 0.0, bases)


def all_outcomes(
    model: LobeModel, bases: Sequence[Base], n_jobs: int
) -> dict[tuple[str, float], Counter[str]]:
    """Return the outcomes of all kinds in all strengths."""
    cells = [(kind, strength) for kind in KINDS.values() for strength in kind.strengths]
    work = joblib.Parallel(n_jobs=n_jobs, batch_size=4)(
        joblib.delayed(outcomes)(model, kind, strength, bases) for kind, strength in cells
    )
    return {(kind.name, strength): found for (kind, strength), found in zip(cells, work, strict=True)}
