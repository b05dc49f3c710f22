"""One count from several windows of a recording."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar
from scipy.special import softmax
from sklearn.base import BaseEstimator

from cyclofeat.counting.calibration._pooling import safe_log
from cyclofeat.counting.evaluation.assembly_folds import Float, Int, of_windows


@dataclass(frozen=True)
class RecordingCounts:
    """Result of :func:`predict_recordings`, one entry per recording.

    Attributes
    ----------
    recordings : ndarray, shape (n_recordings,)
        Names as in ``groups``, in order.
    counts : ndarray, shape (n_recordings,)
        Most probable class.
    probability : ndarray, shape (n_recordings, n_classes)
    classes : ndarray, shape (n_classes,)
    n_windows : ndarray of int, shape (n_recordings,)
        Windows that were combined.
    dependence : float
        Used in combining.
    """

    recordings: NDArray[Any]
    counts: NDArray[Any]
    probability: Float = field(repr=False)
    classes: NDArray[Any] = field(repr=False)
    n_windows: Int
    dependence: float

    def to_dict(self) -> list[dict[str, Any]]:
        """Return one plain entry per recording, for JSON."""
        classes = [str(name) for name in self.classes.tolist()]
        columns = (self.recordings, self.counts, self.probability, self.n_windows)
        return [
            {
                "recording": name,
                "defect_count": count,
                "probability": dict(zip(classes, row, strict=True)),
                "n_windows": n,
            }
            for name, count, row, n in zip(*(column.tolist() for column in columns), strict=True)
        ]


def combine_proba(proba: Float, member: Int, dependence: float) -> Float:
    """Return probabilities of recordings, shape (n_recordings, n_classes), from those of their windows."""
    size = np.bincount(member)
    sums = np.zeros((size.size, proba.shape[1]))
    np.add.at(sums, member, safe_log(proba))
    return np.asarray(softmax(sums / (1 + (size - 1) * dependence)[:, np.newaxis], axis=-1))


def learn_dependence(proba: Float, rank: Int, member: Int) -> float | None:
    """Return the dependence with the highest likelihood for held-out recordings.

    None if no recording has several windows. ``rank`` is the column of each window's true class.
    """
    _, first, member = np.unique(member, return_index=True, return_inverse=True)
    if np.bincount(member).max() < 2:
        return None
    several = np.flatnonzero(np.bincount(member) > 1)
    truth = rank[first][several]
    wrong = 1.0 / (several.size + 2)  # Laplace's rule of succession, as for the temperature

    def loss(dependence: float) -> float:
        combined = combine_proba(proba, member, dependence)[several]
        logs = np.log(np.maximum(combined, np.finfo(float).tiny))
        right = logs[np.arange(truth.size), truth]
        others = (logs.sum(axis=1) - right) / max(proba.shape[1] - 1, 1)
        return float(-np.mean((1 - wrong) * right + wrong * others))

    found = minimize_scalar(loss, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-3})
    candidates = [0.0, float(found.x), 1.0]
    return min(candidates, key=loss)


def predict_recordings(
    counter: BaseEstimator, X: ArrayLike, groups: ArrayLike, *, dependence: float | str = "auto"
) -> RecordingCounts:
    """Count per recording from the probabilities of its windows.

    Parameters
    ----------
    counter : classifier
        Fitted, with ``predict_proba``; its probabilities should be calibrated
        (:class:`GroupCalibratedCounter`, :class:`LobeCounter`).
    X : array-like, shape (n_windows, n_samples)
        Windows, or their features, in any order.
    groups : array-like, shape (n_windows,)
        Recording of each window.
    dependence : float or "auto", default="auto"
        How much the windows of one recording err together: 0 as independent ones, 1 as if all were the same.
        ``"auto"``: what the counter learned (its ``dependence_``); 0 if it has learned nothing of the kind,
        and then the probabilities of long recordings come out too near to 1.

    Returns
    -------
    RecordingCounts

    Raises
    ------
    ValueError
        If ``groups`` is missing, not one name per window, or names are NaN; if ``dependence`` is not from 0
        to 1; if there are no windows.

    Notes
    -----
    log p(c) = (1/(1 + (W - 1) rho)) sum over W windows of log p_w(c), up to a constant: the product of the
    windows' probabilities, tempered because W windows with equal correlation rho carry the information of
    W/(1 + (W - 1) rho) independent ones (Kish, Survey Sampling, 1965). Classes are assumed to be equally
    frequent. The tempering changes probabilities, not the count. Probabilities of windows below 0.001 count
    as 0.001.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.naive_bayes import GaussianNB
    >>> counter = GaussianNB().fit([[-1.0], [0.0], [1.0], [2.0]], [0, 0, 1, 1])
    >>> result = predict_recordings(counter, [[0.4], [0.5], [0.3], [1.2]], ["a", "a", "a", "b"])
    >>> result.counts, result.n_windows
    (array([0, 1]), array([3, 1]))
    """
    if groups is None:
        raise ValueError("groups must name the recording of every window, got None")
    n_windows = len(np.asarray(X)) if not hasattr(X, "shape") else X.shape[0]
    if n_windows == 0:
        raise ValueError("X must hold at least one window, got none")
    names = of_windows("groups", groups, n_windows)
    value = (getattr(counter, "dependence_", None) or 0.0) if dependence == "auto" else dependence
    if isinstance(value, str) or not 0 <= value <= 1:
        raise ValueError(f"dependence must be a number from 0 to 1 or 'auto', got {dependence!r}")
    recordings, member = np.unique(names, return_inverse=True)
    probability = combine_proba(np.asarray(counter.predict_proba(X)), member, value)
    classes = np.asarray(counter.classes_)
    return RecordingCounts(
        recordings=recordings,
        counts=classes[np.argmax(probability, axis=1)],
        probability=probability,
        classes=classes,
        n_windows=np.bincount(member),
        dependence=float(value),
    )
