"""The papers' own formulation of the gearbox: 28 planar bodies held together by Lagrange multipliers.

Two shafts, two wheels, 8 internal and 16 external sleeves have 84 coordinates and 57 constraints (paper B,
equations 2-16). :class:`ReferenceGearbox` solves this system in plain NumPy, a thousand times slower than
:func:`~cyclofeat.simulators.simulate`, whose reduced model gives the same accelerations, forces and torques
to rounding.
"""

from cyclofeat.simulators.reference._bodies import (
    ReferenceGearbox,
    Solution,
    Trajectory,
    ramped_driver,
    ramped_load,
)

__all__ = [
    "ReferenceGearbox",
    "Solution",
    "Trajectory",
    "ramped_driver",
    "ramped_load",
]
