"""
Finding: a tempting artefact at the chord's end
===============================================

A worn lobe's chord ends at the pit. A model that uses the chord's line for the first 12 degrees of the lobe
and the flank beyond has a surface with a jump: a sleeve that crosses the border loses all of its spring
energy at once, and the machine rings. This is not wear. **Surrogate** torque with that surface and with the
closed outline, on which a sleeve touches chord and flank at once, one worn lobe on both wheels.
"""

import matplotlib.pyplot as plt
import numpy as np
from _chord import closed_torque, pressed_in, switched_torque

COUNTS = (0, 1, 3, 7)
closed = {count: closed_torque(count) for count in COUNTS}
switched = {count: switched_torque(count) for count in COUNTS}
time = np.arange(closed[1].size) * 1e-5

fig, (left, right) = plt.subplots(1, 2, figsize=(12, 4.4), layout="constrained")
place = np.linspace(9, 14.5, 1000)
on_outline, on_switched = pressed_in(place)
left.plot(place, 1e6 * on_switched, color="C3", lw=1.2, label="chord to 12 degrees, then the flank")
left.plot(place, 1e6 * on_outline, color="C0", lw=2, ls="--", label="closed outline")
left.set(xlabel="position in degrees from the tip (12: the pit)", ylabel="penetration in µm")
left.set_title("a sleeve moved along the healthy outline")
left.set_ylim(-10, 480)
left.legend(loc="upper right")
right.plot(time, switched[1] - 22, color="C3", lw=0.8, label=f"switched, std {switched[1].std():.2f} Nm")
right.plot(time, closed[1] - 22, color="C0", lw=0.9, label=f"closed, std {closed[1].std():.2f} Nm")
right.set(xlabel="time in s", ylabel="output torque about 22 Nm, Nm", title="one worn lobe, one lobe period")
right.legend()
plt.show()
for count in COUNTS:
    ratio = switched[count].std() / closed[count].std()
    print(f"{count} worn: {switched[count].std():.3f} Nm if switched, {ratio:.1f} times the closed outline's")

# %%
# Without wear both models are the same machine. With wear, the switched surface has two and a half to three
# and a half times the ripple, in bursts at every passage of a worn lobe. This looks like an excellent
# diagnostic signal, and a counter trained on it scores well for the wrong reason. The cause is a force that
# jumps to zero while a sleeve is pressed in by a third of a millimetre. A balance of the energy reveals it,
# a picture of the torque does not.
