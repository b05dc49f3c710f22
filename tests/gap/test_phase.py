"""Torque folded over turns: by the recording's own speed, as far off as summaries look for it."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.gap import Comparison
from cyclofeat.gap.comparison import measured_turns
from cyclofeat.gap.summaries.phase import phase_maps
from cyclofeat.gap.summaries.summarise import Kinematics
from cyclofeat.gap.where import locate as _locate
from cyclofeat.gap.where.locate import locate

RATE, SPEED, N_LOBES = 6400.0, 500 / 60, 15
N = 11_520
CONDITIONS = Kinematics(RATE, SPEED, N_LOBES)


def torque(speeds: np.ndarray, order: float, rate: float = RATE, n: int = N) -> np.ndarray:
    """A line of amplitude 1 at an order of each window's own speed, with noise."""
    random = np.random.default_rng(0)
    phase = 2 * np.pi * speeds[:, None] * np.arange(n) / rate + random.uniform(0, 6, (len(speeds), 1))
    return np.cos(order * phase) + random.normal(0, 0.1, phase.shape)


def amplitude(wave: np.ndarray) -> float:
    return float(np.sqrt(2) * wave.std())


@pytest.mark.parametrize("factor", [0.975, 0.99, 1.012, 1.027])
def test_a_speed_within_the_tolerance_of_summaries_does_not_smear(factor: float) -> None:
    measured = torque(np.full(3, SPEED * factor), N_LOBES + 1)
    simulated = torque(np.full(4, SPEED), N_LOBES + 1)
    found = phase_maps(measured, simulated, CONDITIONS, 0.05)
    for name in ("input", "lobe"):
        assert amplitude(found[name].measured) == pytest.approx(1.0, abs=0.1), name


def test_a_tachometer_says_the_speed() -> None:
    """Of a ripple without mesh lines, which could tell it."""
    speeds = SPEED * np.array([0.96, 1.04, 1.01])
    measured, simulated = torque(speeds, 5), torque(speeds, 5)
    found = phase_maps(measured, simulated, CONDITIONS, 0.05, (speeds, speeds))
    assert amplitude(found["input"].measured) == pytest.approx(1.0, abs=0.05)
    assert amplitude(found["input"].simulated) == pytest.approx(1.0, abs=0.05)
    without = phase_maps(measured, simulated, CONDITIONS, 0.05)
    assert amplitude(without["input"].measured) < 0.5


@pytest.mark.slow
def test_a_located_gap_hands_the_tachometer_on(monkeypatch: pytest.MonkeyPatch) -> None:
    given = []
    monkeypatch.setattr(_locate, "phase_maps", lambda *arguments: given.append(arguments[-1]) or {})
    speeds = SPEED * np.array([0.99, 1.0, 1.01])
    X = 22 + torque(speeds, N_LOBES + 1)
    angle = 2 * np.pi * speeds[:, None] * np.arange(N) / RATE
    plain = Comparison(sampling_rate=RATE, n_bank=10)
    comparison = plain.replace(tachometer=True)
    located = locate(comparison, measured_turns(comparison, X, angle=angle), n_permutations=219)
    assert located.phase == {}
    assert locate(plain, measured_turns(plain, X), n_permutations=219).phase == {}
    (of_measured, of_bank), nothing = given
    assert of_measured == pytest.approx(speeds)
    assert of_bank == pytest.approx(located.bank.speeds)
    assert nothing is None


def test_few_samples_per_turn_leave_no_bin_empty() -> None:
    """96 samples per turn, each at the same phase every turn."""
    rate = 96 * SPEED
    X = torque(np.full(3, SPEED), 1, rate, 1440)
    found = phase_maps(X, X, Kinematics(rate, SPEED), 0.05, (np.full(3, SPEED),) * 2)
    assert np.isfinite(found["input"].measured).all()
    assert amplitude(found["input"].measured) == pytest.approx(1.0, abs=0.1)
