"""Where recordings and model differ at one condition, as the page of a gap shows it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat._base.quantities import number_of, unit_text
from cyclofeat.plotting import GapDisplay
from cyclofeat.plotting.gap_words import (
    cell_name,
    difference_words,
    family_name,
    p_words,
)
from cyclofeat.report._figures import draw_picture
from cyclofeat.report._page import keep_together, rounded_text, signed_text

if TYPE_CHECKING:
    from cyclofeat.gap.where.conditions import Where, WhereRow

_N_CLEAREST = 8
_SIMULATED_PER_RECORDING = 10  # when the number of recordings that agreement takes is estimated
_ALT = {
    "families": "Clearest difference of each group of numbers, in standard deviations of one recording",
    "spectrum": "Levels in third octaves and their differences; bands that differ are shaded",
    "orders": "Differences of the lines of lobes and input shaft, by order",
    "phase": "Torque folded over turns, recordings against model, and the difference",
}


def where_they_differ(where: Where, label: str, word: str) -> dict[str, Any]:
    """Sentences, the clearest differences, and pictures.

    ``label`` names the recordings in pictures (``"measured"``), ``word`` in sentences (``"measurement"``).
    """
    display = GapDisplay(where, label=label)
    flagged = where.flagged
    return {
        "condition": where.condition.text,
        "sentences": [text for text in _where_sentences(where, flagged) if text],
        "overview": _draw_picture(display, "families") if display.has("families") else None,
        "n_cells": where.n_cells,
        "clearest": [_plain_row(row) for row in flagged[:_N_CLEAREST]],
        "n_more_clear": max(len(flagged) - _N_CLEAREST, 0),
        "pictures": _draw_pictures(display, word),
    }


def _where_sentences(where: Where, flagged: Sequence[WhereRow]) -> list[str]:
    if flagged:
        families = list(dict.fromkeys(row.cell.family for row in flagged))
        names = "; ".join(family_name(family) for family in families)
        verb = "is" if len(flagged) == 1 else "are"
        return [f"{number_of(len(flagged), 'difference')} {verb} larger than chance explains, in: {names}."]
    if where.verdict == "disagree":
        return ["No single number differs by more than chance explains; all of them together do."]
    if where.verdict == "equivalent":
        return [
            f"All {where.n_cells} numbers compared agree within {where.margin_db:g} dB, or, if they are not "
            f"levels, within {where.margin_spreads:g} standard deviations of one recording. These "
            "recordings show nothing that the model lacks."
        ]
    energy = where.global_p.get("energy distance", 1.0)
    hint = (
        f"All numbers together hint at a difference ({keep_together(p_words(energy))}), but not at its place."
    )
    return [
        "No number differs by more than chance explains.",
        *([hint] if energy <= where.alpha else []),
        _smallest_noticed(where),
        recordings_for_agreement(where),
    ]


def _smallest_noticed(where: Where) -> str:
    levels = where.means("spectrum")
    if not levels:
        return ""
    least = float(np.median([row.detectable for row in levels]))
    return f"Differences below about {least:.2g} dB in a third octave would mostly go unnoticed."


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


def _plain_row(row: WhereRow) -> dict[str, str]:
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


def _draw_picture(display: GapDisplay, kind: Any, phase: str = "lobe") -> dict[str, Any]:
    return draw_picture(lambda ax, _: display.plot(kind, ax, phase=phase), display.SIZES[kind], _ALT[kind])


def _draw_pictures(display: GapDisplay, word: str) -> list[dict[str, Any]]:
    chosen = (
        ("spectrum", "lobe", "Spectrum in third octaves",
         f"Above: mean level of {word} and model; the bands show one standard deviation of single "
         "recordings. Below: the difference, with a range that holds for all bands at once. Shaded bands "
         "differ. A range may exclude zero without a mark, because the marks also allow for the other groups "
         "of numbers."),
        ("orders", "lobe", "Lines of lobes and input shaft",
         "Level of each line above its surroundings, compared with the model's. Zero is agreement; filled "
         "orange points differ. The ranges hold for all lines of a kind at once; the marks also allow for "
         "the other groups of numbers."),
        ("phase", "lobe", "Torque over the lobes' passage",
         "Torque averaged over the time in which all lobes pass once; each recording is shifted to where it "
         "fits best. Shaded phases differ. The shading belongs to the picture, not to the verdict."),
        ("phase", "input", "Torque over the input's turn",
         "The same for one turn of the input shaft."),
    )  # fmt: skip
    return [
        {"heading": heading, "text": text, "picture": _draw_picture(display, kind, phase)}
        for kind, phase, heading, text in chosen
        if display.has(kind, phase)  # type: ignore[arg-type]
    ]
