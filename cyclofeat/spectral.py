"""Pure functions of windows of torque: spectra, what their shape says, coherence, filters, statistics.

A window is the last axis of an array: ``X`` of shape (n_windows, n_samples) gives one result per window, a
single window of shape (n_samples,) gives one result. float32 and float64 are taken; all sums are float64.

One signal can have 0.9 or 4.2 bits of spectral entropy, depending on whether its mean was removed and on the
window. The choice is therefore a named preset (:data:`PRESETS`) and never implicit.

===================================  ==================================================================
function                             result
===================================  ==================================================================
``welch_psd``                        power spectral density, as a preset defines it
``welch_frequencies``                frequencies of its lines
``amplitude_spectrum``               amplitudes of the lines of a transform of fixed length
``shannon_entropy``                  entropy of a density in bits
``normalized_entropy``               entropy as a share of the largest possible
``spectral_flatness``                geometric over arithmetic mean of a density
``spectral_centroid``                mean frequency of a density
``spectral_rolloff``                 frequency up to which 95 % of the power lies
``band_power``                       power in bands
``narrowband_ratio``                 share of the power around the harmonics of a frequency
``magnitude_squared_coherence``      coherence with a reference
``high_pass``                        windows without what varies slowly
``torque_statistics``                minimum, maximum, mean and the like
===================================  ==================================================================

Papers A and B, quoted here with their numbers of equations and tables:

A. "Verification of the cycloidal gear train fault diagnosis methods based on measured data"
B. "Analysis of the single stage cycloidal gearbox with lobe defects. Fault diagnosis attempts using coherence
   function and Morris minimum-bandwidth wavelets"
"""

from cyclofeat._coherence import magnitude_squared_coherence
from cyclofeat._density import (
    EPSILON,
    band_mask,
    band_power,
    narrowband_mask,
    narrowband_ratio,
    normalized_entropy,
    octave_bands,
    shannon_entropy,
    spectral_centroid,
    spectral_flatness,
    spectral_rolloff,
)
from cyclofeat._filter import high_pass
from cyclofeat._statistics import torque_statistics
from cyclofeat._welch import (
    AMPLITUDE_WINDOWS,
    PRESETS,
    WelchPreset,
    amplitude_spectrum,
    get_preset,
    segment_length,
    welch_frequencies,
    welch_psd,
)

__all__ = [
    "AMPLITUDE_WINDOWS",
    "EPSILON",
    "PRESETS",
    "WelchPreset",
    "amplitude_spectrum",
    "band_mask",
    "band_power",
    "get_preset",
    "high_pass",
    "magnitude_squared_coherence",
    "narrowband_mask",
    "narrowband_ratio",
    "normalized_entropy",
    "octave_bands",
    "segment_length",
    "shannon_entropy",
    "spectral_centroid",
    "spectral_flatness",
    "spectral_rolloff",
    "torque_statistics",
    "welch_frequencies",
    "welch_psd",
]
