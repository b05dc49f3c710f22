"""Pure functions of windows of torque.

A window is the last axis of an array: ``X`` of shape (n_windows, n_samples) gives one result per window, a
single window of shape (n_samples,) gives one result. float32 and float64 are accepted; all sums are float64.

===================  =====================================================================================
module               functions
===================  =====================================================================================
``welch``            ``welch_psd`` and its presets, ``amplitude_spectrum``
``density``          shape of a density: entropy, flatness, centroid, roll-off, power in bands
``coherence``        ``magnitude_squared_coherence`` with a reference
``statistics``       ``torque_statistics``: minimum, maximum, mean and the like
``high_pass``        ``high_pass``: windows without slow variations
``orders``           angle and order domain: ``estimate_input_speed``, ``order_lines``, ``resample_by_angle``
``lobes``            lobe domain: ``lobe_lines``, ``fold``, prominence and contrast of the lines
``speed``            the angle of the input followed in the torque alone: ``follow_speed``
``drive``            the same in a motor's current: ``follow_motor``
``faults``           samples that are clipped, lost or off, filtered torque, noise or speed that changes
``wavelets``         ``dwt``, ``scalogram``, ``minima_mask``, statistics and envelopes of levels
``wavelet_filters``  wavelets by name, the Morris family among them (public in ``wavelets``)
``windows``          checks of windows, chunks and quotients that the others share
===================  =====================================================================================

The functions of the first five are imported here too. One signal can have 0.9 or 4.2 bits of spectral
entropy, depending on whether its mean was removed and on the window. The choice is therefore a named preset
(:data:`PRESETS`) and never implicit.

Papers A and B, cited by the numbers of their equations and tables:

A. "Verification of the cycloidal gear train fault diagnosis methods based on measured data"
B. "Analysis of the single stage cycloidal gearbox with lobe defects. Fault diagnosis attempts using coherence
   function and Morris minimum-bandwidth wavelets"
"""

from cyclofeat.signal.coherence import magnitude_squared_coherence
from cyclofeat.signal.density import (
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
from cyclofeat.signal.high_pass import high_pass
from cyclofeat.signal.statistics import torque_statistics
from cyclofeat.signal.welch import (
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
