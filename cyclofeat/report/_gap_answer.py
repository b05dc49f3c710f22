"""Answer of the page of a gap: which effects are missing, and how far the correction closes the gap."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from cyclofeat._base.gap_words import (
    AFTER,
    COUNT_GROUPS,
    alternative_name,
    cell_name,
    family_name,
    mean_difference_words,
    p_words,
)
from cyclofeat.plotting import GapReductionDisplay
from cyclofeat.report import _figures
from cyclofeat.report._page import (
    keep_together,
    percent_text,
    range_text,
    rounded_text,
)

if TYPE_CHECKING:
    from cyclofeat.gap import GapResult
    from cyclofeat.gap.posterior.answers import State
    from cyclofeat.gap.proof.prove import Proof
    from cyclofeat.gap.result import Remainder


def effect_rows(result: GapResult, *states: State) -> list[dict[str, Any]]:
    """List the effects of some states, each with its look-alikes."""
    rows = []
    for row in result.of_state(*states):
        ties = [result.effect(name) for name in result.look_alikes(row)]
        rows.append({
            "id": row.effect,
            "name": row.name,
            "state": row.state,
            "probability": row.probability,
            "sizes": [
                {"name": size.label} | dict(zip(("value", "range", "unit"), size.parts, strict=True))
                for size in row.sizes
            ],
            "ties": [tie.name for tie in ties],
            "together": min(row.probability + sum(tie.probability for tie in ties), 1.0),
            "seen": "" if row.visible_from is None else str(row.visible_from),
        })  # fmt: skip
    return rows


def summarise_remainder(remainder: Remainder) -> dict[str, Any]:
    """Return the differences that a model leaves unexplained."""
    return {
        "p": keep_together(p_words(remainder.p)),
        "cause": remainder.cause,
        "rows": [
            {
                "what": cell_name(row),
                "difference": mean_difference_words(row.difference, row.unit),
                "z": rounded_text(abs(row.z)),
            }
            for row in remainder.rows
        ],
    }


def summarise_reduction(proof: Proof) -> dict[str, Any]:
    """Return the shares of the gap closed on recordings held out at one condition; None where not defined."""
    rows = proof.rows
    if not any(row.condition == "unseen" for row in rows):  # then all counts were seen
        rows = tuple(row for row in rows if row.condition == "all")
    ours = {row.condition: row for row in rows if row.alternative == AFTER}
    finite = [row for row in rows if math.isfinite(row.grr)]
    drawn = None
    if finite:
        n = len(dict.fromkeys(row.alternative for row in finite))
        alt = "Share of the gap that the correction closes, with its range"
        drawn = _figures.draw_picture(GapReductionDisplay(finite).plot, (8.0, 1.5 + 0.55 * n), alt)
    cells = {
        (row.alternative, row.condition): {
            "value": percent_text(row.grr), "range": range_text(row.low, row.high),
        }
        for row in reversed(rows)
    }  # fmt: skip
    conditions = [name for name in COUNT_GROUPS if any(row.condition == name for row in rows)]
    distances: dict[str, dict[str, float]] = {}
    for distance in proof.distances:
        if distance.condition == "all":
            distances.setdefault(distance.alternative, {})[distance.family] = distance.distance
    before, after, floor = (distances.get(name, {}) for name in ("nothing", AFTER, "floor"))
    return {
        "condition": proof.condition.text if proof.condition else "",
        "share": proof.result.grr if math.isfinite(proof.result.grr) else None,
        "range": range_text(proof.result.low, proof.result.high),
        "undefined": (
            proof.result.undefined or "the gap on the recordings held out is too small"
        ).removesuffix("."),
        "by_condition": [
            {
                "name": COUNT_GROUPS[name],
                "share": ours[name].grr if math.isfinite(ours[name].grr) else None,
                "undefined": ours[name].undefined.removesuffix("."),
            }
            for name in ("seen", "unseen")
            if name in ours
        ],
        "rows": [
            {
                "name": alternative_name(alternative),
                "cells": [cells.get((alternative, condition)) for condition in conditions],
            }
            for alternative in dict.fromkeys(row.alternative for row in rows)
        ],
        "conditions": [COUNT_GROUPS[name] for name in conditions],
        "distances": [
            {
                "name": family_name(name),
                "before": before[name],
                "after": after[name],
                "floor": floor.get(name),
            }
            for name in before
            if name in after
        ],
        "picture": drawn,
    }
