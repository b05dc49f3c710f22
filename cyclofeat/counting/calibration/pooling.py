"""Pooling of probabilities: of several opinions of a window, and of the windows of a recording."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.special import logsumexp, softmax

from cyclofeat.counting.evaluation.scores import window_weights
from cyclofeat.signal.windows import Float, Int

# A zero of a tree ensemble means "not seen in training", not "impossible".
_LEAST_PROBABILITY = 1e-3


def safe_log(proba: Float) -> Float:
    """Return the logarithm of probabilities, with those below 0.001 set to 0.001."""
    return np.asarray(np.log(np.maximum(proba, _LEAST_PROBABILITY)))


def pool_opinions(logs: Float, weights: Float) -> Float:
    """Pool the log probabilities (m, n, c) of m opinions: the product of their powers, (n, c)."""
    return np.asarray(softmax(np.tensordot(weights, logs, axes=1), axis=-1))


def pool_weights(logs: Float, rank: Int, member: Int) -> Float:
    """Return the non-negative exponents with the highest likelihood; for one opinion, 1/temperature.

    ``logs`` are logarithms of held-out probabilities, shape (n_opinions, n_windows, n_classes), ``rank`` is
    the column of each window's true class, ``member`` names its assembly. Every assembly has the same weight.
    By Laplace's rule of succession one of n + 2 assemblies is assumed to be wrong: without any error the
    likelihood would grow towards certainty.
    """
    n_opinions, n_windows, n_classes = logs.shape
    assemblies, member = np.unique(member, return_inverse=True)
    wrong = 1.0 / (assemblies.size + 2)
    target = np.full((n_windows, n_classes), wrong / max(n_classes - 1, 1))
    target[np.arange(n_windows), rank] = 1 - wrong
    weight = window_weights(member)
    importance = weight / weight.sum()

    def loss(weights: Float) -> tuple[float, Float]:
        scores = np.tensordot(weights, logs, axes=1)
        normaliser = logsumexp(scores, axis=1, keepdims=True)
        surplus = importance[:, np.newaxis] * (np.exp(scores - normaliser) - target)
        value = float(importance @ (normaliser[:, 0] - np.sum(target * scores, axis=1)))
        return value, np.tensordot(logs, surplus, axes=([1, 2], [0, 1]))

    start = np.full(n_opinions, 1.0 / n_opinions)
    # Convex in the weights: a local method finds the minimum.
    best = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[(0.0, None)] * n_opinions)
    return np.asarray(best.x)


def combine_proba(proba: Float, member: Int, dependence: float) -> Float:
    """Return probabilities of recordings, shape (n_recordings, n_classes), from those of their windows.

    log p(c) = (1/(1 + (W - 1) rho)) sum over W windows of log p_w(c), up to a constant: the product of the
    windows' probabilities, tempered because W windows with equal correlation rho, the ``dependence``, carry
    the information of W/(1 + (W - 1) rho) independent ones (Kish, Survey Sampling, 1965). ``member`` is the
    number of each window's recording. The tempering changes probabilities, not the count.
    """
    size = np.bincount(member)
    sums = np.zeros((size.size, proba.shape[1]))
    np.add.at(sums, member, safe_log(proba))
    return np.asarray(softmax(sums / (1 + (size - 1) * dependence)[:, np.newaxis], axis=-1))


def pool_windows(proba: Float, dependence: float | None) -> Float:
    """Return the probabilities of one recording; its windows count as one where no dependence is known."""
    one = np.zeros(len(proba), dtype=np.int64)
    return np.asarray(combine_proba(proba, one, 1.0 if dependence is None else dependence)[0])


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

    inner = minimize_scalar(loss, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-3})
    return min([0.0, float(inner.x), 1.0], key=loss)
