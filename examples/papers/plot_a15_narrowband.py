"""
Paper A, figs. 15 to 17: narrowband over total energy
=====================================================

Figs. 15 and 16 mark the multiples of f0 = 100 Hz in the measured density; fig. 17 shows the share of the
energy there: no gradual dependence. This example shows it for **surrogate** torque of the assumed rig
``published`` (statement A8). 100 Hz is order 12 of the input shaft and twice the mains; the gearbox's mesh
is at 133.3 Hz.
"""

import matplotlib.pyplot as plt
import numpy as np
from _papers import COUNTS, RIG_RATE, panels, surrogate_sets

from cyclofeat.features import NarrowbandRatio
from cyclofeat.signal import welch_psd

sets = surrogate_sets()
frequencies, density = welch_psd(sets[0], RIG_RATE)
heading = "one set; orange: 5 Hz about the multiples of 100 Hz (figs. 15 and 16)"
axes = panels(4, "frequency in Hz", "dB over 1 Nm²/Hz", heading)
for count, ax in enumerate(axes.flat):
    for multiple in range(100, 1100, 100):
        ax.axvspan(multiple - 5, multiple + 5, color="C1", alpha=0.6, lw=0)
    ax.plot(frequencies, 10 * np.log10(density[count]), lw=0.7, color="C0")
    ax.set_title(f"{count} worn", fontsize="medium")
    ax.set_xlim(0, 1000)
plt.show()

# %%
# Their share of the power, mean removed (fig. 17), and the same for the mesh.

fig, axes = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained", sharey=True)
for ax, f0, name in ((axes[0], 100.0, "100 Hz (fig. 17)"), (axes[1], 400 / 3, "133.3 Hz, the mesh")):
    transformer = NarrowbandRatio(RIG_RATE, fundamental_hz=f0)
    shares = np.array([100 * transformer.fit_transform(records)[:, 0] for records in sets])
    ax.bar(COUNTS, shares[0], color="0.8", label="one set")
    ax.plot(COUNTS, shares.T, "o", color="C0", alpha=0.6)
    ax.set(title=f"multiples of {name}", xlabel="worn lobes")
axes[0].set_ylabel("% of the power")
axes[0].plot([], [], "o", color="C0", label="four sets")
axes[0].legend()
plt.show()

# %%
# The share is a few per cent without a trend, as random as in the paper. This is expected: no line of a lobe
# (multiples of 8.889 Hz) or of the mesh lies on a multiple of 100 Hz below 400 Hz.
