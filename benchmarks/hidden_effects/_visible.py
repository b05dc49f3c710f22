"""Which hidden effects an oracle sees that knows all the others and their sizes: ``visible.csv``.

For each effect of a set, recordings of a rig with all effects of the set and of one without this one are
simulated (by :mod:`cyclofeat.simulators`, at the set's conditions, with the same random numbers), and a
linear discriminant of their summaries is cross-validated. Its distance between the two, in standard
deviations of one recording, times the root of the number of recordings of the set, is the significance with
which the oracle detects the effect; from 3 on the effect is visible.
"""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Sequence

import joblib
import numpy as np
from numpy.typing import NDArray
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.model_selection import GroupKFold, cross_val_predict

from benchmarks.hidden_effects._folders import n_samples
from benchmarks.hidden_effects._machine import SAMPLING_RATE
from benchmarks.hidden_effects._sets import FIT, HERE, Definition, Planned, definitions, set_names
from cyclofeat.gap.simulations import (
    KERNEL,
    MAY_DIFFER,
    NO_SUCH_RIG,
    Population,
    with_may_differ,
)
from cyclofeat.gap.summaries.summarise import Kinematics
from cyclofeat.gap.world.cells import recording_cells
from cyclofeat.gap.world.world import NOISE_AND_DRIFT
from cyclofeat.simulators import Effect, Rig, known_effects
from cyclofeat.simulators.machine import MachineRun
from cyclofeat.simulators.sampling import sample_runs

Float = NDArray[np.float64]

FILE = HERE / "visible.csv"
SIGMA = 3.0
N_RECORDINGS = 32  # simulated with, and as many without
_FOLDS = 4
_WHEELS = ((0,), (0, 1))


def effects_of(one: Definition) -> dict[str, Effect]:
    """The hidden effects of a set that the library has, as its own."""
    known = known_effects()
    return {name: known[name].with_parameters(**theta) for name, theta in one.hidden if name in known}


def simulated_cells(
    effects: Sequence[Effect], recordings: Sequence[Planned], seed: int, without: Sequence[str] = ()
) -> dict[str, Float]:
    """Summaries of simulated recordings of a rig with effects (``""``) and without one of them (its name).

    NaN stands for recordings that could not be made.
    """
    variants = {name: [one for one in effects if one.effect_id != name] for name in ("", *without)}
    in_machine = {name: [one for one in kept if one.needs_simulation()] for name, kept in variants.items()}
    different = [name for name, kept in in_machine.items() if not name or len(kept) < len(in_machine[""])]
    in_signal = {name: [one for one in kept if not one.needs_simulation()] for name, kept in variants.items()}
    samples = [
        _population(in_machine[name], planned).sample(
            planned.count, np.random.SeedSequence([seed, i]), chains=[in_signal[name]]
        )
        for name in different
        for i, planned in enumerate(recordings)
    ]
    runs = sample_runs(samples, kernel=KERNEL)
    found = {}
    for name, chain in in_signal.items():
        first = len(recordings) * (different.index(name) if name in different else 0)
        torques = [
            _torque(run, chain, planned)
            for run, planned in zip(runs[first : first + len(recordings)], recordings, strict=True)
        ]
        found[name] = _cells(torques, recordings)
    return found


def _population(effects: Sequence[Effect], planned: Planned) -> Population:
    rig, at = with_may_differ(Rig(), (*MAY_DIFFER, *NOISE_AND_DRIFT)).with_added(*effects), planned.condition
    return Population(rig.at(at.speed_rpm, at.load_nm), n_samples(at.speed_rpm), SAMPLING_RATE, _WHEELS)


def _torque(run: object, chain: Sequence[Effect], planned: Planned) -> NDArray[np.float32] | None:
    """Torque of one recording, positive; in reverse the gearbox's mirror image runs. None if it failed."""
    if not isinstance(run, MachineRun):
        return None
    way = planned.condition.direction
    turned = dataclasses.replace(run, run=dataclasses.replace(run.run, torque_out=way * run.run.torque_out))
    try:
        torque = turned.record(chain).torque_out
    except NO_SUCH_RIG:
        return None
    good = torque.size == n_samples(planned.condition.speed_rpm) and np.all(np.isfinite(torque))
    return (way * torque).astype(np.float32) if good else None


