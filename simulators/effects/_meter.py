"""Effects of the torque meter and its signal: applied to the torque, the gearbox does not feel them."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator
from scipy.fft import next_fast_len
from scipy.signal import butter, fftconvolve, sosfilt, sosfilt_zi
from scipy.stats import loguniform, norm

from cyclofeat._base.checks import is_number
from cyclofeat.simulators.effects import _noise
from cyclofeat.simulators.effects._base import Effect, Float, Place, TorqueContext, check_phase
from cyclofeat.simulators.effects._noise import Drift, check_order
from cyclofeat.simulators.effects._numbers import EffectParameter

# Coloured noise is white below this frequency, in Hz: its rms is finite and independent of the duration.
LOWEST_COLOURED = 1.0


class TorqueMeterLowPass(Effect):
    """Low-pass in the torque meter: a Butterworth filter, causal as a real meter is.

    |H(f)|^2 = 1 / (1 + (f/f_c)^(2n)), by the bilinear transform, exact at 0 and f_c; near the Nyquist
    frequency it falls faster than the analogue filter. A record of a running machine is continued before its
    first sample by its mirror image, so that the mean begins without a transient (of a ripple A at f above
    f_c, less than A f_c/f is left for some 1/f_c); a machine that starts from rest had, by assumption, its
    first value before. Separating measurement: a tap test with the filter switched off, or a step of speed:
    the filter's edge stays where it is and does not ring.

    Parameters
    ----------
    cutoff_hz : float or (low, high), default 300
        f_c (-3 dB) in Hz, from 0.1 to below the Nyquist frequency; infinity (``null`` in files) is neutral.
    order : int, default 2
        n, from 1 to 8.
    """

    place = Place.SHAFT_AND_METER
    parameters: ClassVar = {
        # At lower cutoffs rounding of the coefficients matters: it grows with (sampling rate / cutoff)^2.
        "cutoff_hz": EffectParameter("Hz", 0.1, math.inf, math.inf, loguniform(30.0, 3000.0), log=True),
    }
    separated_by = "a tap test with the filter switched off, or a step of speed"

    def __init__(self, cutoff_hz: Any = 300.0, order: int = 2) -> None:
        self.cutoff_hz = cutoff_hz
        self.order = order

    def check_settings(self) -> None:
        check_order(self, self.order)

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        if math.isinf(self.cutoff_hz) or torque.size == 0:
            return torque
        if self.cutoff_hz >= sampling_rate / 2:
            raise ValueError(
                f"cutoff_hz of {self.effect_id} must lie below the Nyquist frequency "
                f"{sampling_rate / 2:g} Hz, got {self.cutoff_hz!r}"
            )
        sos = butter(self.order, self.cutoff_hz, fs=sampling_rate, output="sos")
        at_one = sosfilt_zi(sos)
        if context is not None and context.from_rest:
            return np.asarray(sosfilt(sos, torque, zi=at_one * torque[0])[0])
        decay = math.ceil(_noise.decay_time(self.cutoff_hz, self.order) * sampling_rate)
        before = torque[1 : decay + 1][::-1]
        state = at_one * (before.mean() if before.size else torque[0])
        if before.size:
            _, state = sosfilt(sos, before, zi=state)
        return np.asarray(sosfilt(sos, torque, zi=state)[0])


class SensorDrift(Drift):
    """Drift of the torque meter's zero: added to the torque, not to the load.

    The process of :class:`LoadDrift`: white noise through a Butterworth low-pass, stationary from the first
    sample, with a one-sided density S(f) = ``rms``^2 / B / (1 + (f/f_c)^(2n)), B = f_c (pi/2n) / sin(pi/2n).
    Separating measurement: the envelope of the mesh frequency, which a drift of the load modulates and this
    one does not; or a record with the brake off.

    Parameters
    ----------
    rms_nm : float or (low, high), default 3
        Expected rms in Nm; 0 is neutral.
    cutoff_hz : float or (low, high), default 1.5
        f_c (-3 dB) in Hz, up to 1000.
    order : int, default 2
        n, from 1 to 8.
    """

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        if self.rms_nm == 0:
            return torque
        end = torque.size / sampling_rate
        seed = _noise.seed_from(random)
        drift = _noise.LowPassed(seed, self.rms_nm, (self.cutoff_hz, self.order), end)
        return np.asarray(torque + drift(np.arange(torque.size) / sampling_rate))


class Gain(Effect):
    """Gain of the torque meter: its calibration is off by a factor.

    T becomes ``factor`` T. Separating measurement: calibration with dead weights; at one speed and direction
    it looks like an offset or another brake set-point.

    Parameters
    ----------
    factor : float or (low, high), default 1.02
        A pure number; 1 is neutral.
    """

    parameters: ClassVar = {
        "factor": EffectParameter("1", 1e-3, 1e3, 1.0, loguniform(0.9, 1.1), log=True, default=1.02)
    }
    separated_by = "calibration with dead weights"

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        return np.asarray(self.factor * torque)


class Offset(Effect):
    """Offset of the torque meter: its zero is off by a constant.

    T becomes T + ``offset``. Separating measurement: the meter's reading without load, and both directions of
    rotation; at one speed and direction it looks like friction, a gain or another brake set-point.

    Parameters
    ----------
    offset_nm : float or (low, high), default 0.5
        In Nm; 0 is neutral.
    """

    parameters: ClassVar = {"offset_nm": EffectParameter("Nm", -1e3, 1e3, 0.0, norm(0.0, 0.5), default=0.5)}
    separated_by = "the meter's reading without load, and both directions of rotation"

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        return torque if self.offset_nm == 0 else np.asarray(torque + self.offset_nm)


class Noise(Effect):
    """Noise of the sensor: Gaussian, white or with a density that falls as a power of the frequency.

    A density proportional to max(f, 1 Hz)^-``exponent`` up to the Nyquist frequency, with the expected rms
    ``rms_nm`` at the record's sampling rate; exponent 0 is white.

    Parameters
    ----------
    rms_nm : float or (low, high), default 0.2
        Expected rms in Nm; 0 is neutral.
    exponent : float or (low, high), default 0
        From 0 (white) to 3. Set by hand: neither fitted nor drawn from a prior.

    Notes
    -----
    A longer record begins like a shorter one, coloured noise to rounding. Separating measurement: a record
    with the machine at rest.
    """

    parameters: ClassVar = {
        "rms_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, loguniform(0.01, 2.0), log=True, default=0.2),
        "exponent": EffectParameter("1", 0.0, 3.0, None, default=0.0),
    }
    separated_by = "a record with the machine at rest"

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        if self.rms_nm == 0:
            return torque
        if self.exponent == 0:
            return np.asarray(torque + self.rms_nm * random.normal(size=torque.size))
        # Lines at multiples of a quarter of the lowest frequency: they resolve the corner of the density.
        length = next_fast_len(math.ceil(4 * sampling_rate / LOWEST_COLOURED), real=True)
        lines = np.fft.rfftfreq(length, 1 / sampling_rate)
        density = np.maximum(lines, LOWEST_COLOURED) ** -float(self.exponent)
        response = np.fft.fftshift(np.fft.irfft(np.sqrt(density), length))
        response *= self.rms_nm / math.sqrt(float(response @ response))
        white = random.normal(size=torque.size + length - 1)
        return np.asarray(torque + fftconvolve(white, response, mode="valid"))


class Hum(Effect):
    """Mains hum in the torque signal, with harmonics.

    Adds sum_k a h_k sin(2 pi k f t + p_k), t from the first sample; h_k is the k-th of ``harmonics``.

    Parameters
    ----------
    amplitude_nm : float or (low, high), default 0.2
        a in Nm; 0 is neutral.
    frequency_hz : float or (low, high), default 50
        f in Hz. Set by hand: neither fitted nor drawn from a prior.
    harmonics : sequence of float, default (1,)
        Relative amplitudes of the fundamental and its multiples; (1, 0, 0.3) has a third harmonic.
    phase : float, optional
        p in rad: p_k = k p, so that p moves the whole wave. Default: every p_k is random.

    Notes
    -----
    50 Hz is the sixth order of an input at 500 RPM. Separating measurement: a record with the motor off,
    or at another speed, where hum stays at its frequency.
    """

    parameters: ClassVar = {
        "amplitude_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, loguniform(0.01, 2.0), log=True),
        "frequency_hz": EffectParameter("Hz", 1.0, 1e3, None),
    }
    separated_by = "a record with the motor off, or at another speed"

    def __init__(
        self,
        amplitude_nm: Any = 0.2,
        frequency_hz: Any = 50.0,
        harmonics: tuple[float, ...] = (1.0,),
        phase: float | None = None,
    ) -> None:
        self.amplitude_nm = amplitude_nm
        self.frequency_hz = frequency_hz
        self.harmonics = harmonics
        self.phase = phase

    def check_settings(self) -> None:
        check_phase(f"phase of {self.effect_id}", self.phase)
        given = self.harmonics
        if (
            not isinstance(given, (tuple, list, np.ndarray))
            or len(given) == 0
            or not all(is_number(share) and math.isfinite(share) for share in given)
        ):
            raise ValueError(
                f"harmonics of {self.effect_id} must be one or more finite relative amplitudes like "
                f"(1, 0, 0.3), got {given!r}"
            )

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        highest = len(self.harmonics) * self.frequency_hz
        phases = 2 * np.pi * random.random(len(self.harmonics))
        if self.amplitude_nm == 0:
            return torque
        if highest >= sampling_rate / 2:
            raise ValueError(
                f"frequency_hz of {self.effect_id} and its harmonics must lie below the Nyquist frequency "
                f"{sampling_rate / 2:g} Hz, got {highest:g} Hz"
            )
        turns = 2 * np.pi * self.frequency_hz * np.arange(torque.size) / sampling_rate
        hum = np.zeros(torque.size)
        for k, (share, phase) in enumerate(zip(self.harmonics, phases, strict=True), start=1):
            hum += share * np.sin(k * turns + (phase if self.phase is None else k * self.phase))
        return np.asarray(torque + self.amplitude_nm * hum)


class _ShaftLine(Effect):
    """Base of the lines of both shafts: amplitude and phase."""

    parameters: ClassVar = {
        "amplitude_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, loguniform(0.01, 2.0), log=True)
    }
    _of_output: ClassVar = False

    def __init__(self, amplitude_nm: Any = 0.2, phase: float | None = None) -> None:
        self.amplitude_nm = amplitude_nm
        self.phase = phase

    def check_settings(self) -> None:
        check_phase(f"phase of {self.effect_id}", self.phase)

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        phase = 2 * np.pi * random.random() if self.phase is None else self.phase
        if self.amplitude_nm == 0:
            return torque
        if context is None or context.gearbox is None or context.input_angle is None:
            raise ValueError(
                f"{self.effect_id} needs gearbox and input_angle of the record as context, got {context!r}"
            )
        angle = context.input_angle / (context.gearbox.n_lobes if self._of_output else 1)
        return np.asarray(torque + self.amplitude_nm * np.sin(angle + phase))


class InputShaftLine(_ShaftLine):
    """Line of the input shaft: a wave in the torque signal once per turn of the input.

    Adds a sin(phi + p) with the angle phi of the input. A bent shaft, a coupling or a magnet that couples
    into the meter does so. The gearbox does not feel it; :class:`SpeedWander` with a ripple is a fluctuation
    that it feels. Separating measurement: another speed, with which it moves as hum does not, and the torque
    folded over turns.

    Parameters
    ----------
    amplitude_nm : float or (low, high), default 0.2
        a in Nm; 0 is neutral.
    phase : float, optional
        p in rad. Default: random in each run.
    """

    separated_by = "another speed, with which it moves as hum does not, and the torque folded over turns"


class OutputShaftLine(_ShaftLine):
    """Line of the output shaft: a wave in the torque signal once per turn of the output.

    Adds a sin(phi/z + p) with the angle phi of the input and the reduction z. A misaligned coupling or
    a meter that answers to bending does so. The gearbox does not feel it. Separating measurement: several
    whole output turns, in which it repeats as a drift does not.

    Parameters
    ----------
    amplitude_nm : float or (low, high), default 0.2
        a in Nm; 0 is neutral.
    phase : float, optional
        p in rad. Default: random in each run.
    """

    separated_by = "several whole output turns, in which it repeats as a drift does not"
    _of_output = True
