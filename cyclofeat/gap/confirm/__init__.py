"""Confirmation by simulation: sizes of the effects that a posterior names, and what they leave unexplained.

:func:`confirm` simulates sessions like the measured one with the named effects, fits their sizes, and states
how far the measured session lies from those of the corrected rig. :func:`draw_effects` draws effects
and sizes from what the recordings leave possible. :func:`simulate_possible` simulates such rigs, which tells
what further recordings would settle.
"""

from cyclofeat.gap.confirm._confirm import Confirmed, confirm
from cyclofeat.gap.confirm._draws import draw_effects
from cyclofeat.gap.confirm._next import FurtherRecordings, Possible, simulate_possible
from cyclofeat.gap.confirm._remainder import Unexplained, unexplained
from cyclofeat.gap.confirm._sessions import SimulatedSessions, simulate_prior, simulate_sessions
from cyclofeat.gap.confirm._sizes import Gaussian, size_posterior

__all__ = [
    "Confirmed",
    "FurtherRecordings",
    "Gaussian",
    "Possible",
    "SimulatedSessions",
    "Unexplained",
    "confirm",
    "draw_effects",
    "simulate_possible",
    "simulate_prior",
    "simulate_sessions",
    "size_posterior",
    "unexplained",
]
