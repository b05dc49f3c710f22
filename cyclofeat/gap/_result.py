"""Result of the gap: the disagreement, the missing effects, and the reduction of the gap."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from cyclofeat.gap.proof import AFTER, Proof
from cyclofeat.gap.size import FittedParameter
from cyclofeat.gap.summaries import PhaseMap
from cyclofeat.gap.where import EQUIVALENT_DB, EQUIVALENT_SPREADS, LocatedGap, Row
from cyclofeat.simulators import Effect, Rig

if TYPE_CHECKING:
    import pandas as pd

FORMAT = "cyclofeat gap 1"


@dataclass(frozen=True)
class WhereRow(Row):
    """One number of the comparison, with its levels.

    Attributes
    ----------
    mean : float
        Mean over the recordings, in the cell's unit.
    measured_spread, simulated_spread : float
        Standard deviation of one recording, and of one simulated recording, about the mean of its count.
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
    """Comparison of recordings with a model.

    Attributes
    ----------
    verdict : {"disagree", "equivalent", "unresolved"}
    rows : tuple of WhereRow
        Each number twice: its mean over recordings, and how much recordings vary.
    family_p : mapping from str to float
        Adjusted p of each family, ``"spreads"`` and ``"together"`` among them.
    global_p : mapping from str to float
        Tests of all numbers at once, which have no part in the verdict; empty where they were not made.
    phase : mapping from str to PhaseMap
        Torque folded over the ``"lobe"`` passage and the ``"input"`` turn; empty where it was not made.
    n_recordings, n_simulated : int
    alpha : float
        Adjusted p up to which a number differs.
    margin_db, margin_spreads : float
        Margins of agreement: for levels in dB, for other numbers in spreads of one recording.
    n_permutations, random_state : int
    one_assembly : bool
        Whether all recordings are stated to be of one assembly.
    sampling_rate, input_speed_hz : float
        In Hz.
    """

    verdict: str
    rows: tuple[WhereRow, ...] = field(repr=False)
    family_p: Mapping[str, float]
    global_p: Mapping[str, float]
    phase: Mapping[str, PhaseMap] = field(repr=False, compare=False)
    n_recordings: int
    n_simulated: int
    alpha: float
    margin_db: float
    margin_spreads: float
    n_permutations: int
    random_state: int
    one_assembly: bool
    sampling_rate: float
    input_speed_hz: float

    @property
    def n_cells(self) -> int:
        """Number of cells that are compared."""
        return len({(row.cell.family, row.cell.name) for row in self.rows})

    @property
    def p(self) -> float:
        """Smallest adjusted p."""
        return min(self.family_p.values())

    @property
    def flagged(self) -> list[WhereRow]:
        """Rows that differ, the clearest first."""
        return sorted((row for row in self.rows if row.p <= self.alpha), key=lambda row: -row.clarity)

    def means(self, *families: str) -> list[WhereRow]:
        """Rows of means, of these families or of all."""
        return [
            row for row in self.rows if row.of == "mean" and (not families or row.cell.family in families)
        ]


def where_of(located: LocatedGap, *, pictures: bool = True) -> Where:
    """Rows of a comparison, without its recordings.

    Parameters
    ----------
    located : LocatedGap
    pictures : bool, default=True
        Fold the torque over the turn and test all numbers at once too, which takes some seconds.

    Returns
    -------
    Where
    """
    columns = {(cell.family, cell.name): k for k, cell in enumerate(located.cells)}
    measured, simulated = (values.std(axis=0, ddof=1) for values in located.centred_sets())
    mean = located.measured.values.mean(axis=0)
    rows = []
    for row in located.table:
        # The row of all cells together has no column.
        k = columns.get((row.cell.family, row.cell.name))
        if k is not None:
            rows.append(WhereRow(**vars(row), mean=float(mean[k]), measured_spread=float(measured[k]),
                                 simulated_spread=float(simulated[k])))  # fmt: skip
    return Where(
        verdict=located.verdict,
        rows=tuple(rows),
        family_p=dict(located.family_p),
        global_p=dict(located.p_global) if pictures else {},
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
        input_speed_hz=located.comparison.conditions.input_speed_hz,
    )


@dataclass(frozen=True)
class EffectProbability:
    """Probability that an effect of the library is the missing one, after the fits.

    Attributes
    ----------
    effect : str
        Name of the effect.
    probability : float
        Given that the library holds the missing effect. Where effects were fitted, the ranker's probability
        (:class:`RankedEffect`) is weighted by how well they fit.
    """

    effect: str
    probability: float


