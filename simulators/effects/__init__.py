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

(*) Rigs and files can name it; :func:`effect_library` does not propose it.

The chain has one order, whatever the order in which effects are given: :class:`Place`. Priors and default
values are *assumptions*. :class:`cyclofeat.simulators.Rig` applies effects to a gearbox.
:func:`register_effect` and :func:`load_effects` add effects of users.
"""

from cyclofeat.simulators.effects._base import Effect, Place, TorqueContext
from cyclofeat.simulators.effects._converter import ClockError, Quantisation
from cyclofeat.simulators.effects._drive import (
    LoadDrift,
    LoadScale,
    ProportionalDrift,
    SpeedScale,
    SpeedWander,
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
from cyclofeat.simulators.effects._library import effect_library, register_effect, unregister_effect
from cyclofeat.simulators.effects._loading import load_effects
from cyclofeat.simulators.effects._meter import Gain, Hum, Noise, Offset, SensorDrift, TorqueMeterLowPass
from cyclofeat.simulators.effects._numbers import EffectParameter

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
    "GearboxParameter",
    "Hum",
    "LoadDrift",
    "LoadScale",
    "LobePitchErrors",
    "Noise",
    "Offset",
    "PinErrors",
    "Place",
    "ProportionalDrift",
    "Quantisation",
    "RunOut",
    "SensorDrift",
    "SleeveFriction",
    "SpeedScale",
    "SpeedWander",
    "TorqueContext",
    "TorqueMeterLowPass",
    "effect_library",
    "load_effects",
    "register_effect",
    "unregister_effect",
]
