"""
Paper A, table 4, figs. 5 and 6: the measured torque
====================================================

Table 4 states minimum, maximum, mean and standard deviation of the torque measured with eight discs, one
recording each; figs. 5 and 6 show the recordings, with a drifting mean. The recordings were not published.
This example replaces them by **surrogate** torque of the assumed rig ``published``, whose drift was fitted
to table 4: agreement with the table's level is therefore not a finding (statements A1 and A12).
"""

import matplotlib.pyplot as plt
import numpy as np
from _papers import COUNTS, RIG_RATE, panels, surrogate_sets

from cyclofeat.datasets import load_published_tables

sets = surrogate_sets()
table = load_published_tables().signal_statistics
time = np.arange(sets.shape[-1]) / RIG_RATE

heading = "surrogate (figs. 5 and 6); dashed: measured minimum, mean and maximum (table 4)"
axes = panels(4, "time in s", "torque in Nm", heading)
for count, (ax, torque) in enumerate(zip(axes.flat, sets[0], strict=True)):
    ax.plot(time, torque, lw=0.4, color="C0")
    for value in (table["min_nm"][count], table["mean_nm"][count], table["max_nm"][count]):
        ax.axhline(value, color="black", lw=0.8, ls="--")
    ax.set_title(f"{count} worn", fontsize="medium")
plt.show()

# %%
# Table 4, measured (crosses) and surrogate (dots: four sets of eight assemblies).

fig, axes = plt.subplots(1, 5, figsize=(12, 3.4), layout="constrained")
statistics = {
    "min_nm": sets.min(axis=-1),
    "max_nm": sets.max(axis=-1),
    "mean_nm": sets.mean(axis=-1),
    "std_nm": sets.std(axis=-1, ddof=1),
    "range_nm": np.ptp(sets, axis=-1),
}
for ax, (name, values) in zip(axes, statistics.items(), strict=True):
    ax.plot(COUNTS, values.T, "o", color="C0", alpha=0.5, markersize=4)
    ax.plot(COUNTS, table[name], "kx-", lw=0.8)
    ax.set(title=name.removesuffix("_nm"), xlabel="worn lobes", xticks=COUNTS)
axes[0].set_ylabel("Nm")
axes[0].plot([], [], "kx-", lw=0.8, label="measured")
axes[0].plot([], [], "o", color="C0", alpha=0.5, label="surrogate")
axes[0].legend(fontsize="small")
plt.show()

# %%
# The level agrees, the dependence on the count does not: the measured deviation jumps from the healthy disc
# to one worn lobe and falls from there on, the surrogate's scatters from assembly to assembly. With one
# recording per disc, the effect of wear cannot be separated from the differences between eight assemblies
# (see the finding on it).
