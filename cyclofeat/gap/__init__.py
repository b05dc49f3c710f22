"""Where model and measurement disagree, what is missing, how large it is, and how much better it gets.

=================  =========================================================================================
room               question
=================  =========================================================================================
``where``          Where do measured and simulated torque disagree? (:func:`locate`)
``what``           Which effect of the library is missing? (:func:`learn_effects` draws the table of
                   effects, :meth:`EffectRanker.rank` names them)
``size``           How large is it? (:func:`fit_effects`)
``proof``          How far did the gap shrink on recordings held out? (:func:`prove`,
                   :func:`downstream_gain`)
``comparison``     Which model, which conditions? (:class:`Comparison`, the first argument of all stages)
``simulations``    What would the model alone have given? (:meth:`Comparison.bank`)
``summaries``      Which numbers of a recording are compared? (:func:`summarise`)
``world``          Which rigs could it be? (random rigs, from which a joint posterior learns)
``posterior``      Which effects are missing, all at once? (learned from such rigs)
``confirm``        Would a rig with these effects have given these recordings? How large are they?
``_workflow``      The four stages in turn (:func:`find_gap`)
=================  =========================================================================================

:func:`find_gap` runs all four stages for a :class:`Comparison` and returns a :class:`GapResult`.
:func:`find_joint_gap` names everything that is missing at once, from recordings at several conditions, and
returns a :class:`JointGap`. :func:`find_published_gap` asks the same questions of published statistics,
:func:`find_loop_gap` of torque-deflection loops with the output held.
"""

from cyclofeat.gap._answer import FoundEffect, JointGap, NextMeasurement, Remainder, RemainderRow, Size
from cyclofeat.gap._compare import compare_recordings
from cyclofeat.gap._hold_out import hold_out
from cyclofeat.gap._joint import find_joint_gap
from cyclofeat.gap._measured import Condition, MeasuredRig
from cyclofeat.gap._overlays import Band, Overlay, overlays
from cyclofeat.gap._result import EffectProbability, GapResult
from cyclofeat.gap._settings import GapSettings, Windows
from cyclofeat.gap._where import Where, WhereRow, where_of
from cyclofeat.gap._workflow import find_gap, prepare_ranker
from cyclofeat.gap.comparison import MAY_DIFFER, Comparison
from cyclofeat.gap.loops import LoopGap, LoopModel, LoopSmoother, find_loop_gap, loop_shape
from cyclofeat.gap.proof import DistanceRow, DownstreamGain, Proof, ProofRow, downstream_gain, prove
from cyclofeat.gap.published import PublishedGap, PublishedSettings, find_published_gap
from cyclofeat.gap.simulations import Bank, Population
from cyclofeat.gap.size import FittedEffects, FittedParameter, fit_effects
from cyclofeat.gap.summaries import Cell, Conditions, Measured, PhaseMap, summarise
from cyclofeat.gap.what import EffectRanker, EffectTable, RankedEffect, Ranking, learn_effects
from cyclofeat.gap.where import LocatedGap, Row, locate, locate_all

__all__ = [
    "MAY_DIFFER",
    "Band",
    "Bank",
    "Cell",
    "Comparison",
    "Condition",
    "Conditions",
    "DistanceRow",
    "DownstreamGain",
    "EffectProbability",
    "EffectRanker",
    "EffectTable",
    "FittedEffects",
    "FittedParameter",
    "FoundEffect",
    "GapResult",
    "GapSettings",
    "JointGap",
    "LocatedGap",
    "LoopGap",
    "LoopModel",
    "LoopSmoother",
    "Measured",
    "MeasuredRig",
    "NextMeasurement",
    "Overlay",
    "PhaseMap",
    "Population",
    "Proof",
    "ProofRow",
    "PublishedGap",
    "PublishedSettings",
    "RankedEffect",
    "Ranking",
    "Remainder",
    "RemainderRow",
    "Row",
    "Size",
    "Where",
    "WhereRow",
    "Windows",
    "compare_recordings",
    "downstream_gain",
    "find_gap",
    "find_joint_gap",
    "find_loop_gap",
    "find_published_gap",
    "fit_effects",
    "hold_out",
    "learn_effects",
    "locate",
    "locate_all",
    "loop_shape",
    "overlays",
    "prepare_ranker",
    "prove",
    "summarise",
    "where_of",
]
