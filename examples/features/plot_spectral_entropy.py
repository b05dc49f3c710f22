"""
Spectral entropy measures the ratio of ripple to mean
=====================================================

Shannon entropy is the one method that succeeded in paper A: the entropy of the measured torque's spectrum
falls strictly from one worn lobe to seven (table 6), and so does the normalized entropy.
:class:`~cyclofeat.features.SpectralEntropy` gives both, here for **surrogate** torque, six assemblies per
count on the assumed rig R1.
"""

import matplotlib.pyplot as plt
import numpy as np
from _surrogates import SAMPLING_RATE, dots_by_count, shades, surrogate_windows
from matplotlib.colors import ListedColormap

from cyclofeat.datasets import load_published_tables
from cyclofeat.features import SpectralEntropy

X, y, _ = surrogate_windows(n_assemblies=6)
papers = SpectralEntropy(sampling_rate=SAMPLING_RATE)
bits = papers.fit_transform(X)[:, 0]
normalized = SpectralEntropy(sampling_rate=SAMPLING_RATE, normalize=True).fit_transform(X)[:, 0]
of_ripple = SpectralEntropy(sampling_rate=SAMPLING_RATE, preset="ripple").fit_transform(X)[:, 0]

# %%
# The normalized entropy is the same number divided by log2 of the number of lines; only the axis differs.

largest = np.log2(papers.frequencies_.size)
print(f"largest difference: {np.abs(normalized - bits / largest).max():.1e}")

published = load_published_tables().spectral_entropy
fig, (left, middle, right) = plt.subplots(1, 3, figsize=(11, 4), layout="constrained")
dots_by_count(left, y, bits, "mean kept (papers' pwelch)", "Shannon entropy in bits")
left.plot(published["defect_count"], published["entropy_bits"], "kx", label="measured (paper A table 6)")
left.plot([], [], "o-", color="C0", label="surrogate, and mean")
left.set_ylim(1.2, 2.2)
left.legend(loc="upper left", fontsize="small")
second = left.secondary_yaxis("right", functions=(lambda h: h / largest, lambda e: e * largest))
second.set_ylabel("normalized entropy")

share = X.var(axis=1) / (X**2).mean(axis=1)
points = middle.scatter(share, bits, c=y, cmap=ListedColormap(shades(8)), vmin=-0.5, vmax=7.5)
middle.set(title="what it measures", xlabel="variance / mean square", ylabel="Shannon entropy in bits")
fig.colorbar(points, ax=middle, label="worn lobes", ticks=range(8))

dots_by_count(right, y, of_ripple, "mean removed (preset 'ripple')", "Shannon entropy in bits")
plt.show()

# %%
# **Left:** on this rig the entropy *grows* with the count, whereas the measured one falls: its direction is
# not a property of wear alone. **Middle:** MATLAB's ``pwelch`` keeps the mean, whose line at 0 Hz outweighs
# all others. The entropy then follows the share of ripple in the torque's mean square, which table 4 already
# contains. **Right:** without the mean, entropy separates most worn discs from healthy ones, and little more.
# Interpret a trend of entropy with the count only together with the ripple, and within one rig.
