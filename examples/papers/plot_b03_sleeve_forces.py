"""
Paper B, figs. 3 and 4: forces on the sleeves
=============================================

Fig. 3 shows the force on the 14th external sleeve, fig. 4 that on the 1st internal sleeve, for one to eight
adjacent worn lobes: peaks of 400 to 700 N on the former, hardly any change of the latter. This example
shows the same sleeves in this simulator, whose torque is the **surrogate** of the other examples; both
wheels are worn alike (statements B1 to B3).
"""

import matplotlib.pyplot as plt
import numpy as np
from _papers import HEALTHY, RATE, panels, peaks, sleeve_forces

from cyclofeat.simulators import LobeDefects

time = np.arange(6000) / RATE
healthy = sleeve_forces(HEALTHY)[:, 13]

axes = panels(4, "time in s", "force in N", "14th external sleeve (fig. 3)", size=(11, 8.5))
for count, ax in enumerate(axes.flat, 1):
    force = sleeve_forces(LobeDefects.worn(count))[:, 13]
    ax.plot(time, force, lw=0.8, color="C0", label="worn")
    ax.plot(time, healthy, lw=0.8, color="black", label="healthy")
    heights = ", ".join(f"{height:.0f}" for height in peaks(force)[1])
    ax.set_title(f"{count} worn; peaks above 150 N: {heights} N", fontsize="medium")
axes[0, 0].legend(loc="upper left")
plt.show()

# %%
# The healthy force stays below 200 N, as stated, and a worn lobe's peak is 667 to 693 N where the paper has
# 600 N. But one worn lobe gives *one* peak in 0.6 s, not two: a lobe meets the same sleeve again after a
# whole output turn, and the same lobe of the other wheel half a turn (0.9 s) later. Peaks of less than 300 N
# are chords that pass on the unloaded side. Their number grows with the count as stated for 2, 3 and 7 worn
# lobes, and is lower for 4 to 6.

axes = panels(4, "time in s", "force in N", "1st internal sleeve (fig. 4)", size=(11, 8.5))
healthy = sleeve_forces(HEALTHY, "internal")[:, 0]
for count, ax in enumerate(axes.flat, 1):
    force = sleeve_forces(LobeDefects.worn(count), "internal")[:, 0]
    ax.plot(time, force, lw=0.8, color="C0", label="worn")
    ax.plot(time, healthy, lw=0.8, color="black", label="healthy")
    ax.plot(time, force - healthy - 60, lw=0.8, color="C1", label="difference, shifted by 60 N")
    ax.set_title(f"{count} worn", fontsize="medium")
    ax.set_ylim(-120, 200)
plt.figlegend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
plt.show()

# %%
# The force hardly changes up to three worn lobes and oscillates at the maxima from five on, as stated, but
# with a third of the amplitude (15 to 18 N where the paper has up to 50 N). Eight worn lobes start with a
# jolt, which the next example explains.
