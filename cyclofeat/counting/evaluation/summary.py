"""Scores, with intervals, of counters on held-out windows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator

from cyclofeat._base import plots, svg
from cyclofeat._base.card import card
from cyclofeat._base.frames import frame
from cyclofeat._base.words import number
from cyclofeat.counting.evaluation.assembly_folds import Float, Int, aligned_proba
from cyclofeat.counting.evaluation.protocol import Protocol, Windows
from cyclofeat.counting.evaluation.scores import (
    N_BINS,
    at_the_ends,
    calibration_sums,
    draws,
    expected_calibration_error,
    interval,
    macro_f1,
    ratio_of_sums,
    rule_of_three,
    shares,
    sums_by_assembly,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

Interval = tuple[float, float]
Table = Literal["classes", "assemblies", "windows"]
TABLES: tuple[Table, ...] = ("classes", "assemblies", "windows")


@dataclass(frozen=True)
class Evaluation:
    """Result of :func:`evaluate`.

    Scores that the counter or the data do not allow are None. ``<score>_interval`` holds percentiles of a
    bootstrap over assemblies at ``confidence``; where a share is 0 or 1, the rule of three: none among n
    assemblies is compatible with a share of up to about 3/n.

    Attributes
    ----------
    accuracy, mean_absolute_error : float
        Over all windows, each predicted by a counter that never saw its assembly.
    confusion : ndarray of int, shape (n_classes, n_classes)
        Windows of true class (row) predicted as class (column).
    confusion_interval : ndarray, shape (2, n_classes, n_classes)
        Lower and upper end of the bootstrap interval of the share of a true class predicted as each class.
    groups, group_accuracy : ndarray, shape (n_groups,)
        Assemblies, and the accuracy within each.
    predictions, labels, assemblies : ndarray, shape (n_windows,)
        Predicted count, true count and assembly of each window.
    macro_f1 : float
        Mean over classes of the harmonic mean of precision and recall.
    exact_lobes : float or None
        Share of windows whose set of worn lobes is exactly right; needs ``worn`` and a counter that has
        ``predict_lobes``.
    calibration_error : float or None
        Expected calibration error of the predicted class: mean over ten bins of the probability of
        |probability - accuracy|, every assembly with the same weight. Needs ``predict_proba``.
    coverage, class_coverage : float and ndarray, shape (n_classes,), or None
        Share of windows whose set of counts holds the true one, of all and of each class; needs
        ``predict_set``. Refusals are misses.
    set_size : float or None
        Mean number of counts in a set that is not empty.
    refused : float or None
        Share of empty sets.
    by_condition : dict or None
        Accuracy of each condition.
    probabilities : ndarray, shape (n_windows, n_classes), or None
    folds : ndarray of int, shape (n_windows,), or None
        Fold in which each window was held out, from 0.
    protocol : str
        What was held out, see :class:`Protocol`; ``"train-test"`` for :func:`train_and_test`.
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
    labels: NDArray[Any] = field(repr=False)
    assemblies: NDArray[Any] = field(repr=False)
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
    folds: Int | None = field(default=None, repr=False)
    protocol: str = "stratified"

    def __str__(self) -> str:
        return score_text(self.to_dict())

    def calibration_curve(self) -> tuple[Float, Float, Float] | None:
        """Return mean probability, share of right answers and weight of each bin of the probability.

        Every assembly has the same weight; bins without windows are left out. None without probabilities.
        """
        if self.probabilities is None:
            return None
        member = np.unique(self.assemblies, return_inverse=True)[1]
        right = self.labels == self.predictions
        sums = calibration_sums(self.probabilities.max(axis=1), right, shares(member), member).sum(axis=0)
        said, was, weight = sums.reshape(3, N_BINS)
        used = weight > 0
        return said[used] / weight[used], was[used] / weight[used], weight[used] / weight.sum()

    def class_accuracy(self, k: int) -> tuple[float, Interval]:
        """Return the share of windows of class ``k`` predicted right, with its interval."""
        low, high = self.confusion_interval[:, k, k].tolist()
        value = float(self.confusion[k, k] / self.confusion[k].sum())
        n_assemblies = int(np.unique(self.assemblies[self.labels == self.classes[k]]).size)
        return value, at_the_ends(value, (low, high), n_assemblies, self.confidence)

    def to_dict(self) -> dict[str, Any]:
        """The result in plain types, for JSON; without scores that are None."""
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

    def to_frame(self, table: Table = "classes") -> pd.DataFrame:
        """Return one table of the result as a data frame.

        Parameters
        ----------
        table : {"classes", "assemblies", "windows"}, default="classes"

        Returns
        -------
        pandas.DataFrame
            One row per true count (``recall`` with its interval, ``precision``), per assembly, or per window
            (its fold, and the probability of each count where there is one).

        Raises
        ------
        ImportError
            If pandas is not installed.
        ValueError
            If there is no such table.
        """
        if table not in TABLES:
            raise ValueError(f"table must be one of {', '.join(TABLES)}, got {table!r}")
        if table == "classes":
            return frame(self.class_scores())
        if table == "assemblies":
            return frame({"assembly": self.groups, "accuracy": self.group_accuracy})
        columns: dict[str, Any] = {
            "assembly": self.assemblies,
            "defect_count": self.labels,
            "predicted_count": self.predictions,
        }
        if self.folds is not None:
            columns["fold"] = self.folds
        if self.probabilities is not None:
            columns |= {f"probability_{c}": self.probabilities[:, k] for k, c in enumerate(self.classes)}
        return frame(columns)

    def class_scores(self) -> list[dict[str, Any]]:
        """Return a row for each true count: its windows, recall with its interval, precision (NaN: none)."""
        rows = []
        for k, count in enumerate(self.classes.tolist()):
            tested, said = int(self.confusion[k].sum()), int(self.confusion[:, k].sum())
            recall, limits = self.class_accuracy(k) if tested else (math.nan, (math.nan, math.nan))
            rows.append({
                "defect_count": count,
                "n_windows": tested,
                "n_assemblies": int(np.unique(self.assemblies[self.labels == count]).size),
                "recall": recall,
                "recall_low": limits[0],
                "recall_high": limits[1],
                "precision": float(self.confusion[k, k] / said) if said else math.nan,
            })  # fmt: skip
        return rows

    def plot(
        self, kind: Literal["confusion", "calibration"] = "confusion", ax: Axes | None = None, **options: Any
    ) -> Any:
        """Draw the result.

        Parameters
        ----------
        kind : {"confusion", "calibration"}, default="confusion"
            Confusion matrix, or the share of right answers by the probability that the counter gave them.
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        **options
            Passed on to ``plot`` of the display.

        Returns
        -------
        cyclofeat.plotting.EvaluationDisplay

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If there is no such kind, or the counter gave no probabilities.
        """
        return plots.draw(self, kind, ax, **options)

    def _repr_html_(self) -> str:
        rows = {
            "held out": f"{self.groups.size} assemblies, {number(self.predictions.size, 'window')} "
            f"({self.protocol})",
            "macro F1": _scored(self.macro_f1, self.macro_f1_interval),
            "mean absolute error": _scored(self.mean_absolute_error, self.mean_absolute_error_interval)
            + " lobes",
            "exact lobes": _scored(self.exact_lobes, self.exact_lobes_interval),
            "calibration error": _scored(self.calibration_error, self.calibration_error_interval),
            "coverage of sets": _scored(self.coverage, self.coverage_interval),
            "intervals": f"{100 * self.confidence:.3g} %, over assemblies",
        }
        return card(
            f"Accuracy {_scored(self.accuracy, self.accuracy_interval)}", rows,
            pictures=[svg.confusion(self.confusion, self.classes.tolist())], code="evaluation.to_frame()",
        )  # fmt: skip


