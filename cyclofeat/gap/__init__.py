"""Where model and measurement disagree, what is missing, how large it is, and how much better it gets.

=======================  ===================================================================================
name                     what it does
=======================  ===================================================================================
``DiscrepancyWorkflow``  all four stages in one, with a report
``NuisancePrior``        what may differ between recordings without being a missing effect
``GapLocator``           where measured torque differs from the simulator's, cell by cell, with honest
                         p-values
``EffectRanker``         which effect of the library would explain it, its look-alikes, what to measure next
``EffectFitter``         how large the effect is, with intervals, and the simulator with it
``GapReport``            how far the gap shrank on recordings held out, against each alternative
``downstream_gain``      what the corrected simulator is worth to a counter that is trained on it
``SummaryGap``           the same questions of published statistics, where there are no recordings
``LoopGap``              the same questions of torque-deflection loops with held output
``summarise``            the numbers that are compared, in families: speed, slow part, amplitudes, third
                         octaves, lines of lobes and shaft, floor, synchronous averages, features
=======================  ===================================================================================
"""

from cyclofeat.gap._comparison import ComparisonRow, DistanceRow
from cyclofeat.gap._downstream import DownstreamGain, downstream_gain
from cyclofeat.gap._fitter import EffectFitter
from cyclofeat.gap._locator import GapLocator, Row
from cyclofeat.gap._loop_parts import loop_shape
from cyclofeat.gap._loops import LoopGap, LoopModel, LoopSmoother
from cyclofeat.gap._null import Bank, NuisancePrior, make_bank
from cyclofeat.gap._phase import PhaseMap
from cyclofeat.gap._ranker import EffectRanker, Ranked
from cyclofeat.gap._report import GapReport
from cyclofeat.gap._summaries import Cell, summarise
from cyclofeat.gap._summary_mode import SummaryGap
from cyclofeat.gap._table import EffectTable
from cyclofeat.gap._workflow import Candidate, DiscrepancyWorkflow

__all__ = [
    "Bank",
    "Candidate",
    "Cell",
    "ComparisonRow",
    "DiscrepancyWorkflow",
    "DistanceRow",
    "DownstreamGain",
    "EffectFitter",
    "EffectRanker",
    "EffectTable",
    "GapLocator",
    "GapReport",
    "LoopGap",
    "LoopModel",
    "LoopSmoother",
    "NuisancePrior",
    "PhaseMap",
    "Ranked",
    "Row",
    "SummaryGap",
    "downstream_gain",
    "loop_shape",
    "make_bank",
    "summarise",
]
