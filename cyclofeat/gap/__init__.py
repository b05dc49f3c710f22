"""Where model and measurement disagree.

=================  =========================================================================================
name               what it does
=================  =========================================================================================
``NuisancePrior``  what may differ between recordings without being a missing effect
``GapLocator``     where measured torque differs from the simulator's, cell by cell, with honest p-values
``EffectRanker``   which effect of the library would explain it, its look-alikes, what to measure next
``summarise``      the numbers that are compared, in families: slow part, amplitudes, third octaves, lines of
                   lobes and shaft, floor, synchronous averages, features
=================  =========================================================================================
"""

from cyclofeat.gap._locator import GapLocator, Row
from cyclofeat.gap._null import Bank, NuisancePrior, make_bank
from cyclofeat.gap._ranker import EffectRanker, Ranked
from cyclofeat.gap._summaries import Cell, summarise

__all__ = [
    "Bank",
    "Cell",
    "EffectRanker",
    "GapLocator",
    "NuisancePrior",
    "Ranked",
    "Row",
    "make_bank",
    "summarise",
]
