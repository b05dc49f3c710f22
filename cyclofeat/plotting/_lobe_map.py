"""The disc with a ring of slots, one per lobe."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat import lobes
from cyclofeat.features import LobeMap
from cyclofeat.plotting._base import Float, axes_for, input_speed_from_angle
from cyclofeat.recording import Recording, Windower

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.colorbar import Colorbar
    from matplotlib.colors import Colormap, Normalize
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.text import Text

_QUANTITY = "disturbance of the torque while the lobe passes (rms; 1 = std of the torque)"

# Radii of the picture; the tips of the disc lie at 1.
_HUB = 0.33
_NUMBERS = 0.76
_RING = (1.06, 1.36)
_BARS = (1.43, 1.75)
_MARGIN = 1.03
_COUNTED_RADIUS = 0.135
_OUTLINE_POINTS = 900
# A healthy disc's slots lie below 0.1: on a scale of their own, their noise would look like wear.
LEAST_SCALE = 0.3


class LobeMapDisplay:
    """What the torque does while each lobe of the disc passes the load.

    Parameters
    ----------
    slot_rms : array-like, shape (n_lobes,)
        Rms of the folded, whitened torque in each slot, in units of the whitened torque's standard deviation.
    absolute : bool, default=False
        Whether slot k belongs to lobe k of the disc (and not to the k-th lobe after the window's start).
    worn_lobes : iterable of int, optional
        Lobes known to be worn, in the same numbering, from 0.
    counted_lobes : iterable of int, optional
        Lobes that a model counts as worn, in the same numbering, from 0.
    lobe_probability : array-like, shape (n_lobes,), optional
        Probability of each lobe of being worn, in the same numbering.
    outline : array-like of complex, optional
        Closed outline of the disc about its centre, in any unit, with the tip of lobe 0 on the real axis (as
        from ``CycloidalProfile.outline``). Default: a plain circle.
    input_speed_hz : float, optional
        Input speed in turns per second at which the torque was folded.

    Attributes
    ----------
    colorbar_ : matplotlib.colorbar.Colorbar or None
    ax_ : matplotlib.axes.Axes
    figure_ : matplotlib.figure.Figure

    Raises
    ------
    ValueError
        If an argument is out of its range; the message names it.

    Notes
    -----
    Numbers in the picture count from 1, as people read them. The worn half of a lobe disturbs the torque from
    about two slots before to one slot after the lobe's own: the map shows where, the model's probabilities
    say which.

    Examples
    --------
    A disturbance whenever the fourth lobe passes:

    >>> import numpy as np
    >>> from cyclofeat import Recording
    >>> from cyclofeat.plotting import LobeMapDisplay
    >>> phase = np.arange(46_080) / 25_600 * 500 / 60 * 16 / 15 * 15
    >>> torque = 22 + (phase.astype(int) % 15 == 3) * np.sin(2 * np.pi * phase) ** 2
    >>> display = LobeMapDisplay.from_recording(Recording(torque, 25_600, speed_rpm=500))
    >>> display.slot_rms.shape, int(display.slot_rms.argmax())
    ((15,), 3)
    >>> _ = display.plot()  # doctest: +SKIP
    """

    colorbar_: Colorbar | None
    ax_: Axes
    figure_: Figure | SubFigure

    def __init__(
        self,
        *,
        slot_rms: ArrayLike,
        absolute: bool = False,
        worn_lobes: Iterable[int] | None = None,
        counted_lobes: Iterable[int] | None = None,
        lobe_probability: ArrayLike | None = None,
        outline: ArrayLike | None = None,
        input_speed_hz: float | None = None,
    ) -> None:
        self.slot_rms = np.asarray(slot_rms, dtype=np.float64)
        if self.slot_rms.ndim != 1 or self.slot_rms.size < 3:
            raise ValueError(f"slot_rms must be 1-D with at least 3 slots, got shape {self.slot_rms.shape}")
        if not (np.isfinite(self.slot_rms).all() and (self.slot_rms >= 0).all()):
            raise ValueError(f"slot_rms must be finite and not negative, got {self.slot_rms}")
        self.absolute = bool(absolute)
        self.worn_lobes = None if worn_lobes is None else _lobes("worn_lobes", worn_lobes, self.n_lobes)
        self.counted_lobes = _lobes("counted_lobes", counted_lobes or (), self.n_lobes)
        self.lobe_probability = _probabilities(lobe_probability, self.n_lobes)
        self.outline = _closed(outline)
        self.input_speed_hz = input_speed_hz

    @property
    def n_lobes(self) -> int:
        """Number of lobes, which is the number of slots."""
        return int(self.slot_rms.size)

    @classmethod
    def from_recording(
        cls,
        recording: Recording,
        *,
        input_speed_hz: float | None = None,
        n_lobes: int | None = None,
        n_lines: int = 44,
        skip_s: float = 0.0,
        start_angle: float | None = None,
        counted_lobes: Iterable[int] | None = None,
        lobe_probability: ArrayLike | None = None,
        outline: ArrayLike | None = None,
    ) -> Self:
        """Display of the first whole output turn (``n_lobes`` input turns) of a recording.

        Parameters
        ----------
        recording : Recording
        input_speed_hz : float, optional
            Nominal input speed in turns per second; default, the recording's own. The speed is then taken
            from the recording's angle or, without one, refined from the torque.
        n_lobes : int, optional
            Number of lobes z_s of a disc; default, the recording's own.
        n_lines : int, default=44
            Number of lobe lines to fold; a low sampling rate holds fewer.
        skip_s : float, default=0.0
            Time to leave out at the beginning (ramp and settling), in s.
        start_angle : float, optional
            Absolute angle of the input shaft in rad at the first sample after ``skip_s``, where it is known
            otherwise than from the recording's angle.
        counted_lobes : iterable of int, optional
            Lobes that a model counts as worn, from 0, numbered as the slots will be.
        lobe_probability : array-like, shape (n_lobes,), optional
            Probability of each lobe of being worn, numbered as the slots will be.
        outline : array-like of complex, optional
            See :class:`LobeMapDisplay`.

        Returns
        -------
        LobeMapDisplay
            Where the angle is absolute, slot k spans the moments at which the cam points within half a lobe
            of the tip of lobe k, and the recording's worn lobes are marked. Otherwise slot 0 begins at the
            first sample, and worn lobes cannot be placed.

        Raises
        ------
        ValueError
            If the speed is not known, the recording is shorter than one output turn, constant, or sampled
            too slowly for the lobe lines.
        """
        n_lobes = recording.n_lobes if n_lobes is None else n_lobes
        nominal = recording.input_speed_hz if input_speed_hz is None else input_speed_hz
        if nominal is None:
            raise ValueError(
                "input_speed_hz must be given for a recording that does not state its speed_rpm, got None"
            )
        windower = Windower(input_speed_hz=nominal, reduction=n_lobes, skip_s=skip_s)
        windows = windower.windows([_beginning(recording, skip_s + n_lobes / nominal)])
        X = windows.X[:1]
        first = round(float(windows.start_s[0]) * recording.sampling_rate)
        speed = input_speed_from_angle(recording, n_lobes, first, first + X.shape[1])
        lobe_map = LobeMap(
            windows.sampling_rate,
            input_speed_hz=nominal if speed is None else speed,
            n_lobes=n_lobes,
            n_lines=n_lines,
            align="start",
        )
        if speed is not None:
            lobe_map.set_params(speed_tolerance=0.0)
        lobe_map.fit(X)
        found = lobe_map.lines(X)
        lines = found.lines
        if start_angle is None and bool(windows.absolute[0]):
            start_angle = float(windows.start_angle[0])
        if start_angle is not None:
            lines = lobes.shift(lines, np.array([_turns_to_lobe_zero(start_angle, n_lobes)]))
        folded = lobes.fold(lines, n_lobes)[0]
        absolute = start_angle is not None
        return cls(
            slot_rms=np.sqrt((folded**2).mean(axis=1)),
            absolute=absolute,
            worn_lobes=recording.worn_lobes if absolute else None,
            counted_lobes=counted_lobes,
            lobe_probability=lobe_probability,
            outline=outline,
            input_speed_hz=float(found.input_speed_hz[0]),
        )

    @classmethod
    def from_estimator(cls, model: Any, recording: Recording, *, outline: ArrayLike | None = None) -> Self:
        """Display of a recording with the probabilities that a model gives to its lobes.

        Parameters
        ----------
        model : cyclofeat.counting.LobeModel
            Trained, with a locator.
        recording : Recording
        outline : array-like of complex, optional
            See :class:`LobeMapDisplay`.

        Returns
        -------
        LobeMapDisplay

        Raises
        ------
        ValueError
            If the recording does not suit the model, or the model locates no lobes.
        """
        counted = model.count(recording)
        if not counted.lobe_probability:
            raise ValueError("model must have a locator to give each lobe a probability, got one without")
        return cls.from_recording(
            recording,
            input_speed_hz=model.input_speed_hz,
            n_lobes=model.n_lobes,
            counted_lobes=counted.lobes,
            lobe_probability=counted.lobe_probability,
            outline=outline,
        )

    def plot(
        self,
        ax: Axes | None = None,
        *,
        kind: Literal["disc", "bars"] = "disc",
        vmax: float | None = None,
        cmap: str = "YlOrRd",
        colorbar: bool = True,
    ) -> Self:
        """Draw.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        kind : {"disc", "bars"}, default="disc"
            Ring of slots about the disc, or bars side by side.
        vmax : float, optional
            Rms at the end of the scale; default, the largest, but 0.3 at least. Give the same one to pictures
            that are to be compared.
        cmap : str, default="YlOrRd"
            Name of the colour map of the rms.
        colorbar : bool, default=True
            Whether to draw the colour bar of ``kind="disc"``.

        Returns
        -------
        self

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        ValueError
            If there is no such kind, or ``vmax`` is not positive.
        """
        if kind not in ("disc", "bars"):
            raise ValueError(f"kind must be 'disc' or 'bars', got {kind!r}")
        if vmax is not None and not 0 < vmax < np.inf:
            raise ValueError(f"vmax must be positive and finite, got {vmax!r}")
        self.figure_, self.ax_ = axes_for(ax, (5.2, 5.2) if kind == "disc" else (7.0, 3.4))
        import matplotlib
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        end = max(float(self.slot_rms.max()), LEAST_SCALE) if vmax is None else float(vmax)
        norm, colours = Normalize(0.0, end), matplotlib.colormaps[cmap]
        self.colorbar_ = None
        if kind == "bars":
            self._bars(norm, colours, end)
            return self
        self._disc(norm, colours)
        if colorbar:
            self.colorbar_ = self.figure_.colorbar(
                ScalarMappable(norm, colours), ax=self.ax_, location="bottom", shrink=0.75, pad=0.02,
                aspect=30, label=f"ring: {_QUANTITY}",
                extend="max" if self.slot_rms.max() > end else "neither",
            )  # fmt: skip
            if self.colorbar_.solids is not None:
                # In vector files one image instead of 256 strips with hairlines between them.
                self.colorbar_.solids.set_rasterized(True)
        return self

    # -- both kinds

    @property
    def _numbering(self) -> str:
        if self.absolute:
            return "as numbered on the disc"
        return "counted from the one under load at the first sample"

    # -- the disc

    def _disc(self, norm: Normalize, colours: Colormap) -> None:
        from matplotlib import rcParams
        from matplotlib.colors import to_rgba
        from matplotlib.patches import Circle, Polygon, Wedge

        ax, ink = self.ax_, rcParams["text.color"]
        # Lobe 0 at the top, the others counter-clockwise as on the disc.
        upright = np.exp(0.5j * np.pi)
        body = {"facecolor": to_rgba("0.5", 0.18), "edgecolor": ink, "linewidth": 1.0}
        if self.outline is None:
            ax.add_patch(Circle((0, 0), 1.0, **body))
        else:
            # More points than can be seen only swell vector files.
            drawn = self.outline[:: max(1, self.outline.size // _OUTLINE_POINTS)]
            points = drawn * upright / np.abs(drawn).max()
            ax.add_patch(Polygon(np.column_stack([points.real, points.imag]), **body))
        ax.add_patch(Circle((0, 0), _HUB, fill=False, edgecolor=ink, linewidth=0.8))
        half = 180 / self.n_lobes
        middles: Float = 90 + 2 * half * np.arange(self.n_lobes, dtype=np.float64)
        for middle, rms in zip(middles, self.slot_rms, strict=True):
            wedge = Wedge(
                (0, 0), _RING[1], middle - half, middle + half, width=_RING[1] - _RING[0],
                facecolor=colours(norm(rms)), edgecolor=ink, linewidth=0.5,
            )  # fmt: skip
            ax.add_patch(wedge)
        self._disc_numbers(middles, ink)
        bars = self._disc_probabilities(middles, half, ink)
        edge = _MARGIN * (_RING if self.lobe_probability is None else _BARS)[1]
        ax.set(xlim=(-edge, edge), ylim=(-edge, edge), aspect="equal")
        ax.set_axis_off()
        ax.set_title(f"lobes {self._numbering}", fontsize="medium")
        self._legend(bars, loc="upper center", bbox_to_anchor=(0.5, 0.0))

    def _disc_numbers(self, middles: Float, ink: str) -> None:
        from matplotlib.patches import Circle

        worn = set(self.worn_lobes or ())
        for lobe, direction in enumerate(np.deg2rad(middles)):
            number = self.ax_.text(
                _NUMBERS * np.cos(direction), _NUMBERS * np.sin(direction), str(lobe + 1),
                ha="center", va="center", color=ink,
            )  # fmt: skip
            if lobe in worn:
                _mark_worn(number, ink)
            if lobe in self.counted_lobes:
                ring = Circle(
                    (_NUMBERS * np.cos(direction), _NUMBERS * np.sin(direction)), _COUNTED_RADIUS,
                    fill=False, edgecolor="C1", linewidth=2.5, zorder=4,
                )  # fmt: skip
                self.ax_.add_patch(ring)

    def _disc_probabilities(self, middles: Float, half: float, ink: str) -> Artist | None:
        if self.lobe_probability is None:
            return None
        from matplotlib.patches import Circle, Patch, Wedge

        inner, outer = _BARS
        for radius, style in ((inner, "-"), ((inner + outer) / 2, ":"), (outer, "-")):
            self.ax_.add_patch(
                Circle((0, 0), radius, fill=False, edgecolor=ink, alpha=0.4, linewidth=0.6, linestyle=style)
            )
        for middle, probability in zip(middles, self.lobe_probability, strict=True):
            length = (outer - inner) * float(probability)
            edges = middle - 0.7 * half, middle + 0.7 * half
            self.ax_.add_patch(Wedge((0, 0), inner + length, *edges, width=length, color="C2"))
        meaning = "bar outwards: probability that the lobe is worn\n(dotted circle 0.5, outer circle 1)"
        return Patch(color="C2", label=meaning)

    def _legend(self, probability: Artist | None, **place: Any) -> None:
        """What the marks mean, outside of the axes."""
        from matplotlib.lines import Line2D

        marks: list[Artist] = []
        if self.worn_lobes:
            marks.append(
                Line2D([], [], linestyle="", marker="o", markersize=10, color="C0", label="truly worn lobe")
            )
        if self.counted_lobes:
            marks.append(
                Line2D(
                    [], [], linestyle="", marker="o", markersize=11, markerfacecolor="none",
                    markeredgecolor="C1", markeredgewidth=2.5, label="counted as worn",
                )
            )  # fmt: skip
        if probability is not None:
            marks.append(probability)
        if marks:
            self.ax_.legend(handles=marks, ncols=2, fontsize="small", frameon=False, **place)

    # -- bars

    def _bars(self, norm: Normalize, colours: Colormap, end: float) -> None:
        from matplotlib import rcParams

        ax, ink = self.ax_, rcParams["text.color"]
        numbers = np.arange(1, self.n_lobes + 1)
        bars = ax.bar(
            numbers, self.slot_rms, color=colours(norm(self.slot_rms)), edgecolor=ink, linewidth=0.5
        )
        for lobe in self.counted_lobes:
            bars[lobe].set(edgecolor="C1", linewidth=2.5)
        ax.set(
            xlabel=f"lobe, {self._numbering}",
            ylabel=_QUANTITY.replace(" (", "\n("),
            xlim=(0.3, self.n_lobes + 0.7),
            ylim=(0, 1.08 * end),
        )
        ax.set_xticks(numbers)
        for lobe in self.worn_lobes or ():
            _mark_worn(ax.get_xticklabels()[lobe], ink)
        diamonds = None
        if self.lobe_probability is not None:
            twin = ax.twinx()
            (diamonds,) = twin.plot(
                numbers, self.lobe_probability, linestyle="", marker="D", markersize=6, color="C2",
                markeredgecolor=ink, markeredgewidth=0.5, label="probability of wear by the model (right)",
            )  # fmt: skip
            twin.set(ylim=(0, 1.08), ylabel="probability of wear (1)")
        self._legend(diamonds, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def _mark_worn(number: Text, ink: str) -> None:
    """Set a lobe's number in a filled circle."""
    number.set(color="white", fontweight="bold")
    number.set_bbox({"boxstyle": "circle,pad=0.25", "facecolor": "C0", "edgecolor": ink})


def _turns_to_lobe_zero(start_angle: float, n_lobes: int) -> float:
    """Turns of the fold from the first sample to half a lobe before the tip of lobe 0.

    The cam's direction in the wheel's frame is ((z_s + 1) phi + pi)/z_s; one turn of it passes all lobes.
    """
    cam_in_wheel = ((n_lobes + 1) * start_angle + np.pi) / n_lobes
    return float((-cam_in_wheel / (2 * np.pi) - 0.5 / n_lobes) % 1.0)


def _beginning(recording: Recording, duration_s: float) -> Recording:
    """The recording cut to little more than ``duration_s``: windows of its rest would fill the memory."""
    n_samples = math.ceil(duration_s * recording.sampling_rate) + 1
    if recording.n_samples <= n_samples:
        return recording
    angle = None if recording.angle is None else recording.angle[:n_samples]
    return recording.replace(torque=recording.torque[:n_samples], angle=angle)


def _lobes(name: str, values: Iterable[int], n_lobes: int) -> tuple[int, ...]:
    found = tuple(sorted({int(lobe) for lobe in values}))
    for lobe in found:
        if not 0 <= lobe < n_lobes:
            raise ValueError(f"{name} must lie in 0..{n_lobes - 1}, got {lobe}")
    return found


def _probabilities(values: ArrayLike | None, n_lobes: int) -> Float | None:
    if values is None:
        return None
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (n_lobes,):
        raise ValueError(f"lobe_probability must have shape ({n_lobes},), got {array.shape}")
    if not (np.isfinite(array).all() and (array >= 0).all() and (array <= 1).all()):
        raise ValueError(f"lobe_probability must lie between 0 and 1, got {array}")
    return array


def _closed(outline: ArrayLike | None) -> NDArray[np.complex128] | None:
    if outline is None:
        return None
    points = np.asarray(outline, dtype=np.complex128)
    if points.ndim != 1 or points.size < 3 or not np.isfinite(points).all() or not np.abs(points).max() > 0:
        raise ValueError(
            f"outline must be a 1-D array of at least 3 finite complex points, got shape {points.shape}"
        )
    return points
