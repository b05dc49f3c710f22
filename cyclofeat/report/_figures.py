"""Figures of a report, drawn for light and for dark pages, as data URIs."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.plotting import (
    LobeMapDisplay,
    OrderDisplay,
    SpectrumDisplay,
    TorqueDisplay,
    TrainingDisplay,
)
from cyclofeat.plotting._kinds import words_of
from cyclofeat.plotting._lobe_map import LEAST_SCALE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Picture = dict[str, Any]
Draw = Callable[["Axes", str], object]

# Pixels per inch at which a figure is shown: a font of 10 points is then 13 pixels tall.
_PIXELS_PER_INCH = 92
_HIGHEST_FREQUENCY = 400.0
_BESIDE_TRAINING = (6.0, 3.2)

# What is small must recede, into a bright page as into a dark one.
_RMS_COLOURS = {"light": "YlOrRd", "dark": "inferno"}
_COUNT_COLOURS = {"light": "Blues", "dark": "Blues_r"}

_TORQUE = "Output torque in Nm over time in s"
_SPECTRUM = "Amplitude spectrum of the torque in Nm; lobe lines and orders are marked where a speed is known"
_ORDERS = "Amplitudes in Nm at the lines of the output turn, by order of the input shaft"
_LOBE_MAP = "Disc with a ring of slots, one per lobe, coloured by the rms of the folded torque"


def _theme(ink: str, faint: str, frame: str, legend: str, cycle: Sequence[str]) -> Any:
    from cycler import cycler

    transparent = ("figure.facecolor", "axes.facecolor", "savefig.facecolor")
    inked = ("text.color", "axes.labelcolor", "axes.titlecolor", "xtick.labelcolor", "ytick.labelcolor")
    lines = ("axes.edgecolor", "xtick.color", "ytick.color", "grid.color")
    return {
        **dict.fromkeys(transparent, "none"),
        **dict.fromkeys(inked, ink),
        **dict.fromkeys(lines, faint),
        "legend.facecolor": legend,
        "legend.edgecolor": frame,
        "axes.prop_cycle": cycler(color=list(cycle)),
        "font.size": 10.5,
        # Text as outlines looks the same on every machine; one salt gives equal files for equal data.
        "svg.fonttype": "path",
        "svg.hashsalt": "cyclofeat",
    }


def _themes() -> dict[str, Any]:
    """Settings by the scheme of the page; the legend's ground is the page's card."""
    return {
        "light": _theme("#1d2329", "#6b7580", "#d3d9de", "#ffffff", ("#1f6fb4", "#e07b12", "#2a9134")),
        "dark": _theme("#e4e8ec", "#8b96a1", "#363e46", "#1c2126", ("#4a98de", "#f0a050", "#55bd60")),
    }


def picture(draw: Draw, size: tuple[float, float], alt: str) -> Picture:
    """A figure as two SVG data URIs, with its size in pixels and a text in its place.

    Parameters
    ----------
    draw : callable
        Draws on the axes that it is given; called for the schemes ``"light"`` and ``"dark"``.
    size : tuple of float
        Width and height in inches.
    alt : str
        What the figure shows.

    Returns
    -------
    dict
        ``light``, ``dark``, ``alt``, ``width``, ``height``.
    """
    import matplotlib
    from matplotlib.figure import Figure

    found: Picture = {"alt": alt, "width": round(size[0] * _PIXELS_PER_INCH)}
    found["height"] = round(size[1] * _PIXELS_PER_INCH)
    for scheme, settings in _themes().items():
        # A bare Figure: no window system, and no list of open figures to clear up.
        with matplotlib.rc_context(settings):
            figure = Figure(figsize=size, layout="constrained")
            draw(figure.subplots(), scheme)
            svg = io.BytesIO()
            figure.savefig(svg, format="svg", metadata={"Date": None})
        found[scheme] = "data:image/svg+xml;base64," + base64.b64encode(svg.getvalue()).decode("ascii")
    return found


def example_pictures(
    torques: Sequence[TorqueDisplay], spectra: Sequence[SpectrumDisplay], maps: Sequence[LobeMapDisplay]
) -> list[list[Picture]]:
    """Torque, spectrum and lobe map of each example, all on the same scales."""
    low = min(float(display.torque.min()) for display in torques)
    high = max(float(display.torque.max()) for display in torques)
    margin = 0.05 * (high - low)
    lines = [_shown(display) for display in spectra]
    # Single bins can fall to any depth by chance.
    bottom = min(float(np.quantile(values, 0.01)) for values in lines)
    top = 2 * max(float(values.max()) for values in lines)
    largest = max(LEAST_SCALE, *(float(display.slot_rms.max()) for display in maps))

    def draw_torque(display: TorqueDisplay) -> Draw:
        return lambda ax, _: display.plot(ax, max_points=2000).ax_.set_ylim(low - margin, high + margin)

    def draw_spectrum(display: SpectrumDisplay) -> Draw:
        def draw(ax: Axes, _: str) -> None:
            display.plot(ax, max_frequency_hz=_HIGHEST_FREQUENCY)
            if 0 < bottom < top:
                ax.set_ylim(bottom, top)

        return draw

    def draw_map(display: LobeMapDisplay) -> Draw:
        return lambda ax, scheme: display.plot(ax, vmax=largest, cmap=_RMS_COLOURS[scheme])

    return [
        [
            picture(draw_torque(torque), (6.0, 2.6), _TORQUE),
            picture(draw_spectrum(spectrum), (6.0, 3.3), _SPECTRUM),
            picture(draw_map(lobe_map), (6.0, 5.6), _LOBE_MAP),
        ]
        for torque, spectrum, lobe_map in zip(torques, spectra, maps, strict=True)
    ]


def recording_pictures(
    torque: TorqueDisplay,
    spectrum: SpectrumDisplay,
    orders: OrderDisplay | None = None,
    lobe_map: LobeMapDisplay | None = None,
) -> dict[str, Picture]:
    """Of one recording, each on its own scale: ``torque``, ``spectrum``, ``orders``, ``lobe_map``."""
    found = {
        "torque": picture(lambda ax, _: torque.plot(ax, max_points=2000), (6.0, 2.8), _TORQUE),
        "spectrum": picture(
            lambda ax, _: spectrum.plot(ax, max_frequency_hz=_HIGHEST_FREQUENCY), (6.0, 3.4), _SPECTRUM
        ),
    }
    if orders is not None:
        found["orders"] = picture(lambda ax, _: orders.plot(ax), (6.0, 3.4), _ORDERS)
    if lobe_map is not None:
        found["lobe_map"] = picture(
            lambda ax, scheme: lobe_map.plot(ax, cmap=_RMS_COLOURS[scheme]), (6.0, 5.8), _LOBE_MAP
        )
    return found


def distance_picture(display: TrainingDisplay) -> Picture:
    """The distance from the training windows of each count."""
    distance = "Bars: distance of the recording from the training windows of each number of worn lobes"
    return picture(lambda ax, _: display.plot(ax), _BESIDE_TRAINING, distance)


def feature_picture(display: TrainingDisplay, kind: str, counts: tuple[int, ...]) -> Picture:
    """The features of a kind beside the training windows of some counts."""
    beside = "Features of the recording beside the mean of the training windows of two counts: "
    return picture(
        lambda ax, _: display.plot(ax, kind=kind, counts=counts),
        _BESIDE_TRAINING,
        beside + words_of(kind).title,
    )


def _shown(display: SpectrumDisplay) -> NDArray[np.float64]:
    inside = (display.frequencies > 0) & (display.frequencies <= _HIGHEST_FREQUENCY)
    return display.values[inside]


def confusion_picture(confusion: NDArray[np.int64], labels: Sequence[str]) -> Picture:
    """Confusion matrix, true counts in rows."""

    def draw(ax: Axes, scheme: str) -> None:
        from sklearn.metrics import ConfusionMatrixDisplay

        ConfusionMatrixDisplay(confusion, display_labels=labels).plot(
            ax=ax, cmap=_COUNT_COLOURS[scheme], colorbar=False
        )
        ax.set(xlabel="predicted number of worn lobes", ylabel="true number of worn lobes")

    side = 1.6 + 0.45 * len(labels)
    return picture(draw, (side, side), "Confusion matrix: windows by true and predicted number of worn lobes")


def calibration_picture(
    said: NDArray[np.float64], was: NDArray[np.float64], weight: NDArray[np.float64]
) -> Picture:
    """Share of right answers against the probability said, by bins; larger dots hold more of the windows."""

    def draw(ax: Axes, _: str) -> None:
        from matplotlib import rcParams

        faint = rcParams["xtick.color"]
        ax.plot([0, 1], [0, 1], linestyle="--", linewidth=1, color=faint, label="right as often as said")
        ax.plot(said, was, linewidth=0.8, color="C0", alpha=0.6)
        ax.scatter(
            said, was, s=25 + 500 * weight, color="C0", alpha=0.8, zorder=3,
            label="answers of like probability,\nand their share of all windows",
        )  # fmt: skip
        for x, y, share in zip(said, was, weight, strict=True):
            ax.annotate(
                f"{100 * share:.0f} %", (x, y), xytext=(0, -17), textcoords="offset points", ha="center",
                fontsize="small",
            )  # fmt: skip
        ax.text(0.03, 0.97, "too careful:\nright more often than said", va="top", color=faint)
        ax.text(0.97, 0.03, "too sure:\nright less often than said", ha="right", color=faint)
        ax.set(
            xlabel="probability that the counter gave its answer",
            ylabel="share of these answers that were right",
            aspect="equal", xlim=(0, 1.04), ylim=(-0.06, 1.06),
        )  # fmt: skip
        ax.grid(alpha=0.3, linewidth=0.6)
        ax.legend(
            fontsize="small", frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2,
            markerscale=0.5,
        )  # fmt: skip

    return picture(
        draw, (5.2, 5.2), "Calibration: share of right answers by probability said, beside the diagonal"
    )
