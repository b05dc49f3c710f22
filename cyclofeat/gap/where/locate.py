"""Tests of where measured and simulated torque differ, with the recording as the unit of replication."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.checks import whole
from cyclofeat.gap.comparison import Comparison, Condition, GapSettings, bank_like, summarise_bank
from cyclofeat.gap.measured import MeasuredRig
from cyclofeat.gap.simulations import Bank
from cyclofeat.gap.summaries.phase import PhaseMap, phase_maps
from cyclofeat.gap.summaries.summarise import FAMILIES, Cell, smallest_spreads
from cyclofeat.gap.summaries.turns import MeasuredTurns, class_means, less_class_means
from cyclofeat.gap.where.permutation import SPREADS, TOGETHER, Permuted, holm, statistics_by_family
from cyclofeat.gap.world.world import World

Float = NDArray[np.float64]

# Margins of "equivalent": in dB for levels, else in spreads of one recording.
EQUIVALENT_DB = 1.5
EQUIVALENT_SPREADS = 0.5
_ASSEMBLIES, _PER_ASSEMBLY = 32, 4  # simulated to learn how recordings of one assembly correlate
_N_FAMILIES = len(FAMILIES) + 2  # with the families "spreads" and "together"
_POWER_Z = 0.8416  # standard normal quantile of a power of 0.8


@dataclass(frozen=True)
class WhereRow:
    """Difference between measured and simulated recordings in one cell."""

    cell: Cell
    of: str  # what is compared: "mean" over recordings, or "spread" of single recordings
    difference: float  # measured minus simulated mean, in the cell's unit; for spreads, their ratio in dB
    low: float  # ends of its interval at 1 - alpha, simultaneous within the family
    high: float
    p: float  # adjusted within the family (Westfall-Young, step-down) and across families (Holm)
    detectable: float  # smallest difference that would have been found with a probability of 0.8
    spread: float  # standard deviation of one recording, in the cell's unit; of spreads that of the ratio
    mean: float  # over the recordings, in the cell's unit
    measured_spread: float  # of one recording, and of one simulated one, about the mean of its count
    simulated_spread: float

    @property
    def clarity(self) -> float:
        """Size of the difference relative to ``detectable``."""
        return abs(self.difference) / self.detectable if self.detectable > 0 else 0.0


@dataclass(frozen=True)
class Where:
    """Comparison of recordings with a model at one condition."""

    verdict: str  # "disagree", "equivalent" or "unresolved"
    rows: tuple[WhereRow, ...] = field(repr=False)  # each number's mean, and how much recordings vary
    family_p: Mapping[str, float]  # adjusted p of each family, "spreads" and "together" among them
    n_recordings: int
    n_simulated: int
    alpha: float  # adjusted p up to which a number differs
    margin_db: float  # margins of agreement: of levels in dB,
    margin_spreads: float  # and of other numbers in spreads of one recording
    n_permutations: int
    random_state: int
    one_assembly: bool  # all recordings are stated to be of one assembly
    sampling_rate: float  # in Hz
    condition: Condition
    # Torque folded over the "lobe" passage and the "input" turn; empty where it was not made.
    phase: Mapping[str, PhaseMap] = field(default_factory=dict, repr=False, compare=False)

    @property
    def n_cells(self) -> int:
        """Number of cells that are compared."""
        return len({(row.cell.family, row.cell.name) for row in self.rows})

    @property
    def p(self) -> float:
        """Smallest adjusted p."""
        return min(self.family_p.values())

    @property
    def flagged_rows(self) -> list[WhereRow]:
        """Rows that differ, the clearest first."""
        return sorted((row for row in self.rows if row.p <= self.alpha), key=lambda row: -row.clarity)

    def means(self, *families: str) -> list[WhereRow]:
        """Rows of means, of these families or of all."""
        return [
            row for row in self.rows if row.of == "mean" and (not families or row.cell.family in families)
        ]


@dataclass(frozen=True)
class LocatedGap:
    """Result of :func:`locate`: the comparison, and what it was made from."""

    # Rows are those of all means in the order of the families, then of all spreads. Spreads, and all means
    # together, are tested one-sidedly: only the lower end of their intervals holds at 1 - alpha.
    where: Where
    together: WhereRow  # all means together
    comparison: Comparison
    measured: MeasuredTurns = field(repr=False)
    bank: Bank = field(repr=False)
    simulated: Float = field(repr=False)  # summaries of the bank, (n_bank, n_cells)
    # Share of each cell's variance that recordings of one assembly have in common; 0 for an assembly each.
    shared_variance: Float = field(repr=False)

    @property
    def cells(self) -> list[Cell]:
        """Columns of the summaries."""
        return self.measured.cells

    @functools.cached_property
    def phase(self) -> dict[str, PhaseMap]:
        """Torque folded over the input's turn and over the passage of the lobes, for a picture."""
        speeds = None if self.measured.speeds is None else (self.measured.speeds, self.bank.speeds)
        kinematics = self.comparison.kinematics
        return phase_maps(self.measured.windows, self.bank.X, kinematics, self.where.alpha, speeds)


