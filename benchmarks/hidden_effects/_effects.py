"""Recordings of the rig with nuisance and effects, independent of the simulator's code."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, resample_poly, sosfilt

from benchmarks.hidden_effects._machine import RAMP_TIME, SAMPLING_RATE, Machine, run, times

Float = NDArray[np.float64]
Random = np.random.Generator
Theta = Mapping[str, float]
Hidden = Sequence[tuple[str, Theta]]

PIN_RMS, SPEED_SPREAD, LOAD_SPREAD = 5e-6, 0.003, 0.005
FLOOR_NOISE, FLOOR_DRIFT, FLOOR_CUTOFF = 0.02, 0.05, 1.5  # Nm rms, Nm rms, Hz
_PIN_CIRCLE = 64e-3
_REDUCTION = 15
_ALL_TIME = 60.0
_SPARE = 512  # samples beyond the record, for a fast clock
_BLOW = 2e-3  # s
_BEARING_ORDER = 3.57  # balls that pass a point of the outer race, per turn


@dataclass(frozen=True)
class Condition:
    """Set-points: speed of the input in RPM, load in Nm, direction of rotation (1 or -1)."""

    speed_rpm: float = 500.0
    load_nm: float = 22.0
    direction: int = 1


@dataclass(frozen=True)
class Nuisance:
    """Differences between two recordings that are not an effect."""

    start_angle: float
    first_lobe: int
    wheels: tuple[int, ...]
    speed: float  # relative deviations
    load: float
    pins: NDArray[np.complex128]

    def machine(self, count: int, condition: Condition) -> Machine:
        """The gearbox of a recording with ``count`` worn lobes."""
        worn = np.zeros((2, 15), dtype=np.int64)
        for wheel in self.wheels:
            worn[wheel, (self.first_lobe + np.arange(count)) % 15] = 1
        return Machine(
            speed=condition.speed_rpm * math.pi / 30 * (1 + self.speed),
            load=condition.load_nm * (1 + self.load),
            worn=worn,
            pins=self.pins,
        )


def draw_nuisance(random: Random, decoy: str = "", common: Sequence[float] = ()) -> Nuisance:
    """One recording's nuisance under the prior.

    Start angle uniform over an output turn, first worn lobe uniform, wear on wheel 0 or on both with equal
    chance, speed within 0.3 %, load within 0.5 %, pins displaced by 5 um rms in each direction.

    ``decoy`` moves a recording to an edge of that prior: ``"edges"`` puts speed and load at either end,
    ``"speed"``, ``"load"`` and ``"both"`` all recordings of a set at the same end, ``"assembly"`` gives them
    the same pins, ``"disc"`` the wear on one wheel only, always at the same lobe. ``common`` holds the
    numbers (0 to 1) that all recordings of a set share.
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


def _pin_errors(m: Machine, p: Theta, random: Random) -> Machine:
    return m.with_(pins=m.pins + p["rms"] * (random.normal(size=16) + 1j * random.normal(size=16)))


def _lobe_pitch_errors(m: Machine, p: Theta, random: Random) -> Machine:
    return m.with_(pitch=m.pitch + p["rms"] / _PIN_CIRCLE * random.normal(size=(2, 15)))


def _run_out(m: Machine, p: Theta, random: Random) -> Machine:
    return m.with_(runouts=m.runouts + p["runout"] * np.exp(2j * np.pi * random.random(2)))


def _cam_run_out(m: Machine, p: Theta, random: Random) -> Machine:
    return m.with_(cams=m.cams + p["runout"] * np.exp(2j * np.pi * random.random(2)))