def _scored(value: float | None, limits: Interval | None) -> str:
    """Return a score with its interval; empty without one."""
    return "" if value is None or limits is None else f"{value:.3f} [{limits[0]:.3f}, {limits[1]:.3f}]"


def score_text(scores: Mapping[str, Any]) -> str:
    """One line for people from :meth:`Evaluation.to_dict`."""
    low, high = scores["accuracy_interval"]
    return (
        f"accuracy {scores['accuracy']:.3f} [{low:.3f}, {high:.3f}], "
        f"mean absolute error {scores['mean_absolute_error']:.3f}"
    )


@dataclass
class Answers:
    """Answers of counters for held-out windows."""

    classes: NDArray[Any]
    predictions: NDArray[Any]
    proba: Float
    folds: Int
    sets: NDArray[np.bool_] | None = None
    exact: NDArray[np.bool_] | None = None

    @classmethod
    def empty(cls, data: Windows) -> Answers:
        """Return empty answers for the windows of ``data``."""
        classes = np.unique(data.y)
        nothing = np.full((len(data.y), classes.size), np.nan)
        return cls(classes, np.empty_like(data.y), nothing, np.full(len(data.y), -1))

    def enter(self, fitted: BaseEstimator, data: Windows, test: NDArray[np.intp]) -> None:
        """Store the answers of a fitted counter for some windows, the next fold."""
        X = data.X[test]
        self.folds[test] = self.folds.max() + 1
        self.predictions[test] = fitted.predict(X)
        known = getattr(fitted, "classes_", None)
        if known is not None and not np.isin(known, self.classes).all():
            # The counter may know counts that the test does not contain.
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


