"""One scikit-learn transformer per diagnostic method: windows of torque in, features out.

``docs/features.rst`` lists them, ``examples/features`` shows each on surrogate torque. All take ``X`` of
shape (n_windows, n_samples) in Nm and a required ``sampling_rate`` in Hz. ``fit`` sets ``n_features_in_``,
the samples in a window, ``feature_names_in_``, their names, if it is given a data frame, and for spectra
``frequencies_`` in Hz.

Shape features of the density (entropy, flatness, centroid, roll-off, narrow-band ratio) do not depend on the
scale of the torque and, under the preset ``"ripple"``, not on its mean. They are 0 for windows without power:
zeros and, under ``"ripple"``, any constant window and any of fewer than 9 samples.

``base`` holds the base class of all transformers, ``registry`` the name, unit, formula and version of each
feature.
"""

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
