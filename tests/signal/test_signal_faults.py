"""Faults of a record against their definitions, written out."""

import numpy as np
import pytest
from scipy.signal.windows import hann

from cyclofeat.signal import faults
from cyclofeat.signal.lobes import lobe_frequency

RATE, SPEED = 25_600.0, 500 / 60
PRIME = 46_073  # samples: takes ten times as long to transform


def torque(seed: int, n: int = PRIME) -> np.ndarray:
    """Lobe lines that fall off, drift and noise."""
    random = np.random.default_rng(seed)
    time = np.arange(n) / RATE
    lines = sum(np.cos(2 * np.pi * k * lobe_frequency(SPEED) * time + random.uniform(0, 7)) / k
                for k in range(1, 90))  # fmt: skip
    return 22 + lines + 0.2 * np.sin(2 * np.pi * 0.4 * time) + random.normal(0, 0.05, n)


def pausing(seed: int) -> np.ndarray:
    """The same with an input turn in which the lobes hardly move."""
    values, turn = torque(seed), round(RATE / SPEED)
    values[4 * turn : 5 * turn] = 22 + 0.01 * (values[4 * turn : 5 * turn] - 22)
    return values


@pytest.mark.parametrize("seed", range(3))
def test_smoothness_is_that_of_the_tapered_spectrum(seed):
    values = torque(seed)
    power = np.abs(np.fft.rfft((values - values.mean()) * hann(values.size, sym=False))) ** 2
    lines = np.fft.rfftfreq(values.size, 1 / RATE) / lobe_frequency(SPEED)

    def level(low: float, high: float) -> float:
        return 10 * np.log10(power[(lines >= low) & (lines < high)].mean())

    expected = level(44, 88) - level(3, 9), level(44, 88) - level(44 / 1.5, 44)
    assert faults.spectral_falls(values, RATE, SPEED) == pytest.approx(expected, abs=0.2)


def test_smoothness_is_not_known_at_a_low_rate():
    assert np.isnan(faults.spectral_falls(torque(0)[::20], RATE / 20, SPEED)).all()


@pytest.mark.parametrize("values", [torque(3), pausing(4), pausing(5)], ids=["turns", "pauses", "too"])
def test_the_weakest_part_is_that_of_the_filtered_torque(values):
    spectrum = np.fft.rfft(values - values.mean())
    lines = np.fft.rfftfreq(values.size, 1 / RATE) / lobe_frequency(SPEED)
    spectrum[(lines < 5) | (lines > 44)] = 0
    parts = np.array_split(np.fft.irfft(spectrum, values.size) ** 2, 15)
    power = np.array([part.mean() for part in parts])
    expected = 10 * np.log10(power.min() / np.median(power))
    assert faults.weakest_part(values, RATE, SPEED, 15) == pytest.approx(expected, abs=0.2)


def test_the_noise_between_adjacent_samples_is_that_of_the_meter():
    random = np.random.default_rng(6)
    noise = np.concatenate([random.normal(0, 0.1, 30_000), random.normal(0, 0.3, 2000)])
    assert faults.noise_level(noise[:30_000]) == pytest.approx(0.1, rel=0.03)
    assert faults.noise_change(noise, 16) == pytest.approx(3, rel=0.1)
    noise[500] += 20
    off = faults.jump_sizes(noise)
    assert np.argmax(off) == 500
    np.testing.assert_allclose(off, faults.jump_sizes(noise, faults.noise_level(noise)), rtol=1e-12)
    usual = np.abs(noise[1:-1] - (noise[:-2] + noise[2:]) / 2)
    np.testing.assert_allclose(off[1:-1], usual / (1.4826 * np.median(usual)), rtol=1e-9)


@pytest.mark.parametrize("rise", [0.0, 0.1])
def test_jitter_of_pulses_once_a_turn(rise):
    """Of the errors at the pulses; a speed that rises by a tenth adds nothing."""
    turns = np.linspace(0, 2000, 200_000)
    turns += rise * turns**2 / 4000
    errors = np.random.default_rng(0).normal(0, 8 / 360, 2300)
    angle = np.interp(turns, np.arange(2300) + errors, np.arange(2300))
    windows, steady = (2 * np.pi * one.reshape(-1, 1600) for one in (angle, turns))
    # A place that meets no pulse has a mean of two errors.
    assert 0.7 * 8 < np.mean([faults.angle_jitter(one) for one in windows]) < 1.05 * 8
    assert max(faults.angle_jitter(one) for one in steady) < 0.01


def test_few_turns_do_not_tell_the_jitter():
    angle = np.linspace(0, 2 * np.pi * 4, 1000)
    assert faults.angle_jitter(angle + np.random.default_rng(0).normal(0, 0.3, 1000)) == 0
