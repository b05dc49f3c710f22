"""Kinds of spoiling: what one is, in which strengths, and the table of all."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from cyclofeat.recordings import Recording
from cyclofeat.signal.windows import Float

# Strengths in Nm are those of an output torque with this load; of other quantities, as much of the mean.
LOAD_NM = 22.0
NOISE_NM = 0.2


@dataclass(frozen=True)
class Base:
    """Recordings of one simulated machine that kinds of spoiling start from.

    Attributes
    ----------
    silent : Recording
        One quantity without the sensor's noise, with the absolute angle of the input, labelled.
    recording : Recording
        The same with the noise.
    other : Recording
        As ``recording``, of another machine at the same speed, whose disc has another number of worn lobes.
    other_quantity : Recording
        As ``silent``, of another quantity of the same machine.
    """

    silent: Recording
    recording: Recording
    other: Recording
    other_quantity: Recording

    @property
    def per_nm(self) -> float:
        """Return what 1 Nm of a strength is in the quantity's unit."""
        return per_nm(self.silent)


Spoil = Callable[[Base, float, np.random.Generator], Recording]


@dataclass(frozen=True)
class Kind:
    """Kind of spoiling.

    Attributes
    ----------
    name, text : str
        Name in the table; what it is, with the meaning of the strength.
    strengths : tuple of float
    spoil : callable
        Function of base, strength and generator that returns the spoiled recording.
    has_angle : bool or None
        Whether recordings have an angle; None for every second.
    countable : bool
        Whether the base's count is still the right answer.
    """

    name: str
    text: str
    strengths: tuple[float, ...]
    spoil: Spoil
    has_angle: bool | None = None
    countable: bool = True


KINDS: dict[str, Kind] = {}


def kind(
    *strengths: float, has_angle: bool | None = None, countable: bool = True
) -> Callable[[Spoil], Spoil]:
    """Register a function as a kind of spoiling of its name; its docstring says what it is."""

    def register(spoil: Spoil) -> Spoil:
        name = spoil.__name__.replace("_", " ")
        text = " ".join((inspect.getdoc(spoil) or "").split())
        KINDS[name] = Kind(name, text, strengths, spoil, has_angle, countable)
        return spoil

    return register


def blocks(n_samples: int, share: float, length: int, random: np.random.Generator) -> Iterator[slice]:
    """Yield blocks of samples that cover a share of the record, one at a random place in each stretch."""
    stretch = length / share
    for k in range(int(n_samples / stretch)):
        start = int((k + random.random() * (1 - share)) * stretch)
        yield slice(start, start + length)


def per_nm(recording: Recording) -> float:
    """Return what 1 Nm of a strength is in a recording: as much of its mean as of the load."""
    return abs(float(recording.torque.mean())) / LOAD_NM


def added(base: Base, disturbance_nm: Float) -> Recording:
    """Return the recording with a disturbance."""
    return base.recording.replace(torque=base.recording.torque + base.per_nm * disturbance_nm)


def noisy(recording: Recording, random: np.random.Generator) -> Recording:
    """Return the recording with the sensor's noise."""
    noise = per_nm(recording) * random.normal(0, NOISE_NM, recording.n_samples)
    return recording.replace(torque=recording.torque + noise)


def at_moments(base: Base, moments: Float, random: np.random.Generator) -> Recording:
    """Return the torque at fractional samples, with noise and without an angle."""
    moments = moments[moments <= base.silent.n_samples - 1]
    torque = np.interp(moments, np.arange(base.silent.n_samples), base.silent.torque)
    return noisy(base.silent.replace(torque=torque, angle=None, angle_is_absolute=False), random)


def with_speed(base: Base, ratio: Float, random: np.random.Generator) -> Recording:
    """Return the torque of a shaft at a course of speed, as a ratio to the recorded one, without an angle."""
    return at_moments(base, np.concatenate([[0.0], np.cumsum(ratio[:-1])]), random)
