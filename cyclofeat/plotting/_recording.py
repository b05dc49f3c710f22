"""Displays of a recording: torque over time, spectrum, and lines of the output turn by their cause."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self

import numpy as np
from scipy.signal import periodogram

from cyclofeat._base.checks import positive
from cyclofeat._base.displays import thin_samples
from cyclofeat._base.quantities import in_words
from cyclofeat.plotting.drawing import PlainDisplay, stated_speed
from cyclofeat.signal.lobes import lobe_frequency
from cyclofeat.signal.orders import order_lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

    from cyclofeat.recordings import Recording

# Numerical zeros (a padded or noise-free record) would stretch a logarithmic axis.
_DYNAMIC_RANGE = 1e8
_HIGHEST_ORDER = 48
# Lines below this share of the largest one are rounding errors.
_LEAST_LINE = 1e-5
# Share of a turn: a record of one turn at the nominal speed is too short if the machine runs slower.
_MOST_MISSING = 0.02


class TorqueDisplay(PlainDisplay):
    """Torque, or motor current, over time, with bad spans in grey.

    Of records of more than ``max_points`` samples the smallest and largest value of equal parts are drawn, so
    that peaks remain.

    Parameters
    ----------
    recording : Recording

    Attributes
    ----------
    time, torque : ndarray, shape (n_samples,)
        Times in s from the first sample, and samples in the recording's unit.
    line_ : matplotlib.lines.Line2D

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat import Recording
    >>> from cyclofeat.plotting import TorqueDisplay
    >>> recording = Recording(22 + np.sin(np.arange(25_600) / 100), 25_600)
    >>> display = TorqueDisplay(recording.crop(0.0, 0.5))
    >>> display.torque.size
    12800
    >>> _ = display.plot()  # doctest: +SKIP
    """

    size = (7.0, 3.0)
    max_points = 6000
    line_: Line2D

    def __init__(self, recording: Recording) -> None:
        self.time = np.arange(recording.n_samples) / recording.sampling_rate
        self.torque = recording.torque
        self.quantity = in_words(recording.quantity)
        self.unit = recording.unit
        self.bad_spans = recording.bad_spans

    def _draw(self, ax: Axes) -> None:
        (self.line_,) = ax.plot(*thin_samples(self.time, self.torque, self.max_points), linewidth=0.7)
        for start, stop in self.bad_spans:
            ax.axvspan(start, stop, color="0.5", alpha=0.3, linewidth=0.8)
        label = f"{self.quantity} ({self.unit})"
        ax.set(xlabel="time (s)", ylabel=label, xlim=(self.time[0], self.time[-1]))
        ax.grid(alpha=0.3, linewidth=0.6)


class SpectrumDisplay(PlainDisplay):
    """Amplitude spectrum of a whole recording, with lobe lines and orders of the input shaft.

    One Fourier transform, mean removed, periodic Hann window; a sine's line has the sine's amplitude. A
    recording of T seconds resolves 2/T Hz, enough to separate lobe lines from orders. For a power spectral
    density, see :func:`cyclofeat.signal.welch_psd`.

    Parameters
    ----------
    recording : Recording
    input_speed_hz : float, optional
        Input speed in turns per second, which places lobe lines and orders. Default: the mean speed by the
        recording's angle, else its nominal speed; without one there are none. An error of 1 % puts the marks
        between the lines: pass the refined ``LobeMapDisplay.input_speed_hz`` then.

    Attributes
    ----------
    frequencies : ndarray, shape (n_bins,)
        Frequencies in Hz.
    values : ndarray, shape (n_bins,)
        Amplitudes in the recording's unit.
    line_ : matplotlib.lines.Line2D
    order_ax_ : matplotlib.axes.Axes or None
        The axis of orders on top; None where the input speed is not known.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat import Recording
    >>> from cyclofeat.plotting import SpectrumDisplay
    >>> torque = 22 + 0.5 * np.sin(2 * np.pi * 100 * np.arange(25_600) / 25_600)
    >>> display = SpectrumDisplay(Recording(torque, 25_600, speed_rpm=500))
    >>> peak = display.values.argmax()
    >>> print(display.frequencies[peak], display.values[peak].round(6))
    100.0 0.5
    >>> _ = display.plot(max_frequency_hz=200)  # doctest: +SKIP
    """

    size = (7.0, 3.4)
    line_: Line2D
    order_ax_: Any

    def __init__(self, recording: Recording, *, input_speed_hz: float | None = None) -> None:
        if input_speed_hz is None:
            measured = recording.mean_input_speed()
            input_speed_hz = recording.input_speed_hz if measured is None else measured
        else:
            positive("input_speed_hz", input_speed_hz)
        self.input_speed_hz = input_speed_hz
        self.marks: dict[str, float] = {}  # spacing in Hz, by the text of the legend
        if input_speed_hz is not None:
            n_lobes, passage = recording.n_lobes, lobe_frequency(input_speed_hz, recording.n_lobes)
            text = f"lobe lines, multiples of {passage:.2f} Hz ({n_lobes + 1}/{n_lobes} of input)"
            self.marks = {
                text: passage,
                f"input orders, multiples of {input_speed_hz:.2f} Hz": input_speed_hz,
            }
        self.unit = recording.unit
        self.duration = recording.duration
        self.frequencies, power = periodogram(
            recording.for_counting().torque, recording.sampling_rate, "hann", scaling="spectrum"
        )
        self.values = np.sqrt(2 * power)

    def plot(self, ax: Axes | None = None, *, max_frequency_hz: float = 400.0) -> Self:
        """Draw.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        max_frequency_hz : float, default=400.0
            Upper limit in Hz, at most the highest frequency.

        Returns
        -------
        self : SpectrumDisplay

        Raises
        ------
        ValueError
            If the limit is below the second frequency.
        """
        if not max_frequency_hz >= self.frequencies[1]:
            raise ValueError(
                f"max_frequency_hz must reach {self.frequencies[1]:g} Hz at least, got {max_frequency_hz!r}"
            )
        self._limit = min(float(max_frequency_hz), float(self.frequencies[-1]))
        return super().plot(ax)

    def _draw(self, ax: Axes) -> None:
        # The line at 0 Hz holds a remainder of the mean.
        shown = (self.frequencies <= self._limit) & (self.frequencies > 0)
        heights = np.maximum(self.values[shown], (self.values[shown].max() or 1.0) / _DYNAMIC_RANGE)
        (self.line_,) = ax.plot(self.frequencies[shown], heights, zorder=3, linewidth=0.9)
        label = f"amplitude ({self.unit})\nHann, {self.duration:.3g} s"
        ax.set(yscale="log", xlabel="frequency (Hz)", ylabel=label, xlim=(0, self._limit))
        # Single bins can fall to any depth by chance.
        ax.set_ylim(bottom=float(np.quantile(heights, 0.01)))
        ax.grid(axis="y", alpha=0.3, linewidth=0.6)
        self.order_ax_ = None
        if self.input_speed_hz is None:
            return
        # Lobe lines lie behind the spectrum, orders of the input are strokes and the axis on top.
        looks: Any = ({"color": "C1", "alpha": 0.45, "linewidth": 0.8}, {"color": "C2", "linewidth": 1.0})
        for k, (legend, spacing) in enumerate(self.marks.items()):
            at = np.arange(1, int(self._limit / spacing) + 1) * spacing
            across = ax.get_xaxis_transform()
            ax.vlines(at, 0, (1, 0.035)[k], transform=across, zorder=k + 1, label=legend, **looks[k])
        ax.legend(loc="upper right", fontsize="small", framealpha=0.85)
        speed: Any = self.input_speed_hz
        self.order_ax_ = ax.secondary_xaxis(
            "top", functions=(lambda hz: hz / speed, lambda order: order * speed)
        )
        self.order_ax_.set_xlabel("order of the input shaft (times per turn)")


class OrderDisplay(PlainDisplay):
    """Amplitudes of the torque at the lines of the first output turn, by their cause.

    Line k of the output turn has the order k/z_s of the input shaft. Every (z_s + 1)-th line belongs to the
    passage of lobes, every z_s-th to the turn of the input shaft, both together to the mesh, in which all
    lobes act in the same way. Lines reach up to order 48 or what the sampling rate holds.

    Parameters
    ----------
    recording : Recording
        May lack up to 2 % of the turn.
    input_speed_hz : float, optional
        Input speed in turns per second. Default: by the recording's angle, else its nominal speed. An error
        of 1 % blends neighbouring lines: pass the refined ``LobeMapDisplay.input_speed_hz`` then.

    Attributes
    ----------
    amplitudes : ndarray, shape (n_lines,)
        Amplitudes of the lines k = 1, 2, ... in the recording's unit.
    orders : ndarray, shape (n_lines,)
        Order of each line: multiples of the input speed.
    kinds : ndarray of str, shape (n_lines,)
        ``"mesh"``, ``"lobe"``, ``"input"`` or ``"other"``, which ``meanings`` states in words.
    lines_ : dict of str to matplotlib.lines.Line2D
        By kind.

    Raises
    ------
    ValueError
        If no speed is known, or the recording is too short.

    See Also
    --------
    cyclofeat.signal.orders.order_lines : The amplitudes, with their equation.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat import Recording
    >>> from cyclofeat.plotting import OrderDisplay
    >>> phase = 2 * np.pi * 500 / 60 * np.arange(46_080) / 25_600
    >>> torque = 22 + 0.5 * np.cos(16 / 15 * phase) + 0.2 * np.cos(2 * phase)
    >>> display = OrderDisplay(Recording(torque, 25_600, speed_rpm=500))
    >>> for k in (16, 30):
    ...     print(display.kinds[k - 1], display.orders[k - 1].round(3), display.amplitudes[k - 1].round(3))
    lobe 1.067 0.5
    input 2.0 0.2
    >>> _ = display.plot()  # doctest: +SKIP
    """

    size = (7.0, 3.2)
    lines_: dict[str, Line2D]

    def __init__(self, recording: Recording, *, input_speed_hz: float | None = None) -> None:
        nominal = stated_speed(recording, input_speed_hz)
        n_lobes, rate = recording.n_lobes, recording.sampling_rate
        turn = n_lobes / nominal * rate
        if recording.n_samples < (1 - _MOST_MISSING) * turn:
            raise ValueError(
                f"recording must last one output turn, {turn / rate:.4g} s at {60 * nominal:g} RPM, "
                f"got {recording.duration:.4g} s"
            )
        first = recording if recording.n_samples <= round(turn) else recording.crop(0.0, turn / rate)
        first = first.for_counting()
        if input_speed_hz is None:
            nominal = first.mean_input_speed() or nominal
        highest = min(_HIGHEST_ORDER * n_lobes, int(rate / 2 / nominal * n_lobes))
        self.amplitudes = np.abs(order_lines(first.torque[np.newaxis], rate, [nominal], highest, n_lobes)[0])
        self.unit = recording.unit
        lines = np.arange(1, highest + 1)
        self.orders = lines * (1 / n_lobes)
        of_lobes, of_input = lines % (n_lobes + 1) == 0, lines % n_lobes == 0
        self.kinds = np.select(
            [of_lobes & of_input, of_lobes, of_input], ["mesh", "lobe", "input"], default="other"
        )
        self.meanings = {
            "other": "other lines of the output turn",
            "input": "multiples of the input turn",
            "lobe": f"multiples of the lobes' passage (order {n_lobes + 1}/{n_lobes})",
            "mesh": "mesh: both, all lobes alike",
        }

    def _draw(self, ax: Axes) -> None:
        largest = float(self.amplitudes.max()) or 1.0
        bottom = max(float(np.quantile(self.amplitudes, 0.05)), _LEAST_LINE * largest)
        looks = {
            "other": ("0.6", "", 0),
            "input": ("C2", "s", 3),
            "lobe": ("C1", "o", 4),
            "mesh": ("C0", "D", 5),
        }
        self.lines_ = {}
        for kind, (colour, marker, size) in looks.items():
            which = self.kinds == kind
            heights = np.maximum(self.amplitudes[which], bottom)
            ends = np.column_stack([np.full(heights.size, bottom), heights, np.full(heights.size, np.nan)])
            # One path for all strokes of a kind keeps vector files small.
            (self.lines_[kind],) = ax.plot(
                np.repeat(self.orders[which], 3), ends.ravel(), color=colour, marker=marker, markersize=size,
                linewidth=0.6 if kind == "other" else 1.2, markevery=(1, 3), label=self.meanings[kind],
            )  # fmt: skip
        ax.set(
            xlabel="order of the input shaft (times per turn)", ylabel=f"amplitude ({self.unit})",
            yscale="log", xlim=(0, self.orders[-1] + 0.5), ylim=(bottom, 3 * largest),
        )  # fmt: skip
        ax.grid(axis="y", alpha=0.3, linewidth=0.6)
        ax.legend(fontsize="small", framealpha=0.85, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)
