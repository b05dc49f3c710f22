"""Spoiling of the samples: amplifier, converter, transfer."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

from benchmarks.spoiled._kind import Base, added, blocks, kind
from cyclofeat.recordings import Recording

_BLOCK_S = 0.04  # of samples that the transfer loses


def _in_blocks(base: Base, share: float, random: np.random.Generator, fill: str) -> Recording:
    recording = base.recording
    torque = recording.torque.copy()
    kept = np.ones(torque.size, dtype=bool)
    for lost in blocks(torque.size, share, int(_BLOCK_S * recording.sampling_rate), random):
        kept[lost] = False
        torque[lost] = 0.0 if fill == "zero" else torque[max(lost.start - 1, 0)]
    if fill == "cut":
        # The channel of the angle is another one, and whole.
        angle = None if recording.angle is None else recording.angle[: kept.sum()]
        return recording.replace(torque=torque[kept], angle=angle)
    return recording.replace(torque=torque)


@kind(0.03, 0.1, 0.2)
def blocks_cut_out(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """Blocks of 0.04 s, this share of the torque, are missing, and what follows comes too early."""
    return _in_blocks(base, strength, random, "cut")


@kind(0.03, 0.1, 0.2)
def blocks_held(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """Blocks of 0.04 s, this share of the torque, repeat the last value before them."""
    return _in_blocks(base, strength, random, "hold")


@kind(0.03, 0.1, 0.2)
def blocks_zero(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """Blocks of 0.04 s, this share of the torque, are zero."""
    return _in_blocks(base, strength, random, "zero")


@kind(0.03, 0.1, 0.2)
def blocks_bridged(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """Blocks of 0.04 s, this share of the torque, are replaced by straight lines."""
    torque = base.recording.torque.copy()
    length = int(_BLOCK_S * base.recording.sampling_rate)
    for lost in blocks(torque.size, strength, length, random):
        torque[lost] = np.linspace(
            torque[max(lost.start - 1, 0)], torque[min(lost.stop, torque.size - 1)], length
        )
    return base.recording.replace(torque=torque)


@kind(0.01, 0.05, 0.2, has_angle=False)
def samples_missing(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """Single samples at random places, this share of all, are missing."""
    recording = base.recording
    kept = random.random(recording.n_samples) >= strength
    angle = None if recording.angle is None else recording.angle[kept]
    return recording.replace(torque=recording.torque[kept], angle=angle)


@kind(0.2, 0.5, 0.9)
def samples_repeated(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """Single samples at random places, this share of all, repeat the one before."""
    fresh = random.random(base.recording.n_samples) >= strength
    fresh[0] = True
    return base.recording.replace(
        torque=base.recording.torque[np.maximum.accumulate(np.arange(fresh.size) * fresh)]
    )


@kind(0.1, 0.3, 0.6)
def blocks_swapped(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """Adjacent blocks of 0.04 s, this share of the record, come in the wrong order."""
    torque = base.recording.torque.copy()
    length = int(_BLOCK_S * base.recording.sampling_rate)
    for pair in blocks(torque.size, strength, 2 * length, random):
        torque[pair] = np.roll(torque[pair], length)
    return base.recording.replace(torque=torque)


@kind(32, 64, 128)
def aliased(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """Only every sample of this number was taken, without a filter; straight lines stand between."""
    n = base.recording.n_samples
    taken = np.arange(0, n, int(strength))
    return base.recording.replace(torque=np.interp(np.arange(n), taken, base.recording.torque[taken]))


@kind(0.1, 0.25, 0.5)
def constant_stretch(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """One stretch of the record, of this share, repeats one value."""
    torque = base.recording.torque.copy()
    start = int(random.uniform(0, 1 - strength) * torque.size)
    torque[start : start + int(strength * torque.size)] = torque[start]
    return base.recording.replace(torque=torque)


@kind(0.1, 0.3, 0.6)
def dead_sensor(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The torque is 0 with a noise of 0.02 Nm for one stretch, of this share."""
    torque = base.recording.torque.copy()
    start = int(random.uniform(0, 1 - strength) * torque.size)
    dead = slice(start, start + int(strength * torque.size))
    torque[dead] = base.per_nm * random.normal(0, 0.02, torque[dead].size)
    return base.recording.replace(torque=torque)


@kind(0.02, 0.1, 0.44)
def clipped_on_one_side(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """This share of the samples is clipped at the top."""
    torque = base.recording.torque
    return base.recording.replace(torque=np.minimum(torque, np.quantile(torque, 1 - strength)))


@kind(0.05, 0.2, 0.44)
def clipped_on_both_sides(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """This share of the samples is clipped, half of it at the top, half at the bottom."""
    torque = base.recording.torque
    return base.recording.replace(
        torque=np.clip(torque, *np.quantile(torque, [strength / 2, 1 - strength / 2]))
    )


@kind(0.3, 1, 4)
def coarse_steps(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The converter's step is so many standard deviations of the torque."""
    step = strength * base.recording.torque.std()
    return base.recording.replace(torque=step * np.round(base.recording.torque / step))


@kind(1, 2, 5)
def saturating_gain(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The amplifier saturates softly (tanh), from 1/strength standard deviations on."""
    torque = base.recording.torque
    mean, scale = torque.mean(), torque.std() / strength
    return base.recording.replace(torque=mean + scale * np.tanh((torque - mean) / scale))


@kind(0.7, 0.4, 0.1)
def gain_by_polarity(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """Torque below the mean is amplified by this factor only."""
    mean = base.recording.torque.mean()
    above = base.recording.torque - mean
    return base.recording.replace(torque=mean + np.where(above < 0, strength * above, above))


@kind(0.2, 0.5, 1)
def sign_flipped(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The sign of the torque is wrong for this share of the record, at its end."""
    n = base.recording.n_samples
    return base.recording.replace(
        torque=base.recording.torque * np.where(np.arange(n) < (1 - strength) * n, 1, -1)
    )


@kind(1, 4, 16)
def offset_jumps(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The zero jumps once in a second on average, by so many Nm (standard deviation)."""
    n, rate = base.recording.n_samples, base.recording.sampling_rate
    jumps = (random.random(n) < 1 / rate) * random.normal(0, strength, n)
    return added(base, np.cumsum(jumps))


@kind(3, 12, 50)
def drift(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The zero drifts evenly by so many Nm over the record."""
    return added(base, np.linspace(0, strength, base.recording.n_samples))


@kind(0.8, 0.5, 0.2)
def gain_drifts(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The gain drifts from 1 to this factor over the record."""
    return base.recording.replace(
        torque=base.recording.torque * np.linspace(1, strength, base.recording.n_samples)
    )


@kind(5, 20, 100)
def spikes(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """Single samples, 20 a second on average, are off by so many Nm to either side."""
    recording = base.recording
    hit = random.random(recording.n_samples) < 20 / recording.sampling_rate
    return added(base, strength * hit * random.choice([-1, 1], hit.size))


@kind(100, 50, 20)
def low_pass(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """A low-pass filter of the fourth order cuts off at this frequency in Hz."""
    torque = base.recording.torque
    sos = butter(4, strength, fs=base.recording.sampling_rate, output="sos")
    return base.recording.replace(torque=sosfilt(sos, torque, zi=sosfilt_zi(sos) * torque[0])[0])


@kind(1.0, 0.9, 0.5)
def very_short(base: Base, strength: float, random: np.random.Generator) -> Recording:
    """The record holds this number of output turns."""
    recording = base.recording
    assert recording.input_speed_hz is not None
    return recording.crop(0.0, strength * recording.n_lobes / recording.input_speed_hz)
