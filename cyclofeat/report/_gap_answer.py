"""Answer of the page of a gap: which effects are missing, and how far the correction closes the gap."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

from cyclofeat._base.quantities import beyond_text
from cyclofeat.plotting import GapReductionDisplay
from cyclofeat.plotting.gap_words import (
    AFTER,
    COUNT_GROUPS,
    alternative_name,
    cell_name,
    effect_name,
    family_name,
    mean_difference_words,
    p_words,
)
from cyclofeat.report import _figures
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
    from cyclofeat.gap.proof.prove import Proof
    from cyclofeat.gap.result import FoundEffect, Remainder


def effect_rows(result: GapResult) -> list[dict[str, Any]]:
    """List the effects that are missing or open, each with its look-alikes."""
    named = {effect.effect_id for effect in result.named}
    asked = {row.effect: row.probability for row in result.effects}
    rows: list[dict[str, Any]] = []
    seen: set[str] = set()
    for row in result.effects:
        may_be = row.answer == "present" or (row.answer == "unresolved" and not row.small)
        if row.effect not in named and (not may_be or row.effect in seen):
            continue
        ties = [name for name in row.ties if name not in named]
        seen |= {row.effect, *ties}
        likely = "probably missing" if row.effect in named else "open"
        rows.append({
            "id": row.effect,
            "ids": [row.effect, *ties],
            "name": effect_name(row.effect),
            "answer": "missing" if row.answer == "present" else likely,
            "named": row.effect in named,
            "probability": row.probability,
            "sizes": [
                {
                    "name": re.sub("_(nm|hz|s)$", "", size.name).replace("_", " "),
                    "value": quantity_text([size.value], size.unit),
                    "range": ""
                    if math.isnan(size.low) or math.isnan(size.high)
                    else quantity_text([size.low, size.high], size.unit),
                }
                for size in row.sizes
            ],
            "ties": [effect_name(name) for name in ties],
            "together": min(row.probability + sum(asked.get(name, 0.0) for name in ties), 1.0),
        })  # fmt: skip
    return rows


def describe_absent(row: FoundEffect) -> str:
    """Return an effect that is not missing, its probability, and the size that would have been seen."""
    text, seen = probability_text(row.probability), row.visible_from
    if seen is not None:
        text += f"; seen {beyond_text(seen.below, seen.above, lambda end: quantity_text([end], seen.unit))}"
    return f"{effect_name(row.effect)} ({text})"


def summarise_remainder(remainder: Remainder) -> dict[str, Any]:
    """Return the differences that a model leaves unexplained."""
    return {
        "p": keep_together(p_words(remainder.p)),
        "p_open": None if remainder.p_open is None else keep_together(p_words(remainder.p_open)),
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
