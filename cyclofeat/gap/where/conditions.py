"""Comparison of measured and simulated torque at several conditions, with one verdict."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

from cyclofeat.gap.comparison import GapSettings
from cyclofeat.gap.measured import Condition, MeasuredRig
from cyclofeat.gap.summaries.phase import PhaseMap
from cyclofeat.gap.where.locate import EQUIVALENT_DB, EQUIVALENT_SPREADS, LocatedGap, Row, locate
from cyclofeat.gap.world.world import World


def locate_all(
    measured: MeasuredRig, world: World, settings: GapSettings, *, simulated: MeasuredRig | None = None
) -> tuple[LocatedGap, ...]:
    """Find where recordings differ from the model at each condition.

    Each condition is tested at ``settings.alpha`` over their number, with so many times more relabellings, so
    that the chance of a false "disagree" over all of them is at most ``alpha``.

    Conditions with one recording are left out. ``simulated`` are recordings of another simulator, in the
    place of simulated ones: of each the first output turn is used. It is part of the same
    :class:`MeasuredRig`; conditions that it lacks are left out.
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


@dataclass(frozen=True)
class WhereRow(Row):
    """One number of the comparison, with its levels.

    Mean over the recordings, in the cell's unit, and standard deviation of one recording, and of one
    simulated recording, about the mean of its count.
    """

    mean: float
    measured_spread: float
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
    global_p: Mapping[str, float]  # of all numbers at once, with no part in the verdict; may be empty
    # Torque folded over the "lobe" passage and the "input" turn; empty where it was not made.
    phase: Mapping[str, PhaseMap] = field(repr=False, compare=False)
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


def where_of(located: LocatedGap, *, pictures: bool = True) -> Where:
    """Return the comparison of a located gap, without its recordings.

    For ``pictures`` torque is folded over the turn and all numbers are tested at once, which takes seconds.
    """
    columns = {(cell.family, cell.name): k for k, cell in enumerate(located.cells)}
    measured, simulated = (values.std(axis=0, ddof=1) for values in located.centred_sets())
    mean = located.measured.values.mean(axis=0)
    rows = []
    for row in located.rows:
        # The row of all cells together has no column.
        k = columns.get((row.cell.family, row.cell.name))
        if k is not None:
            rows.append(WhereRow(**vars(row), mean=float(mean[k]), measured_spread=float(measured[k]),
                                 simulated_spread=float(simulated[k])))  # fmt: skip
    return Where(
        verdict=located.verdict,
        rows=tuple(rows),
        family_p=dict(located.family_p),
        global_p=dict(located.global_p) if pictures else {},
        phase=dict(located.phase) if pictures else {},
        n_recordings=located.measured.n_recordings,
        n_simulated=len(located.simulated),
        alpha=located.alpha,
        margin_db=EQUIVALENT_DB,
        margin_spreads=EQUIVALENT_SPREADS,
        n_permutations=located.n_permutations,
        random_state=located.comparison.random_state,
        one_assembly=located.comparison.one_assembly,
        sampling_rate=located.comparison.sampling_rate,
        condition=Condition.of(located.comparison),
    )
