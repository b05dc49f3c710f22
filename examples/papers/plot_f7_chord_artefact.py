"""
Finding: a tempting artefact at the chord's end
===============================================

A worn lobe's chord ends at the pit. Whoever takes the chord's line for the first 12 degrees of the lobe and the flank beyond
has a surface with a jump: a sleeve that crosses the border loses all of its spring energy at once, and the machine rings. This
is not wear. **Surrogate** torque with that surface and with the closed outline, on which a sleeve touches chord and flank at
once, one worn lobe on both wheels.
"""

import matplotlib.pyplot as plt
import numpy as np
from _chord import closed_torque, force_past_the_chord, switched_torque

DT = 2e-5
closed, switched = closed_torque(DT), switched_torque(DT)
time = np.arange(closed.size) * DT

fig, (left, right) = plt.subplots(1, 2, figsize=(12, 4.4), layout="constrained")
place, on_outline, on_switched = force_past_the_chord()
left.plot(place, on_switched / 1e3, color="C3", lw=1.2, label="chord to 12 degrees, then the flank")
left.plot(place, on_outline / 1e3, color="C0", lw=2, ls="--", label="closed outline")
left.set(xlabel="place in degrees from the tip (12: the pit)", ylabel="force in kN")
left.set_title("a sleeve led along the healthy outline")
left.legend(loc="lower left")
right.plot(time, switched - 22, color="C3", lw=0.7, label=f"switched, std {switched.std():.2f} Nm")
right.plot(time, closed - 22, color="C0", lw=0.9, label=f"closed, std {closed.std():.2f} Nm")
right.set(xlabel="time in s", ylabel="output torque about 22 Nm, Nm", title="one lobe period")
right.legend()
plt.show()
print(f"ripple with the switched surface: {switched.std() / closed.std():.1f} times")

# %%
# Seven times the ripple, in short bursts at every passage of a worn lobe: no better diagnostic signal could be wished for,
# and a counter trained on it scores high under any drift. It comes from a force that jumps. The audit of energy finds such
# a thing (:func:`~cyclofeat.simulators.energy_audit`), and so does halving the time step; a picture of torque does not.
