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
    from cyclofeat.gap.proof.prove import Proof, ProofRow


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
