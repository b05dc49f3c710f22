"""What counters said of windows that they had not seen, in scores with intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator
from sklearn.metrics import confusion_matrix

from cyclofeat.counting._folds import Float, Int, aligned_proba, shares
from cyclofeat.counting._protocols import Windows
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


@dataclass
class Answers:
    """What counters said of windows that they had not seen."""

    classes: NDArray[Any]
    predictions: NDArray[Any]
    proba: Float
    sets: NDArray[np.bool_] | None = None
    exact: NDArray[np.bool_] | None = None

    @classmethod
    def empty(cls, data: Windows, classes: NDArray[Any]) -> Answers:
        return cls(classes, np.empty_like(data.y), np.full((len(data.y), classes.size), np.nan))

    def enter(self, fitted: BaseEstimator, data: Windows, test: NDArray[np.intp]) -> None:
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


def summarise(
    data: Windows,
    answers: Answers,
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
