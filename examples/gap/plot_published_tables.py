"""
What eight published records say about a missing effect
=======================================================

Paper A publishes minimum, maximum, mean and standard deviation of the torque measured with eight discs, one
record each (table 4), and no torque. These numbers show where the simulator disagrees, which effects of the
library would explain it, and how well they predict a disc that was not used in the search. The 32 numbers
are measured; everything compared with them is **surrogate** torque, from some 4000 simulated rigs whose
statistics are stored beside this script. Without the stored statistics (``table`` left out), it simulates
3000 records, which takes a quarter of an hour on one core.
"""

import matplotlib.pyplot as plt
import numpy as np
from _stored import DATA

from cyclofeat.datasets import load_published_tables
from cyclofeat.gap import Comparison, find_published_gap
from cyclofeat.gap.published.rigs import PublishedSettings

tables = load_published_tables()
published, entropy = tables.signal_statistics, tables.spectral_entropy["entropy_bits"]
stored = DATA / "published_tables.npz"
comparison = Comparison(sampling_rate=25_600)
gap = find_published_gap(comparison, published, entropy, settings=PublishedSettings(table=stored))
# gap.save_table(stored) writes the table

# %%
# Where
# -----
# Differences over the eight discs. With eight discs no exact two-sided p can be below 2/256 = 0.0078.

print("measured against the simulator alone")
for row in gap.discrepancies:
    size = f"{row.difference:+.2f} Nm" if row.unit == "Nm" else f"a factor of {np.exp(row.difference):.3g}"
    limits = (row.low, row.high) if row.unit == "Nm" else (np.exp(row.low), np.exp(row.high))
    print(
        f"  {row.statistic:13} {size:22} (95 %: {limits[0]:.3g} to {limits[1]:.3g}), {row.same_sign} of 8, "
        f"p = {row.p:.4f}, over all rows {row.p_adjusted:.3f}"
    )

# %%
# What
# ----
# Each effect alone, scored by held-out discs (continuous ranked probability score of the four statistics, in
# units of the spread over the discs; smaller is better). The constant is the mean of the other discs and
# contains no physics.

for row in gap.ranking:
    print(f"  {row.score:7.2f}  {row.effect}")
for step in gap.steps:
    print(
        f"named {step.effect}: score {step.score_before:.2f} -> {step.score_after:.2f}, p = {step.p:.4f}; "
        f"looks like it: {', '.join(step.look_alikes) or 'nothing'}; distinguished by {step.next_measurement}"
    )
for row in (*gap.rejected[:5], *(row for row in gap.rejected[5:] if row.effect == "brake_rotor")):
    print(f"not added: {row.effect} {row.score:.2f} (p = {row.p:.2f})")
for row in gap.parameters:
    print(f"  {row.name} = {row.value:.3g} {row.unit} (90 %: {row.low:.3g} to {row.high:.3g})")

fig, ax = plt.subplots(figsize=(9, 5.5), layout="constrained")
names, scores = zip(*((row.effect, row.score) for row in gap.ranking[::-1]), strict=True)
named = {step.effect for step in gap.steps}
colours = ["C1" if name in named else "C2" if name in ("nothing", "constant") else "C0" for name in names]
labels = [name.replace("_", " ") for name in names]
ax.hlines(labels, min(scores) / 2, scores, color="lightgrey", linewidth=0.8)
ax.scatter(scores, labels, color=colours)
ax.set(xscale="log", xlabel="score of discs left out, in spreads over the discs (smaller is better)")
ax.set_xticks([0.5, 1, 2, 5, 10], ["0.5", "1", "2", "5", "10"])
ax.set_title("One effect at a time (orange: in the end named; green: for comparison)")
plt.show()

# %%
# Show
# ----
# Every disc is predicted without its own data, and the naming is repeated without it. The entropies of table
# 6 are not used in any fit.


def held_out(statistic: str) -> list:
    return [row for row in gap.held_out if row.statistic == statistic]


for row in held_out("std"):
    print(f"named without disc {row.disc}:", " + ".join(row.effects))
