"""Torque over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from cyclofeat._base.checks import number_series
from cyclofeat._base.displays import thin_samples
from cyclofeat._base.quantities import in_words
from cyclofeat.plotting.drawing import Display, axes_for
from cyclofeat.recordings import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D


class TorqueDisplay(Display):
    """Torque, or motor current, over time.

    Parameters
    ----------
    time : array-like, shape (n,)
        Time in s, increasing.
    torque : array-like, shape (n,)
        Samples of the quantity, in its unit.
    quantity : str, default="output torque"
        Name of the quantity, for the axis.
    unit : str, default="Nm"
        Unit of the quantity.
    bad_spans : sequence of (start, stop), optional
        Spans in s that are drawn grey.

    Attributes
    ----------
    line_ : matplotlib.lines.Line2D

    Raises
    ------
    ValueError
        If time and torque are not finite, 1-D and of equal length.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat import Recording
    >>> from cyclofeat.plotting import TorqueDisplay
    >>> recording = Recording(22 + np.sin(np.arange(25_600) / 100), 25_600)
    >>> display = TorqueDisplay.from_recording(recording.crop(0.0, 0.5))
    >>> display.torque.size
    12800
    >>> _ = display.plot()  # doctest: +SKIP
    """

    line_: Line2D

    def __init__(
        self, *, time: ArrayLike, torque: ArrayLike, quantity: str = "output torque", unit: str = "Nm",
        bad_spans: Sequence[tuple[float, float]] = (),
    ) -> None:  # fmt: skip
        self.time = number_series("time", time, least=2)
        self.torque = number_series("torque", torque, least=2)
        self.quantity = quantity
        self.unit = unit
        self.bad_spans = bad_spans
        if self.time.size != self.torque.size:
            raise ValueError(
                f"torque must have time's length, got {self.torque.size} for {self.time.size} moments"
            )

    @classmethod
    def from_recording(cls, recording: Recording) -> Self:
        """Make the display of a recording.

        Parameters
        ----------
        recording : Recording

        Returns
        -------
        TorqueDisplay
        """
        return cls(
            time=np.arange(recording.n_samples) / recording.sampling_rate, torque=recording.torque,
            quantity=in_words(recording.quantity), unit=recording.unit, bad_spans=recording.bad_spans,
        )  # fmt: skip

    def plot(self, ax: Axes | None = None, *, max_points: int = 6000) -> Self:
        """Draw.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        max_points : int, default=6000
            Longer records are drawn as smallest and largest value of ``max_points / 2`` equal parts, so that
            peaks remain.

        Returns
        -------
        self : TorqueDisplay
        """
        self.figure_, self.ax_ = axes_for(ax, (7.0, 3.0))
        (self.line_,) = self.ax_.plot(*thin_samples(self.time, self.torque, max_points), linewidth=0.7)
        for start, stop in self.bad_spans:
            self.ax_.axvspan(start, stop, color="0.5", alpha=0.3, linewidth=0.8)
        label = f"{self.quantity} ({self.unit})"
        self.ax_.set(xlabel="time (s)", ylabel=label, xlim=(self.time[0], self.time[-1]))
        self.ax_.grid(alpha=0.3, linewidth=0.6)
        return self
