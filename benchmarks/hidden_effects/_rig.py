"""Recordings of the rig with nuisance and effects, independent of the simulator's code."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, resample_poly, sosfilt

from benchmarks.hidden_effects._machine import RAMP_TIME, SAMPLING_RATE, Machine, run, times

Float = NDArray[np.float64]
Theta = Mapping[str, float]

N_SAMPLES = 46_080  # 1.8 s: one turn of the output
INPUT_SPEED = 500 / 60 * 2 * math.pi
LOAD = 22.0
PIN_RMS, SPEED_SPREAD, LOAD_SPREAD = 5e-6, 0.003, 0.005
_PIN_CIRCLE = 64e-3
_ALL_TIME = 60.0


@dataclass(frozen=True)
class Nuisance:
    """Nuisance: differences between two recordings that are not an effect."""

    start_angle: float
    first_lobe: int
    wheels: tuple[int, ...]
    speed: float  # relative deviations
    load: float
    pins: NDArray[np.complex128]

    def machine(self, count: int) -> Machine:
        """The gearbox of a recording with ``count`` worn lobes."""
        worn = np.zeros((2, 15), dtype=np.int64)
        for wheel in self.wheels:
            worn[wheel, (self.first_lobe + np.arange(count)) % 15] = 1
        return Machine(
            speed=INPUT_SPEED * (1 + self.speed), load=LOAD * (1 + self.load), worn=worn, pins=self.pins
        )


def draw_nuisance(random: np.random.Generator, decoy: str = "", common: Sequence[float] = ()) -> Nuisance:
    """One recording's nuisance under the prior.

    Start angle uniform over an output turn, first worn lobe uniform, wear on wheel 0 or on both with equal
    chance, speed within 0.3 %, load within 0.5 %, pins displaced by 5 um rms in each direction.

    ``decoy`` moves a recording to an edge of that prior: ``"edges"`` puts speed and load at either end,
    ``"speed"``, ``"load"`` and ``"both"`` all recordings of a case at the same end, ``"assembly"`` gives them
    the same pins, ``"disc"`` the wear on one wheel only, always at the same lobe. ``common`` holds the
    numbers (0 to 1) that all recordings of a case share.
    """
    start = random.uniform(0, 30 * np.pi)
    first = int(random.integers(15))
    wheels = (0,) if random.random() < 0.5 else (0, 1)
    speed, load = random.uniform(-1, 1, 2)
    pins = PIN_RMS * (random.normal(size=16) + 1j * random.normal(size=16))
    if decoy == "edges":
        speed, load = math.copysign(1, speed), math.copysign(1, load)
    if decoy in ("speed", "both"):
        speed = 1.0 if common[0] < 0.5 else -1.0
    if decoy in ("load", "both"):
        load = 1.0 if common[1] < 0.5 else -1.0
    if decoy == "assembly":
        shared = np.random.default_rng(int(common[2] * 2**53))
        pins = PIN_RMS * (shared.normal(size=16) + 1j * shared.normal(size=16))
    if decoy == "disc":
        first, wheels = int(15 * common[3]), (0,)
    return Nuisance(start, first, wheels, SPEED_SPREAD * speed, LOAD_SPREAD * load, pins)


# Effects in the machine: machine, parameters, random numbers.


def _pin_errors(m: Machine, p: Theta, random: np.random.Generator) -> Machine:
    return m.with_(pins=m.pins + p["rms"] * (random.normal(size=16) + 1j * random.normal(size=16)))


def _lobe_pitch_errors(m: Machine, p: Theta, random: np.random.Generator) -> Machine:
    return m.with_(pitch=m.pitch + p["rms"] / _PIN_CIRCLE * random.normal(size=(2, 15)))


def _run_out(m: Machine, p: Theta, random: np.random.Generator) -> Machine:
    return m.with_(runouts=m.runouts + p["runout"] * np.exp(2j * np.pi * random.random(2)))


def _cam_run_out(m: Machine, p: Theta, random: np.random.Generator) -> Machine:
    return m.with_(cams=m.cams + p["runout"] * np.exp(2j * np.pi * random.random(2)))


_MACHINE: dict[str, Callable[[Machine, Theta, np.random.Generator], Machine]] = {
    "pin_errors": _pin_errors,
    "lobe_pitch_errors": _lobe_pitch_errors,
    "run_out": _run_out,
    "cam_run_out": _cam_run_out,
    "clearance": lambda m, p, _: m.with_(clearance=m.clearance + p["clearance"]),
    "contact_stiffness_scale": lambda m, p, _: m.with_(stiffness=m.stiffness * p["factor"]),
    "contact_damping_scale": lambda m, p, _: m.with_(damping=m.damping * p["factor"]),
    "contact_damping_form": lambda m, p, _: m.with_(hunt_crossley=True, damping=m.damping * p["factor"]),
    "sleeve_friction": lambda m, p, _: m.with_(sleeve_friction=m.sleeve_friction + p["coulomb"]),
    "bearing_friction": lambda m, p, _: m.with_(bearing=m.bearing + p["coulomb"]),
    "brake_rotor": lambda m, p, _: m.with_(rotor=(p["inertia"], p["stiffness"], p["damping_ratio"])),
    "stick_slip_brake": lambda m, p, _: m.with_(
        rotor=(p["inertia"], p["stiffness"], p["damping_ratio"]),
        stribeck=(p["rise"], p["fall_speed"]),
    ),
    "second_torsional_mode": lambda m, p, _: m.with_(
        rotor=(p["inertia"], p["stiffness"], p["damping_ratio"]),
        second_rotor=(p["second_inertia"], p["second_stiffness"], p["damping_ratio"]),
    ),
    "coupling_rattle": lambda m, p, _: m.with_(
        loose=(p["inertia"], p["stiffness"], p["damping"], p["play"], p["drag_nm"])
    ),
}


# Effects on load and speed: parameters, times, random numbers.


def slow_process(random: np.random.Generator, rms: float, cutoff: float, time: Float) -> Float:
    """Gaussian noise of one-sided density rms^2 / B / (1 + (f / cutoff)^4), B = cutoff (pi/4) / sin(pi/4).

    It is generated line by line in the frequency domain, with a period longer than a record.
    """
    period = max(_ALL_TIME, 40 / cutoff)
    rate = max(200 * cutoff, 20.0)
    n = 2 ** math.ceil(math.log2(period * rate))
    lines = np.fft.rfftfreq(n, 1 / rate)
    width = cutoff * (math.pi / 4) / math.sin(math.pi / 4)
    variance = rms**2 / width / (1 + (lines / cutoff) ** 4) * (rate / n)
    variance[0] /= 2  # half a line's width lies at positive frequencies
    spectrum = np.sqrt(variance / 2) * (random.normal(size=lines.size) + 1j * random.normal(size=lines.size))
    spectrum[0] = math.sqrt(variance[0]) * random.normal()
    spectrum[-1] = 0
    scale = np.full(lines.size, n / 2)
    scale[0] = n
    values = np.fft.irfft(spectrum * scale * math.sqrt(2) / np.where(lines == 0, math.sqrt(2), 1.0), n)
    return np.interp(time, np.arange(n) / rate, values)


def _thermal_decay(p: Theta, time: Float, begin: float) -> Float:
    since = np.maximum(time - begin, 0.0)
    return LOAD * p["share"] * np.exp(-since / p["time_constant_s"])


# Effects on the signal: torque and input angle of the whole run, parameters, random numbers.


def _low_pass(x: Float, phi: Float, p: Theta, random: np.random.Generator) -> Float:
    return np.asarray(sosfilt(butter(2, p["cutoff_hz"], fs=SAMPLING_RATE, output="sos"), x))


def _sensor_drift(x: Float, phi: Float, p: Theta, random: np.random.Generator) -> Float:
    return x + slow_process(random, p["rms_nm"], p["cutoff_hz"], np.arange(x.size) / SAMPLING_RATE)


def _noise(x: Float, phi: Float, p: Theta, random: np.random.Generator) -> Float:
    return x + random.normal(0, p["rms_nm"], x.size)


def _hum(x: Float, phi: Float, p: Theta, random: np.random.Generator) -> Float:
    angle = 2 * np.pi * (50.0 * np.arange(x.size) / SAMPLING_RATE + random.random())
    return x + p["amplitude_nm"] * np.sin(angle)


def _clock_error(x: Float, phi: Float, p: Theta, random: np.random.Generator) -> Float:
    # Oversample by eight first: a spline is then accurate to 1e-4 at the highest frequencies.
    fine = resample_poly(x - LOAD, 8, 1) + LOAD
    instants = np.arange(math.floor((x.size - 1) * min(1, 1 + p["relative"]))) / (1 + p["relative"])
    return np.asarray(CubicSpline(np.arange(fine.size) / 8, fine)(instants))


def _clipping(x: Float, phi: Float, p: Theta, random: np.random.Generator) -> Float:
    return np.clip(x, LOAD - p["reach_nm"], LOAD + p["reach_nm"])


def _dropped_samples(x: Float, phi: Float, p: Theta, random: np.random.Generator) -> Float:
    """Repeat the last value while the data transfer stalls."""
    x = x.copy()
    n = random.poisson(p["per_second"] * x.size / SAMPLING_RATE)
    for start in random.integers(1, x.size, n):
        x[start : start + 1 + random.geometric(1 / p["mean_length"])] = x[start - 1]
    return x


def _automatic_gain(x: Float, phi: Float, p: Theta, random: np.random.Generator) -> Float:
    """Reduce the alternating part by a gain that falls with its rectified, smoothed size (an amplifier)."""
    decay = math.exp(-1 / (p["time_constant_s"] * SAMPLING_RATE))
    rest = lfilter([1 - decay], [1, -decay], x - LOAD)
    ripple = x - LOAD - rest
    size = lfilter([1 - decay], [1, -decay], np.abs(ripple))
    return LOAD + rest + ripple * (p["level_nm"] / (p["level_nm"] + size))


def _crosstalk(x: Float, phi: Float, p: Theta, random: np.random.Generator) -> Float:
    """Add the tachometer's square wave through a capacitance: a short pulse at each edge."""
    square = np.sign(np.sin(p["pulses_per_turn"] * phi + 2 * np.pi * random.random()))
    decay = math.exp(-1 / (p["time_constant_s"] * SAMPLING_RATE))
    return x + p["amplitude_nm"] / 2 * lfilter([1, -1], [1, -decay], square)


