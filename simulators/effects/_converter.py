"""Effects of the converter (ADC): its sampling instants and its codes."""

from __future__ import annotations

import functools
import math
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.stats import loguniform, norm

from cyclofeat._base.checks import one_of
from cyclofeat.simulators._jit import njit
from cyclofeat.simulators._lines import between
from cyclofeat.simulators.effects._base import Effect, Float, Place, TorqueContext
from cyclofeat.simulators.effects._numbers import EffectParameter

# Samples on either side of an instant from which its value is interpolated, and shape of the window (Kaiser).
# The error is below 1e-5 of a wave up to 0.9 of the Nyquist frequency.
_HALF_WIDTH = 48
_BETA = 10.0
# Fractions of a sample at which the weights are tabulated: linear interpolation has an error of 2e-6.
_FRACTIONS = 512


class ClockError(Effect):
    """Error of the converter's clock: the true sampling rate is not the stated one.

    With relative error r the samples lie at k / ((1 + r) f_s) while the record states f_s: a line at f
    appears at f / (1 + r). The values in between come from a windowed sinc (Kaiser, 48 samples on either
    side); the record's other channels, sampled by the same clock, are moved along by straight lines.

    Parameters
    ----------
    relative : float or (low, high), default 2e-4
        r, a pure number; 0 is neutral.

    Notes
    -----
    Where the samples given do not reach so far (r < 0), the result is shorter; where they reach further, it
    is longer. Separating measurement: a tachometer on its own clock; an error of the speed changes the lines
    of shaft and lobes, but not hum.
    """

    place = Place.ADC_CLOCK
    parameters: ClassVar = {"relative": EffectParameter("1", -0.05, 0.05, 0.0, norm(0.0, 1e-3), default=2e-4)}
    separated_by = "a tachometer on its own clock"

    def samples_needed(self, n_samples: int) -> int:
        if self.relative == 0:
            return n_samples
        return math.ceil((n_samples - 1) / (1 + float(self.relative))) + 1 + _HALF_WIDTH

    def _instants(self, n_given: int) -> Float:
        """Instants of the new samples, in samples of the given record."""
        rate = 1 + float(self.relative)
        n_samples = math.floor((n_given - 1) * rate) + 1
        return np.asarray(np.minimum(np.arange(n_samples) / rate, n_given - 1))

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        if self.relative == 0:
            return torque
        return np.asarray(_interpolated(torque, self._instants(torque.size), _weight_table()))

    def resample(self, values: Float, sampling_rate: float) -> Float:
        if self.relative == 0:
            return values
        return between(values, self._instants(len(values)))


@functools.cache
def _weight_table() -> Float:
    """Windowed sinc (Kaiser) at fractions 0 to 1 of a sample (rows), for the samples around it (columns)."""
    distance = np.linspace(0, 1, _FRACTIONS + 1)[:, None] - np.arange(1 - _HALF_WIDTH, _HALF_WIDTH + 1)
    inside = np.clip(1 - (distance / _HALF_WIDTH) ** 2, 0, None)
    return np.asarray(np.sinc(distance) * np.i0(_BETA * np.sqrt(inside)))


@njit(fastmath={"reassoc", "contract"})  # sums in any order
def _interpolated(torque: Float, instants: Float, table: Float) -> Float:
    """Torque at instants in samples; samples beyond the ends get no weight."""
    result = np.empty(instants.size)
    for i in range(instants.size):
        nearest = math.floor(instants[i])
        place = (instants[i] - nearest) * _FRACTIONS
        row = min(int(place), _FRACTIONS - 1)
        share = place - row
        first = nearest + 1 - _HALF_WIDTH
        total = weights = 0.0
        for j in range(max(0, -first), min(2 * _HALF_WIDTH, torque.size - first)):
            weight = (1 - share) * table[row, j] + share * table[row + 1, j]
            total += weight * torque[first + j]
            weights += weight
        result[i] = total / weights
    return result


