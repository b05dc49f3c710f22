"""
Envelope spectrum of the mesh level
===================================

The classical method for gears, tried in paper A (section 5.1): take the wavelet level that holds the mesh
frequency, its Hilbert envelope, and look for harmonics of the shaft in the envelope's spectrum. It did not
tell counts apart in measured torque. :class:`~cyclofeat.features.WaveletEnvelopeSpectrum` reads the envelope
at the harmonics of shaft and mesh. **Surrogate** torque, six assemblies per count on the assumed rig R1.
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
# Level 7 (100 to 200 Hz) holds the mesh, but on this rig also the upper flank of the resonance, which wear
# rings: the envelope of a worn disc swings once per turn and more, that of a healthy one hardly. From one
# worn lobe on, the harmonics differ less between counts than between assemblies of one count: it detects wear
# on this rig, and does not count it. Harmonic 8 is in every disc: the mesh beating with its own image, as the
# transformer's notes explain.
