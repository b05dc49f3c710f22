"""Reduction of the gap by each alternative on held-out recordings, from summaries alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap._measured import Condition
from cyclofeat.gap.proof import _distance as distance
from cyclofeat.gap.proof._distance import Part, Sample

Float = NDArray[np.float64]

BEFORE, AFTER, FLOOR, OVERALL = "nothing", "after", "floor", "overall"

_FEWEST = 4  # recordings below which their spread is too uncertain
_ERRORS = 2.0  # standard errors by which the gap must exceed the floor
_SPLITS = 100
_INTERVAL = (0.05, 0.95)


@dataclass(frozen=True)
class DistanceRow:
    """A distance of held-out recordings.

    Attributes
    ----------
    alternative : str
        ``"nothing"`` (the simulator before), ``"after"``, another alternative, or ``"floor"``, which
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
class ProofRow:
    """Share of the gap that an alternative closes on recordings held out.

    Attributes
    ----------
    alternative : str
        ``"after"`` is the corrected model, ``"nothing"`` the model as it was.
    condition : {"all", "seen", "unseen"}
        All recordings held out, or those of counts that the fit has seen or not seen.
    grr : float
        Gap reduction ratio: 1 closes the gap, 0 leaves it, below 0 widens it; NaN where undefined.
    low, high : float
        Interval of 90 %, by bootstrap over recordings.
    undefined : str
        Why the ratio is undefined; empty where it is not.
    beaten : float
        Share of bootstrap draws in which the corrected model is nearer to the recordings, ties counting half;
        NaN for the corrected model itself.
    """

    alternative: str
    condition: str
    grr: float
    low: float
    high: float
    undefined: str = ""
    beaten: float = math.nan


