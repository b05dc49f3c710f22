"""The motor that turns the input shaft, and runs at a given speed as it would have made them.

The torque of a run belongs to an angle of the input. The motor's equation is integrated with the torque read
at the angle that the motor has reached. The excess of its acceleration over that of the run is answered by
the inertia of the gearbox and by the brake's rotor behind one spring and damper, those of torque meter and
gearbox in series. Nothing else depends on the speed. Beside an integration of gearbox and motor together, the
current errs by 0.5 % of its variation (rms) where the speed varies by 5 %, and by 2 % where it varies by
22 %; with the brake of rig R1, by 11 %, as the gearbox's stiffness is estimated.
"""

from __future__ import annotations

import dataclasses
import math
from collections import namedtuple
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample_poly

from cyclofeat._base.checks import Replaceable, not_negative, positive, whole
from cyclofeat.simulators._jit import inner_njit, njit
from cyclofeat.simulators.courses import interpolate_rows
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.simulation import SimulationRun, anti_alias_filter, torsion

Float = NDArray[np.float64]

# Steps per second at least, and per time constant of the fastest lag.
_LEAST_RATE, _STEPS_PER_LAG = 20_000.0, 2.0
# A motor beyond this multiple of the set speed has lost control.
_RUNAWAY = 10.0


@dataclass(frozen=True)
class Motor(Replaceable):
    """A motor on the input shaft with control of its speed; made by effects such as ``ServoMotor``.

    J w' = k(phi) i - friction - cogging(phi) - T_in, with phi and w = phi' of the input, J of the rotor with
    all that turns rigidly with it, and the input torque T_in. A proportional-integral controller of the speed
    sets the current i, which follows with a lag of first order. Default values are *assumptions*.

    Parameters
    ----------
    inertia : float
        Moment of inertia of the rotor, in kg m2.
    bandwidth_hz : float
        b of the speed controller, in Hz. Its gains are p = 2 pi b J and p (2 pi b)/4, J with the inertia of
        gearbox and brake: two equal poles at pi b rad/s, as far as everything turns rigidly.
    current_bandwidth_hz : float
        Corner of the current's lag, in Hz.
    torque_constant : float
        Mean of k(phi), in Nm/A.
    pole_pairs, slots : int
        Pairs of magnetic poles of the rotor, and slots of the stator.
    ripple, ripple_phase : float
        k(phi) = ``torque_constant`` (1 + ``ripple`` cos(6 ``pole_pairs`` phi + ``ripple_phase``)).
    cogging_nm, cogging_phases : tuple of three floats
        Amplitudes in Nm, and phases in rad, of the waves of :attr:`cogging_orders`.
    coulomb_nm, viscous : float
        Friction of the motor's bearings: in Nm, and in Nm s/rad.
    offset_nm, noise_nm, lsb_nm : float
        Offset, standard deviation of white noise, and step (0 for none) of the measured current, times the
        torque constant, in Nm.

    Raises
    ------
    TypeError, ValueError
        If a parameter is of the wrong type or outside its range.

    Examples
    --------
    >>> Motor(pole_pairs=5, slots=12).cogging_orders
    (60, 12, 10)
    """

    inertia: float = 5e-5
    bandwidth_hz: float = 50.0
    current_bandwidth_hz: float = 500.0
    torque_constant: float = 0.3
    pole_pairs: int = 4
    slots: int = 12
    ripple: float = 0.0
    ripple_phase: float = 0.0
    cogging_nm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    cogging_phases: tuple[float, float, float] = (0.0, 0.0, 0.0)
    coulomb_nm: float = 0.0
    viscous: float = 0.0
    offset_nm: float = 0.0
    noise_nm: float = 0.0
    lsb_nm: float = 0.0

    def __post_init__(self) -> None:
        for name in ("inertia", "bandwidth_hz", "current_bandwidth_hz", "torque_constant"):
            positive(name, getattr(self, name))
        for name in ("pole_pairs", "slots"):
            whole(name, getattr(self, name), 1)
        for name in ("noise_nm", "lsb_nm"):
            not_negative(name, getattr(self, name))

    @property
    def cogging_orders(self) -> tuple[int, int, int]:
        """Waves per turn: least common multiple of slots and poles, slots, poles."""
        poles = 2 * self.pole_pairs
        return math.lcm(self.slots, poles), self.slots, poles

    @property
    def warm_up(self) -> float:
        """Time in s after which a start in steady state is forgotten: ten time constants of the control."""
        return 10 / (math.pi * self.bandwidth_hz)