@dataclass(frozen=True)
class GapResult:
    """Result of :func:`find_gap`: disagreement, missing effects, their sizes, and the reduction of the gap.

    Attributes
    ----------
    where : Where
        Recordings against the model as it was.
    where_after : Where or None
        The same recordings against the corrected model; None where nothing was added.
    ranking : tuple of EffectProbability
        The most probable first; empty where nothing disagrees.
    effects : tuple of Effect
        What was added to the model, with its parameters.
    parameters : tuple of FittedParameter
        Parameters of ``effects``.
    tie_group : tuple of str
        The first effect and those that the recordings cannot tell from it; empty where there are none.
    unknown : bool
        Whether no effect of the library explains all of it.
    unknown_score : float or None
        Grows with what the library leaves unexplained.
    next_measurement : str
        What would tell the first effect from its look-alikes.
    loss : float or None
        What the fit leaves, in squared standard deviations of one recording.
    proof : Proof or None
        None where no recordings were held out or nothing was added.
    rig : Rig
        The corrected model; the model as it was where nothing was added.
    warnings : tuple of str
    seconds : float
        Computing time.
    """

    where: Where
    rig: Rig
    where_after: Where | None = None
    ranking: tuple[EffectProbability, ...] = ()
    effects: tuple[Effect, ...] = ()
    parameters: tuple[FittedParameter, ...] = ()
    tie_group: tuple[str, ...] = ()
    unknown: bool = False
    unknown_score: float | None = None
    next_measurement: str = ""
    loss: float | None = None
    proof: Proof | None = None
    warnings: tuple[str, ...] = ()
    seconds: float = math.nan

    @property
    def verdict(self) -> str:
        """``"disagree"``, ``"equivalent"`` or ``"unresolved"``."""
        return self.where.verdict

    def probability(self, effect: str) -> float:
        """Probability of an effect; 0 where it is not in the ranking."""
        return next((row.probability for row in self.ranking if row.effect == effect), 0.0)

    def parameters_of(self, effect: str) -> list[FittedParameter]:
        """Parameters of one effect."""
        return [parameter for parameter in self.parameters if parameter.effect == effect]

    def to_dict(self) -> dict[str, Any]:
        """Plain values that JSON can hold, as ``cyclofeat gap --json`` prints them."""
        after = self.where_after
        scores = {} if self.proof is None else self.proof.to_dict()
        return {
            "format": FORMAT,
            "verdict": self.verdict,
            "p": self.where.p,
            "effects": [self._plain_effect(effect.effect_id) for effect in self.effects],
            "ranking": [{"id": row.effect, "probability": round(row.probability, 6)} for row in self.ranking],
            "tie_group": list(self.tie_group),
            "unknown": self.unknown,
            "unknown_score": self.unknown_score,
            "next_measurement": self.next_measurement,
            "loss": self.loss,
            "verdict_after": None if after is None else after.verdict,
            "grr": scores.pop(AFTER, None),
            "alternatives": scores,
            "warnings": list(self.warnings),
            "seconds": None if math.isnan(self.seconds) else round(self.seconds, 1),
        }

    def _plain_effect(self, name: str) -> dict[str, Any]:
        rows = self.parameters_of(name)
        return {
            "id": name,
            "probability": round(self.probability(name), 6),
            "theta": {row.name: row.value for row in rows},
            "interval": {row.name: [row.low, row.high] for row in rows},
            "unit": {row.name: row.unit for row in rows},
            "identifiable": {row.name: row.identifiable for row in rows},
            "at_bound": {row.name: row.at_bound for row in rows},
        }

    def to_frame(self, table: Literal["where", "ranking", "parameters", "proof"] = "where") -> pd.DataFrame:
        """One table of the result as a data frame.

        Parameters
        ----------
        table : {"where", "ranking", "parameters", "proof"}, default="where"

        Returns
        -------
        pandas.DataFrame
            One row per number compared, effect, fitted parameter, or alternative and condition.

        Raises
        ------
        ImportError
            If pandas is not installed.
        ValueError
            If there is no such table.
        """
        import pandas as pd

        if table == "where":
            of_rows = [asdict(row) for row in self.where.rows]
            return pd.DataFrame([row.pop("cell") | row for row in of_rows])
        rows: dict[str, tuple[Any, ...]] = {
            "ranking": self.ranking,
            "parameters": self.parameters,
            "proof": () if self.proof is None else self.proof.rows,
        }
        if table not in rows:
            raise ValueError(f"table must be 'where', 'ranking', 'parameters' or 'proof', got {table!r}")
        return pd.DataFrame([asdict(row) for row in rows[table]])

    def _repr_html_(self) -> str:
        rows = {"verdict": self.verdict, "p": f"{self.where.p:.2g}"}
        for row in self.parameters:
            size = f"{row.value:.3g} ({row.low:.3g} to {row.high:.3g}) {row.unit}"
            rows[f"{row.effect}: {row.name}"] = size
        if self.proof is not None:
            rows["share of the gap closed"] = f"{self.proof.result.grr:.0%}"
        cells = (f"<tr><th>{html.escape(k)}</th><td>{html.escape(v)}</td></tr>" for k, v in rows.items())
        return f"<table>{''.join(cells)}</table>"
