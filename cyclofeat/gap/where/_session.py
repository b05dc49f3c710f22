"""Corrections for what recordings of one session have in common: speed, load and assembly."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.gap.summaries import Cell

Float = NDArray[np.float64]

_MARGIN = 2.0  # times the smallest difference of consequence
_LOAD = "mean"
_SPEEDS = ("input speed by the tachometer", "input speed by the mesh lines")  # in order of preference


class SpeedAndLoad:
    """Removal of the part of summaries that follows a recording's own speed and mean torque.

    A linear regression of the ``simulated`` summaries (n_bank, n_cells), less the mean of their count, gives
    the change of each cell with speed and mean torque. It is applied within the range of the simulated
    recordings, widened by twice the ``smallest`` difference of consequence: all recordings of a session may
    lie at one end of the allowed range, but not beyond it.
    """

    def __init__(self, simulated: Float, cells: list[Cell], smallest: Float) -> None:
        names = [cell.name for cell in cells]
        speed = next(name for name in _SPEEDS if name in names)
        self._at = [names.index(speed), names.index(_LOAD)]
        of_recordings = simulated[:, self._at]
        self._smallest = smallest[self._at]
        margin = _MARGIN * self._smallest
        self._low, self._high = of_recordings.min(axis=0) - margin, of_recordings.max(axis=0) + margin
        self._middle = of_recordings.mean(axis=0)
        self._slopes = np.linalg.lstsq(of_recordings - self._middle, simulated, rcond=1e-6)[0]

    def without(self, values: Float) -> Float:
        """Return summaries without that part, (n, n_cells)."""
        of_recordings = values[:, self._at]
        explained = np.clip(of_recordings, self._low, self._high)
        rest = of_recordings - self._middle
        left = values - (explained - self._middle) @ self._slopes
        # Exactly 0 where the remainder has no consequence: a test would exaggerate it. Else unchanged.
        left[:, self._at] = np.where(np.abs(of_recordings - explained) < self._smallest, 0.0, rest)
        return np.asarray(left)


def intraclass_correlation(values: Float, assemblies: NDArray[Any]) -> Float:
    """Share of each cell's variance that recordings of one assembly have in common, shape (n_cells,).

    One-way analysis of variance: (A - W) / (A + (k - 1) W) with the mean squares A among and W within
    assemblies of k recordings (Fisher 1925), not below 0.
    """
    names, of, sizes = np.unique(assemblies, return_inverse=True, return_counts=True)
    means = np.array([values[of == k].mean(axis=0) for k in range(len(names))])
    within = np.sum((values - means[of]) ** 2, axis=0) / (len(values) - len(names))
    among = np.sum(sizes[:, None] * (means - values.mean(axis=0)) ** 2, axis=0) / (len(names) - 1)
    # Effective k for assemblies of unequal size (from the expected mean square).
    k = (len(values) - np.sum(sizes**2) / len(values)) / (len(names) - 1)
    total = among + (k - 1) * within
    return np.asarray(np.clip((among - within) / np.where(total > 0, total, 1.0), 0.0, 1.0))


def widening(shared: Float, n: int) -> Float:
    """Factor on the standard error of the mean of n recordings of one assembly, shape (n_cells,).

    The recordings count as n / (1 + (n - 1) r), where r is the ``shared`` part of the variance (Kish 1965).
    """
    return np.asarray(np.sqrt(1 + (n - 1) * shared))
