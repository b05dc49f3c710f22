"""A servo motor on the input shaft, with code independent of :mod:`cyclofeat.simulators`.

The equations are those of :class:`cyclofeat.simulators.motor.Motor`. Small changes of the speed make them
linear: they are one filter from the torque against the motor to speed and current. The torque is then read
again at the angle that the motor has reached. Dimensions of the gearbox, and the torsional stiffness and
damping of gearbox and torque meter in series, are taken from the simulator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter, ss2tf

from cyclofeat.simulators import CycloidalGearbox
from cyclofeat.simulators.simulation import torsion

Float = NDArray[np.float64]

_READINGS = 3  # of the torque, at angles ever closer to the motor's


@dataclass(frozen=True)
class Servo:
    """A motor with its control and current sensor; units as of the simulator's."""

    inertia: float
    bandwidth_hz: float
    current_bandwidth_hz: float
    torque_constant: float
    pole_pairs: int
    slots: int
    ripple: tuple[float, float]  # share of the torque constant, phase
    cogging: tuple[tuple[float, float], ...]  # amplitude in Nm, phase
    coulomb_nm: float
    viscous: float
    offset_nm: float
    noise_nm: float
    lsb_nm: float


def drawn_servo(load: float, speed: float, random: np.random.Generator) -> Servo:
    """Return a motor of the size that a load in Nm and a speed in rad/s of the input need."""
    torque = max(load / 15, 0.01)
    slowest = max(20.0, 250 * 2 * math.pi / speed)

    def between(low: float, high: float) -> float:
        return float(low * (high / low) ** random.random())

    def phase() -> float:
        return float(random.uniform(0, 2 * math.pi))

    amplitudes = ((0.005, 0.02), (0.001, 0.005), (0.001, 0.005))
    return Servo(
        torque * between(4e-5, 7e-5), between(slowest, max(100.0, 2 * slowest)), between(200, 1000),
        between(0.05, 0.5), int(random.integers(3, 9)), int(random.integers(8, 26)),
        (between(0.01, 0.03), phase()), tuple((torque * between(*ends), phase()) for ends in amplitudes),
        torque * between(0.005, 0.03), torque * between(0.005, 0.03) / speed,
        torque * float(random.uniform(-0.01, 0.01)), torque * between(0.003, 0.01), 0.0015 * torque,
    )  # fmt: skip


def drive(
    servo: Servo,
    torque: Float,
    angle: Float,
    gearbox: CycloidalGearbox,
    rate: float,
    random: np.random.Generator,
) -> tuple[Float, Float]:
    """Return measured current in A and input angle in rad, at constant set speed.

    ``torque`` and ``angle`` of the input are those of a gearbox and its brake at a given speed, in Nm and
    rad. The motor begins in steady state.
    """
    speed = (angle[-1] - angle[0]) / (angle.size - 1) * rate
    discs = 2 * gearbox.wheel_mass * gearbox.eccentricity**2
    behind = (2 * gearbox.wheel_inertia + gearbox.output_inertia) / 225
    inertia = servo.inertia + gearbox.input_shaft_inertia + discs + behind
    bandwidth = 2 * math.pi * servo.bandwidth_hz
    gain, lag = bandwidth * (inertia + gearbox.brake_inertia / 225), 2 * math.pi * servo.current_bandwidth_hz
    # Deviations of speed, of the control's integral, of what the motor produces, and of the brake's rotor
    # behind gearbox and meter.
    stiffness, damping = torsion(gearbox) if gearbox.brake_inertia else (0.0, 0.0)
    meter = np.array([0, 0, 0, stiffness, damping])
    faster = (np.array([-servo.viscous, 0, 1, 0, 0]) + meter / 15) / inertia
    rotor = -meter / gearbox.brake_inertia if gearbox.brake_inertia else meter
    rates = np.array(
        [
            faster,
            [-gain * bandwidth / 4, 0, 0, 0, 0],
            [-lag * gain, lag, -lag, 0, 0],
            [0, 0, 0, 0, 1],
            rotor - faster / 15,
        ]
    )
    against = np.array([[-1 / inertia], [0], [0], [0], [1 / inertia / 15]])
    shown = np.eye(5)[[0, 2]]
    discrete = cont2discrete((rates, against, shown, np.zeros((2, 1))), 1 / rate, "foh")
    (of_speed, of_current), poles = ss2tf(*discrete[:4])
    poles_of = 2 * servo.pole_pairs
    orders = (math.lcm(servo.slots, poles_of), servo.slots, poles_of)
    mean = float(torque.mean()) + servo.coulomb_nm + servo.viscous * speed
    samples, ahead = np.arange(torque.size), np.zeros(torque.size)
    for _ in range(_READINGS):
        reached = angle + ahead
        load = np.interp(samples + ahead / speed * rate, samples, torque) - torque.mean()
        for order, (amplitude, phase) in zip(orders, servo.cogging, strict=True):
            load = load + amplitude * np.sin(order * reached + phase)
        share, phase = servo.ripple
        load = load - mean * share * np.cos(6 * servo.pole_pairs * reached + phase)
        ahead = np.cumsum(lfilter(of_speed, poles, load)) / rate
    produced = mean + lfilter(of_current, poles, load)
    measured = produced + servo.offset_nm + servo.noise_nm * random.normal(size=produced.size)
    return servo.lsb_nm * np.rint(measured / servo.lsb_nm) / servo.torque_constant, angle + ahead
