"""Counter and locator for whole recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, clone
from sklearn.pipeline import Pipeline

from cyclofeat._base import svg
from cyclofeat._base.arguments import ArgumentError
from cyclofeat._base.card import card
from cyclofeat._base.versions import MODEL_PACKAGES, package_versions
from cyclofeat._base.words import number
from cyclofeat.counting._answers import LobeCount, WindowCount
from cyclofeat.counting._assembly_folds import fewest_assemblies
from cyclofeat.counting._calibration import GroupCalibratedCounter
from cyclofeat.counting._combine import combine_proba
from cyclofeat.counting._conformal import NO_CLASS, OUTSIDE, features_seen
from cyclofeat.counting._domain import TrainingDomain
from cyclofeat.counting._evaluation import evaluate
from cyclofeat.counting._evaluation_summary import score_text
from cyclofeat.counting._lobes import LobeCounter
from cyclofeat.counting._locator import LobeLocator, passage_of_lobe_zero
from cyclofeat.counting._pipelines import make_lobe_counter
from cyclofeat.counting._protocols import Protocol
from cyclofeat.counting._speed import other_speed
from cyclofeat.counting._turning import Turning, turning_of
from cyclofeat.counting._verdicts import disagreement, most_frequent, window_faults
from cyclofeat.features import LobeMap
from cyclofeat.recordings import (
    Recording,
    Windower,
    WindowSet,
    common_n_lobes,
    common_quantity,
    shaft_windows,
)
from cyclofeat.signal.lobes import SPEED_TOLERANCE, LobeLines, lobe_frequency
from cyclofeat.signal.windows import Float

# Share by which a speed may lie outside those of training.
_SPEED_MARGIN = 0.05
# Number of places between two lobes at which a recording without an absolute angle may begin.
_BEGINNINGS = 4


@dataclass(frozen=True)
class LobeModel:
    """Counter and locator of worn lobes of recordings.

    Build it with :meth:`train`, for recordings of any sampling rate at the speeds of the training, or of a
    counter that is fitted already with :meth:`of_counter`, for one sampling rate and speed.

    Attributes
    ----------
    counter : estimator
        Fitted classifier of windows, classes are defect counts. That of :meth:`train` has the steps
        ``"lobe_map"`` and ``"trees"``, the latter in a :class:`GroupCalibratedCounter`, or is a
        :class:`LobeCounter`.
    locator : LobeLocator, LobeCounter or None
        Fitted; the counter itself where that is a :class:`LobeCounter`. None where the training recordings
        did not state angle and worn lobes.
    n_lobes : int
    card : dict
        Training data and versions.
    domain : TrainingDomain or None
        Fitted to the features that the counter sees; None where there was one assembly only.
    sampling_rate, input_speed_hz : float or None
        Hz, and nominal turns per second, of the windows in time that the counter takes. None where it takes
        windows over the angle of the shaft, of any rate and speed.
    """

    counter: BaseEstimator
    locator: LobeLocator | LobeCounter | None
    n_lobes: int
    card: dict[str, Any] = field(repr=False)
    domain: TrainingDomain | None = None
    sampling_rate: float | None = None
    input_speed_hz: float | None = None

    @classmethod
    def train(
        cls,
        recordings: Sequence[Recording],
        *,
        random_state: int = 0,
        n_splits: int = 5,
        n_trees: int = 300,
        description: str = "",
    ) -> LobeModel:
        """Train on labelled recordings, of any speeds, loads and sampling rates.

        Windows of one output turn are cut over the angle of the input shaft: a tachometer's, or the one that
        the lines of the torque give around the stated speed. Where all recordings state which lobes are worn
        and some hold sets that are no row of neighbours, the counter is a :class:`LobeCounter`, which counts
        lobe by lobe; else trees on the lobe map.

        Parameters
        ----------
        recordings : sequence of Recording
            With ``defect_count``; where all of them also state ``worn_lobes`` and an absolute angle, the
            model learns to locate lobes too. Probabilities are calibrated on held-out assemblies; recordings
            are one assembly each if they do not all state theirs.
        random_state : int
            Seed of the trees.
        n_splits : int
            Folds of the cross-validation with whole assemblies held out, whose result goes on the card; 0
            for none. Where a class has fewer assemblies than that there is none either, and the card says so.
        n_trees : int
            Trees of the counter.
        description : str
            Where the recordings come from, for the card.

        Returns
        -------
        LobeModel

        Raises
        ------
        ValueError
            Where recordings lack a defect count, hold one class only, differ in quantity or number of lobes,
            are shorter than an output turn, or state neither angle nor speed.
        """
        n_lobes, quantity = common_n_lobes(recordings), common_quantity(recordings)
        if any(recording.defect_count is None for recording in recordings):
            raise ValueError("recordings must all state their defect_count to train on, some do not")
        turnings = [turning_of(recording, n_lobes) for recording in recordings]
        windows = shaft_windows(recordings, [one.angle for one in turnings], n_lobes)
        assert windows.y is not None
        if np.unique(windows.y).size < 2:
            raise ValueError(f"recordings must hold at least two defect counts, got {windows.y[0]} only")
        made_for = {
            "input_speed_hz": 1.0, "speed_tolerance": 0.0, "n_lobes": n_lobes, "n_trees": n_trees,
            "random_state": random_state,
        }  # fmt: skip
        protocol = Protocol(n_splits=n_splits, random_state=random_state) if n_splits else None
        counter, locator, scores, features = _fitted(windows, made_for, protocol)
        member = windows.recording if windows.groups is None else windows.groups
        domain = None
        if np.unique(member).size > 1:
            domain = TrainingDomain(random_state=random_state).fit(features, windows.y, groups=member)
        card = {
            "description": description,
            "quantity": quantity,
            "speeds_rpm": _range([60 * one.speed_hz for one in turnings]),
            "loads_nm": _range([one.load_nm for one in recordings if one.load_nm is not None]),
            "n_recordings": len(recordings),
            "n_windows": len(windows),
            "sources": sorted({str(r.source) for r in recordings}),
            "assemblies": None if windows.groups is None else np.unique(windows.groups).tolist(),
            "classes": np.unique(windows.y).tolist(),
            "calibrated": fewest_assemblies(member, windows.y) > 1,
            "cross_validation": scores,
            "versions": package_versions(*MODEL_PACKAGES),
        }
        return cls(counter, locator, n_lobes, card, domain)

    @classmethod
    def of_counter(
        cls,
        counter: BaseEstimator,
        *,
        sampling_rate: float,
        input_speed_hz: float = 500 / 60,
        n_lobes: int = 15,
        description: str = "",
    ) -> LobeModel:
        """Make a model for whole recordings of a counter that is fitted already; it locates no lobes.

        Parameters
        ----------
        counter : classifier
            Fitted to windows of one output turn, with ``predict_proba``; classes are defect counts. What a
            :class:`ConformalCounter` refuses, the model refuses.
        sampling_rate, input_speed_hz, n_lobes
            Attributes of the model.
        description : str
            For the card.

        Returns
        -------
        LobeModel

        Raises
        ------
        ValueError
            Where the counter was fitted to windows of another length.
        """
        samples = round(sampling_rate * n_lobes / input_speed_hz)
        fitted = int(counter.n_features_in_)
        if fitted != samples:
            raise ValueError(
                f"counter must be fitted to windows of one output turn, {samples} samples at "
                f"{sampling_rate:g} Hz and {60 * input_speed_hz:g} RPM, got one fitted to {fitted} samples"
            )
        parts = (counter, getattr(counter, "counter_", None))
        card = {
            "description": description,
            "classes": np.asarray(counter.classes_).tolist(),
            "calibrated": any(getattr(part, "calibrated_", False) for part in parts),
            "cross_validation": None,
            "versions": package_versions(*MODEL_PACKAGES),
        }
        domain = getattr(counter, "domain_", None)
        return cls(counter, None, n_lobes, card, domain, sampling_rate, input_speed_hz)

    def _repr_html_(self) -> str:
        stated, scores = self.card, self.card.get("cross_validation")
        rows = {
            "for recordings": self.made_for(),
            "disc": f"{self.n_lobes} lobes",
            "counts": ", ".join(map(str, stated.get("classes", ()))),
            "trained on": stated.get("description"),
            "windows": stated.get("n_windows"),
            "cross-validation": score_text(scores) if scores else "none: accuracy unknown",
            "probabilities": "calibrated" if stated.get("calibrated") else "not calibrated",
            "locates lobes": "no" if self.locator is None else "yes",
            "refuses": "no" if self.domain is None else "what is unlike the training",
        }
        drawn = svg.confusion(np.array(scores["confusion"]), scores["classes"]) if scores else ""
        return card("Counter of worn lobes", rows, pictures=[drawn], code="model.count(recording)")

    def made_for(self) -> str:
        """Return in words which recordings the model counts."""
        quantity = str(self.card.get("quantity", "output_torque")).replace("_", " ")
        if self.input_speed_hz is not None:
            return f"of {quantity} at {self.sampling_rate:g} Hz and {60 * self.input_speed_hz:g} RPM"
        parts = [f"of {quantity} at {_range_text(self.card['speeds_rpm'])} RPM"]
        if self.card["loads_nm"]:
            parts.append(f"{_range_text(self.card['loads_nm'])} Nm")
        return " and ".join(parts)

    def check(self, recording: Recording) -> None:
        """Raise ``ValueError`` if the recording's quantity, lobes, sampling rate or speed do not suit."""
        quantity = self.card.get("quantity", "output_torque")
        if recording.quantity != quantity:
            raise ArgumentError(
                "{argument} of the recording is {got}, but the model was trained on {trained}: train a model "
                "on recordings of that quantity",
                argument="quantity", got=recording.quantity, trained=quantity,
            )  # fmt: skip
        # 15 is the default of recordings that do not state their lobes.
        if recording.n_lobes not in (15, self.n_lobes):
            raise ValueError(
                f"n_lobes of the recording is {recording.n_lobes}, but the model was trained for discs of "
                f"{self.n_lobes}: train a model for them"
            )
        if self.input_speed_hz is None or self.sampling_rate is None:
            return
        if abs(recording.sampling_rate / self.sampling_rate - 1) > 1e-6:
            raise ValueError(
                f"sampling_rate of the recording is {recording.sampling_rate:g} Hz, but the model was "
                f"trained at {self.sampling_rate:g} Hz: resample the recording or train a model at its rate"
            )
        stated = {"speed_rpm of the recording is": recording.input_speed_hz}
        # Speed by the tachometer too, in the middle half, away from a run-up.
        middle = recording.part(0.25 * recording.duration, 0.75 * recording.duration)
        stated["the angle of the recording turns at"] = middle.mean_input_speed(self.n_lobes)
        for source, speed in stated.items():
            if speed is not None and abs(speed / self.input_speed_hz - 1) > SPEED_TOLERANCE:
                raise ValueError(
                    f"{source} {60 * speed:.5g} RPM, but the model was trained at "
                    f"{60 * self.input_speed_hz:.5g} RPM: train a model at that speed"
                )

    def windows(self, recording: Recording) -> WindowSet:
        """Cut a recording into the windows that the counter takes.

        Raises
        ------
        ValueError
            Where the recording does not suit the model or is shorter than one output turn.
        """
        self.check(recording)
        return self._cut(recording)[0]

    def speed_of(self, recording: Recording) -> float:
        """Return the input speed in turns per second at which a recording is drawn.

        The stated one; where that is not close to the shaft's or not known, the shaft's, but at least so
        fast that the recording holds one output turn. For a counter of windows in time, the model's.
        """
        stated = recording.input_speed_hz
        if self.input_speed_hz is not None:
            return stated or self.input_speed_hz
        measured = turning_of(recording, self.n_lobes).speed_hz
        if stated is not None and abs(measured / stated - 1) <= SPEED_TOLERANCE:
            return stated
        return max(measured, self.n_lobes / recording.duration)

    def _cut(self, recording: Recording) -> tuple[WindowSet, Turning | None]:
        """Return windows, and how the shaft turned where they are cut over its angle."""
        if self.input_speed_hz is not None:
            windower = Windower(input_speed_hz=self.input_speed_hz, reduction=self.n_lobes)
            return windower.windows([recording]), None
        turning = turning_of(recording, self.n_lobes)
        return shaft_windows([recording], [turning.angle], self.n_lobes), turning

    def count(self, recording: Recording) -> LobeCount:
        """Count and locate the worn lobes of one recording.

        The probabilities of windows of one output turn are combined by :func:`predict_recordings`; a counter
        without a learned dependence is taken to be no surer of many windows than of one. Windows whose signal
        has a fault, or that lie outside the training domain, are left out. The recording is refused where
        more than half of its windows are, where the windows disagree, where its speed lies outside those of
        training, or where, without a tachometer, its lines are those of another speed or show none; it still
        has a count.

        Raises
        ------
        ValueError
            Where the recording does not suit the model or is shorter than one output turn.
        """
        self.check(recording)
        windows, turning = self._cut(recording)
        proba, dependence, features, lines = self._window_answers(windows.X)
        classes = np.asarray(self.counter.classes_)
        notes = []
        if turning is not None and turning.note:
            notes.append(turning.note)
        if turning is None and recording.input_speed_hz is None:
            assert self.input_speed_hz is not None
            notes.append(
                f"no speed stated: taken as {60 * self.input_speed_hz:g} RPM, as the model was trained"
            )
        distances = self._distances(windows.X, features)
        distance, n_outside = float(np.median(distances)), int(np.sum(distances > 1))
        doubt = self._doubted(recording, windows, turning)
        stops = _stops(windows, recording, turning)
        faults = window_faults(recording, windows, stops, self.n_lobes)
        reason, reasons = self._refusals(windows.X, distances > 1, doubt, faults)
        reason = reason or disagreement(proba, faults)
        used = np.array([not one for one in reasons])
        used |= not used.any()
        probability = combine_proba(proba[used], np.zeros(used.sum(), dtype=int), dependence)[0]
        count = int(classes[probability.argmax()])
        if any(faults) and not reason:
            left_out = f"{sum(map(bool, faults))} of {number(len(windows), 'window')} left out"
            notes.append(f"{left_out}: {most_frequent(faults)}")
        if n_outside:
            notes.append(
                f"{n_outside} of {len(windows)} window{'s' if len(windows) > 1 else ''} {OUTSIDE}: "
                f"{distance:.2f} times the largest distance inside{' (median)' if len(windows) > 1 else ''}"
            )
        lobes: list[int] = []
        share: Float = np.zeros(0)
        absolute = self.locator is not None and bool(windows.absolute.all())
        if self.locator is not None:
            share = self._lobe_probability(windows, lines, absolute, used)
            lobes = sorted(np.argsort(-share, kind="stable")[:count].tolist())
            if not absolute and lobes:
                notes.append(
                    "positions are relative: without an absolute angle they count from the lobe under load "
                    "at the first sample counted"
                )
        if probability.max() < 0.5:
            notes.append(f"uncertain: {count} is most probable with {probability.max():.3f} only")
        if not self.card.get("calibrated", False):
            notes.append("probabilities are not calibrated on assemblies that training did not see")
        return LobeCount(
            defect_count=count,
            probability={int(c): float(p) for c, p in zip(classes, probability, strict=True)},
            lobes=tuple(lobes),
            lobe_probability=tuple(share.tolist()),
            absolute=absolute,
            n_windows=int(used.sum()),
            warnings=tuple(notes),
            refused=bool(reason),
            reason=reason,
            distance=distance,
            windows=tuple(
                WindowCount(*answer)
                for answer in zip(
                    windows.start_s.tolist(),
                    stops.tolist(),
                    classes[proba.argmax(axis=1)].tolist(),
                    proba.max(axis=1).tolist(),
                    distances.tolist(),
                    reasons,
                    strict=True,
                )
            ),
        )

    def _window_answers(self, X: Float) -> tuple[Float, float, Float | None, LobeLines | None]:
        """Return the probabilities of each count for each window, and how much windows err together.

        Also return the features in which the domain measures distances, and the lobe lines: they take most of
        the time, so that locator and domain reuse those of the counter. None where the counter has none.
        """
        lines, features = None, None
        deciding, seen = self.counter, X
        if isinstance(self.counter, Pipeline) and isinstance(self.counter[0], LobeMap):
            lines = self.counter[0].lines(X)
            features = self.counter[0].from_lines(lines)
            deciding, seen = self.counter[1:], features
            if len(deciding) == 1:
                deciding = deciding[0]
            elif self.domain is not None:
                features = np.asarray(deciding[:-1].transform(features))
        elif isinstance(self.counter, LobeCounter):
            lines = self.counter.lobe_map_.lines(X)
            features = self.counter.lobe_map_.from_lines(lines)
        elif self.domain is not None:
            features = features_seen(self.counter, X)
        learned = getattr(deciding, "dependence_", None)
        proba = np.asarray(deciding.predict_proba(seen))
        return proba, 1.0 if learned is None else learned, features, lines

    def _doubted(self, recording: Recording, windows: WindowSet, turning: Turning | None) -> str:
        """Return why the speed of the recording is doubted, or not one of training; else empty."""
        if turning is None:
            return "" if recording.angle is not None else self._another_speed(windows.X)
        if turning.doubt:
            return turning.doubt
        low, high = self.card["speeds_rpm"]
        rpm = 60 * turning.speed_hz
        if low * (1 - _SPEED_MARGIN) <= rpm <= high * (1 + _SPEED_MARGIN):
            return ""
        return f"it turns at {rpm:.5g} RPM, but the model was trained at {_range_text((low, high))} RPM"

    def _refusals(
        self, X: Float, outside: NDArray[np.bool_], doubt: str, faults: Sequence[str]
    ) -> tuple[str, list[str]]:
        """Return why the recording is refused, and why each window is; empty where it is not."""
        # A faulty signal explains that the speed is not found, a wrong speed that windows lie outside.
        if doubt and sum(map(bool, faults)) <= len(X) / 2:
            return doubt, [doubt] * len(X)
        empty = np.zeros(len(X), dtype=bool)
        if hasattr(self.counter, "predict_set"):
            empty = ~self.counter.predict_set(X).any(axis=1)
        unknown = np.select([outside, empty], [OUTSIDE, NO_CLASS], "").tolist()
        reasons = [fault or one for fault, one in zip(faults, unknown, strict=True)]
        return most_frequent(reasons) if sum(map(bool, reasons)) > len(X) / 2 else "", reasons

    def _another_speed(self, X: Float) -> str:
        """Return why the torque cannot come from the model's speed; empty if there is no evidence."""
        assert self.input_speed_hz is not None
        assert self.sampling_rate is not None
        first = self.counter[0] if isinstance(self.counter, Pipeline) else None
        searched = first.speed_tolerance if isinstance(first, LobeMap) else 0.0
        tolerance = max(SPEED_TOLERANCE, searched)
        speed = other_speed(X, self.sampling_rate, self.input_speed_hz, tolerance, self.n_lobes)
        if speed is None:
            return ""
        return (
            f"its torque repeats as lobes at another speed would, such as {60 * speed:.0f} RPM, rather than "
            f"at the model's {60 * self.input_speed_hz:.0f} RPM"
        )

    def _distances(self, X: Float, features: Float | None) -> Float:
        """Return the distance of each window in units of the largest inside; NaN without a domain."""
        if self.domain is None or features is None:
            return np.full(len(X), np.nan)
        largest = max(self.domain.threshold_, np.finfo(float).tiny)
        return np.asarray(self.domain.distance(features) / largest)

    def _lobe_probability(
        self, windows: WindowSet, lines: LobeLines | None, absolute: bool, used: NDArray[np.bool_]
    ) -> Float:
        """Return the mean probability of each lobe, numbered as on the disc or from the first sample."""
        assert self.locator is not None
        if lines is None:
            lines = self.locator.lobe_map_.lines(windows.X)
        if absolute:
            passage = passage_of_lobe_zero(windows.start_angle, self.n_lobes)
            return np.asarray(self.locator._from_lines(lines, passage)[used].mean(axis=0))
        # Windows are aligned by the turns between them. Where between two lobes the recording begins is
        # unknown: take the place with the most decided answer.
        again = -lobe_frequency(1.0, self.n_lobes) * _turned(windows, lines.input_speed_hz)
        begins = np.arange(_BEGINNINGS)[:, np.newaxis] / (_BEGINNINGS * self.n_lobes) + again
        shares = self.locator._from_lines(lines.repeated(_BEGINNINGS), begins.ravel())
        answers = shares.reshape(_BEGINNINGS, len(windows), -1)[:, used].mean(axis=1)
        return np.asarray(answers[np.abs(answers - 0.5).sum(axis=1).argmax()])


