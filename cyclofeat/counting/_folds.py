"""Folds by assembly, and what estimators say of assemblies that they have not seen."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import logsumexp
from sklearn.base import BaseEstimator, clone
from sklearn.model_selection import StratifiedGroupKFold
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import has_fit_parameter

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Folds = list[tuple[NDArray[np.intp], NDArray[np.intp]]]

# A tree ensemble's zero is "never seen among the trees", not "impossible".
LEAST_PROBABILITY = 1e-3


def of_windows(name: str, values: ArrayLike, n_windows: int) -> NDArray[Any]:
    """One value per window as an array, or ``ValueError`` with the argument's name."""
    array = np.asarray(values)
    if array.shape != (n_windows,):
        raise ValueError(
            f"{name} must hold one value per window, shape ({n_windows},), got shape {array.shape}"
        )
    missing = _missing(array)
    if missing.any():
        where = int(np.argmax(missing))
        raise ValueError(f"{name} must hold a value for every window, got {array[where]} at window {where}")
    return array


def _missing(values: NDArray[Any]) -> NDArray[np.bool_]:
    """None, NaN and infinity, also among the objects of a data frame's column."""
    if values.dtype.kind in "fc":
        return np.asarray(~np.isfinite(values))
    if values.dtype.kind != "O":
        return np.zeros(values.shape, dtype=bool)
    return np.array([one is None or (isinstance(one, float) and not math.isfinite(one)) for one in values])


def ordered_classes(y: NDArray[Any]) -> tuple[NDArray[Any], Int]:
    """Classes in order, and the rank of each window's; ``ValueError`` where there is one only."""
    check_classification_targets(y)
    classes, rank = np.unique(y, return_inverse=True)
    if classes.size < 2:
        raise ValueError(f"y must hold at least two classes, got 1 class: {classes.tolist()[0]!r}")
    return classes, np.asarray(rank, dtype=np.int64)


def assemblies_of(groups: ArrayLike | None, n_windows: int) -> Int:
    """Number of the assembly of each window, from 0; without groups every window is one of its own."""
    if groups is None:
        return np.arange(n_windows)
    return np.asarray(np.unique(of_windows("groups", groups, n_windows), return_inverse=True)[1])


def fewest_assemblies(member: Int, y: NDArray[Any]) -> int:
    """Assemblies of the class that has the fewest."""
    return min(np.unique(member[y == label]).size for label in np.unique(y))


def grouped_folds(y: NDArray[Any], member: Int, n_splits: int, random_state: int | None) -> Folds:
    """Whole assemblies held out in turn, classes shared out evenly; [] where a class has only one assembly.

    There are ``n_splits`` folds or, where that is less, as many as the rarest class has assemblies.
    """
    possible = min(n_splits, fewest_assemblies(member, y))
    if possible < 2:
        return []
    # StratifiedGroupKFold wants a seed or nothing
    folds = StratifiedGroupKFold(possible, shuffle=True, random_state=random_state)
    return [(train, test) for train, test in folds.split(np.zeros(len(y)), y, member) if test.size]


def fit_grouped(
    estimator: BaseEstimator, X: NDArray[Any], y: NDArray[Any], groups: NDArray[Any] | None
) -> BaseEstimator:
    """Fit, handing groups over to an estimator whose ``fit`` takes them; returns it."""
    if groups is not None and has_fit_parameter(estimator, "groups"):
        return estimator.fit(X, y, groups=groups)
    return estimator.fit(X, y)


def aligned_proba(estimator: BaseEstimator, X: NDArray[Any], classes: NDArray[Any]) -> Float:
    """``predict_proba`` with a column for each of ``classes``, 0 for one that was not in training."""
    proba = np.zeros((len(X), len(classes)))
    proba[:, np.searchsorted(classes, estimator.classes_)] = estimator.predict_proba(X)
    return proba


def held_out_proba(
    estimator: BaseEstimator,
    X: NDArray[Any],
    y: NDArray[Any],
    member: Int,
    classes: NDArray[Any],
    folds: Folds,
) -> Float:
    """Probabilities of each window by a copy of the estimator that has not seen its assembly.

    Shape (n_windows, n_classes); NaN for windows that no fold holds out.
    """
    proba = np.full((len(y), len(classes)), np.nan)
    for train, test in folds:
        fitted = fit_grouped(clone(estimator), X[train], y[train], member[train])
        proba[test] = aligned_proba(fitted, X[test], classes)
    return proba


def shares(member: Int) -> Float:
    """Weight of each window such that every assembly weighs 1."""
    return np.asarray(1.0 / np.bincount(member)[member])


def safe_log(proba: Float) -> Float:
    """Logarithm of probabilities, none taken for less than 0.001."""
    return np.asarray(np.log(np.maximum(proba, LEAST_PROBABILITY)))


def softmax(scores: Float) -> Float:
    """Probabilities, shape as given, from their logarithms up to a constant per row."""
    powers = np.exp(scores - scores.max(axis=-1, keepdims=True))
    return np.asarray(powers / powers.sum(axis=-1, keepdims=True))


def pooled(logs: Float, weights: Float) -> Float:
    """Probabilities of several opinions (m, n, c) weighted in the logarithm: the product of their powers."""
    return softmax(np.tensordot(weights, logs, axes=1))


def pool_weights(logs: Float, rank: Int, importance: Float, n_assemblies: int) -> Float:
    """Exponents, not negative, at which the pooled opinions are most likely; with one opinion: 1/temperature.

    Where every held-out assembly was counted right, the likelihood would ask for certainty. By Laplace's rule
    of succession one of ``n_assemblies + 2`` is therefore taken for wrong.

    Parameters
    ----------
    logs : ndarray, shape (n_opinions, n_windows, n_classes)
        Logarithms of held-out probabilities.
    rank : ndarray of int, shape (n_windows,)
        Column of the true class.
    importance : ndarray, shape (n_windows,)
        Weight of each window.
    n_assemblies : int

    Returns
    -------
    ndarray, shape (n_opinions,)
    """
    n_opinions, n_windows, n_classes = logs.shape
    wrong = 1.0 / (n_assemblies + 2)
    target = np.full((n_windows, n_classes), wrong / max(n_classes - 1, 1))
    target[np.arange(n_windows), rank] = 1 - wrong
    importance = importance / importance.sum()

    def loss(weights: Float) -> tuple[float, Float]:
        scores = np.tensordot(weights, logs, axes=1)
        normaliser = logsumexp(scores, axis=1, keepdims=True)
        surplus = importance[:, np.newaxis] * (np.exp(scores - normaliser) - target)
        value = float(importance @ (normaliser[:, 0] - np.sum(target * scores, axis=1)))
        return value, np.tensordot(logs, surplus, axes=([1, 2], [0, 1]))

    start = np.full(n_opinions, 1.0 / n_opinions)
    # convex in the weights: any local method finds the minimum
    found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[(0.0, None)] * n_opinions)
    return np.asarray(found.x)
