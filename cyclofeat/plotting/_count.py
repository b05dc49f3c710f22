"""Probabilities of a count."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Self

from cyclofeat.plotting.drawing import Display, axes_for

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.container import BarContainer

    from cyclofeat.counting import LobeCount


class CountDisplay(Display):
    """Probability of each number of worn lobes, and of each lobe of being worn.

    Parameters
    ----------
    count : cyclofeat.counting.LobeCount

    Attributes
    ----------
    bars_ : matplotlib.container.BarContainer

    Examples
    --------
    >>> from cyclofeat.counting import LobeCount
    >>> count = LobeCount(1, {0: 0.1, 1: 0.9}, (3,), (0.0, 0.1, 0.0, 0.9), True, 2)
    >>> len(CountDisplay(count).plot("lobes").bars_)
    4
    """

    bars_: BarContainer

    def __init__(self, count: LobeCount) -> None:
        self.count = count

    def plot(
        self, kind: Literal["counts", "lobes"] = "counts", ax: Axes | None = None, **bar_kw: Any
    ) -> Self:
        """Draw; what the model answers has the colour ``C1``.

        Parameters
        ----------
        kind : {"counts", "lobes"}, default="counts"
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        **bar_kw
            Passed on to ``Axes.bar``.

        Raises
        ------
        ValueError
            If there is no such kind, or the model located no lobes.
        """
        count = self.count
        if kind not in ("counts", "lobes"):
            raise ValueError(f"kind must be 'counts' or 'lobes', got {kind!r}")
        if kind == "lobes" and not count.lobe_probability:
            raise ValueError("kind='lobes' needs a model with a locator, got the count of one without")
        if kind == "counts":
            values, answer = dict(count.probability), {count.defect_count}
            xlabel = "number of worn lobes" + (" (refused: not reliable)" if count.refused else "")
            ylabel = "probability"
        else:
            values = {lobe + 1: share for lobe, share in enumerate(count.lobe_probability)}
            answer = {lobe + 1 for lobe in count.lobes}
            xlabel = (
                "lobe, as numbered on the disc" if count.absolute else "lobe, counted from the first sample"
            )
            ylabel = "probability of wear"
        self.figure_, self.ax_ = axes_for(ax, (7.0, 3.0))
        colours = ["C1" if name in answer else "C0" for name in values]
        self.bars_ = self.ax_.bar([*values], [*values.values()], **({"color": colours} | bar_kw))
        self.ax_.set_xticks([*values])
        self.ax_.set(xlabel=xlabel, ylabel=ylabel, ylim=(0, 1))
        self.ax_.grid(axis="y", alpha=0.3, linewidth=0.6)
        return self