_SIGNAL: dict[str, tuple[int, Callable[[Float, Float, Theta, np.random.Generator], Float]]] = {
    "torque_meter_low_pass": (5, _low_pass),
    "sensor_drift": (6, _sensor_drift),
    "gain": (6, lambda x, phi, p, random: p["factor"] * x),
    "offset": (6, lambda x, phi, p, random: x + p["offset_nm"]),
    "noise": (6, _noise),
    "hum": (6, _hum),
    "automatic_gain": (6, _automatic_gain),
    "crosstalk": (6, _crosstalk),
    "clipping": (6, _clipping),
    "clock_error": (7, _clock_error),
    "quantisation": (8, lambda x, phi, p, random: p["lsb_nm"] * np.rint(x / p["lsb_nm"])),
    "dropped_samples": (9, _dropped_samples),
}
_DRIVE = ("load_drift", "speed_wander", "thermal_decay")
EFFECTS = (*_MACHINE, *_DRIVE, *_SIGNAL)


def _ring(machine: Machine, arm: float, radius: float, n: int) -> tuple[float, float]:
    """Stiffness and damping about the shaft of one ring of contacts, both wheels, half of it loaded."""
    p = machine.numbers()
    arms = arm * np.sin(np.pi * (np.arange(n // 2) + 0.5) / (n // 2))
    hertz = p[10] * math.sqrt(radius) * np.sum(arms**2.5)
    twist = (machine.load / 2 / hertz) ** (2 / 3)
    per_speed = 2 * 150.0 * machine.damping * float(np.sum(arms**2))
    return 3 * hertz * math.sqrt(twist), per_speed


def settling(machine: Machine) -> float:
    """Time in s from rest until a record may begin: the ramp, and five decay times of the vibration."""
    turn = 2 * math.pi / machine.speed
    inertia, stiffness, ratio = machine.rotor
    if inertia == 0:
        return RAMP_TIME + turn
    if machine.stribeck[0] > 0:
        return RAMP_TIME + 1.5
    pins, holes = _ring(machine, 42e-3, 6e-3, 16), _ring(machine, 36e-3, machine.numbers()[7], 8)
    gear = pins[0] * holes[0] / (pins[0] + holes[0])
    gear_damping = pins[1] * holes[1] / (pins[1] + holes[1])
    share = gear / (gear + stiffness)
    meter_damping = 2 * ratio * math.sqrt(stiffness * inertia)
    decay = 2 * inertia / (meter_damping * share**2 + gear_damping * (1 - share) ** 2)
    second = machine.second_rotor
    if second[0] > 0:
        # Its own decay, and the first rotor's with its inertia added.
        decay = decay * (inertia + second[0]) / inertia + math.sqrt(second[0] / second[1]) / ratio
    return RAMP_TIME + max(turn, 5 * decay)


def record(
    count: int,
    effects: Sequence[tuple[str, Theta]],
    seed: np.random.SeedSequence,
    nuisance: Nuisance,
    n_samples: int = N_SAMPLES,
) -> NDArray[np.float32]:
    """Torque in Nm of one recording with ``count`` worn lobes and the effects, in the order of the chain."""
    machine = nuisance.machine(count)
    streams = [np.random.default_rng(one) for one in seed.spawn(len(effects))]
    load: Float | float = 0.0
    speed: Float | float = 0.0
    for (name, theta), random in zip(effects, streams, strict=True):
        if name in _MACHINE:
            machine = _MACHINE[name](machine, theta, random)
    # An amplifier's slow gain also has to settle after the start at rest.
    slow = max((theta["time_constant_s"] for name, theta in effects if name == "automatic_gain"), default=0.0)
    n_settling = math.ceil((settling(machine) + 15 * slow) * SAMPLING_RATE)
    n_more = 256 if any(name == "clock_error" for name, _ in effects) else 0
    n_total = n_settling + n_samples + n_more
    time = times(n_total)
    for (name, theta), random in zip(effects, streams, strict=True):
        if name == "load_drift":
            load = load + slow_process(random, theta["rms_nm"], theta["cutoff_hz"], time)
        elif name == "thermal_decay":
            load = load + _thermal_decay(theta, time, n_settling / SAMPLING_RATE)
        elif name == "speed_wander":
            speed = speed + machine.speed * slow_process(random, theta["rms"], theta["cutoff_hz"], time)
    torque, phi = run(machine, n_total, nuisance.start_angle, load, speed)
    on_signal = sorted(
        (
            (_SIGNAL[name][0], k, theta, random)
            for k, ((name, theta), random) in enumerate(zip(effects, streams, strict=True))
            if name in _SIGNAL
        ),
        key=lambda step: step[:2],
    )
    for _, k, theta, random in on_signal:
        torque = _SIGNAL[effects[k][0]][1](torque, phi, theta, random)
    return np.asarray(torque[n_settling : n_settling + n_samples], dtype=np.float32)


def nuisance_and_seed(seed: Any, **decoy: Any) -> tuple[Nuisance, np.random.SeedSequence]:
    """Nuisance of a recording, and the seed of its effects, from the recording's own seed."""
    of_nuisance, of_effects = np.random.SeedSequence(seed).spawn(2)
    return draw_nuisance(np.random.default_rng(of_nuisance), **decoy), of_effects
