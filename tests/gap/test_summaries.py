"""Cells that a rate or a gearbox does not hold are left out of all recordings alike."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.gap.summaries.summarise import SPEED_TOLERANCE, Cell, Kinematics, summarise_windows
from cyclofeat.signal.orders import estimate_input_speed

SPEED = 500 / 60


def windows(
    rate: float, n_lobes: int = 15, turns: float = 1.0, n: int = 3, speed: float = SPEED
) -> np.ndarray:
    random = np.random.default_rng(0)
    time = np.arange(int(np.ceil(turns * n_lobes / SPEED * rate))) / rate
    return 22 + random.normal(0, 0.1, (n, time.size)) + np.cos(2 * np.pi * (n_lobes + 1) * speed * time)


def lobe_lines(cells: list[Cell]) -> list[int]:
    return [int(cell.name.split()[2]) for cell in cells if cell.family == "lobe lines"]


@pytest.mark.parametrize("rate", [320.0, 600.0, 800.0, 863.0])
@pytest.mark.parametrize("turns", [0.995, 1.0, 2.3])
def test_lines_beyond_half_of_the_rate_are_left_out(rate: float, turns: float) -> None:
    values, cells = summarise_windows(windows(rate, turns=turns), Kinematics(rate, SPEED))
    assert values.shape == (3, len(cells))
    assert np.isfinite(values).all()
    # At 3 % above the nominal speed the last line and its floor still lie below half of the rate.
    lines = [cell for cell in cells if cell.family in ("lobe lines", "shaft lines", "floor")]
    assert max(cell.high_hz for cell in lines) * 1.03 < rate / 2
    held = lobe_lines(cells)
    assert 8 < len(held) < 48
    assert held == list(range(1, len(held) + 1))


def test_the_cells_do_not_depend_on_the_recording_s_speed() -> None:
    for rate in (800.0, 880.0, 895.0):
        slow, fast = (
            summarise_windows(windows(rate, speed=SPEED * factor), Kinematics(rate, SPEED))
            for factor in (0.971, 1.029)
        )
        assert slow[1] == fast[1]
        tachometer = np.full(3, 1.1 * SPEED)
        values, cells = summarise_windows(windows(rate), Kinematics(rate, SPEED), tachometer)
        assert [cell for cell in cells if cell.family != "speed"] == slow[1][1:]
        assert np.isfinite(values).all()


@pytest.mark.parametrize(
    ("n_lobes", "missing"), [(3, list(range(1, 49))), (5, [2, 3, 7, 8]), (8, [4, 12, 20])]
)
def test_lines_of_few_lobes_without_a_floor_are_left_out(n_lobes: int, missing: list[int]) -> None:
    values, cells = summarise_windows(windows(6400.0, n_lobes), Kinematics(6400.0, SPEED, n_lobes))
    assert np.isfinite(values).all()
    assert [line for line in range(1, 49) if line not in lobe_lines(cells)][: len(missing)] == missing
    of_lines, of_floors = ([c for c in cells if c.family == family] for family in ("lobe lines", "floor"))
    assert [cell.low_hz for cell in of_lines] == [cell.low_hz for cell in of_floors]


def test_bands_between_two_bins_are_left_out() -> None:
    """A gearbox of two lobes turns its output four times a second."""
    values, cells = summarise_windows(windows(6400.0, 2), Kinematics(6400.0, SPEED, 2))
    assert np.isfinite(values).all()
    assert "third octave at 10 Hz" not in [cell.name for cell in cells]


def test_usual_rates_leave_nothing_out() -> None:
    for rate in (2000.0, 6400.0, 25_600.0):
        _, cells = summarise_windows(windows(rate), Kinematics(rate, SPEED))
        assert lobe_lines(cells) == list(range(1, 49))


@pytest.mark.parametrize("percent", [-3.0, 0.3, 3.0])
def test_a_speed_at_the_end_of_the_range_is_believed(percent: float) -> None:
    phase = 2 * np.pi * SPEED * (1 + percent / 100) * np.arange(46_080) / 25_600
    noise = np.random.default_rng(0).normal(size=phase.size)
    torque = 22 + noise + 0.1 * np.cos(16 * phase) + 0.1 * np.cos(32 * phase + 1)
    values, _ = summarise_windows(torque[np.newaxis], Kinematics(25_600.0, SPEED))
    assert values[0, 0] == pytest.approx(percent, abs=0.05)


def test_the_flank_of_a_lobe_line_is_no_speed() -> None:
    """Order 30.98 is lobe line 29 at the recording's speed, and close to order 32 of one 3 % slower."""
    phase = 2 * np.pi * SPEED * 1.0015 * np.arange(46_080) / 25_600
    noise = np.random.default_rng(0).normal(size=phase.size)
    mesh = 0.01 * np.cos(16 * phase) + 0.013 * np.cos(32 * phase + 1)
    torque = (22 + noise + mesh + 2 * np.cos(29 * 16 / 15 * phase))[np.newaxis]
    flank = estimate_input_speed(torque, 25_600.0, SPEED, SPEED_TOLERANCE, comb="mesh")
    assert flank[0] < 0.9702 * SPEED
    assert summarise_windows(torque, Kinematics(25_600.0, SPEED))[0][0, 0] == pytest.approx(0.15, abs=0.1)
