"""The cycloidal gearbox as a planar multibody system.

===============  ================================================================================
module           responsibility
===============  ================================================================================
``geometry``     closed-form geometry of profile, lobes and chords
``gearbox``      parameters of gearbox, rig and faults: frozen dataclasses in SI units
``contact``      contact parameters by material and geometry
``tolerances``   random errors of single assemblies
``rig``          gearbox and test rig in one readable description, from which assemblies are drawn
``effects``      what a real rig does besides: parameters, bounds, priors, place in the chain
``composite``    gearbox or rig with effects: the simulator of a record as a real rig would give it
``simulation``   from parameters to a run
``held_output``  the rig's other mode: torque against deflection with the output held
``many``         many runs at once, on several cores
``campaign``     thousands of runs from a declared design to files: resumable, on joblib or Dask
``audit``        where the energy of a run goes
``_chatter``     whether friction is too steep for the time step
``_checks``      what arguments must be, said in one way
``_kernels``     the reduced model in numba: floats and arrays only
``_outline``     where pins meet wheels, described for a while at a time: likewise
``reference``    the papers' own 28-body system in plain NumPy: the oracle, never the product;
                 ``reference_friction`` lets its sleeves rub
===============  ================================================================================
"""

from cyclofeat.simulators.audit import EnergyAudit, energy_audit
from cyclofeat.simulators.campaign import Campaign, CampaignData, WorkerLost, load_campaign
from cyclofeat.simulators.composite import CompositeSimulator, MachineRun
from cyclofeat.simulators.effects import (
    BearingFriction,
    BrakeRotor,
    CamRunOut,
    Clearance,
    ClockError,
    ContactDampingForm,
    ContactDampingScale,
    ContactStiffnessScale,
    Effect,
    Gain,
    Hum,
    LoadDrift,
    LobePitchErrors,
    Noise,
    Offset,
    PinErrors,
    Place,
    ProportionalDrift,
    Quantisation,
    RunOut,
    SensorDrift,
    SleeveFriction,
    SpeedWander,
    TorqueMeterLowPass,
    effect_library,
)
from cyclofeat.simulators.gearbox import CycloidalGearbox, LobeDefects
from cyclofeat.simulators.geometry import CycloidalProfile
from cyclofeat.simulators.held_output import TorqueDeflection, torque_deflection
from cyclofeat.simulators.many import simulate_many
from cyclofeat.simulators.rig import Rig, settling_time
from cyclofeat.simulators.simulation import (
    GearboxLocked,
    SimulationDiverged,
    SimulationFailed,
    SimulationRun,
    simulate,
)
from cyclofeat.simulators.tolerances import AssemblyTolerances

__all__ = [
    "AssemblyTolerances",
    "BearingFriction",
    "BrakeRotor",
    "CamRunOut",
    "Campaign",
    "CampaignData",
    "Clearance",
    "ClockError",
    "CompositeSimulator",
    "ContactDampingForm",
    "ContactDampingScale",
    "ContactStiffnessScale",
    "CycloidalGearbox",
    "CycloidalProfile",
    "Effect",
    "EnergyAudit",
    "Gain",
    "GearboxLocked",
    "Hum",
    "LoadDrift",
    "LobeDefects",
    "LobePitchErrors",
    "MachineRun",
    "Noise",
    "Offset",
    "PinErrors",
    "Place",
    "ProportionalDrift",
    "Quantisation",
    "Rig",
    "RunOut",
    "SensorDrift",
    "SimulationDiverged",
    "SimulationFailed",
    "SimulationRun",
    "SleeveFriction",
    "SpeedWander",
    "TorqueDeflection",
    "TorqueMeterLowPass",
    "WorkerLost",
    "effect_library",
    "energy_audit",
    "load_campaign",
    "settling_time",
    "simulate",
    "simulate_many",
    "torque_deflection",
]
