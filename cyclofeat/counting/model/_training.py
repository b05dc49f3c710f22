"""What a model of whole recordings learns: windows, and the counter that is fitted to them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, clone
from sklearn.pipeline import Pipeline

from cyclofeat.counting.calibration.group_calibrated_counter import GroupCalibratedCounter
from cyclofeat.counting.calibration.training_domain import features_seen
from cyclofeat.counting.estimators.lobe_counter import LobeCounter
from cyclofeat.counting.estimators.lobe_positions import lobes_apart, passage_of_lobe_zero
from cyclofeat.counting.evaluation.assembly_folds import fewest_assemblies, fit_clone
from cyclofeat.counting.evaluation.evaluate import Answers, LabelledData, Protocol, evaluate, score_answers
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
        raise ValueError(
            f"sampling_rate of {sampling_rate:g} Hz is too low at {60 * speed_hz:.5g} RPM: {per_turn} "
            f"samples per input turn do not hold lobe lines up to half of the {n_lobes} lobes; record at a "
            "higher rate or train on slower speeds"
        )
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


def draw_per_count(recordings: Sequence[Recording], share: float, random_state: int | None) -> list[int]:
    """Return the indices of a random fraction of the recordings of each count, rounded up."""
    random = np.random.default_rng(random_state)
    counts = np.array([recording.defect_count for recording in recordings])
    drawn: list[int] = []
    for count in np.unique(counts):
        of_count = random.permutation(np.flatnonzero(counts == count))
        drawn += of_count[: int(np.ceil(share * of_count.size))].tolist()
    return sorted(drawn)


def angles_to_learn(
    recordings: Sequence[Recording], turnings: Sequence[Turning], again: Sequence[int], n_lobes: int
) -> list[tuple[int, Float]]:
    """Return numbers of recordings with their angles, then those of ``again`` with what their lines tell."""
    angles = [(k, turning.angle) for k, turning in enumerate(turnings)]
    for k in again:
        if recordings[k].angle is not None:
            by_lines = angle_by_lines(recordings[k], turnings[k], n_lobes)
            if by_lines is not None:
                angles.append((k, by_lines))
    return angles


def windows_at(
    recordings: Sequence[Recording], angles: Sequence[tuple[int, Float]], windower: Windower
) -> WindowSet:
    """Return the windows of recordings over angles; their ``recording`` is the number that comes with it."""
    windows = windower.windows([recordings[k] for k, _ in angles], [angle for _, angle in angles])
    return replace(windows, recording=np.array([k for k, _ in angles])[windows.recording])


def make_counter(
    kind: str | BaseEstimator, windows: WindowSet, n_lobes: int, *, n_trees: int, epochs: int | None,
    random_state: int | None,
) -> BaseEstimator:  # fmt: skip
    """Return the unfitted counter of a model's windows; ``kind`` is ``counter`` of :class:`LobeModel`."""
    rate, worn = windows.sampling_rate, windows.worn_table(n_lobes)
    if (kind == "rows" or is_network(kind)) and (worn is None or lobes_apart(worn)):
        raise ValueError(
            "recordings must all state an absolute angle and worn_lobes that are neighbours for "
            "counter='rows', some do not"
        )
    if not isinstance(kind, str):
        counter = clone(kind)
    elif kind == "rows":
        counter = LobeCounter(rate, kind="network", n_epochs=epochs, random_state=random_state)
        counter.set_params(n_lines=max(N_LINES, round(N_LINES * rate / SAMPLES_PER_TURN)))
    else:
        counter = LobeCounter(rate, n_trees=n_trees, random_state=random_state)
    # The angle is the time of windows: one turn per unit, exactly.
    known = {"sampling_rate": rate, "input_speed_hz": 1.0, "n_lobes": n_lobes, "speed_tolerance": 0.0}
    names = [name for name in counter.get_params(deep=True) if name.rpartition("__")[2] in known]
    return counter.set_params(**{name: known[name.rpartition("__")[2]] for name in names})


def fit_counter(
    counter: BaseEstimator, windows: WindowSet, n_lobes: int, protocol: Protocol | None
) -> tuple[Any, dict[str, Any] | None, Float]:
    """Fit a counter to windows; return it, its cross-validated scores, and the features that it sees.

    Scores are of whole assemblies held out, None if these are too few. A counter whose calibration is left
    out, which never changes the count, has no calibration error.
    """
    assert windows.y is not None
    groups, worn = windows.groups, windows.worn_table(n_lobes)
    passage = None if worn is None else passage_of_lobe_zero(windows.start_angle, n_lobes)
    data = LabelledData(windows.X, windows.y, windows.recording if groups is None else groups, worn, passage)
    metadata = data.fit_metadata(slice(None))
    fitted: Any = counter
    seen, calibrates = windows.X, True
    if isinstance(counter, LobeCounter):
        proba = counter._fit_cross_val_proba(data.X, data.y, **metadata)
        features = np.asarray(counter.lobe_map_.transform(data.X))
        if is_network(counter):
            if protocol is None or groups is None or not np.isfinite(proba).all():
                return counter, None, features
            answers = Answers.empty(data)
            predictions = answers.classes[proba.argmax(axis=1)]
            answers = replace(answers, proba=proba, certainty=proba.max(axis=1), predictions=predictions)
            return counter, score_answers(answers, protocol).to_dict(), features
        calibrates = counter.pattern_ == "any"
        scored, seen = (counter, seen) if calibrates else (counter.count_trees_, features)
    else:
        # A lobe map learns nothing from other windows, so that all folds can share it.
        shared = isinstance(counter, Pipeline) and isinstance(counter[0], LobeMap)
        seen = np.asarray(counter[0].fit_transform(seen)) if shared else seen
        behind = counter[1:] if shared else counter
        scored = behind[0] if shared and len(behind) == 1 else behind
        if isinstance(scored, GroupCalibratedCounter):
            scored, calibrates = scored.counter, False
        fitted = fit_clone(behind, seen, data.y, **metadata)
        features = features_seen(fitted, seen)
        fitted = Pipeline([counter.steps[0], *fitted.steps]) if shared else fitted
    if protocol is None or groups is None or fewest_assemblies(groups, data.y) < protocol.n_splits:
        return fitted, None, features
    lobes = None if worn is None or passage is None else (worn, passage)
    scores = evaluate(scored, seen, data.y, groups, lobes=lobes, protocol=protocol).to_dict()
    kept = {name: value for name, value in scores.items() if calibrates or "calibration_error" not in name}
    return fitted, kept, features


def is_network(counter: Any) -> bool:
    """Return True for a counter of rows by networks."""
    return isinstance(counter, LobeCounter) and counter.kind == "network"