@dataclass(frozen=True)
class Proof:
    """Comparison of the corrected model with alternatives on recordings held out.

    Attributes
    ----------
    rows : tuple of ProofRow
    distances : tuple of DistanceRow
        Distances by family, in standard deviations of one recording.
    n_recordings : int
    condition : Condition or None
        That of the recordings; None where it was not stated.
    """

    rows: tuple[ProofRow, ...]
    distances: tuple[DistanceRow, ...] = field(repr=False)
    n_recordings: int
    condition: Condition | None = None

    @property
    def result(self) -> ProofRow:
        """Row of the corrected model on all recordings."""
        return next(row for row in self.rows if (row.alternative, row.condition) == (AFTER, "all"))

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Ratios by alternative and condition, None where undefined, and the interval over all recordings."""
        plain: dict[str, dict[str, Any]] = {}
        for row in self.rows:
            ratios = plain.setdefault(row.alternative, {})
            ratios[row.condition] = None if math.isnan(row.grr) else row.grr
            if row.condition == "all" and not math.isnan(row.low):
                ratios["ci"] = [row.low, row.high]
        return plain


def score_alternatives(
    measured: Sample,
    alternatives: dict[str, Sample],
    parts: list[Part],
    seen: NDArray[np.bool_] | None = None,
    *,
    n_draws: int = 400,
    random_state: int = 0,
) -> Proof:
    """Distances, gap reduction and paired comparison of alternatives, from summaries.

    Parameters
    ----------
    measured : Sample
        Held-out recordings; their counts are all the same where they are not known.
    alternatives : dict from str to Sample
        Records of each, ``"nothing"`` and ``"after"`` among them.
    parts : list of Part
        Part of each cell.
    seen : ndarray of bool, shape (n,), optional
        True where a recording's count occurs among those that alternatives were fitted to.
    n_draws : int
        Bootstrap draws, the same for all alternatives.
    random_state : int
    """
    random, counts = np.random.default_rng([random_state, 3]), measured.counts
    conditions = {"all": np.ones(len(counts), dtype=bool)}
    if seen is not None:
        conditions |= {"seen": seen, "unseen": ~seen}
    before, after = alternatives[BEFORE], alternatives[AFTER]
    scale = distance.Scale(distance.replicate_spread(measured, before, parts), distance.cell_weights(parts))
    # If counts have one recording each, an error of a simulator in single counts looks like replication. So
    # the floor is that of the simulator with the smaller one; a lower floor lowers the ratio of every
    # alternative.
    replicates = min(
        (distance.deviations(measured, simulated) for simulated in (before, after)),
        key=lambda found: float(np.sum((found.values / scale.spread) ** 2 @ scale.weights.T)),
    )
    groups = distance.strata(counts, apart=seen, least=distance.POOLED_BELOW)
    chances = distance.bootstrap_chances(groups, n_draws, random)
    families = distance.families_of(parts)
    rows: list[ProofRow] = []
    of_families: list[DistanceRow] = []
    for condition, inside in conditions.items():
        if not inside.any():
            continue
        some = Sample(measured.values[inside], counts[inside])
        drawn = chances[:, inside] / chances[:, inside].sum(axis=1, keepdims=True)
        estimates, draws = {}, {}
        for name, simulated in alternatives.items():
            single = distance.distances(some, simulated, scale)[0]
            many = distance.distances(some, simulated, scale, drawn)
            estimates[name] = float(single.mean())
            draws[name] = distance.centred(many.mean(axis=1), estimates[name])
            of_families += _rows(name, condition, families, single)
        reason = _too_few(int(inside.sum()), len(counts), replicates.n_free)
        floor, floor_draws = np.nan, np.full(n_draws, np.nan)
        if not reason:
            of_bank = distance.bank_error(some.counts, before, scale)
            by_family = distance.floors(replicates, scale, some.counts, of_bank, _SPLITS, random)
            of_families += _rows(FLOOR, condition, families, by_family)
            floor = float(by_family.mean())
            moved = distance.floor_draws(replicates, scale, by_family, chances).mean(axis=1)
            floor_draws = distance.centred(moved, floor)
            reason = _no_gap(estimates[BEFORE], floor, float(np.std(draws[BEFORE] - floor_draws)))
        for name in alternatives:
            ratio, low, high, beaten = (math.nan,) * 4
            if not reason:
                ratio = float(distance.gap_reduction(estimates[BEFORE], estimates[name], floor))
                low, high = _interval(draws[BEFORE], draws[name], floor_draws)
            if name != AFTER:
                equal = draws[AFTER] == draws[name]
                beaten = float(np.mean((draws[AFTER] < draws[name]) + 0.5 * equal))
            rows.append(ProofRow(name, condition, ratio, low, high, reason, beaten))
    return Proof(tuple(rows), tuple(of_families), len(counts))


def _no_gap(before: float, floor: float, error: float) -> str:
    """Reason why there is no gap to close; empty where there is one."""
    if before - floor >= _ERRORS * error:
        return ""
    return (
        f"the gap before, {before:.3g}, does not stand out of what replication leaves, {floor:.3g} +- "
        f"{error:.2g} standard deviations of a recording: there is no gap to close"
    )


def _interval(before: Float, after: Float, floor: Float) -> tuple[float, float]:
    """Return the interval of the gap reduction ratio from draws; draws without a gap have no ratio."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = distance.gap_reduction(before, after, floor)
    low, high = np.nanquantile(np.where(before - floor > 0, ratios, np.nan), _INTERVAL)
    return float(low), float(high)


def _rows(name: str, condition: str, families: list[str], values: Float) -> list[DistanceRow]:
    named = [*zip(families, values, strict=True), (OVERALL, values.mean())]
    return [DistanceRow(name, condition, family, float(value)) for family, value in named]


def _too_few(n_inside: int, n_all: int, n_free: int) -> str:
    if n_all < _FEWEST or n_free < 2:
        return (
            f"{n_all} held-out recordings: at least {_FEWEST} are needed to know what replication leaves "
            "between two of them"
        )
    if n_inside < 2:
        return "one held-out recording in this condition: it cannot be resampled, so its error is not known"
    return ""
