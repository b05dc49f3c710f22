"""Spectrum of the torque, with lobe lines and orders of the input shaft."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import periodogram

from cyclofeat._base.checks import number_series
from cyclofeat.plotting.drawing import Display, axes_for
from cyclofeat.recordings import Recording
from cyclofeat.signal.lobes import lobe_frequency

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

# Numerical zeros (a padded or noise-free record) would stretch a logarithmic axis.
_DYNAMIC_RANGE = 1e8


class SpectrumDisplay(Display):
    """Amplitude spectrum of the torque up to a frequency limit.

    For a power spectral density, see :func:`cyclofeat.signal.welch_psd`.

    Parameters
    ----------
    frequencies : array-like, shape (n_bins,)
        Frequencies in Hz, increasing.
    values : array-like, shape (n_bins,)
        Amplitude in ``unit``; not negative.
    input_speed_hz : float, optional
        Input speed in turns per second: places lobe lines and orders. Without it there are none.
    n_lobes : int, default=15
        Number of lobes z_s of a disc.
    definition : str, default=""
        Definition of the spectrum, for the axis label.
    unit : str, default="Nm"
        Unit of the recording.

    Attributes
    ----------
    line_ : matplotlib.lines.Line2D
    order_ax_ : matplotlib.axes.Axes or None
        The axis of orders on top; None where the input speed is not known.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat import Recording
    >>> from cyclofeat.plotting import SpectrumDisplay
    >>> torque = 22 + 0.5 * np.sin(2 * np.pi * 100 * np.arange(25_600) / 25_600)
    >>> display = SpectrumDisplay.from_recording(Recording(torque, 25_600, speed_rpm=500))
    >>> peak = display.values.argmax()
    >>> print(display.frequencies[peak], display.values[peak].round(6))
    100.0 0.5
    >>> _ = display.plot(max_frequency_hz=200)  # doctest: +SKIP
    """

    line_: Line2D
    order_ax_: Any

    def __init__(
        self,
        *,
        frequencies: ArrayLike,
        values: ArrayLike,
        input_speed_hz: float | None = None,
        n_lobes: int = 15,
        definition: str = "",
        unit: str = "Nm",
    ) -> None:
        if input_speed_hz is not None and not 0 < input_speed_hz < np.inf:
            raise ValueError(f"input_speed_hz must be positive and finite, got {input_speed_hz!r}")
        if n_lobes < 2:
            raise ValueError(f"n_lobes must be at least 2, got {n_lobes!r}")
        self.frequencies = number_series("frequencies", frequencies, least=2)
        self.values = number_series("values", values, least=2)
        if self.values.size != self.frequencies.size or self.values.min() < 0:
            raise ValueError(
                f"values must hold one number, not negative, for each of the {self.frequencies.size} "
                f"frequencies, got {self.values.size} down to {self.values.min():g}"
            )
        self.input_speed_hz = input_speed_hz
        self.n_lobes = n_lobes
        self.definition = definition
        self.unit = unit

    @classmethod
    def from_recording(
        cls, recording: Recording, *, input_speed_hz: float | None = None, n_lobes: int | None = None
    ) -> Self:
        """Make the display of the spectrum of a whole recording.

        One Fourier transform, mean removed, periodic Hann window; a sine's line has the sine's amplitude. A
        recording of T seconds resolves 2/T Hz, enough to separate lobe lines from orders.

        Parameters
        ----------
        recording : Recording
        input_speed_hz : float, optional
            Input speed in turns per second. Default: the mean speed by the recording's angle, else its
            nominal speed. An error of 1 % puts the marks between the lines: pass the refined
            ``LobeMapDisplay.input_speed_hz`` then.
        n_lobes : int, optional
            Number of lobes z_s of a disc; default, the recording's own.

        Returns
        -------
        SpectrumDisplay
        """
        n_lobes = recording.n_lobes if n_lobes is None else n_lobes
        if input_speed_hz is None:
            measured = recording.mean_input_speed(n_lobes)
            input_speed_hz = recording.input_speed_hz if measured is None else measured
        frequencies, power = periodogram(
            recording.for_counting().torque, recording.sampling_rate, "hann", scaling="spectrum"
        )
        return cls(
            frequencies=frequencies, values=np.sqrt(2 * power), input_speed_hz=input_speed_hz,
            n_lobes=n_lobes, definition=f"Hann, {recording.duration:.3g} s", unit=recording.unit,
        )  # fmt: skip

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
        self.figure_, self.ax_ = axes_for(ax, (7.0, 3.4))
        limit = min(float(max_frequency_hz), float(self.frequencies[-1]))
        # The line at 0 Hz holds a remainder of the mean.
        shown = (self.frequencies <= limit) & (self.frequencies > 0)
        heights = np.maximum(self.values[shown], (self.values[shown].max() or 1.0) / _DYNAMIC_RANGE)
        (self.line_,) = self.ax_.plot(self.frequencies[shown], heights, zorder=3, linewidth=0.9)
        # Single bins can fall to any depth by chance.
        bottom = float(np.quantile(heights, 0.01))
        label = f"amplitude ({self.unit})" + (f"\n{self.definition}" if self.definition else "")
        self.ax_.set(yscale="log", xlabel="frequency (Hz)", ylabel=label, xlim=(0, limit))
        self.ax_.set_ylim(bottom=bottom)
        self.ax_.grid(axis="y", alpha=0.3, linewidth=0.6)
        self.order_ax_ = None
        if self.input_speed_hz is None:
            return self
        # Lobe lines lie behind the spectrum, orders of the input are strokes and the axis on top.
        speed: Any = self.input_speed_hz
        spacing = lobe_frequency(speed, self.n_lobes)
        lobe_lines = np.arange(1, int(limit / spacing) + 1) * spacing
        orders = np.arange(1, int(limit / speed) + 1) * speed
        across = self.ax_.get_xaxis_transform()
        self.ax_.vlines(
            lobe_lines, 0, 1, transform=across, color="C1", alpha=0.45, linewidth=0.8, zorder=1,
            label=f"lobe lines, multiples of {spacing:.2f} Hz ({self.n_lobes + 1}/{self.n_lobes} of input)",
        )  # fmt: skip
        self.ax_.vlines(
            orders, 0, 0.035, transform=across, color="C2", linewidth=1.0, zorder=2,
            label=f"input orders, multiples of {speed:.2f} Hz",
        )  # fmt: skip
        self.ax_.legend(loc="upper right", fontsize="small", framealpha=0.85)
        self.order_ax_ = self.ax_.secondary_xaxis(
            "top", functions=(lambda hz: hz / speed, lambda order: order * speed)
        )
        self.order_ax_.set_xlabel("order of the input shaft (times per turn)")
        return self
