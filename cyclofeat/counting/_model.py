"""Counter and locator for whole recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, clone
from sklearn.pipeline import Pipeline

from cyclofeat._base import plots, svg
from cyclofeat._base.card import card
from cyclofeat._base.frames import frame
from cyclofeat._base.versions import MODEL_PACKAGES, package_versions
from cyclofeat._base.words import from_1, lobes_text, number
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
from cyclofeat.counting._verdicts import disagreement, most_frequent, window_faults
from cyclofeat.features import LobeMap
from cyclofeat.recordings import Recording, Windower, WindowSet, common_n_lobes, common_speed
from cyclofeat.signal.lobes import SPEED_TOLERANCE, LobeLines, lobe_frequency
from cyclofeat.signal.windows import Float

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

# Number of places between two lobes at which a recording without an absolute angle may begin.
_BEGINNINGS = 4


@dataclass(frozen=True)
class WindowCount:
    """Answer of a model for one window of a recording.

    Attributes
    ----------
    start_s, stop_s : float
        The window in s from the recording's first sample.
    defect_count : int
        Most probable number of worn lobes in this window alone.
    probability : float
        Its probability.
    distance : float
        Distance from the training windows, in units of the largest inside; NaN where the model has no domain.
    reason : str
        Why the window is refused, else empty.
    """

    start_s: float
    stop_s: float
    defect_count: int
    probability: float
    distance: float
    reason: str


@dataclass(frozen=True)
class LobeCount:
    """Answer of a model for one recording.

    Attributes
    ----------
    defect_count : int
        Most probable number of worn lobes.
    probability : dict
        Probability of each count.
    lobes : tuple of int
        The ``defect_count`` lobes most probably worn, counted from 0; empty where the model has no locator.
    lobe_probability : tuple of float
        Probability of each lobe of being worn; empty where the model has no locator.
    absolute : bool
        Whether lobes are numbered as on the disc. Otherwise lobe 0 is the one under load at the recording's
        first sample.
    n_windows : int
        Windows that were combined.
    warnings : tuple of str
        What the reader should know.
    refused : bool
        Whether most of the windows have a faulty signal, lie outside what the model was trained on, or have
        no count that fits (where the counter is a :class:`ConformalCounter`), the windows disagree, or the
        lobe lines fit another speed: the count is then not reliable.
    reason : str
        Why refused, else empty.
    distance : float
        Median over windows of the distance from the training windows, in units of the largest distance
        inside; NaN where the model has no domain.
    windows : tuple of WindowCount
        The answer of each window.
    """

    defect_count: int
    probability: dict[int, float]
    lobes: tuple[int, ...]
    lobe_probability: tuple[float, ...] = field(repr=False)
    absolute: bool
    n_windows: int
    warnings: tuple[str, ...] = ()
    refused: bool = False
    reason: str = ""
    distance: float = float("nan")
    windows: tuple[WindowCount, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the answer of the whole recording in plain types, for JSON. Lobes count from 1.

        A refused recording has no ``defect_count``; ``refused_defect_count`` is what it would be.
        """
        return {
            "defect_count": None if self.refused else self.defect_count,
            "refused_defect_count": self.defect_count if self.refused else None,
            "probability": {str(count): value for count, value in self.probability.items()},
            "worn_lobes_from_1": from_1(self.lobes),
            "lobe_probability": list(self.lobe_probability),
            "lobes_absolute": self.absolute,
            "n_windows": self.n_windows,
            "refused": self.refused,
            "reason": self.reason,
            # JSON has no NaN
            "distance": None if np.isnan(self.distance) else self.distance,
            "warnings": list(self.warnings),
        }

    def plot(
        self, kind: Literal["counts", "lobes"] = "counts", ax: Axes | None = None, **options: Any
    ) -> Any:
        """Draw the probabilities.

        Parameters
        ----------
        kind : {"counts", "lobes"}, default="counts"
            Probability of each number of worn lobes, or of each lobe of being worn.
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        **options
            Passed on to ``Axes.bar``.

        Returns
        -------
        cyclofeat.plotting.CountDisplay

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If there is no such kind, or the model located no lobes.
        """
        return plots.draw(self, kind, ax, **options)

    def _repr_html_(self) -> str:
        answer = number(self.defect_count, "worn lobe") if self.defect_count else "No worn lobe"
        numbered = "as on the disc, from 1" if self.absolute else "from 1, the lobe under load at the start"
        distance = None if np.isnan(self.distance) else f"{self.distance:.2f} (1: edge of the training)"
        rows = {
            "probability": f"{self.probability[self.defect_count]:.3f}",
            "lobes": f"{lobes_text(self.lobes)} (numbered {numbered})" if self.lobes else None,
            "combined": number(self.n_windows, "window"),
            "distance": distance,
            "refused": self.reason,
        }
        drawn = [
            svg.columns(
                self.probability.values(), [*self.probability], "Probability of each number of worn lobes",
                marked={self.defect_count},
            ),
            svg.disc(self.lobe_probability, self.lobes, "Probability of each lobe of being worn")
            if self.lobe_probability
            else "",
        ]  # fmt: skip
        return card(
            f"Refused, not reliable: {answer}" if self.refused else answer, rows,
            pictures=drawn, notes=self.warnings, code='count.plot("lobes")' if self.lobes else "count.plot()",
        )  # fmt: skip


