"""
Paper A, figs. 10 and 11: coherence of measured torque
======================================================

Figs. 10 and 11 show the coherence with the healthy disc's torque for one to seven defects: no gradual
dependence. This example shows it for **surrogate** torque of the assumed rig ``published`` (statement A5).
"""

import matplotlib.pyplot as plt
import numpy as np
from _papers import RIG_RATE, surrogate_sets

from cyclofeat.signal import magnitude_squared_coherence

sets = surrogate_sets()
fig, axes = plt.subplots(4, 2, figsize=(11, 8), layout="constrained", sharex=True, sharey=True)
for count, ax in enumerate(axes.flat[:7], 1):
    frequencies, lines = magnitude_squared_coherence(sets[0, count], sets[0, 0], RIG_RATE)
    shown = frequencies <= 1500
    ax.fill_between(frequencies[shown], lines[shown], color="C0", lw=0)
    ax.set_title(f"{count} worn", fontsize="medium")
    ax.set(xlim=(0, 1500), ylim=(0, 1))
last = axes.flat[7]
last.axis("off")
for ax in (*axes[-1, :1], axes[-2, 1]):
    ax.set_xlabel("frequency in Hz")
    ax.tick_params(labelbottom=True)
fig.suptitle("one set of eight assemblies (figs. 10 and 11)")
plt.show()

# %%
# The mean from 0 to 1500 Hz, four sets:

fig, ax = plt.subplots(figsize=(7, 3.8), layout="constrained")
for records in sets:
    frequencies, lines = magnitude_squared_coherence(records[1:], records[0], RIG_RATE)
    ax.plot(range(1, 8), lines[:, frequencies <= 1500].mean(axis=1), "o-", lw=0.8, color="C0", alpha=0.6)
unrelated = np.random.default_rng(0).normal(size=(2, sets.shape[-1]))
chance = magnitude_squared_coherence(*unrelated, RIG_RATE)[1].mean()
ax.axhline(chance, color="black", lw=0.8, ls="--", label="unrelated noise")
ax.set(xlabel="worn lobes", ylabel="mean coherence", ylim=(0, 0.4))
ax.legend()
plt.show()

# %%
# Two assemblies fluctuate independently, so their torque is only as coherent as two unrelated noises in eight
# segments. Two healthy discs would give the same picture. Coherence between recordings contains no
# information about wear unless both begin at the same angle and hardly drift.
