"""The speed that a model was trained for, by the torque alone."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.counting._speed import other_speed

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


def test_hum_is_no_speed():
    t = np.arange(round(SECONDS * RATE)) / RATE
    hum = sum(np.sin(2 * np.pi * 50 * k * t + k) for k in range(1, 8))
    for seed in range(5):
        assert other_speed(torque(SPEED, LOBES, seed) + 0.5 * hum, RATE, SPEED, TOLERANCE) is None


def test_where_there_is_nothing_to_go_by_nothing_is_said():
    noise = np.random.default_rng(0).normal(22, 1, (3, round(SECONDS * RATE)))
    assert other_speed(noise, RATE, SPEED, TOLERANCE) is None
    assert other_speed(np.full((1, 46_080), 22.0), RATE, SPEED, TOLERANCE) is None
    assert other_speed(torque(1.1 * SPEED, LOBES, 0)[:, ::128], RATE / 128, SPEED, TOLERANCE) is None
