"""Records of torque or motor current with their labels, and windows cut from them."""

from cyclofeat.recordings.recording import Recording
from cyclofeat.recordings.windower import Windower, WindowSet

__all__ = ["Recording", "WindowSet", "Windower"]
