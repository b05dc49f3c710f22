"""Physical and measurement effects of real rigs.

=============================  =======================================================================
effect                         deviation
=============================  =======================================================================
``GearboxParameter``           one field of the nominal gearbox (*)
``PinErrors``                  position errors of the pins
``LobePitchErrors``            pitch errors of the lobes
``RunOut``, ``CamRunOut``      run-out of the wheels, and of the cams (1x)
``Clearance``                  clearance of the internal sleeves
``ContactStiffnessScale``      stiffness of all contacts by a factor
``ContactDampingScale``        damping of all contacts by a factor
``ContactDampingForm``         contact damping weighted with the elastic force
``LoadDrift``                  slow fluctuation of the brake's torque
``ProportionalDrift``          the same in proportion to the torque (*)
``LoadScale``, ``SpeedScale``  set-points of load and speed by a factor (*)
``SpeedWander``                fluctuation of the input speed
``StickSlip``                  sawtooth of a brake that sticks and slips (*)
``Rattle``                     blows of a part with play on the output shaft (*)
``LoadWarmUp``                 exponential decay of the brake's torque (*)
``SleeveFriction``             friction of the sleeves on wheels and axles
``BearingFriction``            friction of the output shaft's bearings
``BrakeRotor``                 the brake's rotor behind shaft and torque meter
``TorqueMeterLowPass``         low-pass in the torque meter
``SensorDrift``                drift of the torque meter's zero
``SensorWarmUp``               exponential decay of the torque meter's zero (*)
``InputShaftLine``             wave in the torque signal once per turn of the input (*)
``OutputShaftLine``            the same of the output (*)
``Gain``, ``Offset``           calibration and zero of the torque meter
``Noise``, ``Hum``             noise and mains hum in the torque signal
``ClockError``                 error of the converter's clock
``Quantisation``               steps and range of the converter
``Clipping``                   range of amplifier or converter (*)
``LostSamples``                blocks of samples held, zero or cut out (*)
``ServoMotor``                 motor with control of its speed, in place of a given speed (*)
``TorqueConstantRipple``       ripple of the motor's torque constant (*)
``Cogging``                    torque between the motor's magnets and slots (*)
``MotorFriction``              friction of the motor's bearings (*)
``CurrentSensor``              offset, noise and steps of the motor's current (*)
=============================  =======================================================================

(*) Rigs and files can name it; :func:`effect_library` does not propose it, :func:`known_effects` lists it.

The chain has one order, whatever the order in which effects are given: :class:`Place`. Priors and default
values are *assumptions*. :class:`cyclofeat.simulators.Rig` applies effects to a gearbox.
:func:`register_effect` and :func:`load_effects` add effects of users. :func:`motor_effects` returns a motor
for a gearbox.
"""

from cyclofeat.simulators.effects._base import Effect, Place, TorqueContext
from cyclofeat.simulators.effects._converter import Clipping, ClockError, LostSamples, Quantisation
from cyclofeat.simulators.effects._drive import (
    LoadDrift,
    LoadScale,
    ProportionalDrift,
    Rattle,
    SpeedScale,
    SpeedWander,
    StickSlip,
)
from cyclofeat.simulators.effects._gearbox import (
    BearingFriction,
    BrakeRotor,
    CamRunOut,
    Clearance,
    ContactDampingForm,
    ContactDampingScale,
    ContactStiffnessScale,
    GearboxParameter,
    LobePitchErrors,
    PinErrors,
    RunOut,
    SleeveFriction,
)
from cyclofeat.simulators.effects._library import (
    effect_library,
    known_effects,
    register_effect,
    unregister_effect,
)
from cyclofeat.simulators.effects._loading import load_effects
from cyclofeat.simulators.effects._meter import (
    Gain,
    Hum,
    InputShaftLine,
    Noise,
    Offset,
    OutputShaftLine,
    SensorDrift,
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
from cyclofeat.simulators.effects._numbers import EffectParameter
from cyclofeat.simulators.effects._warm_up import LoadWarmUp, SensorWarmUp

__all__ = [
    "BearingFriction",
    "BrakeRotor",
    "CamRunOut",
    "Clearance",
    "Clipping",
    "ClockError",
    "Cogging",
    "ContactDampingForm",
    "ContactDampingScale",
    "ContactStiffnessScale",
    "CurrentSensor",
    "Effect",
    "EffectParameter",
    "Gain",
    "GearboxParameter",
    "Hum",
    "InputShaftLine",
    "LoadDrift",
    "LoadScale",
    "LoadWarmUp",
    "LobePitchErrors",
    "LostSamples",
    "MotorFriction",
    "Noise",
    "Offset",
    "OutputShaftLine",
    "PinErrors",
    "Place",
    "ProportionalDrift",
    "Quantisation",
    "Rattle",
    "RunOut",
    "SensorDrift",
    "SensorWarmUp",
    "ServoMotor",
    "SleeveFriction",
    "SpeedScale",
    "SpeedWander",
    "StickSlip",
    "TorqueConstantRipple",
    "TorqueContext",
    "TorqueMeterLowPass",
    "effect_library",
    "known_effects",
    "load_effects",
    "motor_effects",
    "register_effect",
    "unregister_effect",
]
