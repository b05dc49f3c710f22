"""Positions of worn lobes: when they pass, rows of neighbours, sets, and views of the fold from each lobe."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from sklearn.linear_model import LogisticRegression

from cyclofeat.counting.estimators.trees import CountingTrees
from cyclofeat.signal import lobes
from cyclofeat.signal.windows import Bool, Complex, Float, Int

# Points of each slot in fine views.
_POINTS = 8
# Number of places within a lobe at which the first slot may begin, if there is no tachometer.
_PLACES = 8
# Class of a view that begins between two lobes (sound is 0, worn 1), and how far between.
_BETWEEN, _BESIDE = 2, (0.25, 0.75)
# Shares of trees are limited to this distance from 0 and 1.
_LEAST_SHARE = 1e-3


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


def coarse_views(lines: Complex, begins: Float, n_lobes: int) -> Float:
    """Return mean and spread of each slot, turned to each lobe, (n_windows * n_lobes, 2 * n_lobes)."""
    folded = lobes.fold(lobes.shift(lines, begins), n_lobes)
    return _turn(np.stack([folded.mean(axis=2), folded.std(axis=2)], axis=1))


def fine_views(lines: Complex, begins: Float, n_lobes: int) -> Float:
    """Return the fold at unit spread, turned to each lobe, (n_windows * n_lobes, n_points * n_lobes)."""
    folded = lobes.fold(lobes.shift(lines, begins), n_lobes, 16)
    points = folded.reshape(len(lines), n_lobes, _POINTS, -1).mean(axis=3)
    scale = points.std(axis=(1, 2), keepdims=True)
    points = np.divide(points, scale, out=np.zeros_like(points), where=scale > 0)
    return _turn(points.transpose(0, 2, 1))


def _turn(slots: Float) -> Float:
    """Turn slots, (n_windows, n_values, n_lobes), until each comes first."""
    n_windows, n_values, n_lobes = slots.shape
    turn = (np.arange(n_lobes) + np.arange(n_lobes)[:, np.newaxis]) % n_lobes
    views = np.ascontiguousarray(slots[:, :, turn].transpose(0, 2, 1, 3))
    return views.reshape(n_windows * n_lobes, n_values * n_lobes)


def views_to_learn(lines: Complex, begins: Float, worn: Bool, random_state: int) -> tuple[Float, Int]:
    """Return fine views for training, and their classes: sound lobe, worn lobe, between two lobes."""
    n_lobes = worn.shape[1]
    beside = begins + np.random.default_rng(random_state).uniform(*_BESIDE, len(lines)) / n_lobes
    views = np.concatenate([fine_views(lines, at, n_lobes) for at in (begins, beside)])
    return views, np.concatenate([worn.ravel().astype(int), np.full(worn.size, _BETWEEN)])


def lobe_logits(trees: CountingTrees, lines: Complex, begins: Float, n_lobes: int) -> tuple[Float, Float]:
    """Return logits of lobes, (n_windows, n_lobes), and log-likelihood of their beginning, (n_windows,)."""
    proba = trees.predict_proba(fine_views(lines, begins, n_lobes)).reshape(len(lines), n_lobes, 3)
    sound, worn, between = np.log(np.maximum(proba, _LEAST_SHARE)).transpose(2, 0, 1)
    return worn - sound, np.logaddexp(sound, worn).sum(axis=1) - between.sum(axis=1)


def logits_anywhere(trees: CountingTrees, lines: Complex, n_lobes: int) -> Float:
    """Return the logits of the lobes for the most likely beginning of the slots."""
    places = np.arange(_PLACES) / (_PLACES * n_lobes)
    answers = [lobe_logits(trees, lines, np.full(len(lines), place), n_lobes) for place in places]
    best = np.argmax([likelihood for _, likelihood in answers], axis=0)
    return np.asarray(np.stack([logits for logits, _ in answers])[best, np.arange(len(lines))])


def platt_calibration(logits: Float, worn: Bool) -> Float:
    """Return intercept and slope of the logistic regression of worn lobes on held-out logits (Platt)."""
    held_out = np.isfinite(logits)
    if not held_out.any() or worn[held_out].min() == worn[held_out].max():
        return np.array([0.0, 1.0])
    fitted = LogisticRegression(C=1e3).fit(logits[held_out][:, np.newaxis], worn[held_out])
    return np.array([fitted.intercept_[0], max(fitted.coef_[0, 0], 0.0)])
