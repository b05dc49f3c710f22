"""Rows of the table except the peers': each is a figure with its goal, stored once computed."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator

from benchmarks.counting import _designs as designs
from benchmarks.counting._data import SAMPLING_RATE, Design, Windows
from benchmarks.counting._oracle import Twins
from benchmarks.counting._work import (
    JUDGED_NOISE,
    REDUCED_RATE,
    TRAINING_NOISE,
    WithMore,
    Work,
    reduced,
    share,
)
from cyclofeat.counting import (
    ConformalCounter,
    GroupCalibratedCounter,
    LobeCounter,
    LobeModel,
    Protocol,
    evaluate,
    make_lobe_counter,
    predict_recordings,
)
from cyclofeat.counting.scores import at_the_ends, draws, interval, ratio_of_sums, sums_by_assembly
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.models import load_model, save_model
from cyclofeat.signal.lobes import LobeComb, lobe_lines

GOALS: dict[str, dict[float, float]] = {
    "R1": {0.05: 0.99, 0.2: 0.98, 0.5: 0.96, 1.0: 0.92, 2.0: 0.85},
    "R2": {0.05: 0.92, 0.2: 0.88},
    "R0": {0.05: 0.995, 0.2: 0.98, 0.5: 0.85},
}


def default_trees() -> BaseEstimator:
    """Return the step of the default counter after the lobe map."""
    return make_lobe_counter(REDUCED_RATE)[-1]


def accuracy(work: Work, rig: str, noise: float, more: bool) -> dict[str, Any]:
    """Default counter, one window, folds by assembly; with more training assemblies or without."""

    def run() -> dict[str, Any]:
        # A free output has no resonance to remove, and its ripple reaches twice the frequency.
        options = {"n_lines": 88, "ar_order": 0} if more and rig == "R0" else {}
        X, judged = work.features(designs.JUDGED[rig], noise, JUDGED_NOISE, **options)
        counter = default_trees()
        if more:
            further, truth = work.features(designs.MORE[rig], noise, TRAINING_NOISE, **options)
            counter = WithMore(counter, further, truth.y, truth.assembly)
        result = evaluate(counter, X, judged.y, judged.assembly)
        return share(result) | {"macro_f1": result.macro_f1, "confusion": result.confusion.tolist()}

    return work.kept(f"accuracy-{rig}-{noise:g}{'-more' if more else ''}", run)


def shuffled(work: Work, noise: float) -> dict[str, Any]:
    """The same on R1 with counts permuted among assemblies: must fall to chance."""

    def run() -> dict[str, Any]:
        X, judged = work.features(designs.JUDGED["R1"], noise, JUDGED_NOISE)
        of_assembly = judged.y[judged.number == 0]
        counts = np.random.default_rng(0).permutation(of_assembly)[judged.assembly]
        return share(evaluate(default_trees(), X, counts, judged.assembly))

    return work.kept(f"shuffled-{noise:g}", run)


def recordings(work: Work, noise: float = 1.0) -> dict[str, Any]:
    """Eight windows of a recording together; trained on two windows each of other assemblies."""

    def run() -> dict[str, Any]:
        # EIGHT continues the first assemblies of JUDGED, which must not be in training.
        X, judged = work.features(designs.EIGHT, noise, JUDGED_NOISE)
        further, truth = work.features(designs.MORE["R1"], noise, TRAINING_NOISE)
        counter = GroupCalibratedCounter(default_trees()).fit(further, truth.y, groups=truth.assembly)
        counted = predict_recordings(counter, X, judged.assembly)
        right = (counted.counts == judged.y[judged.number == 0]).astype(float)
        return shares(right)

    return work.kept(f"eight-{noise:g}", run)


def lobe_sets(work: Work, noise: float = 0.2) -> dict[str, Any]:
    """Share of exactly right sets of lobes, with the tachometer."""

    def run() -> dict[str, Any]:
        judged = work.windows(designs.JUDGED["R1"])
        X = reduced(judged, noise, JUDGED_NOISE)
        counter = LobeCounter(REDUCED_RATE, n_splits=2)
        found = evaluate(
            counter, X, judged.y, judged.assembly, lobes=(judged.worn, judged.passage),
            protocol=Protocol(n_splits=3),
        )  # fmt: skip
        assert found.exact_lobes is not None
        return {
            "value": found.exact_lobes,
            "interval": list(found.exact_lobes_interval or ()),
            "count": found.accuracy,
            "count_interval": list(found.accuracy_interval),
        }

    return work.kept(f"lobes-{noise:g}", run)


def patterns(work: Work, noise: float = 0.2) -> dict[str, Any]:
    """Count and positions of non-adjacent lobes; trained on adjacent and on any lobes."""
    return work.kept(
        f"patterns-{noise:g}", lambda: _trained_on_any(work, designs.JUDGED["R1"], designs.PATTERNS, noise)
    )


def neighbours(work: Work, noise: float = 0.2) -> dict[str, Any]:
    """Loss from training on any lobes if the worn ones are adjacent."""
    return work.kept(
        f"neighbours-{noise:g}",
        lambda: _trained_on_any(work, designs.MORE["R1"], designs.JUDGED["R1"], noise),
    )


def _trained_on_any(work: Work, rows: Design, judged: Design, noise: float) -> dict[str, Any]:
    """Count and positions by a counter trained on adjacent worn lobes and on any."""
    training = Windows.joined([work.windows(design) for design in (rows, *designs.ANY)])
    windows = work.windows(judged)
    counter = LobeCounter(REDUCED_RATE, n_splits=3).fit(
        reduced(training, noise, TRAINING_NOISE),
        training.y,
        worn=training.worn,
        passage=training.passage,
        groups=training.assembly,
    )
    X = reduced(windows, noise, JUDGED_NOISE)
    right = (counter.predict(X) == windows.y).astype(float)
    exact = (counter.predict_lobes(X, windows.passage) == windows.worn).all(axis=1).astype(float)
    count, positions = shares(right, windows.assembly), shares(exact, windows.assembly)
    return count | {"positions": positions["value"], "positions_interval": positions["interval"]}


def oracle(work: Work, rig: str, noise: float) -> dict[str, Any]:
    """Likelihood of the lobe lines among simulated twins of the same rig and noise."""

    def run() -> dict[str, Any]:
        parts = [
            (work.windows(design), seed)
            for design, seed in ((designs.MORE[rig], TRAINING_NOISE), (designs.JUDGED[rig], JUDGED_NOISE))
        ]
        lines = [
            lobe_lines(
                reduced(windows, noise, seed).astype(float),
                REDUCED_RATE,
                500 / 60,
                LobeComb(ar_order=16 * (rig == "R2")),
            ).lines
            for windows, seed in parts
        ]
        twins = Twins().fit(lines[0], parts[0][0])
        judged = parts[1][0]
        return shares((twins.predict(lines[1]) == judged.y).astype(float), judged.assembly)

    return work.kept(f"oracle-{rig}-{noise:g}", run)


def conformal(work: Work, noise: float = 0.5, coverage: float = 0.9) -> dict[str, Any]:
    """Sets of counts: coverage over assemblies and of each class, and their size."""

    def run() -> dict[str, Any]:
        X, judged = work.features(designs.JUDGED["R1"], noise, JUDGED_NOISE)
        counter = ConformalCounter(default_trees(), coverage=coverage, nonconformity="aps", unit="assembly")
        found = evaluate(counter, X, judged.y, judged.assembly)
        assert found.coverage is not None
        assert found.class_coverage is not None
        return {
            "value": found.coverage,
            "interval": list(found.coverage_interval or ()),
            "by_class": found.class_coverage.tolist(),
            "size": found.set_size,
            "refused": found.refused,
        }

    return work.kept(f"conformal-{noise:g}", run)


def transfer(work: Work, key: str, train: list[Design], test: Design, noise: float = 0.2) -> dict[str, Any]:
    """Trained on all of some designs, tested on all of another."""

    def run() -> dict[str, Any]:
        parts = [work.features(design, noise, TRAINING_NOISE) for design in train]
        X = np.concatenate([found for found, _ in parts])
        y = np.concatenate([windows.y for _, windows in parts])
        F, judged = work.features(test, noise, JUDGED_NOISE)
        right = default_trees().fit(X, y).predict(F) == judged.y
        return shares(right.astype(float), judged.assembly)

    return work.kept(f"transfer-{key}-{noise:g}", run)


def conditions(work: Work, key: str, ones: dict[float, Design], noise: float = 0.2) -> dict[str, Any]:
    """Each load or speed left out in turn."""

    def run() -> dict[str, Any]:
        first = 0
        X, y, groups, condition = [], [], [], []
        nominal = 22.0 if key == "load" else 500.0
        for value, design in sorted((ones | {nominal: designs.JUDGED["R1"]}).items()):
            # separate noise: the same noise at two loads would identify the assembly
            F, windows = work.features(design, noise, JUDGED_NOISE + int(value))
            # as many assemblies of the nominal condition as of the others
            rows = windows.assembly < 160
            X.append(F[rows])
            y.append(windows.y[rows])
            groups.append(windows.assembly[rows] + first)
            condition.append(np.full(rows.sum(), value))
            first += 1000
        result = evaluate(
            default_trees(), np.concatenate(X), np.concatenate(y), np.concatenate(groups),
            protocol=Protocol("leave-one-condition-out", conditions=np.concatenate(condition)),
        )  # fmt: skip
        found = {str(name): score for name, score in (result.by_condition or {}).items()}
        return share(result) | {"by_condition": found}

    return work.kept(f"left-out-{key}-{noise:g}", run)


def ninth(work: Work, noise: float = 0.2) -> dict[str, Any]:
    """Eight worn lobes as a ninth class."""

    def run() -> dict[str, Any]:
        X, judged = work.features(designs.JUDGED["R1"], noise, JUDGED_NOISE)
        # separate noise, as for `conditions`
        further, eight = work.features(designs.NINTH, noise, JUDGED_NOISE + 8)
        result = evaluate(
            default_trees(),
            np.concatenate([X, further]),
            np.concatenate([judged.y, eight.y]),
            np.concatenate([judged.assembly, eight.assembly + judged.assembly.max() + 1]),
        )
        return share(result) | {"confusion": result.confusion.tolist()}

    return work.kept(f"ninth-{noise:g}", run)


def latency(work: Work) -> dict[str, Any]:
    """Times from one window at the full rate to count, to count and lobes, and by a stored model."""

    def run() -> dict[str, Any]:
        judged = work.windows(designs.JUDGED["R1"]).take(slice(0, 160)).noisy(0.2)
        X = judged.X.astype(float)
        counter = make_lobe_counter(SAMPLING_RATE).fit(X, judged.y)
        lobes = LobeCounter(SAMPLING_RATE, n_splits=2).fit(
            X, judged.y, worn=judged.worn, passage=judged.passage, groups=judged.assembly
        )
        recordings = make_rig_recordings(12, n_jobs=work.n_jobs, with_angle=True)
        untold = [recording.replace(angle=None, angle_is_absolute=False) for recording in recordings]
        with tempfile.TemporaryDirectory() as folder:
            path = save_model(Path(folder) / "model.skops", LobeModel.train(recordings, n_splits=0))
            model = load_model(path)
        return {
            "count": _milliseconds(counter.predict, X[:40, np.newaxis]),
            "lobes": _milliseconds(lobes.predict_lobes, X[:40, np.newaxis], judged.passage[:40, np.newaxis]),
            "model": _milliseconds(model.count, untold[:40]),
        }

    return work.kept("latency", run)


def _milliseconds(call: Callable[..., Any], *arguments: Any) -> float:
    """Processor time of a call, the median over the arguments."""
    times = []
    for one in zip(*arguments, strict=True):
        began = time.process_time()
        call(*one)
        times.append(time.process_time() - began)
    return 1e3 * float(np.median(times))


def shares(right: NDArray[np.float64], assembly: Any = None) -> dict[str, Any]:
    """Mean of the windows' correct counts with its interval over assemblies, as in ``evaluate``."""
    member = np.arange(right.size) if assembly is None else np.unique(assembly, return_inverse=True)[1]
    sums = sums_by_assembly(np.stack([right, np.ones(right.size)], axis=1), member)
    value, limits = interval(ratio_of_sums, sums, draws(len(sums), 1000, 0), 0.95)
    limits = at_the_ends(value, limits, len(sums), 0.95)
    return {"value": value, "interval": list(limits), "n_assemblies": len(sums)}
