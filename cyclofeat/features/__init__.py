"""One scikit-learn transformer per diagnostic method: windows of torque in, features out.

===========================  =================================================================================
transformer                  features of each window
===========================  =================================================================================
``LobeMap``                  mean and rms in each lobe's slot, prominence and contrast of the lobe lines
``SpectralEntropy``          Shannon entropy of the power spectral density in bits, or normalized
``TorqueStatistics``         minimum, maximum, mean, std, range, rms, crest factor, skewness, kurtosis, ripple
``WaveletEnvelopeSpectrum``  envelope of the level that holds the mesh frequency, at shaft and mesh harmonics
``WaveletLevelStatistics``   rms, share of energy, kurtosis, extent of the lowest colour per level
``WaveletMinimaOverlap``     share of lowest-colour cells shared with the worst class, per level
===========================  =================================================================================

All take ``X`` of shape (n_windows, n_samples) in Nm and a required ``sampling_rate`` in Hz. Each is a thin
shell over pure functions of :mod:`cyclofeat.spectral` and its neighbours.
"""

# One import, one line in the table above and one entry below per transformer.
from cyclofeat.features._envelope import WaveletEnvelopeSpectrum
from cyclofeat.features._levels import WaveletLevelStatistics
from cyclofeat.features._lobe_map import LobeMap
from cyclofeat.features._minima_overlap import WaveletMinimaOverlap
from cyclofeat.features._spectral import SpectralEntropy
from cyclofeat.features._statistics import TorqueStatistics

__all__ = [
    "LobeMap",
    "SpectralEntropy",
    "TorqueStatistics",
    "WaveletEnvelopeSpectrum",
    "WaveletLevelStatistics",
    "WaveletMinimaOverlap",
]
