"""
Coherence with a healthy disc falls with wear, on this rig
==========================================================

Both papers compared torque with that of the healthy disc by magnitude-squared coherence (MATLAB's
``mscohere``) from 0 to 1500 Hz. Paper B found a different pattern for each count in simulation; neither
paper found a gradual relation. :class:`~cyclofeat.features.CoherenceToReference` learns its reference from
the healthy training windows. **Surrogate** torque on the assumed rig R1: three healthy assemblies are the
reference, and three other assemblies of each count are compared with them.
"""

import matplotlib.pyplot as plt
import numpy as np
from _surrogates import SAMPLING_RATE, dots_by_count, shades, surrogate_windows

from cyclofeat.features import CoherenceToReference
from cyclofeat.signal import magnitude_squared_coherence

X, y, _ = surrogate_windows(n_assemblies=6)
training = np.arange(len(X)) < len(X) // 2  # assemblies come count after count, in turn
bands = [(0, 100), (100, 200), (200, 400), (400, 800)]
transformer = CoherenceToReference(SAMPLING_RATE, bands=bands).fit(X[training], y[training])
coherence = transformer.transform(X[~training])

# %%
# The left panel shows the coherence of single windows with one reference, line by line. The right panel shows
# the transformer's output: means over bands, medians over the references.

fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
for count, colour, style in zip((0, 1, 7), shades(3), ("-", "--", ":"), strict=True):
    window = X[~training][y[~training] == count][0]
    frequencies, lines = magnitude_squared_coherence(window, transformer.references_[0], SAMPLING_RATE)
    smooth = np.convolve(lines, np.ones(9) / 9, mode="same")
    left.plot(frequencies, smooth, style, color=colour, label=f"{count} worn")
left.set(
    xlim=(0, 1500),
    ylim=(0, 1),
    xlabel="frequency in Hz",
    ylabel="coherence",
    title="single windows, mean of 9 lines",
)
left.legend()
dots_by_count(right, y[~training], coherence[:, 1], "100 to 200 Hz", "coherence")
plt.show()

# %%
# On this rig the coherence falls with the count, most between 100 and 200 Hz, although counts from three on
# overlap. Neither paper found this. The likely reason is that all assemblies here share one brake and one
# torque meter, whose resonance rings more with wear. Confirm the effect on a measured rig before you rely on
# it. Coherence is never zero: with eight segments, unrelated noise has about 0.2, the level above 1000 Hz.
