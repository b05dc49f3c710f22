"""How far measured recordings are from a simulator's, in spreads of one recording, and from themselves."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cyclofeat.gap._summaries import RESOLUTION_NM, level, summarise_all

Float = NDArray[np.float64]
Int = NDArray[np.intp]

FAMILIES = ("spectrum", "orders", "averages", "amplitudes", "features")

_FAMILY_OF = {
    "slow part": "spectrum", "spectrum": "spectrum", "floor": "spectrum",
    "speed": "orders", "lobe lines": "orders", "shaft lines": "orders", "averages": "averages",
}  # fmt: skip
_SHAPE = "shape"
_SHARES = (np.arange(256) + 0.5) / 256  # of the quantile function, midpoints of equal parts
# The spread of a few measured recordings is steadied by the bank's, as by so many degrees of freedom (Smyth
# 2004): without it the cell whose few values happen to agree would decide the distance.
_STEADIED_BY = 4.0
# Two recordings say little of their spread, and drawing one of them less: counts with so few are pooled.
POOLED_BELOW = 3
_LEAST_SPREAD = 0.05  # of the median spread of the cells of the same part and unit


@dataclass(frozen=True)
class Part:
    """Where a number of the comparison belongs: cells of one part count alike, and parts of one family."""

    family: str
    name: str
    unit: str


def describe(
    X: NDArray[Any],
    sampling_rate: float,
    input_speed_hz: float,
    n_lobes: int = 15,
    speeds: Float | None = None,
) -> tuple[Float, list[Part]]:
    """The numbers per window that distances are made of.

    Parameters
    ----------
    X : ndarray, shape (n_windows, n_samples)
        Torque in Nm, at least one output turn each.
    sampling_rate, input_speed_hz, n_lobes, speeds
        As :func:`cyclofeat.gap.summarise` takes them.

    Returns
    -------
    values : ndarray, shape (n_windows, n_cells)
    parts : list of Part

    Notes
    -----
    The families of :func:`cyclofeat.gap.summarise` but for its amplitudes, in whose place stand the mean in
    Nm, the level of the ripple in dB and the quantile function of the standardised torque: the squared
    difference of two averaged quantile functions, averaged over the shares, is the squared Wasserstein
    distance of second order between the two distributions' barycentres.
    """
    summaries, cells = summarise_all(X, sampling_rate, input_speed_hz, n_lobes, speeds)
    kept = [k for k, cell in enumerate(cells) if cell.family != "amplitudes"]
    parts = [Part(_FAMILY_OF.get(cells[k].family, "features"), cells[k].family, cells[k].unit) for k in kept]
    parts += [Part("amplitudes", "mean", "Nm"), Part("amplitudes", "level", "dB")]
    parts += [Part("amplitudes", _SHAPE, "1")] * len(_SHARES)
    return np.hstack([summaries[:, kept], np.vstack([_amplitudes(x) for x in X])]), parts


def _amplitudes(x: NDArray[Any]) -> Float:
    torque: Float = np.asarray(x, dtype=np.float64)
    mean, variance = torque.mean(), torque.var() + RESOLUTION_NM**2
    shape = np.quantile((torque - mean) / np.sqrt(variance), _SHARES)
    return np.asarray(np.r_[mean, level(variance), shape])


def cell_weights(parts: list[Part]) -> Float:
    """Weight of each cell in each family's mean square, shape (n_families, n_cells); rows add up to one.

    Families are those of ``FAMILIES`` that occur, in that order. Parts of a family weigh the same.
    """
    rows = []
    for family in families_of(parts):
        names = sorted({part.name for part in parts if part.family == family})
        row = np.zeros(len(parts))
        for name in names:
            inside = np.array([part.family == family and part.name == name for part in parts])
            row[inside] = 1 / (len(names) * inside.sum())
        rows.append(row)
    return np.array(rows)


def families_of(parts: list[Part]) -> list[str]:
    """The families that occur, in the order of ``FAMILIES``."""
    return [family for family in FAMILIES if any(part.family == family for part in parts)]


def class_means(values: Float, counts: NDArray[Any]) -> dict[int, Float]:
    """Mean of each count."""
    return {int(count): values[counts == count].mean(axis=0) for count in np.unique(counts)}


def strata(counts: NDArray[Any], apart: NDArray[Any] | None = None, least: int = 2) -> Int:
    """Which recordings may take each other's place: those of one count, and all whose counts have few.

    Parameters
    ----------
    counts : ndarray of int, shape (n,)
    apart : ndarray, shape (n,), optional
        Recordings of several counts are pooled only where this is the same.
    least : int
        Counts with fewer recordings are pooled.

    Returns
    -------
    ndarray of int, shape (n,)
        From 0; pools come last.
    """
    alone = lone(counts, least)
    pools = np.zeros(len(counts)) if apart is None else np.asarray(apart)
    keys = [(int(a), float(p) if a else 0.0, 0 if a else int(c))
            for a, p, c in zip(alone, pools, counts, strict=True)]  # fmt: skip
    order = {key: k for k, key in enumerate(sorted(set(keys)))}
    return np.array([order[key] for key in keys], dtype=np.intp)


def lone(counts: NDArray[Any], least: int = 2) -> NDArray[np.bool_]:
    """Whether a recording is one of fewer than ``least`` of its count; by default the only one."""
    return np.array([np.sum(counts == count) < least for count in counts], dtype=bool)


def deviations(
    measured: Float, counts: NDArray[Any], simulated: Float, simulated_counts: NDArray[Any]
) -> tuple[Float, int]:
    """Deviations that replication leaves, and their degrees of freedom.

    A recording deviates from the mean of its count. One that is alone with its count deviates from the
    simulated mean of that count, less the mean of these differences over all that are alone: what the
    simulator misses in all counts alike is no replication, what it misses in some of them passes for it.

    Parameters
    ----------
    measured : ndarray, shape (n, n_cells)
    counts : ndarray of int, shape (n,)
    simulated : ndarray, shape (m, n_cells)
    simulated_counts : ndarray of int, shape (m,)

    Returns
    -------
    deviations : ndarray, shape (n, n_cells)
    n_free : int
    """
    found = measured.copy()
    alone = lone(counts)
    if alone.any():
        means = class_means(simulated, simulated_counts)
        found[alone] -= np.array([means[int(count)] for count in counts[alone]])
        # The simulated mean of M recordings has an error too, which is no spread of the measured one.
        sizes = np.array([np.sum(simulated_counts == count) for count in counts[alone]])
        found[alone] /= np.sqrt(1 + 1 / sizes)[:, None]
    n_free = 0
    groups = strata(counts)
    for group in np.unique(groups):
        inside = groups == group
        found[inside] -= found[inside].mean(axis=0)
        n_free += int(inside.sum()) - 1
    return found, n_free


def replicate_spread(
    measured: Float,
    counts: NDArray[Any],
    simulated: Float,
    simulated_counts: NDArray[Any],
    parts: list[Part],
) -> Float:
    """Standard deviation of one measured recording around its count, per cell.

    s^2 = (n_free v + 4 v_bank) / (n_free + 4), v the variance of :func:`deviations` and v_bank that of the
    simulated recordings around their counts. The cells of the shape of the amplitudes share their root mean
    square, so that theirs is a Wasserstein distance; no cell's is smaller than 1/20 of the median of its part
    and unit. Cells of a part and unit without any spread get infinity and play no part.

    Parameters
    ----------
    measured, counts, simulated, simulated_counts
        As in :func:`deviations`.
    parts : list of Part

    Returns
    -------
    ndarray, shape (n_cells,)
    """
    own, n_free = deviations(measured, counts, simulated, simulated_counts)
    of_bank = _variance_around(simulated, simulated_counts)
    variance = (np.sum(own**2, axis=0) + _STEADIED_BY * of_bank) / (n_free + _STEADIED_BY)
    spread: Float = np.sqrt(variance)
    shape = np.array([part.name == _SHAPE for part in parts])
    spread[shape] = np.sqrt(np.mean(variance[shape])) if shape.any() else 0.0
    kinds = np.array([f"{part.family}|{part.name}|{part.unit}" for part in parts])
    for kind in np.unique(kinds):
        inside = kinds == kind
        spread[inside] = np.maximum(spread[inside], _LEAST_SPREAD * np.median(spread[inside]))
    return np.where(spread > 0, spread, np.inf)


def _variance_around(values: Float, counts: NDArray[Any]) -> Float:
    """Variance around the means of the counts, per cell."""
    means = class_means(values, counts)
    around = values - np.array([means[int(count)] for count in counts])
    return np.asarray(np.sum(around**2, axis=0) / max(len(values) - len(means), 1))


def trends(counts: NDArray[Any]) -> Float:
    """What a difference may do from count to count: constant and, where there are two counts, linear.

    Parameters
    ----------
    counts : ndarray of int, shape (n,)

    Returns
    -------
    ndarray, shape (n_trends, n)
        q_j of each recording's count; orthonormal, (1/n) sum_i q_ji q_li = [j = l].
    """
    rows = [np.ones(len(counts))]
    slope = counts - np.mean(counts)
    if np.any(slope):
        rows.append(slope / np.sqrt(np.mean(slope**2)))
    return np.array(rows)


def distances(
    measured: Float,
    counts: NDArray[Any],
    simulated: Float,
    simulated_counts: NDArray[Any],
    spread: Float,
    weights: Float,
    chances: Float | None = None,
) -> Float:
    """Distance between measured and simulated recordings in each family.

    Each recording is compared with the simulated mean of its count, and of the differences the constant and
    the linear part over the counts are kept, so that what differs from count to count counts and yet many
    counts of few recordings each do not drown it in their noise:

    D_f^2 = sum_j sum_k w_fk a_jk^2 / s_k^2,  a_jk = (1/n) sum_i q_j(c_i) (x_ik - mean_c_i(simulated)_k).

    With all orthogonal functions q of the counts in place of two, this would be
    sum_c (n_c/n) sum_k w_fk (mean_c(measured)_k - mean_c(simulated)_k)^2 / s_k^2, which it is for one count
    and for two.

    Parameters
    ----------
    measured, counts, simulated, simulated_counts
        As in :func:`deviations`; every measured count is among the simulated ones.
    spread : ndarray, shape (n_cells,)
        s, of :func:`replicate_spread`.
    weights : ndarray, shape (n_families, n_cells)
        w, of :func:`cell_weights`.
    chances : ndarray, shape (n_draws, n), optional
        Weight of each recording, adding up to one. Default: one draw with equal weights.

    Returns
    -------
    ndarray, shape (n_draws, n_families)
    """
    n = len(measured)
    chances = np.full((1, n), 1 / n) if chances is None else chances
    means = class_means(simulated, simulated_counts)
    difference = (measured - np.array([means[int(count)] for count in counts])) / spread
    total = np.zeros((len(chances), len(weights)))
    for trend in trends(counts):
        total += ((chances * trend) @ difference) ** 2 @ weights.T
    return np.sqrt(total)


def bank_error(
    counts: NDArray[Any], simulated: Float, simulated_counts: NDArray[Any], spread: Float, weights: Float
) -> Float:
    """Expected squared distance by the error of the simulated means, shape (n_families,).

    sum_j sum_c (n_c/n)^2 q_j(c)^2 / M_c sum_k w_fk v_k / s_k^2, v the simulated recordings' variance around
    their counts.
    """
    share = 0.0
    rows = trends(counts)
    for count in np.unique(counts):
        inside = counts == count
        size = np.sum(simulated_counts == count)
        share += np.mean(inside) ** 2 / size * float(np.sum(rows[:, inside][:, 0] ** 2))
    return np.asarray(share * (weights @ (_variance_around(simulated, simulated_counts) / spread**2)))


def floors(
    own: Float,
    counts: NDArray[Any],
    spread: Float,
    weights: Float,
    n_inside: int,
    n_trends: int,
    of_bank: Float,
    n_free: int,
    n_splits: int,
    random: np.random.Generator,
) -> Float:
    """Distance that replication alone would leave, from measured half against measured half.

    The recordings of a count are split at random into halves of a and b recordings, whose means differ with
    variance s^2 (1/a + 1/b), 4 s^2/n for equal halves; recordings alone with their counts are paired, their
    deviations differing with 2 s^2. A coefficient of n measured recordings against a bank's means has the
    variance s^2/n and the bank's own, s^2/M for M recordings of one count. So each split gives

    D_f^2 = (J/n) mean_p [ c_p sum_k w_fk d_pk^2 / s_k^2 / v_p ] + bank_f,

    over as many pieces p (halved counts and pairs, drawn at random) as the distance has coefficients J, with
    v_p as above. The root is taken per split, as it is in the distance, and the floor is the mean over
    splits. The halves are what s was estimated from, means are independent of it: c_p of
    :func:`_studentised` makes up for that, and is 1 for pairs.

    Parameters
    ----------
    own : ndarray, shape (n_all, n_cells)
        Of :func:`deviations`, of all recordings.
    counts : ndarray of int, shape (n_all,)
    spread, weights
        As in :func:`distances`.
    n_inside : int
        n, recordings of the distance that the floor is for: all, or those of one condition.
    n_trends : int
        J, rows of :func:`trends` for these.
    of_bank : ndarray, shape (n_families,)
        bank_f, of :func:`bank_error` for these.
    n_free : int
        Of :func:`deviations`.
    n_splits : int
    random : numpy.random.Generator

    Returns
    -------
    ndarray, shape (n_families,)
    """
    groups, alone = strata(counts), lone(counts)
    scaled = own / spread
    independent = _studentised(n_free)
    total = np.zeros(len(weights))
    for _ in range(n_splits):
        pieces = []
        for group in np.unique(groups):
            members = random.permutation(np.flatnonzero(groups == group))
            if alone[members[0]]:
                pairs = members[: len(members) // 2 * 2].reshape(-1, 2)
                pieces += [(scaled[i] - scaled[j]) ** 2 / 2 for i, j in pairs]
            else:
                a = len(members) // 2
                half, rest = scaled[members[:a]].mean(axis=0), scaled[members[a:]].mean(axis=0)
                pieces.append(independent * (half - rest) ** 2 / (1 / a + 1 / (len(members) - a)))
        chosen = random.permutation(len(pieces))[:n_trends]
        mean = weights @ np.mean([pieces[k] for k in chosen], axis=0)
        total += np.sqrt(n_trends / n_inside * mean + of_bank)
    return total / n_splits


@functools.cache
def _studentised(n_free: int) -> float:
    """How much larger (d/s)^2 is expected to be where d is independent of s than where it went into s.

    With s^2 = (q + 4) / (n_free + 4) and q chi-squared with n_free degrees of freedom:
    E[1/s^2] / E[(q/n_free)/s^2] = n_free A / (1 - 4 A), A = E[1/(q + 4)].
    """
    if n_free < 1:
        return 1.0
    inverse = float(stats.chi2(n_free).expect(lambda q: 1 / (q + _STEADIED_BY)))
    return n_free * inverse / (1 - _STEADIED_BY * inverse)


def bootstrap_chances(groups: Int, n_draws: int, random: np.random.Generator) -> Float:
    """Weights of recordings in bootstrap draws, shape (n_draws, n), each row adding up to one.

    Random half-samples within strata (McCarthy 1969; Saigo, Shao and Sitter 2001): of n_h recordings a random
    a = n_h / 2 (rounded up or down) get the weight 1 + sqrt((n_h - a) / a), the others
    1 - sqrt(a / (n_h - a)), over n: 2 and 0 for equal halves. A mean then varies with s^2 / n_h, as it does,
    and every draw lies as far from the sample. Draws with replacement do not: the few recordings of some of
    them make the length of a vector of many cells vary far more than it does between samples. A stratum of
    one stays as it is.
    """
    n = len(groups)
    chances = np.full((n_draws, n), 1 / n)
    for group in np.unique(groups):
        members = np.flatnonzero(groups == group)
        size = len(members)
        if size == 1:
            continue
        ranks = random.permuted(np.tile(np.arange(size), (n_draws, 1)), axis=1)
        half = (size + random.integers(2, size=(n_draws, 1))) // 2
        drawn = np.where(ranks < half, np.sqrt((size - half) / half), -np.sqrt(half / (size - half)))
        chances[:, members] += drawn / n
    return chances


def floor_draws(
    own: Float, counts: NDArray[Any], spread: Float, weights: Float, floor: Float, chances: Float
) -> Float:
    """The floor of each family in bootstrap draws, shape (n_draws, n_families).

    It moves as the root of the drawn recordings' mean squared deviation does.
    """
    sizes = np.array([np.sum(strata(counts) == group) for group in strata(counts)])
    squares = ((own / spread) ** 2 @ weights.T) * (sizes / np.maximum(sizes - 1, 1))[:, None]
    mean = squares.mean(axis=0)
    # Half-samples give some recordings negative weight: a mean square below zero is none.
    drawn = np.maximum(chances @ squares, 0.0)
    return np.asarray(floor * np.sqrt(drawn / np.where(mean > 0, mean, 1.0)))


def centred(draws: Float, estimate: Float | float) -> Float:
    """Draws moved to the estimate: resampling adds noise of its own to every distance and lifts it."""
    return np.asarray(draws - draws.mean(axis=0) + estimate)


def gap_reduction(before: Any, after: Any, floor: Any) -> Any:
    """GRR = 1 - (after - floor) / (before - floor).

    Examples
    --------
    >>> gap_reduction(5.0, 1.0, 1.0)
    1.0
    """
    return 1 - (after - floor) / (before - floor)
