"""Figures of a report, drawn for light and for dark pages, as data URIs."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cyclofeat._base.displays import thin_samples
from cyclofeat.plotting import (
    EvaluationDisplay,
    LobeMapDisplay,
    OrderDisplay,
    SpectrumDisplay,
    TorqueDisplay,
    TrainingDisplay,
)
from cyclofeat.plotting.kinds import words_of
from cyclofeat.report._page import count_text, probability_text
from cyclofeat.report._plot import Axis, Line, Marks, Plot, Span
from cyclofeat.signal.lobes import lobe_frequency

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cyclofeat.counting.model.lobe_count import WindowCount

Picture = dict[str, Any]
Draw = Callable[["Axes", str], object]

# Pixels per inch at which a figure is shown: a font of 10 points is then 13 pixels tall.
_PIXELS_PER_INCH = 92
_BESIDE_TRAINING = (6.0, 3.2)

# Small values recede into the page.
# Without a hue: the counted lobes have one.
_RING_COLOURS = {"light": "Greys", "dark": "gray"}
_COUNT_COLOURS = {"light": "Blues", "dark": "Blues_r"}


# Ink, faint ink, frame and ground of legends, and the cycle.
_COLOURS = {
    "light": ("#1d2329", "#6b7580", "#d3d9de", "#ffffff", "#1f6fb4", "#e07b12", "#2a9134"),
    "dark": ("#e4e8ec", "#8b96a1", "#363e46", "#1c2126", "#4a98de", "#f0a050", "#55bd60"),
}
_REFUSED = "#b3261e"


def _theme_colours(scheme: str) -> Any:
    from cycler import cycler

    ink, faint, frame, legend, *cycle = _COLOURS[scheme]
    transparent = ("figure.facecolor", "axes.facecolor", "savefig.facecolor")
    inked = ("text.color", "axes.labelcolor", "axes.titlecolor", "xtick.labelcolor", "ytick.labelcolor")
    lines = ("axes.edgecolor", "xtick.color", "ytick.color", "grid.color")
    return {
        **dict.fromkeys(transparent, "none"),
        **dict.fromkeys(inked, ink),
        **dict.fromkeys(lines, faint),
        "legend.facecolor": legend,
        "legend.edgecolor": frame,
        "axes.prop_cycle": cycler(color=cycle),
        "font.size": 10.5,
        # Text as outlines looks the same on every machine; one salt gives equal files for equal data.
        "svg.fonttype": "path",
        "svg.hashsalt": "cyclofeat",
    }


def draw_picture(
    draw: Draw, size: tuple[float, float], alt: str, *, by_scheme: bool = False, plot: Plot | None = None
) -> Picture:
    """Draw a figure of ``size`` in inches as SVG data URIs ``light`` and ``dark``, with its size in pixels.

    ``draw`` is called with the axes and the scheme, ``alt`` describes the figure in words. Drawing takes most
    of a report's time: a figure is drawn once, and again in dark only if ``by_scheme`` says that it has
    colours besides those of the theme. With a ``plot``, which the page draws in the scheme of the screen, the
    figure is for paper, and light.
    """
    width, height = (round(inches * _PIXELS_PER_INCH) for inches in size)
    light = _draw_svg(draw, size, "light")
    svgs = {"light": light}
    drawn: Picture = {"alt": alt, "width": width, "height": height}
    if plot is None:
        svgs["dark"] = _draw_svg(draw, size, "dark") if by_scheme else _darken_colours(light)
    else:
        drawn["plot"] = plot.to_dict()
    for scheme, svg in svgs.items():
        drawn[scheme] = data_uri(svg.encode())
    return drawn


def data_uri(content: bytes, kind: str = "image/svg+xml") -> str:
    """Return the content of a picture's file as its address."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _draw_svg(draw: Draw, size: tuple[float, float], scheme: str) -> str:
    import matplotlib
    from matplotlib.figure import Figure

    # A bare Figure needs no window system and is not listed as open.
    with matplotlib.rc_context(_theme_colours(scheme)):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure.subplots(), scheme)
        svg = io.StringIO()
        figure.savefig(svg, format="svg", metadata={"Date": None})
    return svg.getvalue()


