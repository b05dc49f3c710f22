"""Text of a gap for people: what is missing, how sure, how large, what is left, what to measure next."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from cyclofeat.plotting.gap_words import (
    VERDICTS,
    cell_name,
    effect_name,
    mean_difference_words,
    p_words,
)

if TYPE_CHECKING:
    from cyclofeat.gap import FoundEffect, GapResult, Proof, Remainder

_N_REMAINING = 3


def gap_lines(result: GapResult) -> list[str]:
    """Lines that tell a result, the answer first."""
    lines = [f"{VERDICTS[result.verdict]} (p = {result.p:.2g}, adjusted over all comparisons)"]
    named = {effect.effect_id for effect in result.named}
    told = set(named)
    for found in result.effects:
        if found.effect in named or found.answer == "present":
            look_alikes = [name for name in found.ties if name not in named]
            lines += _effect(found, [result.effect(name) for name in look_alikes])
            told.update(look_alikes)
    rest = [found for found in result.effects if found.answer == "unresolved" and found.effect not in told]
    open_ones = [f"{found.effect} ({found.probability:.0%})" for found in rest if not found.small]
    if open_ones:
        lines.append(f"open: {', '.join(open_ones)}")
    small = [
        f"{found.effect} ({found.probability:.0%}, {found.visible_from})" for found in rest if found.small
    ]
    if small:
        lines.append(f"open, but too small to be seen; would be seen with: {', '.join(small)}")
    if result.remainder is not None:
        lines += _remaining(result.remainder)
    for one in result.next_measurements[:1]:
        apart = f", to tell apart {', '.join(one.separates)}" if one.separates else ""
        lines.append(f"measure next: {one.what}{apart}")
    for proof in result.proof:
        at = f" at {proof.condition.text}" if proof.condition else ""
        lines.append(f"held out{at}: {_closed(proof)}")
    return lines + [f"note: {warning}" for warning in result.warnings]


def _effect(found: FoundEffect, look_alikes: Sequence[FoundEffect]) -> Iterator[str]:
    word = "missing" if found.answer == "present" else "probably missing"
    first, *others = (f"{one.effect} ({one.probability:.0%})" for one in (found, *look_alikes))
    ties = f", or {', '.join(others)}" if others else ""
    yield f"{word}: {first}{ties}: {effect_name(found.effect)}"
    yield from (f"  {size}" for size in found.sizes)


def _remaining(remainder: Remainder) -> Iterator[str]:
    if remainder.cause == "chance":
        yield f"left unexplained: nothing ({p_words(remainder.p)})"
        return
    if remainder.p_open is not None and not remainder.unexplained:
        yield (
            f"left unexplained: differences that open effects may explain ({p_words(remainder.p_open)}; "
            f"without them {p_words(remainder.p)}); sizes are not confirmed by simulation"
        )
        return
    yield f"left unexplained ({p_words(remainder.p)}):"
    for row in remainder.rows[:_N_REMAINING]:
        yield f"  {cell_name(row)}: {mean_difference_words(row.difference, row.unit)}"
    yield "something is missing that no effect considered explains: sizes are not confirmed by simulation"


def _closed(proof: Proof) -> str:
    closed = proof.result
    if math.isnan(closed.grr):
        return "too little disagreement to state how far it shrank"
    within = f" ({closed.low:.0%} to {closed.high:.0%})" if closed.low <= closed.high else ""
    return f"{closed.grr:.0%} of the gap closed{within}"
