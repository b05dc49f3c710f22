"""Permutation tests of many cells at once, with p adjusted within and across families."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap.summaries.summarise import FAMILIES, Cell, smallest_spreads
from cyclofeat.gap.summaries.turns import uncorrelating_matrix

Float = NDArray[np.float64]

SPREADS = "spreads"
# Its value is the size of all differences together, above the median under permuted labels.
TOGETHER = Cell("together", "all cells together", "1")


class Permuted:
    """Studentised differences of all cells, and their values under permuted labels.

    The order is: differences of means; ratios of variances in dB over their standard deviation under permuted
    labels; the difference of all means together.
    """

    def __init__(
        self,
        measured: Float,
        simulated: Float,
        n: int,
        random: np.random.Generator,
        smallest: Float | float = 0.0,
        wider: Float | float = 1.0,
    ) -> None:
        pooled = np.vstack([measured, simulated])
        first = len(measured)
        total, share = len(pooled), 1 / len(measured) + 1 / len(simulated)
        deviations = pooled - pooled.mean(axis=0)
        squares = np.sum(deviations**2, axis=0)
        choices = np.zeros((n + 1, total))
        choices[0, :first] = 1
        for row in choices[1:]:
            row[random.choice(total, first, replace=False)] = 1
        sums = choices @ deviations
        # Mean of the chosen minus mean of the rest; the deviations of all add up to zero.
        differences = sums / first + sums / (total - first)
        between = differences**2 / share
        variances = np.maximum(squares - between, 0.0) / (total - 2)
        floor = np.square(smallest)
        with np.errstate(invalid="ignore", divide="ignore"):
            errors = np.sqrt((variances + floor) * share)
            t = np.where(errors > 1e-9 * np.sqrt(squares + 1e-300), differences / errors, 0.0)
        chosen = choices @ deviations**2
        inside = np.maximum(chosen - sums**2 / first, 0.0) / (first - 1)
        outside = np.maximum(squares - chosen - sums**2 / (total - first), 0.0) / (total - first - 1)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratios = 10 * np.log10((inside + floor) / (outside + floor))
        ratios = np.nan_to_num(ratios, nan=0.0, posinf=0.0, neginf=0.0)
        # With few recordings the ratio of variances is biased towards small values: subtract its median.
        ratios = ratios - np.median(ratios[1:], axis=0)
        deviation = np.maximum(ratios.std(axis=0), 1e-9)
        # All means together: Hotelling's statistic with a shrunk covariance that ignores the labels.
        scale = np.sqrt(squares / (total - 2) + floor)
        turn = uncorrelating_matrix(deviations / np.where(scale > 0, scale, 1.0))
        # Only the measured set may come from one assembly; permuted sets mix many.
        t[0] /= wider
        in_scales = differences / np.where(scale > 0, scale, 1.0)
        in_scales[0] /= wider
        together = np.sqrt(np.mean((in_scales @ turn) ** 2, axis=1) / share)
        together = (together - np.median(together[1:]))[:, np.newaxis]
        beyond = max(float(together[1:].std()), 1e-9)
        self.differences = np.concatenate([differences[0], ratios[0], together[0]])
        self.errors = np.concatenate([errors[0] * wider, deviation, [beyond]])
        ratios = np.where(deviation > 1e-6, ratios / deviation, 0.0)
        # One-sided: recordings with a common speed, load or assembly spread less, which is no disagreement.
        self.t = np.hstack([np.abs(t), np.maximum(ratios, 0.0), np.maximum(together, 0.0) / beyond])
        self.spreads = np.concatenate([errors[0] / np.sqrt(share), deviation, [beyond]])

    def step_down(self, at: NDArray[np.intp]) -> Float:
        """Adjusted p of the chosen cells (Westfall and Young 1993, step-down maximum)."""
        t = self.t[:, at]
        order = np.argsort(-t[0])
        adjusted = np.empty(len(at))
        largest = np.zeros(len(t))
        # In ascending order of the statistics: maximum over this one and all smaller ones.
        for k in order[::-1]:
            largest = np.maximum(largest, t[:, k])
            adjusted[k] = np.mean(largest >= t[0, k])
        adjusted[order] = np.maximum.accumulate(adjusted[order])
        return adjusted


def statistics_by_family(cells: list[Cell]) -> dict[str, NDArray[np.intp]]:
    """Indices of each family's statistics: means by family, all spreads (with long tails), all means."""
    names = np.array([cell.family for cell in cells])
    of_means = {family: np.flatnonzero(names == family) for family in FAMILIES if np.any(names == family)}
    return of_means | {
        SPREADS: np.arange(len(cells), 2 * len(cells)),
        TOGETHER.family: np.array([2 * len(cells)]),
    }


def family_p(
    measured: Float, simulated: Float, cells: list[Cell], n: int, random: np.random.Generator
) -> dict[str, float]:
    """Return the p of each family of cells, adjusted over its cells and over the families."""
    statistics = Permuted(measured, simulated, n, random, smallest_spreads(cells))
    return holm(
        {family: float(statistics.step_down(at).min()) for family, at in statistics_by_family(cells).items()}
    )


def holm(p: dict[str, float]) -> dict[str, float]:
    """Adjusted p across families (Holm 1979)."""
    adjusted, largest = {}, 0.0
    for rank, family in enumerate(sorted(p, key=lambda name: p[name])):
        largest = max(largest, min(p[family] * (len(p) - rank), 1.0))
        adjusted[family] = largest
    return adjusted
