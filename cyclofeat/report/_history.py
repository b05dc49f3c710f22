"""Report of a history: the counts of gearboxes over time, and their alarms."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from cyclofeat.history import GearboxState, History, HistoryRow
from cyclofeat.history.alarm import time_text
from cyclofeat.report import _figures
from cyclofeat.report._figures import Axis, Line, Picture, Plot, Span
from cyclofeat.report._page import check_page_path, count_text, describe_origin, write_page

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_N_LAST, _MOST_ROWS = 10, 20_000
_ASIDE_S = 43_200.0  # that are shown on both sides of a single recording
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
        States of the gearboxes to show. Default: all, with the default rate of false alarms.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    ValueError
        If there is no recording.

    Examples
    --------
    >>> from cyclofeat.history import History
    >>> from cyclofeat.report import write_history_report
    >>> write_history_report(History("press.sqlite"), "press.html")  # doctest: +SKIP
    """
    check_page_path(path)
    shown = [history.state(name) for name in history.gearboxes()] if states is None else list(states)
    if not shown:
        raise ValueError(f"history {history.path} holds no recording")
    rows = {state.gearbox: history.rows(state.gearbox, _MOST_ROWS) for state in shown}
    _, surrogate, origin = describe_origin(
        [row.answer.get("source") for part in rows.values() for row in part]
    )
    summary = {
        "title": "Worn lobes over time" if len(shown) > 1 else f"Worn lobes over time: {shown[0].gearbox}",
        "surrogate": surrogate,
        "origin": origin,
        "n_recordings": sum(state.n_recordings for state in shown),
        "n_refused": sum(state.n_refused for state in shown),
        "last": time_text(max(state.last for state in shown))[:10],
        "unguarded": [state.gearbox for state in shown if state.rule is None],
        "gearboxes": [
            _gearbox_section(state, rows[state.gearbox])
            for state in sorted(shown, key=lambda state: not state.alarm)
        ],
        "provenance": {"history": str(history.path)},
    }
    return write_page(path, "history.html", summary)


def _gearbox_section(state: GearboxState, rows: Sequence[HistoryRow]) -> dict[str, Any]:
    rule, period = state.rule, f"from {time_text(state.first)} to {time_text(state.last)}"
    facts = {
        "recordings": f"{state.n_recordings} {period}, {state.n_refused} refused",
        "baseline": "none yet" if state.baseline is None else count_text(state.baseline),
    }
    if rule is not None:
        facts |= {
            "counts above it by error": f"up to {rule.error_rate:.1%}, by cross-validation and the baseline",
            "counts above it with a further worn lobe": f"{rule.detection_rate:.1%}",
        }
    return {
        "name": state.gearbox,
        "answer": "Never counted"
        if state.defect_count is None
        else count_text(state.defect_count).capitalize(),
        "alarm": state.alarm,
        "state": str(state),
        "rates": state.rates,
        "facts": facts,
        "pictures": _draw_history(state, rows),
        "alarms": [
            {"from": time_text(begin), "to": "lasts" if end is None else time_text(end)}
            for begin, end in state.alarms
        ],
        "states_wear": any("wear_um" in row.answer for row in rows),
        "last": [
            {
                "time": time_text(row.time),
                "file": Path(row.file).name,
                "count": row.defect_count,
                "wear": "-" if row.answer.get("wear_um") is None else f"{row.answer['wear_um']:.3g}",
                "probability": row.answer["probability"][str(_count_of(row))],
                "reason": row.reason,
            }
            for row in reversed(rows[-_N_LAST:])
        ],
    }


def _count_of(row: HistoryRow) -> int:
    """Return the count of a recording, also if it was refused."""
    return int(row.answer["refused_defect_count"] if row.defect_count is None else row.defect_count)


