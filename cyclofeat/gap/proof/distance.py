"""Distances between measured and simulated recordings, and the floor that replication leaves."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cyclofeat.gap.summaries.summarise import RESOLUTION_NM, Cell, Kinematics, level_db, summarise_windows
from cyclofeat.gap.summaries.turns import class_means, less_class_means

Float = NDArray[np.float64]
Int = NDArray[np.intp]

FAMILIES = ("spectrum", "orders", "averages", "amplitudes", "features")

_FAMILY_OF = {
    "slow part": "spectrum", "spectrum": "spectrum", "floor": "spectrum",
    "speed": "orders", "lobe lines": "orders", "shaft lines": "orders", "averages": "averages",
}  # fmt: skip
_SHAPE = "shape"
_SHARES = (np.arange(256) + 0.5) / 256  # probabilities of the quantile function
# The variance of the bank counts as this many degrees of freedom in that of few measured recordings (Smyth
# 2004): otherwise cells whose few values happen to agree would dominate the distance.
_STEADIED_BY = 4.0
# Counts with fewer recordings than this are pooled: two do not determine a spread.
POOLED_BELOW = 3
_LEAST_SPREAD = 0.05  # least spread, as a share of the median of the cells of the same part and unit


class Sample(NamedTuple):
    """Recordings: values, shape (n, n_cells), and their counts, shape (n,)."""

    values: Float
    counts: NDArray[Any]


class Scale(NamedTuple):
    """Spread of one recording, shape (n_cells,), and weights of :func:`cell_weights`."""

    spread: Float
    weights: Float


class Deviations(NamedTuple):
    """Deviations between replicates, shape (n, n_cells), counts, and degrees of freedom."""

    values: Float
    counts: NDArray[Any]
    n_free: int


def proof_cells(
    X: NDArray[Any], kinematics: Kinematics, speeds: Float | None = None
) -> tuple[Float, list[Cell]]:
    """Return the numbers of each window for the distances, (n_windows, n_cells), and the part of each cell.

    Cells of one part, described like a cell, have equal weights, as have the parts of one family. They are
    those of :func:`summarise_windows`, but amplitudes are the mean in Nm, the level of the ripple in dB and
    the quantile function of the standardised torque: the mean squared difference of two averaged quantile
    functions is the squared Wasserstein distance of second order between the distributions' barycentres.
    """
    summaries, cells = summarise_windows(X, kinematics, speeds)
    kept = [k for k, cell in enumerate(cells) if cell.family != "amplitudes"]
    parts = [Cell(_FAMILY_OF.get(cells[k].family, "features"), cells[k].family, cells[k].unit) for k in kept]
    parts += [Cell("amplitudes", "mean", "Nm"), Cell("amplitudes", "level", "dB")]
    parts += [Cell("amplitudes", _SHAPE, "1")] * len(_SHARES)
    return np.hstack([summaries[:, kept], np.vstack([_amplitude_cells(x) for x in X])]), parts


def _amplitude_cells(x: NDArray[Any]) -> Float:
    torque: Float = np.asarray(x, dtype=np.float64)
    mean, variance = torque.mean(), torque.var() + RESOLUTION_NM**2
    shape = np.quantile((torque - mean) / np.sqrt(variance), _SHARES)
    return np.asarray(np.r_[mean, level_db(variance), shape])


def cell_weights(parts: list[Cell]) -> Float:
    """Weight of each cell in its family, (n_families, n_cells); parts of a family weigh the same."""
    members = [[(part.family, part.name) == (other.family, other.name) for other in parts] for part in parts]
    n_parts = {family: len({p.name for p in parts if p.family == family}) for family in families_of(parts)}
    weights = 1 / (np.array([n_parts[part.family] for part in parts]) * np.sum(members, axis=1))
    return np.array([np.where([p.family == name for p in parts], weights, 0.0) for name in n_parts])


def families_of(parts: list[Cell]) -> list[str]:
    """The families that occur, in the order of ``FAMILIES``."""
    return [family for family in FAMILIES if any(part.family == family for part in parts)]


def number_strata(counts: NDArray[Any], apart: NDArray[Any] | None = None, least: int = 2) -> Int:
    """Number strata of recordings: of one count, or of counts with fewer than ``least``, ``apart`` or not."""
    alone = lone_recordings(counts, least)
    pools = np.zeros(len(counts)) if apart is None else np.asarray(apart)
    keys = [(int(a), float(p) if a else 0.0, 0 if a else int(c))
            for a, p, c in zip(alone, pools, counts, strict=True)]  # fmt: skip
    order = {key: k for k, key in enumerate(sorted(set(keys)))}
    return np.array([order[key] for key in keys], dtype=np.intp)


def lone_recordings(counts: NDArray[Any], least: int = 2) -> NDArray[np.bool_]:
    """Mask of recordings whose count has fewer than ``least`` recordings, by default one."""
    return np.array([np.sum(counts == count) < least for count in counts], dtype=bool)


def replicate_deviations(measured: Sample, simulated: Sample) -> Deviations:
    """Return the deviations between replicates, from the mean of their count.

    For the only recording of a count they are taken from the simulated mean, less the mean of such
    differences: an error of the simulator that is equal in all counts drops out, one in single counts does
    not.
    """
    values, counts = measured.values.copy(), measured.counts
    alone = lone_recordings(counts)
    if alone.any():
        means = class_means(simulated.values, simulated.counts)
        values[alone] = less_class_means(values[alone], counts[alone], means)
        # Correct for the error of the simulated mean of M recordings.
        sizes = np.array([np.sum(simulated.counts == count) for count in counts[alone]])
        values[alone] /= np.sqrt(1 + 1 / sizes)[:, None]
    groups = number_strata(counts)
    values = less_class_means(values, groups, class_means(values, groups))
    return Deviations(values, counts, len(groups) - len(np.unique(groups)))


def replicate_spread(measured: Sample, simulated: Sample, parts: list[Cell]) -> Float:
    """Standard deviation of one measured recording around its count, shape (n_cells,).

    s^2 = (n_free v + 4 v_bank) / (n_free + 4), with the variances v of :func:`replicate_deviations` and
    v_bank of simulated recordings around their counts. Cells of the shape of the amplitudes share their root
    mean square, so that their distance is a Wasserstein distance. No spread is smaller than 1/20 of the
    median of its part and unit; where that is 0, cells get infinity and are ignored.
    """
    of_measured = replicate_deviations(measured, simulated)
    squares, of_bank = np.sum(of_measured.values**2, axis=0), _variance_around(simulated)
    variance = (squares + _STEADIED_BY * of_bank) / (of_measured.n_free + _STEADIED_BY)
    spread: Float = np.sqrt(variance)
    shape = np.array([part.name == _SHAPE for part in parts])
    spread[shape] = np.sqrt(np.mean(variance[shape])) if shape.any() else 0.0
    kinds = np.array([f"{part.family}|{part.name}|{part.unit}" for part in parts])
    for kind in np.unique(kinds):
        inside = kinds == kind
        spread[inside] = np.maximum(spread[inside], _LEAST_SPREAD * np.median(spread[inside]))
    return np.where(spread > 0, spread, np.inf)


def _variance_around(sample: Sample) -> Float:
    """Variance of recordings around the mean of their count, shape (n_cells,)."""
    means = class_means(sample.values, sample.counts)
    around = less_class_means(sample.values, sample.counts, means)
    return np.asarray(np.sum(around**2, axis=0) / max(len(around) - len(means), 1))


def count_trends(counts: NDArray[Any]) -> Float:
    """Constant and, with two counts, linear function of the count, orthonormal: (n_trends, n)."""
    rows = [np.ones(len(counts))]
    slope = counts - np.mean(counts)
    if np.any(slope):
        rows.append(slope / np.sqrt(np.mean(slope**2)))
    return np.array(rows)


def family_distances(
    measured: Sample, simulated: Sample, scale: Scale, chances: Float | None = None
) -> Float:
    """Distance between measured and simulated recordings in each family, (n_draws, n_families).

    D_f^2 = sum_j sum_k w_fk a_jk^2 / s_k^2, a_jk = (1/n) sum_i q_j(c_i) (x_ik - mean_c_i(simulated)_k),

    with only the constant and the linear part q_j over the counts: with many counts of few recordings each,
    the rest is noise. ``chances`` (n_draws, n) are weights of the recordings, each row with sum 1; by default
    one row of equal weights.
    """
    n = len(measured.counts)
    chances = np.full((1, n), 1 / n) if chances is None else chances
    means = class_means(simulated.values, simulated.counts)
    difference = less_class_means(measured.values, measured.counts, means) / scale.spread
    total = np.zeros((len(chances), len(scale.weights)))
    for trend in count_trends(measured.counts):
        total += ((chances * trend) @ difference) ** 2 @ scale.weights.T
    return np.sqrt(total)


def bank_error(counts: NDArray[Any], simulated: Sample, scale: Scale) -> Float:
    """Return the expected squared distance due to the error of the simulated means, shape (n_families,).

    sum_j sum_c (n_c/n)^2 q_j(c)^2 / M_c sum_k w_fk v_k / s_k^2, v the simulated variance around the counts.
    """
    share = 0.0
    rows = count_trends(counts)
    for count in np.unique(counts):
        inside = counts == count
        size = np.sum(simulated.counts == count)
        share += np.mean(inside) ** 2 / size * float(np.sum(rows[:, inside][:, 0] ** 2))
    return np.asarray(share * (scale.weights @ (_variance_around(simulated) / scale.spread**2)))


def family_floors(
    replicates: Deviations,
    scale: Scale,
    counts: NDArray[Any],
    of_bank: Float,
    n_splits: int,
    random: np.random.Generator,
) -> Float:
    """Return the distance of replicates in each family, from comparing halves of the measured recordings.

    The recordings of a count are split at random into halves of a and b recordings; the difference of their
    means has the variance s^2 (1/a + 1/b). Recordings that are alone with their count are paired; the
    difference of their deviations has the variance 2 s^2. Each split gives

    D_f^2 = (J/n) mean_p [ c_p sum_k w_fk d_pk^2 / s_k^2 / v_p ] + bank_f,

    over as many pieces p (halved counts and pairs, drawn at random) as the distance has coefficients J
    (:func:`count_trends` of ``counts``); v_p is the factor of s^2 above, bank_f is from :func:`bank_error`.
    The floor is the mean of the roots. c_p (:func:`_studentising_factor`) corrects for s being estimated from
    the same halves; it is 1 for pairs.
    """
    groups, alone = number_strata(replicates.counts), lone_recordings(replicates.counts)
    scaled = replicates.values / scale.spread
    independent = _studentising_factor(replicates.n_free)
    n_inside, n_trends = len(counts), len(count_trends(counts))
    total = np.zeros(len(scale.weights))
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
        mean = scale.weights @ np.mean([pieces[k] for k in chosen], axis=0)
        total += np.sqrt(n_trends / n_inside * mean + of_bank)
    return total / n_splits


@functools.cache
def _studentising_factor(n_free: int) -> float:
    """Return the ratio of the expected (d/s)^2 for d independent of s to that for d used in s.

    With s^2 = (q + 4) / (n_free + 4) and q chi-squared: n_free A / (1 - 4 A), A = E[1/(q + 4)].
    """
    if n_free < 1:
        return 1.0
    inverse = float(stats.chi2(n_free).expect(lambda q: 1 / (q + _STEADIED_BY)))
    return n_free * inverse / (1 - _STEADIED_BY * inverse)


def bootstrap_chances(groups: Int, n_draws: int, random: np.random.Generator) -> Float:
    """Weights of recordings in bootstrap draws, shape (n_draws, n), each row adding up to one.

    Random half-samples within strata (McCarthy 1969; Saigo, Shao and Sitter 2001): of the n_h recordings of a
    stratum a random a = n_h / 2 (rounded up or down) get the weight 1 + sqrt((n_h - a) / a), the others 1 -
    sqrt(a / (n_h - a)), over n. A mean then has the variance s^2 / n_h, and all draws are equally far from
    the sample, as draws with replacement are not. A stratum of one recording keeps its weight.
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


def floor_draws(replicates: Deviations, scale: Scale, floor: Float, chances: Float) -> Float:
    """Return the floor in bootstrap draws, (n_draws, n_families): it scales with the rms deviation."""
    groups = number_strata(replicates.counts)
    sizes = np.bincount(groups)[groups]
    squares = ((replicates.values / scale.spread) ** 2 @ scale.weights.T) * (
        sizes / np.maximum(sizes - 1, 1)
    )[:, None]
    mean = squares.mean(axis=0)
    # Some weights of half-samples are negative: a negative mean square counts as 0.
    drawn = np.maximum(chances @ squares, 0.0)
    return np.asarray(floor * np.sqrt(drawn / np.where(mean > 0, mean, 1.0)))
