"""What simulators of two real measurements lack, named by the engine; writes real_gaps.md.

python -m benchmarks.real_gaps [--servo FOLDER] [--pendulum FOLDER]    # folders with local copies of the data
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from scipy.signal import lfilter, savgol_filter

from benchmarks._markdown import table
from benchmarks._measured_motions import load_double_pendulum, load_servo_pendulum
from cyclofeat.gap.engine.problem import Array, Effect, Parameter, Rig, Session
from cyclofeat.gap.engine.search import Explanation, explain
from cyclofeat.gap.engine.sizes import fit_sizes, make_rig

GRAVITY = 9.81
TITLES = {
    "servo": """A servo swings a pendulum
Twelve recordings explained, the four of gain 400 held out. The model has a motor and no friction at all.
Known from the literature: Coulomb or viscous friction, then friction that grows with the load; Stribeck's
effect alone adds nothing. A fit of the full family leaves 38 mrad held out.
""",
    "pendulum": """A double pendulum with quasi-direct drives
Six recordings explained, two held out; shoulder and elbow. The model is its project's model 1.1, without
friction and motor inertia; model 1.0 states Coulomb friction of 0.16 and 0.12 Nm, motor inertia of
6.29e-5 kg m2 and viscous friction of 0.001 Nm s/rad. That the torque channels lag needs no model: in 10 of
the 11 records of driven joints the measured torque follows the commanded one by 12 to 34 ms.
""",
}
INTRODUCTION = """# What simulators of two real measurements lack
Written by `python -m benchmarks.real_gaps`. Recordings held out take no part in fits, names or choices. An
effect is named if recordings left out of the fit are predicted better with it, by more than their scatter;
*probably missing* means a probability of one half or more, *missing* 0.95.
"""


class ServoRecording(NamedTuple):
    """Condition of a servo recording, its first state, and its measured position."""

    kp: float
    voltage: float
    mass: float
    length: float
    step: float
    goal: Array
    enabled: Array
    position: Array
    speed: Array


@njit(cache=True)
def _servo_position(goal, enabled, start, speed, step, kp, voltage, mass, length, p):  # type: ignore[no-untyped-def]
    (
        kt,
        resistance,
        armature,
        offset,
        coulomb,
        viscous,
        stribeck,
        slip,
        load,
        driven,
        limit,
        heavier,
        delay,
    ) = p
    error_gain = 4096.0 / (2 * np.pi) / (256.0 * 885.0)
    inertia = mass * length**2 * (1 + heavier) + armature
    weight = mass * length * GRAVITY * (1 + heavier)
    h = step / 2
    phi, w = start, speed
    whole = int(delay / step)
    part = delay / step - whole
    out = np.empty(goal.size)
    for k in range(out.size):
        out[k] = phi
        target = (1 - part) * goal[max(k - whole, 0)] + part * goal[max(k - whole - 1, 0)]
        for _ in range(2):
            drive = 0.0
            if enabled[k] > 0:
                u = kp * error_gain * (target - phi)
                u = voltage * min(max(u, limit - 1.0), 1.0 - limit)
                drive = kt * u / resistance - kt * kt * w / resistance
            gravity = -weight * np.sin(phi - offset)
            through = abs(drive - gravity)
            friction = coulomb + stribeck * np.exp(-abs(w) / slip) + load * through + viscous * abs(w)
            if drive * w < 0 or (w == 0.0 and abs(gravity) > abs(drive)):
                friction += driven * through
            free = w + h * (drive + gravity) / inertia
            stop = h * friction / inertia
            w = np.sign(free) * max(abs(free) - stop, 0.0)
            phi += h * w
    return out


class Servo:
    """Servo on a pendulum without friction, and what it may lack; cells: means of the position over 0.1 s."""

    effects: Mapping[str, Effect] = {
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
            {"torque": Parameter("Nm", 0.005, 0.3), "speed": Parameter("rad/s", 0.02, 3)},
            refines=("coulomb",),
        ),
        "load_friction": Effect({"coefficient": Parameter("", 0.02, 0.6)}, refines=("coulomb", "viscous")),
        "driven_load_friction": Effect(
            {"coefficient": Parameter("", 0.02, 0.6)}, refines=("coulomb", "viscous")
        ),
        "drive_limit": Effect({"reduction": Parameter("", 0.03, 0.6)}),
        "mass_error": Effect({"change": Parameter("", -0.2, 0.2, log=False)}),
        "control_delay": Effect({"delay": Parameter("s", 0.002, 0.05)}),
    }
    unit = "mean absolute, mrad"
    cell = 20  # samples
    floors = np.full(60, 2 * np.pi / 4096 * 3)  # three steps of the encoder
    blocks = np.zeros(60, dtype=np.int64)

    def simulate(self, conditions: Sequence[ServoRecording], rigs: Sequence[Rig]) -> Array:
        """Return the cells of each recording of each rig."""
        return np.array([[self.summarise(x) for x in row] for row in self.positions(conditions, rigs)])

    def positions(self, conditions: Sequence[ServoRecording], rigs: Sequence[Rig]) -> list[list[Array]]:
        """Return the position over time of each recording of each rig."""
        neutral = {"motor": {}, "stribeck": {"speed": 1.0}}
        names = [(effect, key) for effect, kind in self.effects.items() for key in kind.parameters]
        rows = []
        for rig in rigs:
            p = np.array([(neutral | rig).get(effect, {}).get(key, 0.0) for effect, key in names])
            rows.append(
                [
                    _servo_position(
                        c.goal,
                        c.enabled,
                        c.position[0],
                        c.speed[0],
                        c.step,
                        c.kp,
                        c.voltage,
                        c.mass,
                        c.length,
                        p,
                    )
                    for c in conditions
                ]
            )
        return rows

    def summarise(self, channels: Array) -> Array:
        """Return means of the position over 0.1 s."""
        cells: Array = channels[: self.floors.size * self.cell].reshape(-1, self.cell).mean(1)
        return cells

    def errors(self, recordings: Sequence[ServoRecording], rig: Rig) -> list[float]:
        """Return the mean absolute error of the position in mrad."""
        rows = zip(self.positions(recordings, [rig])[0], recordings, strict=True)
        return [float(np.mean([np.abs(x - r.position).mean() for x, r in rows]) * 1e3)]


def servo_recordings(folder: Path | None) -> tuple[list[ServoRecording], list[ServoRecording]]:
    """Return the servo's recordings: those to explain, and those held out (`kp` 400)."""
    recordings = [
        ServoRecording(
            100.0 * 2 ** (k // 4), 7.4, 0.49, 0.1, float(np.diff(r["timestamp"].astype(float)).mean()),
            *(r[key].astype(float) for key in ("goal_position", "torque_enable", "position", "speed")),
        )
        for k, r in enumerate(load_servo_pendulum(folder))
    ]  # fmt: skip
    return [r for r in recordings if r.kp != 400], [r for r in recordings if r.kp == 400]


class PendulumRecording(NamedTuple):
    """Measured torque (2, n), that of model 1.1 for the measured motion, and its derivatives by effects."""

    torque: Array
    model: Array
    speed: Array
    direction: Array
    rotor: Array


RATE = 250.0
SMOOTHING = 37  # samples of the polynomial filter of the angles (150 ms; the motion lies below 5 Hz)


def pendulum_recordings(folder: Path | None) -> tuple[list[PendulumRecording], list[PendulumRecording]]:
    """Return the double pendulum's recordings on an even time base: those to explain, and two held out."""
    inertia1, inertia2, mass1, mass2 = (
        0.031887199591513114, 0.05086984812807257, 0.5234602302310271, 0.6255677234174437,
    )  # fmt: skip
    length1, centre1, centre2, gear = 0.2, 0.2, 0.25569305436052964, 6.0
    even = np.arange(0, 9.98, 1 / RATE)
    recordings = []
    for r in load_double_pendulum(folder):
        angle, torque = (
            np.array([np.interp(even, r["time"], r[f"{key}{joint}"]) for joint in (1, 2)])
            for key in ("pos_meas", "tau_meas")
        )
        (q1, q2), (v1, v2), (a1, a2) = (
            savgol_filter(angle, SMOOTHING, 3, deriv=k, delta=1 / RATE, axis=1) for k in range(3)
        )
        coupling, swing = length1 * mass2 * centre2 * np.cos(q2), length1 * mass2 * centre2 * np.sin(q2)
        lower = GRAVITY * mass2 * centre2 * np.sin(q1 + q2)
        shoulder = (inertia1 + mass2 * length1**2 + inertia2 + 2 * coupling) * a1 + (inertia2 + coupling) * a2
        shoulder += -2 * swing * v1 * v2 - swing * v2**2 + lower
        shoulder += GRAVITY * (mass1 * centre1 + mass2 * length1) * np.sin(q1)
        elbow = (inertia2 + coupling) * a1 + inertia2 * a2 + swing * v1**2 + lower
        rotor = np.array([(gear**2 + 1) * a1 - gear * a2, gear**2 * a2 - gear * a1])
        speed = np.array([v1, v2])
        model = np.array([shoulder, elbow])
        recordings.append(PendulumRecording(torque, model, speed, np.arctan(100 * speed), rotor))
    return [r for k, r in enumerate(recordings) if k not in (2, 4)], [recordings[2], recordings[4]]


def _signed(unit: str, size: float) -> Parameter:
    return Parameter(unit, -size, size, log=False)


class Pendulum:
    """Torques of a double pendulum without friction for its measured motion, and what they may lack.

    The cells are means of both torques over 20 ms.
    """

    effects: Mapping[str, Effect] = {
        **{
            f"{name}_{joint}": Effect({key: prior})
            for name, key, prior in (
                ("coulomb", "torque", Parameter("Nm", 0.005, 0.5)),
                ("viscous", "damping", Parameter("Nm s/rad", 0.0005, 0.1)),
                ("gain", "change", _signed("", 0.3)),
                ("offset", "torque", _signed("Nm", 0.2)),
            )
            for joint in ("shoulder", "elbow")
        },
        "motor_inertia": Effect({"inertia": Parameter("kg m2", 3e-6, 3e-4)}),
        "torque_delay": Effect({"delay": Parameter("s", 0.004, 0.03)}),
        "torque_low_pass": Effect({"time_constant": Parameter("s", 0.004, 0.05)}),
    }
    unit = "rms, Nm"
    cell = 5  # samples
    floors = np.full(2 * 499, 0.02)  # Nm
    blocks = np.repeat([0, 1], 499)

    def simulate(self, conditions: Sequence[PendulumRecording], rigs: Sequence[Rig]) -> Array:
        """Return the cells of each recording of each rig."""
        return np.array([[self.summarise(self.torques(one, rig)) for one in conditions] for rig in rigs])

    def torques(self, recording: PendulumRecording, rig: Rig) -> Array:
        """Return the torques of a recording's motion, shape (2, n)."""

        def sizes(effect: str) -> Any:
            names = (f"{effect}_shoulder", f"{effect}_elbow")
            return np.array([[next(iter(rig.get(name, {"": 0.0}).values()))] for name in names])

        torque = recording.model + sizes("coulomb") * recording.direction + sizes("viscous") * recording.speed
        torque += rig.get("motor_inertia", {"inertia": 0.0})["inertia"] * recording.rotor
        torque = torque * (1 + sizes("gain")) + sizes("offset")
        if "torque_low_pass" in rig:
            pole = np.exp(-1 / RATE / rig["torque_low_pass"]["time_constant"])
            torque = lfilter([1 - pole], [1, -pole], torque - torque[:, :1], axis=1) + torque[:, :1]
        if "torque_delay" in rig:
            times = np.arange(torque.shape[1]) / RATE
            torque = np.array([np.interp(times - rig["torque_delay"]["delay"], times, row) for row in torque])
        return torque

    def summarise(self, channels: Array) -> Array:
        """Return means of the torques over 20 ms, shoulder then elbow."""
        cells: Array = channels.reshape(2, -1, self.cell).mean(2).ravel()
        return cells

    def errors(self, recordings: Sequence[PendulumRecording], rig: Rig) -> list[float]:
        """Return the rms error of the torque of shoulder and elbow in Nm."""
        squares = [((self.torques(r, rig) - r.torque) ** 2).mean(1) for r in recordings]
        return [float(value) for value in np.sqrt(np.mean(squares, axis=0))]


def explain_case(case: str, folder: Path | None, random_state: int = 0) -> tuple[Explanation, str]:
    """Return the answer of a case, and its section of the report."""
    problem: Servo | Pendulum = Servo() if case == "servo" else Pendulum()
    fitted, held_out = (servo_recordings if case == "servo" else pendulum_recordings)(folder)
    cells = np.array([problem.summarise(r.position if case == "servo" else r.torque) for r in fitted])
    begin = time.process_time()
    answer = explain(Session(problem, fitted, cells, random_state=random_state))
    seconds = time.process_time() - begin
    start = {name: problem.effects[name] for name in problem.effects if problem.effects[name].always}
    nothing = fit_sizes(Session(problem, fitted, cells), tuple(start))
    errors = [
        (label, *(", ".join(f"{e:.3g}" for e in problem.errors(part, rig)) for part in (fitted, held_out)))
        for label, rig in (
            ("without effects", make_rig(nothing.axes, nothing.x)),
            ("with the named effects", answer.rig),
        )
    ]
    rows = [
        (name.replace("_", " "), f"{p:.3f}", answer.state(name), answer.describe_sizes(name))
        for name, p in sorted(answer.probabilities.items(), key=lambda row: -row[1])
    ]
    ties = [f"One of {' and '.join(sorted(tie)).replace('_', ' ')} is missing." for tie in answer.ties]
    always = [f"Fitted with each set: {answer.describe_sizes(name)}." for name in start]
    first, last = (", ".join(f"{value:.1f}" for value in row) for row in answer.remainder)
    return answer, "\n".join(
        [
            table(["", f"error, fitted ({problem.unit})", "held out"], errors),
            table(["effect", "probability", "state", "size (90 % interval)"], rows),
            f"Order: {', '.join(answer.order).replace('_', ' ') or 'none'}.",
            *ties,
            *always,
            f"Remainder, in smallest differences that matter: {first} without the effects, {last} with them.",
            f"{seconds:.0f} s of a core.\n",
        ]
    )


def main() -> None:
    """Explain both measurements and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    for case in TITLES:
        parser.add_argument(f"--{case}", type=Path, help="folder with a local copy of its data")
    arguments = vars(parser.parse_args())
    sections = [f"## {title}\n{explain_case(case, arguments[case])[1]}" for case, title in TITLES.items()]
    (Path(__file__).parent / "real_gaps.md").write_text("\n".join([INTRODUCTION, *sections]))


if __name__ == "__main__":
    main()
