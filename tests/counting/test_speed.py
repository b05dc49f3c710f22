"""The speed that a model was trained for, by the torque alone."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.counting import other_speed

RATE, SPEED, TOLERANCE = 25_600.0, 500 / 60, 0.015
SECONDS = 1.8


def torque(speed: float, per_turn: float, seed: int, noise: float = 0.05, n: int = 2) -> np.ndarray:
    """A pulse of its own height for each of 15 slots that pass ``per_turn`` times a turn, drift and noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(SECONDS * RATE)) / RATE
    windows = []
    for _ in range(n):
        place = 15 * (per_turn * speed * t + rng.random())
        heights = rng.normal(size=15)
        pulses = heights[np.floor(place).astype(int) % 15] * np.exp(-(((place % 1 - 0.5) / 0.15) ** 2))
        drift = 3.0 * np.sin(2 * np.pi * (0.4 * t + rng.random()))
        windows.append(22 + pulses + drift + noise * rng.normal(size=t.size))
    return np.array(windows)


# One passage of all 15 lobes takes 15/16 of an input turn.
LOBES = 16 / 15


@pytest.mark.parametrize("factor", [0.8, 0.9, 0.97, 1.03, 16 / 15, 1.2])
def test_another_speed_is_found(factor):
    for seed in range(5):
        found = other_speed(torque(factor * SPEED, LOBES, seed), RATE, SPEED, TOLERANCE)
        assert found == pytest.approx(factor * SPEED, rel=2e-3)


@pytest.mark.parametrize("factor", [0.99, 1.0, 1.01])
@pytest.mark.parametrize("noise", [0.05, 0.5, 5.0])
def test_the_nominal_speed_is_no_other(factor, noise):
    for seed in range(5):
        assert other_speed(torque(factor * SPEED, LOBES, seed, noise), RATE, SPEED, TOLERANCE) is None


def test_lines_of_the_shaft_are_not_taken_for_lobes():
    """A disc whose lobes are alike shows what repeats with each turn of the input, and is not refused."""
    for seed in range(5):
        assert other_speed(torque(SPEED, 1.0, seed), RATE, SPEED, TOLERANCE) is None


@pytest.mark.parametrize("mains", [50, 60])
@pytest.mark.parametrize("rpm", [500, 1450, 2900])
def test_hum_is_no_speed(mains, rpm):
    """Seven harmonics in noise, next to nothing of the disc."""
    speed = rpm / 60
    t = np.arange(round(15 / speed * RATE)) / RATE
    rng = np.random.default_rng(1)
    for _ in range(8):
        hum = sum(np.sin(2 * np.pi * mains * k * t + rng.uniform(0, 7)) for k in range(1, 8))
        assert other_speed((22 + hum + rng.normal(size=t.size))[np.newaxis], RATE, speed, TOLERANCE) is None


def test_a_weaker_comb_beside_that_of_the_lobes_is_no_speed():
    """Brake poles, say. Without lobes they would be taken for lobes at another speed, which is the price."""
    for seed in range(5):
        poles = torque(1.1 * SPEED, LOBES, 100 + seed, noise=0.0) - 22
        assert other_speed(torque(SPEED, LOBES, seed) + 0.3 * poles, RATE, SPEED, TOLERANCE) is None
        assert other_speed(torque(SPEED, LOBES, seed, n=2) * 0 + 22 + poles, RATE, SPEED, TOLERANCE)


def test_noise_is_no_speed_at_any_rate():
    rng = np.random.default_rng(2)
    for rate in (345.0, 500.0, 2560.0):
        for _ in range(60):
            window = rng.normal(22, 1, (1, round(SECONDS * rate)))
            assert other_speed(window, rate, SPEED, TOLERANCE) is None


def test_of_many_windows_the_middle_ones_count():
    """Run-up and run-down may turn otherwise."""
    ends = torque(1.1 * SPEED, LOBES, 0, n=3)
    middle = torque(SPEED, LOBES, 1, n=8)
    assert other_speed(np.vstack([ends, middle, ends]), RATE, SPEED, TOLERANCE) is None


def test_where_there_is_nothing_to_go_by_nothing_is_said():
    noise = np.random.default_rng(0).normal(22, 1, (3, round(SECONDS * RATE)))
    assert other_speed(noise, RATE, SPEED, TOLERANCE) is None
    assert other_speed(np.full((1, 46_080), 22.0), RATE, SPEED, TOLERANCE) is None
    assert other_speed(torque(1.1 * SPEED, LOBES, 0)[:, ::128], RATE / 128, SPEED, TOLERANCE) is None
