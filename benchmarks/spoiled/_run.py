"""Base recordings, and what a model says of spoiled ones."""

from __future__ import annotations

import zlib
from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import chain, islice
from pathlib import Path

import joblib
import numpy as np

from benchmarks._versions import kept_in
from benchmarks.spoiled._kind import KINDS, Base, Kind, noisy
from cyclofeat.counting import LobeModel
from cyclofeat.datasets import make_rig_recordings, rig_preset
from cyclofeat.recordings import Recording
from cyclofeat.simulators import Rig, Solver, motor_effects

# What becomes of a recording. One that is wrong with more than 0.9 counts as both of the last two.
RIGHT, REFUSED, WRONG, SURE = "right", "refused", "wrong, not refused", "wrong with > 0.9"
OUTCOMES = (RIGHT, REFUSED, WRONG, SURE)
# How often each outcome came of each kind and strength.
Found = dict[tuple[str, float], Counter[str]]
SPEEDS_RPM = (430.0, 580.0)
# Each quantity, and the one that is taken for it by mistake.
MISTAKEN = {
    "output_torque": "input_torque",
    "input_torque": "output_torque",
    "motor_current": "output_torque",
}
UNSPOILED = Kind("unspoiled", "", (0.0,), lambda base, *_: base.recording)
_TURNS = 3.02  # of the output; a little more than three windows
_SEED = 8_302
# Machines of each number of worn lobes at each speed. A kind spoils one of them, the next kind the next, so
# that no single machine decides the result; all are counted unspoiled.
_ASSEMBLIES, _COUNTS = 5, 8


def bases(folder: Path, quantity: str, n_jobs: int) -> list[Base]:
    """Return base recordings of rig R2, kept in the folder.

    By speed, then by :data:`_ASSEMBLIES`, then by 0 to 7 worn lobes.
    """
    made = []
    for speed in SPEEDS_RPM:
        silent, other_quantity = kept_in(folder)(_simulated)(speed, quantity, n_jobs)
        random = np.random.default_rng(_SEED)
        heard = [noisy(one, random) for one in silent]
        # The machine with the next count but two is the other one.
        others = heard[3:] + heard[:3]
        made += [Base(*one) for one in zip(silent, heard, others, other_quantity, strict=True)]
    return made


def _simulated(speed_rpm: float, quantity: str, n_jobs: int) -> tuple[list[Recording], ...]:
    """Return a quantity, and the one taken for it, of the same machines, without noise."""
    return tuple(
        make_rig_recordings(
            _ASSEMBLIES, rig=_silent_rig(speed_rpm, quantity), speed_rpm=speed_rpm, output_turns=_TURNS,
            random_state=_SEED, n_jobs=n_jobs, with_angle=True, kernel="auto",
            solver=Solver(integrator="adams_bashforth"), quantity=one,
        )
        for one in (quantity, MISTAKEN[quantity])
    )  # fmt: skip


def _silent_rig(speed_rpm: float, quantity: str) -> Rig:
    """Return rig R2 without noise, with a motor where a current is measured."""
    rig = rig_preset("R2")
    if quantity == "motor_current":
        gearbox = rig.gearbox.replace(input_speed=speed_rpm * np.pi / 30)
        rig = rig.with_effects(*motor_effects(gearbox))
    return rig.without("noise", "current_sensor")


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


def kinds_of(number: int) -> list[Kind]:
    """Return the kinds in which a base recording is spoiled, and that it is counted unspoiled."""
    machine = number // _COUNTS % _ASSEMBLIES
    return [UNSPOILED, *islice(KINDS.values(), machine, None, _ASSEMBLIES)]


def outcomes(model: LobeModel, number: int, base: Base) -> dict[tuple[str, float], list[str]]:
    """Return what becomes of a base recording in all strengths of its kinds."""
    found: dict[tuple[str, float], list[str]] = {}
    for kind in kinds_of(number):
        truth = base.recording.defect_count if kind.countable else None
        for strength in kind.strengths:
            try:
                recording = spoiled(kind, base, number, strength)
            except ValueError:  # no recording at all
                found[kind.name, strength] = [REFUSED]
                continue
            found[kind.name, strength] = outcome(model, recording, truth)
    return found


def all_outcomes(model: LobeModel, bases: Sequence[Base], n_jobs: int) -> Found:
    """Return how often each outcome came of each kind and strength, unspoiled recordings among them."""
    found: Found = defaultdict(Counter)
    work = joblib.Parallel(n_jobs=n_jobs)(
        joblib.delayed(outcomes)(model, number, base) for number, base in enumerate(bases)
    )
    for cell, names in chain.from_iterable(one.items() for one in work):
        found[cell].update(names)
    return found
