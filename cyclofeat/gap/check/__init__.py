"""What recordings could tell, before they are made, and how often the posterior is right about known rigs."""

from cyclofeat.gap.check._check import CheckedEffect, GapCheck, check_recordings
from cyclofeat.gap.check._sizes import detection_limit

__all__ = ["CheckedEffect", "GapCheck", "check_recordings", "detection_limit"]
