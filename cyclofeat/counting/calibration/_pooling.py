"""Pooling of several estimators' probabilities, and the weights at which the pool is most likely."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logsumexp, softmax

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# A zero of a tree ensemble means "not seen in training", not "impossible".
_LEAST_PROBABILITY = 1e-3


def safe_log(proba: Float) -> Float:
    """Return the logarithm of probabilities, with those below 0.001 set to 0.001."""
    return np.asarray(np.log(np.maximum(proba, _LEAST_PROBABILITY)))


def pooled(logs: Float, weights: Float) -> Float:
    """Pool the log probabilities (m, n, c) of m opinions: the product of their powers, (n, c)."""
    return np.asarray(softmax(np.tensordot(weights, logs, axes=1), axis=-1))


def pool_weights(logs: Float, rank: Int, importance: Float, n_assemblies: int) -> Float:
    """Return the non-negative exponents with the highest likelihood; for one opinion, 1/temperature.

    ``logs`` are logarithms of held-out probabilities, shape (n_opinions, n_windows, n_classes), ``rank`` is
    the column of each window's true class. By Laplace's rule of succession one of ``n_assemblies + 2`` is
    assumed to be wrong: without any error the likelihood would grow towards certainty.
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
    # Convex in the weights: a local method finds the minimum.
    found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[(0.0, None)] * n_opinions)
    return np.asarray(found.x)
