"""Result of the gap: the disagreement, the missing effects, and the reduction of the gap."""

from __future__ import annotations

import html
import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

from cyclofeat.gap._where import Where
from cyclofeat.gap.proof import AFTER, Proof
from cyclofeat.gap.size import FittedParameter
from cyclofeat.simulators import Effect, Rig

if TYPE_CHECKING:
    import pandas as pd

FORMAT = "cyclofeat gap 1"


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
