"""How far the gap shrank, as its report shows it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from cyclofeat.plotting import GapReductionDisplay
from cyclofeat.plotting._gap_words import (
    CONDITIONS,
    OURS,
    alternative_name,
    family_name,
)
from cyclofeat.report._gap_numbers import (
    percent,
    quoted,
    range_text,
)

if TYPE_CHECKING:
    from cyclofeat.report._gap_findings import GapFindings

_EXPLAINED = {
    "nothing": "the model as it was: 0 % by definition.",
    "retuned": "stiffness and damping of the contacts set anew, no effect added. What this closes needs "
    "no new physics.",
    "equaliser": "a filter and shaped noise behind the model, fitted to the spectrum. It knows no cause, and "
    "may do well where it was fitted.",
    "gaussian_process": "a smooth curve through the difference of the spectra, added to the model's. It "
    "knows no cause, either.",
    "placebo": "the best of the effects that are no look-alikes, fitted with the same effort: what any added "
    "effect closes.",
    "oracle": "the simulator that made these recordings: as far as the gap can be closed.",
}


def how_far_it_shrank(findings: GapFindings) -> dict[str, Any]:
    """Share of the gap closed on recordings held out, beside that of each alternative."""
    report = findings.report
    found: dict[str, Any] = {
        "sentences": [], "rows": [], "conditions": [], "picture": None, "explained": [], "distances": [],
        "tile": None,
    }  # fmt: skip
    if report is None and not findings.result.get("effects"):
        found["sentences"] = ["Nothing was added to the model, so there is nothing to show."]
        return found
    if report is None:
        found["sentences"] = [
            "Not tested: no recordings were held out. Give some that the fit does not see, best with a count "
            "of worn lobes that it never saw: cyclofeat gap MEASURED_DIR --hold-out DIR, or X_hold= in "
            "Python."
        ]
        return found
    grr, ends = float(report.grr_), tuple(float(end) for end in getattr(report, "grr_ci_", (math.nan,) * 2))
    label = "Gap closed on recordings not used"
    rows = list(report.comparison_)
    if math.isnan(grr):
        reason = str(getattr(report, "undefined_", "")) or "the gap on the recordings held out is too small"
        found["sentences"] = [f"No share of the gap can be stated: {reason.removesuffix('.')}."]
        found["tile"] = {"label": label, "value": "not defined", "text": f"{reason.removesuffix('.')}."}
    else:
        text = range_text(*ends)
        found["sentences"] = [
            f"On recordings that nothing was fitted to, the correction {_closes(grr)} the gap"
            + (f" (range {text})." if text else ".")
        ]
        found["sentences"] += _by_condition(rows)
        found["tile"] = {"label": label, "value": percent(grr), "text": f"range {text}" if text else ""}
    finite = [row for row in rows if math.isfinite(row.grr)]
    found["sentences"] += _against(finite, getattr(report, "beats_", {}))
    found |= _comparison(rows)
    found["distances"] = _distances(report)
    if finite:
        from cyclofeat.report._figures import picture

        display = GapReductionDisplay(comparison=finite)
        n = len(dict.fromkeys(row.alternative for row in finite))
        found["picture"] = picture(
            lambda ax, _: display.plot("comparison", ax),
            (8.0, 1.5 + 0.55 * n),
            "Share of the gap closed by each alternative, with its range",
        )
    return found


def _by_condition(rows: Sequence[Any]) -> list[str]:
    ours = {row.condition: row for row in rows if row.alternative == OURS}
    there = [name for name in ("seen", "unseen") if name in ours]
    parts = [
        f"{percent(ours[name].grr)} with {CONDITIONS[name]}"
        for name in there
        if math.isfinite(ours[name].grr)
    ]
    sentences = [f"That is {' and '.join(parts)}."] if parts else []
    for name in there:
        reason = getattr(ours[name], "undefined", "")
        if reason and not math.isfinite(ours[name].grr):
            sentences.append(f"With {CONDITIONS[name]} no share can be stated: {reason.removesuffix('.')}.")
    return sentences


def _against(rows: Sequence[Any], beats: Mapping[str, Mapping[str, float]]) -> list[str]:
    """How the correction compares with the best alternative, and where one does better."""
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
        best = max(others, key=lambda row: float(row.grr))
        worse = best.grr < ours[0].grr
        if condition == "seen" and worse:
            continue
        verb = "comes nearest" if worse else "does better"
        text = f"{words} {quoted(alternative_name(best.alternative))} {verb}"
        text += f", with {percent(best.grr)} against {percent(ours[0].grr)}"
        share = beats.get(best.alternative, {}).get(condition, math.nan)
        if math.isfinite(share):
            text += f" (with recordings drawn anew, the named effect is nearer in {percent(share)} of draws)"
        sentences.append(f"{text}.")
    return sentences


def _comparison(rows: Sequence[Any]) -> dict[str, Any]:
    conditions = [name for name in CONDITIONS if any(row.condition == name for row in rows)]
    table = []
    for alternative in dict.fromkeys(row.alternative for row in rows):
        cells = []
        for condition in conditions:
            of = [row for row in rows if (row.alternative, row.condition) == (alternative, condition)]
            cells.append(
                {"value": percent(of[0].grr), "range": range_text(of[0].low, of[0].high)} if of else None
            )
        table.append({"name": alternative_name(alternative), "cells": cells})
    named = [row.alternative for row in rows]
    return {
        "rows": table,
        "conditions": [CONDITIONS[name] for name in conditions],
        "explained": [(alternative_name(name), text) for name, text in _EXPLAINED.items() if name in named],
    }


def _distances(report: Any) -> list[dict[str, Any]]:
    """Distances by kind of number: before, after, and what replication alone leaves (None if not known)."""
    of: dict[str, dict[str, float]] = {}
    for row in getattr(report, "distances_", ()):
        if row.condition == "all":
            of.setdefault(row.alternative, {})[row.family] = float(row.distance)
    before, after, floor = (of.get(name, {}) for name in ("nothing", OURS, "floor"))
    return [
        {
            "name": family_name(family),
            "before": before[family],
            "after": after[family],
            "floor": floor.get(family),
        }
        for family in before
        if family in after
    ]


def _closes(grr: float) -> str:
    if grr < 0:
        return f"widened, by {-100 * grr:.0f} %,"
    return f"closed {percent(grr)} of"
