"""Tests of all cells at once: energy distance, and a classifier. They do not say which cells differ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.model_selection import StratifiedKFold

Float = NDArray[np.float64]


def _whitened(measured: Float, simulated: Float, n_components: int = 12) -> Float:
    """Leading principal components of all recordings, each of unit variance: (n, n_components)."""
    pooled = np.vstack([measured, simulated])
    scaled = pooled - pooled.mean(axis=0)
    scaled = scaled / np.maximum(scaled.std(axis=0), 1e-9)
    left, size, _ = np.linalg.svd(scaled, full_matrices=False)
    kept = min(n_components, int(np.sum(size > 1e-9 * size[0])), len(pooled) // 4 + 1)
    return np.asarray(left[:, :kept] * np.sqrt(len(pooled)))


def energy_p(measured: Float, simulated: Float, n: int, random: np.random.Generator) -> float:
    """p of the energy distance (Szekely and Rizzo 2004) under permuted labels."""
    points = _whitened(measured, simulated)
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    first, total = len(measured), len(points)

    def statistic(chosen: NDArray[np.intp]) -> float:
        # Weights of the difference of the two means: the energy distance is minus their quadratic form.
        weights = np.full(total, -1 / (total - first))
        weights[chosen] = 1 / first
        return -float(weights @ distances @ weights)

    observed = statistic(np.arange(first))
    reached = sum(statistic(random.choice(total, first, replace=False)) >= observed for _ in range(n))
    return (reached + 1) / (n + 1)


def classifier_p(measured: Float, simulated: Float, n: int, random: np.random.Generator) -> float:
    """p of the separation by a cross-validated linear classifier, refitted under each permutation."""
    points = _whitened(measured, simulated)
    labels: Float = np.concatenate([np.ones(len(measured)), np.zeros(len(simulated))])
    folds = StratifiedKFold(min(5, len(measured)), shuffle=True, random_state=0)

    def separation(y: Float) -> float:
        # Not cross_val_predict, whose checks take longer than these small fits.
        scores = np.empty(y.size)
        for train, test in folds.split(points, y):
            fitted = LinearDiscriminantAnalysis().fit(points[train], y[train])
            scores[test] = fitted.decision_function(points[test])
        inside = scores[y == 1]
        return float(np.mean(inside[:, None] > scores[y == 0][None]))

    observed = separation(labels)
    reached = sum(separation(random.permutation(labels)) >= observed for _ in range(n))
    return (reached + 1) / (n + 1)
