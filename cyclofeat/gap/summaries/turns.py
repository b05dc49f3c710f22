"""Measured recordings: checked, cut to whole output turns, collected by recording."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.covariance import LedoitWolf
from sklearn.utils.validation import check_array

from cyclofeat.gap.summaries.summarise import Cell, Kinematics, summarise_windows
from cyclofeat.signal.orders import mean_speed

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


def read_measured(
    kinematics: Kinematics,
    X: ArrayLike,
    y: ArrayLike | None,
    groups: ArrayLike | None,
    angle: ArrayLike | None,
) -> MeasuredTurns:
    """Check measured recordings and cut them to whole output turns: see :meth:`Comparison.measured`."""
    windows = check_array(X, dtype=[np.float64, np.float32], input_name="X")
    of_window, counts = recordings_of(len(windows), y, groups)
    if counts is not None and counts.max() > kinematics.n_lobes:
        raise ValueError(f"y must hold counts from 0 to the {kinematics.n_lobes} lobes, got {counts.max()}")
    n_samples = kinematics.whole_turns(windows.shape[1])
    speeds = None
    if angle is not None:
        angles = np.asarray(angle, dtype=float)
        if angles.shape != windows.shape:
            raise ValueError(f"angle must have the shape of X, {windows.shape}, got {angles.shape}")
        if not np.all(np.isfinite(angles)):
            raise ValueError("angle must be finite, got NaN or infinity")
        speeds = mean_speed(angles[:, :n_samples], kinematics.sampling_rate)
        if np.any(speeds <= 0):
            raise ValueError(
                "angle must grow over each window: it is the input shaft's, in rad and unwrapped"
            )
    # Same precision as simulated recordings: otherwise the share of distinct values would differ.
    return MeasuredTurns(windows[:, :n_samples].astype(np.float32), of_window, counts, speeds, kinematics)


def recordings_of(
    n_windows: int, y: ArrayLike | None, groups: ArrayLike | None
) -> tuple[NDArray[np.intp], NDArray[np.int64] | None]:
    """Recording of each window, numbered from 0, and each recording's count where counts are known."""
    names = np.arange(n_windows) if groups is None else np.asarray(groups)
    if names.shape != (n_windows,):
        raise ValueError(
            f"groups must hold one recording per window: shape ({n_windows},), got {names.shape}"
        )
    if any(name is None or name != name for name in names.tolist()):
        raise ValueError("groups must name the recording of every window, got None or NaN")
    _, of_window = np.unique(names, return_inverse=True)
    if y is None:
        return of_window, None
    labels = np.asarray(y)
    if labels.shape != (n_windows,):
        raise ValueError(f"y must hold one count per window: shape ({n_windows},), got {labels.shape}")
    try:
        numbers = labels.astype(np.float64)
    except (TypeError, ValueError):
        numbers = np.full(n_windows, np.nan)
    if not np.all(np.isfinite(numbers) & (numbers >= 0) & (numbers == np.round(numbers))):
        got = ", ".join(sorted({repr(label) for label in labels.tolist()}))
        raise ValueError(f"y must hold whole numbers of worn lobes from 0, got {got}")
    counts = numbers.astype(np.int64)
    first = np.array([counts[of_window == k][0] for k in range(of_window.max() + 1)])
    if np.any(first[of_window] != counts):
        at = int(np.flatnonzero(first[of_window] != counts)[0])
        raise ValueError(f"y must be the same within a recording, got two counts in {names.tolist()[at]!r}")
    return of_window, first


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
