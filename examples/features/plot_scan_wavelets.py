"""
Which wavelet?
==============

Paper B (section 5) tried 130 wavelets on the overlap of minima and kept mb32.3, by eye.
:func:`~cyclofeat.scans.scan_wavelets` asks for numbers: how monotonically does the overlap grow with the
count at any level, how well does the count explain it, and how often does chance do as well? Here a handful
of wavelets; ``wavelets="all"`` takes every discrete one. **Surrogate** torque, six assemblies per count on
the assumed rig R1.
"""

import matplotlib.pyplot as plt
from _surrogates import SAMPLING_RATE, surrogate_windows

from cyclofeat.scans import scan_wavelets

X, y, assemblies = surrogate_windows(n_assemblies=6)
wavelets = ["mb32.3", "mb8.2", "db4", "sym8", "coif3", "haar"]
scan = scan_wavelets(X, y, sampling_rate=SAMPLING_RATE, groups=assemblies, wavelets=wavelets, levels=8)

fig, ax = plt.subplots(figsize=(8, 4.4), layout="constrained")
for row, marker in zip(scan.best_of_each(), "os^dvx", strict=True):
    label = f"{row.wavelet}, level {row.level}: tau {row.kendall:+.2f}, p {row.p_value:.2f}"
    ax.plot(scan.counts, [100 * mean for mean in row.class_means], marker=marker, label=label)
ax.set(xlabel="worn lobes", ylabel="cells lowest in both, %", title="best level of each wavelet")
ax.legend(loc="upper left", bbox_to_anchor=(1, 1), fontsize="small")
plt.show()

# %%
# The best of 48 columns (6 wavelets, 8 levels) has a tau that looks like a find. Two numbers judge it: p says
# how often shuffled counts lead to as high a tau *anywhere in the scan*, separability which share of the
# differences among assemblies the count explains:

for row in scan.best_of_each():
    print(f"{row.wavelet:7} level {row.level}: separability {row.separability:+.2f}, p {row.p_value:.2f}")

# %%
# Class means may line up while assemblies of one count differ by more than the counts: a separability near 0
# is no counter, whatever its tau. The overlaps themselves are small, because noise has filled the dark cells
# (see the overlap's own example).
