"""Torque records with their labels, and windows cut from them.

==================  ==============================================================================
name                job
==================  ==============================================================================
``Recording``       one torque record with sampling rate, angle and labels; frozen
``Windower``        cut recordings into windows of whole output turns, or of equal duration
``WindowSet``       windows with their counts, assemblies, start angles and worn lobes
``common_n_lobes``  number of lobes that recordings share
``common_speed``    nominal input speed that recordings share
==================  ==============================================================================
"""

from cyclofeat.recordings._recording import Recording, common_n_lobes, common_speed
from cyclofeat.recordings._windower import Windower, WindowSet

__all__ = ["Recording", "WindowSet", "Windower", "common_n_lobes", "common_speed"]
