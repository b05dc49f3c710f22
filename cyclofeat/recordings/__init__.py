"""Records of torque or motor current with their labels, and windows cut from them.

===================  ==============================================================================
name                 job
===================  ==============================================================================
``Recording``        one record of a quantity with sampling rate, angle and labels; frozen
``QUANTITIES``       quantities that a recording may hold
``QUANTITY_UNITS``   their units
``SAMPLES_PER_TURN`` samples per input turn of ``shaft_windows``
``ShaftCutter``      the windows of ``shaft_windows`` from samples that arrive in pieces
``Windower``         cut recordings into windows of whole output turns, or of equal duration
``WindowSet``        windows with their counts, assemblies, start angles and worn lobes
``at_lowest_rate``   a recording at the lowest rate that ``shaft_windows`` needs
``window_set``       join cuts of recordings to a ``WindowSet``
``common_quantity``  quantity that recordings share
``common_n_lobes``   number of lobes that recordings share
``common_speed``     nominal input speed that recordings share
===================  ==============================================================================
"""

from cyclofeat._base.quantities import QUANTITIES, QUANTITY_UNITS
from cyclofeat.recordings._recording import Recording, common_n_lobes, common_quantity, common_speed
from cyclofeat.recordings._shaft import (
    SAMPLES_PER_TURN,
    ShaftCutter,
    ShaftWindow,
    at_lowest_rate,
    shaft_windows,
)
from cyclofeat.recordings._windower import Windower, WindowSet, window_set
from cyclofeat.recordings._windower import named as named

__all__ = [
    "QUANTITIES",
    "QUANTITY_UNITS",
    "SAMPLES_PER_TURN",
    "Recording",
    "ShaftCutter",
    "ShaftWindow",
    "WindowSet",
    "Windower",
    "at_lowest_rate",
    "common_n_lobes",
    "common_quantity",
    "common_speed",
    "shaft_windows",
    "window_set",
]