_MACHINE: dict[str, Callable[[Machine, Theta, Random], Machine]] = {
    "pin_errors": _pin_errors,
    "lobe_pitch_errors": _lobe_pitch_errors,
    "run_out": _run_out,
    "cam_run_out": _cam_run_out,
    "clearance": lambda m, p, _: m.with_(clearance=m.clearance + p["clearance"]),
    "contact_stiffness_scale": lambda m, p, _: m.with_(stiffness=m.stiffness * p["factor"]),
    "contact_damping_scale": lambda m, p, _: m.with_(damping=m.damping * p["factor"]),
    "contact_damping_form": lambda m, p, _: m.with_(hunt_crossley=True, damping=m.damping * p["factor"]),
    "load_scale": lambda m, p, _: m.with_(load=m.load * p["factor"]),
    "speed_scale": lambda m, p, _: m.with_(speed=m.speed * p["factor"]),
    "sleeve_friction": lambda m, p, _: m.with_(sleeve_friction=m.sleeve_friction + p["coulomb"]),
    "bearing_friction": lambda m, p, _: m.with_(bearing=m.bearing + p["coulomb"]),
    "brake_rotor": lambda m, p, _: m.with_(rotor=(p["inertia"], p["stiffness"], p["damping_ratio"])),
    "second_torsional_mode": lambda m, p, _: m.with_(
        rotor=(p["inertia"], p["stiffness"], p["damping_ratio"]),
        second_rotor=(p["second_inertia"], p["second_stiffness"], p["damping_ratio"]),
    ),
}


# Effects on load (Nm) or speed (share): machine, parameters, times from rest in s, start angle, random
# numbers.


def slow_process(random: Random, rms: float, cutoff: float, time: Float) -> Float:
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


def _load_drift(m: Machine, p: Theta, time: Float, start: float, random: Random) -> Float:
    return slow_process(random, p["rms_nm"], p["cutoff_hz"], time)


def _proportional_drift(m: Machine, p: Theta, time: Float, start: float, random: Random) -> Float:
    logarithm = slow_process(random, p["relative"], p["cutoff_hz"], time)
    return m.load * np.expm1(logarithm - p["relative"] ** 2 / 2)


def _stick_slip(m: Machine, p: Theta, time: Float, start: float, random: Random) -> Float:
    """Climb for nine tenths of each cycle, fall for one; long cycles climb higher."""
    cycles = random.uniform(0.75, 1.25, math.ceil(2 * time[-1] * p["frequency_hz"]) + 3)
    begins = (np.cumsum(cycles) - cycles - random.random() * cycles[0]) / p["frequency_hz"]
    peaks = begins + 0.9 * cycles / p["frequency_hz"]
    knots = np.stack([begins, peaks], axis=1).ravel()
    heights = np.stack([np.zeros(cycles.size), cycles], axis=1).ravel() - 0.5
    return p["amplitude_nm"] * np.interp(time, knots, heights)


def _blows(time: Float, at: Float, heights: Float) -> Float:
    """Triangular blows that begin at increasing times."""
    found = np.zeros(time.size)
    for begin, height in zip(at, heights, strict=True):
        first, last = np.searchsorted(time, (begin, begin + _BLOW))
        since = (time[first:last] - begin) / _BLOW
        found[first:last] += height * (1 - np.abs(2 * since - 1))
    return found


def _rattle(m: Machine, p: Theta, time: Float, start: float, random: Random) -> Float:
    """Blows of either sign in turn, with exponential heights and pauses."""
    n = math.ceil(time[-1] * p["rate_hz"] * 2) + 40
    pauses, heights = random.exponential(size=(2, n))
    at = np.cumsum(pauses / p["rate_hz"] + _BLOW) - _BLOW
    return _blows(time, at, p["blow_nm"] * heights * (-1.0) ** np.arange(n))


def _load_warm_up(m: Machine, p: Theta, time: Float, start: float, random: Random) -> Float:
    return p["size_nm"] * np.exp(-time / p["time_constant_s"])


def _passages(m: Machine, time: Float, start: float, period: float) -> Float:
    """Times at which the input's angle passes multiples of a period in rad, after the start from rest."""
    first = math.ceil((start + m.speed * RAMP_TIME / 2) / period)
    last = math.floor((start + m.speed * (time[-1] - RAMP_TIME / 2)) / period)
    return RAMP_TIME / 2 + (np.arange(first, last + 1) * period - start) / m.speed


