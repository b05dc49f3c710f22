"""Probabilities of counts and of sets of lobes, from the logit of each lobe."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, softmax

from cyclofeat.counting.evaluation.assembly_folds import Float, Int

Bool = NDArray[np.bool_]


def turned(worn: Bool, slots: Int) -> Bool:
    """Rotate each row by its number of slots, which is the new index of lobe 0."""
    n_lobes = worn.shape[1]
    return np.asarray(np.take_along_axis(worn, (np.arange(n_lobes) - slots[:, np.newaxis]) % n_lobes, axis=1))


def symmetric(odds: Float) -> Float:
    """Return the elementary symmetric polynomials e_0 ... e_n of n odds: sums of products over sets."""
    sums = np.zeros((*odds.shape[:-1], odds.shape[-1] + 1))
    sums[..., 0] = 1.0
    for k in range(odds.shape[-1]):
        sums[..., 1:] += odds[..., k, np.newaxis] * sums[..., :-1]
    return sums


def rows_of_neighbours(logits: Float) -> Float:
    """Sum of logits of the n neighbours from lobe k on: shape (n_windows, n_lobes + 1 counts, n_lobes)."""
    n_lobes = logits.shape[1]
    ahead = np.stack([np.roll(logits, -j, axis=1) for j in range(n_lobes)], axis=1)
    return np.concatenate([np.zeros_like(ahead[:, :1]), np.cumsum(ahead, axis=1)], axis=1)


def log_counts(logits: Float, pattern: str) -> Float:
    """Logarithm of each count's probability up to a constant, shape (n_windows, n_lobes + 1)."""
    if pattern == "any":
        return np.asarray(np.log(symmetric(np.exp(logits))))
    return np.asarray(logsumexp(rows_of_neighbours(logits), axis=2))


def inclusion(logits: Float, pattern: str) -> Float:
    """Probability that lobe k is among n worn ones: shape (n_windows, n_lobes + 1 counts, n_lobes)."""
    n_lobes = logits.shape[1]
    if pattern == "any":
        odds = np.exp(logits)
        others = np.stack([np.delete(odds, k, axis=1) for k in range(n_lobes)], axis=1)
        # Sets of n lobes with lobe k: lobe k and n - 1 of the others.
        with_lobe = odds[:, :, np.newaxis] * symmetric(others)
        result = np.zeros((len(logits), n_lobes + 1, n_lobes))
        result[:, 1:] = with_lobe.transpose(0, 2, 1) / symmetric(odds)[:, 1:, np.newaxis]
        return result
    first = softmax(rows_of_neighbours(logits), axis=-1)
    result = np.zeros_like(first)
    for n in range(1, n_lobes + 1):
        result[:, n] = sum(np.roll(first[:, n], j, axis=1) for j in range(n))
    return result


def best_sets(logits: Float, counts: Int, pattern: str) -> Bool:
    """The most probable set of the given number of lobes, shape (n_windows, n_lobes)."""
    n_lobes = logits.shape[1]
    if pattern == "any":
        place = np.argsort(np.argsort(-logits, axis=1, kind="stable"), axis=1)
        return np.asarray(place < counts[:, np.newaxis])
    first = np.argmax(rows_of_neighbours(logits)[np.arange(len(logits)), counts], axis=1)
    return turned(np.arange(n_lobes) < counts[:, np.newaxis], first)