def _range(values: Sequence[float]) -> list[float] | None:
    """Return the least and the largest value; None of none."""
    return [float(min(values)), float(max(values))] if values else None


def _range_text(ends: Sequence[float]) -> str:
    low, high = (f"{end:.4g}" for end in ends)
    return low if low == high else f"{low} to {high}"


def _stops(windows: WindowSet, recording: Recording, turning: Turning | None) -> Float:
    """Return the ends of the windows in s."""
    n_samples = windows.X.shape[1]
    if turning is None:
        return np.asarray(windows.start_s + n_samples / windows.sampling_rate)
    turned = 2 * np.pi * n_samples / windows.sampling_rate
    return turning.times(windows.start_angle + turned, recording.sampling_rate)


def _fitted(
    windows: WindowSet, made_for: dict[str, Any], protocol: Protocol | None
) -> tuple[BaseEstimator, LobeLocator | LobeCounter | None, dict[str, Any] | None, Float]:
    """Fit counter and locator (if worn lobes are known); return them, cross-validated scores and features."""
    member = windows.recording if windows.groups is None else windows.groups
    n_lobes = made_for["n_lobes"]
    worn = windows.worn_table(n_lobes)
    passage = None if worn is None else passage_of_lobe_zero(windows.start_angle, n_lobes)
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


def _turned(windows: WindowSet, speed_hz: Float) -> Float:
    """Return the input turns from the start of a recording's first window to the start of each."""
    if np.isfinite(windows.start_angle).all():
        return np.asarray((windows.start_angle - windows.start_angle[0]) / (2 * np.pi))
    between = np.diff(windows.start_s) * (speed_hz[1:] + speed_hz[:-1]) / 2
    return np.concatenate([[0.0], np.cumsum(between)])


def _any_apart(worn: NDArray[np.bool_]) -> bool:
    """Return True if the worn lobes of any window are more than one row of neighbours."""
    return bool(((worn & ~np.roll(worn, 1, axis=1)).sum(axis=1) > 1).any())
