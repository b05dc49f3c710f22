"""Figures of a report: plots that ``templates/plot.js`` draws, and pictures for light and dark pages."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.displays import thin_samples
from cyclofeat._base.quantities import probability_text
from cyclofeat.plotting import LobeMapDisplay, OrderDisplay, SpectrumDisplay, TorqueDisplay
from cyclofeat.plotting.drawing import require_matplotlib
from cyclofeat.report._page import count_text
from cyclofeat.signal.faults import find_runs, mark_clipped, mark_dropouts

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cyclofeat.counting import LobeCount
    from cyclofeat.counting.model.lobe_count import WindowCount
    from cyclofeat.recordings import Recording

Picture = dict[str, Any]
Draw = Callable[["Axes"], object]

# Values below this share of the largest are rounding errors, and would stretch a logarithmic axis.
_DYNAMIC_RANGE = 1e-8


@dataclass(frozen=True)
class Axis:
    """Quantity of an axis, in singular and without unit, its unit, and its scale; whole: of whole numbers.

    ``ends`` are shown as long as all of x is; default, the ends of the values. With a ``start``, in s since
    1970, values are seconds after it, and the axis shows dates.
    """

    quantity: str
    unit: str
    log: bool = False
    whole: bool = False
    ends: tuple[float, float] | None = None
    start: float | None = None


@dataclass(frozen=True, eq=False)
class Line:
    """Values over the plot's x, NaN where there are none, with an optional band."""

    name: str
    values: ArrayLike
    colour: str = "accent"  # of the page: accent, second, third, ink, faint or wrong
    style: Literal["line", "dashed", "wide", "stems", "strokes", "points", "steps"] = "line"
    band: tuple[ArrayLike, ArrayLike] | None = None  # lower and upper end


@dataclass(frozen=True, eq=False)
class Marks:
    """Vertical lines at multiples: ``at[k]`` is "``name`` k + 1". Short ones are strokes at the bottom."""

    name: str
    legend: str
    at: ArrayLike
    colour: str
    short: bool = False


@dataclass(frozen=True)
class Span:
    """Part of x with a short label in the plot, and words for the read-out.

    A span with the colour of a ``band`` is drawn over the whole height, its label in the legend.
    """

    start: float
    stop: float
    label: str
    text: str
    amiss: bool = False
    band: str = ""


@dataclass(frozen=True, eq=False)
class Plot:
    """Lines over one x, with what marks places on it."""

    x: ArrayLike  # increasing
    lines: Sequence[Line]
    axes: tuple[Axis, Axis]  # of x and of y
    view: tuple[float, float] | None = None  # part of x that is shown at first; None: all
    marks: Sequence[Marks] = ()
    spans: Sequence[Span] = ()
    note: str = ""  # how the data were reduced

    def to_dict(self) -> dict[str, Any]:
        """Return plain values that JSON can hold: long columns as text."""
        x = np.asarray(self.x, dtype=np.float64)
        lines = []
        for line in self.lines:
            ends = [np.asarray(end, dtype=np.float64) for end in (line.values, *(line.band or ()))]
            least = (np.nanmax(ends[0]) or 1.0) * _DYNAMIC_RANGE if self.axes[1].log else -np.inf
            columns = [_pack_values(np.maximum(end, least)) for end in ends]
            lines.append({"name": line.name, "colour": line.colour, "style": line.style, "columns": columns})
        return {
            "x": _pack_values(x),
            "lines": lines,
            "axes": [vars(axis) for axis in self.axes],
            "view": [float(end) for end in self.view or (x[0], x[-1])],
            "marks": [vars(marks) | {"at": np.asarray(marks.at).tolist()} for marks in self.marks],
            "spans": [vars(span) for span in self.spans],
            "note": self.note,
        }


def _pack_values(values: NDArray[np.float64]) -> dict[str, Any]:
    """Return equal steps as two numbers, and other values as little-endian float32 in base64."""
    steps = np.diff(values)
    if steps.size and np.allclose(steps, steps[0], rtol=1e-6, atol=0):
        return {"first": float(values[0]), "last": float(values[-1]), "n": values.size}
    return {"base64": base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")}


# Pixels per inch at which a figure is shown: a font of 10 points is then 13 pixels tall.
_PIXELS_PER_INCH = 92

# Ink, faint ink, frame and ground of legends, and the cycle.
_COLOURS = ("#1d2329", "#6b7580", "#d3d9de", "#ffffff", "#1f6fb4", "#e07b12", "#2a9134")
_REFUSED = "#b3261e"


def theme_settings() -> Any:
    """Return matplotlib's settings for pages; dark ones turn the colours of a picture round."""
    from cycler import cycler

    ink, faint, frame, legend, *cycle = _COLOURS
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
        "font.sans-serif": ["DejaVu Sans"],
        # Outlines of letters would take half of a page; one salt gives equal files for equal data.
        "svg.fonttype": "none",
        "svg.hashsalt": "cyclofeat",
    }