# Motor, control and gearbox as the compiled equation takes them, in SI units.
_Constants = namedtuple(
    "_Constants",
    [
        "inertia", "gear_inertia", "output_inertia", "brake_inertia", "stiffness", "damping", "reduction",
        "proportional", "integral", "lag", "coulomb", "viscous", "ripple", "ripple_order", "ripple_phase",
    ],
)  # fmt: skip


def _motor_constants(motor: Motor, gearbox: CycloidalGearbox) -> _Constants:
    """Return the constants of a motor on the input shaft of a gearbox."""
    z = gearbox.n_lobes
    stiffness, damping = torsion(gearbox) if gearbox.brake_inertia > 0 else (0.0, 0.0)
    gear = 2 * gearbox.wheel_mass * gearbox.eccentricity**2
    gear += (2 * gearbox.wheel_inertia + gearbox.output_inertia) / z**2
    inertia = motor.inertia + gearbox.input_shaft_inertia + gear
    bandwidth = 2 * math.pi * motor.bandwidth_hz
    proportional = bandwidth * (inertia + gearbox.brake_inertia / z**2)
    return _Constants(
        inertia=inertia, gear_inertia=gear, output_inertia=float(gearbox.output_inertia),
        brake_inertia=float(gearbox.brake_inertia), stiffness=stiffness, damping=damping, reduction=float(z),
        proportional=proportional, integral=proportional * bandwidth / 4,
        lag=2 * math.pi * motor.current_bandwidth_hz, coulomb=float(motor.coulomb_nm),
        viscous=float(motor.viscous), ripple=float(motor.ripple), ripple_order=6.0 * motor.pole_pairs,
        ripple_phase=float(motor.ripple_phase),
    )  # fmt: skip


def drive_run(run: SimulationRun, motor: Motor, start: int, random: np.random.Generator) -> SimulationRun:
    """Return a run with ``torque_in`` as the motor makes it from sample ``start`` on, with its current.

    Raises ValueError if the motor does not hold the speed.
    """
    assert run.torque_in is not None
    rate = run.sampling_rate
    lag = 2 * math.pi * max(motor.current_bandwidth_hz, motor.bandwidth_hz)
    finer = math.ceil(max(_LEAST_RATE, _STEPS_PER_LAG * lag) / rate)
    speed = np.gradient(run.input_angle, 1 / rate)
    n = run.input_angle.size
    at = np.arange(n * finer - finer + 1) / finer
    course = np.column_stack(
        [interpolate_rows(values, at) for values in (run.input_angle, speed, np.gradient(speed, 1 / rate))]
    )
    torques = np.column_stack([run.torque_in, run.torque_out])
    if finer > 1:  # band-limited
        mean, low_pass = [run.torque_in.mean(), run.torque_out.mean()], anti_alias_filter(finer, 1)
        torques = resample_poly(torques - mean, finer, 1, window=low_pass)[: at.size] + mean
    constants = _motor_constants(motor, run.gearbox)
    waves = np.array([motor.cogging_orders, motor.cogging_nm, motor.cogging_phases], dtype=float)
    carried = float(run.torque_in[start:].mean()) + motor.coulomb_nm + motor.viscous * float(speed[start])
    result = np.empty((n - start, 6))
    done = _integrate_motor(
        constants, waves, course, torques, carried, finer, start, 1 / (rate * finer), result
    )
    if done < n - start:
        raise ValueError(
            f"the motor does not hold the speed at t = {(start + done) / rate:.4g} s: raise its inertia "
            f"({motor.inertia:.3g} kg m2) or bandwidth_hz ({motor.bandwidth_hz:.4g}), or lower the load"
        )
    position, angle, true_speed, torque_in, torque_out, produced = result.T
    measured = produced + motor.offset_nm + motor.noise_nm * random.normal(size=produced.size)
    if motor.lsb_nm > 0:
        measured = motor.lsb_nm * np.rint(measured / motor.lsb_nm)
    new = {"torque_in": torque_in, "torque_out": torque_out, "input_angle": angle}
    for name, values in vars(run).items():
        if isinstance(values, np.ndarray) and name not in new:
            new[name] = interpolate_rows(values, position)
    if run.output_speed is not None:
        new["output_speed"] *= true_speed / interpolate_rows(speed, position)
    channels: dict[str, Any] = {
        name: np.concatenate([getattr(run, name)[:start], values]) for name, values in new.items()
    }
    current = np.concatenate([np.full(start, np.nan), measured / motor.torque_constant])
    return dataclasses.replace(run, **channels, motor_current=current)