def locate_all(
    measured: MeasuredRig, world: World, settings: GapSettings, *, simulated: MeasuredRig | None = None
) -> tuple[LocatedGap, ...]:
    """Find where recordings differ from the model at each condition with at least two of them.

    Each condition is tested at ``settings.alpha`` over their number, with so many times more relabellings:
    the chance of a false "disagree" over all of them is at most ``alpha``. ``simulated`` are recordings of
    another simulator, part of the same :class:`MeasuredRig`: of each the first output turn is used, in the
    place of simulated ones.
    """
    parts = (measured,) if simulated is None else (measured, simulated)
    compared = [
        condition for condition in measured.conditions if all(len(part.at(condition)) > 1 for part in parts)
    ]
    if not compared:
        more = "" if simulated is None else ", and 2 simulated ones"
        raise ValueError(
            f"measured must hold at least 2 recordings of one condition{more}: one recording has no spread "
            f"to compare with, got {len(measured.recordings)} at {len(measured.conditions)} conditions"
        )
    shared = dataclasses.replace(
        settings, alpha=settings.alpha / len(compared), n_permutations=settings.n_permutations * len(compared)
    )
    located = []
    for condition in compared:
        comparison = measured.comparison(condition, world, shared)
        turns = measured.turns(comparison)
        bank = None
        if simulated is not None:
            comparison = comparison.replace(one_assembly=False)
            bank = simulated.bank(comparison)
            missing = {*turns.counts_or_zeros.tolist()} - {*bank.counts.tolist()}
            if missing and turns.counts is not None:
                raise ValueError(
                    f"simulated must hold each count of the measured recordings at {condition.text}, got "
                    f"none with {min(missing)} worn lobes"
                )
        n_permutations = shared.n_permutations
        located.append(
            locate(comparison, turns, alpha=shared.alpha, n_permutations=n_permutations, bank=bank)
        )
    return tuple(located)


def where_of(located: LocatedGap, *, pictures: bool = True) -> Where:
    """Return the comparison; with ``pictures``, with folded torque."""
    if not pictures:
        return located.where
    return dataclasses.replace(located.where, phase=located.phase)


