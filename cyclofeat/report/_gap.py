"""Page of a gap: the answer first, then where model and recordings differ, and the method."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat._base.gap_words import (
    AFTER,
    COUNT_GROUPS,
    alternative_name,
    cell_name,
    difference_words,
    family_name,
    mean_difference_words,
    p_words,
)
from cyclofeat._base.quantities import in_words, number_of, some_of, unit_text
from cyclofeat.plotting import GapDisplay, GapOverlayDisplay, GapReductionDisplay
from cyclofeat.report import _figures
from cyclofeat.report._figures import Axis, Line, Plot
from cyclofeat.report._page import (
    check_page_path,
    describe_origin,
    keep_together,
    percent_text,
    range_text,
    rounded_text,
    signed_text,
    write_page,
)

if TYPE_CHECKING:
    import os

    from cyclofeat.gap import GapResult
    from cyclofeat.gap.posterior.answers import State
    from cyclofeat.gap.proof.prove import Proof, ProofRow
    from cyclofeat.gap.result import Remainder
    from cyclofeat.gap.where.locate import Where, WhereRow

_FEW = 5  # recordings, below which exact tests hardly reject
_BESIDE_ANOTHER = (5.2, 3.4)  # inches of a picture that has another one beside it
_OVERLAYS = {
    "spectrum": (
        "Spectrum", Axis("frequency", "Hz", log=True), Axis("rms in a twelfth octave", "Nm", log=True)
    ),
    "orders": (
        "Lines of the output turn", Axis("order of the input shaft", ""), Axis("amplitude", "Nm", log=True)
    ),
    "distribution": ("Distribution of the torque", Axis("torque", "Nm"), Axis("density", "1/Nm", log=True)),
}  # fmt: skip
_N_CLEAREST = 8
_SIMULATED_PER_RECORDING = 10  # when the number of recordings that agreement takes is estimated
_FOLDED = "Torque folded over turns, recordings against model, and the difference"
# What the kinds of pictures of a comparison show.
_PICTURES = {
    "families": "Clearest difference of each group of numbers, in standard deviations of one recording",
    "spectrum": "Levels in third octaves and their differences; bands that differ are shaded",
    "orders": "Differences of the lines of lobes and input shaft, by order",
    "lobe phase": _FOLDED,
    "input phase": _FOLDED,
}


def write_gap_report(
    result: GapResult,
    path: str | os.PathLike[str],
    *,
    sources: Sequence[str | None] = (),
    settings: Mapping[str, Any] | None = None,
    title: str = "",
    counters: Sequence[Mapping[str, Any]] = (),
) -> Path:
    """Write the page of a gap, an HTML file that needs nothing else, and return its path.

    The answer comes first: what is missing in the model, how sure that is and how large, what to measure
    next, and what stays unexplained. An existing file of that name is replaced; no partial file is ever
    visible.

    Parameters
    ----------
    result : cyclofeat.gap.GapResult
    path : path-like
        File to write, ``*.html``.
    sources : sequence of str or None, optional
        ``Recording.source`` of each recording. If one is ``"simulated"`` or ``"surrogate"``, the page says
        so and calls nothing of it measured.
    settings : mapping, optional
        Settings that the page lists, label to value; ``"corrected model"`` names the file that holds it.
    title : str, optional
        Heading.
    counters : sequence of mapping, optional
        Counters that were tried on the recordings: ``counter`` (its name), ``n`` recordings, ``right`` ones
        (None without labels), and ``refused``.

    Returns
    -------
    pathlib.Path

    Examples
    --------
    >>> write_gap_report(result, "gap.html")  # doctest: +SKIP
    """
    check_page_path(path)
    label, surrogate, origin = describe_origin(sources)
    given = list(result.warnings)
    n = sum(where.n_recordings for where in result.where)
    if n < _FEW and not any("recordings" in text for text in given):
        given.append(
            f"Only {number_of(n, 'recording')}: with fewer than {_FEW}, only large differences can be shown."
        )
    names = {row.effect: row.name for row in result.effects}
    first = result.where[0]
    settings = dict(settings or {})
    circumstances = {
        "recordings": n,
        "conditions": "; ".join(where.condition.text for where in result.where),
        "simulated recordings": sum(where.n_simulated for where in result.where),
        "quantity": in_words(result.quantity),
        "sampling rate": f"{first.sampling_rate:g} Hz",
        "random state": first.random_state,
        "computing time": f"{result.seconds:.0f} s" if math.isfinite(result.seconds) else None,
    }
    summary = {
        "title": title or "Model against recordings",
        "surrogate": surrogate,
        "origin": origin,
        **{
            name: getattr(result, name)
            for name in ("verdict", "headline", "size_note", "undecided_text", "caution")
        },
        "p": keep_together(p_words(result.p)),
        "one_in": rounded_text(1 / max(result.p, 1e-9)),
        "n_recordings": n,
        "n_effects": len(result.effects),
        "effects": _effect_rows(result, "missing", "probably missing"),
        "undecided": _effect_rows(result, "undecided"),
        "small": _effect_rows(result, "too small to matter"),
        "absent": _effect_rows(result, "not missing"),
        "warnings": [text for text in dict.fromkeys(given) if text != result.size_note],
        "next": [
            {
                "what": item.what[:1].upper() + item.what[1:],
                "n": len(item.decides),
                "decides": some_of(names.get(name, name) for name in item.decides),
            }
            for item in result.next_measurements
        ],
        "rig_file": settings.get("corrected model"),
        "counters": list(counters),
        "remainder": None if result.remainder is None else _summarise_remainder(result.remainder),
        "overlays": _draw_overlays(result, label),
        "where": [_summarise_where(where, label) for where in result.where],
        "corrected": bool(result.named),
        "proof": [_summarise_reduction(proof) for proof in result.proof],
        "provenance": settings | circumstances | settings,
    }
    return write_page(path, "gap.html", summary)


def _draw_overlays(result: GapResult, label: str) -> list[dict[str, Any]]:
    """Return the kinds of overlays, each with one picture per condition."""
    kinds = []
    for kind, (heading, across, up) in _OVERLAYS.items():
        of_kind = [overlay for overlay in result.overlays if overlay.kind == kind]
        pictures = []
        for overlay in of_kind:
            display = GapOverlayDisplay(overlay, label=label, beside=of_kind)
            curves = (
                ("model", "ink", "dashed", overlay.model),
                (label, "accent", "wide", overlay.measured),
                ("corrected model", "third", "line", overlay.corrected),
            )
            lines = [
                Line(name, band.mean, colour, style, (band.low, band.high))  # type: ignore[arg-type]
                for name, colour, style, band in curves
                if band is not None
            ]
            picture = _figures.draw_picture(
                display.plot,
                display.size if len(of_kind) == 1 else _BESIDE_ANOTHER,
                f"{heading} of recordings, model and corrected model: {overlay.condition.text}",
                plot=Plot(overlay.x, lines, (across, replace(up, ends=display.ends))),
            )
            pictures.append({"condition": overlay.condition.text, "picture": picture})
        if pictures:
            kinds.append({"kind": kind, "heading": heading, "pictures": pictures})
    return kinds


def _summarise_where(where: Where, label: str) -> dict[str, Any]:
    """Return where recordings, which pictures name by the label, and model differ at one condition."""
    display = GapDisplay(where, label=label)
    flagged = where.flagged_rows
    levels = where.means("spectrum")
    pictures = {
        kind: _figures.draw_picture(partial(display.plot, kind), display.SIZES[kind], _PICTURES[kind])
        for kind in display.kinds
    }
    numbers = (
        "verdict", "n_cells", "n_simulated", "n_permutations", "margin_db", "margin_spreads", "one_assembly",
        "alpha",
    )  # fmt: skip
    return {name: getattr(where, name) for name in numbers} | {
        "condition": where.condition.text,
        "families": [family_name(name) for name in dict.fromkeys(row.cell.family for row in flagged)],
        "n_flagged": len(flagged),
        "noticed": f"{np.median([row.detectable for row in levels]):.2g}" if levels else "",
        "for_agreement": recordings_for_agreement(where),
        "clearest": [_describe_row(row) for row in flagged[:_N_CLEAREST]],
        "pictures": pictures,
    }


def recordings_for_agreement(where: Where) -> str:
    """Estimate how many recordings would show agreement: intervals shrink as in a t-test."""
    shrink, last = 1.0, ""
    for row in where.means():
        margin = where.margin_db if row.cell.unit == "dB" else where.margin_spreads * row.spread
        half = (row.high - row.low) / 2
        if half > 0 and margin / half < shrink:
            shrink, last = margin / half, cell_name(row.cell)
    share = (1 / where.n_recordings + 1 / where.n_simulated) * shrink**2
    more = max(math.ceil((1 + 1 / _SIMULATED_PER_RECORDING) / share), where.n_recordings + 1)
    hardest = f" ({last} needs the most)" if last else ""
    return (
        f"To show agreement within {where.margin_db:g} dB would take about {rounded_text(more)} recordings, "
        f"compared with {rounded_text(_SIMULATED_PER_RECORDING * more)} simulated ones{hardest}. More "
        "recordings also make smaller differences visible."
    )


def _describe_row(row: WhereRow) -> dict[str, str]:
    if row.of == "spread":
        ends = [f"{10 ** (end / 20):.2g}" for end in (row.low, row.high)]
        interval = f"{ends[0]} to {ends[1]} times"
    else:
        interval = f"{signed_text(row.low)} to {signed_text(row.high)}{unit_text(row.cell.unit)}"
    return {
        "what": cell_name(row.cell),
        "difference": difference_words(row),
        "range": interval,
        "p": p_words(row.p).removeprefix("p = ").removeprefix("p "),
    }


def _effect_rows(result: GapResult, *states: State) -> list[dict[str, Any]]:
    """List the effects of some states, each with its look-alikes."""
    rows = []
    for row in result.of_state(*states):
        ties = [result.effect(name) for name in row.ties]
        rows.append({
            "id": row.effect,
            "name": row.name,
            "state": row.state,
            "probability": row.probability,
            "sizes": [[size.label, *size.parts] for size in row.sizes],
            "ties": [tie.name for tie in ties],
            "together": min(row.probability + sum(tie.probability for tie in ties), 1.0),
            "seen": "" if row.visible_from is None else str(row.visible_from),
        })  # fmt: skip
    return rows


def _summarise_remainder(remainder: Remainder) -> dict[str, Any]:
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


def _describe_share(row: ProofRow) -> dict[str, Any]:
    return {
        "value": percent_text(row.grr),
        "share": row.grr if math.isfinite(row.grr) else None,
        "range": range_text(row.low, row.high),
        "undefined": row.undefined.removesuffix("."),
    }


def _summarise_reduction(proof: Proof) -> dict[str, Any]:
    """Return the shares of the gap closed on recordings held out at one condition; None where not defined."""
    rows = proof.rows
    if not any(row.condition == "unseen" for row in rows):  # then all counts were seen
        rows = tuple(row for row in rows if row.condition == "all")
    finite = [row for row in rows if math.isfinite(row.grr)]
    drawn = None
    if finite:
        alt = "Share of the gap that the correction closes, with its range"
        display = GapReductionDisplay(finite)
        drawn = _figures.draw_picture(display.plot, display.size, alt)
    shares = {(row.alternative, row.condition): _describe_share(row) for row in reversed(rows)}
    conditions = [name for name in COUNT_GROUPS if any(row.condition == name for row in rows)]
    distances: dict[str, dict[str, float]] = {}
    for distance in proof.distances:
        if distance.condition == "all":
            distances.setdefault(distance.alternative, {})[distance.family] = distance.distance
    before, after, floor = (distances.get(name, {}) for name in ("nothing", AFTER, "floor"))
    return _describe_share(proof.result) | {
        "condition": proof.condition.text if proof.condition else "",
        "by_condition": [
            {"name": COUNT_GROUPS[name]} | shares[AFTER, name]
            for name in ("seen", "unseen")
            if (AFTER, name) in shares
        ],
        "rows": [
            {
                "name": alternative_name(alternative),
                "cells": [shares.get((alternative, condition)) for condition in conditions],
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
