"""Recordings beside model and corrected model, and how far the correction closes the gap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cyclofeat._base.gap_words import COUNT_GROUPS, alternative_name
from cyclofeat.plotting._gap import RECORDED
from cyclofeat.plotting.drawing import (
    PlainDisplay,
    draw_mark_legend,
    legend_above,
    plain_log_ticks,
    theme_colours,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cyclofeat.gap.overlays import Overlay
    from cyclofeat.gap.proof.prove import ProofRow

_CORRECTED = "C2"
_LEAST_DENSITY = 1e-3  # of the largest, that a picture shows
_LABELS = {
    "spectrum": ("frequency (Hz)", "rms in a twelfth octave (Nm)"),
    "orders": ("order (multiples of the input speed)", "amplitude (Nm)"),
    "distribution": ("torque (Nm)", "density (1/Nm)"),
}


class GapOverlayDisplay(PlainDisplay):
    """Display of recordings, model and corrected model over each other.

    Lines are means over recordings; bands hold nine recordings in ten.

    Parameters
    ----------
    overlay : cyclofeat.gap.Overlay
    label : str, default="recordings"
        Name of the recordings.
    beside : sequence of cyclofeat.gap.Overlay, optional
        Those of its kind, itself among them, that share the axis of values.

    Attributes
    ----------
    ends : tuple of float
        Lowest and highest value of that axis.

    Examples
    --------
    >>> GapOverlayDisplay(result.overlays[0]).plot()  # doctest: +SKIP
    """

    size = (8.0, 3.6)

    def __init__(
        self, overlay: Overlay, *, label: str = "recordings", beside: Sequence[Overlay] = ()
    ) -> None:
        self.overlay = overlay
        self.label = str(label)
        bands = [
            band for one in beside or [overlay] for band in (one.measured, one.model, one.corrected) if band
        ]
        values = np.concatenate([ends for band in bands for ends in (band.mean, band.low, band.high)])
        high = float(values.max())
        # Single values can fall to any depth of a logarithmic axis; densities fall to zero.
        least = _LEAST_DENSITY * high if overlay.kind == "distribution" else float(np.quantile(values, 0.01))
        self.ends = 0.8 * least, 1.6 * high

    def _draw(self, ax: Axes) -> None:
        overlay = self.overlay
        # What fits lies within the wide line of the recordings.
        curves = (
            ("model", overlay.model, theme_colours()[0], "--", 1.2, 0.10),
            (self.label, overlay.measured, RECORDED, "-", 2.4, 0.25),
            ("corrected model", overlay.corrected, _CORRECTED, "-", 1.0, 0.20),
        )
        for name, band, colour, style, width, alpha in curves:
            if band is None:
                continue
            ax.fill_between(overlay.x, band.low, band.high, color=colour, alpha=alpha, linewidth=0)
            ax.plot(overlay.x, band.mean, style, color=colour, linewidth=width, label=name)
        xlabel, ylabel = _LABELS[overlay.kind]
        ax.set(xlabel=xlabel, ylabel=ylabel, xlim=(overlay.x[0], overlay.x[-1]))
        ax.set_yscale("log")
        ax.set_ylim(self.ends)
        if overlay.kind == "spectrum":
            ax.set_xscale("log")
            plain_log_ticks(ax)
        ax.grid(axis="y", alpha=0.3, linewidth=0.6)
        legend_above(ax, ncols=3)


_GRR_FLOOR = -100.0  # percent: smaller values are drawn there and stated in words


class GapReductionDisplay(PlainDisplay):
    """Display of the share of the gap that each alternative closes on recordings held out.

    Drawing raises ``ValueError`` if no share is defined.

    Parameters
    ----------
    comparison : sequence of cyclofeat.gap.proof.prove.ProofRow

    Attributes
    ----------
    drawn_ : list of tuple
        ``(alternative, condition, percent)`` as drawn.

    Examples
    --------
    >>> from cyclofeat.gap.proof.prove import ProofRow
    >>> rows = [ProofRow("after", "all", 0.9, 0.8, 0.95), ProofRow("nothing", "all", 0.0, 0.0, 0.0)]
    >>> GapReductionDisplay(rows).plot().drawn_
    [('after', 'all', 90.0), ('nothing', 'all', 0.0)]
    """

    drawn_: list[tuple[str, str, float]]

    def __init__(self, comparison: Sequence[ProofRow]) -> None:
        self.comparison = tuple(comparison)
        n_alternatives = len(dict.fromkeys(row.alternative for row in self.comparison))
        n_conditions = len({row.condition for row in self.comparison})
        self.size = (4.7, 1.2 + 0.5 * n_alternatives + 0.25 * n_conditions)

    def _draw(self, ax: Axes) -> None:
        rows = [row for row in self.comparison if np.isfinite(row.grr)]
        if not rows:
            raise ValueError("comparison must hold a row with a finite grr to be drawn, got none")
        names = list(dict.fromkeys(row.alternative for row in rows))
        styles = {"all": ("o", "C0", 0.0), "seen": ("s", "C2", 0.22), "unseen": ("D", "C1", 0.44)}
        conditions = [name for name in styles if any(row.condition == name for row in rows)]
        centre = np.mean([styles[name][2] for name in conditions])
        self.drawn_ = []
        grey = theme_colours()[1]
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
        ends = 100 * np.array([(row.low, row.grr, row.high) for row in rows])
        finite = ends[np.isfinite(ends)]
        least, most = min(-12.0, finite.min()), max(105.0, finite.max())
        ax.set(
            xlabel="share of the gap closed, recordings held out (%)",
            xlim=(max(least - 5, _GRR_FLOOR - 8), most + 7),
            ylim=(len(names) - 0.5, -0.5),
        )
        if len(conditions) > 1:
            marks = [(*styles[name][:2], styles[name][1], COUNT_GROUPS[name]) for name in conditions]
            draw_mark_legend(ax, marks)
