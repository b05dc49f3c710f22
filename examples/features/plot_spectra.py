"""
Two spectra of the papers, and what wear does to them
=====================================================

The two spectra of the papers, line by line: Welch's power spectral density as MATLAB's ``pwelch`` gives it
(:class:`~cyclofeat.features.WelchPSD`, paper A section 5.3), and the amplitudes of a transform of 8192
points under a Hamming window (:class:`~cyclofeat.features.AmplitudeSpectrum`, paper B section 6).
**Surrogate** torque: medians over four assemblies per count on the assumed rig R1.
"""

import matplotlib.pyplot as plt
import numpy as np
from _surrogates import SAMPLING_RATE, shades, surrogate_windows

from cyclofeat.features import AmplitudeSpectrum, WelchPSD

X, y, _ = surrogate_windows(n_assemblies=4)
density = WelchPSD(SAMPLING_RATE, band=(0, 400), decibels=True).fit(X)
amplitude = AmplitudeSpectrum(SAMPLING_RATE, band=(0, 300)).fit(X)

fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
counts = (0, 1, 3, 7)
for count, colour, style in zip(counts, shades(4), ("-", "--", "-.", ":"), strict=True):
    for ax, transformer in ((left, density), (right, amplitude)):
        frequencies = transformer.frequencies_[: transformer.get_feature_names_out().size]
        median = np.median(transformer.transform(X[y == count]), axis=0)
        ax.plot(frequencies, median, style, color=colour, label=f"{count} worn", lw=1)
left.set(
    title="density (MATLAB's pwelch)", xlabel="frequency in Hz", ylabel="dB over 1 Nm²/Hz", ylim=(-58, 30)
)
right.set(title="amplitudes (Hamming, 8192 points)", xlabel="frequency in Hz", ylabel="Nm", yscale="log")
right.axvline(400 / 3, color="grey", lw=0.8)
right.annotate("mesh", (400 / 3, 10), xytext=(3, 0), textcoords="offset points", color="grey")
left.legend()
plt.show()

# %%
# The rig's torsional resonance (the hump below 100 Hz) and the power above it rise with wear; the peak at 0
# Hz is the mean torque. The lines of the density are 1.6 Hz apart. The lines of the amplitude spectrum are
# 3.1 Hz apart and cannot resolve single lobes, whose lines are 0.6 Hz from those of the input shaft. Paper A
# saw no gradual relation in such densities; in paper B the spectrum of the output torque with *removed* lobes
# was half as high between 200 and 800 Hz.
