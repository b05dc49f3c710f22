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
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.model_selection import GroupKFold, cross_val_predict

from benchmarks.hidden_effects._folders import n_samples
from benchmarks.hidden_effects._machine import SAMPLING_RATE
from benchmarks.hidden_effects._sets import FIT, HERE, Definition, Planned, definitions
from cyclofeat.gap.simulations import KERNEL, MAY_DIFFER, NO_SUCH_RIG, SPARE, Population, with_may_differ
from cyclofeat.gap.summaries import Conditions
from cyclofeat.gap.world import FLOOR, recording_cells
from cyclofeat.simulators import Effect, MachineRun, Rig, known_effects
from cyclofeat.simulators.many import attempt_planned

Float = NDArray[np.float64]

FILE = HERE / "visible.csv"
SIGMA = 3.0
N_RECORDINGS = 32  # simulated with, and as many without
_FOLDS = 4
_WHEELS = ((0,), (0, 1))


def effects_of(one: Definition) -> dict[str, Effect]:
    """The hidden effects of a set that the library has, as its own."""
    known = known_effects()
    return {name: known[name](**theta).check() for name, theta in one.hidden if name in known}


def simulated_cells(
    effects: Sequence[Effect], recordings: Sequence[Planned], seed: int, without: Sequence[str] = ()
) -> dict[str, Float]:
    """Summaries of simulated recordings of a rig with effects (``""``) and without one of them (its name).

    NaN stands for recordings that could not be made.
    """
    variants = {name: [one for one in effects if one.effect_id != name] for name in ("", *without)}
    in_machine = {name: [one for one in kept if one.needs_simulation()] for name, kept in variants.items()}
    different = [name for name, kept in in_machine.items() if not name or len(kept) < len(in_machine[""])]
    plans = [
        _population(in_machine[name], planned).plan_run(
            planned.count, np.random.SeedSequence([seed, i]), spare=SPARE
        )
        for name in different
        for i, planned in enumerate(recordings)
    ]
    runs = attempt_planned(plans, KERNEL)
    found = {}
    for name, kept in variants.items():
        first = len(recordings) * (different.index(name) if name in different else 0)
        chain = [one for one in kept if not one.needs_simulation()]
        rows = [
            _cells(run, chain, planned)
            for run, planned in zip(runs[first : first + len(recordings)], recordings, strict=True)
        ]
        found[name] = np.array(rows)
    return found


def _population(effects: Sequence[Effect], planned: Planned) -> Population:
    rig, at = with_may_differ(Rig(), (*MAY_DIFFER, *FLOOR)).with_added(*effects), planned.condition
    gearbox = rig.gearbox.replace(input_speed=at.speed_rpm * math.pi / 30, load_torque=at.load_nm)
    return Population(rig.replace(gearbox=gearbox), n_samples(at.speed_rpm), SAMPLING_RATE, _WHEELS)


@cache
def _n_cells() -> int:
    conditions = Conditions(SAMPLING_RATE, 500 / 60)
    return len(recording_cells(np.zeros((1, n_samples(500.0)), dtype=np.float32), conditions)[1])


def _cells(run: object, chain: Sequence[Effect], planned: Planned) -> Float:
    """Summaries of one recording; in reverse the gearbox's mirror image runs."""
    nothing = np.full(_n_cells(), np.nan)
    if not isinstance(run, MachineRun):
        return nothing
    way, n = planned.condition.direction, n_samples(planned.condition.speed_rpm)
    turned = dataclasses.replace(run, run=dataclasses.replace(run.run, torque_out=way * run.run.torque_out))
    try:
        torque = turned.record(chain).torque_out
    except NO_SUCH_RIG:
        return nothing
    if torque.size != n or not np.all(np.isfinite(torque)):
        return nothing
    conditions = Conditions(SAMPLING_RATE, planned.condition.speed_rpm / 60)
    values, _ = recording_cells((way * torque[None]).astype(np.float32), conditions)
    return np.asarray(values[0])


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


def write_visible(names: Iterable[str], file: Path = FILE) -> None:
    """Add the significances of the sets that the file does not have; an interrupted run continues."""
    rows = _rows(file)
    with file.open("a", encoding="utf-8", newline="") as stream:
        for name in names:
            one = definitions()[name]
            if name in rows or one.kind not in ("single", "several"):
                continue
            found = significance(one)
            for effect, sigma in found.items():
                stream.write(f"{name},{effect},{sigma:.3g}\n")
            stream.flush()


def visible(file: Path = FILE) -> dict[str, dict[str, float]]:
    """Significance of each effect, by set."""
    return _rows(file)


def _rows(file: Path) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    if file.exists():
        with file.open(encoding="utf-8", newline="") as stream:
            for name, effect, sigma in csv.reader(stream):
                found.setdefault(name, {})[effect] = float(sigma)
    return found
