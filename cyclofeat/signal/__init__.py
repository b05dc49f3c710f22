"""Pure functions of windows of torque.

A window is the last axis of an array: ``X`` of shape (n_windows, n_samples) gives one result per window, a
single window of shape (n_samples,) gives one result. float32 and float64 are accepted; all sums are float64.

===================  =====================================================================================
module               functions
===================  =====================================================================================
``welch``            ``welch_psd`` and its presets, ``amplitude_spectrum``, coherence with a reference
``density``          shape of a density: entropy, flatness, centroid, roll-off, power in bands
``windows``          ``torque_statistics``, ``high_pass``, and checks of windows that the others share
``orders``           angle and order domain: ``estimate_input_speed``, ``order_lines``, ``resample_by_angle``
``lobes``            lobe domain: ``lobe_lines``, ``fold``, prominence and contrast of the lines
``speed``            the angle of the input in torque or current alone: ``follow_speed``, ``follow_motor``
``tachometer``       the angle of a shaft from a tachometer's pulses or a wrapped angle
``faults``           samples that are clipped, lost or off, filtered torque, noise or speed that changes
``wavelets``         ``dwt``, ``scalogram``, levels and their statistics, the Morris family
===================  =====================================================================================

The functions that a user of a single window needs are imported here too. One signal can have 0.9 or 4.2 bits
of spectral entropy, depending on whether its mean was removed and on the window. The choice is therefore a
named preset (``welch.PRESETS``) and never implicit.

Papers A and B, cited by the numbers of their equations and tables:

A. "Verification of the cycloidal gear train fault diagnosis methods based on measured data"
B. "Analysis of the single stage cycloidal gearbox with lobe defects. Fault diagnosis attempts using coherence
   function and Morris minimum-bandwidth wavelets"
"""

from cyclofeat.signal.density import (
    band_power,
    narrowband_ratio,
    normalized_entropy,
    octave_bands,
    shannon_entropy,
    spectral_centroid,
    spectral_flatness,
    spectral_rolloff,
)
from cyclofeat.signal.orders import order_lines
from cyclofeat.signal.welch import amplitude_spectrum, magnitude_squared_coherence, welch_psd
from cyclofeat.signal.windows import high_pass, torque_statistics

__all__ = [
    "amplitude_spectrum",
    "band_power",
    "high_pass",
    "magnitude_squared_coherence",
    "narrowband_ratio",
    "normalized_entropy",
    "octave_bands",
    "order_lines",
    "shannon_entropy",
    "spectral_centroid",
    "spectral_flatness",
    "spectral_rolloff",
    "torque_statistics",
    "welch_psd",
]
