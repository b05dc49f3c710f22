"""Scores of a counter's answers with their intervals: pure functions.

Every score is a ratio of sums over the windows of each assembly, so that a bootstrap over assemblies only
draws rows of these sums.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cyclofeat.signal.windows import Float, Int

Interval = tuple[float, float]
#: Number of bins of the confidence from 0 to 1.
N_BINS = 10
# Draws over assemblies of a bootstrap.
_N_DRAWS = 1000


def rule_of_three(n: int, confidence: float) -> float:
    """Return the largest share compatible with none among ``n``: 1 - (1 - confidence)^(1/n), about 3/n."""
    return float(1 - (1 - confidence) ** (1 / n))


def sums_by_assembly(values: NDArray[np.generic], member: Int) -> Float:
    """Sum over the windows of each assembly: (n_assemblies, ...) of (n_windows, ...)."""
    values = np.asarray(values, dtype=np.float64)
    result = np.zeros((int(member.max()) + 1, *values.shape[1:]))
    np.add.at(result, member, values)
    return result


def bootstrap_weights(n_assemblies: int, random_state: int | None) -> Int:
    """Return how many times each draw of a bootstrap takes each assembly, shape (1000, n_assemblies)."""
    random = np.random.default_rng(random_state)
    drawn = random.integers(n_assemblies, size=(_N_DRAWS, n_assemblies))
    return np.stack([np.bincount(row, minlength=n_assemblies) for row in drawn])


def bootstrap_interval(
    score: Callable[[Float], Float], sums: Float, drawn: Int, confidence: float
) -> tuple[float, Interval]:
    """A score of all assemblies and its percentile interval.

    ``score`` turns sums over assemblies, shape (..., n_sums), into scores, shape (...).
    """
    tail = 100 * (1 - confidence) / 2
    resampled = score(drawn @ sums)
    low, high = np.percentile(resampled[np.isfinite(resampled)], [tail, 100 - tail])
    return float(score(sums.sum(axis=0))), (float(low), float(high))


def window_weights(member: Int) -> Float:
    """Return weights of the windows with sum 1 for each assembly."""
    return np.asarray(1.0 / np.bincount(member)[member])


def ratio_of_sums(sums: Float) -> Float:
    """First of two sums over the second."""
    top, bottom = sums[..., 0], sums[..., 1]
    return np.asarray(np.divide(top, bottom, out=np.full(np.shape(top), np.nan), where=bottom > 0))


def limits_at_ends(value: float, limits: Interval, n: int, confidence: float) -> Interval:
    """Return the interval of a share: at 0 and 1, where a bootstrap has no spread, by the rule of three."""
    if value >= 1:
        return 1 - rule_of_three(n, confidence), 1.0
    if value <= 0:
        return 0.0, rule_of_three(n, confidence)
    return limits


def macro_f1(cells: Float) -> Float:
    """Mean over classes of F1, from confusion matrices (..., n_classes, n_classes); absent ones left out."""
    hits = np.diagonal(cells, axis1=-2, axis2=-1)
    both = cells.sum(axis=-1) + cells.sum(axis=-2)
    f1 = np.divide(2 * hits, both, out=np.full(hits.shape, np.nan), where=both > 0)
    return np.asarray(np.nanmean(f1, axis=-1))


def confusion_interval(cells: Int, drawn: Int, confidence: float) -> Float:
    """Return both ends of the share of each class predicted as each, from (n_assemblies, n, n) counts."""
    tables = np.tensordot(drawn, cells, axes=1)
    of_class = tables.sum(axis=2, keepdims=True)
    parts = np.divide(tables, of_class, out=np.zeros(tables.shape), where=of_class > 0)
    tail = 100 * (1 - confidence) / 2
    return np.asarray(np.percentile(parts, [tail, 100 - tail], axis=0))


def calibration_sums(confidence: Float, right: NDArray[np.bool_], weight: Float, member: Int) -> Float:
    """Sums of each assembly by bin of the confidence: of confidence, of hits and of weights."""
    at = np.minimum((confidence * N_BINS).astype(int), N_BINS - 1)
    cells = np.zeros((len(confidence), 3, N_BINS))
    rows = np.arange(len(confidence))
    for k, values in enumerate((confidence, right.astype(float), np.ones(len(confidence)))):
        cells[rows, k, at] = weight * values
    return sums_by_assembly(cells.reshape(len(confidence), -1), member)


def expected_calibration_error(sums: Float) -> Float:
    """Mean over bins of |confidence - accuracy|, weighted by the bins' share; of :func:`calibration_sums`."""
    said, was, weight = np.moveaxis(sums.reshape(*sums.shape[:-1], 3, N_BINS), -2, 0)
    return np.asarray(np.abs(said - was).sum(axis=-1) / weight.sum(axis=-1))
