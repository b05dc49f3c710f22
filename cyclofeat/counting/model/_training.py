"""What a model of whole recordings learns: windows, and the counter that is fitted to them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, clone
from sklearn.pipeline import Pipeline

from cyclofeat._base.arguments import ArgumentError
from cyclofeat._base.checks import whole
from cyclofeat.counting.calibration.group_calibrated_counter import GroupCalibratedCounter
from cyclofeat.counting.calibration.training_domain import features_seen
from cyclofeat.counting.estimators.lobe_counter import LobeCounter
from cyclofeat.counting.estimators.lobe_positions import lobes_apart, passage_of_lobe_zero
from cyclofeat.counting.evaluation.assembly_folds import fewest_assemblies, fit_clone
from cyclofeat.counting.evaluation.evaluate import (
    Answers,
    LabelledData,
    Protocol,
    evaluate,
    score_answers,
)
from cyclofeat.counting.model.turning import Turning, angle_by_lines
from cyclofeat.features import LobeMap
from cyclofeat.recordings import Recording, WindowSet
from cyclofeat.recordings.windower import SAMPLES_PER_TURN, Windower
from cyclofeat.signal.lobes import N_LINES, lines_held
from cyclofeat.signal.windows import Float

# Share by which a speed may lie outside those of training.
SPEED_MARGIN = 0.05


def samples_per_turn_at(
    sampling_rate: float, speed_hz: float, n_lobes: int, most: int = SAMPLES_PER_TURN
) -> int:
    """Return how many samples per input turn windows of a recording have, at most ``most``.

    Raises ValueError if they hold no lobe lines up to half of the lobes.
    """
    per_turn = min(most, int(sampling_rate / (speed_hz * (1 + SPEED_MARGIN))))
    if 2 * lines_held(per_turn, 1.0, n_lobes) < n_lobes:
        raise ArgumentError(
            "{argument} of {rate:g} Hz is too low at {rpm:.5g} RPM: {per_turn} samples per input turn do not "
            "hold lobe lines up to half of the {n_lobes} lobes; record at a higher rate or train on slower "
            "speeds",
            argument="sampling_rate", rate=sampling_rate, rpm=60 * speed_hz, per_turn=per_turn,
            n_lobes=n_lobes,
        )  # fmt: skip
    return per_turn


def common_samples_per_turn(
    recordings: Sequence[Recording], turnings: Sequence[Turning], n_lobes: int, most: int
) -> int:
    """Return the samples per input turn that all recordings hold, at most ``most``."""
    held = [
        recording.sampling_rate / (turning.speed_hz * (1 + SPEED_MARGIN))
        for recording, turning in zip(recordings, turnings, strict=True)
    ]
    fewest = int(np.argmin(held))
    per_turn = samples_per_turn_at(recordings[fewest].sampling_rate, turnings[fewest].speed_hz, n_lobes, most)
    if per_turn < most <= np.median(held):
        file = (recordings[fewest].meta or {}).get("file")
        warnings.warn(
            f"recordings[{fewest}]{f' ({file})' if file else ''} holds {per_turn} samples per input turn, "
            f"most others {most} and more: the model uses no more of any, and fewer lobe lines; "
            "leave such recordings out, or train a second model on them",
            stacklevel=3,
        )
    return per_turn


def draw_of_each_count(recordings: Sequence[Recording], share: float, random_state: int | None) -> list[int]:
    """Return the indices of a random fraction of the recordings of each count, rounded up."""
    random = np.random.default_rng(random_state)
    counts = np.array([recording.defect_count for recording in recordings])
    drawn: list[int] = []
    for count in np.unique(counts):
        of_count = random.permutation(np.flatnonzero(counts == count))
        drawn += of_count[: int(np.ceil(share * of_count.size))].tolist()
    return sorted(drawn)


def windows_to_learn(
    recordings: Sequence[Recording], turnings: Sequence[Turning], again: Sequence[int], windower: Windower
) -> WindowSet:
    """Return the windows of recordings, then those of some of them ``again``, as if without tachometer."""
    assert windower.reduction is not None
    index = list(range(len(recordings)))
    angles = [turning.angle for turning in turnings]
    for k in again:
        if recordings[k].angle is not None:
            by_lines = angle_by_lines(recordings[k], turnings[k], windower.reduction)
            if by_lines is not None:
                index.append(k)
                angles.append(by_lines)
    windows = windower.windows([recordings[k] for k in index], angles)
    return replace(windows, recording=np.array(index)[windows.recording])


def counter_of_windows(
    kind: str | BaseEstimator,
    windower: Windower | None,
    *,
    n_trees: int,
    epochs: int | None,
    seed: int | None,
) -> Callable[[WindowSet, int], BaseEstimator]:
    """Return the function that makes the unfitted counter of a model for given windows of discs.

    Parameters are those of :class:`LobeModel`; ``kind`` is its ``counter``, ``seed`` its ``random_state``.

    Raises
    ------
    ValueError
        If options of the model exclude each other.
    """
    if isinstance(kind, str) and kind not in ("trees", "rows"):
        raise ValueError(f"counter must be 'trees', 'rows' or a classifier of windows, got {kind!r}")
    if kind == "trees" and windower is not None and (windower.samples_per_turn or 0) > SAMPLES_PER_TURN:
        raise ValueError(
            f"samples_per_turn must be at most {SAMPLES_PER_TURN} for counter='trees', which uses {N_LINES} "
            f"lobe lines, got {windower.samples_per_turn}"
        )
    if epochs is not None:
        whole("epochs", epochs, 1)
        if kind != "rows":
            raise ValueError(f"epochs must be None unless counter='rows', got {epochs} with counter={kind!r}")

    def make_counter(windows: WindowSet, n_lobes: int) -> BaseEstimator:
        rate = windows.sampling_rate
        worn = windows.worn_table(n_lobes)
        of_rows = kind == "rows" or is_network(kind)
        if of_rows and (worn is None or lobes_apart(worn)):
            raise ValueError(
                "recordings must all state an absolute angle and worn_lobes that are neighbours for "
                "counter='rows', some do not"
            )
        if not isinstance(kind, str):
            counter = clone(kind)
        elif kind == "rows":
            n_lines = max(N_LINES, round(N_LINES * rate / SAMPLES_PER_TURN))
            counter = LobeCounter(rate, kind="network", n_lines=n_lines, n_epochs=epochs, random_state=seed)
        else:
            counter = LobeCounter(rate, n_trees=n_trees, random_state=seed)
        # The angle is the time of windows: one turn per unit, exactly.
        known = {"sampling_rate": rate, "input_speed_hz": 1.0, "n_lobes": n_lobes, "speed_tolerance": 0.0}
        names = [name for name in counter.get_params(deep=True) if name.rpartition("__")[2] in known]
        return counter.set_params(**{name: known[name.rpartition("__")[2]] for name in names})

    return make_counter


def fit_counter(
    counter: BaseEstimator, windows: WindowSet, n_lobes: int, protocol: Protocol | None
) -> tuple[Any, dict[str, Any] | None, Float]:
    """Fit a counter to windows; return it, its cross-validated scores, and the features that it sees."""
    assert windows.y is not None
    X, y, worn = windows.X, windows.y, windows.worn_table(n_lobes)
    metadata = {"groups": windows.recording if windows.groups is None else windows.groups}
    lobes = None
    if worn is not None:
        lobes = worn, passage_of_lobe_zero(windows.start_angle, n_lobes)
        metadata |= {"worn": lobes[0], "passage": lobes[1]}
    if isinstance(counter, LobeCounter):
        proba = counter.fit_cross_val_proba(X, y, **metadata)
        features = np.asarray(counter.lobe_map_.transform(X))
        if is_network(counter):
            scores = _scores_of_training(proba, windows, protocol)
        elif counter.pattern_ == "any":
            scores = _cross_validated_scores(counter, X, windows, protocol, lobes)
        else:
            # Calibration raises all probabilities to one power, which never changes the count.
            trees = GroupCalibratedCounter(counter.count_trees_)
            scores = _cross_validated_scores(trees, features, windows, protocol, None)
        return counter, scores, features
    if not (isinstance(counter, Pipeline) and isinstance(counter[0], LobeMap)):
        scores = _cross_validated_scores(counter, X, windows, protocol, lobes)
        fitted = fit_clone(counter, X, y, **metadata)
        return fitted, scores, features_seen(fitted, X)
    # A lobe map learns nothing from other windows, so that all folds can share it.
    features = np.asarray(counter[0].fit_transform(X))
    behind = counter[1:] if len(counter) > 2 else counter[-1]
    scores = _cross_validated_scores(behind, features, windows, protocol, lobes)
    fitted = fit_clone(behind, features, y, **metadata)
    steps = fitted.steps if len(counter) > 2 else [(counter.steps[-1][0], fitted)]
    seen = features_seen(fitted, features) if len(counter) > 2 else features
    return Pipeline([counter.steps[0], *steps]), scores, seen


def is_network(counter: Any) -> bool:
    """Return True for a counter of rows by networks."""
    return isinstance(counter, LobeCounter) and counter.kind == "network"


def _cross_validated_scores(
    counter: BaseEstimator, X: Float, windows: WindowSet, protocol: Protocol | None, lobes: Any
) -> dict[str, Any] | None:
    """Return scores with whole assemblies held out; None if there are too few assemblies."""
    if protocol is None or windows.y is None or windows.groups is None:
        return None
    if fewest_assemblies(windows.groups, windows.y) < protocol.n_splits:
        return None
    uncalibrated = isinstance(counter, GroupCalibratedCounter)
    if isinstance(counter, GroupCalibratedCounter):
        # Calibration raises all probabilities to one power, which never changes the count.
        counter = counter.counter
    scores = evaluate(counter, X, windows.y, windows.groups, lobes=lobes, protocol=protocol).to_dict()
    if uncalibrated:  # the calibration error is not that of the model
        scores = {name: value for name, value in scores.items() if not name.startswith("calibration_error")}
    return scores


def _scores_of_training(proba: Float, windows: WindowSet, protocol: Protocol | None) -> dict[str, Any] | None:
    """Return scores of out-of-fold probabilities; None without folds."""
    if protocol is None or windows.groups is None or not np.isfinite(proba).all():
        return None
    answers = Answers.without_answers(LabelledData.from_arrays(windows.X, windows.y, windows.groups))
    predictions = answers.classes[proba.argmax(axis=1)]
    answers = replace(answers, proba=proba, certainty=proba.max(axis=1), predictions=predictions)
    return score_answers(answers, protocol).to_dict()