def counts_frame(counts: Mapping[str, LobeCount] | Sequence[LobeCount]) -> pd.DataFrame:
    """Return the answers for many recordings as a data frame.

    Parameters
    ----------
    counts : mapping from str to LobeCount, or sequence of LobeCount
        Answers, by the names of their recordings.

    Returns
    -------
    pandas.DataFrame
        One row per recording, its name as the index: ``defect_count`` and ``refused_defect_count`` (one of
        them missing, see :meth:`LobeCount.to_dict`), ``probability`` (of that count),
        ``lobes`` (counted from 0), ``lobes_absolute``, ``n_windows``, ``refused``, ``reason``, ``distance``,
        ``warnings``, and ``probability_<count>`` of each count.

    Raises
    ------
    ImportError
        If pandas is not installed.

    Examples
    --------
    >>> answer = LobeCount(1, {0: 0.1, 1: 0.9}, (3,), (), False, 2)
    >>> counts_frame({"a.csv": answer})[["defect_count", "probability", "lobes"]]
               defect_count  probability lobes
    recording
    a.csv                 1          0.9  (3,)
    """
    names = [*counts] if isinstance(counts, Mapping) else range(len(counts))
    given = counts.values() if isinstance(counts, Mapping) else counts
    rows = []
    for one in given:
        of_counts = {f"probability_{count}": p for count, p in one.probability.items()}
        row = one.to_dict() | {"probability": one.probability[one.defect_count], "lobes": one.lobes}
        rows.append({name: row[name] for name in row if name != "lobe_probability"} | of_counts)
    made = frame(rows)
    if rows:
        made = made.astype({"defect_count": "Int64", "refused_defect_count": "Int64"})
    made.index = frame({"recording": names}).set_index("recording").index
    return made


