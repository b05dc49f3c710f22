"""Result of the gap: the answer, and what it stands on."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from cyclofeat.gap._measured import Condition
from cyclofeat.gap._overlays import Overlay
from cyclofeat.gap._where import Where
from cyclofeat.gap.proof import Proof
from cyclofeat.gap.summaries import Cell
from cyclofeat.gap.where import p_over_conditions, verdict_over_conditions
from cyclofeat.simulators import Effect, Rig

if TYPE_CHECKING:
    import pandas as pd

FORMAT = "cyclofeat gap 2"
Table = Literal["effects", "sizes", "remainder", "next_measurements", "where", "proof"]
TABLES: tuple[Table, ...] = ("effects", "sizes", "remainder", "next_measurements", "where", "proof")


@dataclass(frozen=True)
class Size:
    """Parameter of a missing effect.

    Attributes
    ----------
    name, unit : str
    value : float
        Median.
    low, high : float
        Its interval of 90 %.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class FoundEffect:
    """Whether an effect is missing in the model.

    Attributes
    ----------
    effect : str
        Name of the effect.
    probability : float
        That it is missing.
    answer : {"present", "absent", "unresolved"}
    sizes : tuple of Size
        Its parameters, if it is missing; empty where they were not learned.
    ties : tuple of str
        Other effects that the recordings cannot tell from it.
    """

    effect: str
    probability: float
    answer: str
    sizes: tuple[Size, ...] = ()
    ties: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class RemainderRow(Cell):
    """Number of which the corrected model is still wrong.

    Attributes
    ----------
    difference : float
        Measured minus corrected mean, in ``unit``.
    z : float
        The same in its standard errors.
    """

    difference: float
    z: float


@dataclass(frozen=True)
class Remainder:
    """What the corrected model leaves unexplained.

    Attributes
    ----------
    p : float
        Chance of a remainder this large if the corrected model were right.
    unexplained : bool
        Whether chance explains it no longer.
    rows : tuple of RemainderRow
        The clearest first.
    """

    p: float
    unexplained: bool
    rows: tuple[RemainderRow, ...] = ()


@dataclass(frozen=True)
class NextMeasurement:
    """Recordings to make next.

    Attributes
    ----------
    what : str
    separates : tuple of str
        Effects that they would tell apart.
    gain : float or None
        Expected information in bits; None where it was not computed.
    """

    what: str
    separates: tuple[str, ...] = ()
    gain: float | None = None


