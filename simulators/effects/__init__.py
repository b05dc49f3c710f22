"""Physical and measurement effects of real rigs.

Effects of the gearbox are in ``_gearbox``, of load, speed and motor in ``_drive``, of torque meter and
converter in ``_meter``; ``effect`` has their base class and ``library`` the effects by the names that files
hold (:func:`known_effects`). The chain has one order, whatever the order in which effects
are given (:attr:`Effect.place`). Priors and default values are *assumptions*.
:class:`cyclofeat.simulators.Rig` applies effects to a gearbox.
"""

from cyclofeat.simulators.effects._drive import (
    Drift,
    ProportionalDrift,
    Rattle,
    ServoMotor,
    SpeedWander,
    StickSlip,
    WarmUp,
    motor_effects,
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
from cyclofeat.simulators.effects.effect import Effect, EffectParameter
from cyclofeat.simulators.effects.library import (
    known_effects,
    load_effects,
    register_effect,
    unregister_effect,
)

__all__ = [
    "BearingFriction",
    "BrakeRotor",
    "CamRunOut",
    "Clearance",
    "Clipping",
    "ClockError",
    "ContactDampingForm",
    "Drift",
    "Effect",
    "EffectParameter",
    "Gain",
    "GearboxParameter",
    "Hum",
    "LobePitchErrors",
    "LostSamples",
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
    "TorqueMeterLowPass",
    "WarmUp",
    "known_effects",
    "load_effects",
    "motor_effects",
    "register_effect",
    "unregister_effect",
]
