"""
Bands in which entropy falls with wear, and how many chance gives
=================================================================

Paper A (fig. 19) shows, for its simulation with steel discs, the frequency bands in which Shannon entropy
falls strictly with the number of worn lobes. Among thousands of bands, some always do.
:func:`~cyclofeat.scans.find_monotone_bands` therefore also states how often chance finds as many.
**Surrogate** torque, six assemblies each with 1, 3, 5 and 7 worn lobes on the assumed rig R1.
"""

import matplotlib.pyplot as plt
from _surrogates import SAMPLING_RATE, dots_by_count, surrogate_windows

from cyclofeat.features import SpectralEntropy
from cyclofeat.scans import find_monotone_bands

X, y, assemblies = surrogate_windows(n_assemblies=6)
odd = y % 2 == 1
X, y, assemblies = X[odd], y[odd], assemblies[odd]
found = find_monotone_bands(X, y, SpectralEntropy(SAMPLING_RATE), groups=assemblies)
print(f"{len(found.bands)} of {found.n_tried} bands fall; p = {found.p_number:.3f}")

# %%
# Each dot is a band found, placed by its limits. The right panel shows the entropy in the widest band, means
# and single assemblies.

fig, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
left.plot(found.bands[:, 0], found.bands[:, 1], "s", color="black", markersize=3)
left.axline((0, 0), slope=1, color="0.7")
left.set(title="bands of falling entropy", xlabel="lower limit in Hz", ylabel="upper limit in Hz")
left.set(xlim=(-200, SAMPLING_RATE / 2), ylim=(0, SAMPLING_RATE / 2 + 200))
low, high = found.bands[0]
entropy = SpectralEntropy(SAMPLING_RATE, band=(low, high)).fit_transform(X)[:, 0]
dots_by_count(right, y, entropy, f"widest: {low:g} to {high:g} Hz", "Shannon entropy in bits")
plt.show()

# %%
# One of four shuffles of the counts gives as many bands, so their number is no evidence. Those that begin
# below 1 kHz have a reason: wear adds power at their lower end, above the flat noise floor, and their
# spectra become less flat. Those above 3 kHz contain almost only noise. The class means fall, but single
# assemblies of adjacent counts overlap by more than the steps between the means: a band of falling entropy
# is a trend, not a counter. Four counts fall in order by chance far more often than seven would; p accounts
# for this.