@inner_njit(fastmath=False)
def _cubic_at(values, column, k, share):  # type: ignore[no-untyped-def]
    """Cubic between ``values[k]`` and ``values[k + 1]`` through their neighbours (Catmull and Rom)."""
    a, b = values[max(k - 1, 0), column], values[k, column]
    c, d = values[k + 1, column], values[min(k + 2, values.shape[0] - 1), column]
    bend = 2 * a - 5 * b + 4 * c - d + share * (3 * (b - c) + d - a)
    return b + 0.5 * share * (c - a + share * bend)


@inner_njit(fastmath=False)
def _motor_rates(constants, waves, course, torques, set_speed, k, state, rates):  # type: ignore[no-untyped-def]
    """Write the rates of the state; return the step at its angle, and the excess acceleration.

    The state holds angle, speed, integral of the control (Nm), current times torque constant (Nm), and the
    deviation of the brake's rotor (rad, rad/s) in the sense in which it turns.
    """
    of = constants
    angle, speed, held = state[0], state[1], state[2]
    produced, turned, turning = state[3], state[4], state[5]
    # The step of the run that holds the angle, and the share of it that is passed.
    last = course.shape[0] - 2
    while k < last and course[k + 1, 0] <= angle:
        k += 1
    while k > 0 and angle < course[k, 0]:
        k -= 1
    share = (angle - course[k, 0]) / (course[k + 1, 0] - course[k, 0])
    share = min(max(share, 0.0), 1.0)
    planned = course[k, 2] + share * (course[k + 1, 2] - course[k, 2])
    against = of.coulomb + of.viscous * speed + _cubic_at(torques, 0, k, share) - of.gear_inertia * planned
    for wave in range(3):
        against += waves[1, wave] * np.sin(waves[0, wave] * angle + waves[2, wave])
    pull = produced * (1.0 + of.ripple * np.cos(of.ripple_order * angle + of.ripple_phase))
    meter = of.stiffness * turned + of.damping * turning if of.brake_inertia > 0.0 else 0.0
    acceleration = (pull - against + meter / of.reduction) / of.inertia
    excess = acceleration - planned
    wanted = of.proportional * (set_speed - speed) + held
    rates[0] = speed
    rates[1] = acceleration
    rates[2] = of.integral * (set_speed - speed)
    rates[3] = of.lag * (wanted - produced)
    rates[4] = turning
    rates[5] = -meter / of.brake_inertia - excess / of.reduction if of.brake_inertia > 0.0 else 0.0
    return k, share, excess, meter


@njit(fastmath=False)
def _integrate_motor(  # type: ignore[no-untyped-def]
    constants, waves, course, torques, carried, finer, start, step, result
):
    """Integrate by the classical Runge-Kutta rule; return the number of samples before control is lost.

    ``course`` (n, 3) holds angle, speed and acceleration of the run, ``torques`` (n, 2) its input and output
    torque, at every step. The control begins in steady state with the torque ``carried``. ``result`` takes,
    for every ``finer``-th step from sample ``start`` on: place in the run (samples), angle, speed, input
    torque, output torque, current times torque constant.
    """
    state, at, total = np.zeros(6), np.zeros(6), np.zeros(6)
    rates = np.zeros(6)
    k = start * finer
    state[0], state[1], state[2], state[3] = course[k, 0], course[k, 1], carried, carried
    for sample in range(result.shape[0]):
        for inner in range(finer):
            i = (start + sample) * finer + inner
            if not 0.0 < state[1] < _RUNAWAY * course[i, 1]:
                return sample
            after = course[min(i + 1, course.shape[0] - 1), 1]
            total[:] = 0.0
            at[:] = state
            for stage in range(4):
                set_speed = course[i, 1] + 0.5 * ((stage + 1) // 2) * (after - course[i, 1])
                k, share, excess, meter = _motor_rates(
                    constants, waves, course, torques, set_speed, k, at, rates
                )
                if stage == 0 and inner == 0:
                    row = result[sample]
                    row[0], row[1], row[2], row[5] = (k + share) / finer, state[0], state[1], state[3]
                    row[3] = _cubic_at(torques, 0, k, share) + constants.gear_inertia * excess
                    row[3] -= meter / constants.reduction
                    inert = constants.output_inertia * excess / constants.reduction
                    row[4] = _cubic_at(torques, 1, k, share) + (
                        -meter if constants.brake_inertia > 0.0 else inert
                    )
                if i == course.shape[0] - 1:
                    return sample + 1
                weight = 1.0 if stage == 0 or stage == 3 else 2.0
                for j in range(6):
                    total[j] += weight * rates[j]
                    at[j] = state[j] + (1.0 if stage == 2 else 0.5) * step * rates[j]
            for j in range(6):
                state[j] += step / 6.0 * total[j]
    return result.shape[0]
