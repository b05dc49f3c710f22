"""Search for wavelets and levels that follow the number of worn lobes (paper B section 5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import joblib
import numpy as np
import pywt
from numpy.typing import ArrayLike, NDArray
from sklearn.base import clone
from sklearn.utils import check_array, gen_batches

from cyclofeat._base.frames import frame
from cyclofeat.features import WaveletMinimaOverlap
from cyclofeat.scans._search import Search, assemblies, class_means, defect_counts, permuted_means
from cyclofeat.signal import lobes
from cyclofeat.signal.wavelets import AnyWavelet, morris_names, wavelet_qualifier
from cyclofeat.signal.windows import Float, ratio

if TYPE_CHECKING:
    import pandas as pd

_CHUNK_SAMPLES = 2**20
_N_REFERENCES = 8


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

    def to_frame(self) -> pd.DataFrame:
        """Return the rows as a data frame.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        return frame([asdict(row) for row in self.rows])


def scan_wavelets(
    X: ArrayLike,
    y: ArrayLike,
    overlap: WaveletMinimaOverlap,
    *,
    groups: ArrayLike | None = None,
    wavelets: str | Sequence[AnyWavelet] = "all",
    search: Search | None = None,
) -> WaveletScan:
    """Rank wavelets by how the overlap of minima with the worst class's scalogram grows with the count.

    Each level of each wavelet gets three numbers: how monotonically the class means of
    :class:`cyclofeat.features.WaveletMinimaOverlap` grow, how well the count explains the differences among
    assemblies, and how often chance does as well. Paper B (section 5) chose mb32.3 of 130 by eye.

    Parameters
    ----------
    X : array-like, shape (n_windows, n_samples)
        Windows of torque in Nm.
    y : array-like, shape (n_windows,)
        Defect counts, at least two different ones; the largest is the reference.
    overlap : WaveletMinimaOverlap
        All its parameters but ``wavelet`` and ``reference``; not fitted, not changed.
    groups : array-like, shape (n_windows,), optional
        Assembly of each window: several recordings of one assembly are one group, and each class needs two at
        least. An assembly is then never compared with itself. Without groups the scan ranks by monotony
        alone, and claims neither separability nor significance: windows of one recording resemble each other
        and the reference that was taken from it.
    wavelets : "all" or sequence of wavelets, default="all"
        Names of PyWavelets or of the Morris family, wavelets, or filter banks. ``"all"``: every discrete
        wavelet of PyWavelets and the Morris family, 117 in all (with the duplicates that PyWavelets has: haar
        is db1).
    search : Search, optional
        Permutations (with groups only), processes and progress. Default: ``Search()``.

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
    order by chance in one of six cases, at each level of each wavelet.

    Examples
    --------
    Noise, and a burst at each passage of one lobe that grows with the count:

    >>> import numpy as np
    >>> from cyclofeat.features import WaveletMinimaOverlap
    >>> from cyclofeat.scans import scan_wavelets
    >>> rng = np.random.default_rng(0)
    >>> y, groups = np.repeat([1, 2, 3, 4, 5, 6], 2), np.arange(12)
    >>> slot = (rng.uniform(0, 2880, (12, 1)) + np.arange(11_520)) / 192 % 15
    >>> X = 22 + y[:, None] * np.exp(-(((slot - 3.5) * 8) ** 2)) + rng.normal(scale=0.02, size=slot.shape)
    >>> overlap = WaveletMinimaOverlap(sampling_rate=25_600, levels=6)
    >>> scan = scan_wavelets(X, y, overlap, groups=groups, wavelets=["db3", "mb8.2"])
    >>> row = scan.rows[0]
    >>> row.wavelet, row.level, row.kendall, row.strict, row.p_value < 0.05
    ('mb8.2', 4, 1.0, True, True)

    In pictures, on surrogate torque: ``examples/features/plot_scan_wavelets.py``.
    """
    search = search or Search()
    windows: NDArray[Any] = check_array(X, dtype=[np.float64, np.float32])
    counts, labels = defect_counts(windows, y)
    tested = _wavelets(wavelets)
    members = np.flatnonzero(labels == len(counts) - 1)
    assembly, of_assembly = None, labels
    if groups is not None:
        assembly, of_assembly = assemblies(windows, groups, labels)
        _check_replicates(counts, of_assembly)
        # Windows that are neighbours in this order are of one assembly: equal distances reach most of them.
        members = members[np.argsort(assembly[members], kind="stable")]
    spread = np.linspace(0, len(members) - 1, min(_N_REFERENCES, len(members))).round().astype(int)
    chosen = members[spread]
    same = np.arange(len(windows)) if assembly is None else assembly
    left_out = same[:, np.newaxis] == same[chosen]
    fitted = clone(overlap).set_params(reference="worst").fit(windows[chosen])
    reference = _Reference(fitted, windows, chosen, left_out, fitted.lines(windows))
    done = joblib.Parallel(n_jobs=search.n_jobs, return_as="generator")(
        joblib.delayed(reference.overlaps)(wavelet) for wavelet in tested
    )
    overlaps = []
    for number, of_wavelet in enumerate(done, 1):
        overlaps.append(of_wavelet)
        if search.progress is not None:
            search.progress(number, len(tested))
    of_windows = np.hstack(overlaps)
    units = of_windows if assembly is None else class_means(of_windows, assembly)
    columns = [(wavelet, level + 1) for wavelet in tested for level in range(overlap.levels)]
    rows = _rows(columns, units, of_assembly, search if groups is not None else None)
    return WaveletScan(rows, tuple(counts.tolist()))


