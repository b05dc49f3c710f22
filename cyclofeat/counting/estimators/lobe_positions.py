"""Positions of worn lobes: when they pass, rows of neighbours, and sets from the logit of each lobe."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat.counting.evaluation.assembly_folds import Float, Int

Bool = NDArray[np.bool_]


def passage_of_lobe_zero(start_angle: ArrayLike, n_lobes: int = 15) -> Float:
    """Return when lobe 0 passes the cam's direction, for windows that start at an absolute input angle.

    In the wheel's frame the cam points in direction (z_k phi + pi)/z_s, at the tip of lobe l at 2 pi l/z_s.

    Parameters
    ----------
    start_angle : array-like, shape (n_windows,)
        Input angle phi in rad at the first sample.
    n_lobes : int
        Number of lobes z_s.

    Returns
    -------
    ndarray, shape (n_windows,)
        Time from the first sample in periods of the lobe frequency, from 0 to 1.
    """
    phi = np.asarray(start_angle, dtype=float)
    cam_in_wheel = ((n_lobes + 1) * phi + np.pi) / n_lobes
    return np.asarray(-cam_in_wheel / (2 * np.pi) % 1.0)


def row_starts(worn: Bool) -> Bool:
    """Mark the first lobe of each row of worn neighbours, shape (n_windows, n_lobes)."""
    return np.asarray(worn & ~np.roll(worn, 1, axis=1))


def lobes_apart(worn: Bool) -> bool:
    """Return True if the worn lobes of any window are more than one row of neighbours."""
    return bool((row_starts(worn).sum(axis=1) > 1).any())


def log_counts(logits: Float) -> Float:
    """Return the logarithm of each count's probability up to a constant, shape (n_windows, n_lobes + 1).

    Lobes are independent: the sum over all sets of a count is an elementary symmetric polynomial of the odds.
    """
    odds = np.exp(logits)
    sums = np.zeros((len(odds), odds.shape[1] + 1))
    sums[:, 0] = 1.0
    for k in range(odds.shape[1]):
        sums[:, 1:] += odds[:, k, np.newaxis] * sums[:, :-1]
    return np.asarray(np.log(sums))


def best_sets(logits: Float, counts: Int, pattern: str) -> Bool:
    """Return the most probable set of the given number of lobes, shape (n_windows, n_lobes).

    ``pattern`` is "any", or "consecutive" for rows of neighbours only.
    """
    n_windows, n_lobes = logits.shape
    if pattern == "any":
        place = np.argsort(np.argsort(-logits, axis=1, kind="stable"), axis=1)
        return np.asarray(place < counts[:, np.newaxis])
    # Sums of the logits of the n neighbours from lobe k on, (n_windows, n_lobes + 1 counts, n_lobes).
    ahead = np.stack([np.roll(logits, -j, axis=1) for j in range(n_lobes)], axis=1)
    rows = np.concatenate([np.zeros_like(ahead[:, :1]), np.cumsum(ahead, axis=1)], axis=1)
    first = np.argmax(rows[np.arange(n_windows), counts], axis=1)
    behind = (np.arange(n_lobes) - first[:, np.newaxis]) % n_lobes
    return np.asarray(behind < counts[:, np.newaxis])