def _broken_tooth(m: Machine, p: Theta, time: Float, start: float, random: Random) -> Float:
    at = _passages(m, time, start, 30 * math.pi)
    return _blows(time, at, np.full(at.size, p["blow_nm"]))


def _bearing_defect(m: Machine, p: Theta, time: Float, start: float, random: Random) -> Float:
    at = _passages(m, time, start, 2 * math.pi / _BEARING_ORDER)
    at = np.sort(at + 0.01 * (2 * math.pi / m.speed) * random.normal(size=at.size))  # balls slip
    return _blows(time, at, p["blow_nm"] * random.uniform(0.5, 1.5, at.size))


def _motor_cogging(m: Machine, p: Theta, time: Float, start: float, random: Random) -> Float:
    return p["relative"] * np.sin(4 * m.speed * time + 2 * np.pi * random.random())


_Course = Callable[[Machine, Theta, Float, float, Random], Float]
_LOAD: dict[str, _Course] = {
    "load_drift": _load_drift,
    "proportional_drift": _proportional_drift,
    "stick_slip": _stick_slip,
    "rattle": _rattle,
    "load_warm_up": _load_warm_up,
    "broken_tooth": _broken_tooth,
    "bearing_defect": _bearing_defect,
}
_SPEED: dict[str, _Course] = {
    "speed_wander": lambda m, p, time, start, random: slow_process(random, p["rms"], p["cutoff_hz"], time),
    "motor_cogging": _motor_cogging,
}


# Effects on the signal.


@dataclass(frozen=True)
class Run:
    """Torque of a machine from rest and its input angle, at 25.6 kHz; the record begins at a sample."""

    torque: Float
    angle: Float
    begin: int
    load: float  # set-point, negative in reverse
    torque_in: Float = field(default_factory=lambda: np.zeros(0))

    @property
    def time(self) -> Float:
        """Time from the record's first sample in s."""
        return (np.arange(self.torque.size) - self.begin) / SAMPLING_RATE


def _low_pass(x: Float, run: Run, p: Theta, random: Random) -> Float:
    return np.asarray(sosfilt(butter(2, p["cutoff_hz"], fs=SAMPLING_RATE, output="sos"), x))


def _sensor_warm_up(x: Float, run: Run, p: Theta, random: Random) -> Float:
    return x + p["size_nm"] * np.exp(-np.maximum(run.time, 0) / p["time_constant_s"])


def _sensor_drift(x: Float, run: Run, p: Theta, random: Random) -> Float:
    return x + slow_process(random, p["rms_nm"], p["cutoff_hz"], run.time - run.time[0])


def _wave(angle: Float, p: Theta, random: Random) -> Float:
    return p["amplitude_nm"] * np.sin(angle + 2 * np.pi * random.random())


def _clock_error(x: Float, run: Run, p: Theta, random: Random) -> Float:
    # Oversample by eight first: a spline is then accurate to 1e-4 at the highest frequencies.
    fine = resample_poly(x - run.load, 8, 1) + run.load
    instants = np.arange(math.floor((x.size - 1) * min(1, 1 + p["relative"]))) / (1 + p["relative"])
    return np.asarray(CubicSpline(np.arange(fine.size) / 8, fine)(instants))


def _lost_samples(x: Float, run: Run, p: Theta, random: Random) -> Float:
    """Repeat the last value for one block at a random place of each stretch."""
    x, block = x.copy(), round(p["block"])
    stretch = block / p["share"]
    for k in range(math.ceil(x.size / stretch)):
        first = max(int(stretch * (k + (1 - p["share"]) * random.random())), 1)
        if first < x.size:
            x[first : first + block] = x[first - 1]
    return x


@njit(cache=True)
def _play(x, half):
    y = x.copy()
    for i in range(1, x.size):
        y[i] = min(max(y[i - 1], x[i] - half), x[i] + half)
    return y


def _hysteresis(x: Float, run: Run, p: Theta, random: Random) -> Float:
    """Dry friction in the meter: its reading follows once the torque has moved by the width."""
    return np.asarray(_play(np.asarray(x), p["width_nm"] / 2))


