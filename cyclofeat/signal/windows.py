"""Checks of windows, chunks and quotients. ``recordings.Windower`` cuts the windows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["as_windows", "check_sampling_rate", "chunks", "ratio"]

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

LARGEST = 1e100  # Nm; the fourth power of a deviation or the square in a spectrum would overflow far beyond
_CHUNK = 2**17  # numbers that are worked on at one time: 1 to 2 MiB stay in the processor's cache


def as_windows(X: ArrayLike) -> NDArray[Any]:
    """Return real, finite windows along the last axis, in their own precision."""
    X = np.asarray(X)
    if np.iscomplexobj(X):
        raise ValueError(f"X must be real, got {X.dtype}")
    if X.dtype not in (np.float32, np.float64):
        X = X.astype(np.float64)
    if X.ndim == 0 or X.shape[-1] == 0:
        raise ValueError(
            f"X must hold windows of at least one sample along its last axis, got shape {X.shape}"
        )
    if X.size:
        low, high = float(X.min()), float(X.max())
        if not (low >= -LARGEST and high <= LARGEST):  # true for NaN, too
            raise ValueError(
                f"X must be finite and within +-{LARGEST:g} Nm, got values from {low:g} to {high:g}"
            )
    return X


def chunks(n_windows: int, numbers_per_window: int) -> Iterator[slice]:
    """Slices of windows that need about ``_CHUNK`` numbers each."""
    step = max(1, _CHUNK // numbers_per_window)
    for start in range(0, n_windows, step):
        yield slice(start, min(start + step, n_windows))


def check_sampling_rate(sampling_rate: float) -> None:
    """Raise ``ValueError`` unless the sampling rate is positive and finite."""
    if not 0 < sampling_rate < np.inf:
        raise ValueError(f"sampling_rate must be positive and finite, in Hz; got {sampling_rate!r}")


def ratio(numerator: Float, denominator: Float) -> Float:
    """Divide by numbers that are not negative; zero where they are zero."""
    quotient = np.zeros_like(numerator)
    np.divide(numerator, denominator, out=quotient, where=denominator > 0)
    return quotient
