"""Check planned recordings: effects that they could reveal, and right answers on known rigs."""

from cyclofeat.gap.check._check import CheckedEffect, GapCheck, check_recordings

__all__ = ["CheckedEffect", "GapCheck", "check_recordings"]
