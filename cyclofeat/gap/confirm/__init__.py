"""Confirmation by simulation: sizes of the effects that a posterior names, and what they leave unexplained.

:func:`confirm` simulates sessions like the measured one with the named effects, fits their sizes, and states
how far the measured session lies from those of the corrected rig.
"""

from cyclofeat.gap.confirm._confirm import Confirmed, confirm
from cyclofeat.gap.confirm._remainder import Unexplained
from cyclofeat.gap.confirm._sessions import Simulated, simulate_sessions

__all__ = ["Confirmed", "Simulated", "Unexplained", "confirm", "simulate_sessions"]
