"""Effects of the motor that turns the input shaft, and of the measurement of its current."""

from __future__ import annotations

import math
from typing import ClassVar

from numpy.random import Generator
from scipy.stats import uniform

from cyclofeat.simulators.effects._parameter import EffectParameter
from cyclofeat.simulators.effects.effect import Effect
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.motor import Motor


class ServoMotor(Effect):
    """Motor with control of its speed, in place of a given speed of the input.

    The speed yields to the torque as :class:`cyclofeat.simulators.Motor` describes, the recorded angle is the
    true one, and the run has a current. A stiffer control (``bandwidth_hz``, ``current_bandwidth_hz``) comes
    nearer to the given speed. Separating measurement: the current together with a torque meter on the input.

    Parameters
    ----------
    inertia : float or (low, high), default 5e-5
        Of the rotor, in kg m2.
    bandwidth_hz : float or (low, high), default 50
        Of the speed controller, in Hz.
    current_bandwidth_hz : float or (low, high), default 500
        Of the current controller, in Hz.
    torque_constant : float or (low, high), default 0.3
        In Nm/A.
    pole_pairs : float or (low, high), default 4
        Rounded to a whole number.
    slots : float or (low, high), default 12
        Rounded to a multiple of three, as the windings have three phases.
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
    1996, IEEE Transactions on Industrial Electronics 43(2), 321-330). Its phase is random for each assembly.
    Separating measurement: the torque of the motor alone at several currents, with which it grows.

    Parameters
    ----------
    share : float or (low, high), default 0.02
        Relative amplitude, a pure number; 0 is neutral.
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
    fifteenth line of the lobes, but some are 1/15 of an order from a line. Separating measurement: the torque
    of the motor alone, without current.

    Parameters
    ----------
    common_nm : float or (low, high), default 0.015
        Amplitude at the least common multiple, in Nm; 0 for none.
    slots_nm, poles_nm : float or (low, high), default 0.004
        Amplitudes at slots and poles, in Nm; 0 for none.
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
    """Friction of the motor's bearings: a constant, and a part that grows with the speed.

    Separating measurement: the current of the motor alone at several speeds.

    Parameters
    ----------
    coulomb_nm : float or (low, high), default 0.02
        Constant part in Nm; 0 for none.
    viscous : float or (low, high), default 2e-4
        In Nm s/rad; 0 for none.
    """

    parameters: ClassVar = {
        "coulomb_nm": EffectParameter("Nm", 0.0, 1e3, 0.0, default=0.02),
        "viscous": EffectParameter("Nm s/rad", 0.0, 1e3, 0.0, default=2e-4),
    }
    separated_by = "the current of the motor alone at several speeds"

    def change_motor(self, motor: Motor, random: Generator) -> Motor:
        return motor.replace(coulomb_nm=self.coulomb_nm, viscous=self.viscous)


class CurrentSensor(Effect):
    """Measurement of the motor's current: offset, white noise and steps, but no answer of the motor to them.

    Values are in Nm, times the torque constant, so that they suit a motor of any torque constant. Separating
    measurement: the reading without current.

    Parameters
    ----------
    offset_nm : float or (low, high), default 0
        Added to the current; 0 for none.
    noise_nm : float or (low, high), default 0.01
        Standard deviation of the noise; 0 for none.
    lsb_nm : float or (low, high), default 0.002
        Step of the converter; 0 for none.
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

    All values are *assumptions*, wide enough for servo motors of 50 to 750 W. By the mean input torque T
    (load over number of lobes, at least 0.01 Nm): rotor of 4e-5 to 7e-5 kg m2 per Nm of T; cogging of 0.5 to
    2 % of T at the least common multiple of slots and poles, 0.1 to 0.5 % at slots and at poles; Coulomb
    friction of 0.5 to 3 % of T, and as much viscous friction at nominal speed; offset within 1 %, noise of
    0.3 to 1 % and steps of 0.15 % of T. Speed control of 20 to 100 Hz, and at least 250 Hz divided by the
    input's turns per second (30 Hz at 500 RPM), below which lobes worn to the papers' chord stall the motor;
    current control of 200 to 1000 Hz; torque constant of 0.05 to 0.5 Nm/A with 1 to 3 % ripple; 3 to 8 pairs
    of poles, 9 to 24 slots.

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
