"""
Paper B, figs. 10 to 12: scalograms with the wavelet mb32.3
===========================================================

Figs. 10 and 11 show the absolute coefficients of twelve levels for one to eight worn lobes, fig. 12 for
other patterns; each level has 64 shades, the largest value is the darkest. The paper reads from them rings
at levels 7 to 9 at the start, and quiet levels 1 to 4 for seven worn lobes. This example shows the
**surrogate** torque by MATLAB's documented recipe (statements B7 and B8).
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np
from _papers import LOBE_PERIOD, STEEL, panels, run, shades, torques

from cyclofeat.signal.wavelets import dwt, level_statistics, scalogram
from cyclofeat.simulators import LobeDefects

PATTERNS = ((0, 4), (0, 3, 6), (0, 2, 4, 6), (1, 3, 5, 7))


def names(lobes):
    return ", ".join(str(lobe + 1) for lobe in lobes)


def show(records, titles, heading):
    axes = panels(2, "time in s", "level", heading, size=(11, 7))
    with warnings.catch_warnings():
        # Levels 8 to 12 of 6000 samples consist mostly of end effects, as in the paper.
        warnings.simplefilter("ignore", UserWarning)
        pictures = [scalogram(record, levels=12) for record in records]
    for ax, cells, title in zip(axes.flat, pictures, titles, strict=True):
        ax.imshow(cells, aspect="auto", cmap="gray_r", extent=(0, 0.6, 12.5, 0.5), interpolation="none")
        ax.set_title(title, fontsize="medium")
        ax.set_yticks(range(1, 13))
    plt.show()


of_count = torques(STEEL, counts=range(9))
show(of_count[1:5], [f"{n} worn" for n in range(1, 5)], "lobes 1 to 4 (fig. 10)")
show(of_count[5:], [f"{n} worn" for n in range(5, 9)], "lobes 5 to 8 (fig. 11)")
of_pattern = np.array([run(LobeDefects.worn(lobes)).torque_out for lobes in PATTERNS])
show(of_pattern, [f"lobes {names(lobes)} worn" for lobes in PATTERNS], "other patterns (fig. 12)")

# %%
# The dark start belongs to the ramp and, if the 8th lobe is worn, to a start with its chord pressed in (see
# figs. 5 to 7); it fills levels 7 to 9 as the paper describes. After it each worn lobe draws a line once per
# 0.1125 s. Shades are relative to each row's largest value, so one strong moment makes a row look quiet. In
# numbers, settled:

n = 2 * LOBE_PERIOD
rms = level_statistics(dwt(of_count[:, -n:], levels=7), n)["rms"]
fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
for level, colour in enumerate(shades(7), 1):
    left.semilogy(1e3 * rms[:, level - 1], "o-", color=colour, label=f"level {level}")
left.set(xlabel="worn lobes", ylabel="rms in mNm", title="adjacent lobes")
left.legend(fontsize="small", ncols=2)
time = np.arange(LOBE_PERIOD) / LOBE_PERIOD * 15
for k in range(len(PATTERNS)):
    torque = of_pattern[k, -LOBE_PERIOD:]
    right.plot(time, torque - 22 + 3 * k, lw=0.9, color="black")
right.set(xlabel="time in slots of one lobe (7.5 ms)", title="one lobe period of the other patterns")
right.set_yticks(3 * np.arange(4), [names(lobes) for lobes in PATTERNS])
plt.show()

# %%
# No level becomes quiet at seven worn lobes: all but the highest grow with the count and level off. In the
# torque of the other patterns each worn lobe has its own slot of the lobe period, independent of the other
# lobes. These slots, not a scalogram's shade, allow lobes to be counted.