def locate(
    comparison: Comparison,
    measured: MeasuredTurns,
    *,
    alpha: float = 0.05,
    n_permutations: int = 999,
    bank: Bank | None = None,
) -> LocatedGap:
    """Find where measured recordings differ from simulated ones.

    Means over recordings and spreads of single recordings are compared, of some 180 numbers in nine families.
    Labels are permuted among recordings: windows of one are no replicates (taken as such they raise false
    alarms in 99.8 % of cases without a difference). What follows a recording's own speed and mean torque is
    taken out on both sides, as far as simulated recordings reach, since those may differ anyway. Where counts
    are known, simulated recordings have the same, and the mean of each count is taken out.

    ``alpha`` is the chance of a false "disagree" over all families. With ``comparison.one_assembly`` the
    recordings count as fewer: 128 more simulated ones, four of each assembly, tell by how many. A ``bank``
    has recordings of every measured count, in the place of ``comparison.n_bank`` simulated ones.

    The statistic of a mean is the difference over its standard error with the pooled variance; that of a
    spread is the logarithm of the ratio of variances over its standard deviation under permuted labels. The
    family "together" has one: the root mean square of all differences of means, decorrelated with a shrunk
    covariance of all recordings that ignores the labels. p is (b + 1) / (m + 1) if b of m permutations reach
    the statistic. A spread of 0.1 dB, 0.01 Nm, 0.02 % or 0.02 (assumptions) is added in quadrature: smaller
    differences have no consequence.
    """
    fewest = math.ceil(_N_FAMILIES / alpha) - 1
    if whole("n_permutations", n_permutations, 19) < fewest:
        raise ValueError(
            f"n_permutations must be at least {fewest} for alpha={alpha:g}: with fewer nothing can disagree, "
            f"got {n_permutations}"
        )
    if measured.n_recordings < 2:
        raise ValueError(
            "groups must hold at least 2 recordings: one recording has no spread to compare with, got 1"
        )
    bank = bank_like(comparison, measured) if bank is None else bank
    simulated, cells = summarise_bank(comparison, bank), measured.cells

    def centred(values: Float, counts: NDArray[Any]) -> Float:
        if measured.counts is None:
            return values
        return less_class_means(values, counts, class_means(simulated, bank.counts))

    sets = centred(measured.values, measured.counts_or_zeros), centred(simulated, bank.counts)
    trend = SpeedAndLoadTrend(sets[1], cells, smallest_spreads(cells))
    shared = np.zeros(len(cells))
    if comparison.one_assembly:
        counts = sorted(set(bank.counts.tolist()))
        of_assemblies = comparison.bank(_ASSEMBLIES * _PER_ASSEMBLY, counts, n_assemblies=_ASSEMBLIES)
        values = centred(summarise_bank(comparison, of_assemblies), of_assemblies.counts)
        shared = intraclass_correlation(trend.without(values), of_assemblies.assemblies)
    compared = trend.without(sets[0]), trend.without(sets[1])
    random = np.random.default_rng([comparison.random_state, 0])
    wider = widening_factor(shared, measured.n_recordings)
    statistics = Permuted(*compared, n_permutations, random, smallest_spreads(cells), wider)
    levels = np.array([measured.values.mean(axis=0), *(values.std(axis=0, ddof=1) for values in sets)])
    (*rows, together), family_p = _test_cells(statistics, cells, alpha, levels)
    where = Where(
        verdict=_judge(rows, family_p, alpha), rows=tuple(rows), family_p=family_p,
        n_recordings=measured.n_recordings, n_simulated=len(simulated), alpha=alpha, margin_db=EQUIVALENT_DB,
        margin_spreads=EQUIVALENT_SPREADS, n_permutations=n_permutations,
        random_state=comparison.random_state, one_assembly=comparison.one_assembly,
        sampling_rate=comparison.sampling_rate, condition=comparison.condition,
    )  # fmt: skip
    return LocatedGap(where, together, comparison, measured, bank, simulated, shared)


def _test_cells(
    statistics: Permuted, cells: list[Cell], alpha: float, levels: Float
) -> tuple[list[WhereRow], dict[str, float]]:
    """Return rows of all cells, that of all together last, and the adjusted p of each family.

    ``levels`` (3, n_cells) are the means, and the spreads of measured and simulated recordings.
    """
    tests = {}
    for family, at in statistics_by_family(cells).items():
        reach = float(np.quantile(statistics.t[1:, at].max(axis=1), 1 - alpha))
        tests[family] = at, statistics.step_down(at), reach
    raw = {family: float(adjusted.min()) for family, (_, adjusted, _) in tests.items()}
    family_p, rows = holm(raw), []
    levels = np.hstack([levels, levels, np.full((3, 1), np.nan)])
    for family, (at, adjusted, reach) in tests.items():
        for k, p in zip(at, adjusted, strict=True):
            difference, error = float(statistics.differences[k]), float(statistics.errors[k])
            row = WhereRow(
                TOGETHER if family == TOGETHER.family else cells[k % len(cells)],
                "spread" if family == SPREADS else "mean",
                difference,
                low=difference - reach * error,
                high=difference + reach * error,
                p=min(float(p) * (family_p[family] / raw[family]), 1.0),
                detectable=(reach + _POWER_Z) * error,
                spread=float(statistics.spreads[k]),
                mean=float(levels[0, k]),
                measured_spread=float(levels[1, k]),
                simulated_spread=float(levels[2, k]),
            )
            rows.append(row)
    return rows, family_p


