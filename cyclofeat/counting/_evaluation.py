"""Evaluation that keeps all windows of one assembly on the same side of every split."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, clone
from sklearn.metrics import confusion_matrix
from sklearn.model_selection import StratifiedGroupKFold
from sklearn.utils import check_array, check_consistent_length

_LEAK = (
    "groups must name the assembly of every window, got None: windows of one recording look alike for "
    "reasons that have nothing to do with wear, so a split that puts them on both sides measures how well "
    "the counter recognises the recording. Pass the groups that Windower.transform returns"
)


@dataclass(frozen=True)
class Evaluation:
    """Result of :func:`evaluate`.

    Attributes
    ----------
    accuracy, mean_absolute_error : float
        Over all windows, each predicted by a counter that never saw its assembly.
    accuracy_interval, mean_absolute_error_interval : tuple of float
        Bootstrap intervals over assemblies at ``confidence``.
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
    """

    accuracy: float
    mean_absolute_error: float
    accuracy_interval: tuple[float, float]
    mean_absolute_error_interval: tuple[float, float]
    confusion: NDArray[np.int64] = field(repr=False)
    confusion_interval: NDArray[np.float64] = field(repr=False)
    classes: NDArray[Any] = field(repr=False)
    groups: NDArray[Any] = field(repr=False)
    group_accuracy: NDArray[np.float64] = field(repr=False)
    predictions: NDArray[Any] = field(repr=False)
    confidence: float = 0.95

    def __str__(self) -> str:
        return score_text(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """The result in plain types, for JSON."""
        return {
            "accuracy": self.accuracy,
            "accuracy_interval": list(self.accuracy_interval),
            "mean_absolute_error": self.mean_absolute_error,
            "mean_absolute_error_interval": list(self.mean_absolute_error_interval),
            "confidence": self.confidence,
            "classes": self.classes.tolist(),
            "confusion": self.confusion.tolist(),
            "n_windows": int(self.predictions.size),
            "n_assemblies": int(self.groups.size),
        }


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
    n_splits: int = 5,
    confidence: float = 0.95,
    n_bootstrap: int = 1000,
    random_state: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Cross-validate a counter with whole assemblies held out.

    Parameters
    ----------
    counter : estimator
        Classifier of windows; cloned for each fold, never changed.
    X : array-like, shape (n_windows, n_samples)
        Windows of torque in Nm.
    y : array-like of int, shape (n_windows,)
        Defect count of each window.
    groups : array-like, shape (n_windows,)
        Assembly of each window: several recordings of one assembly are one group.
    n_splits : int
        Number of folds of ``StratifiedGroupKFold(shuffle=True)``.
    confidence : float
        Coverage of the bootstrap intervals.
    n_bootstrap : int
        Number of bootstrap draws over assemblies.
    random_state : int
        Seed of folds and bootstrap.
    progress : callable, optional
        Called as ``progress(folds_done, n_splits)``.

    Returns
    -------
    Evaluation

    Raises
    ------
    ValueError
        Without groups; where a class has fewer assemblies than folds; where counts are not numbers; where
        windows are not finite, all constant, or of different lengths than labels or groups.
    """
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
    if constant.size:
        raise ValueError(f"X must hold windows with variation, but window {constant[0]} is constant")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must lie between 0 and 1, got {confidence!r}")
    if n_splits < 2:
        raise ValueError(f"n_splits must be at least 2, got {n_splits!r}")
    classes = np.unique(labels)
    for label in classes:
        n_assemblies = np.unique(assemblies[labels == label]).size
        if n_assemblies < n_splits:
            raise ValueError(
                f"class {label} has {n_assemblies} assemblies, fewer than n_splits={n_splits}: with one "
                "recording per class no split can estimate an accuracy; record more or lower n_splits"
            )
    predictions = np.empty_like(labels)
    folds = StratifiedGroupKFold(n_splits=n_splits, shuffle=True, random_state=random_state)
    for done, (train, test) in enumerate(folds.split(windows, labels, assemblies), start=1):
        predictions[test] = clone(counter).fit(windows[train], labels[train]).predict(windows[test])
        if progress is not None:
            progress(done, n_splits)
    return _summarise(labels, predictions, assemblies, classes, confidence, n_bootstrap, random_state)


def _summarise(
    labels: NDArray[Any],
    predictions: NDArray[Any],
    assemblies: NDArray[Any],
    classes: NDArray[Any],
    confidence: float,
    n_bootstrap: int,
    random_state: int,
) -> Evaluation:
    groups, member = np.unique(assemblies, return_inverse=True)
    size = np.bincount(member)
    hits = np.bincount(member, labels == predictions)
    errors = np.bincount(member, np.abs(labels - predictions))
    cells = np.stack(
        [
            confusion_matrix(labels[member == g], predictions[member == g], labels=classes)
            for g in range(groups.size)
        ]
    )
    random = np.random.default_rng(random_state)
    drawn = random.integers(groups.size, size=(n_bootstrap, groups.size))
    tail = 100 * (1 - confidence) / 2
    limits = [tail, 100 - tail]
    accuracy = np.percentile(hits[drawn].sum(axis=1) / size[drawn].sum(axis=1), limits)
    error = np.percentile(errors[drawn].sum(axis=1) / size[drawn].sum(axis=1), limits)
    weights = np.stack([np.bincount(row, minlength=groups.size) for row in drawn])
    tables = np.tensordot(weights, cells, axes=1)
    rows = tables.sum(axis=2, keepdims=True)
    shares = np.divide(tables, rows, out=np.zeros(tables.shape), where=rows > 0)
    return Evaluation(
        accuracy=float(hits.sum() / size.sum()),
        mean_absolute_error=float(errors.sum() / size.sum()),
        accuracy_interval=(float(accuracy[0]), float(accuracy[1])),
        mean_absolute_error_interval=(float(error[0]), float(error[1])),
        confusion=cells.sum(axis=0),
        confusion_interval=np.percentile(shares, limits, axis=0),
        classes=classes,
        groups=groups,
        group_accuracy=hits / size,
        predictions=predictions,
        confidence=confidence,
    )
