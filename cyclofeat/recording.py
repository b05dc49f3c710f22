"""One torque record with its labels, and its cutting into windows."""

from cyclofeat._recording import Recording
from cyclofeat._recording import common_n_lobes as common_n_lobes
from cyclofeat._windower import Windower, WindowSet

__all__ = ["Recording", "WindowSet", "Windower"]