@dataclass(frozen=True, kw_only=True)
class GapResult:
    """Result of :func:`find_gap`: what the model lacks, how sure and how large, and what is left.

    Attributes
    ----------
    where : tuple of Where
        Recordings against the model as it was, one comparison per condition.
    rig : Rig
        The corrected model: the model with ``named`` added.
    posterior_rig : Rig or None
        The model with effects drawn from all that the recordings leave possible: each assembly drawn from it
        has another of its 200 variants. None where effects were not asked for.
    effects : tuple of FoundEffect
        All effects that were asked for, the most probable first.
    named : tuple of Effect
        Those that were added, with their sizes.
    confirmed : bool
        Whether simulation has confirmed and corrected set and sizes.
    remainder : Remainder or None
        None where the corrected model was not simulated.
    next_measurements : tuple of NextMeasurement
        The most useful first.
    overlays : tuple of Overlay
        Recordings, model and corrected model, for pictures.
    proof : tuple of Proof
        One per condition held out; empty where nothing was held out or nothing named.
    unknown : bool
        Whether something is missing that none of ``effects`` explains.
    warnings : tuple of str
    seconds : float
        Computing time.
    """

    where: tuple[Where, ...]
    rig: Rig
    posterior_rig: Rig | None = field(default=None, repr=False)
    effects: tuple[FoundEffect, ...] = ()
    named: tuple[Effect, ...] = ()
    confirmed: bool = False
    remainder: Remainder | None = None
    next_measurements: tuple[NextMeasurement, ...] = ()
    overlays: tuple[Overlay, ...] = field(default=(), repr=False)
    proof: tuple[Proof, ...] = ()
    unknown: bool = False
    warnings: tuple[str, ...] = ()
    seconds: float = math.nan

    @property
    def p(self) -> float:
        """Smallest adjusted p of all conditions, adjusted for their number too."""
        return p_over_conditions(self.where)

    @property
    def verdict(self) -> str:
        """``"disagree"``, ``"equivalent"`` or ``"unresolved"``, over all conditions."""
        return verdict_over_conditions(self.where)

    def effect(self, name: str) -> FoundEffect:
        """Return what was found of an effect.

        Raises
        ------
        KeyError
            If it was not asked for.
        """
        for found in self.effects:
            if found.effect == name:
                return found
        raise KeyError(f"{name} is not among the effects that were asked for")

    def to_dict(self) -> dict[str, Any]:
        """Plain values that JSON can hold, as ``cyclofeat gap --json`` prints them."""
        plain = {
            "format": FORMAT,
            "verdict": self.verdict,
            "p": self.p,
            "effects": [_plain_effect(found) for found in self.effects],
            "named": [effect.effect_id for effect in self.named],
            "confirmed": self.confirmed,
            "unknown": self.unknown,
            "remainder": None if self.remainder is None else asdict(self.remainder),
            "next_measurements": [asdict(one) for one in self.next_measurements],
            "conditions": [
                asdict(where.condition)
                | {"verdict": where.verdict, "p": where.p, "recordings": where.n_recordings}
                for where in self.where
            ],
            "proof": [_at(proof.condition) | {"closed": proof.to_dict()} for proof in self.proof],
            "warnings": list(self.warnings),
            "seconds": round(self.seconds, 1),
        }
        return dict(finite(plain))

    def to_frame(self, table: Table = "effects") -> pd.DataFrame:
        """One table of the result as a data frame.

        Parameters
        ----------
        table : {"effects", "sizes", "remainder", "next_measurements", "where", "proof"}, default="effects"

        Returns
        -------
        pandas.DataFrame
            One row per effect, parameter, number that remains, measurement, number compared, or alternative.

        Raises
        ------
        ImportError
            If pandas is not installed.
        ValueError
            If there is no such table.
        """
        import pandas as pd

        if table not in TABLES:
            raise ValueError(f"table must be one of {', '.join(TABLES)}, got {table!r}")
        return pd.DataFrame(self._rows(table))

    def _rows(self, table: Table) -> list[dict[str, Any]]:
        if table == "effects":
            return [{k: v for k, v in asdict(found).items() if k != "sizes"} for found in self.effects]
        if table == "sizes":
            return [{"effect": found.effect} | asdict(size) for found in self.effects for size in found.sizes]
        if table == "remainder":
            return [asdict(row) for row in self.remainder.rows] if self.remainder else []
        if table == "next_measurements":
            return [asdict(one) for one in self.next_measurements]
        of_conditions: Sequence[Where | Proof] = self.where if table == "where" else self.proof
        rows = [_at(one.condition) | asdict(row) for one in of_conditions for row in one.rows]
        return [row.pop("cell", {}) | row for row in rows]

    def _repr_html_(self) -> str:
        rows = {"verdict": self.verdict, "p": f"{self.p:.2g}"}
        for effect in self.named:
            found = self.effect(effect.effect_id)
            rows[found.effect] = f"probability {found.probability:.3g}"
            for size in found.sizes:
                text = f"{size.value:.3g} ({size.low:.3g} to {size.high:.3g}) {size.unit}"
                rows[f"{found.effect}: {size.name}"] = text
        if self.remainder is not None:
            rows["unexplained"] = f"{'yes' if self.unknown else 'nothing'} (p = {self.remainder.p:.2g})"
        for proof in self.proof:
            at = "" if proof.condition is None else f" at {proof.condition.text}"
            rows[f"share of the gap closed{at}"] = f"{proof.result.grr:.0%}"
        cells = (f"<tr><th>{html.escape(k)}</th><td>{html.escape(v)}</td></tr>" for k, v in rows.items())
        return f"<table>{''.join(cells)}</table>"


def _plain_effect(found: FoundEffect) -> dict[str, Any]:
    sizes = {size.name: {k: v for k, v in asdict(size).items() if k != "name"} for size in found.sizes}
    return {
        "id": found.effect, "probability": round(found.probability, 6), "answer": found.answer,
        "sizes": sizes, "ties": list(found.ties),
    }  # fmt: skip


def _at(condition: Condition | None) -> dict[str, Any]:
    return {} if condition is None else asdict(condition)


def finite(value: Any) -> Any:
    """The value with None for NaN and infinity, which JSON does not know."""
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
