"""The training world of the joint posterior: random rigs, their sessions, and summaries of their recordings.

:class:`World` states the prior, :func:`prepare_world` simulates it into a folder, and :class:`Rigs` holds the
result. A :class:`Session` holds the recordings of one rig, measured or simulated.
"""

from cyclofeat.gap.world._cells import recording_cells, turn_samples
from cyclofeat.gap.world._machine import FEWEST_RECORDINGS, DrawnMachine, simulate_drawn
from cyclofeat.gap.world._prepare import prepare_world
from cyclofeat.gap.world._prior import FLOOR, TOLERANCES, DrawnSession, EffectPrior
from cyclofeat.gap.world._rigs import Rigs, Session, present_effects
from cyclofeat.gap.world._world import World

__all__ = [
    "FEWEST_RECORDINGS",
    "FLOOR",
    "TOLERANCES",
    "DrawnMachine",
    "DrawnSession",
    "EffectPrior",
    "Rigs",
    "Session",
    "World",
    "prepare_world",
    "present_effects",
    "recording_cells",
    "simulate_drawn",
    "turn_samples",
]