print("mean error on discs left out     named   nothing  constant  in its 80 % interval")
units = {"std": "ln", "up": "ln", "down": "ln", "range": "ln", "mean": "Nm", "entropy": "bits"}
for statistic, unit in units.items():
    rows = held_out(statistic)
    scale = np.log if unit == "ln" else np.asarray
    errors = [
        np.mean([abs(scale(getattr(row, kind)) - scale(row.measured)) for row in rows])
        for kind in ("predicted", "nothing", "constant")
    ]
    inside = sum(row.low <= row.measured <= row.high for row in rows)
    print(f"  {statistic:12} {unit:6}" + "".join(f"{error:10.3f}" for error in errors) + f"{inside:12} of 8")

# %%
# The length of the records is not stated; depending on it, the entropy of a constant torque lies between 0.87
# and 1.48 bits (MATLAB's segments are padded to a power of two). The comparison is therefore repeated with
# one shift, taken from the other discs.

rows = held_out("entropy")
rest = np.array([row.measured - row.predicted for row in rows])
shifted = rest - (rest.sum() - rest) / 7
constant = np.array([row.measured - row.constant for row in rows])
print(f"entropy, shifted: {np.abs(shifted).mean():.3f} bits, constant {np.abs(constant).mean():.3f} bits")

fig, axes = plt.subplots(1, 4, figsize=(13, 4), layout="constrained")
panels = {
    "std": "standard deviation, Nm",
    "up": "maximum - mean, Nm",
    "down": "mean - minimum, Nm",
    "entropy": "entropy, bits",
}
for ax, (statistic, title) in zip(axes, panels.items(), strict=True):
    rows = held_out(statistic)
    discs = [row.disc for row in rows]
    middle = np.array([row.predicted for row in rows])
    ends = np.abs(np.array([[row.low, row.high] for row in rows]).T - middle)
    ax.errorbar(discs, middle, ends, fmt="o", color="C1", capsize=3, label="predicted without the disc, 80 %")
    ax.plot(discs, [row.nothing for row in rows], "_", color="C0", markersize=10, label="simulator alone")
    ax.plot(
        discs, [row.constant for row in rows], "_", color="C2", markersize=10, label="mean of the other discs"
    )
    ax.plot(discs, [row.measured for row in rows], "x", color="black", label="measured")
    ax.set(title=title, xlabel="worn lobes", xticks=discs)
axes[-1].set_ylim(1.0, 2.0)
fig.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
plt.show()

# %%
# A rig that gives such numbers
# -----------------------------
# The corrected simulator, with the statistics that it gives for the eight discs. Its torque is a surrogate
# and must be labelled as one.

print("effects:", ", ".join(effect.effect_id for effect in gap.effects))
simulated, measured = gap.fitted, gap.measured
for k, name in enumerate(("mean - set-point, Nm", "ln std", "ln up", "ln down")):
    print(f"  {name:21} measured {measured[:, k].mean():+.2f}, its rig {simulated[:, k].mean():+.2f}")
skews = [np.exp(np.mean(x[:, 2] - x[:, 3])) for x in (measured, simulated)]
print(f"  up over down          measured {skews[0]:.2f}, its rig {skews[1]:.2f}")

# %%
# What this does not prove. Eight discs, one record each, determine one effect: a slow fluctuation that
# affects all discs alike, in the load or in the sensor's zero, which these numbers cannot separate. The
# second effect is no finding: its p is that of the best of some 20 candidates, and most searches without
# one disc do not name it. Nor is an offset: with a drift of this size the mean of a record scatters by as
# much as it exceeds the set-point, although it does so in 8 of 8. No effect of the library, alone or in the
# sets that were tried, reaches the upward excursions, 1.6 times those downward; the library has no torque
# that jumps up only (a brake that grabs, a stick-slip). The mean of the other discs predicts a disc better
# than the named effect does: it uses measured level and asymmetry and explains neither. The brake's rotor,
# which could make the deviation depend on the count, is neither confirmed nor excluded, and pairs of
# effects that change the gearbox's response were not tried. Length of the records (1.8 s), clearances and
# priors are assumed.
