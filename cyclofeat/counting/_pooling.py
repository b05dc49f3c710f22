"""Pooling of several estimators' probabilities, and the weights at which the pool is most likely."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logsumexp

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# A tree ensemble's zero is "never seen among the trees", not "impossible".
_LEAST_PROBABILITY = 1e-3


def safe_log(proba: Float) -> Float:
    """Logarithm of probabilities, those below 0.001 raised to it."""
    return np.asarray(np.log(np.maximum(proba, _LEAST_PROBABILITY)))


def softmax(scores: Float) -> Float:
    """Probabilities, shape as given, from their logarithms up to a constant per row."""
    powers = np.exp(scores - scores.max(axis=-1, keepdims=True))
    return np.asarray(powers / powers.sum(axis=-1, keepdims=True))


def pooled(logs: Float, weights: Float) -> Float:
    """Probabilities of several opinions (m, n, c) weighted in the logarithm: the product of their powers."""
    return softmax(np.tensordot(weights, logs, axes=1))


def pool_weights(logs: Float, rank: Int, importance: Float, n_assemblies: int) -> Float:
    """Exponents, not negative, at which the pooled opinions are most likely; with one opinion: 1/temperature.

    ``logs`` are logarithms of held-out probabilities, shape (n_opinions, n_windows, n_classes), ``rank`` is
    the column of each window's true class. By Laplace's rule of succession one of ``n_assemblies + 2`` is
    taken for wrong, since the likelihood of no errors would ask for certainty.
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
