"""Helpers of the displays: axes, colours, legends, and kinds of features in plain words."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from cyclofeat.features.registry import REGISTRY
from cyclofeat.recordings import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure, SubFigure

Float = NDArray[np.float64]


class Display:
    """What all displays have once they are drawn: axes and figure of matplotlib."""

    ax_: Axes
    figure_: Figure | SubFigure


class PlainDisplay(Display):
    """Display of one kind, which draws without options: a subclass has ``size`` (inches) and ``_draw``."""

    size: tuple[float, float]

    def _draw(self, ax: Axes) -> None:
        raise NotImplementedError

    def plot(self, ax: Axes | None = None) -> Self:
        """Draw.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.

        Returns
        -------
        self
        """
        self.figure_, self.ax_ = axes_for(ax, self.size)
        self._draw(self.ax_)
        return self


def require_matplotlib() -> None:
    """Import matplotlib, or raise ``ImportError`` that says what to install.

    ``MPLBACKEND`` may name a backend that is not installed, such as a notebook's outside its environment, and
    would end the import. Pages need no backend: it is set afterwards, if it is known.
    """
    backend = None if "matplotlib" in sys.modules else os.environ.pop("MPLBACKEND", None)
    try:
        import_module("matplotlib.figure")
    except ImportError as error:
        raise ImportError("drawing needs matplotlib: pip install matplotlib") from error
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend
    if backend:
        with contextlib.suppress(ValueError):
            import_module("matplotlib").rcParams["backend"] = backend


def axes_for(ax: Axes | None, figsize: tuple[float, float]) -> tuple[Figure | SubFigure, Axes]:
    """Return the given axes with their figure, or new ones of ``figsize`` in inches."""
    require_matplotlib()
    if ax is None:
        import matplotlib.pyplot as plt

        _, ax = plt.subplots(figsize=figsize, layout="constrained")
    return ax.figure, ax


def theme_colours() -> tuple[str, str]:
    """Return the colours of text and of edges, which a theme may change."""
    from matplotlib import rcParams

    return rcParams["text.color"], rcParams["axes.edgecolor"]


def shade_map(name: str) -> Colormap:
    """Return a colour map whose small values recede into the ground, also where the theme's text is light."""
    import matplotlib
    from matplotlib.colors import to_rgb

    light_text = sum(to_rgb(theme_colours()[0])) > 1.5
    dark_names = {"Greys": "gray", "Blues": "Blues_r"}
    return matplotlib.colormaps[dark_names[name] if light_text else name]


def legend_above(ax: Axes, ncols: int = 2, **options: Any) -> None:
    """Draw a small legend without a frame above the axes."""
    ax.legend(
        fontsize="small", frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=ncols, **options
    )


def draw_mark_legend(
    ax: Axes, marks: Iterable[tuple[str, Any, Any, str]], above: Iterable[Any] = (), *, x: float = 0.0,
    ncols: int = 1,
) -> None:  # fmt: skip
    """Draw a small legend of handles and of marks: marker, colour, colour of its face, and meaning."""
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], linestyle="", marker=marker, color=colour, markerfacecolor=face, label=text)
        for marker, colour, face, text in marks
    ]
    ax.legend(
        handles=[*above, *handles], loc="lower left", bbox_to_anchor=(x, 1.0), ncols=ncols, fontsize="small",
        frameon=False, borderaxespad=0.2,
    )  # fmt: skip


def numbering_words(absolute: bool) -> str:
    """Return where the lobes of a picture are counted from."""
    return "as numbered on the disc" if absolute else "counted from the first sample"


def stated_speed(recording: Recording, input_speed_hz: float | None) -> float:
    """Return the given or the recording's nominal input speed in turns per second."""
    nominal = recording.input_speed_hz if input_speed_hz is None else input_speed_hz
    if nominal is None:
        raise ValueError(
            "input_speed_hz must be given for a recording that does not state its speed_rpm, got None"
        )
    return nominal


def plain_log_ticks(ax: Axes) -> None:
    """Label the ticks of a logarithmic x axis with plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = ax.get_xlim()
    wide = high / low > 1e4
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.10g}"))


@dataclass(frozen=True)
class Words:
    """Words for a kind of features."""

    title: str
    axis: str  # label of the vertical axis, with unit
    places: str = "number within its kind, from 1"  # label of the horizontal axis: what orders the features
    text: str = ""  # meaning, and the influence of wear
    formula: str = ""  # and where it is from


_LINES = "multiple of the rate at which lobes pass"
_OF_LOBE_MAP = {
    "lobe_slot_rms": Words(
        "Roughness of the torque, lobe by lobe",
        "roughness while it passes\n(1 = std of the torque)",
        "slot, from 1",
        "How unsteady the torque is while each lobe passes the load. Worn lobes raise it, often most at the "
        "ends of their row.",
    ),
    "lobe_slot_mean": Words(
        "Mean of the torque, lobe by lobe",
        "mean while it passes\n(1 = std of the torque)",
        "slot, from 1",
        "How far the torque lies above or below its mean while each lobe passes the load. Worn lobes lift "
        "and lower it.",
    ),
    "lobe_line_prominence": Words(
        "Strength of the lobe lines",
        "level over the spectrum\naround it (dB)",
        _LINES,
        "How far each multiple of the rate at which lobes pass stands out of the spectrum around it. Wear "
        "lifts them.",
    ),
    "lobe_line_contrast": Words(
        "Pattern of the lobe lines",
        "level over its\nneighbours (dB)",
        _LINES,
        "How each multiple of the rate at which lobes pass compares with the multiples around it. The gaps "
        "tell how many neighbouring lobes are worn.",
    ),
}


def words_of(kind: str) -> Words:
    """Return a kind of columns in words, by default the registry's name and unit.

    Examples
    --------
    >>> words_of("amplitude_nm").axis
    'amplitude (Nm)'
    """
    row = next((row for row in REGISTRY.values() if row.column().split("(")[0] == kind), None)
    if row is None:
        return Words(kind, kind)
    name = row.name.replace("_", " ")
    words = _OF_LOBE_MAP.get(row.name, Words(name.capitalize(), f"{name} ({row.unit})"))
    return replace(words, formula=f"{row.formula} ({row.source})")
