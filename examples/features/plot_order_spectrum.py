"""
Orders separate worn lobes from run-out
=======================================

A worn lobe passes the load at 16/15 of the input speed (8.9 Hz); run-out turns at the input speed (8.3 Hz).
A fixed frequency grid, or an estimate of the speed that is wrong by one per cent, does not separate the
two. :class:`~cyclofeat.features.OrderSpectrum` finds the speed of each window and gives the torque at the
lines of the output turn, k/15 of the input speed. The papers have no such method. **Surrogate** torque of
one assembly each on the assumed rig R1.
"""

import matplotlib.pyplot as plt
import numpy as np
from _surrogates import SAMPLING_RATE, surrogate_windows

from cyclofeat.features import OrderSpectrum
from cyclofeat.signal.orders import estimate_input_speed

X, y, _ = surrogate_windows(n_assemblies=1)
transformer = OrderSpectrum(SAMPLING_RATE, n_lines=128, n_mesh_lines=0).fit(X)
amplitudes = transformer.transform(X)
speeds = 60 * estimate_input_speed(X, SAMPLING_RATE, nominal_hz=500 / 60)
line = np.arange(1, 129)

fig, axes = plt.subplots(3, 1, figsize=(10, 7), layout="constrained", sharex=True, sharey=True)
for ax, count in zip(axes, (0, 1, 5), strict=True):
    window = np.flatnonzero(y == count)[0]
    ax.vlines(line, 1e-3, amplitudes[window], color="0.6", lw=1.2)
    for step, marker, name in ((15, "s", "input turn and multiples"), (16, "o", "lobe and multiples")):
        of_step = line[line % step == 0]
        ax.plot(
            of_step, amplitudes[window, of_step - 1], marker, color="C0" if step == 16 else "C1", label=name
        )
    ax.set(
        title=f"{count} worn, speed found: {speeds[window]:.1f} RPM",
        yscale="log",
        ylim=(1e-3, 5),
        ylabel="Nm",
    )
axes[0].legend(loc="upper center", ncols=2)
axes[-1].set(xlabel="line k of the output turn (order k/15 of the input)", xticks=range(0, 129, 16))
plt.show()

# %%
# The first few lines are drift, and lines 120 and above lie on the rig's resonance. A worn lobe comes under
# the load once in 15/16 of an input turn, so its pulses have lines at the multiples of 16; run-out has lines
# at the multiples of 15. How far the multiples of 16 stand out shows *that* lobes are worn; their pattern
# shows *how many*: five adjacent worn lobes weaken every third of them (48 and 96). The lobe map reads that
# pattern with the resonance removed.
