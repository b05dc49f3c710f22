"""The speed of the input shaft in the torque alone, where none is stated."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.signal.speed import follow_speed, search_speed, shaft_lines

RATE = 4_000.0


def torque(rpm: float, seconds: float, worn: bool = True, noise: float = 1.0, mesh: float = 0.0, even=None):
    """Lobe lines of a worn disc, or mesh and even lines of a sound one (more of these, or ``even`` others,
    with ``mesh`` lines that are so many times larger), in noise and drift."""
    random = np.random.default_rng(0)
    time = np.arange(round(seconds * RATE)) / RATE
    turns = rpm / 60 * time
    orders = 16 / 15 * np.arange(3, 40) if worn else np.r_[16.0, 32.0, 2.0 * np.arange(2, 15)]
    if mesh:
        orders = 2.0 * np.arange(2, 40) if even is None else np.r_[16.0 * np.arange(1, 5), even]
    phases = random.uniform(0, 2 * np.pi, orders.size)
    lines = np.cos(2 * np.pi * orders * turns[:, None] + phases) @ np.where(orders % 16, 1.0, mesh or 1.0)
    drift = 5 * np.sin(2 * np.pi * 0.3 * time)
    return np.asarray(22 + lines + drift + noise * random.normal(size=time.size))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rpm", "turns"), [(104.0, 16), (173.0, 16), (437.0, 16), (437.0, 48), (980.0, 48), (1490.0, 16)]
)
def test_the_speed_of_a_worn_disc_is_found(rpm, turns):
    """In long records 8/15 of the speed is searched too, where the lobe lines are even lines of the shaft."""
    (found,) = search_speed(torque(rpm, turns * 60 / rpm), RATE)
    assert 60 * found.speed_hz == pytest.approx(rpm, rel=2e-4)
    turned = 2 * np.pi * rpm / 60 * (found.angle.size - 1) / RATE
    assert found.angle[-1] == pytest.approx(turned, rel=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("rpm", [240.0, 500.0, 760.0])
def test_a_sound_disc_is_not_taken_for_a_worn_one_at_another_speed(rpm):
    found = [60 * one.speed_hz for one in search_speed(torque(rpm, 40 * 60 / rpm, worn=False), RATE)]
    assert found == [] or any(speed == pytest.approx(rpm, rel=2e-3) for speed in found)


@pytest.mark.slow
def test_a_speed_that_does_not_fit_the_whole_record_is_not_taken():
    """The machine runs in the middle of the record only."""
    running = torque(437.0, 6)
    random = np.random.default_rng(1)
    still = [running.mean() + running.std() * random.normal(size=round(50 * RATE)) for _ in range(2)]
    assert search_speed(running, RATE)
    assert search_speed(np.concatenate([still[0], running, still[1]]), RATE) == []


@pytest.mark.slow
def test_a_wandering_speed_is_found():
    time = np.arange(round(6 * RATE)) / RATE
    turns = 7 * time + 7 * 0.02 / (2 * np.pi * 0.2) * (1 - np.cos(2 * np.pi * 0.2 * time))
    lines = np.cos(2 * np.pi * 16 / 15 * np.outer(turns, np.arange(3, 40))).sum(axis=1)
    found, *_ = search_speed(lines + np.random.default_rng(1).normal(size=time.size), RATE)
    np.testing.assert_allclose(found.angle - found.angle[0], 2 * np.pi * (turns - turns[0]), atol=0.1)


def slow_disc(rpm: float, seed: int) -> np.ndarray:
    """Brief disturbances of worn lobes: lobe lines 37 to 85, weaker than the noise, and a drift."""
    random = np.random.default_rng(seed)
    time = np.arange(round(32 * 60 / rpm * RATE)) / RATE
    turned = 2 * np.pi * 16 / 15 * np.arange(37, 86) * rpm / 60 * time[:, None]
    lines = np.cos(turned + random.uniform(0, 7, turned.shape[1])).sum(axis=1)
    drift = np.cumsum(random.normal(size=time.size))
    return np.asarray(22 + 0.3 * lines + 5 * drift / np.abs(drift).max() + 3 * random.normal(size=time.size))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_speed_of_a_slow_disc_is_followed_by_its_higher_lines(seed):
    found = follow_speed(slow_disc(118.0, seed), RATE, 120 / 60)
    assert found.fits
    assert found.reaches
    assert 60 * found.speed_hz == pytest.approx(118.0, rel=2e-4)


def test_run_out_does_not_make_a_disc_less_probable():
    """Orders 1 and 2 are even lines of the shaft at a half and a quarter of the speed."""
    weak = torque(330.0, 20, noise=20.0)
    turned = 2 * np.pi * 330 / 60 * np.arange(weak.size) / RATE
    plain, run_out = (
        follow_speed(one, RATE, 330 / 60) for one in (weak, weak + 30 * (np.cos(turned) + np.cos(2 * turned)))
    )
    assert plain.fits
    assert run_out.margin == pytest.approx(plain.margin, abs=3)


@pytest.mark.parametrize("turns", [6.5, 8, 13])
def test_short_records_are_followed_by_blocks_that_they_hold(turns):
    found = follow_speed(torque(330.0, turns * 60 / 330), RATE, 335 / 60)
    assert 60 * found.speed_hz == pytest.approx(330, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("beside", [-0.035, -0.025, 0.0, 0.025])
def test_a_sound_disc_s_shaft_lines_are_not_followed_as_lobe_lines(beside):
    """Its even lines are lobe lines at 15/16 of the speed, which is near where a lower one is stated."""
    found = follow_speed(torque(330.0, 20, worn=False), RATE, (1 + beside) * 330 / 60)
    assert found.fits
    assert 60 * found.speed_hz == pytest.approx(330, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("worn", [True, False])
@pytest.mark.parametrize("beside", [-0.06, 0.06])
def test_a_speed_at_the_end_of_the_range_is_not_believed(worn, beside):
    """The true speed is 6 % beside the stated one; 5 % is followed."""
    near = follow_speed(torque(330.0, 20, worn=worn), RATE, 330 / 60 / (1 + 5 / 6 * beside))
    assert near.fits
    assert 60 * near.speed_hz == pytest.approx(330, rel=2e-3)
    assert not follow_speed(torque(330.0, 20, worn=worn), RATE, 330 / 60 / (1 + beside)).fits


def test_even_lines_of_the_shaft_have_their_root_mean_square():
    turned = 2 * np.pi * np.arange(2 * 15 * 128).reshape(2, -1) / 128
    windows = 3 * np.cos(6 * turned) + 4 * np.cos(20 * turned) + 9 * np.cos(7 * turned) + 22
    assert shaft_lines(windows, 128, 15)[1] == pytest.approx(5 / 2**0.5)


def test_lines_of_the_shaft_alone_are_no_disc():
    time = np.arange(round(8 * RATE)) / RATE
    turned = 2 * np.pi * 330 / 60 * np.outer(time, [4, 6, 8, 10, 12, 14, 18, 20])
    lines = np.cos(turned).sum(axis=1) + np.random.default_rng(0).normal(size=time.size)
    assert not follow_speed(lines, RATE, 330 / 60).fits


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1 / 4, 1 / 3, 1 / 2, 2.0, 3.0, 15 / 8, 8 / 15])
@pytest.mark.parametrize("worn", [True, False])
def test_a_disc_does_not_fit_at_a_multiple_of_its_speed(worn, factor):
    """Even lines of a sound disc are lobe lines at 15/8 of its speed, lobe lines are even ones at 8/15."""
    assert not follow_speed(torque(330.0, 20, worn=worn), RATE, factor * 330 / 60).fits


@pytest.mark.slow
def test_nothing_is_found_in_noise_and_hum_nor_what_the_record_cannot_hold():
    hum = np.sin(2 * np.pi * 50 * np.arange(round(4 * RATE)) / RATE)
    for seed in range(3):
        assert search_speed(hum + np.random.default_rng(seed).normal(size=hum.size), RATE) == []
    assert search_speed(torque(437, 16 * 60 / 437)[:400], RATE) == []  # 0.1 s: no output turn at 1,500 RPM
    assert search_speed(torque(437, 16 * 60 / 437)[::200], RATE / 200) == []  # 20 Hz: no mesh at 100 RPM
    assert search_speed(np.full(20_000, 22.0), RATE) == []


@pytest.mark.slow
@pytest.mark.parametrize("even", [None, 128 / 15 * np.arange(1, 7)])
def test_a_sound_disc_with_little_noise_keeps_its_stated_speed(even):
    """Its even lines reach as far as a worn disc's lobe lines at 15/8 of the speed: the mesh line tells. With
    perfect parts it has lines of the output's eight pins instead, as a worn disc has at 8 times the speed."""
    signal = torque(330.0, 20, worn=False, noise=0.03, mesh=27.0 if even is None else 1.0, even=even)
    found = follow_speed(signal, RATE, 330 / 60)
    assert found.fits
    assert 60 * found.speed_hz == pytest.approx(330, rel=2e-3)
    assert not follow_speed(signal, RATE, 2 * 330 / 60).fits
    assert not follow_speed(signal, RATE, 330 / 2 / 60).fits
