"""Report of a history: the counts of gearboxes over time, and their alarms."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat import __version__
from cyclofeat.history import GearboxState, History, HistoryRow
from cyclofeat.history.alarm import time_text
from cyclofeat.plotting.drawing import require_matplotlib
from cyclofeat.report._page import (
    check_page_path,
    count_heading,
    count_text,
    probability_text,
    summary_tile,
    versions_line,
    write_page,
)
from cyclofeat.report._plot import Axis, Line, Plot, Span

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cyclofeat.report._figures import Picture

_N_LAST, _MOST_ROWS = 10, 20_000
_DAY_S, _HOUR_S = 86_400.0, 3600.0
_SIZE = (11.0, 2.6)


def write_history_report(
    history: History, path: str | os.PathLike[str], *, states: Sequence[GearboxState] | None = None
) -> Path:
    """Write the counts of gearboxes over time as one HTML file, and return its path.

    Alarms come first, then a section for each gearbox: its counts, the depth of its wear where the model
    states it, the standard deviation of its torque, the rule of its alarm and how often it errs, past alarms,
    and the last recordings. A file of that name is replaced.

    Parameters
    ----------
    history : cyclofeat.history.History
    path : path-like
        File to write, ``*.html``.
    states : sequence of cyclofeat.history.GearboxState, optional
        Of the gearboxes to show; default, all with the default rate of false alarms.

    Raises
    ------
    ImportError
        If jinja2 or matplotlib is not installed.
    FileNotFoundError
        If the folder does not exist.
    ValueError
        If there is no recording.

    Examples
    --------
    >>> from cyclofeat.history import History
    >>> from cyclofeat.report import write_history_report
    >>> write_history_report(History("press.sqlite"), "press.html")  # doctest: +SKIP
    """
    target = check_page_path(path)
    return write_page(target, "history.html", summarise_history(history, states=states))


def summarise_history(history: History, *, states: Sequence[GearboxState] | None = None) -> dict[str, Any]:
    """Summarise a history in plain values that JSON can hold.

    Parameters and errors are those of :func:`write_history_report`; pictures are data URIs.

    Returns
    -------
    dict
        ``title``, ``version``, ``tiles``, ``gearboxes`` (one per gearbox) and ``provenance``.
    """
    require_matplotlib()
    shown = [history.state(name) for name in history.gearboxes()] if states is None else list(states)
    if not shown:
        raise ValueError(f"history {history.path} holds no recording")
    alarmed = [state.gearbox for state in shown if state.alarm]
    total, refused = (sum(getattr(state, name) for state in shown) for name in ("n_recordings", "n_refused"))
    unguarded = [state.gearbox for state in shown if state.rule is None]
    tiles = [
        summary_tile(
            "Alarm",
            f"{len(alarmed)} of {len(shown)}",
            ", ".join(alarmed) or "no count has risen",
            bool(alarmed),
        ),
        summary_tile("Recordings", str(total), f"{refused} refused"),
        summary_tile("Last recording", time_text(max(state.last for state in shown))[:10], "day, UTC"),
    ]
    if unguarded:
        tiles.append(summary_tile("No alarm possible", str(len(unguarded)), ", ".join(unguarded), True))
    return {
        "title": "Worn lobes over time" if len(shown) > 1 else f"Worn lobes over time: {shown[0].gearbox}",
        "version": __version__,
        "tiles": tiles,
        "gearboxes": [
            _gearbox_section(history, state) for state in sorted(shown, key=lambda one: not one.alarm)
        ],
        "provenance": [("history", str(history.path)), ("made with", versions_line())],
    }


def _gearbox_section(history: History, state: GearboxState) -> dict[str, Any]:
    rows = history.rows(state.gearbox, _MOST_ROWS)
    rule, period = state.rule, f"from {time_text(state.first)} to {time_text(state.last)}"
    facts = {
        "recordings": f"{state.n_recordings} {period}, {state.n_refused} refused",
        "baseline": "none yet" if state.baseline is None else count_text(state.baseline, ()),
    }
    if rule is not None:
        facts |= {
            "counts above it by error": f"up to {rule.error_rate:.1%}, by cross-validation and the baseline",
            "counts above it with a further worn lobe": f"{rule.detection_rate:.1%}",
        }
    state_facts = [*facts.items()]
    return {
        "name": state.gearbox,
        "answer": "Never counted" if state.defect_count is None else count_heading(state.defect_count),
        "alarm": state.alarm,
        "state": str(state),
        "rates": state.rates,
        "facts": state_facts,
        "n_more": state.n_recordings - len(rows) if len(rows) == _MOST_ROWS else 0,
        "pictures": _draw_history(state, rows),
        "alarms": [
            {"from": time_text(begin), "to": "lasts" if end is None else time_text(end)}
            for begin, end in state.alarms
        ],
        "states_wear": any("wear_um" in row.answer for row in rows),
        "last": [_history_row(row) for row in reversed(rows[-_N_LAST:])],
    }


def _history_row(row: HistoryRow) -> dict[str, Any]:
    refused = row.defect_count is None
    count = row.answer["refused_defect_count"] if refused else row.defect_count
    return {
        "time": time_text(row.time),
        "file": Path(row.file).name,
        "count": "refused" if refused else str(count),
        "refused": refused,
        "wear": "-" if row.answer.get("wear_um") is None else f"{row.answer['wear_um']:.3g}",
        "probability": probability_text(row.answer["probability"][str(count)]),
        "reason": row.reason,
    }


def _draw_history(state: GearboxState, rows: Sequence[HistoryRow]) -> list[Picture]:
    """Draw counts and deviation over time; nothing of a single moment."""
    from cyclofeat.report._figures import draw_picture

    first, last = rows[0].time, rows[-1].time
    if first == last:
        return []
    unit, name = (_DAY_S, "days") if last - first > 3 * _DAY_S else (_HOUR_S, "hours")
    at = np.array([row.time - first for row in rows]) / unit
    axis = Axis(f"time since {time_text(first)}", name)
    spans = [
        Span(
            max(0.0, (begin - first) / unit), ((last if end is None else end) - first) / unit, "alarm",
            f"alarm from {time_text(begin)}{'' if end is None else f' to {time_text(end)}'}", amiss=True,
        )
        for begin, end in state.alarms
        if end is None or end > first
    ]  # fmt: skip
    lines = _count_lines(state, rows)
    note = f"The page holds the last {len(rows)} recordings." if len(rows) == _MOST_ROWS else ""
    counts = Plot(at, lines, (axis, Axis("worn lobes", "", whole=True)), spans=spans, note=note)
    deviations = np.array([row.deviation if row.unit == rows[-1].unit else np.nan for row in rows])
    spread = Line("standard deviation of the samples", deviations, style="points")
    deviation = Plot(at, [spread], (axis, Axis("deviation", rows[-1].unit)), spans=spans)

    def draw(plot: Plot) -> Any:
        def on(ax: Axes, _: str) -> None:
            for k, line in enumerate(plot.lines):
                style = "." if line.style == "points" else "--"
                ax.plot(at, np.asarray(line.values), style, color=f"C{k}", label=line.name)
                if line.band is not None:
                    ax.fill_between(at, *line.band, color=f"C{k}", alpha=0.2)
            for span in plot.spans:
                ax.axvspan(span.start, span.stop, color="r", alpha=0.15, lw=0)
            if plot.axes[1].whole:
                ax.locator_params(axis="y", integer=True)
            ax.set_xlabel(f"{plot.axes[0].quantity} ({name})")
            ax.set_ylabel(
                f"{plot.axes[1].quantity}" + (f" ({plot.axes[1].unit})" if plot.axes[1].unit else "")
            )
            if len(plot.lines) > 1:
                ax.legend(loc="upper left", fontsize="small")

        return on

    of = f"of {state.gearbox} over time"
    shown = [(counts, f"Counts of worn lobes {of}, with the baseline and alarms")]
    if wear := _wear_lines(rows):
        depth = Plot(at, wear, (axis, Axis("depth of wear", "um")), spans=spans)
        shown.append((depth, f"Depth of wear {of}"))
    shown.append((deviation, f"Standard deviation of the samples {of}"))
    return [draw_picture(draw(plot), _SIZE, text, plot=plot) for plot, text in shown]


def _wear_lines(rows: Sequence[HistoryRow]) -> list[Line]:
    """Return the depth of the wear with its interval, of recordings that were counted; none if none shows."""
    seen = [row.defect_count is not None and row.answer.get("wear_um") is not None for row in rows]

    def values(key: str) -> Any:
        return np.array([row.answer[key] if one else np.nan for row, one in zip(rows, seen, strict=True)])

    depth, low, high = (values(key) for key in ("wear_um", "wear_um_low", "wear_um_high"))
    return [Line("depth", depth, style="points", band=(low, high))] if np.isfinite(depth).any() else []


def _count_lines(state: GearboxState, rows: Sequence[HistoryRow]) -> list[Line]:
    """Return the counts of the last model, those of others, refused ones and the baseline."""
    present = np.array([row.model == rows[-1].model for row in rows])
    refused = np.array([row.defect_count is None for row in rows])
    values = np.array(
        [
            row.answer["refused_defect_count"] if row.defect_count is None else row.defect_count
            for row in rows
        ],
        dtype=float,
    )
    kinds: list[tuple[str, Any, Any]] = [
        ("count", present & ~refused, "accent"),
        ("count of an earlier model", ~present & ~refused, "third"),
        ("refused, would be", refused, "wrong"),
    ]
    lines = [
        Line(name, np.where(chosen, values, np.nan), colour, "points")
        for name, chosen, colour in kinds
        if chosen.any()
    ]
    if state.baseline is not None:
        lines.append(Line("baseline", np.where(present, float(state.baseline), np.nan), "faint", "dashed"))
    return lines
