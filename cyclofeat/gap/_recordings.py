"""Windows into recordings: whole output turns, the recording of each window, speeds by a tachometer."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]


def registered(X: NDArray[Any], sampling_rate: float, input_speed_hz: float, n_lobes: int) -> NDArray[Any]:
    """Windows cut to whole output turns at the nominal speed, the first ones."""
    turn = n_lobes / input_speed_hz * sampling_rate
    whole = math.floor(X.shape[1] / turn + 0.01)
    if whole < 1:
        raise ValueError(
            f"X must hold windows of at least one output turn ({turn / sampling_rate:.3g} s), got "
            f"{X.shape[1] / sampling_rate:.3g} s"
        )
    return X[:, : min(round(whole * turn), X.shape[1])]


def recordings_of(
    n_windows: int, y: ArrayLike | None, groups: ArrayLike | None
) -> tuple[NDArray[np.intp], NDArray[np.int64] | None]:
    """Number of each window's recording, from 0, and each recording's count where counts are known."""
    names = np.arange(n_windows) if groups is None else np.asarray(groups)
    if names.shape != (n_windows,):
        raise ValueError(
            f"groups must hold one recording per window: shape ({n_windows},), got {names.shape}"
        )
    _, of_window = np.unique(names, return_inverse=True)
    if y is None:
        return of_window, None
    labels = np.asarray(y)
    if labels.shape != (n_windows,):
        raise ValueError(f"y must hold one count per window: shape ({n_windows},), got {labels.shape}")
    counts = labels.astype(np.int64)
    if np.any(counts != labels) or np.any(counts < 0):
        raise ValueError(f"y must hold whole numbers of worn lobes from 0, got {np.unique(labels).tolist()}")
    first = np.array([counts[of_window == k][0] for k in range(of_window.max() + 1)])
    if np.any(first[of_window] != counts):
        at = int(np.flatnonzero(first[of_window] != counts)[0])
        raise ValueError(f"y must be the same within a recording, got two counts in {names.tolist()[at]!r}")
    return of_window, first


def mixed(counts: NDArray[np.int64], n: int) -> list[int]:
    """The counts in an order whose every beginning holds them in about equal shares.

    Each once where there are more of them than the n recordings that will be simulated.
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


def mean_speeds(angle: ArrayLike, shape: tuple[int, ...], sampling_rate: float) -> Float:
    """Mean input speed of each window in Hz, from its angle in rad."""
    angles = np.asarray(angle, dtype=float)
    if angles.shape != shape:
        raise ValueError(f"angle must have the shape of X, {shape}, got {angles.shape}")
    if not np.all(np.isfinite(angles)):
        raise ValueError("angle must be finite")
    turned = angles[:, -1] - angles[:, 0]
    if np.any(turned <= 0):
        raise ValueError("angle must grow over each window: it is the input shaft's, in rad and unwrapped")
    return np.asarray(turned / (2 * np.pi * (shape[1] - 1)) * sampling_rate)
