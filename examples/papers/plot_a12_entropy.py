"""
Paper A, figs. 12, 13 and 18, table 6: density, entropy and flatness
====================================================================

Fig. 12 shows the power spectral density of the measured torque, fig. 13 its normalized entropy, fig. 18
Shannon entropy and flatness. Table 6 states the entropies: highest for one worn lobe, falling strictly to
seven, lowest for the healthy disc. Entropy is the one method that succeeded in paper A; flatness shows
nothing. This example shows **surrogate** torque of the assumed rig ``published`` beside the published
numbers (statements A6 and A9).
"""

import matplotlib.pyplot as plt
import numpy as np
from _papers import COUNTS, RIG_RATE, entropy_bits, shades, surrogate_sets

from cyclofeat.datasets import load_published_tables
from cyclofeat.signal import spectral_flatness, welch_psd

sets = surrogate_sets()
frequencies, density = welch_psd(sets[0], RIG_RATE)
fig, ax = plt.subplots(figsize=(10, 4.4), layout="constrained")
for count, (lines, colour) in enumerate(zip(density, shades(8), strict=True)):
    ax.plot(frequencies, 10 * np.log10(lines), lw=0.8, color=colour, label=f"{count}")
ax.set(xlim=(0, 800), xlabel="frequency in Hz", ylabel="dB over 1 Nm²/Hz", title="density, one set (fig. 12)")
ax.legend(title="worn lobes", ncols=4, fontsize="small")
plt.show()

# %%
# Entropy in bits, as a share of the largest possible (the same number divided by a constant), and flatness.

published = load_published_tables().spectral_entropy["entropy_bits"]
bits = entropy_bits(sets)
largest = np.log2(frequencies.size)
fig, axes = plt.subplots(1, 3, figsize=(12, 4), layout="constrained")
for ax, divisor, title in (
    (axes[0], 1.0, "Shannon entropy, bits (fig. 18, table 6)"),
    (axes[1], largest, "normalized entropy (fig. 13)"),
):
    ax.plot(COUNTS, bits.T / divisor, "o-", lw=0.6, color="C0", alpha=0.5)
    ax.plot(COUNTS, published / divisor, "kx-")
    ax.set(title=title, xlabel="worn lobes")
axes[0].plot([], [], "kx-", label="measured")
axes[0].plot([], [], "o-", color="C0", alpha=0.5, label="surrogate, four sets")
axes[0].legend(fontsize="small")
axes[2].semilogy(
    COUNTS, spectral_flatness(welch_psd(sets, RIG_RATE)[1]).T, "o-", lw=0.6, color="C0", alpha=0.5
)
axes[2].set(title="flatness (fig. 18; no numbers published)", xlabel="worn lobes")
plt.show()
steps = -np.diff(published)[1:]
at = steps.argmin() + 1
print(f"smallest step of table 6: {steps.min():.4f} bits, from {at} to {at + 1} worn")
print(f"surrogate: assemblies of one count differ by {bits.std(axis=0, ddof=1).mean():.3f} bits (deviation)")

# %%
# The measured entropies fall in steps of down to 0.0007 bits. On the surrogate rig, whose deviations are
# those of table 4, two assemblies with the *same* disc differ by a hundred times as much. The order of eight
# recordings is no evidence that a ninth would fit in, and table 4 already contains what the entropy measures
# (see the finding on it).
