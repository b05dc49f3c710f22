"""The report of a gap: what disagrees, what is missing, how far adding it helps, and what is left."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat import __version__
from cyclofeat.plotting import GapDisplay, GapReductionDisplay
from cyclofeat.plotting._base import require_matplotlib
from cyclofeat.plotting._gap_words import (
    cell_name,
    clarity,
    difference_words,
    family_name,
    in_words,
    p_words,
)
from cyclofeat.report._gap_findings import GapFindings
from cyclofeat.report._gap_missing import what_is_missing
from cyclofeat.report._gap_numbers import (
    listed,
    rounded,
    signed,
)
from cyclofeat.report._gap_reduction import how_far_it_shrank
from cyclofeat.report._page import number, origin, target_of, unbroken, versions, write_page

if TYPE_CHECKING:
    import os

    from cyclofeat.gap import GapLocator, Row

_N_CLEAREST, _N_REMAINING = 8, 6
_BANK_PER_RECORDING = 10  # simulated recordings for each one, when the number that is needed is estimated
_FEW = 5  # recordings, below which exact tests hardly reject


def write_gap_report(path: str | os.PathLike[str], findings: GapFindings) -> Path:
    """Write the report of a gap: one HTML file that needs nothing else.

    The answer comes first: whether model and recordings disagree, what is missing, its size, and how far
    adding it closes the gap on recordings not used before. The file appears whole or not at all; one of that
    name is replaced.

    Parameters
    ----------
    path : path-like
        File to write, usually ``*.html``.
    findings : GapFindings

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
        If there is no such verdict.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from cyclofeat.gap import GapLocator
    >>> time = np.arange(11_520) / 6400
    >>> X = 22 + 0.3 * np.sin(2 * np.pi * 50 * time) + np.random.default_rng(0).normal(0, 0.05, (3, 11_520))
    >>> locator = GapLocator(6400, n_bank=12, n_permutations=499).fit(X, y=[0, 0, 0])
    >>> findings = GapFindings({"verdict": locator.verdict_}, locator, sources=["surrogate"] * 3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = write_gap_report(pathlib.Path(folder, "report.html"), findings)
    ...     "SURROGATE" in file.read_text(encoding="utf-8")
    True
    """
    return write_page(target_of(path), "gap.html", summarise_gap(findings))


def summarise_gap(findings: GapFindings) -> dict[str, Any]:
    """All that the report of a gap shows, as plain values that JSON can hold.

    Parameters
    ----------
    findings : GapFindings

    Returns
    -------
    dict
        ``title``, ``version``, ``surrogate``, ``origin``, ``verdict``, ``tiles``, ``warnings``, ``overview``,
        ``clearest``, ``missing``, ``reduction``, ``remaining``, ``pictures``, ``method``, ``provenance`` and
        what the template needs besides. Pictures are data URIs; parts that there are not are None.

    Raises
    ------
    ImportError, ValueError
        As :func:`write_gap_report`.
    """
    require_matplotlib("report")
    verdict = str(findings.result.get("verdict", findings.locator.verdict_))
    if verdict not in ("disagree", "equivalent", "unresolved"):
        raise ValueError(
            f"result['verdict'] must be 'disagree', 'equivalent' or 'unresolved', got {verdict!r}"
        )
    label, surrogate, said_of_origin = origin(findings.sources)
    display = GapDisplay.of_locator(findings.locator, label=label)
    disagree = verdict == "disagree"
    missing = what_is_missing(findings) if disagree else None
    reduction = how_far_it_shrank(findings) if disagree else None
    flagged = _flagged(findings.locator)
    word = "measurement" if label == "measured" else "recordings"
    return {
        "title": findings.title or f"Model against {word}",
        "version": __version__,
        "surrogate": surrogate,
        "origin": said_of_origin,
        "recordings_word": word,
        "verdict": _verdict(findings, verdict, word),
        "tiles": _tiles(missing, reduction),
        "warnings": _warnings(findings),
        "where": _where(findings.locator, flagged),
        "n_cells": len(findings.locator.cells_),
        "overview": _picture(display, "families") if display.has("families") else None,
        "clearest": [_plain_row(row) for row in flagged[:_N_CLEAREST]],
        "n_more_clear": max(len(flagged) - _N_CLEAREST, 0),
        "missing": missing,
        "confidence_percent": f"{100 * findings.confidence:.3g}",
        "reduction": reduction,
        "remaining": _remaining(findings, label) if disagree else None,
        "pictures": _pictures(display, word),
        "pictures_heading": "Pictures before the correction"
        if findings.effects or findings.locator_after
        else "Pictures",
        "method": _method(findings, disagree),
        "provenance": _provenance(findings),
    }


# -- the answer


def _verdict(findings: GapFindings, verdict: str, word: str) -> dict[str, Any]:
    locator = findings.locator
    n = len(locator.measured_)
    p = float(findings.result.get("p", min(locator.family_p_.values())))
    if verdict == "disagree":
        sentences = [
            f"Were the model right, chance would give a difference this clear in at most 1 of "
            f"{rounded(1 / max(p, 1e-9))} such comparisons ({unbroken(p_words(p))}, "
            f"{number(n, 'recording')} against {len(locator.simulated_)} simulated ones)."
        ]
        flagged = _flagged(locator)
        if flagged:
            sentences.append(f"Clearest: {_against_simulated(flagged[0])}.")
        if findings.result.get("unknown", False):
            sentences.append("None of the effects considered explains all of it.")
        return {"heading": f"Model and {word} disagree", "sentences": sentences}
    if verdict == "equivalent":
        return {
            "heading": f"Model and {word} agree",
            "sentences": [
                f"All {len(locator.cells_)} numbers compared agree within {_margin_db():g} dB, or within "
                f"{_margin_spreads():g} standard deviations of one recording where they are no levels. "
                "Nothing is missing that these recordings could show."
            ],
        }
    energy = locator.p_global_.get("energy distance", 1.0)
    hint = f"All numbers together hint at a difference ({unbroken(p_words(energy))}), but not at its place."
    return {
        "heading": "Cannot be told yet",
        "sentences": [
            *([hint] if energy <= locator.alpha else []),
            f"No difference is clear, but {number(n, 'recording')} "
            f"{'is' if n == 1 else 'are'} too few to show agreement. {_unnoticed(locator)}",
            _needed(locator),
        ],
    }


def _margin_db() -> float:
    from cyclofeat.gap._locator import _EQUIVALENT_DB

    return _EQUIVALENT_DB


def _margin_spreads() -> float:
    from cyclofeat.gap._locator import _EQUIVALENT_SPREADS

    return _EQUIVALENT_SPREADS


def _single(locator: GapLocator) -> list[Row]:
    """Rows of single numbers, without the test of all of them together."""
    return [row for row in locator.table_ if row.cell in locator.cells_]


def _means(locator: GapLocator, family: str | None = None) -> list[Row]:
    rows = (row for row in _single(locator) if row.of == "mean")
    return [row for row in rows if family in (None, row.cell.family)]


def _unnoticed(locator: GapLocator) -> str:
    levels = _means(locator, "spectrum")
    if not levels:
        return ""
    least = float(np.median([row.detectable for row in levels]))
    return f"Differences below about {least:.2g} dB in a third octave would mostly go unnoticed."


def _needed(locator: GapLocator) -> str:
    """How many recordings would show agreement, if there is any: intervals shrink as in a t-test."""
    n, m = len(locator.measured_), len(locator.simulated_)
    shrink, last = 1.0, ""
    for row in _means(locator):
        margin = _margin_db() if row.cell.unit == "dB" else _margin_spreads() * row.spread
        half = (row.high - row.low) / 2
        if half > 0 and margin / half < shrink:
            shrink, last = margin / half, cell_name(row.cell)
    share = (1 / n + 1 / m) * shrink**2
    more = max(math.ceil((1 + 1 / _BANK_PER_RECORDING) / share), n + 1)
    settled = f" (the number that takes most: {last})" if last else ""
    return (
        f"To show agreement within {_margin_db():g} dB it would take roughly {rounded(more)} recordings, "
        f"compared with {rounded(_BANK_PER_RECORDING * more)} simulated ones{settled}. Any more recordings "
        "make smaller differences visible, if there are some."
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
                text = size["remark"] or f"range {size['range']}" if size["range"] else size["remark"]
                tiles.append({"label": f"Its size: {size['name']}", "value": size["value"], "text": text})
    if reduction is not None and reduction["tile"]:
        tiles.append(reduction["tile"])
    return tiles


def _where(locator: GapLocator, flagged: Sequence[Row]) -> str:
    if not flagged and locator.verdict_ == "disagree":
        return "No single number differs more than chance explains; all of them together do."
    if not flagged:
        return "No group of numbers differs more than chance explains."
    families = list(dict.fromkeys(row.cell.family for row in flagged))
    names = listed(family_name(family) for family in families)
    return f"{number(len(flagged), 'difference')} that chance does not explain, in: {names}."


def _flagged(locator: GapLocator) -> list[Row]:
    """Rows that differ, the clearest first."""
    return sorted((row for row in _single(locator) if row.p <= locator.alpha), key=lambda row: -clarity(row))


def _against_simulated(row: Row) -> str:
    """The difference as a whole: ``third octave at 400 Hz: 6.0 dB less than simulated``."""
    return f"{in_words(row)} {'than' if row.of == 'mean' else 'as'} simulated"


def _plain_row(row: Row) -> dict[str, str]:
    if row.of == "spread":
        ends = [f"{10 ** (end / 20):.2g}" for end in (row.low, row.high)]
        found = f"{ends[0]} to {ends[1]} times"
    else:
        unit = "" if row.cell.unit == "1" else f" {row.cell.unit}"
        found = f"{signed(row.low)} to {signed(row.high)}{unit}"
    return {
        "what": f"{cell_name(row.cell)}",
        "difference": difference_words(row),
        "range": found,
        "p": p_words(row.p).removeprefix("p = ").removeprefix("p "),
    }


# -- what stays


def _remaining(findings: GapFindings, label: str) -> dict[str, Any] | None:
    after = findings.locator_after
    if after is None:
        if not findings.result.get("effects"):
            return None
        text = "Not looked at: the recordings were not compared with the corrected simulator."
        return {"sentences": [text], "rows": [], "picture": None}
    flagged = _flagged(after)
    n = len(after.cells_)
    if flagged:
        # A number may differ both in its mean and in how much it varies.
        n_differ = len({(row.cell.family, row.cell.name) for row in flagged})
        rest = "clearest first" if len(flagged) <= _N_REMAINING else f"the {_N_REMAINING} clearest"
        verb = "differs, in its" if n_differ == 1 else "differ, in their"
        sentences = [
            f"With the correction, {n_differ} of {n} numbers still {verb} mean or in how much "
            f"recordings vary from one to the next; {rest}:"
        ]
    else:
        sentences = [
            f"With the correction, none of {n} numbers differs more than chance explains, neither in its "
            f"mean nor in how much recordings vary from one to the next. {_unnoticed(after)}"
        ]
    rows = [_against_simulated(row) for row in flagged[:_N_REMAINING]]
    before = findings.locator
    drawn = None
    if _means(before, "spectrum") and _means(after, "spectrum"):
        from cyclofeat.report._figures import picture

        display = GapReductionDisplay(
            before=before.table_, after=after.table_, alpha=after.alpha, label=label
        )
        drawn = picture(
            lambda ax, _: display.plot("spectrum", ax),
            (8.0, 3.3),
            "Differences in third octaves before and after",
        )
    return {"sentences": sentences, "rows": rows, "picture": drawn}


# -- pictures


def _picture(display: GapDisplay, kind: Any, phase: str = "lobe") -> dict[str, Any]:
    from cyclofeat.plotting._gap import SIZES
    from cyclofeat.report._figures import picture

    texts = {
        "families": "Clearest difference of each group of numbers, in standard deviations of one recording",
        "spectrum": "Levels in third octaves and their differences; bands that differ are shaded",
        "orders": "Differences of the lines of lobes and input shaft, by order",
        "phase": "Torque folded over turns, recordings against model, and the difference",
    }
    return picture(lambda ax, _: display.plot(kind, ax, phase=phase), SIZES[kind], texts[kind])


def _pictures(display: GapDisplay, word: str) -> list[dict[str, Any]]:
    chosen = (
        ("spectrum", "lobe", "Spectrum in third octaves",
         f"Above: mean level of {word} and model; the bands are one standard deviation of single "
         "recordings wide. Below: the difference, with a range that holds for all bands at once. Shaded: "
         "bands that differ. A range may miss zero without a mark: marks allow for the other groups of "
         "numbers, too."),
        ("orders", "lobe", "Lines of lobes and input shaft",
         "Every line above its surroundings, compared with the model's. Zero is agreement; filled and "
         "orange: differs. The ranges hold for all lines of a kind at once; what is marked also "
         "allows for the other groups of numbers."),
        ("phase", "lobe", "Torque over the lobes' passage",
         "Torque averaged over the time in which all lobes pass once, each recording turned to where it fits "
         "best. Shaded: phases that differ (a picture's mark, not part of the verdict)."),
        ("phase", "input", "Torque over the input's turn",
         "The same for one turn of the input shaft."),
    )  # fmt: skip
    return [
        {"heading": heading, "text": text, "picture": _picture(display, kind, phase)}
        for kind, phase, heading, text in chosen
        if display.has(kind, phase)  # type: ignore[arg-type]
    ]


# -- the small print


def _warnings(findings: GapFindings) -> list[str]:
    given = [*findings.result.get("warnings", ()), *findings.warnings]
    n = len(findings.locator.measured_)
    if n < _FEW and not any("recordings" in text for text in given):
        given.append(
            f"Only {number(n, 'recording')}: with fewer than {_FEW}, only large differences can be shown."
        )
    return list(dict.fromkeys(str(text) for text in given))


def _of_assemblies(locator: GapLocator) -> str:
    if locator.one_assembly:
        return "All recordings are of one assembly, as stated: they count as fewer for what it has in common."
    return "Each recording counts as one of an assembly of its own."


def _method(findings: GapFindings, disagree: bool) -> list[tuple[str, str]]:
    locator = findings.locator
    found = [
        (
            "Comparison",
            f"Each recording is summarised by {len(locator.cells_)} numbers, and so are "
            f"{len(locator.simulated_)} recordings of the model, in which everything varies that may vary "
            "without being a missing effect (start angle, wear's place, speed, load, pins). Compared are the "
            "means, and whether recordings vary more from one to the next than simulated ones. What follows "
            "a recording's own speed and mean torque counts as explained, as far as both vary in the model. "
            f"{_of_assemblies(locator)}",
        ),
        (
            "p",
            f"The labels of recordings are shuffled {locator.n_permutations} times; p is the share of "
            "shuffles with a difference as clear, corrected for the number of comparisons within a group "
            "(Westfall and Young) and for the number of groups (Holm). "
            f"Up to {locator.alpha:g} counts as a difference. A recording is one unit, however long it is.",
        ),
        (
            "Agreement",
            f"Shown only if every range lies within {_margin_db():g} dB, or {_margin_spreads():g} standard "
            "deviations of one recording. Where neither difference nor agreement is shown, the answer is "
            "open.",
        ),
    ]
    others = ", ".join(f"{name} {p_words(p)}" for name, p in getattr(locator, "p_global_", {}).items())
    if others:
        found.append(("All numbers together", f"Tests beside the verdict: {others}."))
    if hasattr(locator, "null_rate_"):
        text = (
            f"With simulated recordings in place of the real ones, {100 * locator.null_rate_:.1f} % of trials"
        )
        found.append(("False alarms", f"{text} end in a disagreement."))
    if disagree:
        found.append((
            "Naming",
            "The library's effects are simulated many times with sizes drawn from what rigs may have; a "
            "forest of decision trees learns what each does. Its probabilities hold among the effects of the "
            "library. Where these recordings resemble none of them, that is said.",
        ))  # fmt: skip
        found.append((
            "Size",
            "Parameters are fitted so that simulated numbers meet the recorded ones; the range comes from "
            "simulations around the best fit.",
        ))  # fmt: skip
    if findings.report is not None:
        found.append((
            "Gap closed",
            "1 - (after - floor) / (before - floor), with distances between recordings held out and "
            "simulator, in standard deviations of one recording; floor: distance of one half of the "
            "recordings from the other. The range comes from drawing recordings anew.",
        ))  # fmt: skip
    return found


def _provenance(findings: GapFindings) -> list[tuple[str, str]]:
    locator = findings.locator
    found = [(str(name), str(value)) for name, value in findings.settings.items()]
    known = [
        ("recordings", str(len(locator.measured_))),
        ("simulated recordings", str(len(locator.simulated_))),
        ("sampling rate", f"{locator.sampling_rate:g} Hz"),
        ("nominal input speed", f"{60 * locator.input_speed_hz:g} RPM"),
        ("seed of the comparison", str(locator.random_state)),
    ]
    found += [(name, text) for name, text in known if name not in findings.settings]
    if findings.seconds is not None:
        found.append(("computing time", f"{findings.seconds:.0f} s"))
    found.append(("versions", versions()))
    return found
