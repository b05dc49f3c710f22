"""The third stage of the gap: how large the missing effect is.

:func:`fit_effects` fits the parameters of effects to measured recordings, with intervals, and adds the
effects to the model.
"""

from cyclofeat.gap.size._calibration import Calibration as Calibration
from cyclofeat.gap.size._fit import FittedEffects, FittedParameter, fit_effects

__all__ = [
    "FittedEffects",
    "FittedParameter",
    "fit_effects",
]
