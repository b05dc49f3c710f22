"""Displays of a gap: differences, recordings over model and corrected model, and the share that closes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np

from cyclofeat._base.gap_words import (
    COUNT_GROUPS,
    alternative_name,
    difference_words,
    family_name,
    p_words,
    row_words,
    short_name,
)
from cyclofeat.plotting.drawing import (
    Display,
    Float,
    PlainDisplay,
    axes_for,
    draw_mark_legend,
    legend_above,
    plain_log_ticks,
    theme_colours,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from cyclofeat.gap.overlays import Overlay
    from cyclofeat.gap.proof.prove import ProofRow
    from cyclofeat.gap.where.locate import Where, WhereRow

Kind = Literal["families", "spectrum", "orders", "lobe phase", "input phase"]

# Three roles, told apart by the colour-blind too: recordings, what is flagged, and the model in grey. The
# colours are the first two of the cycle and that of the ticks, so that a theme may change them.
RECORDED, FLAGGED, _SHADE = "C0", "C1", 0.22
_LEAST_SPREADS = 0.1  # left end of the overview's axis
_OTHER_SPREAD = "varies more or less than the model"
_N_WORDS = 4  # differences that a picture states in words

_PHASES = {
    "lobe phase": ("passages of all lobes", "phase of the lobes' passage (1: all lobes have passed once)"),
    "input phase": ("input turns", "phase of the input turn (1: one turn)"),
}


class GapDisplay(Display):
    """Display of the differences between recordings and simulator.

    Parameters
    ----------
    where : cyclofeat.gap.Where
        Comparison of recordings with a model at one condition: one of ``where`` of a result.
    label : str, default="recordings"
        Name of the recordings, such as ``"measured"``.

    Attributes
    ----------
    ax_ : matplotlib.axes.Axes
        Axes drawn on; those of kinds with two panels are switched off and hold the panels.
    axes_ : list of matplotlib.axes.Axes
        The panels, from the top.
    flags_ : list of matplotlib.artist.Artist
        One for each cell, family or phase that is drawn as flagged.
    spread_flags_ : list of matplotlib.artist.Artist
        One for each cell whose spread between recordings is drawn as flagged.

    Notes
    -----
    ``"families"``: largest difference of each family, in standard deviations of one recording.
    ``"spectrum"``: mean levels in third octaves, bands of one recording's spread, flagged bands shaded;
    below, the differences with intervals that hold for all bands at once. ``"orders"``: differences of the
    lines of lobes and input shaft, likewise. ``"lobe phase"`` and ``"input phase"``: torque folded over the
    passage of all lobes or the turn of the input shaft.

    Examples
    --------
    >>> GapDisplay(result.where[1]).plot("orders").figure_.savefig("orders.png")  # doctest: +SKIP
    """

    SIZES: ClassVar[dict[Kind, tuple[float, float]]] = {
        "families": (4.7, 6.0), "spectrum": (8.0, 5.2), "orders": (8.0, 3.8), "lobe phase": (8.0, 4.8),
        "input phase": (8.0, 4.8),
    }  # fmt: skip

    axes_: list[Axes]
    flags_: list[Artist]
    spread_flags_: list[Artist]

    def __init__(self, where: Where, *, label: str = "recordings") -> None:
        self.where = where
        self.label = str(label)

    @property
    def kinds(self) -> list[Kind]:
        """Kinds of which the comparison holds something to draw."""
        families = {row.cell.family for row in self.where.rows}
        held = {"families", *(f"{name} phase" for name in self.where.phase)} if families else set()
        held |= {"spectrum"} & families
        held |= {"orders"} if {"lobe lines", "shaft lines"} & families else set()
        return [kind for kind in self.SIZES if kind in held]

    def plot(self, kind: Kind = "spectrum", ax: Axes | None = None) -> Self:
        """Draw.

        Parameters
        ----------
        kind : {"spectrum", "orders", "lobe phase", "input phase", "families"}, default="spectrum"
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.

        Returns
        -------
        self : GapDisplay

        Raises
        ------
        ValueError
            If there is no such kind, or nothing of it was compared.
        """
        if kind not in self.kinds:
            compared = ", ".join(map(repr, self.kinds)) or "nothing"
            raise ValueError(f"kind must be among what was compared: {compared}, got {kind!r}")
        self.figure_, self.ax_ = axes_for(ax, self.SIZES[kind])
        self.axes_, self.flags_, self.spread_flags_ = [self.ax_], [], []
        if kind == "families":
            self._draw_families()
        elif kind == "spectrum":
            self._draw_spectrum()
        elif kind == "orders":
            self._draw_orders()
        else:
            self._draw_phase(kind)
        return self

    def _draw_families(self) -> None:
        ax, (ink, edge) = self.ax_, theme_colours()
        names = list(dict.fromkeys(row.cell.family for row in self.where.rows))
        ends = []
        for place, family in enumerate(names):
            rows = [row for row in self.where.rows if row.cell.family == family]
            row = max(rows, key=lambda row: row.clarity)
            # Differences of spreads, too, are placed by how clear they are.
            least = max(
                (r.detectable / r.spread for r in rows if r.of == "mean" and r.spread > 0), default=1.0
            )
            flagged = self.where.family_p.get(family, row.p) <= self.where.alpha
            colour = FLAGGED if flagged else edge
            at = max(row.clarity * least, _LEAST_SPREADS)
            ends += [at, least]
            ax.hlines(place, _LEAST_SPREADS, at, color=colour, linewidth=3 if flagged else 1.5, alpha=0.7)
            (dot,) = ax.plot(
                at, place, "o", color=colour, markersize=9 if flagged else 7,
                markerfacecolor=colour if flagged else "none", zorder=3,
            )  # fmt: skip
            if flagged:
                self.flags_.append(dot)
            ax.plot(max(least, _LEAST_SPREADS), place, "|", color=ink, markersize=9, zorder=4)
            p = p_words(self.where.family_p[family]) if family in self.where.family_p else ""
            # Words above the bars, not beside them, leave a picture narrow enough for a phone.
            texts = (
                (0.0, 0.44, "left", family_name(family)), (1.0, 0.44, "right", p),
                (0.0, 0.16, "left", row_words(row)),
            )  # fmt: skip
            for x, above, align, text in texts:
                ax.text(
                    x, place - above, text, va="bottom", ha=align, transform=ax.get_yaxis_transform(),
                    fontsize="small", fontweight="bold" if flagged and above > 0.3 else "normal",
                    color=ink, alpha=1.0 if flagged else 0.75,
                )  # fmt: skip
        ax.set_yticks([])
        ax.set(
            xscale="log",
            xlim=(_LEAST_SPREADS, max(2.5 * max(ends), 10)),
            ylim=(len(names) - 0.7, -0.8),
            xlabel=f"{self.label} against model (1 = std of one recording)",
        )
        plain_log_ticks(ax)
        ax.spines[["top", "left", "right"]].set_visible(False)
        draw_mark_legend(
            ax, [
                ("o", FLAGGED, FLAGGED, f"differs (p at most {self.where.alpha:g})"),
                ("o", edge, "none", "no difference shown"),
                ("|", ink, "none", "smallest difference found with a chance of 80 %"),
            ], x=-0.03,
        )  # fmt: skip

    def _draw_spectrum(self) -> None:
        rows = self.where.means("spectrum")
        edges: Float = np.array([(row.cell.low_hz, row.cell.high_hz) for row in rows])
        hz: Float = np.sqrt(edges.prod(axis=1))
        level: Float = np.array([row.mean for row in rows])
        spreads: Float = np.array([(row.measured_spread, row.simulated_spread) for row in rows])
        flagged = np.array([row.p <= self.where.alpha for row in rows])
        simulated = level - np.array([row.difference for row in rows])
        upper, lower = self._draw_panels(0.54, hz, (level, simulated), spreads.T, edges[flagged])
        for ax in (upper, lower):
            ax.set(xscale="log", xlim=(edges[0, 0], edges[-1, 1]))
        self._draw_differences(lower, hz, rows, "o", theme_colours()[1])
        self._mark_spreads(lower, hz, rows)
        self._label_clearest(upper, hz, rows, runs=True)
        plain_log_ticks(lower)
        upper.set_ylabel("level in the third octave\n(dB re 1 Nm²)")
        lower.set(xlabel="frequency (Hz)", ylabel=f"{self.label} minus\nmodel (dB)")
        upper.tick_params(labelbottom=False, which="both")
        self._draw_panel_legend(upper)

    def _draw_orders(self) -> None:
        ax, rows = self.ax_, self.where.means("lobe lines", "shaft lines")
        orders: Float = np.array(
            [(row.cell.low_hz + row.cell.high_hz) / 2 / (self.where.condition.speed_rpm / 60) for row in rows]
        )
        ax.axhline(0, color=theme_colours()[1], linewidth=1)
        marks = []
        looks = {"lobe lines": ("o", "C0", "of the lobes"), "shaft lines": ("s", "C2", "of the input shaft")}
        for family, (marker, colour, name) in looks.items():
            chosen = [k for k, row in enumerate(rows) if row.cell.family == family]
            if chosen:
                chosen_rows = [rows[k] for k in chosen]
                self.flags_ += self._draw_differences(ax, orders[chosen], chosen_rows, marker, colour)
                marks.append((marker, colour, "none", f"line {name}"))
        if self.flags_:
            marks.append(("D", FLAGGED, FLAGGED, f"filled: differs (p at most {self.where.alpha:g})"))
        self._mark_spreads(ax, orders, rows)
        if self.spread_flags_:
            marks.append(("^", FLAGGED, "none", _OTHER_SPREAD))
        ax.grid(axis="y", alpha=0.3, linewidth=0.6)
        ax.set(
            xlabel="order (multiples of the input speed)",
            ylabel=f"{self.label} minus model:\nline above its surroundings (dB)",
            xlim=(0, orders.max() + 1),
        )
        self._label_clearest(ax, orders, rows, runs=False)
        draw_mark_legend(ax, marks, ncols=3)

    def _draw_phase(self, kind: str) -> None:
        fold = self.where.phase[kind.removesuffix(" phase")]
        phase, measured, simulated = (
            np.asarray(values, dtype=np.float64) for values in (fold.phase, fold.measured, fold.simulated)
        )
        half = 0.5 / phase.size
        flagged = phase[np.asarray(fold.flagged, dtype=bool)]
        spreads = (fold.measured_spread, fold.simulated_spread)
        bands = np.column_stack([flagged - half, flagged + half])
        upper, lower = self._draw_panels(0.6, phase, (measured, simulated), spreads, bands)
        lower.plot(phase, measured - simulated, color=theme_colours()[0], linewidth=1.3)
        reach = 1.15 * max(float(np.abs(measured - simulated).max()), 1e-9)
        name, xlabel = _PHASES[kind]
        for ax in (upper, lower):
            ax.set_xlim(phase[0] - half, phase[-1] + half)
        lower.set(xlabel=xlabel, ylabel=f"{self.label} minus\nmodel (Nm)", ylim=(-reach, reach))
        upper.set_ylabel(f"torque averaged\nover {name} (Nm)")
        upper.tick_params(labelbottom=False)
        self._draw_panel_legend(upper)

    def _draw_panels(
        self, share: float, x: Float, curves: Sequence[Float], spreads: Sequence[Float] | Float, bands: Float
    ) -> list[Axes]:
        """Draw recordings and model in the upper panel, and shade the bands that differ in both panels.

        Curves and the standard deviations of one recording are those of recordings and model; ``share`` is
        that of the upper panel in the height.
        """
        self.ax_.set_axis_off()
        upper = self.ax_.inset_axes((0, 1 - share, 1, share))
        lower = self.ax_.inset_axes((0, 0, 1, 1 - share - 0.05), sharex=upper)
        self.axes_ = [upper, lower]
        ink, edge = theme_colours()
        looks = (("model", ink, "--", 1.3, 0.15), (self.label, RECORDED, "-", 1.8, 0.25))
        for (name, colour, style, width, alpha), middle, spread in zip(
            looks, curves[::-1], spreads[::-1], strict=True
        ):
            upper.fill_between(x, middle - spread, middle + spread, color=colour, alpha=alpha, linewidth=0)
            upper.plot(x, middle, style, color=colour, linewidth=width, label=f"{name} ± 1 std")
        for low, high in bands.tolist():
            shades = [
                ax.axvspan(low, high, color=FLAGGED, alpha=_SHADE, linewidth=0, zorder=0) for ax in self.axes_
            ]
            self.flags_.append(shades[0])
        lower.axhline(0, color=edge, linewidth=1)
        for ax in self.axes_:
            ax.grid(axis="y", alpha=0.3, linewidth=0.6)
        return self.axes_

    def _draw_panel_legend(self, ax: Axes) -> None:
        from matplotlib.patches import Patch

        handles = ax.get_legend_handles_labels()[0]
        if self.flags_:
            text = f"differs (p at most {self.where.alpha:g})"
            handles.append(Patch(color=FLAGGED, alpha=_SHADE, linewidth=0, label=text))
        marks = [("^", FLAGGED, "none", _OTHER_SPREAD)] if self.spread_flags_ else []
        draw_mark_legend(ax, marks, handles, ncols=3)

    def _draw_differences(
        self, ax: Axes, x: Float, rows: Sequence[WhereRow], marker: str, colour: str
    ) -> list[Artist]:
        """Draw differences with their intervals, and return those that are filled in the colour of flags."""
        flags: list[Artist] = []
        for place, row in zip(x.tolist(), rows, strict=True):
            flagged = row.p <= self.where.alpha
            shown = FLAGGED if flagged else colour
            ax.vlines(place, row.low, row.high, color=shown, linewidth=1.5 if flagged else 0.8,
                      alpha=1.0 if flagged else 0.6, zorder=2)  # fmt: skip
            dots = ax.plot(
                place, row.difference, marker, color=shown, markersize=6 if flagged else 4,
                markerfacecolor=shown if flagged else "none", zorder=4 if flagged else 3,
            )  # fmt: skip
            flags += dots if flagged else []
        return flags

    def _mark_spreads(self, ax: Axes, x: Float, rows: Sequence[WhereRow]) -> None:
        """Draw triangles on the ground where recordings vary more, or less, than simulated ones."""
        flagged = {row.cell for row in self.where.rows if row.of == "spread" and row.p <= self.where.alpha}
        look: dict[str, Any] = {"color": FLAGGED, "markerfacecolor": "none", "zorder": 5}
        for place, row in zip(x.tolist(), rows, strict=True):
            if row.cell in flagged:
                self.spread_flags_ += ax.plot(place, 0.05, "^", transform=ax.get_xaxis_transform(), **look)

    def _label_clearest(self, ax: Axes, x: Float, rows: Sequence[WhereRow], *, runs: bool) -> None:
        """State the clearest flagged differences; with ``runs``, one per run of neighbours of one sign."""
        groups: list[list[int]] = []
        for k, row in enumerate(rows):
            if row.p > self.where.alpha:
                continue
            if runs and groups and groups[-1][-1] == k - 1 and row.difference * rows[k - 1].difference > 0:
                groups[-1].append(k)
            else:
                groups.append([k])
        largest = [max(group, key=lambda k: abs(rows[k].difference)) for group in groups]
        chosen = sorted(largest, key=lambda k: -rows[k].clarity)[:_N_WORDS]
        low, high = ax.get_ylim()
        if chosen:
            # Room for the words above all that is drawn, a row for each so that none covers another.
            step = 0.09
            ax.set_ylim(low, high + (high - low) * step * (len(chosen) + 0.3))
        # From the outside in and from the top down: hardly a line to a point crosses another one's words.
        middle = float(np.quantile(x, 0.6))
        left, right = [k for k in chosen if x[k] <= middle], [k for k in chosen if x[k] > middle]
        ordered = [*sorted(left, key=lambda k: x[k]), *sorted(right, key=lambda k: -x[k])]
        for line, k in enumerate(ordered):
            shift, align = (-4, "right") if x[k] > middle else (4, "left")
            ax.annotate(
                f"{short_name(rows[k].cell)}: {difference_words(rows[k])}", (x[k], 0.98 - 0.085 * line),
                xycoords=ax.get_xaxis_transform(), xytext=(shift, 0), textcoords="offset points",
                ha=align, va="top", fontsize="small", zorder=6,
            )  # fmt: skip
            ax.axvline(x[k], 0, 0.98 - 0.085 * line, color=FLAGGED, linewidth=0.8, linestyle=":", zorder=1)


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
            ("corrected model", overlay.corrected, "C2", "-", 1.0, 0.20),
        )
        for name, band, colour, style, width, alpha in curves:
            if band is None:
                continue
            ax.fill_between(overlay.x, band.low, band.high, color=colour, alpha=alpha, linewidth=0)
            ax.plot(overlay.x, band.mean, style, color=colour, linewidth=width, label=name)
        xlabel, ylabel = _LABELS[overlay.kind]
        x_ends = (overlay.x[0], overlay.x[-1])
        ax.set(xlabel=xlabel, ylabel=ylabel, xlim=x_ends, yscale="log", ylim=self.ends)
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
