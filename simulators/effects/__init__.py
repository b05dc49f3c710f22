"""Physical and measurement effects of real rigs.

===========================  =========================================================================
effect                       deviation
===========================  =========================================================================
``GearboxParameter``         one field of the nominal gearbox (*)
``PinErrors``                position errors of the pins
``LobePitchErrors``          pitch errors of the lobes
``RunOut``, ``CamRunOut``    run-out of the wheels, and of the cams (1x)
``Clearance``                clearance of the internal sleeves
``Scale``                    stiffness or damping of all contacts, load (*) or speed (*) by a factor
``ContactDampingForm``       contact damping weighted with the elastic force
``Drift``                    slow fluctuation of the brake's torque or of the torque meter's zero
``ProportionalDrift``        that of the brake in proportion to the torque (*)
``WarmUp``                   exponential decay of the brake's torque or of the torque meter's zero (*)
``SpeedWander``              fluctuation of the input speed
``StickSlip``                sawtooth of a brake that sticks and slips (*)
``Rattle``                   blows of a part with play on the output shaft (*)
``SleeveFriction``           friction of the sleeves on wheels and axles
``BearingFriction``          friction of the output shaft's bearings
``BrakeRotor``               the brake's rotor behind shaft and torque meter
``TorqueMeterLowPass``       low-pass in the torque meter
``ShaftLine``                wave in the torque signal once per turn of the input or output (*)
``Gain``, ``Offset``         calibration and zero of the torque meter
``Noise``, ``Hum``           noise and mains hum in the torque signal
``ClockError``               error of the converter's clock
``Quantisation``             steps and range of the converter
``Clipping``                 range of amplifier or converter (*)
``LostSamples``              blocks of samples held, zero or cut out (*)
``ServoMotor``               motor with control of its speed, in place of a given speed (*)
``TorqueConstantRipple``     ripple of the motor's torque constant (*)
``Cogging``                  torque between the motor's magnets and slots (*)
``MotorFriction``            friction of the motor's bearings (*)
``CurrentSensor``            offset, noise and steps of the motor's current (*)
===========================  =========================================================================

(*) A search that adds one effect at a time does not propose it.

The chain has one order, whatever the order in which effects are given (:attr:`Effect.place`). Priors and
default values are *assumptions*. :class:`cyclofeat.simulators.Rig` applies effects to a gearbox, and
:func:`known_effects` lists all. ``library`` has them by the names in files, ``effect`` is their base class.
"""

from cyclofeat.simulators.effects._drive import (
    Drift,
    ProportionalDrift,
    Rattle,
    SpeedWander,
    StickSlip,
    WarmUp,
)
from cyclofeat.simulators.effects._gearbox import (
    BearingFriction,
    BrakeRotor,
    CamRunOut,
    Clearance,
    ContactDampingForm,
    GearboxParameter,
    LobePitchErrors,
    PinErrors,
    RunOut,
    Scale,
    SleeveFriction,
)
from cyclofeat.simulators.effects._loading import load_effects
from cyclofeat.simulators.effects._meter import (
    Clipping,
    ClockError,
    Gain,
    Hum,
    LostSamples,
    Noise,
    Offset,
    Quantisation,
    ShaftLine,
    TorqueMeterLowPass,
)
from cyclofeat.simulators.effects._motor import (
    Cogging,
    CurrentSensor,
    MotorFriction,
    ServoMotor,
    TorqueConstantRipple,
    motor_effects,
)
from cyclofeat.simulators.effects._parameter import EffectParameter
from cyclofeat.simulators.effects.effect import Effect
from cyclofeat.simulators.effects.library import known_effects, register_effect, unregister_effect

__all__ = [
    "BearingFriction",
    "BrakeRotor",
    "CamRunOut",
    "Clearance",
    "Clipping",
    "ClockError",
    "Cogging",
    "ContactDampingForm",
    "CurrentSensor",
    "Drift",
    "Effect",
    "EffectParameter",
    "Gain",
    "GearboxParameter",
    "Hum",
    "LobePitchErrors",
    "LostSamples",
    "MotorFriction",
    "Noise",
    "Offset",
    "PinErrors",
    "ProportionalDrift",
    "Quantisation",
    "Rattle",
    "RunOut",
    "Scale",
    "ServoMotor",
    "ShaftLine",
    "SleeveFriction",
    "SpeedWander",
    "StickSlip",
    "TorqueConstantRipple",
    "TorqueMeterLowPass",
    "WarmUp",
    "known_effects",
    "load_effects",
    "motor_effects",
    "register_effect",
    "unregister_effect",
]
