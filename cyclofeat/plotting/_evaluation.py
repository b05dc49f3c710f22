"""Confusion and calibration of an evaluation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Self

from cyclofeat.plotting.drawing import Display, axes_for, legend_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cyclofeat.counting import Evaluation


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

    @property
    def side(self) -> float:
        """Side of the confusion matrix in inches."""
        return 1.6 + 0.45 * self.result.classes.size

    def plot(
        self,
        kind: Literal["confusion", "calibration"] = "confusion",
        ax: Axes | None = None,
        *,
        cmap: str = "Blues",
    ) -> Self:
        """Draw.

        Parameters
        ----------
        kind : {"confusion", "calibration"}, default="confusion"
            Windows by true and predicted count, or the share of right answers by the probability that the
            counter gave them; larger dots hold more of the windows.
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        cmap : str, default="Blues"
            Name of the colour map of the confusion matrix.

        Raises
        ------
        ValueError
            If there is no such kind, or the counter gave no probabilities.
        """
        if kind not in ("confusion", "calibration"):
            raise ValueError(f"kind must be 'confusion' or 'calibration', got {kind!r}")
        if kind == "calibration":
            return self._draw_calibration(ax)
        self.figure_, self.ax_ = axes_for(ax, (self.side, self.side))
        from sklearn.metrics import ConfusionMatrixDisplay

        labels = [str(count) for count in self.result.classes]
        ConfusionMatrixDisplay(self.result.confusion, display_labels=labels).plot(
            ax=self.ax_, cmap=cmap, colorbar=False
        )
        self.ax_.set(xlabel="predicted number of worn lobes", ylabel="true number of worn lobes")
        return self

    def _draw_calibration(self, ax: Axes | None) -> Self:
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
            ax.annotate(
                f"{100 * share:.0f} %", (x, y), xytext=(0, -17), textcoords="offset points", ha="center",
                fontsize="small",
            )  # fmt: skip
        ax.text(0.03, 0.97, "too careful:\nright more often than stated", va="top", color=faint)
        ax.text(0.97, 0.03, "too sure:\nright less often than stated", ha="right", color=faint)
        settings: dict[str, Any] = {"aspect": "equal", "xlim": (0, 1.04), "ylim": (-0.06, 1.06)}
        ax.set(
            xlabel="probability that the counter gave its answer",
            ylabel="share of these answers that were right",
            **settings,
        )
        ax.grid(alpha=0.3, linewidth=0.6)
        legend_above(ax, markerscale=0.5)
        return self
