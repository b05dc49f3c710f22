"""How far the gap shrank, as the page of a gap shows it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from cyclofeat.plotting import GapReductionDisplay
from cyclofeat.plotting.gap_words import CONDITIONS, OURS, alternative_name, family_name
from cyclofeat.report._figures import draw_picture
from cyclofeat.report._gap_numbers import percent_text, range_text

if TYPE_CHECKING:
    from cyclofeat.gap import Proof, ProofRow

_EXPLAINED = {
    "nothing": "the model as it was: 0 % by definition.",
    "retuned": "stiffness and damping of the contacts fitted again, without a new effect. What this closes "
    "needs no new physics.",
    "equaliser": "a filter and shaped noise behind the model, fitted to the spectrum. It knows no cause; it "
    "may do well on the conditions it was fitted to.",
    "gaussian_process": "a smooth curve through the difference of the spectra, added to the model's. It "
    "knows no cause either.",
    "placebo": "the best of the effects that are not look-alikes, fitted with the same effort: what any "
    "added effect closes.",
    "oracle": "the simulator that made these recordings: the largest share that can be closed.",
}


def summarise_reduction(proof: Proof) -> dict[str, Any]:
    """Share of the gap closed on recordings held out at one condition, beside that of each alternative."""
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
            "Share of the gap closed by each alternative, with its range",
        )
    return {
        "sentences": [*sentences, *_compare_with_best(finite)],
        **_comparison_table(rows),
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


def _compare_with_best(rows: Sequence[ProofRow]) -> list[str]:
    """Compare the correction with the best alternative, and say where one does better."""
    sentences = []
    for condition, words in (
        ("all", "Of the alternatives"),
        ("seen", "With counts seen in the fit,"),
        ("unseen", "With counts never seen in the fit,"),
    ):
        here = [row for row in rows if row.condition == condition]
        ours = [row for row in here if row.alternative == OURS]
        others = [row for row in here if row.alternative not in (OURS, "oracle", "nothing")]
        if not ours or not others:
            continue
        best = max(others, key=lambda row: row.grr)
        worse = best.grr < ours[0].grr
        if condition == "seen" and worse:
            continue
        verb = "comes nearest" if worse else "does better"
        text = f"{words} \N{LEFT DOUBLE QUOTATION MARK}{alternative_name(best.alternative)}"
        text += f"\N{RIGHT DOUBLE QUOTATION MARK} {verb}"
        text += f", with {percent_text(best.grr)} against {percent_text(ours[0].grr)}"
        if math.isfinite(best.beaten):
            text += (
                f" (the correction is nearer in {percent_text(best.beaten)} of resampled sets of recordings)"
            )
        sentences.append(f"{text}.")
    return sentences


def _comparison_table(rows: Sequence[ProofRow]) -> dict[str, Any]:
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
    named = [row.alternative for row in rows]
    return {
        "rows": table,
        "conditions": [CONDITIONS[name] for name in conditions],
        "explained": [(alternative_name(name), text) for name, text in _EXPLAINED.items() if name in named],
    }


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
