"""What a model of whole recordings learns: windows, and the counter and locator that are fitted to them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, clone
from sklearn.pipeline import Pipeline

from cyclofeat._base.arguments import ArgumentError
from cyclofeat.counting.calibration.group_calibrated_counter import GroupCalibratedCounter
from cyclofeat.counting.calibration.training_domain import features_seen
from cyclofeat.counting.estimators.lobe_counter import LobeCounter
from cyclofeat.counting.estimators.lobe_locator import LobeLocator, passage_of_lobe_zero
from cyclofeat.counting.estimators.pipelines import make_lobe_counter
from cyclofeat.counting.estimators.row_counter import RowCounter
from cyclofeat.counting.evaluation.assembly_folds import fewest_assemblies
from cyclofeat.counting.evaluation.evaluate import (
    Answers,
    LabelledData,
    Protocol,
    evaluate,
    score_answers,
)
from cyclofeat.counting.model.turning import Turning, angle_by_lines
from cyclofeat.recordings import Recording, WindowSet
from cyclofeat.recordings.windower import SAMPLES_PER_TURN, lobe_windower
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


def samples_per_turn_of(
    recordings: Sequence[Recording], turnings: Sequence[Turning], n_lobes: int, most: int
) -> int:
    """Return how many samples per input turn windows have: what all recordings hold, at most ``most``."""
    held = [
        one.sampling_rate / (turning.speed_hz * (1 + SPEED_MARGIN))
        for one, turning in zip(recordings, turnings, strict=True)
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


def some_of_each_count(recordings: Sequence[Recording], share: float, random_state: int) -> list[int]:
    """Return the numbers of a random share of the recordings of each count, rounded up."""
    random = np.random.default_rng(random_state)
    counts = np.array([one.defect_count for one in recordings])
    some: list[int] = []
    for count in np.unique(counts):
        of_count = random.permutation(np.flatnonzero(counts == count))
        some += of_count[: int(np.ceil(share * of_count.size))].tolist()
    return sorted(some)


def windows_to_learn(
    recordings: Sequence[Recording],
    turnings: Sequence[Turning],
    again: Sequence[int],
    n_lobes: int,
    samples_per_turn: int,
) -> WindowSet:
    """Return the windows of recordings, then those of some of them ``again``, as if without tachometer."""
    number = list(range(len(recordings)))
    angles = [one.angle for one in turnings]
    for k in again:
        recording, turning = recordings[k], turnings[k]
        by_lines = None if recording.angle is None else angle_by_lines(recording, turning, n_lobes)
        if by_lines is not None:
            number.append(k)
            angles.append(by_lines)
    windows = lobe_windower(n_lobes, samples_per_turn).windows([recordings[k] for k in number], angles)
    return replace(windows, recording=np.array(number)[windows.recording])


def fitted_counter(
    windows: WindowSet,
    made_for: dict[str, Any],
    protocol: Protocol | None,
    *,
    rows: bool,
    epochs: int | None,
) -> tuple[BaseEstimator, LobeLocator | LobeCounter | RowCounter | None, dict[str, Any] | None, Float]:
    """Fit counter and locator (if worn lobes are known); return them, cross-validated scores and features."""
    member = windows.recording if windows.groups is None else windows.groups
    n_lobes = made_for["n_lobes"]
    worn = windows.worn_table(n_lobes)
    passage = None if worn is None else passage_of_lobe_zero(windows.start_angle, n_lobes)
    if rows and (worn is None or _any_apart(worn)):
        raise ValueError(
            "recordings must all state an absolute angle and worn_lobes that are neighbours for "
            "counter='rows', some do not"
        )
    if rows:
        n_lines = max(N_LINES, round(N_LINES * windows.sampling_rate / SAMPLES_PER_TURN))
        counter = make_lobe_counter(windows.sampling_rate, kind="rows", **made_for).set_params(
            n_lines=n_lines, n_epochs=epochs
        )
        counter.fit(windows.X, windows.y, groups=member, worn=worn, passage=passage)
        scores = _held_out_scores(counter.oob_decision_function_, windows, protocol)
        return counter, counter, scores, features_seen(counter, windows.X)
    if worn is not None and _any_apart(worn):
        counter = make_lobe_counter(windows.sampling_rate, kind="lobes", **made_for)
        scores = _cross_validation(counter, windows.X, windows, protocol, (worn, passage))
        counter.fit(windows.X, windows.y, groups=member, worn=worn, passage=passage)
        return counter, counter, scores, features_seen(counter, windows.X)
    plain = make_lobe_counter(windows.sampling_rate, **made_for)
    # A lobe map learns nothing from other windows, so that all folds can share it.
    features = np.asarray(plain["lobe_map"].fit_transform(windows.X))
    # Calibration raises all probabilities to one power, which never changes the count: the scores of the
    # uncalibrated trees are those of the model.
    scores = _cross_validation(plain["trees"], features, windows, protocol)
    random_state = made_for["random_state"]
    trees = GroupCalibratedCounter(plain["trees"], random_state=random_state)
    trees.fit(features, windows.y, groups=member)
    locator = None
    if worn is not None and passage is not None and worn.any() and not worn.all():
        locator = LobeLocator(
            windows.sampling_rate, made_for["input_speed_hz"], n_lobes, random_state=random_state,
            speed_tolerance=made_for["speed_tolerance"],
        )  # fmt: skip
        locator.fit(windows.X, worn, passage)
    return Pipeline([("lobe_map", plain["lobe_map"]), ("trees", trees)]), locator, scores, features


def _cross_validation(
    counter: BaseEstimator,
    X: Float,
    windows: WindowSet,
    protocol: Protocol | None,
    lobes: tuple[Any, Any] | None = None,
) -> dict[str, Any] | None:
    """Return scores with whole assemblies held out; None if there are too few assemblies."""
    if protocol is None or windows.y is None or windows.groups is None:
        return None
    if fewest_assemblies(windows.groups, windows.y) < protocol.n_splits:
        return None
    scores = evaluate(clone(counter), X, windows.y, windows.groups, lobes=lobes, protocol=protocol).to_dict()
    # the calibration error of uncalibrated trees is not that of the model
    return {name: value for name, value in scores.items() if not name.startswith("calibration_error")}


def _held_out_scores(proba: Float, windows: WindowSet, protocol: Protocol | None) -> dict[str, Any] | None:
    """Return scores of what a counter said of assemblies that it had held out; None without folds."""
    if protocol is None or windows.y is None or windows.groups is None or not np.isfinite(proba).all():
        return None
    data = LabelledData.checked(windows.X, windows.y, windows.groups)
    answers = Answers.empty(data)
    predictions = answers.classes[proba.argmax(axis=1)]
    answers = replace(answers, proba=proba, certainty=proba.max(axis=1), predictions=predictions)
    return score_answers(answers, protocol).to_dict()


def _any_apart(worn: NDArray[np.bool_]) -> bool:
    """Return True if the worn lobes of any window are more than one row of neighbours."""
    return bool(((worn & ~np.roll(worn, 1, axis=1)).sum(axis=1) > 1).any())
