"""The gap in torque-deflection loops of a drive with held output (:func:`find_loop_gap`)."""

from cyclofeat.gap.loops._loops import LOOP_EFFECTS, LoopGap, LoopModel, LoopSmoother, Subset, find_loop_gap
from cyclofeat.gap.loops._parts import (
    LoopShape,
    contact_deflection,
    elastic_torque,
    loop_shape,
    relative_error,
)

__all__ = [
    "LOOP_EFFECTS",
    "LoopGap",
    "LoopModel",
    "LoopShape",
    "LoopSmoother",
    "Subset",
    "contact_deflection",
    "elastic_torque",
    "find_loop_gap",
    "loop_shape",
    "relative_error",
]
