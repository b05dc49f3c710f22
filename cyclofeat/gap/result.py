"""Result of the gap: the answer, and what it stands on."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar, get_args

import numpy as np

from cyclofeat._base import checks, displays, draw_plot
from cyclofeat._base.displays import Card, WithCard, data_frame
from cyclofeat._base.gap_words import cell_name, mean_difference_words, p_words
from cyclofeat._base.quantities import (
    beyond_text,
    number_of,
    probability_text,
    quantity_parts,
    quantity_text,
    some_of,
)
from cyclofeat.gap.overlays import Overlay
from cyclofeat.gap.posterior.answers import State
from cyclofeat.gap.proof.prove import Proof
from cyclofeat.gap.summaries.summarise import Cell
from cyclofeat.gap.where.locate import Where
from cyclofeat.simulators import Effect, Rig, known_effects

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

FORMAT = "cyclofeat gap 2"
Table = Literal["effects", "sizes", "remainder", "next_measurements", "where", "proof"]
LEFT = {
    "chance": "nothing that chance does not explain",
    "undecided effects": "differences that undecided effects may explain",
    "unknown": "differences that no effect considered explains",
}
_VERDICTS = {
    "disagree": "Model and recordings disagree",
    "equivalent": "Model and recordings agree within the margins",
    "unresolved": "No single difference is clear: more recordings may show one",
}


@dataclass(frozen=True)
class Size:
    """Parameter of a missing effect."""

    name: str
    unit: str
    value: float  # median
    low: float  # ends of its interval of 90 %
    high: float

    @property
    def label(self) -> str:
        """Name in words, without the unit: ``amplitude``."""
        return re.sub("_(nm|hz|s)$", "", self.name).replace("_", " ")

    @property
    def parts(self) -> tuple[str, str, str]:
        """Texts of value, interval (empty where it is not known) and unit."""
        (value, low, high), unit = quantity_parts([self.value, self.low, self.high], self.unit)
        known = not math.isnan(self.low) and not math.isnan(self.high)
        return value, f"({low} to {high})" if known else "", "" if unit == "1" else unit

    def __str__(self) -> str:
        return " ".join(filter(None, (self.label, *self.parts)))


@dataclass(frozen=True)
class VisibleFrom:
    """Sizes of an effect that recordings show: half of the simulated rigs with it so large are named."""

    name: str  # of its main parameter
    unit: str
    below: float  # values beyond which it is seen; NaN on a side on which it grows no stronger
    above: float

    def __str__(self) -> str:
        return beyond_text(self.below, self.above, lambda end: quantity_text([end], self.unit))


@dataclass(frozen=True)
class FoundEffect:
    """Answer about one effect: its probability of being missing in the model, and the word for it."""

    effect: str
    probability: float
    # From 0.95 on, from 0.5 on (of look-alikes, together), or between; too small to be seen; up to 0.05.
    state: State
    sizes: tuple[Size, ...] = ()  # its parameters, if it is missing; empty where they were not learned
    ties: tuple[str, ...] = ()  # look-alikes in these recordings that are not named themselves
    visible: float = math.nan  # probability that it is missing and large enough to be seen
    visible_from: VisibleFrom | None = None  # sizes that are large enough, if any is

    @property
    def name(self) -> str:
        """Name in plain words: ``Mains hum in the torque signal``."""
        effect = known_effects().get(self.effect)
        if effect is None:
            return self.effect.replace("_", " ")
        return effect.summary.partition(":")[0].partition(",")[0].removesuffix(".")

    def __str__(self) -> str:
        return f"{self.effect} ({probability_text(self.probability)})"


@dataclass(frozen=True, kw_only=True)
class RemainderRow(Cell):
    """Statistic that the corrected model still misses."""

    difference: float  # measured minus corrected mean, in ``unit``
    z: float  # the same in its standard errors


@dataclass(frozen=True)
class Remainder:
    """Differences that the corrected model leaves unexplained."""

    p: float  # chance of a remainder this large if the corrected model were right
    unexplained: bool  # neither chance nor undecided effects explain it
    rows: tuple[RemainderRow, ...] = field(default=(), repr=False)  # the clearest first
    # Chance of it if each undecided effect were there as often as it is probable; None where chance alone
    # explains it, or no effect is undecided.
    p_undecided: float | None = None

    @property
    def cause(self) -> Literal["chance", "undecided effects", "unknown"]:
        """Explanation of the remainder."""
        if self.unexplained:
            return "unknown"
        return "chance" if self.p_undecided is None else "undecided effects"


@dataclass(frozen=True)
class NextMeasurement:
    """Recordings to make next."""

    what: str
    decides: tuple[str, ...] = ()  # effects about which they would decide

    def __str__(self) -> str:
        return self.what + (f", to decide about {some_of(self.decides)}" if self.decides else "")


AnyRow = TypeVar("AnyRow")


class EffectRows(Generic[AnyRow]):
    """Base of results that have a row for each effect that was asked for."""

    effects: tuple[AnyRow, ...]

    def effect(self, name: str) -> AnyRow:
        """Return the row of an effect; ``KeyError`` if it was not asked for."""
        rows: dict[str, Any] = {vars(row)["effect"]: row for row in self.effects}
        if name in rows:
            return rows[name]  # type: ignore[no-any-return]
        raise KeyError(f"{name} is not among the effects that were asked for: {', '.join(rows) or 'none'}")


@dataclass(frozen=True, kw_only=True)
class GapResult(EffectRows[FoundEffect], WithCard):
    """Result of :func:`find_gap`: missing effects with probabilities and sizes, and the remainder.

    Attributes
    ----------
    where : tuple of Where
        Recordings against the model as it was, one comparison per condition.
    rig : Rig
        The corrected model: the model with ``named`` added.
    quantity : {"output_torque", "input_torque"}
        What was measured. Input torque is referred to the output here.
    posterior_rig : Rig or None
        The model with effects drawn from all that the recordings leave possible: each assembly drawn from it
        has another of its 200 variants. None where effects were not asked for.
    effects : tuple of FoundEffect
        All effects that were asked for, the most probable first.
    named : tuple of Effect
        Those that were added, with their sizes.
    remainder : Remainder or None
        What the corrected model leaves; None where effects were not asked for. Where it leaves something
        unexplained, an effect is missing that is not in ``effects``.
    size_note : str
        Reason for which sizes may be off by more than their intervals, also among the warnings; empty
        without one.
    next_measurements : tuple of NextMeasurement
        The most useful first.
    overlays : tuple of Overlay
        Recordings, model and corrected model, for pictures.
    proof : tuple of Proof
        One per condition held out; empty where nothing was held out or nothing named.
    warnings : tuple of str
    seconds : float
        Computing time.
    """

    where: tuple[Where, ...] = field(repr=False)
    rig: Rig = field(repr=False)
    quantity: str = "output_torque"
    posterior_rig: Rig | None = field(default=None, repr=False)
    effects: tuple[FoundEffect, ...] = field(default=(), repr=False)
    named: tuple[Effect, ...] = ()
    remainder: Remainder | None = None
    size_note: str = ""
    next_measurements: tuple[NextMeasurement, ...] = ()
    overlays: tuple[Overlay, ...] = field(default=(), repr=False)
    proof: tuple[Proof, ...] = field(default=(), repr=False)
    warnings: tuple[str, ...] = ()
    seconds: float = math.nan

    @property
    def p(self) -> float:
        """Smallest adjusted p of all conditions, adjusted for their number too (Bonferroni)."""
        return min(1.0, len(self.where) * min(where.p for where in self.where))

    @property
    def verdict(self) -> str:
        """``"disagree"`` if one condition does, ``"equivalent"`` if all are, else ``"unresolved"``."""
        verdicts = {where.verdict for where in self.where}
        if "disagree" in verdicts:
            return "disagree"
        return "equivalent" if verdicts == {"equivalent"} else "unresolved"

    def of_state(self, *states: State) -> tuple[FoundEffect, ...]:
        """Return the effects of some states, the most probable first.

        Look-alikes of a missing effect stand beside it, and are left out.

        Parameters
        ----------
        *states : str
            As in :class:`FoundEffect`.

        Returns
        -------
        tuple of FoundEffect
        """
        beside = {tie for effect in self.named for tie in self.effect(effect.effect_id).ties}
        return tuple(row for row in self.effects if row.state in states and row.effect not in beside)

    @property
    def headline(self) -> str:
        """The answer in one sentence: ``2 effects are missing in the model, 1 is probably missing``."""
        unknown = bool(self.caution)
        missing, likely = (len(self.of_state(state)) for state in get_args(State)[:2])
        if not missing + likely:
            text = _VERDICTS[self.verdict]
            if self.verdict == "disagree" and self.effects:
                text += f", and {'no effect considered explains it' if unknown else 'no effect is decided'}"
            return text
        parts = [
            f"{number_of(n, 'effect') if first else n} {'is' if n == 1 else 'are'} {state}{where}"
            for n, state, where, first in (
                (missing, "missing", " in the model", True), (likely, "probably missing", "", not missing),
            )
            if n
        ]  # fmt: skip
        return ", ".join([*parts, *(["something unknown is missing too"] if unknown else [])])

    @property
    def caution(self) -> str:
        """Sentence to read before the corrected model is used; empty where it leaves nothing unknown."""
        if self.remainder is None or not self.remainder.unexplained:
            return ""
        return (
            "Something is still missing: try the counter on recordings with known counts before you trust it."
        )

    @property
    def undecided_text(self) -> str:
        """What is undecided, and what would decide it, in one line; empty if nothing is."""
        rows = self.of_state("undecided")
        if not rows:
            return ""
        names, text = {row.effect for row in rows}, f"{number_of(len(rows), 'effect')} undecided"
        helpful = [row.what for row in self.next_measurements if names & {*row.decides}]
        return text + (f"; most would be decided by {helpful[0]}" if helpful else "")

    def to_dict(self) -> dict[str, Any]:
        """Return plain values that JSON can hold, as ``cyclofeat gap --json`` prints them.

        Returns
        -------
        dict from str to object
        """
        # fmt: off
        plain = {
            "format": FORMAT,
            "text": str(self).splitlines(),
            "headline": self.headline,
            "verdict": self.verdict,
            "p": self.p,
            "quantity": self.quantity,
            "effects": [
                {
                    "id": row.effect, "probability": round(row.probability, 6), "state": row.state,
                    "sizes": {size.pop("name"): size for size in map(asdict, row.sizes)},
                    "ties": list(row.ties), "visible": row.visible,
                    "visible_from": None if row.visible_from is None else asdict(row.visible_from),
                }
                for row in self.effects
            ],
            "named": [effect.effect_id for effect in self.named],
            "size_note": self.size_note,
            "remainder": None if self.remainder is None else asdict(self.remainder),
            "next_measurements": [asdict(one) for one in self.next_measurements],
            "conditions": [
                asdict(where.condition)
                | {"verdict": where.verdict, "p": where.p, "recordings": where.n_recordings}
                for where in self.where
            ],
            "proof": [
                (asdict(proof.condition) if proof.condition else {}) | {"closed": proof.to_dict()}
                for proof in self.proof
            ],
            "warnings": list(self.warnings),
            "seconds": round(self.seconds, 1),
        }
        # fmt: on
        return dict(replace_nonfinite(plain))

    def to_frame(self, table: Table = "effects") -> pd.DataFrame:
        """Return one table of the result as a data frame; needs pandas.

        Parameters
        ----------
        table : {"effects", "sizes", "remainder", "next_measurements", "where", "proof"}, default="effects"

        Returns
        -------
        pandas.DataFrame
            One row per effect, parameter, number that remains, measurement, number compared, or alternative.
        """
        rows: list[dict[str, Any]] = []
        match checks.one_of("table", table, get_args(Table)):
            case "effects":
                hidden = ("sizes", "visible_from")
                rows = [{k: v for k, v in asdict(row).items() if k not in hidden} for row in self.effects]
            case "sizes":
                rows = [{"effect": row.effect} | asdict(size) for row in self.effects for size in row.sizes]
            case "remainder":
                rows = [asdict(row) for row in self.remainder.rows] if self.remainder else []
            case "next_measurements":
                rows = [asdict(row) for row in self.next_measurements]
            case _:
                parts: Sequence[Where | Proof] = self.where if table == "where" else self.proof
                for part in parts:
                    at = asdict(part.condition) if part.condition else {}
                    plain = [at | asdict(row) for row in part.rows]
                    rows += [row.pop("cell", {}) | row for row in plain]
        return data_frame(rows)

    def plot(
        self,
        kind: Literal["spectrum", "orders", "distribution", "differences", "closed"] = "spectrum",
        ax: Axes | None = None,
        **options: Any,
    ) -> Any:
        """Draw the result at one condition.

        Parameters
        ----------
        kind : {"spectrum", "orders", "distribution", "differences", "closed"}, default="spectrum"
            Recordings, model and corrected model over each other, by one of the first three; the clearest
            differences between recordings and model; or the share of the gap that each alternative closes.
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        **options
            ``condition`` (number of the condition, default 0) and, but for ``"closed"``, ``label`` (name of
            the recordings).

        Returns
        -------
        GapOverlayDisplay, GapDisplay or GapReductionDisplay
            Of :mod:`cyclofeat.plotting`; with the axes ``ax_`` and the ``figure_``.

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If there is no such kind or condition, or the result holds nothing of the kind.
        """
        return draw_plot(self, kind, ax, **options)

    def _card(self) -> Card:
        n = sum(where.n_recordings for where in self.where)
        conditions = [where.condition.text for where in self.where]
        against = f"against the model: {self.verdict} (p = {self.p:.2g})"
        rows: dict[str, object] = {"recordings": f"{n} at {'; '.join(conditions)}; {against}"}
        for row in self.of_state("missing", "probably missing"):
            either = ", or ".join(map(str, [row, *map(self.effect, row.ties)]))
            rows[f"{row.state}: {either}"] = "; ".join(map(str, row.sizes)) or row.name
        rows["undecided"] = some_of(self.of_state("undecided"))
        if self.remainder is not None:
            clearest = self.remainder.rows[:1] if self.remainder.unexplained else ()
            left = [f"{LEFT[self.remainder.cause]} ({p_words(self.remainder.p)})"]
            for one in clearest:
                difference = mean_difference_words(one.difference, one.unit)
                left.append(f"most of all {cell_name(one)}: {difference} in the recordings")
            rows["left unexplained"] = ", ".join(left)
        rows["measure next"] = "".join(map(str, self.next_measurements[:1]))
        rows["gap closed on recordings held out"] = "; ".join(map(str, self.proof))
        code = 'result.to_frame("sizes")' if self.named else 'result.to_frame("where")'
        return Card(self.headline, rows, self._draw_first_overlay, self.warnings, code)

    def _draw_first_overlay(self) -> list[str]:
        curves = []
        for overlay in self.overlays[:1]:
            looks = (
                (overlay.measured, displays.Curve(overlay.x, width=2.4)),
                (overlay.model, displays.Curve(overlay.x, "currentColor", 1.0, "4 3")),
                (overlay.corrected, displays.Curve(overlay.x, displays.SECOND, 1.2)),
            )
            drawn = [
                look._replace(values=np.log(np.maximum(band.mean, np.finfo(float).tiny)))
                for band, look in looks
                if band is not None
            ]
            text = (
                f"{overlay.kind.capitalize()} at {overlay.condition.text}: recordings (wide), model (dashed)"
            )
            text += "" if overlay.corrected is None else ", corrected model (thin)"
            curves.append(displays.draw_curves(drawn, text))
        return curves


def replace_nonfinite(value: Any) -> Any:
    """The value with None for NaN and infinity, which JSON does not know."""
    if isinstance(value, dict):
        return {key: replace_nonfinite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [replace_nonfinite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
