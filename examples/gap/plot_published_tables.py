"""
Missing effects behind published statistics
===========================================

Paper A prints minimum, maximum, mean and standard deviation of the torque measured with eight discs, one
record each (table 4), and no torque. That is enough to ask where the simulator disagrees, which effects
of the library would make up for it, and how well they predict a disc that had no part in the search. The
32 numbers are measured; everything that they are compared with is **surrogate** torque, from some 4000
simulated rigs whose statistics lie beside this script. Remade without them (``table`` left out) it
simulates 3000 records, a quarter of an hour on one core.
"""

import matplotlib.pyplot as plt
import numpy as np
from _stored import DATA

from cyclofeat.datasets import load_published_tables
from cyclofeat.gap import SummaryGap

tables = load_published_tables()
published, entropy = tables.signal_statistics, tables.spectral_entropy["entropy_bits"]
stored = DATA / "published_tables.npz"
gap = SummaryGap(table=stored).fit(published, entropy=entropy)  # gap.save_table(stored) writes it

# %%
# Where
# -----
# Differences over the eight discs. With eight of them no exact two-sided p can fall below 2/256 = 0.0078.

print("measured against the simulator alone")
for row in gap.discrepancies_:
    size = f"{row.difference:+.2f} Nm" if row.unit == "Nm" else f"a factor of {np.exp(row.difference):.3g}"
    limits = (row.low, row.high) if row.unit == "Nm" else (np.exp(row.low), np.exp(row.high))
    print(
        f"  {row.statistic:13} {size:22} (95 %: {limits[0]:.3g} to {limits[1]:.3g}), {row.same_sign} of 8, "
        f"p = {row.p:.4f}, over all rows {row.p_adjusted:.3f}"
    )

# %%
# What
# ----
# Each effect alone, scored by discs left out (continuous ranked probability score of the four statistics,
# in spreads over the discs; smaller is better). The constant is the mean of the other discs: it knows no
# physics.

for name, score in gap.ranking_:
    print(f"  {score:7.2f}  {name}")
for step in gap.steps_:
    print(
        f"named {step.effect_id}: score {step.score_before:.2f} -> {step.score_after:.2f}, p = {step.p:.4f}; "
        f"looks like it: {', '.join(step.look_alikes) or 'nothing'}; told apart by {step.next_measurement}"
    )
print("not added:", "; ".join(f"{name} {score:.2f} (p = {p:.2f})" for name, score, p in gap.rejected_[:5]))
print(
    "          ", "; ".join(f"{n} {s:.2f} (p = {p:.2f})" for n, s, p in gap.rejected_ if n == "brake_rotor")
)
for name, value in gap.theta_.items():
    low, high = gap.theta_ci_[name]
    print(f"  {name} = {value:.3g} (90 %: {low:.3g} to {high:.3g})")

fig, ax = plt.subplots(figsize=(9, 5.5), layout="constrained")
names, scores = zip(*gap.ranking_[::-1], strict=True)
own = {step.effect_id for step in gap.steps_}
colours = ["C1" if name in own else "C2" if name in ("nothing", "constant") else "C0" for name in names]
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
# Every disc predicted without it, the naming repeated without it. The entropies of table 6 took no part in
# anything.


def held_out(statistic: str) -> list:
    return [row for row in gap.held_out_ if row.statistic == statistic]


print("named without disc:", {row.disc: "+".join(row.effects) for row in held_out("std")})
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
# How long the records were is not stated, and the entropy of a constant torque alone lies between 0.87 and
# 1.48 bits with their length (MATLAB's segments are padded to a power of two). So once more with one shift,
# taken from the other discs.

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
# The corrected simulator, with the statistics that it gives for the eight discs: a surrogate, to be called
# so.

print(gap.simulator_.effects)
simulated = np.array([np.median(gap.predictive(k), axis=0) for k in range(8)])
measured = gap.measured_
for k, name in enumerate(("mean - set-point, Nm", "ln std", "ln up", "ln down")):
    print(f"  {name:21} measured {measured[:, k].mean():+.2f}, its rig {simulated[:, k].mean():+.2f}")
skews = [np.exp(np.mean(x[:, 2] - x[:, 3])) for x in (measured, simulated)]
print(f"  up over down          measured {skews[0]:.2f}, its rig {skews[1]:.2f}")

# %%
# What this does not prove. Eight discs, one record each, carry one effect: something slow that moves all
# discs alike, in the load or in the sensor's zero, which these numbers cannot tell apart. Nothing further
# is named: with a drift of this size the mean of a record scatters by as much as it lies above the
# set-point, although it does so in 8 of 8. The excursions upward, 1.6 times those downward, are reached by
# no effect of the library alone or in the sets that were tried; torque that only ever jumps up (a brake
# that grabs, a stick-slip) is not in it. The mean of the other discs predicts a disc better than the named
# effect does: it is told level and asymmetry and explains neither. The brake's rotor, which could make the
# deviation depend on the count, is neither confirmed nor excluded, and pairs of effects that the gearbox
# answers were not tried. Length of the records (1.8 s), clearances and priors are assumed.
