"""Records of torque or motor current with their labels, and windows cut from them.

==================  ===============================================================================
module              job
==================  ===============================================================================
``recording``       ``Recording``: one record with sampling rate, angle and labels; frozen
``windower``        ``Windower``: cut recordings into windows of output turns or of equal duration;
                    ``WindowSet``: windows with their counts, assemblies, start angles, worn lobes
``window_stream``   ``WindowStream``: the same windows from samples that arrive in pieces
==================  ===============================================================================
"""

from cyclofeat.recordings.recording import Recording
from cyclofeat.recordings.windower import Windower, WindowSet

__all__ = ["Recording", "WindowSet", "Windower"]