def _cells(torques: Sequence[NDArray[np.float32] | None], recordings: Sequence[Planned]) -> Float:
    """Summaries, NaN for recordings that failed; those of one speed at once, which is quicker."""
    rows: dict[int, Float] = {}
    for speed in {planned.condition.speed_rpm for planned in recordings}:
        there = [
            i for i, planned in enumerate(recordings)
            if planned.condition.speed_rpm == speed and torques[i] is not None
        ]  # fmt: skip
        if there:
            X = np.array([torques[i] for i in there])
            values, _ = recording_cells(X, Kinematics(SAMPLING_RATE, speed / 60))
            rows |= dict(zip(there, values, strict=True))
    n_cells = len(next(iter(rows.values()))) if rows else 0
    return np.array([rows.get(i, np.full(n_cells, np.nan)) for i in range(len(recordings))])


def significance(one: Definition) -> dict[str, float]:
    """Significance with which the oracle detects each effect of a set that the library has."""
    effects = effects_of(one)
    fit = [planned for planned in one.recordings if planned.part == FIT]
    recordings = [fit[i % len(fit)] for i in range(N_RECORDINGS)]
    values = simulated_cells(list(effects.values()), recordings, one.number, list(effects))
    blocks = [(planned.condition, planned.count) for planned in recordings]
    return {name: math.sqrt(len(fit)) * distance(values[""], values[name], blocks) for name in effects}


def distance(with_it: Float, without: Float, blocks: Sequence[object]) -> float:
    """Distance between two samples in standard deviations, by a cross-validated linear discriminant.

    Rows of one place are a pair. ``blocks`` names the condition and count of each, whose means are removed.
    """
    shown = np.isfinite(with_it).all(axis=1) & np.isfinite(without).all(axis=1)
    if shown.sum() < _FOLDS * 2:
        return math.nan
    keys = [str(block) for block, kept in zip(blocks, shown, strict=True) if kept]
    X = np.vstack([with_it[shown], without[shown]])
    labels = np.array(keys * 2)
    for key in dict.fromkeys(keys):
        X[labels == key] -= X[labels == key].mean(axis=0)
    spread = X.std(axis=0)
    X = X[:, spread > 1e-9] / spread[spread > 1e-9]
    y = np.repeat([1, 0], len(keys))
    learner = LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto")
    scores = cross_val_predict(
        learner, X, y, groups=np.tile(np.arange(len(keys)), 2), cv=GroupKFold(_FOLDS),
        method="decision_function",
    )  # fmt: skip
    apart = scores[y == 1].mean() - scores[y == 0].mean()
    return float(apart / math.sqrt((scores[y == 1].var() + scores[y == 0].var()) / 2 + 1e-12))


def write_visible(jobs: int) -> None:
    """Add the significances of the sets that ``visible.csv`` does not have; an interrupted run continues."""
    known = visible()
    left = [name for kind in ("several", "single") for name in set_names([kind]) if name not in known]
    work = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
    for name, found in work(joblib.delayed(_named)(name) for name in left):
        known[name] = found
        rows = [f"{name},{effect},{sigma:.3g}\n" for effect, sigma in found.items()]
        with FILE.open("a", encoding="utf-8") as stream:
            stream.writelines(rows)
    every = [
        f"{name},{effect},{sigma:.3g}\n" for name in sorted(known) for effect, sigma in known[name].items()
    ]
    FILE.write_text("".join(every), encoding="utf-8")


def _named(name: str) -> tuple[str, dict[str, float]]:
    return name, significance(definitions()[name])


def visible() -> dict[str, dict[str, float]]:
    """Significance of each effect, by set."""
    found: dict[str, dict[str, float]] = {}
    if FILE.exists():
        with FILE.open(encoding="utf-8", newline="") as stream:
            for name, effect, sigma in csv.reader(stream):
                found.setdefault(name, {})[effect] = float(sigma)
    return found
