"""
Finding: the papers' contact law makes energy
=============================================

Paper B's contact stiffness follows the local curvature of the flank (eq. 14). While a contact moves along
the flank under load, its stored energy changes without any work being done: the law is not conservative.
Over a whole number of load cycles the drive's mean torque times the reduction has to cover the load; what it
lacks, the law has made. The torque is a **surrogate** for the papers' simulation.
"""

import matplotlib.pyplot as plt
import numpy as np
from _papers import RATE, STEEL, run

LAWS = {"paper (eq. 11 to 14)": STEEL, "conservative": STEEL.replace(contact_law="conservative")}
turn = 1200  # samples of an input turn
torques = {name: run(gearbox=gearbox).torque_in[-2 * turn :] for name, gearbox in LAWS.items()}
for name, torque in torques.items():
    print(f"{name:21} mean {torque.mean():.4f} Nm, surplus over the load {15 * torque.mean() / 22 - 1:+.2%}")

fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
for (name, torque), style in zip(torques.items(), ("-", "--"), strict=True):
    left.plot(np.arange(2 * turn) / RATE, torque, style, lw=1, label=f"{name}, mean {torque.mean():.4f} Nm")
left.axhline(22 / 15, color="black", lw=0.8, ls=":", label="22 Nm / 15 = 1.4667 Nm")
left.set(xlabel="time in s", ylabel="input torque in Nm", ylim=(1.44, 1.5))
left.legend(fontsize="small", loc="upper right")

# Along the loaded flank the energy that a contact stores at one force varies, although no work is done.
t = np.linspace(0, 12, 200)
radius = STEEL.profile.effective_radius(np.deg2rad(t))
right.plot(t, 1e3 * radius)
right.axhline(1e3 * STEEL.pin_radius, color="C1", ls="--")
right.set(xlabel="position on the loaded flank in degrees (0 tip, 12 pit)", ylabel="mm", yscale="log")
right.set_yticks([4, 6, 10, 20, 40], ["4", "6", "10", "20", "40"])
right.minorticks_off()
right.set_title("effective radius of the contact (conservative: dashed)")
plt.show()

# %%
# With the papers' law the drive needs 0.9 % less than the load's power: the efficiency exceeds one. With one
# effective radius for all contacts the balance closes to rounding, and the input torque equals the load's
# share plus the loss of the damping. The error hardly matters for counting lobes; it matters for losses,
# efficiencies and every effect of a few per cent of torque.
