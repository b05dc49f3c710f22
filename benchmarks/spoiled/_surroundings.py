"""Spoiling by the machine's surroundings, and by mistakes about what was recorded."""

from __future__ import annotations

import numpy as np

from benchmarks.spoiled._kind import Base, added, kind, noisy, per_nm
from cyclofeat.recordings import Recording
from cyclofeat.signal.lobes import lobe_frequency
from cyclofeat.signal.windows import Float

_RESONANCE_HZ = 110.0  # of brake and torque meter, in the middle of the rig's range


def _time(base: Base) -> Float:
    return np.arange(base.recording.n_samples) / base.recording.sampling_rate


def _knocks(base: Base, rate_hz: float, random: np.random.Generator) -> Float:
    """Return blows of height 1 that ring at 300 Hz for 4 ms."""
    since = (_time(base) * rate_hz + random.random()) % 1 / rate_hz
    return np.asarray(np.exp(-since / 0.004) * np.sin(2 * np.pi * 300 * since))


@kind(0.5, 2, 8)
def hum(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """Mains hum of 50 Hz with this amplitude in Nm and 20 harmonics."""
    wave = sum(
        np.sin(2 * np.pi * 50 * k * _time(base) + random.uniform(0, 2 * np.pi)) / k for k in range(1, 22)
    )
    return added(base, strength * np.asarray(wave))


@kind(0.5, 2, 8)
def mains_beat(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """A line of 50 Hz and one of a motor with slip, each of this amplitude in Nm, beat."""
    time, phase = _time(base), random.uniform(0, 2 * np.pi)
    slipping = 50 * (1 - random.uniform(0.01, 0.05))
    return added(
        base, strength * (np.sin(2 * np.pi * 50 * time) + np.sin(2 * np.pi * slipping * time + phase))
    )


@kind(1, 4, 16)
def noise(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """White noise of this standard deviation in Nm."""
    return added(base, random.normal(0, strength, base.recording.n_samples))


@kind(1, 4, 16)
def knocks_of_a_press(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """A machine nearby knocks 0.3 to 3 times a turn of the input, with this amplitude in Nm."""
    assert base.recording.input_speed_hz is not None
    rate = base.recording.input_speed_hz * np.exp(random.uniform(np.log(0.3), np.log(3)))
    return added(base, strength * _knocks(base, float(rate), random))


@kind(1, 4, 16)
def knocks_at_the_lobe_rate(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """A neighbour knocks as often as one lobe passes, up to 0.5 % beside, with this amplitude in Nm."""
    assert base.recording.input_speed_hz is not None
    rate = lobe_frequency(base.recording.input_speed_hz) * (1 + random.uniform(-0.005, 0.005))
    return added(base, strength * _knocks(base, float(rate), random))


@kind(1, 4, 16)
def vibration(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """A line near the resonance of brake and meter, of this amplitude in Nm."""
    frequency = _RESONANCE_HZ * random.uniform(0.9, 1.1)
    return added(base, strength * np.sin(2 * np.pi * frequency * _time(base) + random.uniform(0, 2 * np.pi)))


@kind(1, 4, 16)
def crosstalk_of_speed(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The first eight orders of the input shaft leak into the signal, the first of this amplitude in Nm."""
    angle = base.recording.angle
    assert angle is not None
    waves = sum(np.sin(k * angle + random.uniform(0, 2 * np.pi)) / k for k in range(1, 9))
    return added(base, strength * np.asarray(waves))


@kind(0.2, 0.5, 0.8)
def load_steps(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The load drops by this share in the middle third of the record."""
    n = base.recording.n_samples
    middle = (np.arange(n) > n / 3) & (np.arange(n) < 2 * n / 3)
    return base.recording.replace(torque=base.recording.torque * np.where(middle, 1 - strength, 1.0))


@kind(0.15, 0.3, 0.5)
def load_reversed(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The load changes its sign for this share of the record, where other lobe flanks carry it."""
    n = base.recording.n_samples
    start = int(random.uniform(0, 1 - strength) * n)
    torque = base.recording.torque.copy()
    torque[start : start + int(strength * n)] = -base.other.torque[start : start + int(strength * n)]
    return base.recording.replace(torque=torque)


@kind(0.25, 0.5, 0.75, countable=False)
def two_discs(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The record goes on with another assembly and disc after this share."""
    late = np.arange(base.recording.n_samples) >= strength * base.recording.n_samples
    return base.recording.replace(torque=np.where(late, base.other.torque, base.recording.torque))


@kind(0.2, 0.5, 1, countable=False)
def two_assemblies_mixed(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """Blocks of two assemblies, of so many output turns each, alternate."""
    recording = base.recording
    assert recording.input_speed_hz is not None
    length = strength * recording.n_lobes / recording.input_speed_hz * recording.sampling_rate
    odd = (np.arange(recording.n_samples) // length) % 2 == 1
    return recording.replace(torque=np.where(odd, base.other.torque, recording.torque))


@kind(1 / 15, 1 / 3, 1)
def another_quantity(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The channel is the torque of the other shaft, with a mean of this share of the right one."""
    other = noisy(base.other_quantity, random)
    return base.recording.replace(torque=strength * base.per_nm / per_nm(other) * other.torque)
