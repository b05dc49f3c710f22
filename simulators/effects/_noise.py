"""Low-passed noise: the one slow process behind the drifts of load and sensor and the wander of speed."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from cyclofeat.simulators._lines import on_lines

Float = NDArray[np.float64]

# Samples of the drift per period of its cutoff: what lies between them is joined by straight lines. Towards
# half of that rate the bilinear filter falls short of the analogue one: FINE is for levels compared there.
OVERSAMPLING = 200
FINE = 1000
HIGHEST_CUTOFF = 1000.0
HIGHEST_ORDER = 8
# Time beyond the duration asked for, in s: a simulation runs on a little, for its anti-alias filter.
MARGIN = 1.0


def decay_time(cutoff: float, order: int, share: float = 1e-9) -> float:
    """Time in s until the slowest pole of a Butterworth low-pass has fallen to a share of its start."""
    slowest = 2 * np.pi * cutoff * math.sin(np.pi / (2 * order))
    return math.log(1 / share) / slowest


def low_passed_noise(
    stream: Any, rms: float, cutoff: float, order: int, end: float, oversampling: int = OVERSAMPLING
) -> tuple[Float, Float]:
    """Times in s and values of stationary low-passed noise with the given expected rms, in its unit."""
    rate = oversampling * cutoff
    warm_up = math.ceil(decay_time(cutoff, order) * rate)
    sos, power = _low_pass(cutoff, order, warm_up, oversampling)
    n = math.ceil(end * rate) + 1
    noise = np.random.default_rng(stream).normal(size=warm_up + n)
    return np.arange(n) / rate, rms / math.sqrt(power) * sosfilt(sos, noise)[warm_up:]


@functools.lru_cache(maxsize=64)
def _low_pass(cutoff: float, order: int, n: int, oversampling: int) -> tuple[Float, float]:
    """The filter, and the mean square of what ``n`` samples of its response make of white noise."""
    sos: Float = butter(order, cutoff, fs=oversampling * cutoff, output="sos")
    response = sosfilt(sos, np.r_[1.0, np.zeros(n)])
    # A straight line between samples has, averaged over its length, 2/3 of their variance and 1/3 of their
    # covariance.
    return sos, 2 / 3 * float(response @ response) + 1 / 3 * float(response[1:] @ response[:-1])


def streams(random: np.random.Generator, n: int) -> Sequence[Any]:
    """Seeds of ``n`` independent processes."""
    return list(random.integers(2**63, size=(n, 4)))


def checked_time(time: Any, end: float) -> Float:
    """Times as an array, if the process reaches so far."""
    times = np.asarray(time, dtype=float)
    if times.size and not (times.min() >= 0 and times.max() <= end):
        raise ValueError(
            f"time must lie between 0 and {end:g} s in this drift, got {times.min():g} to "
            f"{times.max():g} s: draw it with a longer duration"
        )
    return times


def sum_of(parts: Sequence[tuple[Float, Float]], end: float) -> Callable[[Float], Float]:
    """The sum of processes given by times and values, as a function of time up to ``end`` (s)."""

    def load(time: Float) -> Float:
        time = checked_time(time, end)
        if not parts:
            return np.zeros(time.shape)
        return functools.reduce(operator.iadd, (on_lines(time, *part) for part in parts))

    return load
