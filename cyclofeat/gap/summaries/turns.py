"""Measured recordings: checked, cut to whole output turns, collected by recording."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.covariance import LedoitWolf

from cyclofeat.gap.summaries.summarise import Cell, Kinematics, summarise_windows

Float = NDArray[np.float64]

# Added to every eigenvalue: an assumed share of uncorrelated variance, so that no combination is too certain.
_RIDGE = 0.05


@dataclass(frozen=True)
class MeasuredTurns:
    """Measured recordings, checked and cut to whole output turns.

    ``windows`` (n_windows, n_samples) hold torque in Nm, float32 as that of simulated recordings;
    ``of_window`` the number of the recording of each, from 0; ``counts`` (n_recordings,) worn lobes, where
    they are known; ``speeds`` (n_windows,) mean input speeds in Hz by a tachometer, or None.
    """

    windows: NDArray[np.float32] = field(repr=False)
    of_window: NDArray[np.intp] = field(repr=False)
    counts: NDArray[np.int64] | None
    speeds: Float | None = field(repr=False)
    kinematics: Kinematics

    @property
    def n_recordings(self) -> int:
        """Number of recordings."""
        return int(self.of_window.max()) + 1

    @property
    def values(self) -> Float:
        """Summaries of each recording, the mean over its windows: shape (n_recordings, n_cells)."""
        return per_recording(self._window_summaries[0], self.of_window)

    @property
    def cells(self) -> list[Cell]:
        """Columns of ``values``."""
        return self._window_summaries[1]

    @property
    def counts_or_zeros(self) -> NDArray[np.int64]:
        """Counts; all 0 where they are not known."""
        return np.zeros(self.n_recordings, dtype=np.int64) if self.counts is None else self.counts

    @functools.cached_property
    def _window_summaries(self) -> tuple[Float, list[Cell]]:
        return summarise_windows(self.windows, self.kinematics, self.speeds)


def mix_counts(counts: NDArray[np.int64], n: int) -> list[int]:
    """Order counts so that the first k have about the shares of all, for every k.

    If there are more counts than the n recordings to simulate, each occurs once.
    """
    if len(counts) > n:
        counts = np.unique(counts)
    known, repeats = np.unique(counts, return_counts=True)
    places = [
        ((k + 0.5) / total, count) for count, total in zip(known, repeats, strict=True) for k in range(total)
    ]
    return [int(count) for _, count in sorted(places)]


def per_recording(values: Float, of_window: NDArray[np.intp]) -> Float:
    """Mean over the windows of each recording, shape (n_recordings, n_columns)."""
    n = int(of_window.max()) + 1
    return np.array([values[of_window == k].mean(axis=0) for k in range(n)])


def class_means(values: Float, counts: NDArray[Any]) -> dict[int, Float]:
    """Mean of the rows of each count."""
    return {int(count): values[counts == count].mean(axis=0) for count in np.unique(counts)}


def less_class_means(values: Float, counts: NDArray[Any], means: dict[int, Float]) -> Float:
    """Rows less the mean of their count."""
    return np.asarray(values - np.array([means[int(count)] for count in counts]))


def uncorrelating_matrix(deviations: Float) -> Float:
    """Matrix W (n_cells, n_cells) for which ``deviations @ W`` has about the identity as covariance.

    The covariance is shrunk (Ledoit and Wolf 2004); deviations have about unit variance and zero mean.
    """
    covariance = LedoitWolf(store_precision=False, assume_centered=True).fit(deviations).covariance_
    power, directions = np.linalg.eigh(covariance)
    return np.asarray(directions / np.sqrt(np.maximum(power, 0.0) + _RIDGE))
