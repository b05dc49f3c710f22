"""Evaluation that keeps all windows of one assembly on the same side of every split."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

import joblib
import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, clone
from sklearn.metrics import confusion_matrix
from sklearn.model_selection import StratifiedGroupKFold
from sklearn.utils import check_array, check_consistent_length
from sklearn.utils.validation import has_fit_parameter

from cyclofeat.counting._folds import Float, Folds, Int, aligned_proba, of_windows, shares
from cyclofeat.counting._scores import (
    at_the_ends,
    calibration_sums,
    draws,
    expected_calibration_error,
    interval,
    macro_f1,
    ratio,
    rule_of_three,
    sums_by_assembly,
)

Interval = tuple[float, float]

PROTOCOLS = ("stratified", "leave-one-assembly-out", "leave-one-condition-out")
_LEAK = (
    "groups must name the assembly of every window, got None: windows of one recording look alike for "
    "reasons that have nothing to do with wear, so a split that puts them on both sides measures how well "
    "the counter recognises the recording. Pass the groups that Windower.transform returns"
)


@dataclass(frozen=True)
class Evaluation:
    """Result of :func:`evaluate`.

    Scores that the counter or the data do not allow are None. Each has an interval: percentiles of a
    bootstrap over assemblies at ``confidence``; where a share is 0 or 1 (and the bootstrap would know no
    spread), the rule of three: none among n assemblies is compatible with a share of up to about 3/n.

    Attributes
    ----------
    accuracy, mean_absolute_error : float
        Over all windows, each predicted by a counter that never saw its assembly.
    accuracy_interval, mean_absolute_error_interval : tuple of float
    confusion : ndarray of int, shape (n_classes, n_classes)
        Windows of true class (row) predicted as class (column).
    confusion_interval : ndarray, shape (2, n_classes, n_classes)
        Lower and upper end of the bootstrap interval of the share of a true class predicted as each class.
    classes : ndarray, shape (n_classes,)
    groups : ndarray, shape (n_groups,)
        Assemblies.
    group_accuracy : ndarray, shape (n_groups,)
        Accuracy within each assembly.
    predictions : ndarray, shape (n_windows,)
    confidence : float
    macro_f1 : float
        Mean over classes of the harmonic mean of precision and recall.
    macro_f1_interval : tuple of float
    exact_lobes : float or None
        Share of windows whose set of worn lobes is exactly right; needs ``worn`` and a counter that has
        ``predict_lobes``.
    exact_lobes_interval : tuple of float or None
    calibration_error : float or None
        Expected calibration error of the predicted class: mean over ten bins of the probability of
        |probability - accuracy|, every assembly with the same weight. Never negative, so that a perfectly
        calibrated counter has one too, the larger the fewer the assemblies. Needs ``predict_proba``.
    calibration_error_interval : tuple of float or None
    coverage : float or None
        Share of windows whose set of counts holds the true one; needs ``predict_set``. Refusals are misses.
    coverage_interval : tuple of float or None
    class_coverage : ndarray, shape (n_classes,), or None
        The same of each class.
    set_size : float or None
        Mean number of counts in a set that is not empty.
    refused : float or None
        Share of empty sets.
    by_condition : dict or None
        Accuracy of each condition.
    probabilities : ndarray, shape (n_windows, n_classes), or None
    protocol : str
    """

    accuracy: float
    mean_absolute_error: float
    accuracy_interval: Interval
    mean_absolute_error_interval: Interval
    confusion: NDArray[np.int64] = field(repr=False)
    confusion_interval: NDArray[np.float64] = field(repr=False)
    classes: NDArray[Any] = field(repr=False)
    groups: NDArray[Any] = field(repr=False)
    group_accuracy: NDArray[np.float64] = field(repr=False)
    predictions: NDArray[Any] = field(repr=False)
    confidence: float = 0.95
    macro_f1: float = float("nan")
    macro_f1_interval: Interval = (float("nan"), float("nan"))
    exact_lobes: float | None = None
    exact_lobes_interval: Interval | None = None
    calibration_error: float | None = None
    calibration_error_interval: Interval | None = None
    coverage: float | None = None
    coverage_interval: Interval | None = None
    class_coverage: NDArray[np.float64] | None = field(default=None, repr=False)
    set_size: float | None = None
    refused: float | None = None
    by_condition: dict[Any, float] | None = None
    probabilities: NDArray[np.float64] | None = field(default=None, repr=False)
    protocol: str = "stratified"

    def __str__(self) -> str:
        return score_text(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """The result in plain types, for JSON; scores that there are not are left out."""
        result: dict[str, Any] = {
            "accuracy": self.accuracy,
            "accuracy_interval": list(self.accuracy_interval),
            "mean_absolute_error": self.mean_absolute_error,
            "mean_absolute_error_interval": list(self.mean_absolute_error_interval),
            "macro_f1": self.macro_f1,
            "macro_f1_interval": list(self.macro_f1_interval),
            "confidence": self.confidence,
            "classes": self.classes.tolist(),
            "confusion": self.confusion.tolist(),
            "n_windows": int(self.predictions.size),
            "n_assemblies": int(self.groups.size),
            "protocol": self.protocol,
        }
        for name in ("exact_lobes", "calibration_error", "coverage"):
            value, limits = getattr(self, name), getattr(self, f"{name}_interval")
            if value is not None:
                result |= {name: value, f"{name}_interval": list(limits)}
        if self.coverage is not None and self.class_coverage is not None:
            result |= {
                "class_coverage": self.class_coverage.tolist(),
                "set_size": self.set_size,
                "refused": self.refused,
            }
        if self.by_condition is not None:
            result["by_condition"] = {str(name): value for name, value in self.by_condition.items()}
        return result


def score_text(scores: Mapping[str, Any]) -> str:
    """One line for people from :meth:`Evaluation.to_dict`."""
    low, high = scores["accuracy_interval"]
    return (
        f"accuracy {scores['accuracy']:.3f} [{low:.3f}, {high:.3f}], "
        f"mean absolute error {scores['mean_absolute_error']:.3f}"
    )


def evaluate(
    counter: BaseEstimator,
    X: ArrayLike,
    y: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    protocol: str = "stratified",
    conditions: ArrayLike | None = None,
    training: tuple[Any, ...] | None = None,
    worn: ArrayLike | None = None,
    passage: ArrayLike | None = None,
    n_splits: int = 5,
    confidence: float = 0.95,
    n_bootstrap: int = 1000,
    random_state: int = 0,
    n_jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Test a counter on assemblies that it has not seen.

    Parameters
    ----------
    counter : estimator
        Classifier of windows; cloned for each fold, never changed. One whose ``fit`` takes ``groups`` gets
        those of the training windows.
    X : array-like, shape (n_windows, n_samples)
        Windows of torque in Nm.
    y : array-like of int, shape (n_windows,)
        Defect count of each window.
    groups : array-like, shape (n_windows,)
        Assembly of each window: several recordings of one assembly are one group.
    protocol : {"stratified", "leave-one-assembly-out", "leave-one-condition-out"}
        What is held out in turn: a share of the assemblies of every class
        (``StratifiedGroupKFold(shuffle=True)``); one assembly; all windows of one condition - the training
        windows are then those of other conditions *and* other assemblies.
    conditions : array-like, shape (n_windows,), optional
        Load, speed, material or whatever the windows differ in beside the count. Needed to leave one out;
        given with another protocol, the accuracy of each condition is reported.
    training : tuple of array-like, optional
        ``(X, y, groups)`` of other windows to train on once - simulated ones, say - and to test on all of
        ``X``. ``protocol`` is then "train-test". With ``worn`` and ``passage``: five arrays.
    worn : array-like of bool, shape (n_windows, n_lobes), optional
        Worn lobes, for a counter that finds them; together with ``passage``.
    passage : array-like, shape (n_windows,), optional
        When lobe 0 passes, see :func:`passage_of_lobe_zero`.
    n_splits : int
        Number of folds of the stratified protocol.
    confidence : float
        Coverage of the bootstrap intervals.
    n_bootstrap : int
        Number of bootstrap draws over assemblies.
    random_state : int
        Seed of folds and bootstrap.
    n_jobs : int, optional
        Processes that fit folds side by side, as in joblib: None is one, -1 all processors.
    progress : callable, optional
        Called as ``progress(folds_done, n_folds)``.

    Returns
    -------
    Evaluation

    Raises
    ------
    ValueError
        Without groups; where a class has fewer assemblies than folds, a condition holds a count that no other
        has, or training and test share an assembly; where counts are not numbers; where windows are not
        finite, all constant, or of different lengths than labels or groups.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.naive_bayes import GaussianNB
    >>> random = np.random.default_rng(0)
    >>> assembly = np.repeat(np.arange(40), 2)
    >>> X = (assembly % 2)[:, np.newaxis] + random.normal(scale=0.1, size=(80, 3))
    >>> print(evaluate(GaussianNB(), X, assembly % 2, assembly))
    accuracy 1.000 [0.928, 1.000], mean absolute error 0.000
    """
    data = _Windows.checked(X, y, groups, worn, passage)
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must lie between 0 and 1, got {confidence!r}")
    if n_splits < 2:
        raise ValueError(f"n_splits must be at least 2, got {n_splits!r}")
    if protocol not in PROTOCOLS:
        raise ValueError(f"protocol must be one of {PROTOCOLS}, got {protocol!r}")
    named = None if conditions is None else of_windows("conditions", conditions, len(data.y))
    classes = np.unique(data.y)
    answers = _Answers.empty(data, classes)
    if training is not None:
        protocol = "train-test"
        trained_on = _training(training, data)
        fitted = _fit(counter, trained_on, np.arange(len(trained_on.y)))
        answers.enter(fitted, data, np.arange(len(data.y)))
        classes = answers.classes
        if progress is not None:
            progress(1, 1)
    else:
        folds = _folds(protocol, data, named, n_splits, random_state)
        fits = joblib.Parallel(n_jobs=n_jobs, return_as="generator")(
            joblib.delayed(_fit)(counter, data, train) for train, _ in folds
        )
        for done, (fitted, (_, test)) in enumerate(zip(fits, folds, strict=True), start=1):
            answers.enter(fitted, data, test)
            if progress is not None:
                progress(done, len(folds))
    return _summarise(data, answers, named, protocol, confidence, n_bootstrap, random_state)


