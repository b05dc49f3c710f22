"""Effects of torque meter and converter: applied to the torque, the gearbox does not feel them."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator
from scipy.fft import next_fast_len
from scipy.signal import butter, fftconvolve, sosfilt, sosfilt_zi
from scipy.stats import loguniform, norm

from cyclofeat._base.checks import is_number, list_members, one_of
from cyclofeat.simulators._jit import njit
from cyclofeat.simulators.courses import interpolate_rows
from cyclofeat.simulators.effects._drive import check_order, check_phase, decay_time
from cyclofeat.simulators.effects.effect import Effect, EffectParameter, Float, Of, TorqueContext

# Coloured noise is white below this frequency, in Hz: its rms is finite and independent of the duration.
LOWEST_COLOURED = 1.0
# Samples on either side of an instant from which its value is interpolated, and shape of the window (Kaiser).
# The error is below 1e-5 of a wave up to 0.9 of the Nyquist frequency.
_HALF_WIDTH = 48
_BETA = 10.0
# Fractions of a sample at which the weights are tabulated: linear interpolation has an error of 2e-6. Rows
# are the fractions from 0 to 1, columns the samples around the instant.
_FRACTIONS = 512
_DISTANCE = np.linspace(0, 1, _FRACTIONS + 1)[:, None] - np.arange(1 - _HALF_WIDTH, _HALF_WIDTH + 1)
_INSIDE = np.clip(1 - (_DISTANCE / _HALF_WIDTH) ** 2, 0, None)
_WEIGHTS = np.asarray(np.sinc(_DISTANCE) * np.i0(_BETA * np.sqrt(_INSIDE)))


class _MeterEffect(Effect):
    """Base of the effects on the torque alone: a neutral effect or an empty record changes nothing."""

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        sizes = {name: one.neutral for name, one in self.parameters.items() if one.neutral is not None}
        unchanged = bool(sizes) and all(getattr(self, name) == neutral for name, neutral in sizes.items())
        if unchanged or torque.size == 0:
            return torque
        return self._distort_torque(torque, sampling_rate, random, context or TorqueContext())

    def _distort_torque(self, torque: Float, rate: float, random: Generator, context: TorqueContext) -> Float:
        """Return the torque, shape (n,) in Nm, after an effect that acts; see :meth:`change_torque`."""
        raise NotImplementedError


class TorqueMeterLowPass(_MeterEffect):
    """Low-pass in the torque meter: a causal Butterworth filter.

    |H(f)|^2 = 1 / (1 + (f/f_c)^(2n)) with f_c = ``cutoff_hz``, below the Nyquist frequency, and n =
    ``order``, by the bilinear transform, exact at 0 and f_c; near the Nyquist frequency it falls faster than
    the analogue filter. The record is continued before its first sample by its mirror image, so that the mean
    begins without a transient (of a ripple A at f above f_c, less than A f_c/f is left for some 1/f_c). The
    filter's edge stays where it is and does not ring.

    Parameters
    ----------
    order : int, default 2
        From 1 to 8.
    """

    place = "shaft_and_meter"
    parameters: ClassVar = {
        # At lower cutoffs rounding of the coefficients matters: it grows with (sampling rate / cutoff)^2.
        "cutoff_hz": EffectParameter(
            "Hz", 0.1, math.inf, math.inf, loguniform(30.0, 3000.0), log=True, default=300.0
        ),
    }
    settings: ClassVar = {"order": 2}
    separated_by = "a tap test with the filter switched off, or a step of speed"

    check_settings = check_order

    def _distort_torque(self, torque: Float, rate: float, random: Generator, context: TorqueContext) -> Float:
        if self.cutoff_hz >= rate / 2:
            raise ValueError(
                f"cutoff_hz of {self.effect_id} must lie below the Nyquist frequency "
                f"{rate / 2:g} Hz, got {self.cutoff_hz!r}"
            )
        sos = butter(self.order, self.cutoff_hz, fs=rate, output="sos")
        at_one = sosfilt_zi(sos)
        decay = math.ceil(decay_time(self.cutoff_hz, self.order) * rate)
        before = torque[1 : decay + 1][::-1]
        state = at_one * (before.mean() if before.size else torque[0])
        if before.size:
            _, state = sosfilt(sos, before, zi=state)
        return np.asarray(sosfilt(sos, torque, zi=state)[0])


class Gain(_MeterEffect):
    """Gain of the torque meter: its calibration is off by a factor.

    At one speed and direction it looks like an offset or another brake set-point.
    """

    parameters: ClassVar = {
        "factor": EffectParameter("1", 1e-3, 1e3, 1.0, loguniform(0.9, 1.1), log=True, default=1.02)
    }
    separated_by = "another load, or calibration with dead weights"
    shows_as = "mean torque"

    def _distort_torque(self, torque: Float, rate: float, random: Generator, context: TorqueContext) -> Float:
        return np.asarray(self.factor * torque)


class Offset(_MeterEffect):
    """Offset of the torque meter: its zero is off by a constant.

    At one speed and direction it looks like friction, a gain or another brake set-point.
    """

    parameters: ClassVar = {"offset_nm": EffectParameter("Nm", -1e3, 1e3, 0.0, norm(0.0, 0.5), default=0.5)}
    separated_by = "the meter's reading without load, another load, and both directions of rotation"
    shows_as = "mean torque"

    def _distort_torque(self, torque: Float, rate: float, random: Generator, context: TorqueContext) -> Float:
        return np.asarray(torque + self.offset_nm)


class Noise(_MeterEffect):
    """Noise of the sensor: Gaussian, white or with a density that falls as a power of the frequency.

    A density proportional to max(f, 1 Hz)^-``exponent`` up to the Nyquist frequency, with the expected rms
    ``rms_nm`` at the record's sampling rate; exponent 0 is white. A longer record begins like a shorter one,
    coloured noise to rounding.
    """

    parameters: ClassVar = {
        "rms_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, loguniform(0.01, 2.0), log=True, default=0.2),
        "exponent": EffectParameter("1", 0.0, 3.0, None, default=0.0),
    }
    separated_by = "a record with the machine at rest"

    def _distort_torque(self, torque: Float, rate: float, random: Generator, context: TorqueContext) -> Float:
        if self.exponent == 0:
            return np.asarray(torque + self.rms_nm * random.normal(size=torque.size))
        # Lines at multiples of a quarter of the lowest frequency: they resolve the corner of the density.
        length = next_fast_len(math.ceil(4 * rate / LOWEST_COLOURED), real=True)
        lines = np.fft.rfftfreq(length, 1 / rate)
        density = np.maximum(lines, LOWEST_COLOURED) ** -float(self.exponent)
        response = np.fft.fftshift(np.fft.irfft(np.sqrt(density), length))
        response *= self.rms_nm / math.sqrt(float(response @ response))
        white = random.normal(size=torque.size + length - 1)
        return np.asarray(torque + fftconvolve(white, response, mode="valid"))


class Hum(_MeterEffect):
    """Mains hum in the torque signal, with harmonics.

    Adds sum_k a h_k sin(2 pi k f t + p_k), t from the first sample, a = ``amplitude_nm``, f =
    ``frequency_hz``; h_k is the k-th of ``harmonics``. 50 Hz is the sixth order of an input at 500 RPM.

    Parameters
    ----------
    harmonics : sequence of float, default (1,)
        Relative amplitudes of the fundamental and its multiples; (1, 0, 0.3) has a third harmonic.
    phase : float, optional
        p in rad: p_k = k p, so that p moves the whole wave. Default: every p_k is random.
    """

    parameters: ClassVar = {
        "amplitude_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, loguniform(0.01, 2.0), log=True, default=0.2),
        "frequency_hz": EffectParameter("Hz", 1.0, 1e3, None, default=50.0),
    }
    settings: ClassVar = {"harmonics": (1.0,), "phase": None}
    separated_by = "a record with the motor off, or at another speed"

    def check_settings(self) -> None:
        check_phase(self)
        given = list_members(self.harmonics)
        if not given or not all(is_number(share) and math.isfinite(share) for share in given):
            raise ValueError(f"harmonics of {self.effect_id} must hold finite numbers, got {given!r}")

    def _distort_torque(self, torque: Float, rate: float, random: Generator, context: TorqueContext) -> Float:
        highest = len(self.harmonics) * self.frequency_hz
        phases = 2 * np.pi * random.random(len(self.harmonics))
        if highest >= rate / 2:
            raise ValueError(
                f"frequency_hz of {self.effect_id} and its harmonics must lie below the Nyquist frequency "
                f"{rate / 2:g} Hz, got {highest:g} Hz"
            )
        turns = 2 * np.pi * self.frequency_hz * np.arange(torque.size) / rate
        hum = np.zeros(torque.size)
        for k, (share, phase) in enumerate(zip(self.harmonics, phases, strict=True), start=1):
            hum += share * np.sin(k * turns + (phase if self.phase is None else k * self.phase))
        return np.asarray(torque + self.amplitude_nm * hum)


class ShaftLine(_MeterEffect):
    """Line of a shaft: a wave in the torque signal once per turn of the input or of the output.

    Adds ``amplitude_nm`` sin(phi/z + ``phase``) with the angle phi of the input and, for the output, the
    reduction z (for the input 1). A bent shaft, a coupling, a magnet that couples into the meter, or a meter
    that answers to bending does so. The gearbox does not feel it; :class:`SpeedWander` with a ripple is a
    fluctuation that it feels.

    Parameters
    ----------
    phase : float, optional
        In rad. Default: random in each run.
    of : {"input", "output"}, default "input"
        The shaft. In files the effect is named ``input_shaft_line`` or ``output_shaft_line``.
    """

    effect_id: ClassVar[Any] = Of(input="input_shaft_line", output="output_shaft_line")
    summary: ClassVar[Any] = Of(
        input="Line of the input shaft: a wave in the torque signal once per turn.",
        output="Line of the output shaft: a wave in the torque signal once per turn.",
    )
    parameters: ClassVar = {
        "amplitude_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, loguniform(0.01, 2.0), log=True, default=0.2)
    }
    settings: ClassVar = {"phase": None, "of": "input"}
    separated_by: ClassVar[Any] = Of(
        input="another speed, which moves it but not hum, and the torque folded over turns",
        output="several whole output turns: it repeats, a drift does not",
    )
    proposed = False
    check_settings = check_phase

    def _distort_torque(self, torque: Float, rate: float, random: Generator, context: TorqueContext) -> Float:
        phase = 2 * np.pi * random.random() if self.phase is None else self.phase
        if context.gearbox is None or context.input_angle is None:
            raise ValueError(f"{self.effect_id} needs gearbox and input_angle as context, got {context!r}")
        angle = context.input_angle / (context.gearbox.n_lobes if self.of == "output" else 1)
        return np.asarray(torque + self.amplitude_nm * np.sin(angle + phase))


class ClockError(_MeterEffect):
    """Error of the converter's clock: the true sampling rate is not the stated one.

    With the error r = ``relative`` the samples lie at k / ((1 + r) f_s) while the record states f_s: a line
    at f appears at f / (1 + r). The values in between come from a windowed sinc (Kaiser, 48 samples on either
    side); the record's other channels, sampled by the same clock, are moved along by straight lines. Where
    the samples given do not reach so far (r < 0), the result is shorter; where they reach further, it is
    longer. An error of the speed changes the lines of shaft and lobes, but not hum.
    """

    place = "adc_clock"
    parameters: ClassVar = {"relative": EffectParameter("1", -0.05, 0.05, 0.0, norm(0.0, 1e-3), default=2e-4)}
    separated_by = "a tachometer on its own clock"
    shows_as = "time axis"

    def samples_needed(self, n_samples: int) -> int:
        if self.relative == 0:
            return n_samples
        return math.ceil((n_samples - 1) / (1 + float(self.relative))) + 1 + _HALF_WIDTH

    def _instants(self, n_given: int) -> Float:
        """Instants of the new samples, in samples of the given record."""
        rate = 1 + float(self.relative)
        n_samples = math.floor((n_given - 1) * rate) + 1
        return np.asarray(np.minimum(np.arange(n_samples) / rate, n_given - 1))

    def _distort_torque(self, torque: Float, rate: float, random: Generator, context: TorqueContext) -> Float:
        return np.asarray(_interpolate(torque, self._instants(torque.size), _WEIGHTS))

    def resample(self, values: Float, sampling_rate: float) -> Float:
        if self.relative == 0:
            return values
        return interpolate_rows(values, self._instants(len(values)))


@njit(fastmath={"reassoc", "contract"})  # sums in any order
def _interpolate(torque: Float, instants: Float, table: Float) -> Float:
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


class Quantisation(_MeterEffect):
    """Codes of the converter: torque in whole steps (LSB), clipped at the ends of its range.

    T becomes q c with q = ``lsb_nm`` and the code c = T/q rounded to the nearest whole number (half to even),
    limited to -N <= c <= N - 1 with N = floor(``full_scale_nm`` / q). Noise does not have such a comb.
    """

    place = "adc_codes"
    parameters: ClassVar = {
        "lsb_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, loguniform(2e-3, 1.0), log=True, default=0.05),
        "full_scale_nm": EffectParameter("Nm", 1e-6, math.inf, math.inf, log=True),
    }
    separated_by = "the comb of the histogram"

    def check_settings(self) -> None:
        if self.has_spread or self.lsb_nm <= self.full_scale_nm:
            return
        raise ValueError(f"full_scale_nm must be at least lsb_nm {self.lsb_nm:g}, got {self.full_scale_nm!r}")

    def _distort_torque(self, torque: Float, rate: float, random: Generator, context: TorqueContext) -> Float:
        step, full = float(self.lsb_nm), float(self.full_scale_nm)
        if step == 0:
            return np.clip(torque, -full, full)
        codes = np.rint(torque / step)
        if math.isfinite(full):
            # By rounding, a full scale of N steps may give slightly less than N.
            n_codes = math.floor(full / step * (1 + 1e-12))
            codes = np.clip(codes, -n_codes, n_codes - 1)
        return np.asarray(step * codes)


class Clipping(_MeterEffect):
    """Clipping: the amplifier or converter saturates at a torque.

    T is limited to -L to L with L = ``limit_nm``, as by the ``full_scale_nm`` of :class:`Quantisation`, but
    without steps and with a prior (*an assumption*, for loads of some 22 Nm). A saturated amplifier that
    recovers late is not modelled.
    """

    place = "adc_codes"
    parameters: ClassVar = {
        "limit_nm": EffectParameter(
            "Nm", 1e-6, math.inf, math.inf, loguniform(12.0, 40.0), log=True, default=25.0
        )
    }
    separated_by = "a lower load, or a lower gain of the amplifier"
    moves_mean = True
    proposed = False

    def _distort_torque(self, torque: Float, rate: float, random: Generator, context: TorqueContext) -> Float:
        return np.clip(torque, -float(self.limit_nm), float(self.limit_nm))


class LostSamples(_MeterEffect):
    """Lost samples: the record loses a block of them now and then.

    In each stretch of ``block``/``share`` samples one block at a random place is lost, of ``block`` samples
    (rounded). The block holds the last value before it, is zero, or is cut out, so that what follows comes
    too early. Only the torque's channel loses samples: an angle recorded with it stays, and no longer matches
    a torque with samples cut out.

    Parameters
    ----------
    fill : {"hold", "zero", "cut"}, default "hold"
        What stands in the place of the block.
    """

    place = "adc_codes"
    parameters: ClassVar = {
        "share": EffectParameter("1", 0.0, 0.5, 0.0, loguniform(5e-3, 0.1), log=True, default=0.03),
        "block": EffectParameter("1", 1.0, 1e6, None, loguniform(4.0, 256.0), log=True, default=64.0),
    }
    settings: ClassVar = {"fill": "hold"}
    separated_by = "a tachometer in the same channel, or a counter of samples"
    moves_mean = True
    proposed = False

    def check_settings(self) -> None:
        one_of(f"fill of {self.effect_id}", self.fill, ("hold", "zero", "cut"))

    def samples_needed(self, n_samples: int) -> int:
        if self.share == 0 or self.fill != "cut":
            return n_samples
        # At most one block more than the share is lost.
        return math.ceil((n_samples + round(float(self.block))) / (1 - float(self.share))) + 1

    def _distort_torque(self, torque: Float, rate: float, random: Generator, context: TorqueContext) -> Float:
        length = round(float(self.block))
        stretch = length / float(self.share)
        places = random.random(math.ceil(torque.size / stretch)) * (1 - float(self.share))
        starts = np.floor((np.arange(places.size) + places) * stretch).astype(int)
        lost = np.zeros(math.ceil(places.size * stretch), dtype=bool)
        lost[starts[:, None] + np.arange(length)] = True
        lost = lost[: torque.size]
        if self.fill == "cut":
            return np.asarray(torque[~lost])
        if self.fill == "zero":
            return np.where(lost, 0.0, torque)
        # A block at the beginning repeats the first sample.
        return np.asarray(torque[np.maximum.accumulate(np.where(lost, 0, np.arange(torque.size)))])
