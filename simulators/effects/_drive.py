"""Effects on load and speed."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator
from scipy.stats import loguniform, norm

from cyclofeat.simulators._lines import on_lines
from cyclofeat.simulators.effects import _noise
from cyclofeat.simulators.effects._base import Effect, Float, Fluctuation, Place, check_phase
from cyclofeat.simulators.effects._noise import Drift, check_order
from cyclofeat.simulators.effects._numbers import EffectParameter
from cyclofeat.simulators.gearbox import CycloidalGearbox


class LoadDrift(Drift):
    """Slow fluctuation of the brake's torque, to which the whole drive answers.

    White noise through a Butterworth low-pass, stationary from the start: a one-sided density
    S(f) = ``rms``^2 / B / (1 + (f/f_c)^(2n)) with B = f_c (pi/2n) / sin(pi/2n).

    Parameters
    ----------
    rms_nm : float or (low, high), default 3
        Expected rms in Nm; 0 is neutral.
    cutoff_hz : float or (low, high), default 1.5
        f_c (-3 dB) in Hz, up to 1000.
    order : int, default 2
        n, from 1 to 8.

    Notes
    -----
    A drift of the sensor's zero gives nearly the same torque. Separating measurement: the envelope of the
    mesh frequency, which a load modulates and a zero drift does not; or a record with the brake off.
    """

    def load_fluctuation(
        self, gearbox: CycloidalGearbox, duration: float, random: Generator
    ) -> Fluctuation | None:
        if self.rms_nm == 0:
            return None
        end = duration + _noise.MARGIN
        low_pass = self.cutoff_hz, self.order
        return _noise.LowPassed(_noise.seed_from(random), self.rms_nm, low_pass, end)


class ProportionalDrift(Effect):
    """Fluctuation of the brake's torque in proportion to it: a drift of its logarithm.

    The load T becomes T exp(x(t) - s^2/2), x low-passed white noise as in
    :class:`cyclofeat.simulators.LoadDrift` with standard deviation s = ``relative``: the mean stays T, and
    excursions are as large upward as downward by factors, hence larger upward by newton metres. A brake whose
    torque is a product (pressure, friction coefficient, radius) does so. *An assumption*: no brake was
    looked at.

    Parameters
    ----------
    relative : float or (low, high), default 0.15
        Standard deviation s of the load's logarithm, a pure number; 0 is neutral.
    cutoff_hz : float or (low, high), default 50
        Cutoff (-3 dB) of x's low-pass in Hz, up to 1000.
    order : int, default 2
        Order of that low-pass (Butterworth), from 1 to 8.

    Notes
    -----
    Rigs and files can name it; a search for missing effects proposes only
    :class:`cyclofeat.simulators.LoadDrift`. Separating measurement: another set-point of the
    brake, with which this drift grows and an additive one does not; or the skewness of a long record.

    Examples
    --------
    >>> from cyclofeat.simulators import Rig
    >>> run = Rig(effects=[ProportionalDrift(0.2)]).simulate(duration=0.2, random_state=1)
    >>> bool(run.torque_out.max() - 22 > 22 - run.torque_out.min())
    True
    """

    parameters: ClassVar = {
        "relative": EffectParameter("1", 0.0, 1.0, 0.0, loguniform(0.005, 0.3), log=True),
        "cutoff_hz": EffectParameter("Hz", 1e-3, 1e3, None, loguniform(0.2, 400.0), log=True),
    }
    separated_by = "another set-point of the brake"

    def __init__(self, relative: Any = 0.15, cutoff_hz: Any = 50.0, order: int = 2) -> None:
        self.relative = relative
        self.cutoff_hz = cutoff_hz
        self.order = order

    def check_settings(self) -> None:
        check_order(self, self.order)

    def load_fluctuation(
        self, gearbox: CycloidalGearbox, duration: float, random: Generator
    ) -> Fluctuation | None:
        if self.relative == 0:
            return None
        end = duration + _noise.MARGIN
        # For cutoffs of tens of hertz the coarser steps keep the density accurate at the lobe lines.
        low_pass = self.cutoff_hz, self.order
        logarithm = _noise.LowPassed(
            _noise.seed_from(random), self.relative, low_pass, end, _noise.OVERSAMPLING
        )
        load, shift = gearbox.load_torque, 0.5 * float(self.relative) ** 2
        return lambda time: load * np.expm1(logarithm(time) - shift)


class LoadScale(Effect):
    """Load of the brake by a factor: its set-point is off, or differs between assemblies.

    The mean load T becomes ``factor`` T.

    Parameters
    ----------
    factor : float or (low, high), default 1.02
        A pure number; 1 is neutral.

    Notes
    -----
    Rigs and files can name it; a search for missing effects in recordings does not propose it, as the gain of
    the torque meter looks the same. Separating measurement: a dead-weight calibration, and the brake's own
    reading.
    """

    place = Place.LOAD_AND_SPEED
    parameters: ClassVar = {
        # 0.5 Nm on the papers' 22 Nm.
        "factor": EffectParameter("1", 0.0, 1e3, 1.0, norm(1.0, 0.5 / 22), default=1.02),
    }
    separated_by = "a dead-weight calibration, and the brake's own reading"

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        return gearbox.replace(load_torque=gearbox.load_torque * self.factor)


class SpeedScale(Effect):
    """Speed of the input by a factor: its set-point is off, or differs between assemblies.

    The mean speed w_0 becomes ``factor`` w_0.

    Parameters
    ----------
    factor : float or (low, high), default 1.01
        A pure number; 1 is neutral.

    Notes
    -----
    Rigs and files can name it; a search for missing effects does not propose it, as recordings are compared
    at their own speed. Separating measurement: a tachometer.
    """

    place = Place.LOAD_AND_SPEED
    parameters: ClassVar = {"factor": EffectParameter("1", 1e-3, 1e3, 1.0, norm(1.0, 0.01), default=1.01)}
    separated_by = "a tachometer"

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        return gearbox.replace(input_speed=gearbox.input_speed * self.factor)


class SpeedWander(Effect):
    """Fluctuation of the input speed: a slow wander, a ripple locked to the shaft, or both.

    w(t) = w_0 (1 + u(t) + ``ripple`` sin(``ripple_order`` phi(t) + ``phase``)), u as the drift of
    :class:`LoadDrift` with rms ``rms``; phi is the angle that the mean speed and the wander turn the input
    shaft from the start (without the share of the ripple, below ripple/ripple_order rad). Separating
    measurement: a tachometer on its own clock; the clock of the converter moves all frequencies by one
    constant factor.

    Parameters
    ----------
    rms : float or (low, high), default 0.003
        Expected rms of u, a pure number; 0 for no wander.
    cutoff_hz : float or (low, high), default 1
        Cutoff of u's low-pass in Hz, up to 1000.
    order : int, default 2
        Order of that low-pass, from 1 to 8.
    ripple : float or (low, high), default 0
        Relative amplitude of the ripple. Set by hand: neither fitted nor drawn from a prior.
    ripple_order : float or (low, high), default 1
        Waves of the ripple per input turn.
    phase : float, optional
        In rad, at the start. Default: random.
    """

    parameters: ClassVar = {
        "rms": EffectParameter("1", 0.0, 0.2, 0.0, loguniform(5e-4, 0.02), log=True),
        "cutoff_hz": EffectParameter("Hz", 1e-3, 1e3, None, loguniform(0.2, 10.0), log=True),
        "ripple": EffectParameter("1", 0.0, 0.5, 0.0),
        "ripple_order": EffectParameter("1", 1e-3, 1e3, None),
    }
    separated_by = "a tachometer on its own clock"

    def __init__(
        self,
        rms: Any = 0.003,
        cutoff_hz: Any = 1.0,
        order: int = 2,
        ripple: Any = 0.0,
        ripple_order: Any = 1.0,
        phase: float | None = None,
    ) -> None:
        self.rms = rms
        self.cutoff_hz = cutoff_hz
        self.order = order
        self.ripple = ripple
        self.ripple_order = ripple_order
        self.phase = phase

    def check_settings(self) -> None:
        check_order(self, self.order)
        check_phase(f"phase of {self.effect_id}", self.phase)

    def speed_fluctuation(
        self, gearbox: CycloidalGearbox, duration: float, random: Generator
    ) -> Fluctuation | None:
        seed = _noise.seed_from(random)
        phase = 2 * np.pi * random.random()  # drawn even if a phase is given, so that nothing else changes
        if self.phase is not None:
            phase = float(self.phase)
        if self.rms == 0 and self.ripple == 0:
            return None
        end = duration + _noise.MARGIN
        times, wander = np.array([0.0, 2 * end]), np.zeros(2)
        if self.rms > 0:
            low_pass = self.cutoff_hz, self.order
            times, wander = _noise.LowPassed(seed, self.rms, low_pass, end, _noise.OVERSAMPLING).knots
        speed, ramp = gearbox.input_speed, gearbox.ramp_time
        # Fluctuations are scaled by the ramp like the speed; the angle is their integral.
        reached = wander * np.clip(times / ramp, 0, 1) if ramp else wander
        steps = np.diff(times)
        turned = np.r_[0.0, np.cumsum(0.5 * (reached[1:] + reached[:-1]) * steps)]
        slope = np.diff(reached) / steps
        ripple, ripple_order = float(self.ripple), float(self.ripple_order)

        def fluctuation(time: Float) -> Float:
            time = _noise.checked_time(time, end)
            slow = on_lines(time, times, wander)
            if ripple == 0:
                return np.asarray(speed * slow)
            k = np.clip(np.searchsorted(times, time, side="right") - 1, 0, slope.size - 1)
            since = time - times[k]
            extra = turned[k] + since * (reached[k] + 0.5 * slope[k] * since)
            mean = np.where(time < ramp, 0.5 * time**2 / ramp if ramp else 0.0, time - ramp / 2)
            angle = speed * (mean + extra)
            return np.asarray(speed * (slow + ripple * np.sin(ripple_order * angle + phase)))

        return fluctuation


class StickSlip(Effect):
    """Stick-slip of the brake: its torque climbs while it sticks and falls when it slips.

    Adds a sawtooth to the load: over each cycle it rises from -A/2 at the rate A f, and falls back in the
    last tenth of the cycle. Cycles last 1/f, uniformly within 25 %, and long ones climb higher, as at a
    constant speed against a spring. *An assumption*: the sawtooth is prescribed. Amplitude and frequency
    follow neither speed nor load, and the drive does not excite or damp it. Separating measurement: another
    speed, with which the frequency of real stick-slip changes, or the brake off.

    Parameters
    ----------
    amplitude_nm : float or (low, high), default 1
        Mean peak-to-peak amplitude A in Nm; 0 is neutral.
    frequency_hz : float or (low, high), default 5
        Mean number f of cycles per second, in Hz.
    """

    parameters: ClassVar = {
        "amplitude_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, loguniform(0.1, 5.0), log=True, default=1.0),
        "frequency_hz": EffectParameter("Hz", 1e-2, 1e3, None, loguniform(1.0, 30.0), log=True, default=5.0),
    }
    separated_by = "another speed"

    def load_fluctuation(
        self, gearbox: CycloidalGearbox, duration: float, random: Generator
    ) -> Fluctuation | None:
        own = np.random.default_rng(_noise.seed_from(random))
        if self.amplitude_nm == 0:
            return None
        end, size = duration + _noise.MARGIN, float(self.amplitude_nm)
        began = own.random()
        cycles = own.uniform(0.75, 1.25, math.ceil(end * self.frequency_hz / 0.75) + 2)
        last = np.cumsum(cycles) - began * cycles[0]
        first = last - cycles
        times = np.column_stack([first, last - 0.1 * cycles]).ravel() / self.frequency_hz
        values = np.column_stack([np.full(cycles.size, -size / 2), size * (cycles - 0.5)]).ravel()
        return lambda time: np.asarray(on_lines(_noise.checked_time(time, end), times, values))


class Rattle(Effect):
    """Rattle of a part with play on the output shaft: short blows on the load, from either flank in turn.

    Adds triangular pulses of alternating sign to the load; their heights and the pauses between them are
    exponentially distributed. The drive answers each with its own vibration. *An assumption*: the blows are
    prescribed. They follow neither speed nor load, and the play itself, a dead zone where the torque
    reverses, is not modelled. Separating measurement: the part taken off, or preloaded.

    Parameters
    ----------
    blow_nm : float or (low, high), default 5
        Mean height of a blow in Nm; 0 is neutral.
    rate_hz : float or (low, high), default 10
        Blows per second of pause, in Hz: the pauses last 1/``rate_hz`` on average.
    blow_s : float or (low, high), default 0.002
        Duration of a blow in s. Set by hand: neither fitted nor drawn from a prior.
    """

    parameters: ClassVar = {
        "blow_nm": EffectParameter("Nm", 0.0, 1e4, 0.0, loguniform(0.5, 20.0), log=True, default=5.0),
        "rate_hz": EffectParameter("Hz", 1e-2, 1e3, None, loguniform(2.0, 50.0), log=True, default=10.0),
        "blow_s": EffectParameter("s", 1e-4, 0.1, None, default=2e-3),
    }
    separated_by = "the part taken off, or preloaded"

    def load_fluctuation(
        self, gearbox: CycloidalGearbox, duration: float, random: Generator
    ) -> Fluctuation | None:
        own = np.random.default_rng(_noise.seed_from(random))
        if self.blow_nm == 0:
            return None
        end, length = duration + _noise.MARGIN, float(self.blow_s)
        # As many as can follow each other without a pause.
        waits, heights = own.exponential(size=(math.ceil(end / length) + 1, 2)).T
        last = np.cumsum(waits / self.rate_hz + length)
        signs = np.where(np.arange(last.size) % 2, -1.0, 1.0)
        nothing = np.zeros(last.size)
        times = np.column_stack([last - length, last - length / 2, last]).ravel()
        values = np.column_stack([nothing, self.blow_nm * signs * heights, nothing]).ravel()
        return lambda time: np.asarray(on_lines(_noise.checked_time(time, end), times, values))