def learning_curve(
    counter: BaseEstimator,
    X: ArrayLike,
    y: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    n_assemblies: Sequence[int] = (2, 4, 8, 16),
    n_splits: int = 5,
    confidence: float = 0.95,
    n_bootstrap: int = 1000,
    random_state: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[int, Evaluation]:
    """Scores against the number of training assemblies per class, on the same held-out assemblies.

    Parameters
    ----------
    counter, X, y, groups, n_splits, confidence, n_bootstrap, random_state
        As in :func:`evaluate`.
    n_assemblies : sequence of int
        Training assemblies of each class. Smaller sets are parts of larger ones.
    progress : callable, optional
        Called as ``progress(fits_done, n_fits)``.

    Returns
    -------
    dict of int to Evaluation

    Raises
    ------
    ValueError
        As :func:`evaluate`; also if a fold leaves a class fewer training assemblies than asked for.
    """
    data = _Windows.checked(X, y, groups, None, None)
    folds = _folds("stratified", data, None, n_splits, random_state)
    sizes = sorted(set(n_assemblies))
    if not sizes or sizes[0] < 1:
        raise ValueError(f"n_assemblies must hold whole numbers from 1 on, got {n_assemblies!r}")
    curve, done = {}, 0
    for size in sizes:
        answers = _Answers.empty(data, np.unique(data.y))
        for number, (train, test) in enumerate(folds):
            random = np.random.default_rng([random_state, number])
            kept = []
            for label in np.unique(data.y):
                of_class = train[data.y[train] == label]
                names = random.permutation(np.unique(data.groups[of_class]))
                if names.size < size:
                    raise ValueError(
                        f"n_assemblies asks for {size} training assemblies per class, but class {label} has "
                        f"{names.size} in a fold: ask for fewer, or raise n_splits"
                    )
                kept.append(of_class[np.isin(data.groups[of_class], names[:size])])
            answers.enter(_fit(counter, data, np.concatenate(kept)), data, test)
            done += 1
            if progress is not None:
                progress(done, len(sizes) * len(folds))
        curve[int(size)] = _summarise(
            data, answers, None, "stratified", confidence, n_bootstrap, random_state
        )
    return curve


def noise_sweep(
    counter: BaseEstimator,
    X: ArrayLike,
    y: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    noise_nm: Sequence[float] = (0.05, 0.2, 0.5, 1.0, 2.0),
    training_noise_nm: float | str = "same",
    worn: ArrayLike | None = None,
    passage: ArrayLike | None = None,
    n_splits: int = 5,
    confidence: float = 0.95,
    n_bootstrap: int = 1000,
    random_state: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[float, Evaluation]:
    """Scores against white noise added to the windows, on the same folds.

    Parameters
    ----------
    counter, X, y, groups, worn, passage, n_splits, confidence, n_bootstrap, random_state
        As in :func:`evaluate`. ``X`` holds noise of its own already: pass windows with little of it.
    noise_nm : sequence of float
        Standard deviations of the noise added, in Nm.
    training_noise_nm : float or "same"
        Standard deviation of the noise added to training windows, in Nm: that of the test windows, or a fixed
        one for a counter that does not know how noisy its windows will be.
    progress : callable, optional
        Called as ``progress(fits_done, n_fits)``.

    Returns
    -------
    dict of float to Evaluation

    Raises
    ------
    ValueError
        As :func:`evaluate`; also if noise is negative or not finite.
    """
    data = _Windows.checked(X, y, groups, worn, passage)
    if isinstance(training_noise_nm, str) and training_noise_nm != "same":
        raise ValueError(f"training_noise_nm must be a number or 'same', got {training_noise_nm!r}")
    fixed = None if isinstance(training_noise_nm, str) else training_noise_nm
    for value in [*noise_nm, *([] if fixed is None else [fixed])]:
        if not (np.isfinite(value) and value >= 0):
            raise ValueError(f"noise_nm must hold finite numbers from 0 on, got {value!r}")
    folds = _folds("stratified", data, None, n_splits, random_state)
    # One pattern of noise, scaled: what changes from level to level is the level alone.
    test_noise, train_noise = (
        np.random.default_rng([random_state, k]).standard_normal(data.X.shape) for k in (1, 2)
    )
    sweep, done = {}, 0
    for level in noise_nm:
        heard = data.with_torque(data.X + level * test_noise)
        trained = heard if fixed is None else data.with_torque(data.X + fixed * train_noise)
        answers = _Answers.empty(data, np.unique(data.y))
        for train, test in folds:
            answers.enter(_fit(counter, trained, train), heard, test)
            done += 1
            if progress is not None:
                progress(done, len(noise_nm) * len(folds))
        sweep[float(level)] = _summarise(
            heard, answers, None, "stratified", confidence, n_bootstrap, random_state
        )
    return sweep


@dataclass(frozen=True)
class _Windows:
    """Checked windows with their labels."""

    X: NDArray[Any]
    y: NDArray[Any]
    groups: NDArray[Any]
    worn: NDArray[np.bool_] | None
    passage: Float | None

    @classmethod
    def checked(
        cls,
        X: ArrayLike,
        y: ArrayLike,
        groups: ArrayLike | None,
        worn: ArrayLike | None,
        passage: ArrayLike | None,
    ) -> _Windows:
        if groups is None:
            raise ValueError(_LEAK)
        windows: NDArray[Any] = check_array(X, dtype=[np.float64, np.float32], input_name="X")
        labels, assemblies = np.asarray(y), np.asarray(groups)
        for name, values in (("y", labels), ("groups", assemblies)):
            if values.ndim != 1:
                raise ValueError(f"{name} must hold one value per window, got shape {values.shape}")
        check_consistent_length(windows, labels, assemblies)
        if not all(isinstance(label, Real) for label in labels.tolist()):
            raise ValueError(f"y must hold defect counts (numbers), got {labels.tolist()[0]!r}")
        constant = np.flatnonzero(windows.max(axis=1) == windows.min(axis=1))
        if constant.size and windows.shape[1] > 1:  # a single feature may well stand in place of a window
            raise ValueError(f"X must hold windows with variation, but window {constant[0]} is constant")
        if (worn is None) != (passage is None):
            raise ValueError("worn and passage must be given together: lobes are numbered by the passage")
        if worn is None or passage is None:
            return cls(windows, labels, assemblies, None, None)
        marks = np.asarray(worn, dtype=bool)
        if marks.ndim != 2 or len(marks) != len(windows):
            raise ValueError(
                f"worn must have shape (n_windows, n_lobes) with {len(windows)} windows, got {marks.shape}"
            )
        begins = of_windows("passage", passage, len(windows)).astype(float)
        return cls(windows, labels, assemblies, marks, begins)

    def with_torque(self, X: NDArray[Any]) -> _Windows:
        return _Windows(X, self.y, self.groups, self.worn, self.passage)


@dataclass
class _Answers:
    """What counters said of windows that they had not seen."""

    classes: NDArray[Any]
    predictions: NDArray[Any]
    proba: Float
    sets: NDArray[np.bool_] | None = None
    exact: NDArray[np.bool_] | None = None

    @classmethod
    def empty(cls, data: _Windows, classes: NDArray[Any]) -> _Answers:
        return cls(classes, np.empty_like(data.y), np.full((len(data.y), classes.size), np.nan))

    def enter(self, fitted: BaseEstimator, data: _Windows, test: NDArray[np.intp]) -> None:
        """Ask a fitted counter about some windows and keep the answers."""
        X = data.X[test]
        self.predictions[test] = fitted.predict(X)
        known = getattr(fitted, "classes_", None)
        if known is not None and not np.isin(known, self.classes).all():
            # trained elsewhere, on counts that the test does not hold
            self._widen(np.union1d(known, self.classes))
        if hasattr(fitted, "predict_proba"):
            self.proba[test] = aligned_proba(fitted, X, self.classes)
        if hasattr(fitted, "predict_set"):
            if self.sets is None:
                self.sets = np.zeros(self.proba.shape, dtype=bool)
            columns = np.searchsorted(self.classes, fitted.classes_)
            self.sets[np.ix_(test, columns)] = fitted.predict_set(X)
        if data.worn is not None and data.passage is not None and hasattr(fitted, "predict_lobes"):
            if self.exact is None:
                self.exact = np.zeros(len(data.y), dtype=bool)
            found = fitted.predict_lobes(X, data.passage[test])
            self.exact[test] = np.all(found == data.worn[test], axis=1)

    def _widen(self, classes: NDArray[Any]) -> None:
        proba = np.zeros((len(self.proba), classes.size))
        proba[:, np.searchsorted(classes, self.classes)] = self.proba
        self.classes, self.proba = classes, proba


def _fit(counter: BaseEstimator, data: _Windows, train: NDArray[np.intp]) -> BaseEstimator:
    """A copy of the counter fitted to some windows, with what else its ``fit`` takes."""
    fitted = clone(counter)
    extra = {"groups": data.groups, "worn": data.worn, "passage": data.passage}
    taken = {
        name: values[train]
        for name, values in extra.items()
        if values is not None and has_fit_parameter(fitted, name)
    }
    return fitted.fit(data.X[train], data.y[train], **taken)


def _training(training: tuple[Any, ...], data: _Windows) -> _Windows:
    if not isinstance(training, tuple) or len(training) not in (3, 5):
        raise ValueError(
            "training must be a tuple (X, y, groups), or (X, y, groups, worn, passage), got "
            f"{type(training).__name__}" + (f" of {len(training)}" if isinstance(training, tuple) else "")
        )
    windows = _Windows.checked(*(training if len(training) == 5 else (*training, None, None)))
    both = np.intersect1d(windows.groups, data.groups)
    if both.size:
        raise ValueError(
            f"training and test must not share assemblies, but both hold {both.tolist()[0]!r}: what the "
            "counter remembers of an assembly is no measure of what it says of others"
        )
    return windows


def _folds(
    protocol: str, data: _Windows, conditions: NDArray[Any] | None, n_splits: int, random_state: int
) -> Folds:
    if protocol == "leave-one-condition-out":
        return _by_condition(data, conditions)
    least = n_splits if protocol == "stratified" else 2
    for label in np.unique(data.y):
        n_assemblies = np.unique(data.groups[data.y == label]).size
        if n_assemblies < least:
            fewer = f"n_splits={n_splits}" if protocol == "stratified" else f"the 2 that {protocol} needs"
            raise ValueError(
                f"class {label} has {n_assemblies} assemblies, fewer than {fewer}: with one "
                "recording per class no split can estimate an accuracy; record more or lower n_splits"
            )
    if protocol == "leave-one-assembly-out":
        held_out = (data.groups == name for name in np.unique(data.groups))
        return [(np.flatnonzero(~rows), np.flatnonzero(rows)) for rows in held_out]
    splitter = StratifiedGroupKFold(n_splits=n_splits, shuffle=True, random_state=random_state)
    return list(splitter.split(data.X, data.y, data.groups))


def _by_condition(data: _Windows, conditions: NDArray[Any] | None) -> Folds:
    if conditions is None:
        raise ValueError("conditions must name the condition of every window to leave one out, got None")
    names = np.unique(conditions)
    if names.size < 2:
        raise ValueError(f"conditions must name at least two conditions, got {names.tolist()} only")
    folds: Folds = []
    for name in names:
        test = conditions == name
        train = ~test & ~np.isin(data.groups, data.groups[test])
        missing = np.setdiff1d(data.y[test], data.y[train])
        if missing.size:
            raise ValueError(
                f"condition {name} holds count {missing[0]}, which no assembly of another condition has: "
                "record every count in at least two conditions, with an assembly of its own in each"
            )
        folds.append((np.flatnonzero(train), np.flatnonzero(test)))
    return folds


def _summarise(
    data: _Windows,
    answers: _Answers,
    conditions: NDArray[Any] | None,
    protocol: str,
    confidence: float,
    n_bootstrap: int,
    random_state: int,
) -> Evaluation:
    labels, predictions, classes = data.y, answers.predictions, answers.classes
    groups, member = np.unique(data.groups, return_inverse=True)
    drawn = draws(groups.size, n_bootstrap, random_state)
    right = labels == predictions

    def share(hits: NDArray[np.bool_]) -> tuple[float, Interval]:
        """A share of windows; at 0 or 1 with the rule of three over assemblies."""
        sums = sums_by_assembly(np.column_stack([hits, np.ones(hits.size)]), member)
        value, found = interval(ratio, sums, drawn, confidence)
        return value, at_the_ends(value, found, groups.size, confidence)

    accuracy, accuracy_interval = share(right)
    # Unsigned numbers would wrap around.
    errors = np.abs(labels.astype(float) - predictions.astype(float))
    sums = sums_by_assembly(np.column_stack([errors, np.ones(errors.size)]), member)
    error, error_interval = interval(ratio, sums, drawn, confidence)
    if error == 0:  # what none wrong is compatible with, each wrong by one
        error_interval = (0.0, rule_of_three(groups.size, confidence))

    cells = np.stack(
        [
            confusion_matrix(labels[member == g], predictions[member == g], labels=classes)
            for g in range(groups.size)
        ]
    )
    size = classes.size
    flat = cells.reshape(groups.size, -1).astype(float)
    f1, f1_interval = interval(
        lambda sums: macro_f1(sums.reshape(*sums.shape[:-1], size, size)), flat, drawn, confidence
    )
    f1_interval = at_the_ends(f1, f1_interval, groups.size, confidence)
    tables = np.tensordot(drawn, cells, axes=1)
    rows = tables.sum(axis=2, keepdims=True)
    parts = np.divide(tables, rows, out=np.zeros(tables.shape), where=rows > 0)
    tail = 100 * (1 - confidence) / 2

    more: dict[str, Any] = {}
    probabilities = answers.proba if np.isfinite(answers.proba).all() else None
    if probabilities is not None:
        said = probabilities.max(axis=1)
        cal = calibration_sums(said, right, shares(member), member)
        value, limits = interval(expected_calibration_error, cal, drawn, confidence)
        more |= {"calibration_error": value, "calibration_error_interval": limits}
    if answers.exact is not None:
        value, limits = share(answers.exact)
        more |= {"exact_lobes": value, "exact_lobes_interval": limits}
    if answers.sets is not None:
        more |= _of_sets(answers.sets, np.searchsorted(classes, labels), share)
    if conditions is not None:
        more["by_condition"] = {
            name: float(right[conditions == name].mean()) for name in np.unique(conditions).tolist()
        }
    return Evaluation(
        accuracy=accuracy,
        mean_absolute_error=error,
        accuracy_interval=accuracy_interval,
        mean_absolute_error_interval=error_interval,
        confusion=cells.sum(axis=0),
        confusion_interval=np.percentile(parts, [tail, 100 - tail], axis=0),
        classes=classes,
        groups=groups,
        group_accuracy=np.bincount(member, right) / np.bincount(member),
        predictions=predictions,
        confidence=confidence,
        macro_f1=f1,
        macro_f1_interval=f1_interval,
        probabilities=probabilities,
        protocol=protocol,
        **more,
    )


def _of_sets(
    sets: NDArray[np.bool_],
    rank: Int,
    share: Callable[[NDArray[np.bool_]], tuple[float, Interval]],
) -> dict[str, Any]:
    """Scores of sets of counts."""
    covered = sets[np.arange(rank.size), rank]
    coverage, limits = share(covered)
    sizes = sets.sum(axis=1)
    by_class = [
        float(covered[rank == c].mean()) if np.any(rank == c) else np.nan for c in range(sets.shape[1])
    ]
    return {
        "coverage": coverage,
        "coverage_interval": limits,
        "class_coverage": np.array(by_class),
        "set_size": float(sizes[sizes > 0].mean()) if np.any(sizes) else 0.0,
        "refused": float(np.mean(sizes == 0)),
    }
