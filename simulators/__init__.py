"""The cycloidal gearbox as a planar multibody system.

===============  ================================================================================
module           responsibility
===============  ================================================================================
``geometry``     closed-form geometry of profile, lobes and chords
``gearbox``      parameters of gearbox, rig and faults: frozen dataclasses in SI units
``contact``      contact parameters by material and geometry
``tolerances``   random errors of single assemblies
``rig``          gearbox and test rig in one readable description, from which assemblies are drawn
``simulation``   from parameters to a run
``_kernels``     the reduced model in numba: floats and arrays only
``reference``    the papers' own 28-body system in plain NumPy: the oracle, never the product
===============  ================================================================================
"""

from cyclofeat.simulators.gearbox import CycloidalGearbox, LobeDefects
from cyclofeat.simulators.geometry import CycloidalProfile
from cyclofeat.simulators.rig import Rig, settling_time
from cyclofeat.simulators.simulation import SimulationDiverged, SimulationRun, simulate
from cyclofeat.simulators.tolerances import AssemblyTolerances

__all__ = [
    "AssemblyTolerances",
    "CycloidalGearbox",
    "CycloidalProfile",
    "LobeDefects",
    "Rig",
    "SimulationDiverged",
    "SimulationRun",
    "settling_time",
    "simulate",
]