def _check_replicates(counts: Float, of_assembly: NDArray[np.intp]) -> None:
    alone = [f"{count:g}" for k, count in enumerate(counts) if np.count_nonzero(of_assembly == k) < 2]
    if alone:
        raise ValueError(
            f"count {', '.join(alone)} has one assembly: what sets it apart may be that assembly and not "
            "its count. Separability needs two assemblies of each count; without groups the scan ranks "
            "by monotony alone"
        )


def _rows(
    columns: Sequence[tuple[AnyWavelet, int]],
    units: Float,
    labels: NDArray[np.intp],
    search: Search | None,
) -> tuple[WaveletRow, ...]:
    """Rows of the scan, in order; ``search`` is None without groups."""
    means = class_means(units, labels)
    kendall = _kendall(means)
    separability = p_value = [None] * len(columns)
    if search is not None:
        separability = _omega_squared(units, labels).tolist()
    if search is not None and search.n_permutations > 0:
        largest = np.array([_kendall(by_chance).max() for by_chance in permuted_means(units, labels, search)])
        as_large = np.count_nonzero(largest[:, np.newaxis] >= kendall - 1e-12, axis=0)
        p_value = ((as_large + 1) / (search.n_permutations + 1)).tolist()
    rows = [
        WaveletRow(
            wavelet=wavelet_qualifier(wavelet),
            level=level,
            kendall=float(kendall[k]),
            strict=bool((np.diff(means[:, k]) > 0).all()),
            separability=separability[k],
            p_value=p_value[k],
            class_means=tuple(means[:, k].tolist()),
        )
        for k, (wavelet, level) in enumerate(columns)
    ]
    return tuple(sorted(rows, key=lambda row: (-row.kendall, -(row.separability or 0.0))))


def _wavelets(wavelets: str | Sequence[AnyWavelet]) -> list[AnyWavelet]:
    if isinstance(wavelets, str):
        if wavelets != "all":
            raise ValueError(f"wavelets must be 'all' or a sequence of wavelets, got {wavelets!r}")
        return [*morris_names(), *pywt.wavelist(kind="discrete")]
    if len(wavelets) == 0:
        raise ValueError("wavelets must be 'all' or a sequence of wavelets, got an empty one")
    return list(wavelets)


@dataclass(frozen=True)
class _Reference:
    """Windows of the scan, and the reference that they are compared with.

    ``left_out`` marks the windows of the reference that a window is not compared with.
    """

    overlap: WaveletMinimaOverlap
    windows: NDArray[Any]
    chosen: NDArray[np.intp]
    left_out: NDArray[np.bool_]
    lines: lobes.LobeLines | None

    def overlaps(self, wavelet: AnyWavelet) -> Float:
        """Overlap of each window by a wavelet, shape (n_windows, levels)."""
        X, lines = self.windows, self.lines
        fitted = clone(self.overlap).set_params(wavelet=wavelet).fit(X[self.chosen])
        rows = []
        for part in gen_batches(len(X), max(_CHUNK_SAMPLES // X.shape[1], 1)):
            of_part = lines and lines.part(part)
            rows.append(fitted.overlaps(np.ascontiguousarray(X[part]), self.left_out[part], of_part))
        return np.concatenate(rows)


def _kendall(means: Float) -> Float:
    """Kendall's tau-b of each column with the number of its row, 0 in columns of one value."""
    first, second = np.triu_indices(len(means), 1)
    signs = np.sign(means[second] - means[first])
    untied = np.count_nonzero(signs, axis=0)
    return np.asarray(signs.sum(axis=0) / np.sqrt(np.maximum(untied, 1) * len(first)))


def _omega_squared(units: Float, labels: NDArray[np.intp]) -> Float:
    """Share of the variance of each column that the labels explain, less what they would by chance."""
    means = class_means(units, labels)
    within = np.sum((units - means[labels]) ** 2, axis=0)
    total = np.sum((units - units.mean(axis=0)) ** 2, axis=0)
    n_classes = len(means)
    mean_square = within / (len(units) - n_classes)
    explained = total - within - (n_classes - 1) * mean_square
    # A column of one value differs by rounding only.
    size = np.finfo(np.float64).eps * np.sum(units**2, axis=0)
    scale = total + mean_square
    return ratio(explained, np.where(scale > size, scale, 0.0))
