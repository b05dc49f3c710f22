"""Answer of the page of a gap: which effects are missing, and how far the correction closes the gap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from cyclofeat._base.quantities import beyond_text, number_of
from cyclofeat.plotting import GapReductionDisplay
from cyclofeat.plotting.gap_words import (
    CONDITIONS,
    OURS,
    alternative_name,
    cell_name,
    effect_name,
    family_name,
    mean_difference_words,
    p_words,
)
from cyclofeat.report._figures import draw_picture
from cyclofeat.report._page import (
    keep_together,
    percent_text,
    probability_text,
    quantity_text,
    range_text,
    rounded_text,
)

if TYPE_CHECKING:
    from cyclofeat.gap import GapResult
    from cyclofeat.gap.proof.prove import Proof, ProofRow
    from cyclofeat.gap.result import FoundEffect, Remainder, Size


def the_answer(result: GapResult, word: str) -> dict[str, Any]:
    """Heading, sentences, and one row for each effect that is missing or may be.

    ``word`` names the recordings in the heading: ``"measurement"``.
    """
    rows = _effect_rows(result)
    shown = {name for row in rows for name in row["ids"]}
    rest = [found for found in result.effects if found.effect not in shown]
    return {
        "heading": _answer_heading(result, word),
        "sentences": _answer_sentences(result, word),
        "rows": rows,
        "rest": [_describe_rest(found) for found in rest],
        "rest_heading": f"{number_of(len(rest), 'other effect')} not missing, or too small to be seen"
        if rest
        else "",
        "tiles": _answer_tiles(result) if result.effects else [],
    }


def what_remains(remainder: Remainder, model: str) -> dict[str, Any]:
    """Return the differences that a model, named in words, leaves unexplained."""
    p = keep_together(p_words(remainder.p))
    if remainder.cause == "chance":
        text = f"Nothing that chance does not explain: the {model} agrees with the recordings ({p})."
        return {"sentences": [text], "rows": []}
    rows = [
        {
            "what": cell_name(row),
            "difference": mean_difference_words(row.difference, row.unit),
            "z": rounded_text(abs(row.z)),
        }
        for row in remainder.rows
    ]
    cause = "something is missing that none of the effects considered accounts for"
    if remainder.p_open is not None and not remainder.unexplained:
        cause = f"effects that are still open may be the cause ({keep_together(p_words(remainder.p_open))})"
    text = (
        f"The {model} differs from the recordings by more than chance explains ({p}): {cause}. The clearest "
        "remaining differences show where to look for it."
    )
    return {"sentences": [text], "rows": rows}


def measure_next(result: GapResult) -> list[dict[str, str]]:
    """Return the recordings to make next, the most useful first."""
    return [
        {
            "what": one.what[:1].upper() + one.what[1:],
            "separates": ", ".join(effect_name(name) for name in one.separates),
            "gain": "" if one.gain is None else f"{one.gain:.2g} bit",
        }
        for one in result.next_measurements
    ]


def _answer_heading(result: GapResult, word: str) -> str:
    answers = [result.effect(effect.effect_id).answer for effect in result.named]
    sure = answers.count("present")
    likely = len(answers) - sure
    parts = (
        [f"{number_of(sure, 'effect')} {'is' if sure == 1 else 'are'} missing in the model"] if sure else []
    )
    if likely:
        parts.append(f"{likely} more probably" if sure else f"{number_of(likely, 'effect')} probably missing")
    unexplained = result.remainder is not None and result.remainder.unexplained
    if parts and unexplained:
        parts.append("and something unknown")
    if parts:
        return ", ".join(parts)
    if result.verdict == "equivalent":
        return f"Model and {word} agree"
    if result.verdict == "unresolved":
        return "No clear answer yet"
    end = ""
    if result.effects:
        end = ", and no effect considered explains it" if unexplained else "; what is missing is open"
    return f"Model and {word} disagree{end}"


def _answer_sentences(result: GapResult, word: str) -> list[str]:
    n = sum(where.n_recordings for where in result.where)
    at = f" at {len(result.where)} conditions" if len(result.where) > 1 else ""
    if result.verdict == "disagree":
        texts = [
            f"Model and {word} disagree: if the model were right, differences this clear would arise by "
            f"chance in at most 1 of {rounded_text(1 / max(result.p, 1e-9))} such comparisons "
            f"({keep_together(p_words(result.p))}, {number_of(n, 'recording')}{at})."
        ]
    elif result.verdict == "equivalent":
        texts = [f"All numbers compared agree within the margins ({number_of(n, 'recording')}{at})."]
    elif result.named:
        texts = [
            f"One by one, no number differs clearly ({number_of(n, 'recording')}{at}); all of them together "
            "show the effects above."
        ]
    else:
        texts = [
            f"No single difference is clear, but {number_of(n, 'recording')}{at} "
            f"{'is' if n == 1 else 'are'} too few to show agreement."
        ]
    if result.named and result.remainder is not None:
        texts.append(
            "Effects and sizes come from the posterior, which learned from simulated rigs; a simulation of "
            "this rig has not confirmed them."
            if result.remainder.cause != "chance"
            else "Simulation of the corrected model has confirmed the effects and their sizes."
        )
    return texts


def _effect_rows(result: GapResult) -> list[dict[str, Any]]:
    """Effects that are missing, and those that may be; one that is tied to an earlier one only beside it."""
    named = {effect.effect_id for effect in result.named}
    rows: list[dict[str, Any]] = []
    seen: set[str] = set()
    for found in result.effects:
        may_be = found.answer == "present" or (found.answer == "unresolved" and not found.small)
        if found.effect not in named and (not may_be or found.effect in seen):
            continue
        ties = [name for name in found.ties if name not in named]
        seen |= {found.effect, *ties}
        rows.append(_effect_row(result, found, ties, found.effect in named))
    return rows


def _describe_rest(found: FoundEffect) -> str:
    """An effect that is not missing: its probability, and the size that would have been seen."""
    text, seen = probability_text(found.probability), found.visible_from
    if seen is not None:
        text += f"; seen {beyond_text(seen.below, seen.above, lambda end: quantity_text([end], seen.unit))}"
    return f"{effect_name(found.effect)} ({text})"


def _effect_row(result: GapResult, found: FoundEffect, ties: Sequence[str], named: bool) -> dict[str, Any]:
    asked = {one.effect: one.probability for one in result.effects}
    together = min(found.probability + sum(asked.get(name, 0.0) for name in ties), 1.0)
    return {
        "id": found.effect,
        "ids": [found.effect, *ties],
        "name": effect_name(found.effect),
        "answer": "missing" if found.answer == "present" else "probably missing" if named else "open",
        "named": named,
        "probability": found.probability,
        "text": probability_text(found.probability),
        "sizes": [_size_entry(size) for size in found.sizes],
        "ties": [effect_name(name) for name in ties],
        "together": probability_text(together),
    }


def _size_entry(size: Size) -> dict[str, str]:
    ends = [size.low, size.high]
    return {
        "name": size.name.removesuffix("_nm").removesuffix("_hz").removesuffix("_s").replace("_", " "),
        "value": quantity_text([size.value], size.unit),
        "range": "" if any(math.isnan(end) for end in ends) else quantity_text(ends, size.unit),
    }


def _answer_tiles(result: GapResult) -> list[dict[str, str]]:
    tiles = [_closed_tile(result)] if result.named else []
    if result.remainder is not None:
        value, text = "nothing", f"the remaining differences are chance ({p_words(result.remainder.p)})"
        if result.remainder.cause == "open effects":
            value, text = "perhaps nothing", "open effects may explain the remaining differences"
        elif result.remainder.unexplained:
            value, text = "something", "none of the effects considered explains all of it"
            if result.remainder.rows:
                row = result.remainder.rows[0]
                text = f"most of all: {cell_name(row)}, {mean_difference_words(row.difference, row.unit)}"
        tiles.append({"label": "Left unexplained", "value": value, "text": text})
    if result.next_measurements:
        first = measure_next(result)[0]
        text = f"to tell apart: {first['separates']}" if first["separates"] else ""
        tiles.append({"label": "Measure next", "value": "", "strong": first["what"], "text": text})
    return tiles


def _closed_tile(result: GapResult) -> dict[str, str]:
    label = "Gap closed on recordings held out"
    if not result.proof:
        return {"label": label, "value": "not tested", "text": "no recordings were held out"}
    shares = [proof.result.grr for proof in result.proof if math.isfinite(proof.result.grr)]
    if not shares:
        return {"label": label, "value": "not defined", "text": "the gap is too small there"}
    if len(result.proof) == 1:
        ours = result.proof[0].result
        text = f"range {range_text(ours.low, ours.high)}"
        return {"label": label, "value": percent_text(ours.grr), "text": text}
    value = range_text(min(shares), max(shares)) or percent_text(shares[0])
    return {"label": label, "value": value, "text": f"at {len(shares)} of {len(result.proof)} conditions"}


def summarise_reduction(proof: Proof) -> dict[str, Any]:
    """Return the share of the gap closed on recordings held out at one condition."""
    ours = proof.result
    rows = proof.rows
    if not any(row.condition == "unseen" for row in rows):  # then all counts were seen
        rows = tuple(row for row in rows if row.condition == "all")
    if math.isnan(ours.grr):
        reason = (ours.undefined or "the gap on the recordings held out is too small").removesuffix(".")
        sentences = [f"No share of the gap can be stated: {reason}."]
    else:
        text = range_text(ours.low, ours.high)
        closed = f"closed {percent_text(ours.grr)} of the gap"
        if ours.grr < 0:
            closed = f"widened the gap by {-100 * ours.grr:.0f} %"
        sentences = [
            f"On recordings to which nothing was fitted, the correction {closed}"
            + (f" (range {text})." if text else "."),
            *_by_condition(rows),
        ]
    finite = [row for row in rows if math.isfinite(row.grr)]
    drawn = None
    if finite:
        display = GapReductionDisplay(finite)
        n = len(dict.fromkeys(row.alternative for row in finite))
        drawn = draw_picture(
            lambda ax, _: display.plot(ax),
            (8.0, 1.5 + 0.55 * n),
            "Share of the gap that the correction closes, with its range",
        )
    conditions = [name for name in CONDITIONS if any(row.condition == name for row in rows)]
    table = []
    for alternative in dict.fromkeys(row.alternative for row in rows):
        cells = []
        for condition in conditions:
            of = [row for row in rows if (row.alternative, row.condition) == (alternative, condition)]
            cells.append(
                {"value": percent_text(of[0].grr), "range": range_text(of[0].low, of[0].high)} if of else None
            )
        table.append({"name": alternative_name(alternative), "cells": cells})
    comparison_table = {"rows": table, "conditions": [CONDITIONS[name] for name in conditions]}
    return {
        "sentences": sentences,
        **comparison_table,
        "distances": _distance_rows(proof),
        "picture": drawn,
    }


def _by_condition(rows: Sequence[ProofRow]) -> list[str]:
    ours = {row.condition: row for row in rows if row.alternative == OURS}
    known = [name for name in ("seen", "unseen") if name in ours]
    parts = [
        f"{percent_text(ours[name].grr)} with {CONDITIONS[name]}"
        for name in known
        if math.isfinite(ours[name].grr)
    ]
    sentences = [f"That is {' and '.join(parts)}."] if parts else []
    for name in known:
        if ours[name].undefined and not math.isfinite(ours[name].grr):
            reason = ours[name].undefined.removesuffix(".")
            sentences.append(f"With {CONDITIONS[name]} no share can be stated: {reason}.")
    return sentences


def _distance_rows(proof: Proof) -> list[dict[str, Any]]:
    """Distances by kind of number: before, after, and by replication alone (None if not known)."""
    of: dict[str, dict[str, float]] = {}
    for row in proof.distances:
        if row.condition == "all":
            of.setdefault(row.alternative, {})[row.family] = row.distance
    before, after, floor = (of.get(name, {}) for name in ("nothing", OURS, "floor"))
    return [
        {"name": family_name(name), "before": before[name], "after": after[name], "floor": floor.get(name)}
        for name in before
        if name in after
    ]