@dataclass(frozen=True)
class LobeModel:
    """Counter and locator of worn lobes, for recordings of one sampling rate and nominal speed.

    Build it with :meth:`train`, or of a counter that is fitted already with :meth:`of_counter`.

    Attributes
    ----------
    counter : estimator
        Fitted classifier of windows, classes are defect counts. That of :meth:`train` has the steps
        ``"lobe_map"`` and ``"trees"``, the latter in a :class:`GroupCalibratedCounter`, or is a
        :class:`LobeCounter`.
    locator : LobeLocator, LobeCounter or None
        Fitted; the counter itself where that is a :class:`LobeCounter`. None where the training recordings
        did not state angle and worn lobes.
    sampling_rate, input_speed_hz : float
        In Hz, and nominal in turns per second.
    n_lobes : int
    card : dict
        Training data and versions.
    domain : TrainingDomain or None
        Fitted to the features that the counter sees; None where there was one assembly only.
    """

    counter: BaseEstimator
    locator: LobeLocator | LobeCounter | None
    sampling_rate: float
    input_speed_hz: float
    n_lobes: int
    card: dict[str, Any] = field(repr=False)
    domain: TrainingDomain | None = None

    @classmethod
    def train(
        cls,
        recordings: Sequence[Recording],
        *,
        input_speed_hz: float | None = None,
        random_state: int = 0,
        n_splits: int = 5,
        n_trees: int = 300,
        description: str = "",
    ) -> LobeModel:
        """Train on labelled recordings.

        Where they state which lobes are worn and hold sets that are no row of neighbours, the counter is a
        :class:`LobeCounter`, which counts lobe by lobe; else trees on the lobe map.

        Parameters
        ----------
        recordings : sequence of Recording
            With ``defect_count``; where all of them also state ``worn_lobes`` and an absolute angle, the
            model learns to locate lobes too. Probabilities are calibrated on held-out assemblies; recordings
            are one assembly each if they do not all state theirs.
        input_speed_hz : float, optional
            Nominal input speed; default the median of those that the recordings state.
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
            Where recordings lack a defect count, hold one class only, cannot be cut into windows, or state
            another number of lobes or a speed more than 1.5 % beside the nominal one.
        """
        n_lobes = common_n_lobes(recordings)
        speed = common_speed(recordings, input_speed_hz)
        windows = Windower(input_speed_hz=speed, reduction=n_lobes).windows(recordings)
        if windows.y is None:
            raise ValueError("recordings must all state their defect_count to train on, some do not")
        assert speed is not None  # otherwise the windower raises
        if np.unique(windows.y).size < 2:
            raise ValueError(f"recordings must hold at least two defect counts, got {windows.y[0]} only")
        made_for = {
            "input_speed_hz": speed, "n_lobes": n_lobes, "n_trees": n_trees, "random_state": random_state,
        }  # fmt: skip
        protocol = Protocol(n_splits=n_splits, random_state=random_state) if n_splits else None
        counter, locator, scores, features = _fitted(windows, made_for, protocol)
        member = windows.recording if windows.groups is None else windows.groups
        domain = None
        if np.unique(member).size > 1:
            domain = TrainingDomain(random_state=random_state).fit(features, windows.y, groups=member)
        card = {
            "description": description,
            "n_recordings": len(recordings),
            "n_windows": len(windows),
            "sources": sorted({str(r.source) for r in recordings}),
            "assemblies": None if windows.groups is None else np.unique(windows.groups).tolist(),
            "classes": np.unique(windows.y).tolist(),
            "calibrated": fewest_assemblies(member, windows.y) > 1,
            "cross_validation": scores,
            "versions": package_versions(*MODEL_PACKAGES),
        }
        return cls(counter, locator, windows.sampling_rate, speed, n_lobes, card, domain)

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
        return cls(counter, None, sampling_rate, input_speed_hz, n_lobes, card, domain)

    def _repr_html_(self) -> str:
        stated, scores = self.card, self.card.get("cross_validation")
        rows = {
            "for recordings at": f"{self.sampling_rate:g} Hz and {60 * self.input_speed_hz:g} RPM",
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

    def check(self, recording: Recording) -> None:
        """Raise ``ValueError`` if the recording's sampling rate, lobes or speed do not suit the model."""
        # 15 is the default of recordings that do not state their lobes.
        if recording.n_lobes not in (15, self.n_lobes):
            raise ValueError(
                f"n_lobes of the recording is {recording.n_lobes}, but the model was trained for discs of "
                f"{self.n_lobes}: train a model for them"
            )
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

    def count(self, recording: Recording) -> LobeCount:
        """Count and locate the worn lobes of one recording.

        The probabilities of windows of one output turn are combined by :func:`predict_recordings`; a counter
        without a learned dependence is taken to be no surer of many windows than of one. Windows whose signal
        has a fault, or that lie outside the training domain, are left out. The recording is refused where
        more than half of its windows are, where the windows disagree, or where, without a tachometer, its
        lobe lines are those of another speed; it still has a count.

        Raises
        ------
        ValueError
            Where the recording does not suit the model or is shorter than one output turn.
        """
        self.check(recording)
        windows = Windower(input_speed_hz=self.input_speed_hz, reduction=self.n_lobes).windows([recording])
        proba, dependence, features, lines = self._window_answers(windows.X)
        classes = np.asarray(self.counter.classes_)
        notes = []
        if recording.input_speed_hz is None:
            notes.append(
                f"no speed stated: taken as {60 * self.input_speed_hz:g} RPM, as the model was trained"
            )
        distances = self._distances(windows.X, features)
        distance, n_outside = float(np.median(distances)), int(np.sum(distances > 1))
        stops = windows.start_s + windows.X.shape[1] / windows.sampling_rate
        faults = window_faults(recording, windows, stops, self.n_lobes)
        has_angle = recording.angle is not None
        reason, reasons = self._refusals(windows.X, distances > 1, faults, has_angle=has_angle)
        reason = reason or disagreement(proba, faults)
        used = np.array([not one for one in reasons])
        used |= not used.any()
        probability = combine_proba(proba[used], np.zeros(used.sum(), dtype=int), dependence)[0]
        count = int(classes[probability.argmax()])
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

    def _refusals(
        self, X: Float, outside: NDArray[np.bool_], faults: Sequence[str], *, has_angle: bool
    ) -> tuple[str, list[str]]:
        """Return why the recording is refused, and why each window is; empty where it is not."""
        # First the speed: a wrong one explains windows outside the domain.
        if not has_angle and (reason := self._another_speed(X)):
            return reason, [reason] * len(X)
        empty = np.zeros(len(X), dtype=bool)
        if hasattr(self.counter, "predict_set"):
            empty = ~self.counter.predict_set(X).any(axis=1)
        unknown = np.select([outside, empty], [OUTSIDE, NO_CLASS], "").tolist()
        reasons = [fault or one for fault, one in zip(faults, unknown, strict=True)]
        return most_frequent(reasons) if sum(map(bool, reasons)) > len(X) / 2 else "", reasons

    def _another_speed(self, X: Float) -> str:
        """Return why the torque cannot come from the model's speed; empty if there is no evidence."""
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
            windows.sampling_rate, made_for["input_speed_hz"], n_lobes, random_state=random_state
        )
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
