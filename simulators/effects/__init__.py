"""What a real rig does and the plain simulation does not: physical and measurement effects.

=============================  =======================================================================
effect                         what it is
=============================  =======================================================================
``PinErrors``                  position errors of the pins
``LobePitchErrors``            pitch errors of the lobes
``RunOut``, ``CamRunOut``      run-out of the wheels, and of the cams (1x)
``Clearance``                  clearance of the internal sleeves
``ContactStiffnessScale``      stiffness of all contacts by a factor
``ContactDampingScale``        damping of all contacts by a factor
``ContactDampingForm``         contact damping weighted with the elastic force
``LoadDrift``                  slow fluctuation of the brake's torque
``ProportionalDrift``          the same in proportion to the torque (a variant: not in `effect_library`)
``SpeedWander``                fluctuation of the input speed
``SleeveFriction``             friction of the sleeves on wheels and axles
``BearingFriction``            friction of the output shaft's bearings
``BrakeRotor``                 the brake's rotor behind shaft and torque meter
``TorqueMeterLowPass``         low-pass in the torque meter
``SensorDrift``                drift of the torque meter's zero
``Gain``, ``Offset``           calibration and zero of the torque meter
``Noise``, ``Hum``             noise and mains hum in the torque signal
``ClockError``                 error of the converter's clock
``Quantisation``               steps and range of the converter
=============================  =======================================================================

The chain has one order, whatever the order in which effects are given: :class:`Place`. Priors and default
values are *assumptions*. :class:`cyclofeat.simulators.CompositeSimulator` applies effects to gearbox or rig.
"""

from cyclofeat.simulators.effects._base import (
    Effect,
    EffectParameter,
    LogUniform,
    Normal,
    Place,
    TorqueContext,
    Uniform,
)
from cyclofeat.simulators.effects._converter import ClockError, Quantisation
from cyclofeat.simulators.effects._drive import LoadDrift, ProportionalDrift, SpeedWander
from cyclofeat.simulators.effects._gearbox import (
    BearingFriction,
    BrakeRotor,
    CamRunOut,
    Clearance,
    ContactDampingForm,
    ContactDampingScale,
    ContactStiffnessScale,
    LobePitchErrors,
    PinErrors,
    RunOut,
    SleeveFriction,
)
from cyclofeat.simulators.effects._library import effect_library
from cyclofeat.simulators.effects._meter import Gain, Hum, Noise, Offset, SensorDrift, TorqueMeterLowPass

__all__ = [
    "BearingFriction",
    "BrakeRotor",
    "CamRunOut",
    "Clearance",
    "ClockError",
    "ContactDampingForm",
    "ContactDampingScale",
    "ContactStiffnessScale",
    "Effect",
    "EffectParameter",
    "Gain",
    "Hum",
    "LoadDrift",
    "LobePitchErrors",
    "LogUniform",
    "Noise",
    "Normal",
    "Offset",
    "PinErrors",
    "Place",
    "ProportionalDrift",
    "Quantisation",
    "RunOut",
    "SensorDrift",
    "SleeveFriction",
    "SpeedWander",
    "TorqueContext",
    "TorqueMeterLowPass",
    "Uniform",
    "effect_library",
]
