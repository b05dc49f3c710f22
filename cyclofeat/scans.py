"""Searches over many definitions of a feature, with what a search owes: how often chance alone finds as much.

Both searches of the papers are here: :func:`scan_wavelets` (paper B section 5 tried 130 wavelets) and
:func:`find_monotone_bands` (paper A fig. 19 shows the bands in which entropy falls with the count). Among
many wavelets, levels and bands some always follow the count, so every result carries a p-value by permutation
of the counts among assemblies. Where each disc was recorded once, class and recording are one thing: a split
of such data can tell recordings apart, not counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any

import joblib
import numpy as np
import pywt
from numpy.typing import ArrayLike, NDArray
from sklearn.utils import check_array, check_consistent_length, column_or_1d, gen_batches

from cyclofeat import lobes
from cyclofeat.features._minima_overlap import WaveletMinimaOverlap, _median_of_others
from cyclofeat.spectral import welch_psd
from cyclofeat.wavelets import AnyWavelet, dwt, morris_names, wavelet_qualifier

__all__ = ["MonotoneBands", "WaveletRow", "WaveletScan", "find_monotone_bands", "scan_wavelets"]

Float = NDArray[np.float64]

_CHUNK_SAMPLES = 2**20
_N_REFERENCES = 8
_N_INTERVALS = 64
_NO_GROUPS = (
    "groups must name the assembly of every window, got None: windows of one recording look alike for "
    "reasons that have nothing to do with wear, so without groups neither separability nor chance can be "
    "told. Pass the groups that Windower.transform returns"
)


@dataclass(frozen=True)
class WaveletRow:
    """One level of one wavelet in a :class:`WaveletScan`.

    Attributes
    ----------
    wavelet : str
        Name, or checksum of a filter bank.
    level : int
        Level of the transform, 1 for the highest frequencies.
    kendall : float
        Kendall's tau-b of the class means of the overlap with the count: 1 grows, -1 falls, at every step.
    strict : bool
        Whether the class means grow strictly.
    separability : float or None
        Omega squared: share of the variance among assemblies that the count explains, about 0 for counts that
        mean nothing, at most 1. None without groups.
    p_value : float or None
        How often permuted counts lead to a tau as high at any level of any wavelet. None without groups.
    class_means : tuple of float
        Mean overlap of each count, in the order of the scan's ``counts``.
    """

    wavelet: str
    level: int
    kendall: float
    strict: bool
    separability: float | None
    p_value: float | None
    class_means: tuple[float, ...]


@dataclass(frozen=True)
class WaveletScan:
    """Result of :func:`scan_wavelets`.

    Attributes
    ----------
    rows : tuple of WaveletRow
        One for each level of each wavelet, the most monotone first; of those equal in that, the most
        separable first.
    counts : tuple of float
        Defect counts, increasing.
    """

    rows: tuple[WaveletRow, ...] = field(repr=False)
    counts: tuple[float, ...]

    def sorted_by(self, column: str) -> list[WaveletRow]:
        """Rows by ``"kendall"`` or ``"separability"``, largest first, or by ``"p_value"``, smallest first.

        Raises
        ------
        ValueError
            For another column, and for one that a scan without groups does not have.
        """
        if column not in ("kendall", "separability", "p_value"):
            raise ValueError(f"column must be 'kendall', 'separability' or 'p_value', got {column!r}")
        if any(getattr(row, column) is None for row in self.rows):
            raise ValueError(f"this scan has no {column}: {_NO_GROUPS}")
        sign = 1 if column == "p_value" else -1
        return sorted(self.rows, key=lambda row: sign * getattr(row, column))

    def best_of_each(self) -> list[WaveletRow]:
        """The first row of each wavelet, in the order of the rows."""
        first: dict[str, WaveletRow] = {}
        for row in self.rows:
            first.setdefault(row.wavelet, row)
        return list(first.values())

    def records(self) -> list[dict[str, Any]]:
        """Rows as dicts, for ``pandas.DataFrame``."""
        return [asdict(row) for row in self.rows]


def scan_wavelets(
    X: ArrayLike,
    y: ArrayLike,
    *,
    sampling_rate: float,
    groups: ArrayLike | None = None,
    wavelets: str | Sequence[AnyWavelet] = "all",
    levels: int = 12,
    colours: int = 64,
    align: str = "energy",
    input_speed_hz: float = 500 / 60,
    n_lobes: int = 15,
    speed_tolerance: float = 0.015,
    n_permutations: int = 1000,
    random_state: int = 0,
    n_jobs: int = 1,
    progress: Callable[[int, int], object] | None = None,
) -> WaveletScan:
    """Rank wavelets by how the overlap of minima with the worst class's scalogram grows with the count.

    Paper B (section 5) looked at 130 wavelets and chose mb32.3 by eye. Here each level of each wavelet gets
    three numbers: how monotonically the class means of :class:`cyclofeat.features.WaveletMinimaOverlap` grow,
    how well the count explains the differences among assemblies, and how often chance does as well.

    Parameters
    ----------
    X : array-like, shape (n_windows, n_samples)
        Windows of torque in Nm.
    y : array-like, shape (n_windows,)
        Defect counts, at least two different ones; the largest is the reference.
    sampling_rate : float
        Samples per second in Hz.
    groups : array-like, shape (n_windows,), optional
        Assembly of each window: several recordings of one assembly are one group, and each class needs two at
        least. An assembly is then never compared with itself. Without groups the scan ranks by monotony
        alone, and claims neither separability nor significance: windows of one recording resemble each other
        and the reference that was taken from it.
    wavelets : "all" or sequence of wavelets, default="all"
        Names of PyWavelets or of the Morris family, wavelets, or filter banks. ``"all"``: every discrete
        wavelet of PyWavelets and the Morris family, 117 in all (with the duplicates that PyWavelets has: haar
        is db1).
    levels, colours, align, input_speed_hz, n_lobes, speed_tolerance
        As :class:`cyclofeat.features.WaveletMinimaOverlap` takes them.
    n_permutations : int, default=1000
        Number of permutations of the counts among assemblies, for the p-value; used with groups only.
    random_state : int, default=0
        Seed of the permutations.
    n_jobs : int, default=1
        Number of processes; -1 for all processors.
    progress : callable, optional
        Called after each wavelet with the number done and their total.

    Returns
    -------
    WaveletScan

    Raises
    ------
    ValueError
        If an argument is out of its range, ``y`` holds fewer than two counts, an assembly has windows of two
        counts, or a class has one assembly only.

    Notes
    -----
    Assemblies have equal weight in a class's mean; without groups, windows have. Up to eight windows of the
    worst class, of as many assemblies as possible, are the reference.

    p = (b + 1) / (m + 1), where in b of m permutations the largest tau of all levels of all wavelets is at
    least this one: a p-value that holds for the whole scan. Few counts cannot give a small one: three are in
    order by chance in one of six cases, at each level of each wavelet. Permuted counts keep the reference.

    Examples
    --------
    Noise, and a burst at each passage of one lobe that grows with the count:

    >>> import numpy as np
    >>> from cyclofeat.scans import scan_wavelets
    >>> rng = np.random.default_rng(0)
    >>> y, groups = np.repeat([1, 2, 3, 4, 5, 6], 2), np.arange(12)
    >>> slot = (rng.uniform(0, 2880, (12, 1)) + np.arange(11_520)) / 192 % 15
    >>> X = 22 + y[:, None] * np.exp(-(((slot - 3.5) * 8) ** 2)) + rng.normal(scale=0.02, size=slot.shape)
    >>> scan = scan_wavelets(X, y, sampling_rate=25_600, groups=groups, wavelets=["db3", "mb8.2"], levels=6)
    >>> row = scan.rows[0]
    >>> row.wavelet, row.level, row.kendall, row.strict, row.p_value < 0.05
    ('mb8.2', 4, 1.0, True, True)

    In pictures, on surrogate torque: ``examples/features/plot_scan_wavelets.py``.
    """
    windows: NDArray[Any] = check_array(X, dtype=[np.float64, np.float32])
    counts, labels = _counts(windows, y)
    tested = _wavelets(wavelets)
    members = np.flatnonzero(labels == len(counts) - 1)
    assembly, of_assembly = None, labels
    if groups is not None:
        assembly, of_assembly = _assemblies(windows, groups, labels)
        alone = [f"{count:g}" for k, count in enumerate(counts) if np.count_nonzero(of_assembly == k) < 2]
        if alone:
            raise ValueError(
                f"count {', '.join(alone)} has one assembly: what sets it apart may be that assembly and not "
                "its count. Separability needs two assemblies of each count; without groups the scan ranks "
                "by monotony alone"
            )
        # Windows that are neighbours in this order are of one assembly: equal distances reach most of them.
        members = members[np.argsort(assembly[members], kind="stable")]
    spread = np.linspace(0, len(members) - 1, min(_N_REFERENCES, len(members))).round().astype(int)
    chosen = members[spread]
    same = np.arange(len(windows)) if assembly is None else assembly
    left_out = same[:, np.newaxis] == same[chosen]

    parameters: dict[str, Any] = {
        "sampling_rate": sampling_rate,
        "levels": levels,
        "colours": colours,
        "align": align,
        "input_speed_hz": input_speed_hz,
        "n_lobes": n_lobes,
        "speed_tolerance": speed_tolerance,
    }
    first = WaveletMinimaOverlap(**parameters).fit(windows[chosen])
    found = first._lines(windows)
    done = joblib.Parallel(n_jobs=n_jobs, return_as="generator")(
        joblib.delayed(_overlaps)(wavelet, parameters, windows, chosen, left_out, found) for wavelet in tested
    )
    overlaps = []
    for number, overlap in enumerate(done, 1):
        overlaps.append(overlap)
        if progress is not None:
            progress(number, len(tested))
    of_windows = np.hstack(overlaps)
    units = of_windows if assembly is None else _means(of_windows, assembly)
    means = _means(units, of_assembly)
    kendall = _kendall(means)
    separability = p_value = None
    if assembly is not None:
        separability = _omega_squared(units, of_assembly)
        if n_permutations > 0:
            largest = np.array(
                [
                    _kendall(permuted).max()
                    for permuted in _permuted_means(units, of_assembly, n_permutations, random_state)
                ]
            )
            as_large = np.count_nonzero(largest[:, np.newaxis] >= kendall - 1e-12, axis=0)
            p_value = (as_large + 1) / (n_permutations + 1)
    rows = [
        WaveletRow(
            wavelet=wavelet_qualifier(tested[column // levels]),
            level=column % levels + 1,
            kendall=float(kendall[column]),
            strict=bool((np.diff(means[:, column]) > 0).all()),
            separability=None if separability is None else float(separability[column]),
            p_value=None if p_value is None else float(p_value[column]),
            class_means=tuple(means[:, column].tolist()),
        )
        for column in range(means.shape[1])
    ]
    rows.sort(key=lambda row: (-row.kendall, -(row.separability or 0.0)))
    return WaveletScan(tuple(rows), tuple(counts.tolist()))


def _wavelets(wavelets: str | Sequence[AnyWavelet]) -> list[AnyWavelet]:
    if isinstance(wavelets, str):
        if wavelets != "all":
            raise ValueError(f"wavelets must be 'all' or a sequence of wavelets, got {wavelets!r}")
        return [*morris_names(), *pywt.wavelist(kind="discrete")]
    if len(wavelets) == 0:
        raise ValueError("wavelets must be 'all' or a sequence of wavelets, got an empty one")
    return list(wavelets)


def _overlaps(
    wavelet: AnyWavelet,
    parameters: dict[str, Any],
    X: NDArray[Any],
    chosen: NDArray[np.intp],
    left_out: NDArray[np.bool_],
    found: lobes.LobeLines | None,
) -> Float:
    """Overlap of each window, shape (n_windows, levels), with those chosen that are not left out for it."""
    fitted = WaveletMinimaOverlap(wavelet=wavelet, **parameters).fit(X[chosen])
    rows = []
    for part in gen_batches(len(X), max(_CHUNK_SAMPLES // X.shape[1], 1)):
        windows = np.ascontiguousarray(X[part])
        lines = found and lobes.LobeLines(found.input_speed_hz[part], found.lines[part], found.floor[part])
        shared = fitted._shared(windows, dwt(windows, wavelet, fitted.levels), lines)
        rows.append(_median_of_others(shared, left_out[part]))
    return np.concatenate(rows)


def _counts(X: NDArray[Any], y: ArrayLike) -> tuple[Float, NDArray[np.intp]]:
    """Counts, increasing, and for each window which of them it has."""
    try:
        y = np.asarray(column_or_1d(y), dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"y must hold one defect count per window, as a number, got {y!r:.60}") from None
    check_consistent_length(X, y)
    counts, labels = np.unique(y, return_inverse=True)
    if len(counts) < 2 or not np.isfinite(counts).all():
        raise ValueError(f"y must hold at least two defect counts, finite, got {counts.tolist()}")
    return counts, labels


def _assemblies(
    X: NDArray[Any], groups: ArrayLike, labels: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Assembly of each window, and class of each assembly, both as indices."""
    given = column_or_1d(groups)
    check_consistent_length(X, given)
    names, assembly = np.unique(given, return_inverse=True)
    of_assembly = np.empty(len(names), dtype=np.intp)
    of_assembly[assembly] = labels
    mixed = np.flatnonzero(of_assembly[assembly] != labels)
    if mixed.size:
        raise ValueError(
            f"groups must name assemblies with one defect count each, but {given[mixed[0]]!r} has windows "
            "of two counts"
        )
    return assembly, of_assembly


