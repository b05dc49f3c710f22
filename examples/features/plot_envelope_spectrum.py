"""
An envelope spectrum detects wear and does not count it
=======================================================

Paper A (section 5.1) tried the classical method for gears: take the wavelet level that contains the mesh
frequency, compute its Hilbert envelope, and look for harmonics of the shaft in the envelope's spectrum. It
did not separate counts in measured torque. :class:`~cyclofeat.features.WaveletEnvelopeSpectrum` gives the
envelope's amplitude at the harmonics of shaft and mesh. **Surrogate** torque, six assemblies per count on
the assumed rig R1.
"""

import matplotlib.pyplot as plt
import numpy as np
from _surrogates import SAMPLING_RATE, dots_by_count, shades, surrogate_windows

from cyclofeat.features import WaveletEnvelopeSpectrum

X, y, _ = surrogate_windows(n_assemblies=6)
transformer = WaveletEnvelopeSpectrum(sampling_rate=SAMPLING_RATE).fit(X)
features = transformer.transform(X)
harmonics = np.arange(1, transformer.n_shaft_harmonics + 1)

fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
for count, colour, style in zip((0, 1, 3, 7), shades(4), ("o-", "s--", "^-.", "d:"), strict=True):
    median = np.median(features[y == count], axis=0)[harmonics]
    left.semilogy(harmonics, median, style, color=colour, markersize=4, label=f"{count} worn")
left.set(title=f"envelope of level {transformer.level_}, medians", xlabel="harmonic of the input shaft")
left.set_ylabel("amplitude in Nm")
left.legend()
dots_by_count(right, y, features[:, 1], "first harmonic of the shaft", "amplitude in Nm")
plt.show()

# %%
# Level 7 (100 to 200 Hz) contains the mesh, but on this rig also the upper flank of the resonance, which wear
# excites: the envelope of a worn disc varies once per turn and more often, that of a healthy disc hardly at
# all. From one worn lobe on, the harmonics differ less between counts than between assemblies of one count:
# on this rig the method detects wear and does not count it. Every disc has harmonic 8, the beat of the mesh
# with its own image, as the transformer's notes explain.
