"""
Fold the torque, and each lobe has a slot of its own
====================================================

:class:`~cyclofeat.features.LobeMap` removes the rig's resonance from the torque and folds it at the rate at
which lobes pass the load, so that each lobe has a slot. It gives the mean and rms of each slot and two
numbers per lobe line, the multiple k of that rate. The papers have no such method. **Surrogate** torque: four
assemblies per count on the assumed rig R1, each worn on adjacent lobes from a random one on.
"""

import matplotlib.pyplot as plt
import numpy as np
from _surrogates import SAMPLING_RATE, surrogate_windows

from cyclofeat.features import LobeMap

X, y, _ = surrogate_windows(n_assemblies=4)
transformer = LobeMap(sampling_rate=SAMPLING_RATE).fit(X)
features = transformer.transform(X)
names = transformer.get_feature_names_out()
slot_rms = features[:, [name.startswith("lobe_slot_rms") for name in names]]
contrast = features[:, [name.startswith("lobe_line_contrast") for name in names]]

fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
in_order = np.argsort(y, kind="stable")
picture = left.imshow(slot_rms[in_order], aspect="auto", cmap="gray_r", vmax=0.6, interpolation="none")
left.set_yticks(np.arange(8) * 4 + 1.5, range(8))
left.hlines(np.arange(1, 8) * 4 - 0.5, -0.5, 14.5, color="C1", lw=0.8)
left.set(title="rms in each slot, centred", xlabel="slot (centre of the wear in the middle)")
left.set_ylabel("worn lobes, four assemblies each")
fig.colorbar(picture, ax=left, label="standard deviations", extend="max")

line = np.arange(1, contrast.shape[1] + 1)
for count, style in ((1, "o-"), (3, "s--"), (5, "^:")):
    right.plot(line[:20], contrast[y == count].mean(axis=0)[:20], style, markersize=4, label=f"{count} worn")
for zero in (3, 6, 9, 12):
    right.axvline(zero, color="0.8", lw=4, zorder=0)
right.set(
    title="contrast of the lobe lines, mean",
    xlabel="lobe line k",
    ylabel="dB",
    xticks=range(0, 21, 5),
    ylim=(-16, 7),
)
right.legend(loc="lower left", ncols=3)
plt.show()

# %%
# **Left:** a healthy disc has empty slots. A worn stretch appears at its ends, which move apart as it grows.
# **Right:** n adjacent worn lobes put zeros at multiples of 15/n, visible as dips: at 5 and, weakly, 10 for
# three; at 3, 6, 9 and 12 (grey) for five. Line 15 is the mesh, which every disc has. Neither resonance nor
# drift moves a zero, so the zeros count lobes where spectra do not.