def _darken_colours(svg: str) -> str:
    """Replace the colours of the light theme by those of the dark one."""
    dark_of = dict(zip(_COLOURS["light"], _COLOURS["dark"], strict=True))
    return re.sub("|".join(dark_of), lambda colour: dark_of[colour[0]], svg)


def recording_pictures(
    torque: TorqueDisplay,
    spectrum: SpectrumDisplay,
    orders: OrderDisplay | None = None,
    lobe_map: LobeMapDisplay | None = None,
    *,
    windows: Sequence[Span] = (),
    most_samples: int = 100_000,
) -> dict[str, Picture]:
    """Draw ``torque``, ``spectrum``, ``orders`` and ``lobe_map`` of one recording, each on its own scale.

    The torque has its ``windows`` above it. The page holds ``most_samples`` of it, or their room in extremes.
    """

    def draw_torque(ax: Axes, _: str) -> None:
        torque.plot(ax, max_points=2000)
        # Draw a strip of windows with their labels above the curve.
        low, high = ax.get_ylim()
        if windows:
            ax.set_ylim(low, high + 0.12 * (high - low))
        few = len(windows) <= 8
        for window in windows:
            colour = _REFUSED if window.amiss else "C0"
            ax.axvspan(window.start, window.stop, 0.9, 1, facecolor=colour, edgecolor="w", alpha=0.3)
            middle, label = (window.start + window.stop) / 2, window.label if few else window.label[0]
            ax.text(
                middle, 0.95, label, transform=ax.get_xaxis_transform(), ha="center", va="center",
                fontsize="small", clip_on=True,
            )  # fmt: skip

    drawn = {
        "torque": draw_picture(
            draw_torque, (6.0, 2.8),
            f"{torque.quantity.capitalize()} in {torque.unit} over time in s, with the answer of each window",
            plot=torque_plot(torque, windows, most_samples),
        ),
        "spectrum": draw_picture(
            lambda ax, _: spectrum.plot(ax), (6.0, 3.4),
            f"Amplitude spectrum of the {torque.quantity} in {torque.unit}; "
            "lobe lines and orders are marked if a speed is known",
            plot=spectrum_plot(spectrum),
        ),
    }  # fmt: skip
    if orders is not None:
        drawn["orders"] = draw_picture(
            lambda ax, _: orders.plot(ax), (6.0, 3.4),
            f"Amplitudes in {torque.unit} at the lines of the output turn, by order of the input shaft",
            plot=order_plot(orders),
        )  # fmt: skip
    if lobe_map is not None:
        drawn["lobe_map"] = draw_picture(
            lambda ax, scheme: lobe_map.plot(ax, cmap=_RING_COLOURS[scheme]), (6.0, 5.8),
            "Disc with its counted lobes in colour, a ring as dark as each is worn, and bars of disturbance",
            by_scheme=True,
        )  # fmt: skip
    return drawn


def distance_picture(display: TrainingDisplay) -> Picture:
    """Draw the distance from the training windows of each count."""
    alt = "Bars: distance of the recording from the training windows of each number of worn lobes"
    return draw_picture(lambda ax, _: display.plot(ax), _BESIDE_TRAINING, alt)


def feature_picture(display: TrainingDisplay, kind: str, counts: tuple[int, ...]) -> Picture:
    """Draw the features of a kind beside the training windows of some counts."""
    alt = "Features of the recording beside the mean of the training windows of two counts: "
    alt += words_of(kind).title
    return draw_picture(lambda ax, _: display.plot(ax, kind=kind, counts=counts), _BESIDE_TRAINING, alt)


def confusion_picture(display: EvaluationDisplay) -> Picture:
    """Draw a confusion matrix, true counts in rows."""
    alt = "Confusion matrix: windows by true and predicted number of worn lobes"
    return draw_picture(
        lambda ax, scheme: display.plot("confusion", ax, cmap=_COUNT_COLOURS[scheme]),
        (display.side, display.side), alt, by_scheme=True,
    )  # fmt: skip


