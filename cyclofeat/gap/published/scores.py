"""Scores and exact tests of a few rows of statistics."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Float = NDArray[np.float64]

STATISTICS = ("mean", "std", "up", "down")


def sign_flip_p(differences: ArrayLike, alternative: str = "two-sided") -> float:
    """Exact p of a mean of zero, if all signs of the differences are equally likely.

    It is the share of the 2^n sign patterns of up to 20 differences, one per independent unit, whose mean is
    at least as extreme (``"two-sided"`` or ``"greater"``), the observed one among them.

    Examples
    --------
    >>> sign_flip_p([0.4, 0.9, 0.1, 0.7, 0.5, 0.6, 0.3, 0.8])
    0.0078125
    """
    values = np.asarray(differences, dtype=np.float64)
    if values.ndim != 1 or not 1 <= values.size <= 20 or not np.isfinite(values).all():
        raise ValueError(f"differences must be 1 to 20 finite numbers, got {differences!r}")
    if alternative not in ("two-sided", "greater"):
        raise ValueError(f"alternative must be 'two-sided' or 'greater', got {alternative!r}")
    signs = 1 - 2 * ((np.arange(2**values.size)[:, None] >> np.arange(values.size)) & 1)
    sums = signs @ values
    observed = values.sum()
    if alternative == "two-sided":
        sums, observed = np.abs(sums), abs(observed)
    return float(np.mean(sums >= observed - 1e-12 * np.abs(values).sum()))


def fewest_units(alpha: float) -> int:
    """Fewest independent units whose one-sided :func:`sign_flip_p` can be as small as alpha.

    Examples
    --------
    >>> fewest_units(0.05)
    5
    """
    return next(n for n in itertools.count(1) if 2.0**-n <= alpha)


def to_statistics(values: Float, set_point: float) -> Float:
    """Return the four statistics by which discs are compared, from minimum, maximum, mean and std, (..., 4).

    Mean minus set-point in Nm, and the natural logarithms of standard deviation, largest excursion upward
    (maximum minus mean) and downward (mean minus minimum), each in Nm.
    """
    low, high, middle, spread = np.moveaxis(values, -1, 0)
    sizes = [np.log(np.maximum(x, 1e-9)) for x in (spread, high - middle, middle - low)]
    return np.stack([middle - set_point, *sizes], axis=-1)


def crps(samples: ArrayLike, observed: ArrayLike) -> Float:
    """Continuous ranked probability score E|X - y| - E|X - X'| / 2 of equally likely samples (..., n).

    Smaller is better; in the samples' unit (Gneiting and Raftery 2007, eq. 21).
    """
    ordered = np.sort(np.asarray(samples, dtype=np.float64), axis=-1)
    n = ordered.shape[-1]
    gaps = 2 * np.arange(1, n + 1) - n - 1
    distance = np.abs(ordered - np.asarray(observed)[..., np.newaxis]).mean(axis=-1)
    return np.asarray(distance - ordered @ gaps / n**2)


def student_samples(others: Float, n_samples: int) -> Float:
    """Return samples of Student's prediction of one more disc like the others."""
    n = len(others)
    shares = (np.arange(n_samples) + 0.5) / n_samples
    quantiles = stats.t.ppf(shares, n - 1)[:, np.newaxis] * np.sqrt(1 + 1 / n)
    return np.asarray(others.mean(axis=0) + quantiles * others.std(axis=0, ddof=1))
