"""Page of a gap: the answer, where model and recordings disagree, and what remains.

``_gap_missing`` writes what is missing, ``_gap_reduction`` how far adding it helps, both into
``templates/gap.html``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat import __version__
from cyclofeat._base.words import number
from cyclofeat.plotting import GapDisplay, GapReductionDisplay
from cyclofeat.plotting.drawing import require_matplotlib
from cyclofeat.plotting.gap_words import cell_name, difference_words, family_name, in_words, p_words
from cyclofeat.report import _gap_page
from cyclofeat.report._figures import picture
from cyclofeat.report._gap_missing import what_is_missing
from cyclofeat.report._gap_numbers import rounded, signed
from cyclofeat.report._gap_reduction import how_far_it_shrank
from cyclofeat.report._page import check_page_path, origin, unbroken, versions, write_page

if TYPE_CHECKING:
    import os

    from cyclofeat.gap import GapResult, JointGap, Where, WhereRow

_N_CLEAREST, _N_REMAINING = 8, 6
_SIMULATED_PER_RECORDING = 10  # when the number of recordings that agreement takes is estimated
_FEW = 5  # recordings, below which exact tests hardly reject


def write_gap_report(
    result: GapResult | JointGap,
    path: str | os.PathLike[str],
    *,
    sources: Sequence[str | None] = (),
    settings: Mapping[str, Any] | None = None,
    title: str = "",
) -> Path:
    """Write the page of a gap: one HTML file that needs nothing else.

    The answer comes first: whether model and recordings disagree, what is missing, its size, and how far
    adding it closes the gap on recordings held out. An existing file of that name is replaced; no partial
    file is ever visible.

    Parameters
    ----------
    result : cyclofeat.gap.GapResult
    path : path-like
        File to write, ``*.html``.
    sources : sequence of str or None, optional
        ``Recording.source`` of each recording. If one is ``"simulated"`` or ``"surrogate"``, the page says
        so and calls nothing of it measured.
    settings : mapping, optional
        Settings that the page lists, label to value.
    title : str, optional
        Heading.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    ImportError
        If jinja2 or matplotlib is not installed.
    FileNotFoundError
        If the folder does not exist.
    ValueError
        If ``path`` does not end in ``.html``.

    Examples
    --------
    >>> write_gap_report(result, "gap.html")  # doctest: +SKIP
    """
    if isinstance(result.where, tuple):
        return _gap_page.write_gap_report(result, path, sources=sources, settings=settings, title=title)
    target = check_page_path(path)
    summary = summarise_gap(result, sources=sources, settings=settings, title=title)
    return write_page(target, "gap.html", summary)


def summarise_gap(
    result: GapResult,
    *,
    sources: Sequence[str | None] = (),
    settings: Mapping[str, Any] | None = None,
    title: str = "",
) -> dict[str, Any]:
    """Values that the page of a gap shows, plain as JSON can hold them.

    Parameters
    ----------
    result : cyclofeat.gap.GapResult
    sources, settings, title
        As in :func:`write_gap_report`.

    Returns
    -------
    dict
        ``title``, ``version``, ``surrogate``, ``origin``, ``verdict``, ``tiles``, ``warnings``, ``overview``,
        ``clearest``, ``missing``, ``reduction``, ``remaining``, ``pictures``, ``method``, ``provenance`` and
        what the template needs besides. Pictures are data URIs; absent parts are None.

    Raises
    ------
    ImportError
        If matplotlib is not installed.
    """
    require_matplotlib()
    where = result.where
    label, surrogate, text_of_origin = origin(sources)
    display = GapDisplay(where, label=label)
    disagree = result.verdict == "disagree"
    missing = what_is_missing(result) if disagree else None
    reduction = how_far_it_shrank(result) if disagree else None
    flagged = where.flagged
    word = "measurement" if label == "measured" else "recordings"
    return {
        "title": title or f"Model against {word}",
        "version": __version__,
        "surrogate": surrogate,
        "origin": text_of_origin,
        "recordings_word": word,
        "verdict": _verdict(result, word),
        "tiles": _tiles(missing, reduction),
        "warnings": _warnings(result),
        "where": _where(where, flagged),
        "n_cells": where.n_cells,
        "overview": _picture(display, "families") if display.has("families") else None,
        "clearest": [_plain_row(row) for row in flagged[:_N_CLEAREST]],
        "n_more_clear": max(len(flagged) - _N_CLEAREST, 0),
        "missing": missing,
        "reduction": reduction,
        "remaining": _remaining(result, label) if disagree else None,
        "pictures": _pictures(display, word),
        "pictures_heading": "Pictures before the correction" if result.effects else "Pictures",
        "method": _method(result, disagree),
        "provenance": _provenance(result, dict(settings or {})),
    }


def _verdict(result: GapResult, word: str) -> dict[str, Any]:
    where = result.where
    n = where.n_recordings
    if result.verdict == "disagree":
        sentences = [
            f"If the model were right, a difference this clear would arise by chance in at most 1 of "
            f"{rounded(1 / max(where.p, 1e-9))} such comparisons ({unbroken(p_words(where.p))}, "
            f"{number(n, 'recording')} against {where.n_simulated} simulated ones)."
        ]
        if where.flagged:
            sentences.append(f"The clearest: {_against_simulated(where.flagged[0])}.")
        if result.unknown:
            sentences.append("None of the effects considered explains all of it.")
        return {"heading": f"Model and {word} disagree", "sentences": sentences}
    if result.verdict == "equivalent":
        return {
            "heading": f"Model and {word} agree",
            "sentences": [
                f"All {where.n_cells} numbers compared agree within {where.margin_db:g} dB, or, if they are "
                f"not levels, within {where.margin_spreads:g} standard deviations of one recording. These "
                "recordings show nothing that the model lacks."
            ],
        }
    energy = where.global_p.get("energy distance", 1.0)
    hint = f"All numbers together hint at a difference ({unbroken(p_words(energy))}), but not at its place."
    return {
        "heading": "No clear answer yet",
        "sentences": [
            *([hint] if energy <= where.alpha else []),
            f"No difference is clear, but {number(n, 'recording')} "
            f"{'is' if n == 1 else 'are'} too few to show agreement. {_unnoticed(where)}",
            _recordings_for_agreement(where),
        ],
    }


def _unnoticed(where: Where) -> str:
    levels = where.means("spectrum")
    if not levels:
        return ""
    least = float(np.median([row.detectable for row in levels]))
    return f"Differences below about {least:.2g} dB in a third octave would mostly go unnoticed."


def _recordings_for_agreement(where: Where) -> str:
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
        f"To show agreement within {where.margin_db:g} dB would take about {rounded(more)} recordings, "
        f"compared with {rounded(_SIMULATED_PER_RECORDING * more)} simulated ones{hardest}. More recordings "
        "also make smaller differences visible."
    )


def _tiles(missing: dict[str, Any] | None, reduction: dict[str, Any] | None) -> list[dict[str, str]]:
    tiles = []
    if missing is not None:
        for effect in missing["effects"]:
            tiles.append({"label": "Missing in the model", "value": effect["name"], "text": effect["short"]})
        if not missing["effects"]:
            tiles.append({"label": "Missing in the model", "value": "not known", "text": missing["heading"]})
        for effect in missing["effects"][:1]:
            for size in effect["sizes"][:1]:
                text = size["remark"] or (f"range {size['range']}" if size["range"] else "")
                tiles.append({"label": f"Its size: {size['name']}", "value": size["value"], "text": text})
    if reduction is not None and reduction["tile"]:
        tiles.append(reduction["tile"])
    return tiles


def _where(where: Where, flagged: Sequence[WhereRow]) -> str:
    if not flagged and where.verdict == "disagree":
        return "No single number differs by more than chance explains; all of them together do."
    if not flagged:
        return "No group of numbers differs by more than chance explains."
    families = list(dict.fromkeys(row.cell.family for row in flagged))
    names = "; ".join(family_name(family) for family in families)
    verb = "is" if len(flagged) == 1 else "are"
    return f"{number(len(flagged), 'difference')} {verb} larger than chance explains, in: {names}."


def _against_simulated(row: WhereRow) -> str:
    """Difference in words: ``third octave at 400 Hz: 6.0 dB less than simulated``."""
    return f"{in_words(row)} {'than' if row.of == 'mean' else 'as'} simulated"


def _plain_row(row: WhereRow) -> dict[str, str]:
    if row.of == "spread":
        ends = [f"{10 ** (end / 20):.2g}" for end in (row.low, row.high)]
        interval = f"{ends[0]} to {ends[1]} times"
    else:
        unit = "" if row.cell.unit == "1" else f" {row.cell.unit}"
        interval = f"{signed(row.low)} to {signed(row.high)}{unit}"
    return {
        "what": cell_name(row.cell),
        "difference": difference_words(row),
        "range": interval,
        "p": p_words(row.p).removeprefix("p = ").removeprefix("p "),
    }


def _remaining(result: GapResult, label: str) -> dict[str, Any] | None:
    before, after = result.where, result.where_after
    if after is None:
        return None
    flagged, drawn = after.flagged, None
    if flagged:
        # A number may differ both in its mean and in how much it varies.
        n_differ = len({row.cell for row in flagged})
        rest = "clearest first" if len(flagged) <= _N_REMAINING else f"the {_N_REMAINING} clearest"
        verb = "differs, in its" if n_differ == 1 else "differ, in their"
        sentences = [
            f"With the correction, {n_differ} of {after.n_cells} numbers still {verb} mean or in how much "
            f"recordings vary from one to the next; {rest}:"
        ]
    else:
        sentences = [
            f"With the correction, none of {after.n_cells} numbers differs by more than chance explains, "
            f"neither in its mean nor in how much recordings vary from one to the next. {_unnoticed(after)}"
        ]
    if before.means("spectrum") and after.means("spectrum"):
        display = GapReductionDisplay(before=before, after=after, label=label)
        alt = "Differences in third octaves before and after"
        drawn = picture(lambda ax, _: display.plot("spectrum", ax), (8.0, 3.3), alt)
    rows = [_against_simulated(row) for row in flagged[:_N_REMAINING]]
    return {"sentences": sentences, "rows": rows, "picture": drawn}


def _picture(display: GapDisplay, kind: Any, phase: str = "lobe") -> dict[str, Any]:
    texts = {
        "families": "Clearest difference of each group of numbers, in standard deviations of one recording",
        "spectrum": "Levels in third octaves and their differences; bands that differ are shaded",
        "orders": "Differences of the lines of lobes and input shaft, by order",
        "phase": "Torque folded over turns, recordings against model, and the difference",
    }
    return picture(lambda ax, _: display.plot(kind, ax, phase=phase), display.SIZES[kind], texts[kind])


def _pictures(display: GapDisplay, word: str) -> list[dict[str, Any]]:
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
        {"heading": heading, "text": text, "picture": _picture(display, kind, phase)}
        for kind, phase, heading, text in chosen
        if display.has(kind, phase)  # type: ignore[arg-type]
    ]


def _warnings(result: GapResult) -> list[str]:
    given = list(result.warnings)
    n = result.where.n_recordings
    if n < _FEW and not any("recordings" in text for text in given):
        given.append(
            f"Only {number(n, 'recording')}: with fewer than {_FEW}, only large differences can be shown."
        )
    return list(dict.fromkeys(given))


def _method(result: GapResult, disagree: bool) -> list[tuple[str, str]]:
    where = result.where
    assemblies = (
        "All recordings are stated to be of one assembly; they count as fewer, because they share its errors."
        if where.one_assembly
        else "Each recording counts as one of a different assembly."
    )
    method = [
        (
            "Comparison",
            f"Each recording is summarised by {where.n_cells} numbers, and so are {where.n_simulated} "
            "recordings of the model, in which start angle, position of the wear, speed, load and pins vary "
            "as they may without a missing effect. The means are compared, and also whether recordings vary "
            "more from one to the next than simulated ones. Differences that follow a recording's own speed "
            f"and mean torque count as explained, as far as both vary in the model. {assemblies}",
        ),
        (
            "p",
            f"The labels of recordings are shuffled {where.n_permutations} times; p is the share of shuffles "
            "with a difference at least as clear, corrected for the number of comparisons within a group "
            "(Westfall and Young) and for the number of groups (Holm). A p of at most "
            f"{where.alpha:g} counts as a difference. A recording is one unit, however long it is.",
        ),
        (
            "Agreement",
            f"Agreement is shown only if every range lies within {where.margin_db:g} dB, or within "
            f"{where.margin_spreads:g} standard deviations of one recording. If neither difference nor "
            "agreement is shown, the answer is open.",
        ),
    ]
    others = ", ".join(f"{name} {p_words(p)}" for name, p in where.global_p.items())
    if others:
        method.append(("All numbers together", f"Tests in addition to the verdict: {others}."))
    if disagree:
        method += [
            (
                "Naming",
                "The effects of the library are simulated many times with sizes drawn from realistic ranges; "
                "a forest of decision trees learns what each of them changes. The probabilities hold among "
                "the effects of the library. If the recordings resemble none of them, the page says so.",
            ),
            (
                "Size",
                "Parameters are fitted so that simulated numbers match the recorded ones; the range comes "
                "from simulations around the best fit.",
            ),
        ]
    if result.proof is not None:
        method.append((
            "Gap closed",
            "1 - (after - floor) / (before - floor), with distances between the recordings held out and the "
            "simulator, in standard deviations of one recording. The floor is the distance between two "
            "halves of the recordings. The range comes from resampling the recordings.",
        ))  # fmt: skip
    return method


def _provenance(result: GapResult, settings: dict[str, Any]) -> list[tuple[str, str]]:
    where = result.where
    known = {
        "recordings": where.n_recordings,
        "simulated recordings": where.n_simulated,
        "sampling rate": f"{where.sampling_rate:g} Hz",
        "nominal input speed": f"{where.condition.speed_rpm:g} RPM",
        "random state": where.random_state,
    }
    if math.isfinite(result.seconds):
        known["computing time"] = f"{result.seconds:.0f} s"
    shown = settings | {name: text for name, text in known.items() if name not in settings}
    return [(str(name), str(text)) for name, text in (shown | {"versions": versions()}).items()]