def calibration_picture(display: EvaluationDisplay) -> Picture:
    """Draw the share of right answers by bins of the probability; larger dots hold more of the windows."""
    alt = "Calibration: share of right answers by probability said, beside the diagonal"
    return draw_picture(lambda ax, _: display.plot("calibration", ax), (5.2, 5.2), alt)


_SHOWN_HZ, _HIGHEST_HZ = 400.0, 2000.0
_MOST_BINS = 60_000


def window_spans(windows: Sequence[WindowCount]) -> list[Span]:
    """Return the windows of a recording with their answers in words."""
    return [
        Span(
            start=window.start_s,
            stop=window.stop_s,
            label="refused" if window.reason else f"{window.defect_count} worn",
            text=f"window {number}: {f'refused, {window.reason}; would be ' if window.reason else ''}"
            f"{count_text(window.defect_count, ())}, probability {probability_text(window.probability)}",
            amiss=bool(window.reason),
        )
        for number, window in enumerate(windows, 1)
    ]


def torque_plot(display: TorqueDisplay, spans: Sequence[Span], most_samples: int) -> Plot:
    """Return the torque over time: all samples, or as many extremes as ``most_samples`` have room for."""
    time, torque, note = display.time, display.torque, "The page holds every sample."
    if torque.size > most_samples:
        # Times of extremes take as much room as their values; those of all samples take none.
        time, torque = thin_samples(time, torque, most_samples // 2)
        length = round(2 * display.time.size / time.size)
        note = f"Of every {length} samples the page holds the smallest and the largest: peaks are true, and "
        note += "what lies between them is left out."
    axes = Axis("time", "s"), Axis(display.quantity, display.unit)
    return Plot(time, [Line(display.quantity, torque)], axes, spans=spans, note=note)


def spectrum_plot(display: SpectrumDisplay) -> Plot:
    """Return the spectrum up to 2 kHz, of which 400 Hz are shown at first."""
    limit = min(_HIGHEST_HZ, float(display.frequencies[-1]))
    # The line at 0 Hz holds a remainder of the mean.
    shown = (display.frequencies <= limit) & (display.frequencies > 0)
    frequencies, values = thin_samples(display.frequencies[shown], display.values[shown], _MOST_BINS)
    marks = []
    if display.input_speed_hz is not None:
        speed, n_lobes = display.input_speed_hz, display.n_lobes
        passage = lobe_frequency(speed, n_lobes)
        marks = [
            Marks(
                "lobe line", f"lobe lines, multiples of {passage:.2f} Hz ({n_lobes + 1}/{n_lobes} of input)",
                np.arange(1, int(limit / passage) + 1) * passage, "second",
            ),
            Marks(
                "input order", f"input orders, multiples of {speed:.2f} Hz",
                np.arange(1, int(limit / speed) + 1) * speed, "third", short=True,
            ),
        ]  # fmt: skip
    return Plot(
        frequencies,
        [Line("amplitude", values)],
        (Axis("frequency", "Hz"), Axis("amplitude", display.unit, log=True)),
        view=(0.0, min(_SHOWN_HZ, limit)),
        marks=marks,
        note=f"The page holds the spectrum up to {limit:g} Hz.",
    )


def order_plot(display: OrderDisplay) -> Plot:
    """Return the lines of the output turn, by their cause."""
    n_lobes = display.n_lobes
    looks = {
        "other": ("other lines of the output turn", "faint", "strokes"),
        "input": ("multiples of the input turn", "third", "stems"),
        "lobe": (f"multiples of the lobes' passage (order {n_lobes + 1}/{n_lobes})", "second", "stems"),
        "mesh": ("mesh: both, all lobes alike", "accent", "stems"),
    }
    lines = [
        Line(name, np.where(display.kinds == kind, display.amplitudes, np.nan), colour, style)  # type: ignore[arg-type]
        for kind, (name, colour, style) in looks.items()
        if np.any(display.kinds == kind)
    ]
    axes = Axis("order of the input shaft", ""), Axis("amplitude", display.unit, log=True)
    return Plot(display.orders, lines, axes)
