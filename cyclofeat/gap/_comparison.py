"""What alternatives close of the gap on held-out recordings, from summaries alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap import _distance as distance

Float = NDArray[np.float64]

BEFORE, AFTER, FLOOR, OVERALL = "nothing", "after", "floor", "overall"


_FEWEST = 4  # recordings below which their spread is not known well enough to compare anything with it
_ERRORS = 2.0  # standard errors by which the gap must stand out of the floor
_SPLITS = 100
_INTERVAL = (0.05, 0.95)


@dataclass(frozen=True)
class DistanceRow:
    """A distance of held-out recordings.

    Attributes
    ----------
    alternative : str
        ``"nothing"`` (the simulator before), ``"after"``, another alternative, or ``"floor"``: what
        replication alone would leave.
    condition : {"all", "seen", "unseen"}
    family : str
        One of spectrum, orders, averages, amplitudes, features; or ``"overall"``, their mean.
    distance : float
        In spreads of one recording.
    """

    alternative: str
    condition: str
    family: str
    distance: float


@dataclass(frozen=True)
class ComparisonRow:
    """What an alternative closes of the gap.

    Attributes
    ----------
    alternative : str
    condition : {"all", "seen", "unseen"}
    grr : float
        Gap reduction ratio: 1 closes the gap, 0 leaves it, below 0 widens it; NaN where undefined.
    low, high : float
        Interval of 90 %, by bootstrap over recordings.
    undefined : str
        Why the ratio is undefined; empty where it is not.
    """

    alternative: str
    condition: str
    grr: float
    low: float
    high: float
    undefined: str = ""


@dataclass(frozen=True)
class Simulation:
    """Summaries of an alternative's records: values, shape (m, n_cells), and their counts, shape (m,)."""

    values: Float
    counts: NDArray[Any]


@dataclass(frozen=True)
class Scored:
    """What :func:`compare` finds."""

    distances: list[DistanceRow] = field(repr=False)
    comparison: list[ComparisonRow] = field(repr=False)
    beats: dict[str, dict[str, float]] = field(repr=False)


def compare(
    measured: Float,
    counts: NDArray[Any],
    alternatives: dict[str, Simulation],
    parts: list[distance.Part],
    seen: NDArray[np.bool_] | None = None,
    *,
    n_draws: int = 400,
    random_state: int = 0,
) -> Scored:
    """Distances, gap reduction and paired comparison of alternatives, from summaries.

    Parameters
    ----------
    measured : ndarray, shape (n, n_cells)
        One row per held-out recording.
    counts : ndarray of int, shape (n,)
        Their counts; all the same where counts are not known.
    alternatives : dict from str to Simulation
        With ``"nothing"`` and ``"after"``.
    parts : list of Part
        Where each cell belongs.
    seen : ndarray of bool, shape (n,), optional
        Whether a recording's count occurs among those that alternatives were fitted on.
    n_draws : int
        Bootstrap draws, the same for all alternatives.
    random_state : int

    Returns
    -------
    Scored
    """
    random = np.random.default_rng([random_state, 3])
    conditions = {"all": np.ones(len(counts), dtype=bool)}
    if seen is not None:
        conditions |= {"seen": seen, "unseen": ~seen}
    weights, families = distance.cell_weights(parts), distance.families_of(parts)
    before, after = alternatives[BEFORE], alternatives[AFTER]
    spread = distance.replicate_spread(measured, counts, before.values, before.counts, parts)
    # What a simulator misses in single counts only would pass for replication where counts have one recording
    # each. Of both simulators the one that leaves less of it says what the floor is: a lower floor lowers the
    # ratio of every alternative.
    left = [distance.deviations(measured, counts, sim.values, sim.counts) for sim in (before, after)]
    left_by = [float(np.sum((found / spread) ** 2 @ weights.T)) for found, _ in left]
    own, n_free = left[int(np.argmin(left_by))]
    groups = distance.strata(counts, apart=seen, least=distance.POOLED_BELOW)
    chances = distance.bootstrap_chances(groups, n_draws, random)
    rows: list[DistanceRow] = []
    compared: list[ComparisonRow] = []
    beats: dict[str, dict[str, float]] = {name: {} for name in alternatives if name != AFTER}
    for condition, inside in conditions.items():
        if not inside.any():
            continue
        some, of = measured[inside], counts[inside]
        drawn = chances[:, inside] / chances[:, inside].sum(axis=1, keepdims=True)
        found, draws = {}, {}
        for name, sim in alternatives.items():
            single = distance.distances(some, of, sim.values, sim.counts, spread, weights)[0]
            many = distance.distances(some, of, sim.values, sim.counts, spread, weights, drawn)
            found[name] = float(single.mean())
            draws[name] = distance.centred(many.mean(axis=1), found[name])
            rows += _rows(name, condition, families, single)
        for name in beats:
            smaller = draws[AFTER] < draws[name]
            beats[name][condition] = float(np.mean(smaller + 0.5 * (draws[AFTER] == draws[name])))
        reason = _too_few(int(inside.sum()), len(counts), n_free)
        error = floor = np.nan
        if not reason:
            of_bank = distance.bank_error(of, before.values, before.counts, spread, weights)
            by_family = distance.floors(
                own, counts, spread, weights, len(of), len(distance.trends(of)), of_bank, n_free, _SPLITS,
                random,
            )  # fmt: skip
            rows += _rows(FLOOR, condition, families, by_family)
            floor = float(by_family.mean())
            moved = distance.floor_draws(own, counts, spread, weights, by_family, chances).mean(axis=1)
            floor_draws = distance.centred(moved, floor)
            error = float(np.std(draws[BEFORE] - floor_draws))
            if found[BEFORE] - floor < _ERRORS * error:
                reason = (
                    f"the gap before, {found[BEFORE]:.3g}, does not stand out of what replication leaves, "
                    f"{floor:.3g} +- {error:.2g} standard deviations of a recording: there is no gap to close"
                )
        for name in alternatives:
            if reason:
                compared.append(ComparisonRow(name, condition, np.nan, np.nan, np.nan, reason))
                continue
            ratio = float(distance.gap_reduction(found[BEFORE], found[name], floor))
            # A draw without a gap has no ratio; it says that the interval is open.
            gap = draws[BEFORE] - floor_draws
            with np.errstate(divide="ignore", invalid="ignore"):
                ratios = distance.gap_reduction(draws[BEFORE], draws[name], floor_draws)
            ratios = np.where(gap > 0, ratios, np.nan)
            low, high = np.nanquantile(ratios, _INTERVAL)
            compared.append(ComparisonRow(name, condition, ratio, float(low), float(high)))
    return Scored(rows, compared, beats)


def _rows(name: str, condition: str, families: list[str], values: Float) -> list[DistanceRow]:
    found = [DistanceRow(name, condition, f, float(v)) for f, v in zip(families, values, strict=True)]
    return [*found, DistanceRow(name, condition, OVERALL, float(values.mean()))]


def _too_few(n_inside: int, n_all: int, n_free: int) -> str:
    if n_all < _FEWEST or n_free < 2:
        return (
            f"{n_all} held-out recordings: at least {_FEWEST} are needed to know what replication leaves "
            "between two of them"
        )
    if n_inside < 2:
        return "one held-out recording in this condition: it cannot be resampled, so its error is not known"
    return ""
