"""Search for the bands in which spectral entropy falls with the number of worn lobes (paper A fig. 19)."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils import check_array

from cyclofeat.features import SpectralEntropy
from cyclofeat.scans._search import NO_GROUPS, Search, assemblies, class_means, defect_counts, permuted_means
from cyclofeat.signal import welch_psd
from cyclofeat.signal.windows import Float, ratio

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
    entropy: SpectralEntropy,
    *,
    groups: ArrayLike | None = None,
    edges: ArrayLike | None = None,
    search: Search | None = None,
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
    entropy : SpectralEntropy
        Sampling rate and definition of the density (``preset``); not fitted, not changed.
    groups : array-like, shape (n_windows,)
        Assembly of each window. Optional only without permutations.
    edges : array-like, shape (n_edges,), optional
        Limits of bands in Hz, increasing. Default: 64 equal steps from 0 to half of the sampling rate.
    search : Search, optional
        Permutations. Default: ``Search()``.

    Raises
    ------
    ValueError
        If an argument is out of its range, ``y`` holds fewer than two counts, ``groups`` are missing or an
        assembly has windows of two counts.

    Notes
    -----
    Among 2,080 bands some always fall: a list of bands proves nothing by itself. p = (b + 1) / (m + 1), where
    in b of m permutations of the counts among assemblies there are at least as many bands (``p_number``), or
    one at least as wide in Hz (``p_widest``). With one recording per count, a small p-value says that the
    discs are in this order, not that wear is the cause. Bands with fewer than two spectral lines do not
    count.

    Examples
    --------
    A tone above noise: the stronger it is, the lower the entropy in bands that hold it.

    >>> import numpy as np
    >>> from cyclofeat.features import SpectralEntropy
    >>> from cyclofeat.scans import find_monotone_bands
    >>> rng = np.random.default_rng(0)
    >>> y = np.repeat([1, 2, 3, 4], 2)
    >>> tone = np.sin(2 * np.pi * 3000 * np.arange(10_000) / 25_600)
    >>> X = 22 + rng.normal(size=(8, 10_000)) + 0.1 * np.outer(y, tone)
    >>> found = find_monotone_bands(X, y, SpectralEntropy(25_600, "ripple"), groups=np.arange(8))
    >>> found.n_tried, len(found.bands), found.bands[0], found.p_number < 0.05
    (2080, 813, array([    0., 12800.]), True)

    In pictures, on surrogate torque: ``examples/features/plot_monotone_bands.py``.
    """
    search = search or Search()
    windows: NDArray[Any] = check_array(X, dtype=[np.float64, np.float32])
    counts, labels = defect_counts(windows, y)
    if groups is None and search.n_permutations > 0:
        raise ValueError(f"{NO_GROUPS}, or search=Search(n_permutations=0) for bands without p-values")
    frequencies, psd = welch_psd(windows, entropy.sampling_rate, entropy.preset)
    limits = _edges(edges, entropy.sampling_rate)
    bands, entropies = _band_entropies(frequencies, psd, limits)
    if groups is not None:
        assembly, labels = assemblies(windows, groups, labels)
        entropies = class_means(entropies, assembly)
    width = np.diff(bands, axis=1)[:, 0]
    means = class_means(entropies, labels)
    falling = _falls(means)
    p_number = p_widest = None
    if search.n_permutations > 0:
        permuted = [_falls(by_chance) for by_chance in permuted_means(entropies, labels, search)]
        number = np.array([np.count_nonzero(falls) for falls in permuted])
        widest = np.array([width[falls].max(initial=0.0) for falls in permuted])
        p_number = _p_value(number, float(np.count_nonzero(falling)))
        p_widest = _p_value(widest, float(width[falling].max(initial=0.0)))
    order = np.flatnonzero(falling)
    order = order[np.argsort(-width[order], kind="stable")]
    return MonotoneBands(bands[order], means[:, order].T, counts, len(bands), p_number, p_widest)


def _p_value(by_chance: NDArray[Any], observed: float) -> float:
    return float((np.sum(by_chance >= observed) + 1) / (by_chance.size + 1))


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
        entropies.append(np.log2(power, out=np.zeros_like(power), where=power > 0) - ratio(term, power))
        bands += [(edges[first], upper) for upper in edges[first + 1 :][enough]]
    if not bands:
        raise ValueError(f"edges {edges.tolist()} Hz hold no band with two of the {frequencies.size} lines")
    return np.array(bands), np.hstack(entropies)
