"""Effects of the drive: load, speed and motor, and the drifts and warm-ups of load or torque meter."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt
from scipy.stats import loguniform, norm, uniform

from cyclofeat._base.checks import is_number, whole
from cyclofeat.simulators.effects.effect import Added, Effect, EffectParameter, Float, Of, TorqueContext
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.motor import Motor

# Samples of the process per period of its cutoff, interpolated linearly. Near half of that rate the bilinear
# filter attenuates more than the analogue one: FINE is for levels compared in that range.
OVERSAMPLING = 200
FINE = 1000
# Time beyond the requested duration, in s: a simulation is longer, for its anti-alias filter.
MARGIN = 1.0


def check_order(self: Any) -> None:
    """Raise unless ``order`` of an effect is a whole number from 1 to 8, as of a Butterworth low-pass."""
    whole(f"order of {self.effect_id}", self.order, 1, 8)


def check_phase(self: Any) -> None:
    """Raise ValueError unless ``phase`` of an effect is None or a finite number of rad."""
    phase = self.phase
    if phase is not None and not (is_number(phase) and math.isfinite(phase)):
        raise ValueError(f"phase of {self.effect_id} must be a number of rad or None, got {phase!r}")


class _AddedTorque(Effect):
    """Base of the effects that add a function of time to the brake's torque or to the torque meter's."""

    place = "load_and_speed"

    def overrides(self, hook: str) -> bool:
        unused = "change_torque" if self.place == "load_and_speed" else "load_fluctuation"
        return hook != unused and super().overrides(hook)

    def load_fluctuation(self, gearbox: CycloidalGearbox, duration: float, random: Generator) -> Added:
        return self._added_torque(duration + MARGIN, random) if self.place == "load_and_speed" else None

    def change_torque(
        self, torque: Float, sampling_rate: float, random: Generator, context: TorqueContext | None = None
    ) -> Float:
        at_meter = self.place != "load_and_speed"
        added = self._added_torque(torque.size / sampling_rate, random) if at_meter else None
        return torque if added is None else np.asarray(torque + added(np.arange(torque.size) / sampling_rate))

    def _added_torque(self, end: float, random: Generator) -> Added:
        """Return what is added, in Nm, as a function of time from 0 to ``end`` (s); None for nothing."""
        raise NotImplementedError


class Drift(_AddedTorque):
    """Drift: a slow fluctuation of the brake's torque or of the torque meter's zero.

    White noise through a Butterworth low-pass, stationary from the start: a one-sided density
    S(f) = ``rms_nm``^2 / B / (1 + (f/f_c)^(2n)) with f_c = ``cutoff_hz``, n = ``order`` and
    B = f_c (pi/2n) / sin(pi/2n). The whole drive answers to a drift of the load; one of the meter is added to
    its torque. Both give nearly the same record: a load modulates the envelope of the mesh frequency, and a
    zero drift does not. A record with the brake off separates them too.

    Parameters
    ----------
    order : int, default 2
        From 1 to 8.
    of : {"load", "sensor"}, default "load"
        What drifts. In files the effect is named ``load_drift`` or ``sensor_drift``.
    """

    effect_id: ClassVar[Any] = Of(load="load_drift", sensor="sensor_drift")
    summary: ClassVar[Any] = Of(
        load="Slow fluctuation of the brake's torque, to which the whole drive responds.",
        sensor="Drift of the torque meter's zero: added to the torque, not to the load.",
    )
    parameters: ClassVar = {
        "rms_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, loguniform(0.1, 6.0), log=True, default=3.0),
        "cutoff_hz": EffectParameter("Hz", 1e-3, 1e3, None, loguniform(0.2, 20.0), log=True, default=1.5),
    }
    settings: ClassVar = {"order": 2, "of": "load"}
    place: ClassVar[Any] = Of(load="load_and_speed", sensor="sensor")
    separated_by = "the envelope of the mesh frequency, or a record with the motor off"
    shows_as = "slow torque"
    moves_mean = True

    check_settings = check_order

    def _added_torque(self, end: float, random: Generator) -> Added:
        if self.rms_nm == 0:
            return None
        return LowPassed(seed_from(random), self.rms_nm, (self.cutoff_hz, self.order), end)


class WarmUp(_AddedTorque):
    """Warm-up of brake or torque meter: its torque or zero begins too high or too low and settles.

    The torque T becomes T + ``size_nm`` exp(-t/``time_constant_s``). For the brake t runs from the start of
    the run, and a record begins later by the settling time; a brake that fades while it warms up does so. For
    the meter t runs from the first sample. Each run begins cold, by assumption: a warm-up over a session of
    many recordings is not modelled.

    Parameters
    ----------
    of : {"load", "sensor"}, default "load"
        What warms up. In files the effect is named ``load_warm_up`` or ``sensor_warm_up``.
    """

    effect_id: ClassVar[Any] = Of(load="load_warm_up", sensor="sensor_warm_up")
    summary: ClassVar[Any] = Of(
        load="Warm-up of the brake: its torque begins too high or too low and settles exponentially.",
        sensor="Warm-up of the torque meter: its zero begins too high or too low and settles exponentially.",
    )
    parameters: ClassVar = {
        "size_nm": EffectParameter("Nm", -1e3, 1e3, 0.0, norm(0.0, 1.5), default=1.0),
        "time_constant_s": EffectParameter(
            "s", 1e-2, 1e5, None, loguniform(0.3, 10.0), log=True, default=2.0
        ),
    }
    settings: ClassVar = {"of": "load"}
    place: ClassVar[Any] = Of(load="load_and_speed", sensor="sensor")
    separated_by: ClassVar[Any] = Of(
        load="the same record when the rig is warm",
        sensor="the same record when the rig is warm, and the meter's reading with the machine at rest",
    )
    shows_as = "start of the torque"
    moves_mean = True
    proposed = False

    def _added_torque(self, end: float, random: Generator) -> Added:
        if self.size_nm == 0:
            return None
        return lambda time: np.asarray(self.size_nm * np.exp(-check_time(time, end) / self.time_constant_s))


class ProportionalDrift(Effect):
    """Fluctuation of the brake's torque in proportion to it: a drift of its logarithm.

    The load T becomes T exp(x(t) - s^2/2), x low-passed white noise as in :class:`Drift` (``cutoff_hz``,
    ``order``) with standard deviation s = ``relative``: the mean stays T, and excursions are as large upward
    as downward by factors, hence larger upward by newton metres. A brake whose torque is a product (pressure,
    friction coefficient, radius) does so. *An assumption*: no brake was looked at. The skewness of a long
    record separates it too.

    Parameters
    ----------
    order : int, default 2
        From 1 to 8.

    Examples
    --------
    >>> from cyclofeat.simulators import Rig
    >>> run = Rig(effects=[ProportionalDrift(0.2)]).simulate(duration=0.2, random_state=1)
    >>> bool(run.torque_out.max() - 22 > 22 - run.torque_out.min())
    True
    """

    parameters: ClassVar = {
        "relative": EffectParameter("1", 0.0, 1.0, 0.0, loguniform(0.005, 0.3), log=True, default=0.15),
        "cutoff_hz": EffectParameter("Hz", 1e-3, 1e3, None, loguniform(0.2, 400.0), log=True, default=50.0),
    }
    settings: ClassVar = {"order": 2}
    separated_by = "another set-point of the brake"
    shows_as = "slow torque"
    moves_mean = True
    proposed = False

    check_settings = check_order

    def load_fluctuation(self, gearbox: CycloidalGearbox, duration: float, random: Generator) -> Added:
        if self.relative == 0:
            return None
        # For cutoffs of tens of hertz the coarser steps keep the density accurate at the lobe lines.
        low_pass = self.cutoff_hz, self.order
        logarithm = LowPassed(seed_from(random), self.relative, low_pass, duration + MARGIN, OVERSAMPLING)
        load, shift = gearbox.load_torque, 0.5 * float(self.relative) ** 2
        return lambda time: load * np.expm1(logarithm(time) - shift)


class SpeedWander(Effect):
    """Fluctuation of the input speed: a slow wander, a ripple locked to the shaft, or both.

    w(t) = w_0 (1 + u(t) + ``ripple`` sin(``ripple_order`` phi(t) + ``phase``)), u as the drift of
    :class:`Drift` with ``rms``, ``cutoff_hz`` and ``order``; phi is the angle that the mean speed and the
    wander turn the input shaft from the start (without the share of the ripple, below ripple/ripple_order
    rad). The clock of the converter moves all frequencies by one constant factor instead.

    Parameters
    ----------
    order : int, default 2
        From 1 to 8.
    phase : float, optional
        In rad, at the start. Default: random.
    """

    parameters: ClassVar = {
        "rms": EffectParameter("1", 0.0, 0.2, 0.0, loguniform(5e-4, 0.02), log=True, default=0.003),
        "cutoff_hz": EffectParameter("Hz", 1e-3, 1e3, None, loguniform(0.2, 10.0), log=True, default=1.0),
        "ripple": EffectParameter("1", 0.0, 0.5, 0.0),
        "ripple_order": EffectParameter("1", 1e-3, 1e3, None, default=1.0),
    }
    settings: ClassVar = {"order": 2, "phase": None}
    separated_by = "a tachometer on its own clock"

    def check_settings(self) -> None:
        check_order(self)
        check_phase(self)

    def speed_fluctuation(self, gearbox: CycloidalGearbox, duration: float, random: Generator) -> Added:
        seed = seed_from(random)
        phase = 2 * np.pi * random.random()  # drawn even if a phase is given, so that nothing else changes
        if self.phase is not None:
            phase = float(self.phase)
        if self.rms == 0 and self.ripple == 0:
            return None
        end = duration + MARGIN
        times, wander = np.array([0.0, 2 * end]), np.zeros(2)
        if self.rms > 0:
            low_pass = self.cutoff_hz, self.order
            times, wander = LowPassed(seed, self.rms, low_pass, end, OVERSAMPLING).knots
        speed, ramp = gearbox.input_speed, gearbox.ramp_time
        # Fluctuations are scaled by the ramp like the speed; the angle is their integral.
        reached = wander * np.clip(times / ramp, 0, 1) if ramp else wander
        steps = np.diff(times)
        turned = np.r_[0.0, np.cumsum(0.5 * (reached[1:] + reached[:-1]) * steps)]
        slope = np.diff(reached) / steps
        ripple, ripple_order = float(self.ripple), float(self.ripple_order)

        def fluctuation(time: Float) -> Float:
            time = check_time(time, end)
            slow = np.interp(time, times, wander)
            if ripple == 0:
                return np.asarray(speed * slow)
            k = np.clip(np.searchsorted(times, time, side="right") - 1, 0, slope.size - 1)
            since = time - times[k]
            extra = turned[k] + since * (reached[k] + 0.5 * slope[k] * since)
            mean = np.where(time < ramp, 0.5 * time**2 / ramp if ramp else 0.0, time - ramp / 2)
            angle = speed * (mean + extra)
            return np.asarray(speed * (slow + ripple * np.sin(ripple_order * angle + phase)))

        return fluctuation


class StickSlip(_AddedTorque):
    """Stick-slip of the brake: its torque climbs while it sticks and falls when it slips.

    Adds a sawtooth to the load: over each cycle it rises from -A/2 at the rate A f, and falls back in the
    last tenth of the cycle, with the mean amplitude A = ``amplitude_nm`` and f = ``frequency_hz``. Cycles
    last 1/f, uniformly within 25 %, and long ones climb higher, as at a constant speed against a spring. *An
    assumption*: the sawtooth is prescribed. Amplitude and frequency follow neither speed nor load, as those
    of real stick-slip do, and the drive does not excite or damp it. A record with the brake off separates it
    too.
    """

    parameters: ClassVar = {
        "amplitude_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, loguniform(0.1, 5.0), log=True, default=1.0),
        "frequency_hz": EffectParameter("Hz", 1e-2, 1e3, None, loguniform(1.0, 30.0), log=True, default=5.0),
    }
    separated_by = "another speed"
    proposed = False

    def _added_torque(self, end: float, random: Generator) -> Added:
        own = np.random.default_rng(seed_from(random))
        if self.amplitude_nm == 0:
            return None
        size = float(self.amplitude_nm)
        began = own.random()
        cycles = own.uniform(0.75, 1.25, math.ceil(end * self.frequency_hz / 0.75) + 2)
        last = np.cumsum(cycles) - began * cycles[0]
        first = last - cycles
        times = np.column_stack([first, last - 0.1 * cycles]).ravel() / self.frequency_hz
        values = np.column_stack([np.full(cycles.size, -size / 2), size * (cycles - 0.5)]).ravel()
        return lambda time: np.interp(check_time(time, end), times, values)


class Rattle(_AddedTorque):
    """Rattle of a part with play on the output shaft: short blows on the load from both flanks in turn.

    Adds triangular pulses of alternating sign to the load, ``blow_s`` long; their heights and the pauses
    between them are exponentially distributed, with means ``blow_nm`` and 1/``rate_hz``. The drive answers
    each with its own vibration. *An assumption*: the blows are prescribed. They follow neither speed nor
    load, and the play itself, a dead zone where the torque reverses, is not modelled.
    """

    parameters: ClassVar = {
        "blow_nm": EffectParameter("Nm", 0.0, 1e4, 0.0, loguniform(0.5, 20.0), log=True, default=5.0),
        "rate_hz": EffectParameter("Hz", 1e-2, 1e3, None, loguniform(2.0, 50.0), log=True, default=10.0),
        "blow_s": EffectParameter("s", 1e-4, 0.1, None, default=2e-3),
    }
    separated_by = "the part taken off, or preloaded"
    proposed = False

    def _added_torque(self, end: float, random: Generator) -> Added:
        own = np.random.default_rng(seed_from(random))
        if self.blow_nm == 0:
            return None
        length = float(self.blow_s)
        # As many as can follow each other without a pause.
        waits, heights = own.exponential(size=(math.ceil(end / length) + 1, 2)).T
        last = np.cumsum(waits / self.rate_hz + length)
        signs = np.where(np.arange(last.size) % 2, -1.0, 1.0)
        nothing = np.zeros(last.size)
        times = np.column_stack([last - length, last - length / 2, last]).ravel()
        values = np.column_stack([nothing, self.blow_nm * signs * heights, nothing]).ravel()
        return lambda time: np.interp(check_time(time, end), times, values)


class ServoMotor(Effect):
    """Motor with control of its speed, in place of a given speed of the input.

    The speed yields to the torque as :class:`cyclofeat.simulators.Motor` describes, the recorded angle is the
    true one, and the run has a current. ``inertia`` is that of the rotor. A stiffer control (``bandwidth_hz``
    of speed, ``current_bandwidth_hz``) comes nearer to the given speed. ``pole_pairs`` are rounded to a whole
    number, ``slots`` to a multiple of three, as the windings have three phases.
    """

    parameters: ClassVar = {
        "inertia": EffectParameter("kg m2", 1e-8, 1.0, log=True, default=5e-5),
        "bandwidth_hz": EffectParameter("Hz", 1.0, 1e5, log=True, default=50.0),
        "current_bandwidth_hz": EffectParameter("Hz", 10.0, 1e6, log=True, default=500.0),
        "torque_constant": EffectParameter("Nm/A", 1e-4, 1e3, log=True, default=0.3),
        "pole_pairs": EffectParameter("1", 1.0, 100.0, default=4.0),
        "slots": EffectParameter("1", 3.0, 300.0, default=12.0),
    }
    separated_by = "the current beside a torque meter on the input"

    def change_motor(self, motor: Motor, random: Generator) -> Motor:
        return motor.replace(
            inertia=self.inertia, bandwidth_hz=self.bandwidth_hz, torque_constant=self.torque_constant,
            current_bandwidth_hz=self.current_bandwidth_hz, pole_pairs=round(self.pole_pairs),
            slots=3 * round(self.slots / 3),
        )  # fmt: skip


class TorqueConstantRipple(Effect):
    """Ripple of the motor's torque constant, six times per turn and pair of poles.

    In a three-phase motor the fifth and seventh harmonics of its voltage give this order (Jahns and Soong
    1996, IEEE Transactions on Industrial Electronics 43(2), 321-330). ``share`` is its relative amplitude;
    its phase is random for each assembly. The ripple grows with the current.
    """

    parameters: ClassVar = {"share": EffectParameter("1", 0.0, 0.5, 0.0, default=0.02)}
    separated_by = "the torque of the motor alone at several currents"

    def change_motor(self, motor: Motor, random: Generator) -> Motor:
        return motor.replace(ripple=self.share, ripple_phase=2 * math.pi * random.random())


class Cogging(Effect):
    """Cogging of the motor: torque between magnets and slots, by the angle of its rotor alone.

    A wave for the least common multiple of slots and poles (Zhu and Howe 2000, IEEE Transactions on Energy
    Conversion 15(4), 407-412) and, for a motor that is not perfect, one for the slots and one for the poles.
    Their phases are random for each assembly. They lie at whole orders of the input, as does only every
    fifteenth line of the lobes, but some are 1/15 of an order from a line.
    """

    parameters: ClassVar = {
        "common_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, default=0.015),
        "slots_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, default=0.004),
        "poles_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, default=0.004),
    }
    separated_by = "the torque of the motor alone, without current"

    def change_motor(self, motor: Motor, random: Generator) -> Motor:
        phases = tuple(2 * math.pi * random.random(3))
        return motor.replace(cogging_nm=(self.common_nm, self.slots_nm, self.poles_nm), cogging_phases=phases)


class MotorFriction(Effect):
    """Friction of the motor's bearings: a constant, and a part that grows with the speed."""

    parameters: ClassVar = {
        "coulomb_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, default=0.02),
        "viscous": EffectParameter("Nm s/rad", 0.0, 1e3, 0.0, default=2e-4),
    }
    separated_by = "the current of the motor alone at several speeds"

    def change_motor(self, motor: Motor, random: Generator) -> Motor:
        return motor.replace(coulomb_nm=self.coulomb_nm, viscous=self.viscous)