def _automatic_gain(x: Float, run: Run, p: Theta, random: Random) -> Float:
    """Reduce the alternating part by a gain that falls with its rectified, smoothed size (an amplifier)."""
    decay = math.exp(-1 / (p["time_constant_s"] * SAMPLING_RATE))
    rest = lfilter([1 - decay], [1, -decay], x - run.load)
    ripple = x - run.load - rest
    size = lfilter([1 - decay], [1, -decay], np.abs(ripple))
    return run.load + rest + ripple * (p["level_nm"] / (p["level_nm"] + size))


def _tachometer_edges(x: Float, run: Run, p: Theta, random: Random) -> Float:
    """Add the tachometer's square wave through a capacitance: a short pulse at each edge."""
    square = np.sign(np.sin(4 * run.angle + 2 * np.pi * random.random()))
    decay = math.exp(-1 / (3e-4 * SAMPLING_RATE))
    return x + p["amplitude_nm"] / 2 * lfilter([1, -1], [1, -decay], square)


def _supply_modulation(x: Float, run: Run, p: Theta, random: Random) -> Float:
    """A bridge whose supply pulsates at a frequency that belongs to nothing else."""
    angle = 2 * np.pi * (p["frequency_hz"] * run.time + random.random())
    return x * (1 + p["share"] * np.sin(angle))


def _starts(x: Float, per_second: float, random: Random) -> Iterator[int]:
    n = random.poisson(per_second * x.size / SAMPLING_RATE)
    yield from np.sort(random.integers(0, x.size, n)).tolist()


def _dropout(x: Float, run: Run, p: Theta, random: Random) -> Float:
    """A loose plug: the signal falls to zero and comes back ringing."""
    x, n = x.copy(), round(p["length_s"] * SAMPLING_RATE)
    time = np.arange(round(0.05 * SAMPLING_RATE)) / SAMPLING_RATE
    ringing = np.exp(-time / 0.01) * np.cos(2 * np.pi * 200 * time)
    for start in _starts(x, p["per_second"], random):
        after = x[start + n : start + n + time.size]
        after *= 1 - ringing[: after.size]
        x[start : start + n] = 0.0
    return x


def _noise_bursts(x: Float, run: Run, p: Theta, random: Random) -> Float:
    x, n = x.copy(), round(0.05 * SAMPLING_RATE)
    for start in _starts(x, p["per_second"], random):
        burst = x[start : start + n]
        burst += p["rms_nm"] * random.normal(size=burst.size)
    return x


def _spikes(x: Float, run: Run, p: Theta, random: Random) -> Float:
    x = x.copy()
    for start in _starts(x, p["per_second"], random):
        x[start] += p["height_nm"] * random.choice((-1, 1))
    return x


# By place in the chain: within a place in the order of the table.
_SIGNAL: dict[str, tuple[int, Callable[[Float, Run, Theta, Random], Float]]] = {
    "torque_meter_low_pass": (5, _low_pass),
    "hysteresis": (5, _hysteresis),
    "sensor_warm_up": (6, _sensor_warm_up),
    "sensor_drift": (6, _sensor_drift),
    "gain": (6, lambda x, run, p, random: p["factor"] * x),
    "offset": (6, lambda x, run, p, random: x + p["offset_nm"]),
    "noise": (6, lambda x, run, p, random: x + random.normal(0, p["rms_nm"], x.size)),
    "hum": (6, lambda x, run, p, random: x + _wave(100 * np.pi * run.time, p, random)),
    "input_shaft_line": (6, lambda x, run, p, random: x + _wave(run.angle, p, random)),
    "output_shaft_line": (6, lambda x, run, p, random: x + _wave(run.angle / 15, p, random)),
    "automatic_gain": (6, _automatic_gain),
    "tachometer_edges": (6, _tachometer_edges),
    "supply_modulation": (6, _supply_modulation),
    "inverter_tone": (
        6,
        lambda x, run, p, random: x + _wave(2 * np.pi * p["frequency_hz"] * run.time, p, random),
    ),
    "dropout": (6, _dropout),
    "noise_bursts": (6, _noise_bursts),
    "clock_error": (7, _clock_error),
    "quantisation": (8, lambda x, run, p, random: p["lsb_nm"] * np.rint(x / p["lsb_nm"])),
    "clipping": (8, lambda x, run, p, random: np.clip(x, -p["limit_nm"], p["limit_nm"])),
    "lost_samples": (8, _lost_samples),
    "spikes": (8, _spikes),
}
_STEPS = {name: step for step, name in enumerate(sorted(_SIGNAL, key=lambda name: _SIGNAL[name][0]))}
EFFECTS = (*_MACHINE, *_LOAD, *_SPEED, *_SIGNAL)