def _judge(rows: Iterable[WhereRow], family_p: Mapping[str, float], alpha: float) -> str:
    """Return the verdict of a comparison.

    ``"disagree"``: an adjusted p is at most alpha. ``"equivalent"``: all intervals of means lie within 1.5 dB
    or half a recording's spread. ``"unresolved"``: neither; more recordings would tell.
    """
    if min(family_p.values()) <= alpha:
        return "disagree"
    within = all(
        max(-row.low, row.high)
        <= (EQUIVALENT_DB if row.cell.unit == "dB" else EQUIVALENT_SPREADS * row.spread)
        for row in rows
        if row.of == "mean"
    )
    return "equivalent" if within else "unresolved"


_MARGIN = 2.0  # times the smallest difference of consequence
_LOAD = "mean"
_SPEEDS = ("input speed by the tachometer", "input speed by the mesh lines")  # in order of preference


class SpeedAndLoadTrend:
    """Linear trend of summaries with a recording's own speed and mean torque.

    The slopes are those of the ``simulated`` summaries (n_bank, n_cells), less the mean of their count. They
    are applied within the simulated range, widened by twice the ``smallest`` difference of consequence: all
    recordings of a session may lie at one end of the allowed range, but not beyond it.
    """

    def __init__(self, simulated: Float, cells: list[Cell], smallest: Float) -> None:
        names = [cell.name for cell in cells]
        speed = next(name for name in _SPEEDS if name in names)
        self._at = [names.index(speed), names.index(_LOAD)]
        of_recordings = simulated[:, self._at]
        self._smallest = smallest[self._at]
        margin = _MARGIN * self._smallest
        self._low, self._high = of_recordings.min(axis=0) - margin, of_recordings.max(axis=0) + margin
        self._middle = of_recordings.mean(axis=0)
        self._slopes = np.linalg.lstsq(of_recordings - self._middle, simulated, rcond=1e-6)[0]

    def without(self, values: Float) -> Float:
        """Return summaries without that part, (n, n_cells)."""
        of_recordings = values[:, self._at]
        explained = np.clip(of_recordings, self._low, self._high)
        rest = of_recordings - self._middle
        left = values - (explained - self._middle) @ self._slopes
        # Exactly 0 where the remainder has no consequence: a test would exaggerate it. Else unchanged.
        left[:, self._at] = np.where(np.abs(of_recordings - explained) < self._smallest, 0.0, rest)
        return np.asarray(left)


def intraclass_correlation(values: Float, assemblies: NDArray[Any]) -> Float:
    """Share of each cell's variance that recordings of one assembly have in common, shape (n_cells,).

    One-way analysis of variance: (A - W) / (A + (k - 1) W) with the mean squares A among and W within
    assemblies of k recordings (Fisher 1925), not below 0.
    """
    names, of, sizes = np.unique(assemblies, return_inverse=True, return_counts=True)
    means = np.array([values[of == k].mean(axis=0) for k in range(len(names))])
    within = np.sum((values - means[of]) ** 2, axis=0) / (len(values) - len(names))
    among = np.sum(sizes[:, None] * (means - values.mean(axis=0)) ** 2, axis=0) / (len(names) - 1)
    # Effective k for assemblies of unequal size (from the expected mean square).
    k = (len(values) - np.sum(sizes**2) / len(values)) / (len(names) - 1)
    total = among + (k - 1) * within
    return np.asarray(np.clip((among - within) / np.where(total > 0, total, 1.0), 0.0, 1.0))


def widening_factor(shared: Float, n: int) -> Float:
    """Factor on the standard error of the mean of n recordings of one assembly, shape (n_cells,).

    The recordings count as n / (1 + (n - 1) r), where r is the ``shared`` part of the variance (Kish 1965).
    """
    return np.asarray(np.sqrt(1 + (n - 1) * shared))