def _draw_history(state: GearboxState, rows: Sequence[HistoryRow]) -> list[Picture]:
    """Draw counts, wear and deviation over time."""
    first, last = rows[0].time, rows[-1].time
    at = np.array([row.time - first for row in rows])
    time_axis = Axis("time, UTC", "", start=first)
    view = (0.0, last - first) if last > first else (-_ASIDE_S, _ASIDE_S)
    spans = [
        Span(
            max(0.0, begin - first), (last if end is None else end) - first, "alarm",
            f"alarm from {time_text(begin)}{'' if end is None else f' to {time_text(end)}'}", amiss=True,
        )
        for begin, end in state.alarms
        if end is None or end > first
    ]  # fmt: skip
    note = f"The page holds the last {len(rows)} recordings." if len(rows) == _MOST_ROWS else ""
    of, unit = f"of {state.gearbox} over time", rows[-1].unit
    deviations = np.array([row.deviation if row.unit == unit else np.nan for row in rows])
    shown = [
        (_count_lines(state, rows), Axis("worn lobes", "", whole=True),
         f"Counts of worn lobes {of}, with the baseline and alarms"),
        ([Line("standard deviation of the samples", deviations, style="points")], Axis("deviation", unit),
         f"Standard deviation of the samples {of}"),
    ]  # fmt: skip
    # Of recordings that were counted, the depth of the wear with its interval, if any shows.
    seen = [row.answer if row.defect_count is not None else {} for row in rows]
    depth, low, high = (
        np.array([np.nan if answer.get("wear_um") is None else answer[key] for answer in seen])
        for key in ("wear_um", "wear_um_low", "wear_um_high")
    )
    if np.isfinite(depth).any():
        wear = Line("depth", depth, style="points", band=(low, high))
        shown.insert(1, ([wear], Axis("depth of wear", "um"), f"Depth of wear {of}"))
    pictures = []
    for lines, axis, text in shown:
        plot = Plot(at, lines, (time_axis, axis), view, spans=spans, note=note)
        pictures.append(_figures.draw_picture(partial(_draw_plot, plot), _SIZE, text, plot=plot))
        note = ""
    return pictures


def _draw_plot(plot: Plot, ax: Axes) -> None:
    """Draw a plot over time for paper."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    of_time, of_values = plot.axes

    def moments(seconds: ArrayLike) -> Any:
        """Return the times of seconds after the first recording."""
        return (1e3 * (np.asarray(seconds) + (of_time.start or 0.0))).astype("datetime64[ms]")

    styles = {"points": "o", "steps": "o-", "dashed": "--"}
    for k, line in enumerate(plot.lines):
        known = np.isfinite(np.asarray(line.values))
        at, values = moments(plot.x)[known], np.asarray(line.values)[known]
        ax.plot(
            at, values, styles[line.style], color=f"C{k}", ms=3, label=line.name,
            drawstyle="steps-post" if line.style == "steps" else "default",
        )  # fmt: skip
        if line.band is not None:
            ax.fill_between(at, *(np.asarray(end)[known] for end in line.band), color=f"C{k}", alpha=0.2)
    for span in plot.spans:
        ax.axvspan(*moments([span.start, span.stop]), color="r", alpha=0.15, lw=0)
    if plot.view is not None:
        ax.set_xlim(*moments(plot.view))
    dates = AutoDateLocator()  # type: ignore[no-untyped-call]
    ax.xaxis.set_major_locator(dates)
    ax.xaxis.set_major_formatter(ConciseDateFormatter(dates))  # type: ignore[no-untyped-call]
    if of_values.whole:
        ax.locator_params(axis="y", integer=True)
    unit = f" ({of_values.unit})" if of_values.unit else ""
    ax.set(xlabel=of_time.quantity, ylabel=of_values.quantity + unit)
    if len(plot.lines) > 1:
        ax.legend(loc="upper left", fontsize="small")


def _count_lines(state: GearboxState, rows: Sequence[HistoryRow]) -> list[Line]:
    """Return the counts of the last model, those of others, refused ones and the baseline."""
    present = np.array([row.model == rows[-1].model for row in rows])
    refused = np.array([row.defect_count is None for row in rows])
    counts = np.array([_count_of(row) for row in rows], dtype=float)
    kinds = (
        ("count", present & ~refused, "accent"),
        ("count of an earlier model", ~present & ~refused, "third"),
        ("refused, would be", refused, "wrong"),
    )
    lines = [
        Line(name, np.where(chosen, counts, np.nan), colour, "points" if colour == "wrong" else "steps")
        for name, chosen, colour in kinds
        if chosen.any()
    ]
    if state.baseline is not None:
        lines.append(Line("baseline", np.where(present, float(state.baseline), np.nan), "faint", "dashed"))
    return lines