def on_signal(name: str) -> bool:
    """Return True if an effect changes the torque signal alone."""
    return name in _SIGNAL


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


def run_machine(
    count: int,
    condition: Condition,
    effects: Hidden,
    seed: np.random.SeedSequence,
    nuisance: Nuisance,
    n_samples: int,
) -> Run:
    """Run the machine with ``count`` worn lobes, the effects in it and the floor's drift of the load.

    Effects on the signal are left out, except that an amplifier's slow gain has to settle too.
    """
    machine = nuisance.machine(count, condition)
    of_drift, *streams = (np.random.default_rng(one) for one in seed.spawn(1 + len(effects)))
    for (name, theta), random in zip(effects, streams, strict=True):
        if name in _MACHINE:
            machine = _MACHINE[name](machine, theta, random)
    slow = max((theta["time_constant_s"] for name, theta in effects if name == "automatic_gain"), default=0.0)
    begin = math.ceil((settling(machine) + 15 * slow) * SAMPLING_RATE)
    n_total = begin + n_samples + _SPARE
    time = times(n_total)
    load: Float = slow_process(of_drift, FLOOR_DRIFT, FLOOR_CUTOFF, time)
    speed: Float | float = 0.0
    for (name, theta), random in zip(effects, streams, strict=True):
        if name in _LOAD:
            load = load + _LOAD[name](machine, theta, time, nuisance.start_angle, random)
        elif name in _SPEED:
            course = _SPEED[name](machine, theta, time, nuisance.start_angle, random)
            speed = speed + machine.speed * course
    torque, torque_in, angle = run(machine, n_total, nuisance.start_angle, load, speed)
    # In reverse the gearbox's mirror image runs.
    way = condition.direction
    return Run(way * torque, angle, begin, way * condition.load_nm, way * torque_in)


def record(
    made: Run, effects: Hidden, seed: np.random.SeedSequence, n_samples: int, *, at_input: bool = False
) -> NDArray[np.float32]:
    """Torque in Nm as measured: a machine's run with the effects on the signal and the floor's noise.

    A meter on the input has a smaller range: all that it adds is a fifteenth.
    """
    scale = _REDUCTION if at_input else 1
    of_noise, *streams = (np.random.default_rng(one) for one in seed.spawn(1 + len(effects)))
    chain = [(_STEPS[name], theta, random, _SIGNAL[name][1])
             for (name, theta), random in zip(effects, streams, strict=True) if name in _SIGNAL]  # fmt: skip
    chain.append((_STEPS["noise"], {"rms_nm": FLOOR_NOISE}, of_noise, _SIGNAL["noise"][1]))
    torque = made.torque_in * scale if at_input else made.torque
    for _, theta, random, change in sorted(chain, key=lambda step: step[0]):
        torque = change(torque, made, theta, random)
    return np.asarray(torque[made.begin : made.begin + n_samples] / scale, dtype=np.float32)


def nuisance_and_seed(seed: Any, **decoy: Any) -> tuple[Nuisance, np.random.SeedSequence]:
    """Nuisance of a recording, and the seed of its effects, from the recording's own seed."""
    of_nuisance, of_effects = np.random.SeedSequence(seed).spawn(2)
    return draw_nuisance(np.random.default_rng(of_nuisance), **decoy), of_effects
