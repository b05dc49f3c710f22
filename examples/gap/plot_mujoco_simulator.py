"""
Use a MuJoCo model as the simulator
===================================

A simulator of your own is a frozen dataclass with one method, which may call any program. Here
`MuJoCo <https://mujoco.org>`_ simulates motor, shaft and brake. The gap workflow then treats it as it treats
the drive of :ref:`sphx_glr_gallery_gap_own_simulator.py`: with effects on sensor and load, and with effects
that change the model, such as a shaft that is softer than stated. It needs ``pip install "mujoco<4"``.
The torque is **surrogate**: simulated, not measured.
"""

import functools
from dataclasses import dataclass, replace

import matplotlib.pyplot as plt
import mujoco
import numpy as np
from mujoco import rollout
from scipy import signal

from cyclofeat.simulators import Drift, Noise, Rig, Simulator

# The brake hangs on the motor: its joint is the shaft, and the joint's angle the shaft's twist.
MODEL = """
<mujoco>
  <option timestep="{step}" gravity="0 0 0" integrator="RK4"/>
  <worldbody>
    <body name="motor">
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 {motor_inertia}"/>
      <joint name="motor" axis="0 0 1" damping="{speed_control}"/>
      <body name="brake">
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 {brake_inertia}"/>
        <joint name="shaft" axis="0 0 1" stiffness="{stiffness}" damping="{damping}"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="drive" joint="motor"/>
    <motor name="load" joint="shaft"/>
  </actuator>
  <sensor>
    <jointpos joint="shaft"/>
    <jointvel joint="shaft"/>
    <jointpos joint="motor"/>
  </sensor>
</mujoco>
"""


@dataclass(frozen=True)
class MujocoDrive(Simulator):
    """Motor with speed control, shaft and brake, seen from the gearbox's output, in SI units."""

    motor_inertia: float = 0.02
    brake_inertia: float = 0.05
    stiffness: float = 3000.0
    damping: float = 0.4
    speed_control: float = 2.0  # Nm per rad/s
    wear: float = 0.2  # Nm per worn lobe, once per turn of the input

    def simulate(self, time, angle, speed, load, gearbox, defects):
        """Return the shaft's torque, and the motor's angle."""
        model = _model(float(time[1]), self)
        lead = round(0.2 / time[1])  # the shaft settles before the record
        speed, load = (np.pad(course, (lead, 0), "reflect") for course in (speed, load))
        angle = np.pad(angle, (lead, 0), "reflect", reflect_type="odd")
        lobes = 2 * np.pi * np.array(defects.worn_lobes) / gearbox.n_lobes
        pushes = self.wear * np.cos(angle[:, None] - lobes).sum(axis=1)
        drive = self.speed_control * speed / gearbox.n_lobes + pushes
        data = mujoco.MjData(model)
        mean = load.mean()
        data.qpos[:] = 0.0, -mean / self.stiffness
        data.qvel[0] = speed[0] / gearbox.n_lobes
        state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        # A torque on the brake acts on both joints, as both turn it; the speed control holds the mean load.
        control = np.column_stack([drive + mean - load, -load])
        control[:-1] = (control[:-1] + control[1:]) / 2  # held over each step
        _, sensors = rollout.rollout(model, data, state[None], control[None])
        twist, rate, turned = sensors[0, lead:].T
        torque = -(self.stiffness * twist + self.damping * rate)
        return torque, angle[lead] + gearbox.n_lobes * (turned - turned[0])


@functools.lru_cache(maxsize=8)
def _model(step, drive):
    numbers = {name: getattr(drive, name) for name in drive.__dataclass_fields__}
    return mujoco.MjModel.from_xml_string(MODEL.format(step=step, **numbers))


# %%
# Records of the model, and of a rig whose shaft has half the stiffness
# ----------------------------------------------------------------------
# The resonance of the shaft moves down by the square root of two.

stiff = MujocoDrive()
drive = Rig(effects=[Drift(0.3, cutoff_hz=150.0), Noise(0.02)], name="drive", simulator=stiff)
soft = drive.replace(simulator=replace(stiff, stiffness=1500.0))

figure, ax = plt.subplots(figsize=(8, 4), layout="constrained")
for rig, label in ((drive, "model"), (soft, "rig with a soft shaft")):
    run = rig.simulate(duration=8.0, sampling_rate=2000.0, random_state=1)
    frequencies, density = signal.welch(run.torque_out, 2000.0, nperseg=2048)
    resonance = np.sqrt(rig.simulator.stiffness * (1 / 0.02 + 1 / 0.05)) / (2 * np.pi)
    (line,) = ax.semilogy(frequencies, density, label=f"{label}, resonance {resonance:.0f} Hz")
    ax.axvline(resonance, color=line.get_color(), linestyle=":")
ax.set(xlabel="frequency in Hz", ylabel="torque in Nm²/Hz", xlim=(0, 200))
ax.legend()
plt.show()
