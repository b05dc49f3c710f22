"""What recordings could tell, before they are made, and how often the posterior is right about known rigs."""

from cyclofeat.gap.check._check import CheckedEffect, GapCheck, check_recordings

__all__ = ["CheckedEffect", "GapCheck", "check_recordings"]
