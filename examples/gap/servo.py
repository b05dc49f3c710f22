"""
Friction that a servo's simulator lacks
=======================================

A servo (Dynamixel XL330) swings 0.49 kg at 0.1 m: sixteen recordings of its position, **measured** by the
authors of `bam <https://github.com/Rhoban/bam>`_, four at each gain of its controller. The simulator has a
motor and no friction at all. From the literature it is known what such a servo needs: Coulomb or viscous
friction, and friction that grows with the load; Stribeck's effect alone adds nothing.

The engine behind the gap workflow takes any simulator. Here it is given the servo's, with eight effects that
it may lack. It names the friction from the recordings of three gains; those of gain 400 are held out. It
takes a minute, and loads the data once, or takes a local copy: ``python servo.py FOLDER``.

.. image:: /figures/gap_servo.png
   :alt: Position of a recording held out, measured and simulated; probability of each effect.
         Lines: undecided, probably missing and missing begin
"""

# sphinx_gallery_thumbnail_path = 'figures/gap_servo.png'

import sys
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from _measured_motions import load_servo_pendulum, mark_states
from numba import njit

from cyclofeat.gap.engine.problem import Effect, Parameter, Session
from cyclofeat.gap.engine.search import explain
from cyclofeat.gap.engine.sizes import fit_sizes, make_rig

# %%
# The recordings
# --------------
# A condition is a gain of the controller, with the goal over time and the first position and speed.


class Recording(NamedTuple):
    """Condition of a recording, and the position in rad that was measured."""

    gain: float
    step: float  # s
    goal: np.ndarray
    enabled: np.ndarray
    position: np.ndarray
    speed: np.ndarray


