"""Low-passed noise, for the drifts of load and sensor and the wander of speed."""

from __future__ import annotations

import functools
import math
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt
from scipy.stats import loguniform

from cyclofeat._base.checks import whole
from cyclofeat.simulators._lines import on_lines
from cyclofeat.simulators.effects._base import Effect, Float
from cyclofeat.simulators.effects._numbers import EffectParameter

# Samples of the process per period of its cutoff, interpolated linearly. Near half of that rate the bilinear
# filter attenuates more than the analogue one: FINE is for levels compared in that range.
OVERSAMPLING = 200
FINE = 1000
# Time beyond the requested duration, in s: a simulation is longer, for its anti-alias filter.
MARGIN = 1.0


class Drift(Effect):
    """Base of the drifts in Nm: rms, cutoff and order of their low-pass."""

    parameters: ClassVar = {
        "rms_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, loguniform(0.1, 6.0), log=True),
        "cutoff_hz": EffectParameter("Hz", 1e-3, 1e3, None, loguniform(0.2, 20.0), log=True),
    }
    separated_by = "the envelope of the mesh frequency"

    def __init__(self, rms_nm: Any = 3.0, cutoff_hz: Any = 1.5, order: int = 2) -> None:
        self.rms_nm = rms_nm
        self.cutoff_hz = cutoff_hz
        self.order = order

    def check_settings(self) -> None:
        check_order(self, self.order)


def check_order(effect: Effect, order: Any) -> None:
    """Raise TypeError or ValueError unless a Butterworth low-pass can have this order."""
    whole(f"order of {effect.effect_id}", order, 1, 8)


def decay_time(cutoff: float, order: int) -> float:
    """Return the time in s in which the slowest pole of a Butterworth low-pass decays to 1e-9."""
    slowest = 2 * np.pi * cutoff * math.sin(np.pi / (2 * order))
    return math.log(1e9) / slowest


def seed_from(random: Generator) -> NDArray[np.int64]:
    """Draw the seed of one process."""
    return random.integers(2**63, size=4)


class LowPassed:
    """Stationary low-passed noise with the given expected rms, as a function of time from 0 to ``end`` (s).

    It is made at its first use, from its seed: planned runs wait without their noise.
    """

    def __init__(
        self,
        seed: NDArray[np.int64],
        rms: float,
        low_pass: tuple[float, int],
        end: float,
        oversampling: int = FINE,
    ) -> None:
        self._seed, self._rms, (self._cutoff, self._order) = seed, rms, low_pass
        self._end, self._oversampling = end, oversampling

    @functools.cached_property
    def knots(self) -> tuple[Float, Float]:
        """Times in s, and the values between which lines are straight."""
        rate = self._oversampling * self._cutoff
        warm_up = math.ceil(decay_time(self._cutoff, self._order) * rate)
        sos, power = _low_pass(self._cutoff, self._order, warm_up, self._oversampling)
        n = math.ceil(self._end * rate) + 1
        noise = np.random.default_rng(self._seed).normal(size=warm_up + n)
        return np.arange(n) / rate, self._rms / math.sqrt(power) * sosfilt(sos, noise)[warm_up:]

    def __call__(self, time: Float) -> Float:
        """Return the values at increasing times in s; raise ValueError for times outside 0 to the end."""
        return np.asarray(on_lines(checked_time(time, self._end), *self.knots))


@functools.lru_cache(maxsize=64)
def _low_pass(cutoff: float, order: int, n: int, oversampling: int) -> tuple[Float, float]:
    """Return the filter and the mean square of its response of ``n`` samples to white noise."""
    sos: Float = butter(order, cutoff, fs=oversampling * cutoff, output="sos")
    response = sosfilt(sos, np.r_[1.0, np.zeros(n)])
    # Averaged over its length, a straight line between two samples has 2/3 of their variance plus 1/3 of
    # their covariance.
    return sos, 2 / 3 * float(response @ response) + 1 / 3 * float(response[1:] @ response[:-1])


def checked_time(time: Any, end: float) -> Float:
    """Return times as an array; raise ValueError for times outside 0 to ``end`` (s)."""
    times = np.asarray(time, dtype=float)
    if times.size and not (times.min() >= 0 and times.max() <= end):
        raise ValueError(
            f"time must lie between 0 and {end:g} s in this drift, got {times.min():g} to "
            f"{times.max():g} s: draw it with a longer duration"
        )
    return times
