"""
Paper B, figs. 1, 2, 13 and 14: gearbox and defects
===================================================

Fig. 1 shows the model healthy and with eight adjacent worn lobes, fig. 2 its dimensions, figs. 13 and 14
the designs with seven lobes removed from both wheels and from one. This example shows the simulator's
versions at the start of a run. Their torque is the **surrogate** in all following examples.
"""

import matplotlib.pyplot as plt
import numpy as np
from _papers import BOTH, HEALTHY, ONE, STEEL

from cyclofeat.simulators import LobeDefects

POINTS = 200  # per lobe


def edge(defects, wheel):
    """Outline of a wheel in mm in the housing's frame, without the removed lobes."""
    own = wheel in defects.wheels
    points = STEEL.profile.outline(defects.worn_lobes if own else (), POINTS)
    for lobe in defects.removed_lobes if own else ():
        points[lobe * POINTS : (lobe + 1) * POINTS] = np.nan
    side = (-1) ** wheel  # wheel 1 is wheel 0, turned by 180 degrees
    return side * 1e3 * (np.append(points, points[0]) - STEEL.eccentricity)


def draw(ax, title, defects):
    for number in range(STEEL.n_pins):
        centre = 1e3 * STEEL.pin_circle_radius * np.exp(2j * np.pi * number / STEEL.n_pins)
        ax.add_patch(plt.Circle((centre.real, centre.imag), 1e3 * STEEL.pin_radius, color="0.85"))
        if number in (0, 13):
            ax.text(centre.real, centre.imag, f"{number + 1}", ha="center", va="center")
    for number in range(STEEL.n_internal_sleeves):
        centre = 1e3 * STEEL.internal_pitch_radius * np.exp(2j * np.pi * number / STEEL.n_internal_sleeves)
        circle = plt.Circle((centre.real, centre.imag), 1e3 * STEEL.internal_sleeve_radius, color="0.85")
        ax.add_patch(circle)
        if number == 0:
            ax.text(centre.real, centre.imag, "1", ha="center", va="center")
    for wheel, style in ((1, "--"), (0, "-")):
        points = edge(defects, wheel)
        ax.plot(points.real, points.imag, style, color=f"C{wheel}", lw=1.3, label=f"wheel {wheel}")
    ax.set(title=title, aspect="equal", xlim=(-72, 72), ylim=(-72, 72), xticks=[], yticks=[])


fig, axes = plt.subplots(2, 2, figsize=(9, 9.4), layout="constrained")
draw(axes[0, 0], "healthy (fig. 1, left)", HEALTHY)
draw(axes[0, 1], "lobes 1 to 8 worn (fig. 1, right)", LobeDefects.worn(8))
draw(axes[1, 0], "lobes 1 to 7 of both wheels removed (fig. 13)", LobeDefects.removed(7, wheels=BOTH))
draw(axes[1, 1], "lobes 1 to 7 of one wheel removed (fig. 14)", LobeDefects.removed(7, wheels=ONE))
fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
plt.show()

# %%
# Dimensions (fig. 2). The paper does not state those of the internal sleeves; they are assumed here:

tip, pit = (abs(point) for point in STEEL.profile.chord())
for name, value in (
    ("eccentricity", STEEL.eccentricity),
    ("external sleeves, radius", STEEL.pin_radius),
    ("their circle", STEEL.pin_circle_radius),
    ("tips of the lobes", tip),
    ("pits between them", pit),
    ("internal sleeves, radius (assumed)", STEEL.internal_sleeve_radius),
    ("their circle (assumed)", STEEL.internal_pitch_radius),
):
    print(f"{name:35} {1e3 * value:5.1f} mm")

# %%
# A worn lobe has a straight line from its tip to the pit behind it. The line removes 1.25 mm near the tip and
# *adds* 0.35 mm near the pit: it pushes a sleeve outwards there, which causes the peaks of force in fig. 3.
# The outline must be closed without a gap (see the finding on the chord). Lobes and sleeves count from 1 in
# the papers and in these pictures.
