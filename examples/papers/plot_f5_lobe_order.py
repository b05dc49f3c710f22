"""
Finding: a lobe's order is 16/15, not 1
=======================================

Paper A looks for defects at harmonics of the input shaft and of the mesh. But a lobe does not pass the load
once per input turn: the wheel turns back by a lobe meanwhile, so the lobe passes once in 15/16 of a turn,
at 8.889 Hz at 500 RPM and not at 8.333 Hz. A misaligned coupling or motor causes the latter. **Surrogate**
torque with both, and no noise.
"""

import matplotlib.pyplot as plt
import numpy as np
from _papers import BOTH, RATE, STEEL

from cyclofeat.simulators import Courses, LobeDefects, simulate

INPUT, LOBE = 500 / 60, 500 / 60 * 16 / 15


def once_per_turn(time):
    """Assumed: 2 mNm of load at each of the first five harmonics of the input shaft."""
    return 2e-3 * sum(np.sin(2 * np.pi * k * INPUT * time) for k in range(1, 6))


# Three adjacent lobes are worn; the ramp and some settling are removed.
made = simulate(
    STEEL,
    LobeDefects.worn(3, wheels=BOTH),
    duration=4.0,
    sampling_rate=RATE,
    courses=Courses(load_fluctuation=once_per_turn),
)
angle, torque = (values[-round(3.6 * RATE) :] for values in (made.input_angle, made.torque_out))
torque = torque - torque.mean()


def amplitudes(part):
    """Finely interpolated amplitude spectrum under a Hann window."""
    window = np.hanning(part.size)
    lines = 2 * np.abs(np.fft.rfft(part * window, 20 * torque.size)) / window.sum()
    return np.fft.rfftfreq(20 * torque.size, 1 / RATE), lines


fig, axes = plt.subplots(1, 2, figsize=(12, 4.4), layout="constrained", sharey=True)
for ax, (low, high, number) in zip(axes, ((7, 10.5, 1), (40, 46.5, 5)), strict=True):
    for seconds, style, colour in ((0.6, "--", "C1"), (1.8, "-.", "C2"), (3.6, "-", "C0")):
        frequencies, lines = amplitudes(torque[: round(seconds * RATE)])
        shown = (frequencies >= low) & (frequencies <= high)
        ax.plot(frequencies[shown], 1e3 * lines[shown], style, color=colour, label=f"{seconds:g} s")
    ax.axvline(number * INPUT, color="0.6", lw=0.8)
    ax.axvline(number * LOBE, color="0.6", lw=0.8)
    ax.text(number * INPUT, 1.01, f"{number} × input", transform=ax.get_xaxis_transform(), ha="right")
    ax.text(number * LOBE, 1.01, f"{number} × lobe", transform=ax.get_xaxis_transform(), ha="left")
    ax.set_xlabel("frequency in Hz")
axes[0].set_ylabel("amplitude in mNm")
axes[1].legend(title="record")
plt.show()

# %%
# Folding shows it without lines. The same record cut into stretches of one input turn, and of 15/16 of it:

fig, axes = plt.subplots(1, 2, figsize=(12, 4), layout="constrained", sharey=True)
turns = (angle - angle[0]) / (2 * np.pi)
for ax, period, name in ((axes[0], 1.0, "input turns"), (axes[1], 15 / 16, "lobe periods")):
    phase = turns / period
    grid = np.arange(int(phase[-1]))[:, np.newaxis] + np.linspace(0, 1, 600)
    folded = np.interp(grid, phase, torque)
    ax.plot(np.linspace(0, 1, 600), folded.T, color="C0", lw=0.3, alpha=0.5)
    ax.plot(np.linspace(0, 1, 600), folded.mean(axis=0), color="black", lw=1.2)
    ax.set(title=f"folded by {name}; mean in black", xlabel=f"phase in {name}")
axes[0].set_ylabel("torque about its mean in Nm")
plt.show()

# %%
# The papers' 0.6 s cannot separate the two at the first line: they are 0.56 Hz apart and a line is 3 Hz wide.
# This requires a whole output turn (1.8 s), after which pins and lobes have met in all combinations, or
# better two. 50 Hz mains is exactly input order 6, and the papers' f0 = 100 Hz is order 12: neither is a line
# of a lobe. The lobe lines are a comb from 8.889 Hz on, whose first line is small; wear changes all of them,
# and :class:`~cyclofeat.features.LobeMap` uses them all. Run-out of a *wheel* turns with the lobes, at 16/15,
# too: it is one smooth wave over all lobes, whereas wear is a short event at one.
