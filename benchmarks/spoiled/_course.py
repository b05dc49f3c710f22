"""Spoiling of speed, clock and tachometer."""

from __future__ import annotations

import numpy as np

from benchmarks.spoiled._kind import Base, at_moments, kind, with_speed
from cyclofeat.recordings import Recording


def _said(recording: Recording, factor: float) -> Recording:
    """Return the recording with a multiple of its speed stated, and no angle."""
    assert recording.speed_rpm is not None
    return recording.replace(speed_rpm=factor * recording.speed_rpm, angle=None, angle_is_absolute=False)


@kind(2, 3, 4, has_angle=False)
def speed_a_fraction(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The input turns at 1/strength of the stated speed."""
    return _said(base.recording, strength)


@kind(1.5, 2, 3, has_angle=False)
def speed_a_multiple(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The input turns at strength times the stated speed."""
    return _said(base.recording, 1 / strength)


@kind(0.03, 0.06, 0.12, has_angle=False)
def speed_beside(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The input is faster or slower than stated by this share."""
    return _said(base.recording, 1 + strength * random.choice([-1, 1]))


@kind(0.02, 0.05, 0.1, has_angle=False)
def speed_creeps(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The speed rises or falls evenly by this share over the record."""
    course = np.linspace(-0.5, 0.5, base.recording.n_samples) * random.choice([-1, 1])
    return with_speed(base, 1 + strength * course, random)


@kind(0.01, 0.03, 0.06, has_angle=False)
def speed_wanders(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The speed swings by this share to either side, 2 to 4 times over the record."""
    turns = random.uniform(2, 4) * np.linspace(0, 1, base.recording.n_samples) + random.random()
    return with_speed(base, 1 + strength * np.sin(2 * np.pi * turns), random)


@kind(0.15, 0.4, 0.7, has_angle=False)
def run_up(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The input runs up from rest over this share of the record."""
    n = base.recording.n_samples
    return with_speed(base, np.minimum(1.0, np.arange(n) / (strength * n)), random)


@kind(0.1, 0.3, 0.5, has_angle=False)
def stop(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The input stands still for this share of the record."""
    n = base.recording.n_samples
    start = int(random.uniform(0.1, 0.9 - strength) * n)
    ratio = np.ones(n)
    ratio[start : start + int(strength * n)] = 0
    return with_speed(base, ratio, random)


@kind(1.03, 1.25, 2, has_angle=False)
def wrong_sampling_rate(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The sampling rate is strength times the true one."""
    return at_moments(base, np.arange(0, base.recording.n_samples, strength), random)


@kind(14, 11, 21)
def wrong_number_of_lobes(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The disc is stated to have this number of lobes instead of 15."""
    return base.recording.replace(n_lobes=int(strength), worn_lobes=None)


@kind(10, 100, 1000, has_angle=False)
def irregular_time(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The samples' times err by this number of samples (standard deviation), anew 20 times a turn."""
    recording = base.recording
    assert recording.input_speed_hz is not None
    n = recording.n_samples
    knots = np.linspace(0, n - 1, round(20 * recording.duration * recording.input_speed_hz))
    moments = np.interp(np.arange(n), knots, knots + strength * random.normal(size=knots.size))
    return at_moments(base, np.clip(np.maximum.accumulate(moments), 0, n - 1), random)


@kind(1, 2, 4, has_angle=True)
def tachometer_slips(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The tachometer counts this number of turns that the input did not make."""
    assert base.recording.angle is not None
    angle = base.recording.angle.copy()
    for start in random.integers(0, angle.size, int(strength)):
        angle[start:] += 2 * np.pi
    return base.recording.replace(angle=angle)


@kind(2, 8, 30, has_angle=True)
def tachometer_jitters(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The tachometer's pulses, one a turn, come at wrong angles, by so many degrees (standard deviation)."""
    assert base.recording.angle is not None
    turns = base.recording.angle / (2 * np.pi)
    pulses = np.arange(np.floor(turns[0]) - 1, np.ceil(turns[-1]) + 2)
    true = pulses + np.clip(strength / 360 * random.normal(size=pulses.size), -0.45, 0.45)
    return base.recording.replace(angle=2 * np.pi * np.interp(turns, true, pulses))


@kind(1.01, 16 / 15, 2, has_angle=True)
def wrong_pulses_per_turn(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The tachometer's angle is strength times the true one."""
    assert base.recording.angle is not None
    return base.recording.replace(angle=strength * base.recording.angle)


@kind(2, 15, 16, has_angle=True)
def angle_of_another_shaft(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The angle given as the input's is that of a shaft that turns strength times slower (15: the disc)."""
    assert base.recording.angle is not None
    return base.recording.replace(angle=base.recording.angle / strength)
