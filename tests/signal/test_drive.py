"""The angle of a shaft whose speed a motor controls, from the motor's current."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from cyclofeat.counting.model.turning import turning_of
from cyclofeat.datasets import make_rig_recordings, rig_preset
from cyclofeat.recordings import Recording
from cyclofeat.signal.speed import controlled_lag, follow_motor, follow_speed

RATE, HERTZ = 4_000.0, 8.0
WORN = tuple(16 / 15 * np.arange(1, 33))
# Of a sound disc: mesh and even lines of the shaft; of its motor: ripple, and one wave for each of 21 slots.
SOUND = (4.0, 6.0, 8.0, 10.0, 14.0, 16.0, 20.0, 32.0)
EVEN = tuple(np.arange(4.0, 92.0, 2.0))  # or, if they are large, of a worn disc at 15/8 of the speed


@cache
def driven(orders, gain=0.1, integral_s=0.015, motor=(30.0,), seed=0, turns=32):
    """Return the current and the angle in rad of a shaft that slows down where load or lobes brake it."""
    random = np.random.default_rng(seed)
    time = np.arange(round(turns / HERTZ * RATE)) / RATE
    phases = random.uniform(0, 2 * np.pi, len(orders))
    angle = steady = 2 * np.pi * HERTZ * time
    drift = sosfilt(butter(2, [0.3, 6.0], "bandpass", fs=RATE, output="sos"), random.normal(size=time.size))
    drift *= 6 / drift.std()
    for _ in range(40):  # until angle and current belong to each other
        lobes = np.cos(np.multiply.outer(angle, orders) + phases) @ (6 / np.sqrt(orders))
        current = lobes + drift + 2 * sum(np.cos(order * angle) for order in motor)
        scaled = (current - current.mean()) / current.std()
        angle = steady - 2 * np.pi * HERTZ * gain * controlled_lag(scaled, RATE, integral_s)
    assert np.diff(angle).min() > 0
    return 20 + current + 4.0 * random.normal(size=time.size), angle


def error(found, angle):
    """Standard deviation in turns."""
    return float(np.std(found.angle - angle) / (2 * np.pi))


def test_the_lag_is_that_of_a_controlled_shaft():
    """The control's own equation, integrated forwards, gives the current of a known lag."""
    step, gain, integral_s = 1e-4, 3.0, 0.02
    speed = np.cumsum(np.random.default_rng(0).normal(size=20_000)) * 0.01
    speed -= np.linspace(speed[0], speed[-1], speed.size)
    lag, current = np.zeros(speed.size), np.zeros(speed.size)
    for k in range(1, speed.size):
        lag[k] = lag[k - 1] + step * speed[k]
        current[k] = gain * (speed[k] + lag[k] / integral_s)
    found = controlled_lag(current, 1 / step, integral_s) / gain
    np.testing.assert_allclose(found, lag, atol=0.01 * lag.std())


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "integral_s"), [(0.1, 0.015), (0.2, 0.008), (0.08, 0.03)])
def test_braking_by_lobes_is_followed(gain, integral_s):
    """A torque's search cannot: within one turn the speed hardly changes there."""
    current, angle = driven(WORN, gain, integral_s)
    found = follow_motor(current, RATE, HERTZ * 1.01)
    assert found.fits
    assert error(found, angle) < 0.003 < error(follow_speed(current, RATE, HERTZ * 1.01), angle)


@pytest.mark.slow
def test_a_sensor_the_other_way_round_tells_the_same():
    current, _ = driven(WORN)
    there, back = (follow_motor(one, RATE, HERTZ) for one in (current, -current))
    np.testing.assert_allclose(back.angle, there.angle, atol=1e-6)


@pytest.mark.slow
def test_a_steady_shaft_stays_steady():
    current, angle = driven(WORN, gain=0.0)
    assert error(follow_motor(current, RATE, HERTZ), angle) < 0.003


@pytest.mark.slow
def test_a_line_of_the_motor_beside_a_lobe_line_does_not_draw_the_speed():
    """Order 30 is 2/15 of an order above lobe line 28: a speed that is 0.45 % higher would explain it."""
    current, angle = driven(WORN[:24], motor=(30.0, 30.0))
    found = follow_motor(current, RATE, HERTZ)
    assert found.speed_hz == pytest.approx(HERTZ, rel=4e-4)
    assert error(found, angle) < 0.003


@pytest.mark.slow
@pytest.mark.parametrize(("orders", "mean", "motor"), [(SOUND, 400, (21.0, 24.0)), (EVEN, 400, (30.0,))])
def test_a_sound_disc_beside_lines_of_its_motor_is_followed(orders, mean, motor):
    current, angle = driven(orders, gain=0.02, motor=motor)
    found = follow_motor(current - 20 + mean, RATE, HERTZ)
    assert found.fits
    assert error(found, angle) < 0.003


@pytest.mark.slow
@pytest.mark.parametrize(
    ("orders", "mean", "multiple"),
    [
        (WORN, 20, 2.0), (WORN, 20, 0.5), (WORN, 20, 15 / 8), (WORN, 20, 16 / 15), (WORN, 400, 0.8),
        (SOUND, 20, 1.0), (EVEN, 20, 1.0),
    ],
)  # fmt: skip
def test_a_speed_does_not_fit_if_it_may_be_another(orders, mean, multiple):
    """Even lines that are large, against the mean current, are not those of a sound disc."""
    current, _ = driven(orders)
    assert not follow_motor(current - 20 + mean, RATE, multiple * HERTZ).fits


@pytest.mark.slow
def test_a_control_is_not_taken_for_one_that_answers_more():
    """A larger gain bends the lines, and so adds further ones, but also power between them."""
    made = make_rig_recordings(
        3, (2, 6), rig=rig_preset("R2"), speed_rpm=1200.0, load_nm=25.0, output_turns=2.05, random_state=1,
        with_angle=True, quantity="motor_current", sampling_rate=8000.0, kernel="auto",
    )  # fmt: skip
    errors = [error(follow_motor(one.torque, 8000.0, 20.0), one.angle) for one in made]
    assert np.median(errors) < 0.005


@pytest.mark.parametrize("beside", [[], [4.0, 2.0, 5.0, 2.0] * 75])
def test_nothing_is_followed_in_a_current_that_is_constant_but_for_its_ends(beside):
    assert follow_motor(np.r_[beside, np.full(32_000, 3.0), beside], RATE, HERTZ).evidence <= 0


def test_a_current_that_is_too_short_is_an_error():
    with pytest.raises(ValueError, match="too short to follow the speed"):
        follow_motor(np.ones(1_000), RATE, HERTZ)


@pytest.mark.slow
def test_recordings_of_current_without_a_tachometer_are_followed_so():
    current, angle = driven(WORN)
    recording = Recording(current, RATE, speed_rpm=60 * HERTZ, quantity="motor_current")
    turning = turning_of(recording, 15)
    assert not turning.doubt
    assert np.std(turning.angle - angle) < 2 * np.pi * 0.003
