"""Where recordings and simulator differ."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat.plotting._base import Float, axes_for, plain_log_ticks
from cyclofeat.plotting._gap_words import (
    clarity,
    difference_words,
    family_name,
    in_words,
    p_words,
    short_name,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from cyclofeat.gap import Cell, GapLocator, Row
    from cyclofeat.gap._phase import PhaseMap

Kind = Literal["families", "spectrum", "orders", "phase"]
KINDS: tuple[Kind, ...] = ("families", "spectrum", "orders", "phase")

# Three roles, told apart by the colour-blind too: recordings, what is flagged, and the model in grey. The
# colours are the first two of the cycle and that of the ticks, so that a theme may change them.
RECORDED, FLAGGED, _SHADE = "C0", "C1", 0.22
SIZES: dict[Kind, tuple[float, float]] = {
    "families": (8.0, 4.6), "spectrum": (8.0, 5.2), "orders": (8.0, 3.8), "phase": (8.0, 4.8),
}  # fmt: skip
_LEAST_SPREADS = 0.1  # left end of the overview's axis
_OTHER_SPREAD = "varies more, or less, than simulated"
_N_WORDS = 4  # differences that a picture tells in words

_PHASES = {
    "lobe": ("passages of all lobes", "phase of the lobes' passage (1: all lobes have passed once)"),
    "input": ("input turns", "phase of the input turn (1: one turn)"),
}


class GapDisplay:
    """Where recordings and simulator differ.

    Parameters
    ----------
    table : sequence of cyclofeat.gap.Row
        Cells, their differences, intervals and p.
    mean : array-like, shape (n_cells,)
        Mean of the recordings in each cell of ``table``.
    spread, simulated_spread : array-like, shape (n_cells,)
        Standard deviation of one recording, and of one simulated recording.
    family_p : mapping from str to float
        Adjusted p of each family.
    phase : mapping from str to PhaseMap, optional
        Folded torque by ``"lobe"`` and by ``"input"``.
    alpha : float, default=0.05
        Adjusted p up to which a cell is flagged.
    input_speed_hz : float, default=500 / 60
        Nominal input speed at which the cells' frequencies are stated.
    label : str, default="measured"
        What the recordings are called; give ``"surrogate"`` or the like where nothing was measured.

    Attributes
    ----------
    ax_ : matplotlib.axes.Axes
        Axes drawn on; those of kinds with two panels are switched off and hold the panels.
    axes_ : list of matplotlib.axes.Axes
        The panels, from the top.
    figure_ : matplotlib.figure.Figure
    flags_ : list of matplotlib.artist.Artist
        One for each cell, family or phase that is drawn as flagged.
    spread_flags_ : list of matplotlib.artist.Artist
        One for each cell whose spread between recordings is drawn as flagged.

    Notes
    -----
    ``"families"``: largest difference of each family, in standard deviations of one recording.
    ``"spectrum"``: mean levels in third octaves, bands of one recording's spread, flagged bands shaded;
    below, the differences with intervals that hold for all bands at once. ``"orders"``: differences of the
    lines of lobes and input shaft, likewise. ``"phase"``: torque folded over input turns or lobes.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.gap import GapLocator
    >>> from cyclofeat.plotting import GapDisplay
    >>> time = np.arange(11_520) / 6400
    >>> X = 22 + 0.3 * np.sin(2 * np.pi * 50 * time) + np.random.default_rng(0).normal(0, 0.05, (3, 11_520))
    >>> locator = GapLocator(6400, n_bank=10, n_permutations=499).fit(X, y=[0, 0, 0])
    >>> display = GapDisplay.from_locator(locator, kind="spectrum")  # doctest: +SKIP
    >>> display.plot(kind="orders").figure_.savefig("orders.png")  # doctest: +SKIP
    """

    ax_: Axes
    axes_: list[Axes]
    figure_: Figure | SubFigure
    flags_: list[Artist]
    spread_flags_: list[Artist]

    def __init__(
        self,
        *,
        table: Sequence[Row],
        mean: ArrayLike,
        spread: ArrayLike,
        simulated_spread: ArrayLike,
        family_p: Mapping[str, float],
        phase: Mapping[str, PhaseMap] | None = None,
        alpha: float = 0.05,
        input_speed_hz: float = 500 / 60,
        label: str = "measured",
    ) -> None:
        self.table = list(table)
        n = len(self.table)
        self.mean = _of_length("mean", mean, n)
        self.spread = _of_length("spread", spread, n)
        self.simulated_spread = _of_length("simulated_spread", simulated_spread, n)
        self.family_p = dict(family_p)
        self.phase = dict(phase or {})
        self.alpha = float(alpha)
        self.input_speed_hz = float(input_speed_hz)
        self.label = str(label)

    @classmethod
    def of_locator(cls, locator: GapLocator, *, label: str = "measured") -> Self:
        """Display of a fitted locator, not drawn yet.

        Parameters
        ----------
        locator : cyclofeat.gap.GapLocator
            Fitted.
        label : str, default="measured"
            What the recordings are called.
        """
        columns = {cell: k for k, cell in enumerate(_keys(locator.cells_))}
        # The test of all cells together is no cell.
        table = [row for row in locator.table_ if _keys([row.cell])[0] in columns]
        at = [columns[key] for key in _keys([row.cell for row in table])]
        # Spread about the mean of the own count of worn lobes, which is no spread of recordings.
        measured = locator.centred(locator.measured_, locator.counts_)[:, at]
        simulated = locator.centred(locator.simulated_, locator.bank_.counts)[:, at]
        return cls(
            table=table,
            mean=locator.measured_[:, at].mean(axis=0),
            spread=measured.std(axis=0, ddof=1),
            simulated_spread=simulated.std(axis=0, ddof=1),
            family_p=locator.family_p_,
            phase=getattr(locator, "phase_", None),
            alpha=locator.alpha,
            input_speed_hz=locator.input_speed_hz,
            label=label,
        )

    @classmethod
    def from_locator(
        cls,
        locator: GapLocator,
        kind: Kind = "spectrum",
        ax: Axes | None = None,
        *,
        phase: str = "lobe",
        label: str = "measured",
    ) -> Self:
        """Draw what a fitted locator has found.

        Parameters
        ----------
        locator : cyclofeat.gap.GapLocator
            Fitted.
        kind, ax, phase
            As in :meth:`plot`.
        label : str, default="measured"
            What the recordings are called; give ``"surrogate"`` or the like where nothing was measured.

        Returns
        -------
        GapDisplay
        """
        return cls.of_locator(locator, label=label).plot(kind=kind, ax=ax, phase=phase)

    def plot(self, kind: Kind = "spectrum", ax: Axes | None = None, *, phase: str = "lobe") -> Self:
        """Draw.

        Parameters
        ----------
        kind : {"spectrum", "orders", "phase", "families"}, default="spectrum"
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        phase : {"lobe", "input"}, default="lobe"
            What the torque of ``kind="phase"`` is folded over.

        Returns
        -------
        self

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If there is no such kind or phase, or the locator has nothing of that kind.
        """
        draw: dict[str, Callable[[], None]] = {
            "families": self._families,
            "spectrum": self._spectrum,
            "orders": self._orders,
            "phase": lambda: self._phase(phase),
        }
        if kind not in draw:
            raise ValueError(f"kind must be one of {KINDS}, got {kind!r}")
        if not self.has(kind, phase):
            there = [name for name in KINDS if any(self.has(name, by) for by in _PHASES)]
            what = f"kind='phase' with phase={phase!r}" if kind == "phase" else f"kind={kind!r}"
            raise ValueError(f"{what} is not in what was compared; there is {', '.join(there) or 'nothing'}")
        self.figure_, self.ax_ = axes_for(ax, SIZES[kind])
        self.axes_, self.flags_, self.spread_flags_ = [self.ax_], [], []
        draw[kind]()
        return self

    def has(self, kind: Kind, phase: str = "lobe") -> bool:
        """Whether there is something of that kind to draw."""
        families = {row.cell.family for row in self.table}
        if kind == "phase":
            return phase in self.phase
        if kind == "orders":
            return bool({"lobe lines", "shaft lines"} & families)
        return bool(self.table) if kind == "families" else "spectrum" in families

    def _of(self, *families: str) -> NDArray[np.intp]:
        """Places of the families' means."""
        return np.array(
            [k for k, row in enumerate(self.table) if row.cell.family in families and row.of == "mean"],
            dtype=np.intp,
        )

    def _with_other_spread(self, rows: Sequence[Row]) -> list[int]:
        """Places in ``rows`` of the cells whose spread between recordings is flagged."""
        flagged = {
            key
            for key, row in zip(_keys([row.cell for row in self.table]), self.table, strict=True)
            if row.of == "spread" and row.p <= self.alpha
        }
        return [k for k, key in enumerate(_keys([row.cell for row in rows])) if key in flagged]

    # -- overview

    def _families(self) -> None:
        from matplotlib import rcParams

        ax = self.ax_
        names = list(dict.fromkeys(row.cell.family for row in self.table))
        ends = []
        for place, family in enumerate(names):
            rows = [row for row in self.table if row.cell.family == family]
            row = max(rows, key=clarity)
            # Differences of spreads, too, are placed by how clear they are.
            least = max(
                (r.detectable / r.spread for r in rows if r.of == "mean" and r.spread > 0), default=1.0
            )
            size, p = clarity(row) * least, self.family_p.get(family, row.p)
            flagged = p <= self.alpha
            colour = FLAGGED if flagged else rcParams["axes.edgecolor"]
            at = max(size, _LEAST_SPREADS)
            ends.append(at)
            ax.hlines(place, _LEAST_SPREADS, at, color=colour, linewidth=3 if flagged else 1.5, alpha=0.7)
            (dot,) = ax.plot(
                at, place, "o", color=colour, markersize=9 if flagged else 7,
                markerfacecolor=colour if flagged else "none", zorder=3,
            )  # fmt: skip
            if flagged:
                self.flags_.append(dot)
            ends.append(least)
            ax.plot(
                max(least, _LEAST_SPREADS), place, "|", color=rcParams["text.color"], markersize=9, zorder=4
            )
            ax.text(
                _LEAST_SPREADS * 1.05, place - 0.17, in_words(row), va="bottom", fontsize="small",
                color=rcParams["text.color"], alpha=1.0 if flagged else 0.75,
            )  # fmt: skip
        ax.set_yticks(range(len(names)), [family_name(name) for name in names])
        ax.set(
            xscale="log",
            xlim=(_LEAST_SPREADS, max(2.5 * max(ends), 10)),
            ylim=(len(names) - 0.4, -0.75),
            xlabel=f"largest difference, {self.label} against simulated (1 = std of one recording)",
        )
        plain_log_ticks(ax)
        right = ax.secondary_yaxis("right")
        right.set_yticks(
            range(len(names)),
            [p_words(self.family_p[name]) if name in self.family_p else "" for name in names],
        )
        for name, text in zip(names, right.get_yticklabels(), strict=True):
            if self.family_p.get(name, 1.0) <= self.alpha:
                text.set_fontweight("bold")
        for axis in (ax.yaxis, right.yaxis):
            axis.set_tick_params(length=0)
        for side in ("top", "right", "left"):
            ax.spines[side].set_visible(False)
        right.spines["right"].set_visible(False)
        self._legend(
            ax, [
                ("o", FLAGGED, FLAGGED, f"differs (p at most {self.alpha:g})"),
                ("o", rcParams["axes.edgecolor"], "none", "no difference shown"),
                ("|", rcParams["text.color"], "none", "least that would most likely (80 %) be found"),
            ], loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=3,
        )  # fmt: skip

    # -- spectrum

    def _spectrum(self) -> None:
        from matplotlib import rcParams

        at = self._of("spectrum")
        rows = [self.table[k] for k in at]
        hz: Float = np.array([np.sqrt(row.cell.low_hz * row.cell.high_hz) for row in rows])
        effects: Float = np.array([row.effect for row in rows])
        upper, lower = self._panels(0.54)
        level = self.mean[at]
        self._two_lines(upper, hz, level, level - effects, self.spread[at], self.simulated_spread[at])
        for row in rows:
            if row.p <= self.alpha:
                self.flags_.append(self._shade(upper, row.cell.low_hz, row.cell.high_hz))
                self._shade(lower, row.cell.low_hz, row.cell.high_hz)
        lower.axhline(0, color=rcParams["axes.edgecolor"], linewidth=1)
        self._differences(lower, hz, rows, "o", rcParams["axes.edgecolor"])
        self._mark_spreads(lower, hz[self._with_other_spread(rows)])
        self._tell(upper, hz, rows, runs=True)
        for ax in (upper, lower):
            ax.set(xscale="log", xlim=(rows[0].cell.low_hz, rows[-1].cell.high_hz))
            ax.grid(axis="y", alpha=0.3, linewidth=0.6)
        plain_log_ticks(lower)
        upper.set_ylabel("level in the third octave\n(dB re 1 Nm²)")
        lower.set(xlabel="frequency (Hz)", ylabel=f"{self.label} minus\nsimulated (dB)")
        upper.tick_params(labelbottom=False, which="both")
        self._spectrum_legend(upper)

    def _spectrum_legend(self, ax: Axes) -> None:
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        handles, labels = ax.get_legend_handles_labels()
        if self.flags_:
            handles.append(Patch(color=FLAGGED, alpha=_SHADE, linewidth=0))
            labels.append(f"differs (p at most {self.alpha:g})")
        if self.spread_flags_:
            handles.append(Line2D([], [], linestyle="", marker="^", color=FLAGGED, markerfacecolor="none"))
            labels.append(_OTHER_SPREAD)
        ax.legend(
            handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize="small",
            frameon=False, borderaxespad=0.2,
        )  # fmt: skip

    # -- lines

    def _orders(self) -> None:
        from matplotlib import rcParams

        ax, at = self.ax_, self._of("lobe lines", "shaft lines")
        rows = [self.table[k] for k in at]
        orders: Float = np.array(
            [(row.cell.low_hz + row.cell.high_hz) / 2 / self.input_speed_hz for row in rows]
        )
        shaft = np.array([row.cell.family == "shaft lines" for row in rows])
        ax.axhline(0, color=rcParams["axes.edgecolor"], linewidth=1)
        marks = []
        for of_shaft, marker, colour, name in ((False, "o", "C0", "line of the lobes"),
                                               (True, "s", "C2", "line of the input shaft")):  # fmt: skip
            chosen = np.flatnonzero(shaft == of_shaft)
            if chosen.size:
                self._differences(ax, orders[chosen], [rows[k] for k in chosen], marker, colour, collect=True)
                marks.append((marker, colour, "none", name))
        if self.flags_:
            marks.append(("D", FLAGGED, FLAGGED, f"filled: differs (p at most {self.alpha:g})"))
        if self.spread_flags_:
            marks.append(("^", FLAGGED, "none", _OTHER_SPREAD))
        self._mark_spreads(ax, orders[self._with_other_spread(rows)])
        ax.grid(axis="y", alpha=0.3, linewidth=0.6)
        ax.set(
            xlabel="order (multiples of the input speed)",
            ylabel=f"{self.label} minus simulated:\nline above its surroundings (dB)",
            xlim=(0, orders.max() + 1),
        )
        self._tell(ax, orders, rows, runs=False)
        self._legend(ax, marks, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)

    # -- phase

    def _phase(self, by: str) -> None:
        from matplotlib import rcParams

        fold = self.phase[by]
        phase = np.asarray(fold.phase, dtype=np.float64)
        half = 0.5 / phase.size
        measured, simulated = (
            np.asarray(values, dtype=np.float64) for values in (fold.measured, fold.simulated)
        )
        upper, lower = self._panels(0.6)
        self._two_lines(upper, phase, measured, simulated, fold.measured_spread, fold.simulated_spread)
        for place in phase[np.asarray(fold.flagged, dtype=bool)]:
            self.flags_.append(self._shade(upper, place - half, place + half))
            self._shade(lower, place - half, place + half)
        lower.axhline(0, color=rcParams["axes.edgecolor"], linewidth=1)
        lower.plot(phase, measured - simulated, color=rcParams["text.color"], linewidth=1.3)
        reach = 1.15 * max(float(np.abs(measured - simulated).max()), 1e-9)
        name, xlabel = _PHASES[by]
        for ax in (upper, lower):
            ax.set_xlim(phase[0] - half, phase[-1] + half)
            ax.grid(axis="y", alpha=0.3, linewidth=0.6)
        lower.set(xlabel=xlabel, ylabel=f"{self.label} minus\nsimulated (Nm)", ylim=(-reach, reach))
        upper.set_ylabel(f"torque averaged\nover {name} (Nm)")
        upper.tick_params(labelbottom=False)
        self._spectrum_legend(upper)

    # -- parts

    def _panels(self, share: float) -> list[Axes]:
        """Two panels within the axes, the upper one with that share of the height."""
        self.ax_.set_axis_off()
        gap = 0.05
        upper = self.ax_.inset_axes((0, 1 - share, 1, share))
        lower = self.ax_.inset_axes((0, 0, 1, 1 - share - gap), sharex=upper)
        self.axes_ = [upper, lower]
        return self.axes_

    def _two_lines(
        self, ax: Axes, x: Float, measured: Float, simulated: Float, spread: Float, simulated_spread: Float
    ) -> None:
        from matplotlib import rcParams

        model = rcParams["text.color"]
        ax.fill_between(
            x,
            simulated - simulated_spread,
            simulated + simulated_spread,
            color=model,
            alpha=0.15,
            linewidth=0,
        )
        ax.fill_between(x, measured - spread, measured + spread, color=RECORDED, alpha=0.25, linewidth=0)
        ax.plot(x, simulated, "--", color=model, linewidth=1.3, label="simulated, with standard deviation")
        ax.plot(x, measured, color=RECORDED, linewidth=1.8, label=f"{self.label}, likewise")

    def _shade(self, ax: Axes, low: float, high: float) -> Artist:
        return ax.axvspan(low, high, color=FLAGGED, alpha=_SHADE, linewidth=0, zorder=0)

    def _differences(
        self, ax: Axes, x: Float, rows: Sequence[Row], marker: str, colour: str, *, collect: bool = False
    ) -> None:
        """Differences with their intervals: hollow, or filled in the colour of flags."""
        for place, row in zip(x.tolist(), rows, strict=True):
            flagged = row.p <= self.alpha
            shown = FLAGGED if flagged else colour
            ax.vlines(place, row.low, row.high, color=shown, linewidth=1.5 if flagged else 0.8,
                      alpha=1.0 if flagged else 0.6, zorder=2)  # fmt: skip
            (dot,) = ax.plot(
                place, row.effect, marker, color=shown, markersize=6 if flagged else 4,
                markerfacecolor=shown if flagged else "none", zorder=4 if flagged else 3,
            )  # fmt: skip
            if flagged and collect:
                self.flags_.append(dot)

    def _mark_spreads(self, ax: Axes, x: Float) -> None:
        """Triangles on the ground where recordings vary more, or less, than simulated ones."""
        for place in x.tolist():
            (mark,) = ax.plot(
                place, 0.05, "^", color=FLAGGED, markerfacecolor="none", transform=ax.get_xaxis_transform(),
                zorder=5,
            )  # fmt: skip
            self.spread_flags_.append(mark)

    def _tell(self, ax: Axes, x: Float, rows: Sequence[Row], *, runs: bool) -> None:
        """Say the clearest flagged differences in words; with ``runs``, one of neighbours of one sign."""
        chosen, run = [], []  # type: list[int], list[int]
        flagged = [row.p <= self.alpha for row in rows]
        for k, row in enumerate(rows):
            continues = bool(run) and runs and run[-1] == k - 1 and row.effect * rows[run[-1]].effect > 0
            if flagged[k] and not continues and run:
                chosen.append(max(run, key=lambda j: abs(rows[j].effect)))
                run = []
            if flagged[k]:
                run.append(k)
        if run:
            chosen.append(max(run, key=lambda j: abs(rows[j].effect)))
        chosen = sorted(chosen, key=lambda k: -clarity(rows[k]))[:_N_WORDS]
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
            to_the_right = x[k] > middle
            ax.annotate(
                f"{short_name(rows[k].cell)}: {difference_words(rows[k])}",
                (x[k], 0.98 - 0.085 * line),
                xycoords=ax.get_xaxis_transform(),
                xytext=(-4 if to_the_right else 4, 0),
                textcoords="offset points",
                ha="right" if to_the_right else "left",
                va="top",
                fontsize="small",
                zorder=6,
            )
            ax.axvline(x[k], 0, 0.98 - 0.085 * line, color=FLAGGED, linewidth=0.8, linestyle=":", zorder=1)

    @staticmethod
    def _legend(ax: Axes, marks: Sequence[tuple[str, Any, Any, str]], **place: Any) -> None:
        from matplotlib.lines import Line2D

        handles = [
            Line2D([], [], linestyle="", marker=marker, color=colour, markerfacecolor=face, label=text)
            for marker, colour, face, text in marks
        ]
        ax.legend(handles=handles, fontsize="small", frameon=False, borderaxespad=0.2, **place)


def _keys(cells: Sequence[Cell]) -> list[tuple[str, str]]:
    return [(cell.family, cell.name) for cell in cells]


def _of_length(name: str, values: ArrayLike, n: int) -> Float:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (n,):
        raise ValueError(f"{name} must have one value for each of {n} rows of table, got shape {array.shape}")
    return array
