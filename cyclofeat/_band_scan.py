"""In which bands the spectral entropy falls with the number of worn lobes (paper A fig. 19)."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils import check_array

from cyclofeat._search import NO_GROUPS, assemblies, class_means, defect_counts, permuted_means
from cyclofeat.spectral import welch_psd

Float = NDArray[np.float64]
_N_INTERVALS = 64


@dataclass(frozen=True)
class MonotoneBands:
    """Result of :func:`find_monotone_bands`.

    Attributes
    ----------
    bands : ndarray, shape (n_found, 2)
        Lower and upper limits in Hz of the bands found, both included, the widest first.
    entropies : ndarray, shape (n_found, n_counts)
        Mean entropy in bits of each count in each band.
    counts : ndarray, shape (n_counts,)
        Defect counts, increasing.
    n_tried : int
        Number of bands on the grid.
    p_number : float or None
        How often permuted counts give as many bands. None without permutations.
    p_widest : float or None
        How often permuted counts give a band as wide as the widest. None without permutations.
    """

    bands: Float = field(repr=False)
    entropies: Float = field(repr=False)
    counts: Float
    n_tried: int
    p_number: float | None
    p_widest: float | None


def find_monotone_bands(
    X: ArrayLike,
    y: ArrayLike,
    *,
    sampling_rate: float,
    groups: ArrayLike | None = None,
    preset: str = "matlab_pwelch",
    edges: ArrayLike | None = None,
    n_permutations: int = 1000,
    random_state: int = 0,
) -> MonotoneBands:
    """Find the bands in which Shannon entropy falls strictly with the defect count (paper A fig. 19).

    Every pair of edges is a band. In each, the entropies of the windows are averaged per assembly and then
    per count; the band is found if these means fall at every step.

    Parameters
    ----------
    X : array-like, shape (n_windows, n_samples)
        Windows of torque in Nm.
    y : array-like, shape (n_windows,)
        Defect counts, at least two different ones. Paper A leaves out the healthy disc, whose entropy is the
        lowest: leave its windows out to do the same.
    sampling_rate : float
        Samples per second in Hz.
    groups : array-like, shape (n_windows,)
        Assembly of each window. May be left out with ``n_permutations=0`` only.
    preset : str, default="matlab_pwelch"
        Definition of the density, a name in :data:`cyclofeat.spectral.PRESETS`.
    edges : array-like, shape (n_edges,), optional
        Limits of bands in Hz, increasing. Default: 64 equal steps from 0 to half of the sampling rate.
    n_permutations : int, default=1000
        Number of permutations of the counts among assemblies; 0 for none.
    random_state : int, default=0
        Seed of the permutations.

    Returns
    -------
    MonotoneBands

    Raises
    ------
    ValueError
        If an argument is out of its range, ``y`` holds fewer than two counts, ``groups`` are missing or an
        assembly has windows of two counts.

    Notes
    -----
    Among 2,080 bands some always fall, and neighbours fall together: a list of bands proves nothing by
    itself. p = (b + 1) / (m + 1), where in b of m permutations of the counts among assemblies there are at
    least as many bands (``p_number``), or one at least as wide in Hz (``p_widest``). With one recording per
    count, a small p-value says that the discs are in this order, not that wear put them there. Bands with
    fewer than two spectral lines are left out.

    Examples
    --------
    A tone above noise: the stronger it is, the lower the entropy in bands that hold it.

    >>> import numpy as np
    >>> from cyclofeat.scans import find_monotone_bands
    >>> rng = np.random.default_rng(0)
    >>> y = np.repeat([1, 2, 3, 4], 2)
    >>> tone = np.sin(2 * np.pi * 3000 * np.arange(10_000) / 25_600)
    >>> X = 22 + rng.normal(size=(8, 10_000)) + 0.1 * np.outer(y, tone)
    >>> found = find_monotone_bands(X, y, sampling_rate=25_600, groups=np.arange(8), preset="ripple")
    >>> found.n_tried, len(found.bands), found.bands[0], found.p_number < 0.05
    (2080, 813, array([    0., 12800.]), True)

    In pictures, on surrogate torque: ``examples/features/plot_monotone_bands.py``.
    """
    windows: NDArray[Any] = check_array(X, dtype=[np.float64, np.float32])
    counts, labels = defect_counts(windows, y)
    if groups is None and n_permutations > 0:
        raise ValueError(f"{NO_GROUPS}, or n_permutations=0 for a list of bands without p-values")
    frequencies, psd = welch_psd(windows, sampling_rate, preset)
    limits = _edges(edges, sampling_rate)
    bands, entropies = _band_entropies(frequencies, psd, limits)
    if groups is not None:
        assembly, labels = assemblies(windows, groups, labels)
        entropies = class_means(entropies, assembly)
    width = np.diff(bands, axis=1)[:, 0]
    means = class_means(entropies, labels)
    falling = _falls(means)
    p_number = p_widest = None
    if n_permutations > 0:
        number, widest = [], []
        for permuted in permuted_means(entropies, labels, n_permutations, random_state):
            by_chance = _falls(permuted)
            number.append(np.count_nonzero(by_chance))
            widest.append(width[by_chance].max(initial=0.0))
        p_number = float((np.sum(np.array(number) >= np.count_nonzero(falling)) + 1) / (n_permutations + 1))
        observed = width[falling].max(initial=0.0)
        p_widest = float((np.sum(np.array(widest) >= observed) + 1) / (n_permutations + 1))
    order = np.flatnonzero(falling)
    order = order[np.argsort(-width[order], kind="stable")]
    return MonotoneBands(bands[order], means[:, order].T, counts, len(bands), p_number, p_widest)


def _falls(means: Float) -> NDArray[np.bool_]:
    return np.asarray((np.diff(means, axis=0) < 0).all(axis=0))


def _edges(edges: ArrayLike | None, sampling_rate: float) -> Float:
    if edges is None:
        return np.linspace(0, sampling_rate / 2, _N_INTERVALS + 1)
    limits = np.asarray(edges, dtype=np.float64)
    inside = limits.ndim == 1 and limits.size >= 2 and limits[0] >= 0 and limits[-1] <= sampling_rate / 2
    if not (inside and (np.diff(limits) > 0).all()):
        raise ValueError(
            f"edges must be at least two increasing frequencies from 0 to {sampling_rate / 2:g} Hz (half of "
            f"sampling_rate), got {edges!r:.80}"
        )
    return limits


def _band_entropies(frequencies: Float, psd: Float, edges: Float) -> tuple[Float, Float]:
    """Bands of two lines and more between any two edges, and their entropies, shape (n_windows, n_bands).

    H = log2(S) - T / S with S = sum(P), T = sum(P log2(P)): sums over the steps between edges give the sums
    over all bands. A band's sums are of terms of its own, never differences of larger ones.
    """
    low = np.searchsorted(frequencies, edges, side="left")
    high = np.searchsorted(frequencies, edges, side="right")  # limits are included
    terms = np.stack([psd, psd * np.log2(psd, out=np.zeros_like(psd), where=psd > 0)])
    steps = np.stack([terms[..., i:j].sum(axis=-1) for i, j in pairwise(low)], axis=-1)
    on_edge = np.stack([terms[..., i:j].sum(axis=-1) for i, j in zip(low, high, strict=True)], axis=-1)
    bands, entropies = [], []
    for first in range(len(edges) - 1):
        enough = high[first + 1 :] - low[first] >= 2
        power, term = (np.cumsum(steps[..., first:], axis=-1) + on_edge[..., first + 1 :])[..., enough]
        inside = power > 0
        quotient = np.divide(term, power, out=np.zeros_like(power), where=inside)
        entropies.append(np.log2(power, out=np.zeros_like(power), where=inside) - quotient)
        bands += [(edges[first], upper) for upper in edges[first + 1 :][enough]]
    if not bands:
        raise ValueError(f"edges {edges.tolist()} Hz hold no band with two of the {frequencies.size} lines")
    return np.array(bands), np.hstack(entropies)
