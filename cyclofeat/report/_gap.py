"""The report of a gap: what disagrees, what is missing, how far adding it helps, and what is left."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat import __version__
from cyclofeat.plotting import GapDisplay, GapReductionDisplay
from cyclofeat.plotting._base import require_matplotlib
from cyclofeat.plotting._gap import (
    CONDITIONS,
    OURS,
    alternative_name,
    cell_name,
    clarity,
    difference_words,
    family_name,
    in_words,
    p_words,
)
from cyclofeat.report._page import number, origin, probability_text, target_of, unbroken, versions, write_page

if TYPE_CHECKING:
    import os

    from cyclofeat.gap import GapLocator, Row
    from cyclofeat.simulators import Effect

_N_CLEAREST, _N_REMAINING, _N_RANKED = 8, 6, 5
_BANK_PER_RECORDING = 10  # simulated recordings for each one, when the number that is needed is estimated
_FEW = 5  # recordings, below which exact tests hardly reject

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


@dataclass(frozen=True)
class GapFindings:
    """All that the report of a gap is made from.

    Parameters
    ----------
    result : mapping
        What ``cyclofeat gap --json`` prints: ``verdict``, ``p``, ``effects``, ``ranking``, ``tie_group``,
        ``unknown``, ``next_measurement``, ``warnings``; keys that are missing count as empty.
    locator : GapLocator
        Fitted with the simulator as it was.
    locator_after : GapLocator, optional
        Fitted with the corrected simulator.
    report : GapReport, optional
        Scored on recordings held out: ``comparison_``, ``distances_``, ``grr_``, ``grr_ci_``, ``undefined_``.
    effects : sequence of Effect
        The fitted effects.
    theta : mapping from str to float
        Fitted parameters by ``"effect_id.parameter"``, in their units.
    theta_ci : mapping from str to tuple of float
        Their intervals.
    identifiable, at_bound : mapping from str to bool
        Whether the recordings fix them, and whether they lie at an end of their range.
    confidence : float, default=0.9
        Of the intervals.
    sources : sequence of str or None
        ``Recording.source`` of each recording. Where one is ``"simulated"`` or ``"surrogate"`` the report
        says so, and calls nothing of it measured.
    settings : mapping
        What the results were made from, label to value.
    warnings : sequence of str
        Besides those of ``result``.
    seconds : float, optional
        Computing time.
    title : str, optional
        Heading.
    """

    result: Mapping[str, Any]
    locator: GapLocator
    locator_after: GapLocator | None = None
    report: Any = None
    effects: Sequence[Effect] = ()
    theta: Mapping[str, float] = field(default_factory=dict)
    theta_ci: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    identifiable: Mapping[str, bool] = field(default_factory=dict)
    at_bound: Mapping[str, bool] = field(default_factory=dict)
    confidence: float = 0.9
    sources: Sequence[str | None] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    warnings: Sequence[str] = ()
    seconds: float | None = None
    title: str = ""


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
    missing = _missing(findings) if disagree else None
    reduction = _reduction(findings) if disagree else None
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
            f"{_round(1 / max(p, 1e-9))} such comparisons ({unbroken(p_words(p))}, "
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
        f"To show agreement within {_margin_db():g} dB it would take roughly {_round(more)} recordings, "
        f"compared with {_round(_BANK_PER_RECORDING * more)} simulated ones{settled}. Any more recordings "
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
    names = _listed(family_name(family) for family in families)
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
        found = f"{_signed(row.low)} to {_signed(row.high)}{unit}"
    return {
        "what": f"{cell_name(row.cell)}",
        "difference": difference_words(row),
        "range": found,
        "p": p_words(row.p).removeprefix("p = ").removeprefix("p "),
    }


# -- what is missing


def _missing(findings: GapFindings) -> dict[str, Any]:
    result = findings.result
    # Most probable first.
    probability = {str(row["id"]): float(row["probability"]) for row in result.get("ranking", ())}
    tie_group = [str(name) for name in result.get("tie_group", ())]
    accepted = [
        _effect(findings, dict(row), tie_group if k == 0 else [], probability)
        for k, row in enumerate(result.get("effects", ()))
    ]
    unknown = bool(result.get("unknown", False))
    heading = "No effect considered explains it" if unknown else "No effect was accepted"
    if unknown and accepted:
        heading = "No effect considered explains the rest"
    text = ""
    if unknown:
        text = (
            "None of the effects considered does to the torque what is seen here. The probabilities below "
            "say which come nearest, not that one of them is right. The pictures show what a new effect "
            "would have to do."
        )
    elif not accepted:
        text = "Model and recordings disagree, but none of the effects considered was found to close the gap."
    alike = [name for name in tie_group if name not in {effect["id"] for effect in accepted}]
    together = sum(probability.get(name, 0.0) for name in tie_group)
    return {
        "heading": heading,
        "effects": accepted,
        "unknown": text,
        "look_alikes": [_named(findings, name) for name in alike],
        "look_alikes_text": "These recordings cannot tell it from the following; together they have a "
        f"probability of {probability_text(min(together, 1.0))}. What is missing may be any of them:",
        "next_measurement": _sentence(str(result.get("next_measurement") or "")),
        "ranking": [
            _named(findings, name) | {"probability": share, "text": probability_text(share)}
            for name, share in list(probability.items())[:_N_RANKED]
        ],
        "ranking_caption": "The most probable of the effects considered, given that something is missing"
        + (" and that it is one of them (which is doubtful here)." if unknown else "."),
    }


def _effect(
    findings: GapFindings, row: Mapping[str, Any], tie_group: Sequence[str], among: Mapping[str, float]
) -> dict[str, Any]:
    effect_id = str(row["id"])
    found = _named(findings, effect_id)
    probability = row.get("probability", among.get(effect_id))
    short, confidence = "", ""
    if probability is not None:
        text = probability_text(float(probability))
        short = f"{_likely(float(probability))}: probability {text}"
        confidence = f"{short[0].upper()}{short[1:]}, among the effects considered."
        if len(tie_group) > 1:
            short += f", with {number(len(tie_group) - 1, 'look-alike')}"
            confidence += " It has look-alikes, see below."
    theta, interval = dict(row.get("theta", {})), dict(row.get("interval", {}))
    prefix = f"{effect_id}."
    for key, value in findings.theta.items():
        if key.startswith(prefix):
            theta[key.removeprefix(prefix)] = value
    for key, ends in findings.theta_ci.items():
        if key.startswith(prefix):
            interval[key.removeprefix(prefix)] = ends
    units = _units(findings, effect_id)
    sizes = [
        _size(findings, effect_id, name, float(value), interval.get(name), units.get(name, "1"))
        for name, value in theta.items()
    ]
    remarks = any(size["remark"] for size in sizes)
    return found | {"short": short, "confidence": confidence, "sizes": sizes, "remarks": remarks}


def _size(
    findings: GapFindings,
    effect_id: str,
    name: str,
    value: float,
    interval: Sequence[float] | None,
    unit: str,
) -> dict[str, str]:
    remarks = []
    key = f"{effect_id}.{name}"
    if not findings.identifiable.get(key, True):
        remarks.append("not fixed by these recordings: other values do as well")
    if findings.at_bound.get(key, False):
        remarks.append("at an end of what was tried: the true value may lie beyond")
    low, high = (math.nan, math.nan) if interval is None else (float(end) for end in interval)
    there = not (math.isnan(low) or math.isnan(high))
    return {
        "name": name.removesuffix("_nm").removesuffix("_hz").replace("_", " "),
        "value": _quantity([value], unit),
        "range": _quantity([low, high], unit) if there else "",
        "remark": "; ".join(remarks),
    }


def _kinds(findings: GapFindings) -> dict[str, Any]:
    from cyclofeat.simulators import effect_library

    return {**effect_library(), **{effect.effect_id: type(effect) for effect in findings.effects}}


def _units(findings: GapFindings, effect_id: str) -> dict[str, str]:
    kind = _kinds(findings).get(effect_id)
    return {} if kind is None else {name: parameter.unit for name, parameter in kind.parameters.items()}


def _named(findings: GapFindings, effect_id: str) -> dict[str, Any]:
    """Id, name in plain words, what it is and what tells it apart."""
    kind = _kinds(findings).get(effect_id)
    if kind is None:
        return {"id": effect_id, "name": effect_id.replace("_", " "), "summary": "", "separated_by": ""}
    summary = kind.summary()
    name = summary.partition(":")[0].partition(",")[0].removesuffix(".")
    return {"id": effect_id, "name": name, "summary": summary, "separated_by": kind.separated_by}


def _likely(probability: float) -> str:
    for least, word in ((0.95, "very likely"), (0.8, "likely"), (0.5, "more likely than not")):
        if probability >= least:
            return word
    return "uncertain"


# -- how far the gap shrank


def _reduction(findings: GapFindings) -> dict[str, Any]:
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
        text = _range_text(*ends)
        found["sentences"] = [
            f"On recordings that nothing was fitted to, the correction {_closes(grr)} the gap"
            + (f" (range {text})." if text else ".")
        ]
        found["sentences"] += _by_condition(rows)
        found["tile"] = {"label": label, "value": _percent(grr), "text": f"range {text}" if text else ""}
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
        f"{_percent(ours[name].grr)} with {CONDITIONS[name]}"
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
        text = f"{words} {_quoted(alternative_name(best.alternative))} {verb}"
        text += f", with {_percent(best.grr)} against {_percent(ours[0].grr)}"
        share = beats.get(best.alternative, {}).get(condition, math.nan)
        if math.isfinite(share):
            text += f" (with recordings drawn anew, the named effect is nearer in {_percent(share)} of draws)"
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
                {"value": _percent(of[0].grr), "range": _range_text(of[0].low, of[0].high)} if of else None
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
    return f"closed {_percent(grr)} of"


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


# -- numbers as text


def _percent(share: float) -> str:
    return unbroken(f"{100 * float(share):.0f} %") if math.isfinite(share) else "not defined"


def _range_text(low: float, high: float) -> str:
    if not (math.isfinite(low) and math.isfinite(high)) or low == high:
        return ""
    return f"{100 * float(low):.0f} to {_percent(high)}"


def _quantity(values: Sequence[float], unit: str) -> str:
    """One value, or a range, with its unit."""
    if unit == "m" and all(abs(value) < 1e-3 for value in values):
        values, unit = [1e6 * value for value in values], "\N{MICRO SIGN}m"
    text = " to ".join("infinite" if math.isinf(value) else f"{value:.3g}" for value in values)
    return text if unit == "1" else f"{text}\N{NO-BREAK SPACE}{unit}"


def _signed(value: float) -> str:
    return f"{value:+.2g}" if abs(value) < 10 else f"{value:+.0f}"


def _round(value: float) -> str:
    """Two significant digits, without powers of ten."""
    if value < 10:
        return f"{value:.2g}"
    digits = 1 - math.floor(math.log10(value))
    return f"{round(value, digits):.0f}"


def _listed(names: Iterable[str]) -> str:
    return "; ".join(names)


def _quoted(text: str) -> str:
    return f"\N{LEFT DOUBLE QUOTATION MARK}{text}\N{RIGHT DOUBLE QUOTATION MARK}"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].removesuffix(".") + "." if text else ""
