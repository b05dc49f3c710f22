"""Page of a gap: the answer first, then what it stands on.

``_gap_answer`` writes what is missing, ``_gap_where`` where model and recordings differ, ``_gap_reduction``
how far the gap shrank and ``_gap_method`` how all of it was found, into ``templates/gap.html``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat import __version__
from cyclofeat._base.words import number
from cyclofeat.plotting import GapOverlayDisplay
from cyclofeat.plotting.drawing import require_matplotlib
from cyclofeat.report._figures import draw_picture
from cyclofeat.report._gap_answer import measure_next, the_answer, what_remains
from cyclofeat.report._gap_method import method_rows, provenance_rows
from cyclofeat.report._gap_reduction import summarise_reduction
from cyclofeat.report._gap_where import where_they_differ
from cyclofeat.report._page import check_page_path, describe_origin, write_page
from cyclofeat.report._plot import Axis, Line, Plot

if TYPE_CHECKING:
    import os

    from cyclofeat.gap import GapResult
    from cyclofeat.gap.overlays import Overlay

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
            f"Only {number(n, 'recording')}: with fewer than {_FEW}, only large differences can be shown."
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