def summarise(data: Windows, answers: Answers, protocol: Protocol) -> Evaluation:
    """Score the answers; intervals are those of a bootstrap over assemblies."""
    predictions, classes = answers.predictions, answers.classes
    sample = _Bootstrap.of(data, protocol)
    right = data.y == predictions
    accuracy, accuracy_interval = sample.share(right)
    # Unsigned numbers would wrap around.
    errors = np.abs(data.y.astype(float) - predictions.astype(float))
    error, error_interval = sample.score(ratio_of_sums, np.column_stack([errors, np.ones(errors.size)]))
    if error == 0:  # upper limit by the rule of three, with errors of one lobe
        error_interval = (0.0, rule_of_three(sample.groups.size, protocol.confidence))
    more: dict[str, Any] = {}
    if np.isfinite(answers.proba).all():
        more["probabilities"] = answers.proba
        more |= _of_probabilities(answers.proba, right, sample)
    if answers.exact is not None:
        value, limits = sample.share(answers.exact)
        more |= {"exact_lobes": value, "exact_lobes_interval": limits}
    if answers.sets is not None:
        more |= _of_sets(answers.sets, np.searchsorted(classes, data.y), sample.share)
    conditions = protocol.conditions_of(len(data.y))
    if conditions is not None:
        more["by_condition"] = {
            name: float(right[conditions == name].mean()) for name in np.unique(conditions).tolist()
        }
    return Evaluation(
        accuracy=accuracy,
        mean_absolute_error=error,
        accuracy_interval=accuracy_interval,
        mean_absolute_error_interval=error_interval,
        **_of_confusion(data.y, answers, sample),
        classes=classes,
        groups=sample.groups,
        group_accuracy=np.bincount(sample.member, right) / np.bincount(sample.member),
        predictions=predictions,
        labels=data.y,
        assemblies=data.groups,
        confidence=protocol.confidence,
        folds=answers.folds,
        protocol=protocol.hold_out,
        **more,
    )


@dataclass(frozen=True)
class _Bootstrap:
    """Assemblies of the windows, and their weights in the bootstrap draws."""

    groups: NDArray[Any]
    member: Int
    drawn: Int
    confidence: float

    @classmethod
    def of(cls, data: Windows, protocol: Protocol) -> _Bootstrap:
        groups, member = np.unique(data.groups, return_inverse=True)
        drawn = draws(groups.size, protocol.n_bootstrap, protocol.random_state)
        return cls(groups, member, drawn, protocol.confidence)

    def score(self, score: Callable[[Float], Float], values: NDArray[Any]) -> tuple[float, Interval]:
        """Return a score of sums over windows, with its interval."""
        return interval(score, sums_by_assembly(values, self.member), self.drawn, self.confidence)

    def share(self, hits: NDArray[np.bool_]) -> tuple[float, Interval]:
        """Return a share of windows with its interval; at 0 or 1 by the rule of three over assemblies."""
        value, limits = self.score(ratio_of_sums, np.column_stack([hits, np.ones(hits.size)]))
        return value, at_the_ends(value, limits, self.groups.size, self.confidence)


def _of_confusion(labels: NDArray[Any], answers: Answers, sample: _Bootstrap) -> dict[str, Any]:
    """Confusion matrix and macro F1, with intervals."""
    size, n_groups = answers.classes.size, sample.groups.size
    cells = np.zeros((n_groups, size, size), dtype=np.int64)
    truth, answer = (np.searchsorted(answers.classes, counts) for counts in (labels, answers.predictions))
    np.add.at(cells, (sample.member, truth, answer), 1)
    flat = cells.reshape(n_groups, -1).astype(float)
    f1, f1_interval = interval(
        lambda sums: macro_f1(sums.reshape(*sums.shape[:-1], size, size)),
        flat,
        sample.drawn,
        sample.confidence,
    )
    tables = np.tensordot(sample.drawn, cells, axes=1)
    rows = tables.sum(axis=2, keepdims=True)
    parts = np.divide(tables, rows, out=np.zeros(tables.shape), where=rows > 0)
    tail = 100 * (1 - sample.confidence) / 2
    return {
        "confusion": cells.sum(axis=0),
        "confusion_interval": np.percentile(parts, [tail, 100 - tail], axis=0),
        "macro_f1": f1,
        "macro_f1_interval": at_the_ends(f1, f1_interval, n_groups, sample.confidence),
    }


def _of_probabilities(proba: Float, right: NDArray[np.bool_], sample: _Bootstrap) -> dict[str, Any]:
    """Expected calibration error of the predicted class."""
    sums = calibration_sums(proba.max(axis=1), right, shares(sample.member), sample.member)
    value, limits = interval(expected_calibration_error, sums, sample.drawn, sample.confidence)
    return {"calibration_error": value, "calibration_error_interval": limits}


def _of_sets(
    sets: NDArray[np.bool_],
    rank: Int,
    share: Callable[[NDArray[np.bool_]], tuple[float, Interval]],
) -> dict[str, Any]:
    """Scores of sets of counts."""
    covered = sets[np.arange(rank.size), rank]
    coverage, limits = share(covered)
    sizes = sets.sum(axis=1)
    of_class = [covered[rank == c] for c in range(sets.shape[1])]
    return {
        "coverage": coverage,
        "coverage_interval": limits,
        "class_coverage": np.array([hits.mean() if hits.size else np.nan for hits in of_class]),
        "set_size": float(sizes[sizes > 0].mean()) if np.any(sizes) else 0.0,
        "refused": float(np.mean(sizes == 0)),
    }
