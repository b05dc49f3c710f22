"""Scores, with intervals, of counters on held-out windows."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base import draw_plot
from cyclofeat._base.checks import one_of
from cyclofeat._base.displays import Card, WithCard, data_frame, draw_confusion
from cyclofeat._base.quantities import number_of
from cyclofeat.counting.evaluation.scores import (
    N_BINS,
    Interval,
    calibration_sums,
    limits_at_ends,
    window_weights,
)
from cyclofeat.signal.windows import Float, Int

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Evaluation(WithCard):
    """Result of :func:`evaluate`.

    Scores that the counter or the data do not allow are None. ``<score>_interval`` holds percentiles of a
    bootstrap over assemblies at ``confidence``; where a share is 0 or 1, the rule of three.

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
    by_condition : dict or None
        Accuracy of each condition.
    refused, accepted_accuracy : float or None
        Share of recordings that a :class:`LobeModel` refuses, and accuracy of those that it does not. All
        other scores include refused recordings.
    reasons : ndarray of str, shape (n_recordings,), or None
        Why each recording is refused; empty where it is not.
    windows : Evaluation or None
        The same for the windows of the recordings, each counted by itself.
    certainty : ndarray, shape (n_windows,), or None
        Probability of the predicted count.
    probabilities : ndarray, shape (n_windows, n_classes), or None
    folds : ndarray of int, shape (n_windows,), or None
        Fold in which each window was held out, from 0.
    protocol : str
        What was held out, see :class:`Protocol`.
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
    by_condition: dict[Any, float] | None = None
    refused: float | None = None
    accepted_accuracy: float | None = None
    accepted_accuracy_interval: Interval | None = None
    reasons: NDArray[np.str_] | None = field(default=None, repr=False)
    windows: Evaluation | None = field(default=None, repr=False)
    certainty: NDArray[np.float64] | None = field(default=None, repr=False)
    probabilities: NDArray[np.float64] | None = field(default=None, repr=False)
    folds: Int | None = field(default=None, repr=False)
    protocol: str = "stratified"

    def __str__(self) -> str:
        return score_text(self.to_dict())

    def calibration_curve(self) -> tuple[Float, Float, Float] | None:
        """Compare probabilities with the share of right answers, in bins of the probability.

        Every assembly has the same weight; bins without windows are left out.

        Returns
        -------
        tuple of ndarray, shape (n_bins,) each, or None
            Mean probability, share of right answers and weight of each bin; None without probabilities.
        """
        if self.certainty is None:
            return None
        member = np.unique(self.assemblies, return_inverse=True)[1]
        right = self.labels == self.predictions
        sums = calibration_sums(self.certainty, right, window_weights(member), member).sum(axis=0)
        stated, was, weight = sums.reshape(3, N_BINS)
        used = weight > 0
        return stated[used] / weight[used], was[used] / weight[used], weight[used] / weight.sum()

    def agreement(self) -> str:
        """Return in words how many recordings or windows are counted as their labels say, and of each count.

        Returns
        -------
        str
        """
        right, n = self.confusion.diagonal(), self.confusion.sum(axis=1)
        of_counts = [f"{c}: {k} of {m}" for c, k, m in zip(self.classes, right, n, strict=True) if m]
        return f"{right.sum()} of {n.sum()} agree with their labels ({', '.join(of_counts)})"

    def _scores(self, *names: str) -> dict[str, Any]:
        """Return scores and their intervals by name, without those that are None."""
        scores: dict[str, Any] = {}
        for name in names:
            if (score := getattr(self, name)) is not None:
                scores |= {name: score, f"{name}_interval": list(getattr(self, f"{name}_interval"))}
        return scores

    def to_dict(self) -> dict[str, Any]:
        """Return the result in plain types, for JSON, without scores that are None.

        Returns
        -------
        dict
        """
        result = self._scores("accuracy", "mean_absolute_error", "macro_f1") | {
            "confidence": self.confidence,
            "classes": self.classes.tolist(),
            "confusion": self.confusion.tolist(),
            "n_windows" if self.windows is None else "n_recordings": int(self.predictions.size),
            "n_assemblies": int(self.groups.size),
            "protocol": self.protocol,
        }
        result |= self._scores("exact_lobes", "calibration_error", "accepted_accuracy")
        if self.reasons is not None:
            result |= {"refused": self.refused, "reasons": count_reasons(self.reasons)}
        if self.windows is not None:
            result["windows"] = self.windows.to_dict()
        if self.by_condition is not None:
            result["by_condition"] = {str(name): value for name, value in self.by_condition.items()}
        return result

    def to_frame(self, table: Literal["classes", "assemblies", "windows"] = "classes") -> pd.DataFrame:
        """Return one table of the result as a data frame.

        Parameters
        ----------
        table : {"classes", "assemblies", "windows"}, default="classes"

        Returns
        -------
        pandas.DataFrame
            One row per true count (``recall`` with its interval, ``precision``), per assembly, or per window
            (its fold, and the probability of each count where there is one).
        """
        if one_of("table", table, ("classes", "assemblies", "windows")) == "classes":
            return data_frame(self.class_scores())
        if table == "assemblies":
            return data_frame({"assembly": self.groups, "accuracy": self.group_accuracy})
        columns: dict[str, Any] = {
            "assembly": self.assemblies,
            "defect_count": self.labels,
            "predicted_count": self.predictions,
            "fold": self.folds,
            "reason": self.reasons,
        }
        if self.probabilities is not None:
            columns |= {f"probability_{c}": self.probabilities[:, k] for k, c in enumerate(self.classes)}
        return data_frame({name: values for name, values in columns.items() if values is not None})

    def class_scores(self) -> list[dict[str, Any]]:
        """Return a row for each true count: its windows, recall with its interval, precision (NaN: none).

        Returns
        -------
        list of dict
        """
        rows = []
        for k, count in enumerate(self.classes.tolist()):
            tested, predicted = int(self.confusion[k].sum()), int(self.confusion[:, k].sum())
            n_assemblies = int(np.unique(self.assemblies[self.labels == count]).size)
            recall, low, high = math.nan, math.nan, math.nan
            if tested:
                recall = float(self.confusion[k, k] / tested)
                low, high = self.confusion_interval[:, k, k].tolist()
                low, high = limits_at_ends(recall, (low, high), n_assemblies, self.confidence)
            rows.append({
                "defect_count": count, "n_windows": tested, "n_assemblies": n_assemblies, "recall": recall,
                "recall_low": low, "recall_high": high,
                "precision": float(self.confusion[k, k] / predicted) if predicted else math.nan,
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
        """
        return draw_plot(self, kind, ax, **options)

    def _card(self) -> Card:
        scores = self.to_dict()
        texts = {
            name: "{:.3f} [{:.3f}, {:.3f}]".format(scores[name], *scores[f"{name}_interval"])
            for name in ("accuracy", "macro_f1", "mean_absolute_error", "exact_lobes", "calibration_error")
            if name in scores
        }
        tested = f"{number_of(self.groups.size, 'assembly')}, {number_of(self.predictions.size, 'window')}"
        rows = {
            "held out": f"{tested} ({self.protocol})",
            "macro F1": texts["macro_f1"],
            "mean absolute error": f"{texts['mean_absolute_error']} lobes",
            "exact lobes": texts.get("exact_lobes"),
            "calibration error": texts.get("calibration_error"),
            "intervals": f"{100 * self.confidence:.3g} %, over assemblies",
        }
        return Card(
            f"Accuracy {texts['accuracy']}", rows,
            lambda: [draw_confusion(self.confusion, self.classes.tolist())], code="evaluation.to_frame()",
        )  # fmt: skip


def count_reasons(reasons: Iterable[str | None]) -> dict[str, int]:
    """Return how often each reason of a refusal occurs, the most frequent first.

    Numbers in them are ``...``; what follows a colon is left out.
    """
    kinds = [re.sub(r"\d[\d.,]*", "...", reason.partition(":")[0]) for reason in reasons if reason]
    return dict(Counter(kinds).most_common())


def score_text(scores: Mapping[str, Any]) -> str:
    """One line for people from :meth:`Evaluation.to_dict`."""
    low, high = scores["accuracy_interval"]
    return (
        f"accuracy {scores['accuracy']:.3f} [{low:.3f}, {high:.3f}], "
        f"mean absolute error {scores['mean_absolute_error']:.3f}"
    )
