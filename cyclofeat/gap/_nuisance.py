"""What recordings of one session have in common: their speed, their load, and the assembly."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap._summaries import Cell

Float = NDArray[np.float64]

_MARGIN = 2.0  # in what is no difference of consequence
_LOAD = "mean"
_SPEEDS = ("input speed by the tachometer", "input speed by the mesh lines")  # the first that is there


class SpeedAndLoad:
    """The part of summaries that follows the recording's own speed and mean torque.

    Straight lines through simulated recordings say how each cell moves with both. A speed or a mean torque
    counts as explained as far as simulated recordings go, and no farther: all recordings of a session may be
    at the end of what the prior allows, none beyond it.

    Parameters
    ----------
    simulated : ndarray, shape (n_bank, n_cells)
        Summaries of simulated recordings less the mean of their count.
    cells : list of Cell
    smallest : ndarray, shape (n_cells,)
        What is no difference of consequence in each cell: twice as much farther than simulated recordings go
        counts as explained too.
    """

    def __init__(self, simulated: Float, cells: list[Cell], smallest: Float) -> None:
        names = [cell.name for cell in cells]
        speed = next(name for name in _SPEEDS if name in names)
        self._at = [names.index(speed), names.index(_LOAD)]
        own = simulated[:, self._at]
        self._smallest = smallest[self._at]
        margin = _MARGIN * self._smallest
        self._low, self._middle, self._high = (
            own.min(axis=0) - margin,
            own.mean(axis=0),
            own.max(axis=0) + margin,
        )
        self._slopes = np.linalg.lstsq(own - self._middle, simulated, rcond=1e-6)[0]

    def without(self, values: Float) -> Float:
        """Summaries less that part, (n, n_cells)."""
        own = values[:, self._at]
        explained = np.clip(own, self._low, self._high)
        left = values - (explained - self._middle) @ self._slopes
        # Exactly 0 where nothing of consequence is left, or ranks would make much of it; else whole.
        left[:, self._at] = np.where(np.abs(own - explained) < self._smallest, 0.0, own - self._middle)
        return np.asarray(left)


def alikeness(values: Float, assemblies: NDArray[Any]) -> Float:
    """Share of each cell's variance that recordings of one assembly have in common, shape (n_cells,).

    The intraclass correlation by one-way analysis of variance, (A - W) / (A + (k - 1) W) with the mean
    squares A among and W within assemblies of k recordings (Fisher 1925), not below 0.

    Parameters
    ----------
    values : ndarray, shape (n, n_cells)
    assemblies : ndarray, shape (n,)
        Assembly of each row.
    """
    names, of, sizes = np.unique(assemblies, return_inverse=True, return_counts=True)
    means = np.array([values[of == k].mean(axis=0) for k in range(len(names))])
    within = np.sum((values - means[of]) ** 2, axis=0) / (len(values) - len(names))
    among = np.sum(sizes[:, None] * (means - values.mean(axis=0)) ** 2, axis=0) / (len(names) - 1)
    # Of unequal sizes: what stands for k in the expected mean square.
    k = (len(values) - np.sum(sizes**2) / len(values)) / (len(names) - 1)
    total = among + (k - 1) * within
    return np.asarray(np.clip((among - within) / np.where(total > 0, total, 1.0), 0.0, 1.0))


def widening(alike: Float, n: int) -> Float:
    """Factor on the standard error of the mean of n recordings of one assembly, shape (n_cells,).

    They count as n / (1 + (n - 1) r) recordings, with the share r of the variance that they have in common
    (Kish 1965).
    """
    return np.asarray(np.sqrt(1 + (n - 1) * alike))
