"""Page of a ranking of features: its table, histograms by count, and the code for the best of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.quantities import number_of
from cyclofeat.plotting.drawing import legend_above
from cyclofeat.report._report import Report

if TYPE_CHECKING:
    import os

    import pandas as pd
    from matplotlib.axes import Axes

    from cyclofeat.features import TorqueFeatures

_N_HISTOGRAMS = 8
_N_CHOSEN = 5
_MEANING = (
    "Trend: rank correlation of assemblies with the count, from -1 to 1; monotonicity: steps of the class "
    "means upwards less those downwards, over all steps; both with 95 % bootstrap intervals over assemblies. "
    "Mutual information in bits. p-values of the one-way analysis of variance and the Kruskal-Wallis test "
    "are adjusted for the number of features; they tell whether counts differ, in any order."
)
_CODE = """from cyclofeat import Windower
from cyclofeat.datasets import read_folder
from cyclofeat.features import TorqueFeatures

X, y, groups = Windower().transform(read_folder("measured/"))
features = {transformer}
table = features.set_output(transform="pandas").fit_transform(X, y)
chosen = table[{chosen}]"""


def write_features_report(
    table: pd.DataFrame, features: pd.DataFrame, y: ArrayLike, groups: ArrayLike,
    path: str | os.PathLike[str], *, transformer: TorqueFeatures,
) -> Path:  # fmt: skip
    """Write the page of a ranking of features as one HTML file, and return its path.

    ``table`` is that of :func:`cyclofeat.counting.rank_features` of the ``features``, which an equal
    ``transformer`` computes.
    """
    labels = np.asarray(y)
    page = Report("Which features depend on the number of worn lobes?")
    assemblies = number_of(len(set(np.asarray(groups).tolist())), "assembly")
    page.add_text(
        f"{number_of(len(table), 'feature')} of {number_of(len(labels), 'window')} of {assemblies}. "
        f"The most gradual come first. {_MEANING}"
    )
    page.add_heading("Histograms of the most gradual")
    for name in table.index[:_N_HISTOGRAMS]:
        low, high = table.trend_low[name], table.trend_high[name]
        trend = f"trend {table.trend[name]:+z.2f}, {low:+z.2f} to {high:+z.2f}"
        page.add_figure(_Histogram(features[name].to_numpy(), labels), f"{name}: {trend}", size=(8.0, 2.6))
    page.add_heading(f"Code for the {min(_N_CHOSEN, len(table))} most gradual")
    chosen = ",\n    ".join(map(repr, table.index[:_N_CHOSEN]))
    page.add_code(_CODE.format(transformer=transformer, chosen=f"[\n    {chosen},\n]"))
    page.add_heading("All features")
    return page.add_table(table).write(path)


@dataclass(frozen=True, eq=False)
class _Histogram:
    """Histogram of a feature's windows for each count."""

    values: NDArray[Any]
    labels: NDArray[Any]

    def plot(self, ax: Axes) -> None:
        bins: Any = np.histogram_bin_edges(self.values, 30)
        counts = np.unique(self.labels)
        for k, count in enumerate(counts):
            shade = 0.15 + 0.7 * k / max(len(counts) - 1, 1)
            look: dict[str, Any] = {"color": ("C0", shade), "edgecolor": "C0", "linewidth": 0.6}
            ax.hist(self.values[self.labels == count], bins, label=f"{count} worn", **look)
        ax.set(ylabel="windows")
        legend_above(ax, ncols=len(counts))
