"""The cycloidal gearbox as a planar multibody system.

===============  ================================================================================
module           responsibility
===============  ================================================================================
``gearbox``      parameters of gearbox and rig: a frozen dataclass in SI units; geometry of the profile
``defects``      worn and removed lobes
``effects``      properties of real rigs: parameters, bounds, priors, place in the chain
``motor``        the motor on the input shaft with control of its speed; runs as it would have made them
``rig``          a gearbox with effects: draws machines, simulates records, reads and writes files
``simulation``   runs of one gearbox or of many, and the time until they are steady
``courses``      input speed and load over time
``tables``       parameters as the compiled kernel takes them, those of contacts included
``held_output``  torque against deflection with the output held
``sampling``     draws assemblies and recordings of rigs from seeds, for all who simulate them
``batch``        many gearboxes at once, one in each lane of the processor's vectors
``campaign``     thousands of runs from a declared design to files: resumable, on joblib or Dask
``_jit``         numba, or plain Python where it is switched off
``machine``      one machine of a rig, its run, and records of the run
``_simulator``   base of users' simulators
``_kernels``     the reduced model in numba: floats and arrays only
``_outline``     contacts of pins and wheels, likewise
===============  ================================================================================
"""

from cyclofeat.simulators import effects
from cyclofeat.simulators._simulator import Simulator
from cyclofeat.simulators.campaign import Campaign, load_campaign, run_campaign
from cyclofeat.simulators.courses import Courses
from cyclofeat.simulators.defects import LobeDefects
from cyclofeat.simulators.effects import *  # noqa: F403
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.held_output import torque_deflection
from cyclofeat.simulators.many import simulate_many
from cyclofeat.simulators.motor import Motor
from cyclofeat.simulators.rig import Rig
from cyclofeat.simulators.simulation import SimulationFailed, SimulationRun, Solver, simulate

__all__ = [
    "Campaign",
    "Courses",
    "CycloidalGearbox",
    "LobeDefects",
    "Motor",
    "Rig",
    "SimulationFailed",
    "SimulationRun",
    "Simulator",
    "Solver",
    "load_campaign",
    "run_campaign",
    "simulate",
    "simulate_many",
    "torque_deflection",
]
__all__ += effects.__all__
