"""Picture of the lines of the output turn, by their cause."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from cyclofeat._base.checks import number_series
from cyclofeat.plotting.drawing import PlainDisplay, stated_speed
from cyclofeat.recordings import Recording
from cyclofeat.signal.orders import order_lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

_HIGHEST_ORDER = 48
# Lines below this share of the largest one are rounding errors.
_DYNAMIC_RANGE = 1e-5
# Share of a turn: a record of one turn at the nominal speed is too short if the machine runs slower.
_MOST_MISSING = 0.02


class OrderDisplay(PlainDisplay):
    """Amplitudes of the torque at the lines of the output turn, by their cause.

    Line k of the output turn has the order k/z_s of the input shaft. Every (z_s + 1)-th line belongs to the
    passage of lobes, every z_s-th to the turn of the input shaft, both together to the mesh, in which all
    lobes act in the same way.

    Parameters
    ----------
    amplitudes : array-like, shape (n_lines,)
        Amplitudes in ``unit`` of the lines k = 1, 2, ...; not negative.
    n_lobes : int, default=15
        Number of lobes z_s of a disc.
    unit : str, default="Nm"
        Unit of the recording.

    Attributes
    ----------
    orders : ndarray, shape (n_lines,)
        Order of each line: multiples of the input speed.
    kinds : ndarray of str, shape (n_lines,)
        ``"mesh"``, ``"lobe"``, ``"input"`` or ``"other"``, which ``meanings`` states in words.
    lines_ : dict of str to matplotlib.lines.Line2D
        By kind.

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
    >>> display = OrderDisplay.from_recording(Recording(torque, 25_600, speed_rpm=500))
    >>> for k in (16, 30):
    ...     print(display.kinds[k - 1], display.orders[k - 1].round(3), display.amplitudes[k - 1].round(3))
    lobe 1.067 0.5
    input 2.0 0.2
    >>> _ = display.plot()  # doctest: +SKIP
    """

    size = (7.0, 3.2)
    lines_: dict[str, Line2D]

    def __init__(self, *, amplitudes: ArrayLike, n_lobes: int = 15, unit: str = "Nm") -> None:
        if n_lobes < 2:
            raise ValueError(f"n_lobes must be at least 2, got {n_lobes!r}")
        self.amplitudes = number_series("amplitudes", amplitudes, least=2)
        if self.amplitudes.min() < 0:
            raise ValueError(f"amplitudes must not be negative ({unit}), got {self.amplitudes.min():g}")
        self.n_lobes = n_lobes
        self.unit = unit
        lines = np.arange(1, self.amplitudes.size + 1)
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

    @classmethod
    def from_recording(
        cls, recording: Recording, *, input_speed_hz: float | None = None, n_lobes: int | None = None
    ) -> Self:
        """Make the display of the first output turn of a recording, up to order 48 or what its rate holds.

        A recording may lack up to 2 % of the turn.

        Parameters
        ----------
        recording : Recording
        input_speed_hz : float, optional
            Input speed in turns per second. Default: by the recording's angle, else its nominal speed. An
            error of 1 % blends neighbouring lines: pass the refined ``LobeMapDisplay.input_speed_hz`` then.
        n_lobes : int, optional
            Number of lobes z_s of a disc; default, the recording's own.

        Returns
        -------
        OrderDisplay

        Raises
        ------
        ValueError
            If no speed is known, or the recording is too short.
        """
        n_lobes = recording.n_lobes if n_lobes is None else n_lobes
        nominal = stated_speed(recording, input_speed_hz)
        rate = recording.sampling_rate
        turn = n_lobes / nominal * rate
        if recording.n_samples < (1 - _MOST_MISSING) * turn:
            raise ValueError(
                f"recording must last one output turn, {turn / rate:.4g} s at {60 * nominal:g} RPM, "
                f"got {recording.duration:.4g} s"
            )
        first = recording if recording.n_samples <= round(turn) else recording.crop(0.0, turn / rate)
        first = first.for_counting()
        if input_speed_hz is None:
            nominal = first.mean_input_speed(n_lobes) or nominal
        highest = min(_HIGHEST_ORDER * n_lobes, int(rate / 2 / nominal * n_lobes))
        lines = order_lines(first.torque[np.newaxis], rate, [nominal], highest, n_lobes)
        return cls(amplitudes=np.abs(lines[0]), n_lobes=n_lobes, unit=recording.unit)

    def _draw(self, ax: Axes) -> None:
        largest = float(self.amplitudes.max()) or 1.0
        bottom = max(float(np.quantile(self.amplitudes, 0.05)), _DYNAMIC_RANGE * largest)
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
            gap = np.full(heights.size, np.nan)
            # One path for all strokes of a kind keeps vector files small.
            (self.lines_[kind],) = ax.plot(
                np.repeat(self.orders[which], 3),
                np.column_stack([np.full(heights.size, bottom), heights, gap]).ravel(),
                color=colour,
                linewidth=0.6 if kind == "other" else 1.2,
                marker=marker,
                markersize=size,
                markevery=(1, 3),
                label=self.meanings[kind],
            )
        ax.set_yscale("log")
        ax.set(
            xlabel="order of the input shaft (times per turn)",
            ylabel=f"amplitude ({self.unit})",
            xlim=(0, self.orders[-1] + 0.5),
            ylim=(bottom, 3 * largest),
        )
        ax.grid(axis="y", alpha=0.3, linewidth=0.6)
        ax.legend(fontsize="small", framealpha=0.85, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)
