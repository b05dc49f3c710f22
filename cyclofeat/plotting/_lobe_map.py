"""The disc with its counted lobes and a ring of slots, one per lobe."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from cyclofeat.features import LobeMap
from cyclofeat.plotting.drawing import Float, PlainDisplay, shade_map, stated_speed, theme_colours
from cyclofeat.recordings import Recording, Windower
from cyclofeat.signal import lobes

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.colorbar import Colorbar

    from cyclofeat.counting import LobeCount

# Radii of the picture; the tips of the disc lie at 1.
_HUB = 0.33
_NUMBERS = 0.76
_RING = (1.06, 1.2)
_BARS = (1.27, 1.6)
_MARGIN = 1.03
_BAR_LOOK: dict[str, Any] = {"facecolor": "C2", "alpha": 0.4, "linewidth": 0}  # paler than the ring
_OUTLINE_POINTS = 900
# Least rms at the outer circle: a healthy disc's slots lie below 0.1, and must not look worn.
_LEAST_SCALE = 0.3


class LobeMapDisplay(PlainDisplay):
    """Ring of a disc's lobes, as dark as they are worn, and the disturbance while each passes the load.

    Shows the first whole output turn (``n_lobes`` input turns) of a recording: :meth:`Recording.crop` leaves
    out a run-up. A low sampling rate gives fewer lobe lines than 44.

    Parameters
    ----------
    recording : Recording
    input_speed_hz : float, optional
        Nominal input speed in turns per second; default, the recording's own. The speed is then taken from
        the recording's angle or, without one, refined from the torque.
    count : cyclofeat.counting.LobeCount, optional
        Answer of a model, whose lobes and their probabilities are shown.
    outline : array-like of complex, optional
        Outline of the disc about its centre, in any unit, with the tip of lobe 0 on the real axis (as from
        ``CycloidalProfile.outline``). Default: a circle.

    Attributes
    ----------
    slot_rms : ndarray, shape (n_lobes,)
        Rms of the folded, whitened torque in each slot, in units of the whitened torque's standard deviation.
    absolute : bool
        True if slot k spans the moments at which the cam points within half a lobe of the tip of lobe k, and
        the recording's worn lobes are marked: its angle is absolute, and that is what the count is based on.
        Otherwise slot 0 begins at the first sample, and worn lobes are not marked.
    input_speed_hz : float
        Input speed in turns per second at which the torque was folded.
    colorbar_ : matplotlib.colorbar.Colorbar or None
        Of a model's probabilities.

    Raises
    ------
    ValueError
        If the speed is not known, the recording is shorter than one output turn, constant, or sampled too
        slowly for the lobe lines, or the count is of another disc.

    Notes
    -----
    Numbers in the picture count from 1. The ring shows a model's probabilities, else the worn lobes that the
    recording states, else nothing. Bars outwards show the disturbance: the worn half of a lobe disturbs the
    torque from about two slots before to one slot after the lobe, so that the longest bar is often beside it.

    Examples
    --------
    A disturbance whenever the fourth lobe passes:

    >>> import numpy as np
    >>> from cyclofeat import Recording
    >>> from cyclofeat.plotting import LobeMapDisplay
    >>> phase = np.arange(46_080) / 25_600 * 500 / 60 * 16 / 15 * 15
    >>> torque = 22 + (phase.astype(int) % 15 == 3) * np.sin(2 * np.pi * phase) ** 2
    >>> display = LobeMapDisplay(Recording(torque, 25_600, speed_rpm=500))
    >>> display.slot_rms.shape, int(display.slot_rms.argmax())
    ((15,), 3)
    >>> _ = display.plot()  # doctest: +SKIP
    """

    size = (5.2, 5.2)
    colorbar_: Colorbar | None

    def __init__(
        self, recording: Recording, *, input_speed_hz: float | None = None, count: LobeCount | None = None,
        outline: ArrayLike | None = None,
    ) -> None:  # fmt: skip
        self.n_lobes = n_lobes = recording.n_lobes
        self.lobe_probability: Float | None = None
        if count is not None and count.lobe_probability:
            if len(count.lobe_probability) != n_lobes:
                raise ValueError(
                    f"count must be of a disc of {n_lobes} lobes, got one of {len(count.lobe_probability)}"
                )
            self.lobe_probability = np.asarray(count.lobe_probability)
            if recording.angle_is_absolute and not count.absolute:
                # The model counts lobes from the first sample, and so must the picture.
                recording = recording.replace(angle_is_absolute=False)
        self.counted_lobes = () if count is None else count.lobes
        self.outline = None if outline is None else np.asarray(outline, dtype=np.complex128)
        if self.outline is not None and not 0 < np.abs(self.outline).max(initial=0) < np.inf:
            raise ValueError(f"outline must be finite complex points about 0, got {outline!r}")
        nominal = stated_speed(recording, input_speed_hz)
        turn_s = n_lobes / nominal + 1 / recording.sampling_rate
        fits = recording.duration <= turn_s or recording.bad_spans
        first = recording if fits else recording.crop(0.0, turn_s)
        windows = Windower(input_speed_hz=nominal, reduction=n_lobes).windows([first])
        X = windows.X[:1]
        start, length = float(windows.start_s[0]), X.shape[1] / recording.sampling_rate
        speed = recording.crop(start, start + length).mean_input_speed()
        lobe_map = LobeMap(
            windows.sampling_rate,
            input_speed_hz=nominal if speed is None else speed,
            n_lobes=n_lobes,
            align="start",
        )
        if speed is not None:
            lobe_map.set_params(speed_tolerance=0.0)
        fitting = lobes.highest_frequency(lobe_map.input_speed_hz, n_lobes, 1, lobe_map.speed_tolerance)
        lobe_map.set_params(n_lines=min(lobe_map.n_lines, int(recording.sampling_rate / 2 / fitting)))
        lobe_map.fit(X)
        of_lobes = lobe_map.lines(X)
        lines = of_lobes.lines
        self.absolute = bool(windows.absolute[0])
        if self.absolute:
            from cyclofeat.counting import passage_of_lobe_zero  # loads numba

            lines = lobes.shift(lines, passage_of_lobe_zero(windows.start_angle[:1], n_lobes) - 0.5 / n_lobes)
        self.worn_lobes = recording.worn_lobes if self.absolute else None
        self.slot_rms: Float = np.sqrt((lobes.fold(lines, n_lobes)[0] ** 2).mean(axis=1))
        self.input_speed_hz = float(of_lobes.input_speed_hz[0])

    def _draw(self, ax: Axes) -> None:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize, to_rgba
        from matplotlib.lines import Line2D
        from matplotlib.patches import Circle, Patch, Polygon, Wedge

        ink = theme_colours()[0]
        body: dict[str, Any] = {"facecolor": to_rgba("0.5", 0.18), "edgecolor": ink, "linewidth": 1.0}
        if self.outline is None:
            outline: Patch = Circle((0, 0), 1.0, **body)
        else:
            # Fewer points keep vector files small; lobe 0 is at the top.
            drawn = self.outline[:: max(1, self.outline.size // _OUTLINE_POINTS)]
            points = drawn * np.exp(0.5j * np.pi) / np.abs(drawn).max()
            outline = Polygon(np.column_stack([points.real, points.imag]), **body)
        ax.add_patch(outline)
        ax.add_patch(Circle((0, 0), _HUB, fill=False, edgecolor=ink, linewidth=0.8))
        # The other lobes follow counter-clockwise as on the disc.
        half = 180 / self.n_lobes
        middles: Float = 90 + 2 * half * np.arange(self.n_lobes, dtype=np.float64)
        for middle in middles[list(self.counted_lobes)]:
            counted = Wedge(
                (0, 0), 1.1, middle - half, middle + half, width=1.1 - _HUB, color="C1", linewidth=0
            )
            ax.add_patch(counted)
            counted.set_clip_path(outline)
        marks: list[Artist] = []
        if self.worn_lobes:
            dot: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 10, "color": "C0"}
            marks.append(Line2D([], [], label="truly worn lobe", **dot))
        if self.counted_lobes:
            marks.append(Patch(color="C1", label="counted as worn"))
        marks.append(self._draw_slots(ax, middles, half, ink))
        edge = _MARGIN * _BARS[1]
        ax.set(xlim=(-edge, edge), ylim=(-edge, edge), aspect="equal")
        ax.set_axis_off()
        start = "as numbered on the disc"
        if not self.absolute:
            start = "counted from the one under load at the first sample"
        ax.set_title(f"lobes {start}", fontsize="medium")
        below: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0)}
        ax.legend(handles=marks, ncols=2, fontsize="small", frameon=False, **below)
        self.colorbar_ = None
        if self.lobe_probability is not None:
            self.colorbar_ = ax.figure.colorbar(
                ScalarMappable(Normalize(0.0, 1.0), shade_map("Greys")), ax=ax, location="bottom",
                shrink=0.75, pad=0.02, aspect=30, label="ring: probability that the lobe is worn",
            )  # fmt: skip
            if self.colorbar_.solids is not None:
                # One image instead of 256 strips with hairlines between them in vector files.
                self.colorbar_.solids.set_rasterized(True)

    def _draw_slots(self, ax: Axes, middles: Float, half: float, ink: str) -> Artist:
        """Draw ring, numbers and bars of the disturbance, and return the bars' entry in the legend."""
        from matplotlib.patches import Circle, Patch, Wedge

        worn: Float | None = self.lobe_probability
        if worn is None and self.worn_lobes is not None:
            worn = np.isin(np.arange(self.n_lobes), self.worn_lobes).astype(float)
        colours: list[Any] = ["none"] * self.n_lobes if worn is None else list(shade_map("Greys")(worn))
        for lobe, (middle, colour) in enumerate(zip(middles, colours, strict=True)):
            edges = middle - half, middle + half
            look = {"facecolor": colour, "edgecolor": ink, "linewidth": 0.5}
            ax.add_patch(Wedge((0, 0), _RING[1], *edges, width=_RING[1] - _RING[0], **look))
            place = _NUMBERS * np.exp(1j * np.deg2rad(middle))
            number = ax.text(place.real, place.imag, str(lobe + 1), ha="center", va="center", color=ink)
            if lobe in (self.worn_lobes or ()):
                number.set(color="white", fontweight="bold")
                number.set_bbox({"boxstyle": "circle,pad=0.25", "facecolor": "C0", "edgecolor": ink})
        inner, outer = _BARS
        end = max(float(self.slot_rms.max()), _LEAST_SCALE)
        for radius, style in ((inner, "-"), ((inner + outer) / 2, ":"), (outer, "-")):
            ring = Circle(
                (0, 0), radius, linestyle=style, fill=False, edgecolor=ink, alpha=0.4, linewidth=0.6
            )
            ax.add_patch(ring)
        for middle, rms in zip(middles, self.slot_rms, strict=True):
            length = (outer - inner) * float(rms) / end
            edges = middle - 0.7 * half, middle + 0.7 * half
            ax.add_patch(Wedge((0, 0), inner + length, *edges, width=length, **_BAR_LOOK))
        meaning = (
            "bar outwards: disturbance of the torque\nwhile the lobe passes (rms; dotted circle\n"
            f"{end / 2:.2g}, outer circle {end:.2g} std of the torque)"
        )
        return Patch(**_BAR_LOOK, label=meaning)
