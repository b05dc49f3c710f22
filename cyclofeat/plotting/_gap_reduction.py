"""How far a corrected simulator closes the gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from cyclofeat.plotting._base import Float, axes_for, plain_log_ticks
from cyclofeat.plotting._gap import FLAGGED, RECORDED
from cyclofeat.plotting._gap_words import (
    CONDITIONS,
    alternative_name,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from cyclofeat.gap import GapLocator, Row

ReductionKind = Literal["comparison", "spectrum"]


_GRR_FLOOR = -100.0  # in percent: what is worse is drawn there and said in words


@dataclass(frozen=True)
class _Comparison:
    alternative: str
    condition: str
    grr: float
    low: float
    high: float


class GapReductionDisplay:
    """How far simulators close the gap on recordings that none of them was fitted to.

    Parameters
    ----------
    comparison : sequence of rows
        With attributes ``alternative``, ``condition`` (``"all"``, ``"seen"`` or ``"unseen"``), ``grr`` (share
        of the gap that is closed; 1 closes it, below 0 it grows), ``low`` and ``high``.
    before, after : sequence of cyclofeat.gap.Row, optional
        Tables of the locator with the simulator before and after.
    alpha : float, default=0.05
        Adjusted p up to which a cell is flagged.
    label : str, default="measured"
        What the recordings are called.

    Attributes
    ----------
    ax_, figure_
        As drawn on.
    drawn_ : list of tuple
        ``(alternative, condition, percent)`` as drawn, of kind ``"comparison"``.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> rows = [
    ...     SimpleNamespace(alternative="after", condition="all", grr=0.9, low=0.8, high=0.95),
    ...     SimpleNamespace(alternative="retuned", condition="all", grr=0.2, low=0.1, high=0.3),
    ... ]
    >>> display = GapReductionDisplay(comparison=rows).plot()
    >>> display.drawn_
    [('after', 'all', 90.0), ('retuned', 'all', 20.0)]
    """

    ax_: Axes
    figure_: Figure | SubFigure
    drawn_: list[tuple[str, str, float]]

    def __init__(
        self,
        *,
        comparison: Sequence[Any] = (),
        before: Sequence[Row] | None = None,
        after: Sequence[Row] | None = None,
        alpha: float = 0.05,
        label: str = "measured",
    ) -> None:
        self.comparison = [
            _Comparison(row.alternative, row.condition, float(row.grr), float(row.low), float(row.high))
            for row in comparison
        ]
        self.before = None if before is None else _bands(before)
        self.after = None if after is None else _bands(after)
        self.alpha = float(alpha)
        self.label = str(label)

    @classmethod
    def from_report(
        cls,
        report: Any = None,
        kind: ReductionKind = "comparison",
        ax: Axes | None = None,
        *,
        before: GapLocator | None = None,
        after: GapLocator | None = None,
        label: str = "measured",
    ) -> Self:
        """Draw a scored report, or the spectrum's differences before and after.

        Parameters
        ----------
        report : cyclofeat.gap.GapReport, optional
            Scored; needed for ``kind="comparison"``.
        kind, ax
            As in :meth:`plot`.
        before, after : cyclofeat.gap.GapLocator, optional
            Fitted with the simulator before and after; needed for ``kind="spectrum"``.
        label : str, default="measured"
            What the recordings are called.

        Returns
        -------
        GapReductionDisplay
        """
        display = cls(
            comparison=() if report is None else report.comparison_,
            before=None if before is None else before.table_,
            after=None if after is None else after.table_,
            alpha=0.05 if after is None else after.alpha,
            label=label,
        )
        return display.plot(kind=kind, ax=ax)

    def plot(self, kind: ReductionKind = "comparison", ax: Axes | None = None) -> Self:
        """Draw.

        Parameters
        ----------
        kind : {"comparison", "spectrum"}, default="comparison"
            Share of the gap that each alternative closes, with its interval; or the differences in third
            octaves before and after.
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.

        Returns
        -------
        self

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If there is no such kind, or nothing to draw of it.
        """
        if kind not in ("comparison", "spectrum"):
            raise ValueError(f"kind must be 'comparison' or 'spectrum', got {kind!r}")
        if kind == "comparison":
            if not any(np.isfinite(row.grr) for row in self.comparison):
                raise ValueError("comparison must hold a row with a finite grr to be drawn, got none")
            n = len(dict.fromkeys(row.alternative for row in self.comparison))
            self.figure_, self.ax_ = axes_for(ax, (8.0, 1.4 + 0.6 * n))
            self._compare()
        else:
            if not self.before or not self.after:
                raise ValueError("before and after must be given, with cells of family 'spectrum'")
            self.figure_, self.ax_ = axes_for(ax, (8.0, 3.4))
            self._spectra()
        return self

    def _compare(self) -> None:
        from matplotlib import rcParams
        from matplotlib.lines import Line2D

        ax = self.ax_
        rows = [row for row in self.comparison if np.isfinite(row.grr)]
        names = list(dict.fromkeys(row.alternative for row in rows))
        styles = {"all": ("o", "C0", 0.0), "seen": ("s", "C2", 0.22), "unseen": ("D", "C1", 0.44)}
        conditions = [name for name in styles if any(row.condition == name for row in rows)]
        centre = np.mean([styles[name][2] for name in conditions])
        self.drawn_ = []
        grey = rcParams["axes.edgecolor"]
        for x, style in ((0, "-"), (100, ":")):
            ax.axvline(x, color=grey, linewidth=1.2, linestyle=style, zorder=1)
        for row in rows:
            marker, colour, offset = styles[row.condition]
            place = names.index(row.alternative) + offset - float(centre)
            percent = 100 * row.grr
            self.drawn_.append((row.alternative, row.condition, percent))
            if percent < _GRR_FLOOR:
                ax.plot(_GRR_FLOOR, place, "<", color=colour, markersize=7, zorder=3)
                ax.text(_GRR_FLOOR + 4, place, f"{percent:.0f} %", va="center", fontsize="small")
                continue
            if np.isfinite(row.low) and np.isfinite(row.high):
                ax.hlines(
                    place, max(100 * row.low, _GRR_FLOOR - 5), 100 * row.high, color=colour, linewidth=2
                )
            ax.plot(percent, place, marker, color=colour, markersize=7, zorder=3)
        for place in np.arange(len(names) - 1) + 0.5:
            ax.axhline(float(place), color=grey, linewidth=0.5, alpha=0.4)
        ax.set_yticks(range(len(names)), [alternative_name(name) for name in names])
        ax.tick_params(axis="y", length=0)
        least = min([-12.0, *(100 * row.low for row in rows if np.isfinite(row.low)),
                     *(100 * row.grr for row in rows)])  # fmt: skip
        most = max([105.0, *(100 * row.high for row in rows if np.isfinite(row.high)),
                    *(100 * row.grr for row in rows)])  # fmt: skip
        ax.set(
            xlabel="share of the gap closed on recordings not used before (%)",
            xlim=(max(least - 5, _GRR_FLOOR - 8), most + 7),
            ylim=(len(names) - 0.5, -0.5),
        )
        if len(conditions) > 1:
            handles = [
                Line2D([], [], linestyle="", marker=styles[name][0], color=styles[name][1],
                       label=CONDITIONS[name]) for name in conditions
            ]  # fmt: skip
            ax.legend(handles=handles, fontsize="small", frameon=False, ncols=len(handles),
                      loc="lower center", bbox_to_anchor=(0.35, 1.0), borderaxespad=0.2)  # fmt: skip

    def _spectra(self) -> None:
        from matplotlib import rcParams

        ax = self.ax_
        assert self.before is not None
        assert self.after is not None
        grey, ink = rcParams["axes.edgecolor"], rcParams["text.color"]
        hz: Float = np.array([np.sqrt(row.cell.low_hz * row.cell.high_hz) for row in self.before])
        spread: Float = np.array([row.spread for row in self.before])
        ax.fill_between(hz, -spread, spread, color=ink, alpha=0.12, linewidth=0,
                        label="standard deviation of one recording")  # fmt: skip
        ax.axhline(0, color=grey, linewidth=1)
        for rows, colour, style, name in (
            (self.before, FLAGGED, "--", "before"),
            (self.after, RECORDED, "-", "after"),
        ):
            x: Float = np.array([np.sqrt(row.cell.low_hz * row.cell.high_hz) for row in rows])
            effects: Float = np.array([row.effect for row in rows])
            ax.plot(x, effects, style, color=colour, linewidth=1.6, label=f"{name} the correction")
            flagged = np.array([row.p <= self.alpha for row in rows])
            ax.plot(x[flagged], effects[flagged], "o", color=colour, markersize=5)
        ax.set(
            xscale="log", xlabel="frequency (Hz)",
            xlim=(self.before[0].cell.low_hz, self.before[-1].cell.high_hz),
            ylabel=f"{self.label} minus\nsimulated (dB)",
        )  # fmt: skip
        plain_log_ticks(ax)
        ax.grid(axis="y", alpha=0.3, linewidth=0.6)
        handles, labels = ax.get_legend_handles_labels()
        from matplotlib.lines import Line2D

        handles.append(Line2D([], [], linestyle="", marker="o", markersize=5, color=ink))
        labels.append("dot: differs")
        ax.legend(handles, labels, fontsize="small", frameon=False, ncols=4, loc="lower left",
                  bbox_to_anchor=(0, 1.0), borderaxespad=0.2)  # fmt: skip


def _bands(table: Sequence[Row]) -> list[Row]:
    return [row for row in table if row.cell.family == "spectrum" and row.of == "mean"]
