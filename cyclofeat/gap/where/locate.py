"""Tests of where measured and simulated torque differ, with the recording as the unit of replication."""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.checks import whole
from cyclofeat.gap.comparison import Comparison
from cyclofeat.gap.simulations import Bank
from cyclofeat.gap.summaries.phase import PhaseMap, phase_maps
from cyclofeat.gap.summaries.summarise import FAMILIES, Cell, smallest_spreads
from cyclofeat.gap.summaries.turns import MeasuredTurns, class_means, less_class_means
from cyclofeat.gap.where.permutation import (
    SPREADS,
    TOGETHER,
    Permuted,
    classifier_p,
    energy_p,
    holm,
    statistics_by_family,
)

Float = NDArray[np.float64]

# Margins of "equivalent": in dB for levels, else in spreads of one recording.
EQUIVALENT_DB = 1.5
EQUIVALENT_SPREADS = 0.5
_REFITS = 99  # permutations for the classifier, refitted in each; its p is at least 1 / (_REFITS + 1)
_ASSEMBLIES, _PER_ASSEMBLY = 32, 4  # simulated to learn how recordings of one assembly correlate
_N_FAMILIES = len(FAMILIES) + 2  # with the families "spreads" and "together"
_POWER_Z = 0.8416  # standard normal quantile of a power of 0.8


@dataclass(frozen=True)
class Row:
    """Difference between measured and simulated recordings in one cell."""

    cell: Cell
    of: str  # what is compared: "mean" over recordings, or "spread" of single recordings
    difference: float  # measured minus simulated mean, in the cell's unit; for spreads, their ratio in dB
    low: float  # ends of its interval at 1 - alpha, simultaneous within the family
    high: float
    p: float  # adjusted within the family (Westfall-Young, step-down) and across families (Holm)
    detectable: float  # smallest difference that would have been found with a probability of 0.8
    spread: float  # standard deviation of one recording, in the cell's unit; of spreads that of the ratio


@dataclass(frozen=True)
class LocatedGap:
    """Result of :func:`locate`."""

    comparison: Comparison
    measured: MeasuredTurns = field(repr=False)
    bank: Bank = field(repr=False)
    simulated: Float = field(repr=False)  # summaries of the bank, (n_bank, n_cells)
    alpha: float
    n_permutations: int
    # Share of each cell's variance that recordings of one assembly have in common; 0 for an assembly each.
    shared_variance: Float = field(repr=False)
    # All cells: means in the order of the families, then spreads, then all means together. Spreads and all
    # together are tested one-sidedly: only the lower end of their intervals holds at 1 - alpha, the upper end
    # lies as far above the difference and bounds nothing.
    rows: tuple[Row, ...] = field(repr=False)
    # Smallest p of each family, "spreads" and "together" among them, adjusted within and across.
    family_p: dict[str, float]
    _compared: tuple[Float, Float] = field(repr=False)

    @property
    def p(self) -> float:
        """Smallest adjusted p."""
        return min(self.family_p.values())

    @property
    def verdict(self) -> str:
        """Answer of the comparison.

        ``"disagree"``: an adjusted p is at most alpha. ``"equivalent"``: all intervals of means lie within
        1.5 dB or half a recording's spread. ``"unresolved"``: neither; more recordings would tell.
        """
        if self.p <= self.alpha:
            return "disagree"
        within = all(
            max(-row.low, row.high)
            <= (EQUIVALENT_DB if row.cell.unit == "dB" else EQUIVALENT_SPREADS * row.spread)
            for row in self.rows
            if row.of == "mean" and row.cell is not TOGETHER
        )
        return "equivalent" if within else "unresolved"

    @property
    def cells(self) -> list[Cell]:
        """Columns of the summaries."""
        return self.measured.cells

    @functools.cached_property
    def global_p(self) -> dict[str, float]:
        """p of two tests of all cells at once, which do not affect the verdict.

        The tests are the energy distance, and a classifier of measured against simulated recordings that is
        refitted under each permutation.
        """
        random = np.random.default_rng([self.comparison.random_state, 2])
        return {
            "energy distance": energy_p(*self._compared, self.n_permutations, random),
            "classifier": classifier_p(*self._compared, min(self.n_permutations, _REFITS), random),
        }

    @functools.cached_property
    def phase(self) -> dict[str, PhaseMap]:
        """Torque folded over the input's turn and over the passage of the lobes, for a picture."""
        speeds = None if self.measured.speeds is None else (self.measured.speeds, self.bank.speeds)
        kinematics = self.comparison.kinematics
        return phase_maps(self.measured.windows, self.bank.X, kinematics, self.alpha, speeds)

    def centre_on_counts(self, values: Float, counts: NDArray[Any] | None) -> Float:
        """Summaries less the simulated mean of their count; unchanged where counts are not known."""
        if self.measured.counts is None or counts is None:
            return values
        return less_class_means(values, counts, class_means(self.simulated, self.bank.counts))

    def centred_sets(self) -> tuple[Float, Float]:
        """Measured and simulated summaries by :meth:`centre_on_counts`."""
        return (
            self.centre_on_counts(self.measured.values, self.measured.counts),
            self.centre_on_counts(self.simulated, self.bank.counts),
        )