recordings = [
    Recording(
        100.0 * 2 ** (number // 4),
        float(np.diff(one["timestamp"].astype(float)).mean()),
        *(one[key].astype(float) for key in ("goal_position", "torque_enable", "position", "speed")),
    )
    for number, one in enumerate(load_servo_pendulum(Path(sys.argv[1]) if sys.argv[1:] else None))
]
fitted = [one for one in recordings if one.gain != 400]
held_out = [one for one in recordings if one.gain == 400]

# %%
# The simulator and what it may lack
# ----------------------------------
# The motor's constants are not known either: every rig has them, and their sizes are fitted with each set of
# effects. An effect that ``refines`` others is asked for only beside one of them.

GRAVITY, MASS, LENGTH, VOLTAGE = 9.81, 0.49, 0.1, 7.4
effects = {
    "motor": Effect(
        {
            "torque_constant": Parameter("Nm/A", 0.1, 1.5),
            "resistance": Parameter("ohm", 0.5, 10),
            "armature": Parameter("kg m2", 1e-5, 0.02),
            "offset": Parameter("rad", -0.1, 0.1, log=False),
        },
        always=True,
    ),
    "coulomb": Effect({"torque": Parameter("Nm", 0.005, 0.3)}),
    "viscous": Effect({"damping": Parameter("Nm s/rad", 0.002, 0.3)}),
    "stribeck": Effect(
        {"torque": Parameter("Nm", 0.005, 0.3), "speed": Parameter("rad/s", 0.02, 3)}, refines=("coulomb",)
    ),
    "load_friction": Effect({"coefficient": Parameter("", 0.02, 0.6)}, refines=("coulomb", "viscous")),
    "driven_load_friction": Effect({"coefficient": Parameter("", 0.02, 0.6)}, refines=("coulomb", "viscous")),
    "drive_limit": Effect({"reduction": Parameter("", 0.03, 0.6)}),
    "mass_error": Effect({"change": Parameter("", -0.2, 0.2, log=False)}),
    "control_delay": Effect({"delay": Parameter("s", 0.002, 0.05)}),
}


@njit(cache=True)
def simulate_position(goal, enabled, start, speed, step, gain, parameters):
    """Return the position over time; the parameters are those of all effects, in their order."""
    constant, resistance, armature, offset = parameters[:4]
    coulomb, viscous, stribeck, slip, load, driven, limit, heavier, delay = parameters[4:]
    error_gain = 4096.0 / (2 * np.pi) / (256.0 * 885.0)
    inertia = MASS * LENGTH**2 * (1 + heavier) + armature
    weight = MASS * LENGTH * GRAVITY * (1 + heavier)
    h = step / 2
    phi, w = start, speed
    whole = int(delay / step)
    part = delay / step - whole
    position = np.empty(goal.size)
    for k in range(goal.size):
        position[k] = phi
        target = (1 - part) * goal[max(k - whole, 0)] + part * goal[max(k - whole - 1, 0)]
        for _ in range(2):
            drive = 0.0
            if enabled[k] > 0:
                duty = min(max(gain * error_gain * (target - phi), limit - 1.0), 1.0 - limit)
                drive = constant * (VOLTAGE * duty) / resistance - constant * constant * w / resistance
            gravity = -weight * np.sin(phi - offset)
            through = abs(drive - gravity)
            friction = coulomb + stribeck * np.exp(-abs(w) / slip) + load * through + viscous * abs(w)
            if drive * w < 0 or (w == 0.0 and abs(gravity) > abs(drive)):
                friction += driven * through
            free = w + h * (drive + gravity) / inertia
            w = np.sign(free) * max(abs(free) - h * friction / inertia, 0.0)
            phi += h * w
    return position


def positions(conditions, rig):
    """Return the position over time of each recording of a rig."""
    neutral = {"stribeck": {"speed": 1.0}}
    names = [(effect, name) for effect, kind in effects.items() for name in kind.parameters]
    parameters = np.array([(neutral | rig).get(effect, {}).get(name, 0.0) for effect, name in names])
    return [
        simulate_position(
            one.goal, one.enabled, one.position[0], one.speed[0], one.step, one.gain, parameters
        )
        for one in conditions
    ]


def summarise(position):
    """Return the cells of a recording: means of the position over 0.1 s, 20 samples."""
    return position[:1200].reshape(60, 20).mean(axis=1)


class Servo:
    """The simulator, as the engine takes it."""

    effects = effects
    floors = np.full(60, 3 * 2 * np.pi / 4096)  # three steps of the encoder are no difference that matters
    blocks = np.zeros(60, dtype=np.int64)  # all cells are of one quantity

    def simulate(self, conditions, rigs):
        """Return the cells of each recording of each rig."""
        return np.array([[summarise(one) for one in positions(conditions, rig)] for rig in rigs])


# %%
# What is missing
# ---------------

session = Session(Servo(), fitted, np.array([summarise(one.position) for one in fitted]))
answer = explain(session)
print(answer)

# %%
# Position of the recordings held out
# -----------------------------------

alone = fit_sizes(session, ["motor"])
rigs = {"without friction": make_rig(alone.axes, alone.x), "with the named effects": answer.rig}
unit = "mean absolute, mrad"


def errors(conditions, rig):
    """Return the mean absolute error of the position in mrad."""
    pairs = zip(positions(conditions, rig), conditions, strict=True)
    return [1e3 * float(np.mean([np.abs(simulated - one.position).mean() for simulated, one in pairs]))]


for name, rig in rigs.items():
    print(f"{name}: {errors(held_out, rig)[0]:.1f} mrad held out")

figure, (over_time, missing) = plt.subplots(1, 2, figsize=(10.0, 3.6), layout="constrained")
one = held_out[0]
time = one.step * np.arange(one.position.size)
over_time.plot(time, one.position, "k", lw=2.5, label="measured")
for name, rig in rigs.items():
    over_time.plot(time, positions([one], rig)[0], label=f"simulated {name}")
over_time.set(xlabel="time (s)", ylabel="position (rad)", title="A recording held out")
over_time.legend(loc="lower left", fontsize="small")
mark_states(missing, answer.probabilities)
figure.savefig(Path(__file__).parents[2] / "docs" / "figures" / "gap_servo.png", dpi=100)

# %%
# Held out, the error is that of a fit of the full family of frictions, 38 mrad.

assert answer.state("driven_load_friction") == "missing"
assert max(answer.probabilities["viscous"], answer.probabilities["coulomb"]) > 0.5
assert answer.probabilities["stribeck"] < 0.05
assert errors(held_out, answer.rig)[0] < 45