class CurrentSensor(Effect):
    """Measurement of the motor's current: offset, white noise and steps, which the motor does not feel.

    Values are in Nm, times the torque constant, so that they suit a motor of any torque constant.
    ``noise_nm`` is a standard deviation, ``lsb_nm`` the step of the converter.
    """

    parameters: ClassVar = {
        "offset_nm": EffectParameter("Nm", -1e3, 1e3, 0.0),
        "noise_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, default=0.01),
        "lsb_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, default=2e-3),
    }
    separated_by = "the reading without current"

    def change_motor(self, motor: Motor, random: Generator) -> Motor:
        return motor.replace(offset_nm=self.offset_nm, noise_nm=self.noise_nm, lsb_nm=self.lsb_nm)


def motor_effects(gearbox: CycloidalGearbox | None = None) -> tuple[Effect, ...]:
    """Return a motor with its errors, which differ between assemblies, of the size that a gearbox needs.

    All values are *assumptions*, wide enough for servo motors of 50 to 750 W; ``print(motor_effects())``
    lists the ranges. Rotor, cogging, friction (the viscous part as large at nominal speed as the Coulomb
    one), offset, noise and steps are in proportion to the mean input torque, load over number of lobes, of at
    least 0.01 Nm. The speed control has at least 250 Hz divided by the input's turns per second (30 Hz at 500
    RPM), below which lobes worn to the papers' chord stall the motor.

    Parameters
    ----------
    gearbox : CycloidalGearbox, default ``CycloidalGearbox.steel()``

    Returns
    -------
    tuple of Effect

    Examples
    --------
    >>> from cyclofeat.simulators import Rig
    >>> rig = Rig(effects=motor_effects())
    >>> run = rig.simulate(duration=0.1, sampling_rate=4_000, quantity="motor_current", random_state=1)
    >>> run.motor_current.shape
    (400,)
    """
    gearbox = CycloidalGearbox.steel() if gearbox is None else gearbox
    torque = max(abs(gearbox.load_torque) / gearbox.n_lobes, 0.01)
    slowest = max(20.0, 250.0 / gearbox.input_speed_hz)

    def part(low: float, high: float) -> tuple[float, float]:
        return low * torque, high * torque

    friction = part(0.005, 0.03)
    return (
        ServoMotor(
            inertia=part(4e-5, 7e-5), bandwidth_hz=(slowest, max(100.0, 2 * slowest)),
            current_bandwidth_hz=(200, 1000), torque_constant=(0.05, 0.5), pole_pairs=uniform(2.5, 6),
            slots=uniform(7.5, 18),
        ),
        TorqueConstantRipple((0.01, 0.03)),
        Cogging(part(0.005, 0.02), part(0.001, 0.005), part(0.001, 0.005)),
        MotorFriction(friction, tuple(end / gearbox.input_speed for end in friction)),
        CurrentSensor(part(-0.01, 0.01), part(0.003, 0.01), 0.0015 * torque),
    )  # fmt: skip


