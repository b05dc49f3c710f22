"""One scikit-learn transformer per diagnostic method: windows of torque in, features out.

===========================  =================================================================================
transformer                  features of each window
===========================  =================================================================================
``AmplitudeSpectrum``        amplitudes of the lines of a transform of fixed length, averaged over blocks
``BandPower``                power in bands
``CoherenceToReference``     mean coherence with windows of the healthy class, per band
``HighPass``                 the window itself without what varies slowly: goes before any of the others
``LobeMap``                  mean and rms in each lobe's slot, prominence and contrast of the lobe lines
``NarrowbandRatio``          share of the power around the harmonics of a frequency
``OrderSpectrum``            amplitudes at order lines of the output turn, of the input turn or of the lobes
``SpectralCentroid``         mean frequency of the density, of the window or its parts
``SpectralEntropy``          Shannon entropy of the power spectral density in bits, or normalized
``SpectralFlatness``         geometric over arithmetic mean of the density, of the window or its parts
``SpectralRolloff``          frequency up to which 95 % of the power lies, of the window or its parts
``TorqueFeatures``           all features in one row, what they share worked out once
``TorqueStatistics``         minimum, maximum, mean, std, range, rms, crest factor, skewness, kurtosis, ripple
``WaveletEnvelopeSpectrum``  envelope of the level that holds the mesh frequency, at shaft and mesh harmonics
``WaveletLevelStatistics``   rms, share of energy, kurtosis, extent of the lowest colour per level
``WaveletMinimaOverlap``     share of lowest-colour cells shared with the worst class, per level
``WelchPSD``                 power spectral density, line by line
===========================  =================================================================================

All take ``X`` of shape (n_windows, n_samples) in Nm and a required ``sampling_rate`` in Hz. Each is a thin
shell over pure functions of :mod:`cyclofeat.signal`; ``examples/features`` shows each on surrogate torque.
``fit`` sets ``n_features_in_``, the samples in a window, ``feature_names_in_``, their names, if it is given a
data frame, and for spectra ``frequencies_`` in Hz.

Shape features of the density (entropy, flatness, centroid, roll-off, narrow-band ratio) do not depend on the
scale of the torque and, under the preset ``"ripple"``, not on its mean. They are 0 for windows without power:
zeros and, under ``"ripple"``, any constant window and any of fewer than 9 samples.

``base`` holds the base class of all transformers, ``registry`` the name, unit, formula and version of each
feature.
"""

# One import, one line in the table above and one entry below per transformer.
from cyclofeat.features._coherence import CoherenceToReference
from cyclofeat.features._composite import TorqueFeatures
from cyclofeat.features._lobe_map import LobeMap
from cyclofeat.features._minima_overlap import WaveletMinimaOverlap
from cyclofeat.features._orders import OrderSpectrum
from cyclofeat.features._spectra import (
    AmplitudeSpectrum,
    BandPower,
    NarrowbandRatio,
    SpectralCentroid,
    SpectralEntropy,
    SpectralFlatness,
    SpectralRolloff,
    WelchPSD,
)
from cyclofeat.features._torque import HighPass, TorqueStatistics
from cyclofeat.features._wavelets import WaveletEnvelopeSpectrum, WaveletLevelStatistics

__all__ = [
    "AmplitudeSpectrum",
    "BandPower",
    "CoherenceToReference",
    "HighPass",
    "LobeMap",
    "NarrowbandRatio",
    "OrderSpectrum",
    "SpectralCentroid",
    "SpectralEntropy",
    "SpectralFlatness",
    "SpectralRolloff",
    "TorqueFeatures",
    "TorqueStatistics",
    "WaveletEnvelopeSpectrum",
    "WaveletLevelStatistics",
    "WaveletMinimaOverlap",
    "WelchPSD",
]
