"""Windows into recordings: whole output turns, the recording of each window, speeds by a tachometer."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float = NDArray[np.float64]


def registered(X: NDArray[Any], sampling_rate: float, input_speed_hz: float, n_lobes: int) -> NDArray[Any]:
    """Windows cut to whole output turns at the nominal speed, the first ones."""
    return X[:, : in_whole_turns(X.shape[1], sampling_rate, input_speed_hz, n_lobes)]


def in_whole_turns(
    n_samples: int, sampling_rate: float, input_speed_hz: float, n_lobes: int, of: str = ""
) -> int:
    """Samples of a window in its whole output turns; ``of`` ends the argument's name in errors."""
    turn = n_lobes / input_speed_hz * sampling_rate
    whole = math.floor(n_samples / turn + 0.01)
    if whole < 1:
        raise ValueError(
            f"X{of} must hold windows of at least one output turn ({turn / sampling_rate:.3g} s), got "
            f"{n_samples / sampling_rate:.3g} s"
        )
    return min(round(whole * turn), n_samples)


def recordings_of(
    n_windows: int, y: ArrayLike | None, groups: ArrayLike | None, of: str = ""
) -> tuple[NDArray[np.intp], NDArray[np.int64] | None]:
    """Number of each window's recording, from 0, and each recording's count where counts are known.

    ``of`` ends the arguments' names in errors.
    """
    names = np.arange(n_windows) if groups is None else np.asarray(groups)
    if names.shape != (n_windows,):
        raise ValueError(
            f"groups{of} must hold one recording per window: shape ({n_windows},), got {names.shape}"
        )
    if any(name is None or name != name for name in names.tolist()):
        raise ValueError(f"groups{of} must name the recording of every window, got None or NaN")
    _, of_window = np.unique(names, return_inverse=True)
    if y is None:
        return of_window, None
    labels = np.asarray(y)
    if labels.shape != (n_windows,):
        raise ValueError(f"y{of} must hold one count per window: shape ({n_windows},), got {labels.shape}")
    try:
        numbers = labels.astype(np.float64)
    except (TypeError, ValueError):
        numbers = np.full(n_windows, np.nan)
    if not np.all(np.isfinite(numbers) & (numbers >= 0) & (numbers == np.round(numbers))):
        got = ", ".join(sorted({repr(label) for label in labels.tolist()}))
        raise ValueError(f"y{of} must hold whole numbers of worn lobes from 0, got {got}")
    counts = numbers.astype(np.int64)
    first = np.array([counts[of_window == k][0] for k in range(of_window.max() + 1)])
    if np.any(first[of_window] != counts):
        at = int(np.flatnonzero(first[of_window] != counts)[0])
        raise ValueError(
            f"y{of} must be the same within a recording, got two counts in {names.tolist()[at]!r}"
        )
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


def mean_speeds(angle: ArrayLike, shape: tuple[int, ...], sampling_rate: float, of: str = "") -> Float:
    """Mean input speed of each window in Hz, from its angle in rad; ``of`` ends the name in errors."""
    angles = np.asarray(angle, dtype=float)
    if angles.shape != shape:
        raise ValueError(f"angle{of} must have the shape of X{of}, {shape}, got {angles.shape}")
    if not np.all(np.isfinite(angles)):
        raise ValueError(f"angle{of} must be finite, got NaN or infinity")
    turned = angles[:, -1] - angles[:, 0]
    if np.any(turned <= 0):
        raise ValueError(
            f"angle{of} must grow over each window: it is the input shaft's, in rad and unwrapped"
        )
    return np.asarray(turned / (2 * np.pi * (shape[1] - 1)) * sampling_rate)
