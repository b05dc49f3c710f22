"""Count of one recording, and scores of a counter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

from cyclofeat._base.checks import one_of
from cyclofeat.plotting.drawing import Display, axes_for, legend_above, numbering_words, shade_map

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.container import BarContainer

    from cyclofeat.counting import Evaluation, LobeCount


_LABELLED_ABOVE = 0.93  # share of right answers up to which there is room above a dot


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

    def plot(self, kind: Literal["counts", "lobes"] = "counts", ax: Axes | None = None) -> Self:
        """Draw; what the model answers has the colour ``C1``.

        Parameters
        ----------
        kind : {"counts", "lobes"}, default="counts"
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.

        Returns
        -------
        self : CountDisplay

        Raises
        ------
        ValueError
            If there is no such kind, or the model located no lobes.
        """
        count = self.count
        one_of("kind", kind, ("counts", "lobes"))
        if kind == "lobes" and not count.lobe_probability:
            raise ValueError("kind='lobes' needs a model with a locator, got the count of one without")
        if kind == "counts":
            values, answer = dict(count.probability), {count.defect_count}
            xlabel = "number of worn lobes" + (" (refused: not reliable)" if count.refused else "")
            ylabel = "probability"
        else:
            values = {lobe + 1: share for lobe, share in enumerate(count.lobe_probability)}
            answer = {lobe + 1 for lobe in count.lobes}
            xlabel = f"lobe, {numbering_words(count.absolute)}"
            ylabel = "probability of wear"
        self.figure_, self.ax_ = axes_for(ax, (7.0, 3.0))
        colours = ["C1" if name in answer else "C0" for name in values]
        self.bars_ = self.ax_.bar([*values], [*values.values()], color=colours)
        self.ax_.set_xticks([*values])
        self.ax_.set(xlabel=xlabel, ylabel=ylabel, ylim=(0, 1))
        self.ax_.grid(axis="y", alpha=0.3, linewidth=0.6)
        return self


class EvaluationDisplay(Display):
    """Confusion matrix and calibration of a counter on assemblies that it has not seen.

    Parameters
    ----------
    result : cyclofeat.counting.Evaluation

    Examples
    --------
    >>> EvaluationDisplay(result).plot("calibration")  # doctest: +SKIP
    """

    def __init__(self, result: Evaluation) -> None:
        self.result = result
        self.side = 1.6 + 0.45 * result.classes.size  # of the confusion matrix, in inches

    def plot(self, kind: Literal["confusion", "calibration"] = "confusion", ax: Axes | None = None) -> Self:
        """Draw.

        Parameters
        ----------
        kind : {"confusion", "calibration"}, default="confusion"
            Windows by true and predicted count, or the share of right answers by the probability that the
            counter gave them; larger dots hold more of the windows.
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.

        Returns
        -------
        self : EvaluationDisplay

        Raises
        ------
        ValueError
            If there is no such kind, or the counter gave no probabilities.
        """
        one_of("kind", kind, ("confusion", "calibration"))
        if kind == "confusion":
            self.figure_, self.ax_ = axes_for(ax, (self.side, self.side))
            from sklearn.metrics import ConfusionMatrixDisplay

            labels = [str(count) for count in self.result.classes]
            ConfusionMatrixDisplay(self.result.confusion, display_labels=labels).plot(
                ax=self.ax_, cmap=shade_map("Blues"), colorbar=False
            )
            self.ax_.set(xlabel="predicted number of worn lobes", ylabel="true number of worn lobes")
            return self
        curve = self.result.calibration_curve()
        if curve is None:
            raise ValueError("kind='calibration' needs a counter with predict_proba, got one without")
        self.figure_, ax = axes_for(ax, (5.2, 5.2))
        self.ax_ = ax
        from matplotlib import rcParams

        said, was, weight = curve
        faint = rcParams["xtick.color"]
        ax.plot([0, 1], [0, 1], linestyle="--", linewidth=1, color=faint, label="right as often as stated")
        ax.plot(said, was, linewidth=0.8, color="C0", alpha=0.6)
        ax.scatter(
            said, was, s=25 + 500 * weight, color="C0", alpha=0.8, zorder=3,
            label="answers of similar probability,\nand their share of all windows",
        )  # fmt: skip
        for x, y, share in zip(said, was, weight, strict=True):
            # Away from the diagonal, where neighbours lie.
            above = 1 if x < y < _LABELLED_ABOVE else -1
            ax.annotate(
                f"{100 * share:.0f} %", (x, y), xytext=(0, above * 15), textcoords="offset points",
                ha="center", va="center", fontsize="small",
            )  # fmt: skip
        ax.text(0.03, 0.97, "too careful:\nright more often than stated", va="top", color=faint)
        ax.text(0.97, 0.03, "too sure:\nright less often than stated", ha="right", color=faint)
        ax.set(aspect="equal", xlim=(0, 1.04), ylim=(-0.06, 1.06))
        ax.set_xlabel("probability that the counter gave its answer")
        ax.set_ylabel("share of these answers that were right")
        ax.grid(alpha=0.3, linewidth=0.6)
        legend_above(ax, markerscale=0.5)
        return self
