"""Display of recordings, model and corrected model over each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal, Self

from cyclofeat.plotting._gap import RECORDED
from cyclofeat.plotting.drawing import Display, axes_for, legend_above, one_of_result, plain_log_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cyclofeat.gap import GapResult
    from cyclofeat.gap.overlays import Overlay

OverlayKind = Literal["spectrum", "orders", "distribution"]

_CORRECTED = "C2"
_LABELS = {
    "spectrum": ("frequency (Hz)", "rms in a twelfth octave (Nm)"),
    "orders": ("order (multiples of the input speed)", "amplitude (Nm)"),
    "distribution": ("torque (Nm)", "density (1/Nm)"),
}


class GapOverlayDisplay(Display):
    """Display of recordings, model and corrected model over each other.

    Lines are means over recordings; bands hold nine recordings in ten.

    Parameters
    ----------
    overlay : cyclofeat.gap.Overlay
    label : str, default="measured"
        Name of the recordings.

    Examples
    --------
    >>> GapOverlayDisplay.from_result(result, "orders")  # doctest: +SKIP
    """

    SIZE: ClassVar[tuple[float, float]] = (8.0, 3.6)

    def __init__(self, overlay: Overlay, *, label: str = "measured") -> None:
        self.overlay = overlay
        self.label = str(label)

    @classmethod
    def from_result(
        cls,
        result: GapResult,
        kind: OverlayKind = "spectrum",
        ax: Axes | None = None,
        *,
        condition: int = 0,
        label: str = "measured",
    ) -> Self:
        """Draw one overlay of a result.

        Parameters
        ----------
        result : cyclofeat.gap.GapResult
        kind : {"spectrum", "orders", "distribution"}, default="spectrum"
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        condition : int, default=0
            Number of the condition.
        label : str, default="measured"
            Name of the recordings.

        Raises
        ------
        ValueError
            If the result has no such overlay.
        """
        of_kind = [overlay for overlay in result.overlays if overlay.kind == kind]
        overlay = one_of_result(f"overlays of kind={kind!r}", of_kind, condition)
        return cls(overlay, label=label).plot(ax)

    def plot(self, ax: Axes | None = None) -> Self:
        """Draw.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        """
        from matplotlib import rcParams

        self.figure_, self.ax_ = axes_for(ax, self.SIZE)
        overlay, ax = self.overlay, self.ax_
        # What fits lies within the wide line of the recordings.
        curves = (
            ("model", overlay.model, rcParams["text.color"], "--", 1.2, 0.10),
            (self.label, overlay.measured, RECORDED, "-", 2.4, 0.25),
            ("corrected model", overlay.corrected, _CORRECTED, "-", 1.0, 0.20),
        )
        for name, band, colour, style, width, alpha in curves:
            if band is None:
                continue
            ax.fill_between(overlay.x, band.low, band.high, color=colour, alpha=alpha, linewidth=0)
            ax.plot(overlay.x, band.mean, style, color=colour, linewidth=width, label=name)
        xlabel, ylabel = _LABELS[overlay.kind]
        ax.set(xlabel=xlabel, ylabel=ylabel, xlim=(overlay.x[0], overlay.x[-1]))
        if overlay.kind == "distribution":
            ax.set_ylim(bottom=0)
        else:
            ax.set_yscale("log")
        if overlay.kind == "spectrum":
            ax.set_xscale("log")
            plain_log_ticks(ax)
        ax.grid(axis="y", alpha=0.3, linewidth=0.6)
        legend_above(ax, ncols=3)
        return self
