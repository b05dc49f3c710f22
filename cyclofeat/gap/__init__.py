"""Find where model and measurement disagree, name and size missing effects, and correct the model.

=================  =========================================================================================
module             question
=================  =========================================================================================
``comparison``     Which model, which conditions, which settings? (:class:`Comparison`, :class:`GapSettings`)
``measured``       Which recordings, at which speeds and loads? (``MeasuredRig``, :class:`Condition`)
``simulations``    What would the model alone have given? (:meth:`Comparison.bank`)
``summaries``      Which numbers of a recording are compared?
``where``          Where do measured and simulated torque disagree?
``world``          Which rigs could it be? (:class:`World`, :func:`prepare_world`)
``posterior``      Which effects are missing, all at once? (:class:`EffectPosterior`)
``confirm``        Would a rig with these effects have given these recordings? How large are they?
``proof``          How far did the gap shrink on recordings held out?
``check``          What could recordings reveal? (:func:`check_recordings`)
=================  =========================================================================================

:func:`find_gap` asks all of them, of recordings at one condition or several, and returns a
:class:`GapResult`. :func:`find_published_gap` asks the same questions of published statistics,
:func:`find_loop_gap` of torque-deflection loops with the output held.
"""

from cyclofeat.gap._workflow import compare_recordings, find_gap, hold_out
from cyclofeat.gap.cases.held_drive import find_loop_gap
from cyclofeat.gap.cases.published_table import find_published_gap
from cyclofeat.gap.check import GapCheck, check_recordings
from cyclofeat.gap.comparison import Comparison, Condition, GapSettings
from cyclofeat.gap.posterior.effect_posterior import EffectPosterior, load_posterior
from cyclofeat.gap.result import GapResult
from cyclofeat.gap.world.prepare import prepare_world
from cyclofeat.gap.world.world import World

__all__ = [
    "Comparison",
    "Condition",
    "EffectPosterior",
    "GapCheck",
    "GapResult",
    "GapSettings",
    "World",
    "check_recordings",
    "compare_recordings",
    "find_gap",
    "find_loop_gap",
    "find_published_gap",
    "hold_out",
    "load_posterior",
    "prepare_world",
]