def draw_picture(draw: Draw, size: tuple[float, float], alt: str, *, plot: Plot | None = None) -> Picture:
    """Draw a figure of ``size`` in inches as an SVG data URI ``image``, with its size in pixels.

    ``draw`` is called with the axes, ``alt`` describes the figure in words. With a ``plot``, which the page
    draws, the figure is for paper.
    """
    width, height = (round(inches * _PIXELS_PER_INCH) for inches in size)
    image = data_uri(_draw_svg(draw, size).encode())
    drawn: Picture = {"alt": alt, "width": width, "height": height, "image": image}
    return drawn if plot is None else drawn | {"plot": plot.to_dict()}


def data_uri(content: bytes, kind: str = "image/svg+xml") -> str:
    """Return the content of a picture's file as its address."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _draw_svg(draw: Draw, size: tuple[float, float]) -> str:
    require_matplotlib()
    import matplotlib
    from matplotlib.figure import Figure

    # A bare Figure needs no window system and is not listed as open.
    with matplotlib.rc_context(theme_settings()):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure.subplots())
        svg = io.StringIO()
        figure.savefig(svg, format="svg", metadata={"Date": None})
    # A tenth of a point is finer than any screen, and lines need no indent.
    text = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d)\d+", r"\1", path[0]), svg.getvalue())
    return re.sub(r"\s*\n\s*", "\n", text)


MOST_SAMPLES = 60_000  # of torque in a page, which they make 0.3 MB larger
_MOST_POINTS = 1200  # of a torque on paper
_MOST_SPANS = 500
_SHOWN_HZ, _HIGHEST_HZ = 400.0, 2000.0
_MOST_BINS = 12_000


def recording_pictures(
    recording: Recording, count: LobeCount, speed_hz: float | None, most_samples: int
) -> dict[str, Picture]:
    """Draw torque and spectrum of a counted recording and, if its speed is known, its disc and orders.

    The torque has its windows above it. The page holds ``most_samples`` of it, or their room in extremes.
    """
    from cyclofeat.simulators.gearbox import CycloidalProfile

    torque, windows = TorqueDisplay(recording), window_spans(count.windows)
    torque.max_points = _MOST_POINTS

    def draw_torque(ax: Axes) -> None:
        torque.plot(ax)
        # Draw a strip of windows with their labels above the curve.
        low, high = ax.get_ylim()
        if windows:
            ax.set_ylim(low, high + 0.12 * (high - low))
        for window in windows:
            colour = _REFUSED if window.amiss else "C0"
            ax.axvspan(window.start, window.stop, 0.9, 1, facecolor=colour, edgecolor="w", alpha=0.3)
            middle, label = (window.start + window.stop) / 2, window.label
            ax.text(
                middle, 0.95, label if len(windows) <= 8 else label[0], transform=ax.get_xaxis_transform(),
                ha="center", va="center", fontsize="small", clip_on=True,
            )  # fmt: skip

    alt = f"{torque.quantity.capitalize()} in {torque.unit} over time in s, with the answer of each window"
    plot = torque_plot(torque, windows, most_samples)
    drawn = {"torque": draw_picture(draw_torque, (6.0, 2.8), alt, plot=plot)}
    if speed_hz is None:
        # Lines marked at a wrong speed would mislead.
        spectrum = SpectrumDisplay(recording.replace(speed_rpm=None))
    else:
        # Recordings do not state their gearbox: the disc has the proportions of the papers.
        n_pins = recording.n_lobes + 1
        profile = CycloidalProfile(
            eccentricity=0.7 / n_pins, n_pins=n_pins, shortening=0.7, pin_radius=1.5 / n_pins
        )
        lobe_map = LobeMapDisplay(
            recording, input_speed_hz=speed_hz, count=count, outline=profile.outline(count.lobes)
        )
        alt = "Disc with its counted lobes in colour, a ring as dark as each is worn, and bars of disturbance"
        drawn["lobe_map"] = draw_picture(lobe_map.plot, (6.0, 5.8), alt)
        spectrum = SpectrumDisplay(recording, input_speed_hz=lobe_map.input_speed_hz)
        orders = OrderDisplay(recording, input_speed_hz=lobe_map.input_speed_hz)
        alt = f"Amplitudes in {torque.unit} at the lines of the output turn, by order of the input shaft"
        drawn["orders"] = draw_picture(orders.plot, (6.0, 3.4), alt, plot=order_plot(orders))
    alt = f"Amplitude spectrum of the {torque.quantity} in {torque.unit}; "
    alt += "lobe lines and orders are marked if a speed is known"
    plot = spectrum_plot(spectrum, most_samples)
    return drawn | {"spectrum": draw_picture(spectrum.plot, (6.0, 3.4), alt, plot=plot)}


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


def draw_recording(recording: Recording, size: tuple[float, float]) -> Picture:
    """Draw a whole recording with its gaps, bad spans, lost and clipped samples."""
    display, rate, torque = TorqueDisplay(recording), recording.sampling_rate, recording.torque
    channel = str((recording.meta or {}).get("channel", display.quantity))
    display.quantity = channel.removesuffix(f" [{display.unit}]")
    marked: list[tuple[str, NDArray[np.bool_]]] = []
    if torque.min() < torque.max():
        marked = [("lost samples", mark_dropouts(torque))]
        marked += [("clipped samples", at_end) for at_end in mark_clipped(torque)]
    spans = []
    for label, bad in marked:
        starts, lengths = find_runs(bad)
        # Those too close to be told apart are one.
        first = np.diff(starts, prepend=-np.inf) > recording.n_samples / _MOST_SPANS
        last = np.append(first[1:], True)[: starts.size]
        ends = zip(starts[first] / rate, (starts + lengths)[last] / rate, strict=True)
        spans += [Span(start, stop, label, label, band="wrong") for start, stop in ends]
    at = [sample / rate for sample, _ in recording.gaps]
    gaps = [Marks("gap", "gaps, where samples are missing or recordings joined", at, "second")] if at else []
    alt = f"{display.quantity.capitalize()} in {display.unit} over time in s, with gaps, faults and bad spans"
    plot = torque_plot(display, spans, MOST_SAMPLES, gaps)
    display.max_points = _MOST_POINTS
    return draw_picture(display.plot, size, alt, plot=plot)


def torque_plot(
    display: TorqueDisplay, spans: Sequence[Span], most_samples: int, marks: Sequence[Marks] = ()
) -> Plot:
    """Return the torque over time: all samples, or as many extremes as ``most_samples`` have room for."""
    time, torque, note = display.time, display.torque, "The page holds every sample."
    if torque.size > most_samples:
        # Times of extremes take as much room as their values; those of all samples take none.
        time, torque = thin_samples(time, torque, most_samples // 2)
        length = round(2 * display.time.size / time.size)
        note = f"Of every {length} samples the page holds the smallest and the largest: peaks are true, and "
        note += "what lies between them is left out."
    axes = Axis("time", "s"), Axis(display.quantity, display.unit)
    bands = [
        Span(start, stop, "bad span", f"bad span of {stop - start:.4g} s", band="faint")
        for start, stop in display.bad_spans
        if start < stop
    ]
    line = Line(display.quantity, torque)
    return Plot(time, [line], axes, marks=marks, spans=[*bands, *spans], note=note)


def spectrum_plot(display: SpectrumDisplay, most_bins: int = _MOST_BINS) -> Plot:
    """Return the spectrum up to 2 kHz, of which 400 Hz are shown at first."""
    limit = min(_HIGHEST_HZ, float(display.frequencies[-1]))
    # The line at 0 Hz holds a remainder of the mean.
    shown = (display.frequencies <= limit) & (display.frequencies > 0)
    frequencies, values = thin_samples(
        display.frequencies[shown], display.values[shown], min(most_bins, _MOST_BINS)
    )
    looks = (("lobe line", "second", False), ("input order", "third", True))
    marks = [
        Marks(name, legend, np.arange(1, int(limit / spacing) + 1) * spacing, colour, short)
        for (legend, spacing), (name, colour, short) in zip(display.marks.items(), looks, strict=False)
    ]
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
    colours = {"other": "faint", "input": "third", "lobe": "second", "mesh": "accent"}
    lines = [
        Line(
            display.meanings[kind], np.where(display.kinds == kind, display.amplitudes, np.nan), colour,
            "strokes" if kind == "other" else "stems",
        )
        for kind, colour in colours.items()
        if np.any(display.kinds == kind)
    ]  # fmt: skip
    axes = Axis("order of the input shaft", ""), Axis("amplitude", display.unit, log=True)
    return Plot(display.orders, lines, axes)