class Quantisation(Effect):
    """Codes of the converter: torque in whole steps (LSB), clipped at the ends of its range.

    T becomes q c with the code c = T/q rounded to the nearest whole number (half to even), limited to -N <= c
    <= N - 1 with N = floor(full scale / q). Separating measurement: the comb of the histogram, which noise
    does not have.

    Parameters
    ----------
    lsb_nm : float or (low, high), default 0.05
        Step q in Nm; 0 for none.
    full_scale_nm : float or (low, high), default infinity
        Range from -full_scale_nm to just below full_scale_nm, in Nm; infinity (``null`` in files) never
        clips. Set by hand: neither fitted nor drawn from a prior.
    """

    place = Place.ADC_CODES
    parameters: ClassVar = {
        "lsb_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, loguniform(2e-3, 1.0), log=True, default=0.05),
        "full_scale_nm": EffectParameter("Nm", 1e-6, math.inf, math.inf, log=True),
    }
    separated_by = "the comb of the histogram"

    def check_settings(self) -> None:
        if self.has_spread or self.lsb_nm <= self.full_scale_nm:
            return
        raise ValueError(
            f"full_scale_nm of {self.effect_id} must be at least lsb_nm = {self.lsb_nm:g} Nm, "
            f"got {self.full_scale_nm!r}"
        )

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        step, full = float(self.lsb_nm), float(self.full_scale_nm)
        if step == 0:
            return torque if math.isinf(full) else np.clip(torque, -full, full)
        codes = np.rint(torque / step)
        if math.isfinite(full):
            # By rounding, a full scale of N steps may give slightly less than N.
            n_codes = math.floor(full / step * (1 + 1e-12))
            codes = np.clip(codes, -n_codes, n_codes - 1)
        return np.asarray(step * codes)


class Clipping(Effect):
    """Clipping: amplifier or converter saturate at a torque.

    T is limited to -L to L, as by the ``full_scale_nm`` of :class:`Quantisation`, but without steps and with
    a prior (*an assumption*, for loads of some 22 Nm). A saturated amplifier that recovers late is not
    modelled. Separating measurement: a lower load, or a lower gain of the amplifier.

    Parameters
    ----------
    limit_nm : float or (low, high), default 25
        L in Nm; infinity (``null`` in files) is neutral.
    """

    place = Place.ADC_CODES
    parameters: ClassVar = {
        "limit_nm": EffectParameter(
            "Nm", 1e-6, math.inf, math.inf, loguniform(12.0, 40.0), log=True, default=25.0
        )
    }
    separated_by = "a lower load, or a lower gain of the amplifier"

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        limit = float(self.limit_nm)
        return torque if math.isinf(limit) else np.clip(torque, -limit, limit)


class LostSamples(Effect):
    """Lost samples: the transfer of the record loses a block of them now and then.

    In each stretch of ``block``/``share`` samples one block at a random place is lost. The block holds the
    last value before it, is zero, or is cut out, so that what follows comes too early. Only the torque's
    channel loses samples: an angle recorded beside it stays, and no longer matches a torque with samples cut
    out.
    Separating measurement: a tachometer in the same channel, or a counter of samples.

    Parameters
    ----------
    share : float or (low, high), default 0.03
        Share of the samples that is lost, a pure number; 0 is neutral.
    block : float or (low, high), default 64
        Length of a block in samples, rounded to whole ones.
    fill : {"hold", "zero", "cut"}, default "hold"
        What stands in the place of the block.
    """

    place = Place.ADC_CODES
    parameters: ClassVar = {
        "share": EffectParameter("1", 0.0, 0.5, 0.0, loguniform(5e-3, 0.1), log=True),
        "block": EffectParameter("1", 1.0, 1e6, None, loguniform(4.0, 256.0), log=True),
    }
    separated_by = "a tachometer in the same channel, or a counter of samples"

    def __init__(self, share: Any = 0.03, block: Any = 64.0, fill: str = "hold") -> None:
        self.share = share
        self.block = block
        self.fill = fill

    def check_settings(self) -> None:
        one_of(f"fill of {self.effect_id}", self.fill, ("hold", "zero", "cut"))

    def samples_needed(self, n_samples: int) -> int:
        if self.share == 0 or self.fill != "cut":
            return n_samples
        # At most one block more than the share is lost.
        return math.ceil((n_samples + self._length) / (1 - float(self.share))) + 1

    @property
    def _length(self) -> int:
        return round(float(self.block))

    def _lost(self, n_samples: int, random: Generator) -> NDArray[np.bool_]:
        stretch = self._length / float(self.share)
        places = random.random(math.ceil(n_samples / stretch)) * (1 - float(self.share))
        starts = np.floor((np.arange(places.size) + places) * stretch).astype(int)
        lost = np.zeros(math.ceil(places.size * stretch), dtype=bool)
        lost[starts[:, None] + np.arange(self._length)] = True
        return lost[:n_samples]

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        if self.share == 0 or torque.size == 0:
            return torque
        lost = self._lost(torque.size, random)
        if self.fill == "cut":
            return np.asarray(torque[~lost])
        if self.fill == "zero":
            return np.where(lost, 0.0, torque)
        # A block at the beginning repeats the first sample.
        return np.asarray(torque[np.maximum.accumulate(np.where(lost, 0, np.arange(torque.size)))])
