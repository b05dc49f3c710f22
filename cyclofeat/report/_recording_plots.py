"""Plots of one recording: torque with the answers of its windows, spectrum, and orders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cyclofeat._base.displays import thin_samples
from cyclofeat.plotting import OrderDisplay, SpectrumDisplay, TorqueDisplay
from cyclofeat.report._page import count_text, probability_text
from cyclofeat.report._plot import Axis, Line, Marks, Plot, Span
from cyclofeat.signal.lobes import lobe_frequency

if TYPE_CHECKING:
    from cyclofeat.counting import WindowCount

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
