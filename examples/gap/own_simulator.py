"""
Name what a simulator of your own lacks
=======================================

The gap workflow needs a simulator, not the toolkit's. Here it is a drive of two masses: motor, shaft and
brake. An effect of its own, a shaft softer than stated, joins those of the sensor. The hidden rig, whose
recordings are **surrogates**, has a soft shaft and hum. The posterior learns from simulated drives of the
model, and :func:`cyclofeat.gap.find_gap` names and sizes both, in about a minute on two cores. It needs
``pip install jax optax``.
"""

import dataclasses
import tempfile
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import signal
from scipy.stats import loguniform

from cyclofeat.datasets import make_rig_recordings
from cyclofeat.gap import EffectPosterior, GapSettings, World, find_gap, hold_out, prepare_world
from cyclofeat.simulators import (
    Drift,
    Effect,
    EffectParameter,
    Gain,
    Hum,
    Noise,
    Offset,
    Rig,
    Simulator,
    register_effect,
)


@dataclass(frozen=True)
class TwoMassDrive(Simulator):
    """Motor and brake on a shaft, seen from the gearbox's output, in SI units."""

    motor_inertia: float = 0.02
    brake_inertia: float = 0.05
    stiffness: float = 3000.0
    damping: float = 1.0
    speed_control: float = 5.0  # Nm per rad/s
    ripple: float = 0.05  # Nm, of each of 24 harmonics of the motor's turn
    wear: float = 0.05  # Nm per worn lobe, once per turn of the motor

    def simulate(self, time, angle, speed, load, gearbox, defects):
        """Return the shaft's torque, and the motor's angle."""
        step, z = time[1], gearbox.n_lobes
        lead = round(0.2 / step)  # the shaft settles before the record
        angle = np.pad(angle, (lead, 0), "reflect", reflect_type="odd")
        speed, load = (np.pad(course, (lead, 0), "reflect") for course in (speed, load))
        lobes = 2 * np.pi * np.array(defects.worn_lobes) / z
        harmonics = np.arange(1, 25)
        ripple = self.ripple * np.cos(np.outer(angle, harmonics) + harmonics**2).sum(axis=1)
        ripple += self.wear * np.cos(angle[:, None] - lobes).sum(axis=1)
        # All but the angle as deviations from the set-point.
        inputs = (speed - gearbox.input_speed) / z, ripple, load - gearbox.load_torque
        torque, motor = self._response(inputs, step)
        turned = angle[0] + np.cumsum(gearbox.input_speed + z * motor) * step
        return gearbox.load_torque + torque[lead:], turned[lead:]

    def _response(self, inputs, step):
        """Return the shaft's torque and the motor's speed for speed, ripple and load."""
        j, b, k, c = self.motor_inertia, self.brake_inertia, self.stiffness, self.damping
        g = self.speed_control
        # States: twist of the shaft, speed of the motor, speed of the brake.
        system = signal.StateSpace(
            [[0, 1, -1], [-k / j, -(c + g) / j, c / j], [k / b, c / b, -c / b]],
            [[0, 0, 0], [g / j, 1 / j, 0], [0, 0, -1 / b]],
            [[k, c, -c], [0, 1, 0]],
            np.zeros((2, 3)),
        )
        sampled = system.to_discrete(step, "foh")
        response = 0.0
        for number, course in enumerate(inputs):
            above, below = signal.ss2tf(sampled.A, sampled.B, sampled.C, sampled.D, input=number)
            response = response + np.array([signal.lfilter(one, below, course) for one in above])
        return response


@register_effect
class SoftShaft(Effect):
    """Shaft that is softer than stated, by a factor."""

    parameters: ClassVar = {
        "factor": EffectParameter("1", 0.1, 1.0, neutral=1.0, prior=loguniform(0.3, 0.8), log=True),
    }

    def change_simulator(self, simulator, random):
        """Soften the shaft."""
        return dataclasses.replace(simulator, stiffness=self.factor * simulator.stiffness)


# %%
# Learn what missing effects look like
# ------------------------------------
# In the model, load drift and noise are known. The world considers the soft shaft and three effects of the
# sensor.

model = Rig(effects=[Drift(0.2), Noise(0.1)], name="drive", simulator=TwoMassDrive())
world = World(
    rig=model,
    effects=(SoftShaft(), Gain(), Offset(), Hum()),
    most=2,
    sampling_rate=2000.0,
    speeds_rpm=(480.0, 720.0),
    n_recordings=8,
    n_rigs_per_machine=4,
)
with tempfile.TemporaryDirectory() as folder:
    rigs = prepare_world(world, folder, 240, n_jobs=-1)
posterior = EffectPosterior(n_networks=1, epochs=100).fit(rigs)

# %%
# Name what the recordings have
# -----------------------------
# Intervals are of 90 %; the hidden shaft has half the stiffness, the hum 0.2 Nm.

hidden = model.with_effects(SoftShaft(0.5), Hum(0.2))
recordings = make_rig_recordings(6, (0, 3), rig=hidden, duration=2.0, sampling_rate=2000.0, random_state=1)
fitted, held_out = hold_out(recordings, 0.4, random_state=0)
settings = GapSettings(pictures=False, random_state=0, n_jobs=-1)
result = find_gap(fitted, held_out, posterior=posterior, settings=settings)
for found in result.effects:
    print(f"{found.effect}: {found.probability:.0%}", *found.sizes, sep=", ")
print(f"something left unexplained: {result.remainder.unexplained}")
for proof in result.proof:
    print(f"{proof.condition.text}: {proof.result.grr:.0%} of the gap closed")

# %%
# Both are named, and nothing else; more than half of the gap closes.

assert {effect.effect_id for effect in result.named} == {"soft_shaft", "hum"}
assert not result.remainder.unexplained
assert min(proof.result.grr for proof in result.proof) > 0.5