def locate(
    comparison: Comparison,
    measured: MeasuredTurns,
    *,
    alpha: float = 0.05,
    n_permutations: int = 999,
    bank: Bank | None = None,
) -> LocatedGap:
    """Find where measured recordings differ from simulated ones.

    Each recording is summarised by some 180 numbers in nine families, and so are ``comparison.n_bank``
    simulated ones. The means over recordings and the spreads of single recordings are compared. Labels are
    permuted among recordings, never among windows of one, which are no replicates (taken as such they raise
    false alarms in 99.8 % of cases without a difference).

    The measured recordings may share a speed or a load that may differ anyway. The part of each cell that
    follows a recording's own speed and mean torque is therefore taken out on both sides, as far as simulated
    recordings reach.

    With ``comparison.one_assembly`` the recordings count as fewer: by how many, 128 more simulated recordings
    tell, four of each assembly. Where the counts of the two or more ``measured`` recordings are known, the
    simulated ones have the same counts, and the mean of each count is taken out. ``alpha`` is the chance of a
    false "disagree" over all families together. A p is at least 11 / (n_permutations + 1), as 11 families are
    adjusted for: fewer than 219 relabellings can never "disagree" at 0.05, and are refused. A ``bank`` has
    recordings of every measured count, in the place of simulated ones.

    Notes
    -----
    The statistic of a mean is the difference of the means over its standard error with the pooled variance.
    The statistic of a spread is the logarithm of the ratio of variances over its standard deviation under
    permuted labels. The family "together" has one statistic: the root mean square of all differences of
    means, decorrelated with a shrunk covariance of all recordings that ignores the labels. p is (b + 1) / (m
    + 1) if b of m permutations reach the statistic, so it is never 0. A spread of 0.1 dB, 0.01 Nm, 0.02 % or
    0.02 (assumptions) is added to that of each cell in quadrature, because smaller differences have no
    consequence.

    Examples
    --------
    >>> from cyclofeat.datasets import make_rig_recordings
    >>> records = make_rig_recordings(2, [0, 3], rig="R0", sampling_rate=6400, random_state=1)
    >>> comparison = Comparison(sampling_rate=6400, n_bank=24)
    >>> measured = comparison.measured([record.torque for record in records], y=[0, 3, 0, 3])
    >>> locate(comparison, measured, n_permutations=499).verdict
    'disagree'
    """
    if not 0 < alpha < 1:
        raise ValueError(f"alpha must lie between 0 and 1, got {alpha!r}")
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
    bank = comparison.bank_like(measured) if bank is None else bank
    untested = LocatedGap(
        comparison, measured, bank, comparison.summaries(bank), alpha, n_permutations,
        np.zeros(len(measured.cells)), (), {}, (np.empty(0), np.empty(0)),
    )  # fmt: skip
    of_measured, of_simulated = untested.centred_sets()
    trend = SpeedAndLoadTrend(of_simulated, measured.cells, smallest_spreads(measured.cells))
    shared = np.zeros(len(measured.cells))
    if comparison.one_assembly:
        counts = sorted(set(bank.counts.tolist()))
        of_assemblies = comparison.bank(_ASSEMBLIES * _PER_ASSEMBLY, counts, n_assemblies=_ASSEMBLIES)
        values = untested.centre_on_counts(comparison.summaries(of_assemblies), of_assemblies.counts)
        shared = intraclass_correlation(trend.without(values), of_assemblies.assemblies)
    compared = trend.without(of_measured), trend.without(of_simulated)
    rows, family_p = _test_cells(dataclasses.replace(untested, shared_variance=shared), compared)
    return dataclasses.replace(
        untested, shared_variance=shared, rows=rows, family_p=family_p, _compared=compared
    )


def _test_cells(
    located: LocatedGap, compared: tuple[Float, Float]
) -> tuple[tuple[Row, ...], dict[str, float]]:
    """Test all cells: return their rows, and the adjusted p of each family."""
    cells, n = located.cells, len(located.cells)
    random = np.random.default_rng([located.comparison.random_state, 0])
    wider = widening_factor(located.shared_variance, len(compared[0]))
    statistics = Permuted(*compared, located.n_permutations, random, smallest_spreads(cells), wider)
    rows: list[tuple[str, Row]] = []
    raw: dict[str, float] = {}
    for family, at in statistics_by_family(cells).items():
        adjusted = statistics.step_down(at)
        raw[family] = float(adjusted.min())
        reach = statistics.largest_quantile(at, 1 - located.alpha)
        for k, p in zip(at, adjusted, strict=True):
            difference, error = float(statistics.differences[k]), float(statistics.errors[k])
            row = Row(
                cell=TOGETHER if family == TOGETHER.family else cells[k % n],
                of="spread" if family == SPREADS else "mean",
                difference=difference,
                low=difference - reach * error,
                high=difference + reach * error,
                p=float(p),
                detectable=(reach + _POWER_Z) * error,
                spread=float(statistics.spreads[k]),
            )
            rows.append((family, row))
    family_p = holm(raw)
    across = {family: family_p[family] / raw[family] for family in raw}
    table = tuple(dataclasses.replace(row, p=min(row.p * across[family], 1.0)) for family, row in rows)
    return table, family_p


_MARGIN = 2.0  # times the smallest difference of consequence
_LOAD = "mean"
_SPEEDS = ("input speed by the tachometer", "input speed by the mesh lines")  # in order of preference


class SpeedAndLoadTrend:
    """Linear trend of summaries with a recording's own speed and mean torque.

    A linear regression of the ``simulated`` summaries (n_bank, n_cells), less the mean of their count, gives
    the change of each cell with speed and mean torque. It is applied within the range of the simulated
    recordings, widened by twice the ``smallest`` difference of consequence: all recordings of a session may
    lie at one end of the allowed range, but not beyond it.
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