def decay_time(cutoff: float, order: int) -> float:
    """Return the time in s in which the slowest pole of a Butterworth low-pass decays to 1e-9."""
    slowest = 2 * np.pi * cutoff * math.sin(np.pi / (2 * order))
    return math.log(1e9) / slowest


def seed_from(random: Generator) -> NDArray[np.int64]:
    """Draw the seed of one process."""
    return random.integers(2**63, size=4)


@dataclass(eq=False)
class LowPassed:
    """Stationary low-passed noise with the given expected rms, as a function of time from 0 to ``end`` (s).

    It is made at its first use, from its seed: planned runs wait without their noise.
    """

    seed: NDArray[np.int64]
    rms: float
    low_pass: tuple[float, int]  #: cutoff in Hz, order
    end: float
    oversampling: int = FINE

    @functools.cached_property
    def knots(self) -> tuple[Float, Float]:
        """Times in s, and the values between which lines are straight."""
        rate = self.oversampling * self.low_pass[0]
        warm_up = math.ceil(decay_time(*self.low_pass) * rate)
        sos, power = _low_pass(*self.low_pass, warm_up, self.oversampling)
        n = math.ceil(self.end * rate) + 1
        noise = np.random.default_rng(self.seed).normal(size=warm_up + n)
        return np.arange(n) / rate, self.rms / math.sqrt(power) * sosfilt(sos, noise)[warm_up:]

    def __call__(self, time: Float) -> Float:
        """Return the values at increasing times in s; raise ValueError for times outside 0 to the end."""
        return np.interp(check_time(time, self.end), *self.knots)


@functools.lru_cache(maxsize=64)
def _low_pass(cutoff: float, order: int, n: int, oversampling: int) -> tuple[Float, float]:
    """Return the filter and the mean square of its response of ``n`` samples to white noise."""
    sos: Float = butter(order, cutoff, fs=oversampling * cutoff, output="sos")
    response = sosfilt(sos, np.r_[1.0, np.zeros(n)])
    # Averaged over its length, a straight line between two samples has 2/3 of their variance plus 1/3 of
    # their covariance.
    return sos, 2 / 3 * float(response @ response) + 1 / 3 * float(response[1:] @ response[:-1])


def check_time(time: Any, end: float) -> Float:
    """Return increasing times as an array; raise ValueError for times outside 0 to ``end`` (s)."""
    times = np.asarray(time, dtype=float)
    if times.size and not (times[0] >= 0 and times[-1] <= end):
        raise ValueError(f"time must lie between 0 and {end:g} s, got {times[0]:g} to {times[-1]:g} s")
    return times