def _means(values: Float, labels: NDArray[np.intp]) -> Float:
    """Mean of the rows of each label 0, 1, ..."""
    numbers = np.bincount(labels)
    sums = np.zeros((len(numbers), values.shape[1]))
    np.add.at(sums, labels, values)
    return sums / numbers[:, np.newaxis]


def _permuted_means(
    units: Float, labels: NDArray[np.intp], n_permutations: int, random_state: int
) -> Iterator[Float]:
    """Class means with the labels permuted among the rows, again and again."""
    rng = np.random.default_rng(random_state)
    for _ in range(n_permutations):
        yield _means(units, rng.permutation(labels))


def _kendall(means: Float) -> Float:
    """Kendall's tau-b of each column with the number of its row, 0 in columns of one value."""
    first, second = np.triu_indices(len(means), 1)
    signs = np.sign(means[second] - means[first])
    untied = np.count_nonzero(signs, axis=0)
    return np.asarray(signs.sum(axis=0) / np.sqrt(np.maximum(untied, 1) * len(first)))


def _omega_squared(units: Float, labels: NDArray[np.intp]) -> Float:
    """Share of the variance of each column that the labels explain, less what they would by chance."""
    means = _means(units, labels)
    within = np.sum((units - means[labels]) ** 2, axis=0)
    total = np.sum((units - units.mean(axis=0)) ** 2, axis=0)
    n_classes = len(means)
    mean_square = within / (len(units) - n_classes)
    explained = total - within - (n_classes - 1) * mean_square
    # A column of one value differs by rounding only.
    size = np.finfo(np.float64).eps * np.sum(units**2, axis=0)
    scale = total + mean_square
    return np.asarray(np.divide(explained, scale, out=np.zeros_like(scale), where=scale > size))


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
    counts, labels = _counts(windows, y)
    if groups is None and n_permutations > 0:
        raise ValueError(f"{_NO_GROUPS}, or n_permutations=0 for a list of bands without p-values")
    frequencies, psd = welch_psd(windows, sampling_rate, preset)
    limits = _edges(edges, sampling_rate)
    bands, entropies = _band_entropies(frequencies, psd, limits)
    if groups is not None:
        assembly, labels = _assemblies(windows, groups, labels)
        entropies = _means(entropies, assembly)
    width = np.diff(bands, axis=1)[:, 0]
    means = _means(entropies, labels)
    falling = _falls(means)
    p_number = p_widest = None
    if n_permutations > 0:
        number, widest = [], []
        for permuted in _permuted_means(entropies, labels, n_permutations, random_state):
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
