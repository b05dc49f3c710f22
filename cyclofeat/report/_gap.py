"""Page of a gap: the answer first, then what it stands on.

``_gap_answer`` writes what is missing, ``_gap_where`` where model and recordings differ, ``_gap_reduction``
how far the gap shrank and ``_gap_method`` how all of it was found, into ``templates/gap.html``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat import __version__
from cyclofeat._base.quantities import in_words, number_of
from cyclofeat.plotting import GapOverlayDisplay
from cyclofeat.plotting.drawing import require_matplotlib
from cyclofeat.plotting.gap_words import p_words
from cyclofeat.report._figures import draw_picture
from cyclofeat.report._gap_answer import measure_next, summarise_reduction, the_answer, what_remains
from cyclofeat.report._gap_where import where_they_differ
from cyclofeat.report._page import check_page_path, describe_origin, versions_line, write_page
from cyclofeat.report._plot import Axis, Line, Plot

if TYPE_CHECKING:
    import os

    from cyclofeat.gap import GapResult
    from cyclofeat.gap.overlays import Overlay
    from cyclofeat.gap.where.conditions import Where

_FEW = 5  # recordings, below which exact tests hardly reject
_BESIDE_ANOTHER = (5.2, 3.4)  # inches of a picture that has another one beside it
_OVERLAYS = {
    "spectrum": ("Spectrum", "Torque in twelfth octaves."),
    "orders": ("Lines of the output turn", "With 15 lobes, the mesh has orders 16, 32 and so on, the input "
               "shaft whole orders; others are of lobes, or of nothing that turns."),
    "distribution": ("Distribution of the torque", "How often each value of the torque occurs."),
}  # fmt: skip
_AXES = {
    "spectrum": (Axis("frequency", "Hz", log=True), Axis("rms in a twelfth octave", "Nm", log=True)),
    "orders": (Axis("order of the input shaft", ""), Axis("amplitude", "Nm", log=True)),
    "distribution": (Axis("torque", "Nm"), Axis("density", "1/Nm")),
}


def write_gap_report(
    result: GapResult,
    path: str | os.PathLike[str],
    *,
    sources: Sequence[str | None] = (),
    settings: Mapping[str, Any] | None = None,
    title: str = "",
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
        Settings that the page lists, label to value.
    title : str, optional
        Heading.

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
    """Summarise a gap in plain values that JSON can hold.

    Parameters and errors are those of :func:`write_gap_report`; pictures are data URIs.

    Returns
    -------
    dict
        ``title``, ``version``, ``surrogate``, ``origin``, ``answer``, ``next``, ``remains``, ``overlays``,
        ``where``, ``proof``, ``warnings``, ``method`` and ``provenance``, and what the template needs
        besides; absent parts are None or empty.
    """
    require_matplotlib()
    label, surrogate, text_of_origin = describe_origin(sources)
    word = "measurement" if label == "measured" else "recordings"
    # Of each kind its heading, and one picture per condition.
    shown = []
    for kind, (heading, text) in _OVERLAYS.items():
        of_kind = [overlay for overlay in result.overlays if overlay.kind == kind]
        if of_kind:
            size = GapOverlayDisplay.SIZE if len(of_kind) == 1 else _BESIDE_ANOTHER
            drawn = [
                {"condition": overlay.condition.text, "picture": _draw_overlay(overlay, label, size)}
                for overlay in of_kind
            ]
            shown.append({"heading": heading, "text": text, "pictures": drawn})
    given = list(result.warnings)
    n = sum(where.n_recordings for where in result.where)
    if n < _FEW and not any("recordings" in text for text in given):
        given.append(
            f"Only {number_of(n, 'recording')}: with fewer than {_FEW}, only large differences can be shown."
        )
    collect_warnings = list(dict.fromkeys(given))
    return {
        "title": title or f"Model against {word}",
        "version": __version__,
        "surrogate": surrogate,
        "origin": text_of_origin,
        "recordings_word": word,
        "answer": the_answer(result, word),
        "warnings": collect_warnings,
        "next": measure_next(result),
        "remains": None
        if result.remainder is None
        else what_remains(result.remainder, "corrected model" if result.named else "model"),
        "overlays": shown,
        "where": [where_they_differ(where, label, word) for where in result.where],
        "corrected": bool(result.named),
        "proof": [
            {"condition": proof.condition.text if proof.condition else ""} | summarise_reduction(proof)
            for proof in result.proof
        ],
        "method": method_rows(result),
        "provenance": provenance_rows(result, dict(settings or {})),
    }


def _draw_overlay(overlay: Overlay, label: str, size: tuple[float, float]) -> dict[str, Any]:
    display = GapOverlayDisplay(overlay, label=label)
    alt = f"{_OVERLAYS[overlay.kind][0]} of recordings, model and corrected model: {overlay.condition.text}"
    curves = {
        ("model", "ink", "dashed"): overlay.model,
        (label, "accent", "wide"): overlay.measured,
        ("corrected model", "third", "line"): overlay.corrected,
    }
    lines = [
        Line(name, band.mean, colour, style, (band.low, band.high))  # type: ignore[arg-type]
        for (name, colour, style), band in curves.items()
        if band is not None
    ]
    overlay_plot = Plot(overlay.x, lines, _AXES[overlay.kind])
    return draw_picture(lambda ax, _: display.plot(ax), size, alt, plot=overlay_plot)


def method_rows(result: GapResult) -> list[tuple[str, str]]:
    """Method in short: heading and text of each part."""
    parts = _describe_comparison(result.where[0], result.where[0].alpha * len(result.where))
    tests = [
        f"{one.condition.text}: {', '.join(f'{name} {p_words(p)}' for name, p in one.global_p.items())}"
        for one in result.where
        if one.global_p
    ]
    if tests:
        parts.append(("All numbers together", f"Tests in addition to the verdict. {'; '.join(tests)}."))
    if result.effects:
        parts.append((
            "Naming and size",
            f"Rigs with random sets of {len(result.effects)} effects, of random sizes, were simulated at "
            "random conditions; from them it was learned how probable each effect is, given recordings, and "
            "how large. An effect is called missing, or not missing, where one of the two is almost certain; "
            "else it is open. The ranges of sizes hold with 90 %.",
        ))  # fmt: skip
    if result.remainder is not None:
        parts.append((
            "Left unexplained",
            "The corrected model is simulated at all conditions and compared with the recordings, number by "
            "number and all together. Where they differ, so are rigs that have the open effects too, each as "
            "often as it is probable.",
        ))  # fmt: skip
    if result.proof:
        parts.append((
            "Gap closed",
            "1 - (after - floor) / (before - floor), with distances between the recordings held out and the "
            "simulator, in standard deviations of one recording. The floor is the distance between two "
            "halves of the recordings. The range comes from resampling the recordings.",
        ))  # fmt: skip
    return parts


def _describe_comparison(where: Where, alpha: float) -> list[tuple[str, str]]:
    assemblies = (
        "All recordings are stated to be of one assembly; they count as fewer, because they share its errors."
        if where.one_assembly
        else "Each recording counts as one of a different assembly."
    )
    return [
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
            "(Westfall and Young), for the number of groups (Holm) and for that of conditions (Bonferroni). "
            f"A p of at most {alpha:.2g} counts as a difference. A recording is one unit, however long.",
        ),
        (
            "Agreement",
            f"Agreement is shown only if every range lies within {where.margin_db:g} dB, or within "
            f"{where.margin_spreads:g} standard deviations of one recording. If neither difference nor "
            "agreement is shown, the answer is open.",
        ),
    ]


def provenance_rows(result: GapResult, settings: dict[str, Any]) -> list[tuple[str, str]]:
    """Settings and circumstances: label and text of each."""
    where = result.where[0]
    known = {
        "recordings": sum(one.n_recordings for one in result.where),
        "conditions": "; ".join(one.condition.text for one in result.where),
        "simulated recordings": sum(one.n_simulated for one in result.where),
        "quantity": in_words(result.quantity),
        "sampling rate": f"{where.sampling_rate:g} Hz",
        "random state": where.random_state,
    }
    if math.isfinite(result.seconds):
        known["computing time"] = f"{result.seconds:.0f} s"
    shown = settings | {name: text for name, text in known.items() if name not in settings}
    return [(str(name), str(text)) for name, text in (shown | {"versions": versions_line()}).items()]
