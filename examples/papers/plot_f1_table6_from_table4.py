"""
Finding: table 6 restates table 4
=================================

Paper A's entropies (table 6) are its success. They follow from the means and deviations of its table 4:
MATLAB's ``pwelch`` keeps the mean, whose line at 0 Hz outweighs all others, so the entropy measures the
ripple relative to the mean. All numbers here are published ones; one picture of **surrogate** torque shows
the reason.
"""

import matplotlib.pyplot as plt
import numpy as np
from _papers import COUNTS, binary_entropy, entropy_bits, surrogate_set, table_6_from_table_4

from cyclofeat.datasets import load_published_tables

entropy, fitted, (constant, slope) = table_6_from_table_4()
table = load_published_tables().signal_statistics
share = table["std_nm"] ** 2 / (table["mean_nm"] ** 2 + table["std_nm"] ** 2)
print(f"entropy = {constant:.3f} + {slope:.3f} h(a), largest error {np.abs(entropy - fitted).max():.4f} bits")
print(f"Pearson r of a and entropy: {np.corrcoef(share, entropy)[0, 1]:.4f}")

fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
left.plot(COUNTS, entropy, "kx", markersize=9, label="table 6")
left.plot(COUNTS, fitted, "o-", color="C0", markersize=4, label="from table 4, two constants fitted")
left.set(xlabel="worn lobes", ylabel="entropy in bits")
left.legend()
grid = np.linspace(0.015, 0.05, 100)
right.plot(100 * grid, constant + slope * binary_entropy(grid), color="C0")
for count in COUNTS:
    right.plot(100 * share[count], entropy[count], "kx")
    place = {3: (-10, 2), 4: (5, 2), 5: (2, -13)}.get(count, (5, -9))  # three crosses touch
    right.annotate(f"{count}", (100 * share[count], entropy[count]), place, textcoords="offset points")
right.set(xlabel="a = std² / (mean² + std²) in %", title="measured; number of worn lobes beside each")
plt.show()

# %%
# The same record with its fluctuation scaled: the entropy follows every increase, while the entropy with the
# mean removed stays constant.

record = surrogate_set(0)[3]
factors = np.linspace(0.3, 2, 12)
mean, ripple = record.mean(), record - record.mean()
kept = np.array([entropy_bits(mean + factor * ripple) for factor in factors])
removed = np.array([entropy_bits(factor * ripple) for factor in factors])
fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
ax.plot(factors * record.std(), kept, "o-", label="mean kept")
ax.plot(factors * record.std(), removed, "s--", label="mean removed")
ax.set(
    xlabel="standard deviation in Nm",
    ylabel="entropy in bits",
    title="one surrogate record, scaled",
    ylim=(0, None),
)
ax.legend()
plt.show()

# %%
# Everything that makes the torque fluctuate (wear, a brake that grabs, warmer oil) changes this entropy, and
# so does the brake's set-point. Two constants are fitted to eight numbers, and the other six follow.
