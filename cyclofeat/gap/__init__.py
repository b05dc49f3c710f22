"""Find where model and measurement disagree, name and size missing effects, and correct the model.

=================  =========================================================================================
room               question
=================  =========================================================================================
``where``          Where do measured and simulated torque disagree? (:func:`locate`)
``posterior``      Which effects are missing, all at once? (:class:`~cyclofeat.gap.posterior.EffectPosterior`)
``world``          Which rigs could it be? (random rigs, from which the posterior learns)
``confirm``        Would a rig with these effects have given these recordings? How large are they?
``proof``          How far did the gap shrink on recordings held out? (:func:`prove`)
``comparison``     Which model, which conditions? (:class:`Comparison`)
``simulations``    What would the model alone have given? (:meth:`Comparison.bank`)
``summaries``      Which numbers of a recording are compared? (:func:`summarise`)
``_workflow``      All of it in turn (:func:`find_gap`)
=================  =========================================================================================

:func:`find_gap` names everything that is missing at once, from recordings at one condition or several, and
returns a :class:`GapResult`. :func:`find_published_gap` asks the same questions of published statistics,
:func:`find_loop_gap` of torque-deflection loops with the output held.
"""

from cyclofeat.gap._compare import compare_recordings
from cyclofeat.gap._hold_out import hold_out
from cyclofeat.gap._measured import Condition, MeasuredRig
from cyclofeat.gap._overlays import Band, Overlay, overlays
from cyclofeat.gap._result import (
    FoundEffect,
    GapResult,
    NextMeasurement,
    Remainder,
    RemainderRow,
    Size,
    VisibleFrom,
)
from cyclofeat.gap._settings import GapSettings
from cyclofeat.gap._where import Where, WhereRow, where_of
from cyclofeat.gap._workflow import find_gap
from cyclofeat.gap.check import CheckedEffect, GapCheck, check_recordings
from cyclofeat.gap.comparison import MAY_DIFFER, Comparison
from cyclofeat.gap.loops import LoopGap, LoopModel, LoopSmoother, find_loop_gap, loop_shape
from cyclofeat.gap.proof.prove import DistanceRow, Proof, ProofRow, prove
from cyclofeat.gap.published import PublishedGap, PublishedSettings, find_published_gap
from cyclofeat.gap.simulations import Bank, Population
from cyclofeat.gap.summaries import Cell, Conditions, MeasuredTurns, PhaseMap, summarise
from cyclofeat.gap.where import LocatedGap, Row, locate, locate_all

__all__ = [
    "MAY_DIFFER",
    "Band",
    "Bank",
    "Cell",
    "CheckedEffect",
    "Comparison",
    "Condition",
    "Conditions",
    "DistanceRow",
    "FoundEffect",
    "GapCheck",
    "GapResult",
    "GapSettings",
    "LocatedGap",
    "LoopGap",
    "LoopModel",
    "LoopSmoother",
    "MeasuredRig",
    "MeasuredTurns",
    "NextMeasurement",
    "Overlay",
    "PhaseMap",
    "Population",
    "Proof",
    "ProofRow",
    "PublishedGap",
    "PublishedSettings",
    "Remainder",
    "RemainderRow",
    "Row",
    "Size",
    "VisibleFrom",
    "Where",
    "WhereRow",
    "check_recordings",
    "compare_recordings",
    "find_gap",
    "find_loop_gap",
    "find_published_gap",
    "hold_out",
    "locate",
    "locate_all",
    "loop_shape",
    "overlays",
    "prove",
    "summarise",
    "where_of",
]
