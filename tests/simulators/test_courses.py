"""Speed and load over time, the tachometer, and where the sleeves touch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from reference_tools import SPEED, simulate_with

from cyclofeat.simulators import Courses, CycloidalGearbox, LobeDefects, SimulationRun, simulate
from cyclofeat.simulators.courses import DriveAndLoad
from cyclofeat.simulators.many import simulate_each

STEEL = CycloidalGearbox.steel()
HEALTHY = LobeDefects.healthy()
RATE = 100_000


def raw(gearbox: CycloidalGearbox = STEEL, defects: LobeDefects = HEALTHY, **options: Any) -> SimulationRun:
    return simulate_with(
        gearbox, defects, **{"duration": 0.3, "sampling_rate": RATE, "decimation": "pick"} | options
    )


def ramp_of_speed(t: np.ndarray) -> np.ndarray:
    return SPEED * np.clip(t / 0.2, 0, 1)


def ramp_of_load(t: np.ndarray) -> np.ndarray:
    return 22.0 * np.clip(t / 0.2, 0, 1)


# Speed and load ---------------------------------------------------------------------------------------------


def test_the_built_in_ramp_as_functions_gives_the_default_run() -> None:
    """But for the trapezoid rule at the end of the ramp, where the acceleration jumps."""
    default, given = raw(), raw(speed=ramp_of_speed, load=ramp_of_load)
    assert given.input_angle == pytest.approx(default.input_angle, abs=1e-8)
    assert np.all(np.abs(given.torque_out - default.torque_out) < 1e-5)
    # At the one step where the ramp ends the acceleration is the mean of both sides.
    assert np.sort(np.abs(given.torque_in - default.torque_in))[-4] < 1e-5


def test_numbers_are_reached_over_the_ramp() -> None:
    """As the gearbox's own values are."""
    given = raw(speed=40.0, load=10.0)
    own = raw(STEEL.replace(input_speed=40.0, load_torque=10.0))
    for name in ("input_angle", "torque_out", "torque_in", "output_speed"):
        assert np.array_equal(getattr(given, name), getattr(own, name))


@pytest.mark.parametrize(
    "courses",
    [
        Courses(),
        Courses(speed_fluctuation=0.7, load_fluctuation=1.5),
        Courses(speed=lambda t: 50 + np.sin(40 * t), load_fluctuation=lambda t: np.cos(300 * t)),
        Courses(speed_fluctuation=lambda t: np.sin(70 * t), load=lambda t: 5 + 20 * t),
        Courses(speed=lambda t: 40 + 9 * t, speed_fluctuation=0.2, load=lambda t: 7.0),
    ],
)
def test_pieces_are_the_course_to_the_last_bit(courses: Courses) -> None:
    gearbox = STEEL.replace(ramp_time=0.011)
    for n, step in ((301, 5e-5), (40, 1e-4)):
        whole = DriveAndLoad(gearbox, n, step, 0.3, courses).piece()
        for size in (1, 7, 100, n):
            pieces = DriveAndLoad(gearbox, n, step, 0.3, courses)
            for first in range(0, n - 1, size):
                last = min(first + size, n - 1)
                np.testing.assert_array_equal(pieces.piece(first, last), whole[:, first : last + 1])


def test_a_function_that_is_not_one_of_time_is_refused_in_pieces() -> None:
    random = np.random.default_rng(1)
    walks = Courses(load_fluctuation=lambda t: 0.01 * np.cumsum(random.normal(size=t.size)))
    simulate(STEEL, duration=0.01, courses=walks)
    arguments = {"gearbox": STEEL, "courses": walks, "duration": 0.4}
    with pytest.raises(ValueError, match="load_fluctuation must be a function of time alone: at 0.16"):
        list(simulate_each([arguments], "batch"))


@pytest.mark.parametrize("ramp", [0.0, 0.2])
def test_sine_fluctuation_of_the_speed_gives_the_analytic_angle(ramp: float) -> None:
    """phi = integral of ramp(t) (omega + a sin(w t))."""
    a, w = 3.0, 2 * np.pi * 7
    gearbox = STEEL.replace(ramp_time=ramp)
    time = np.arange(60_001) * 5e-6
    phi, omega, alpha, _ = DriveAndLoad(
        gearbox, time.size, 5e-6, 0.25, Courses(speed_fluctuation=lambda t: a * np.sin(w * t))
    ).piece()
    if ramp == 0:
        expected = 0.25 + SPEED * time + a / w * (1 - np.cos(w * time))
        speed, acceleration = SPEED + a * np.sin(w * time), a * w * np.cos(w * time)
    else:
        rising = np.minimum(time, ramp)
        # integral of t sin(w t) = sin(w t)/w^2 - t cos(w t)/w
        swing = (np.sin(w * rising) / w**2 - rising * np.cos(w * rising) / w) / ramp
        swing += np.where(time > ramp, (np.cos(w * ramp) - np.cos(w * np.maximum(time, ramp))) / w, 0)
        steady = np.where(time < ramp, time**2 / (2 * ramp), time - ramp / 2)
        expected = 0.25 + SPEED * steady + a * swing
        share = np.clip(time / ramp, 0, 1)
        speed = share * (SPEED + a * np.sin(w * time))
        acceleration = np.where(
            time < ramp,
            (SPEED + a * np.sin(w * time)) / ramp + share * a * w * np.cos(w * time),
            a * w * np.cos(w * time),
        )
    np.testing.assert_allclose(phi, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(omega, speed, rtol=0, atol=1e-9)
    smooth = (time > 1e-4) & (np.abs(time - ramp) > 1e-4) & (time < 0.2999)
    np.testing.assert_allclose(alpha[smooth], acceleration[smooth], rtol=0, atol=1e-4)


def test_fluctuating_speed_reaches_the_machine() -> None:
    """The input torque holds the wheels' inertia at the cams, 2 m e^2 alpha, and output's divided by z^2."""
    a, w = 5.0, 2 * np.pi * 7
    free = STEEL.replace(load_torque=0.0, ramp_time=0.0)
    swinging = raw(free, speed_fluctuation=lambda t: a * (1 - np.cos(w * t)), load=lambda t: 0.0 * t + 5.0)
    steady = raw(free, load=lambda t: 0.0 * t + 5.0)
    settled = slice(8_000, 28_000)
    time = swinging.time[settled]
    basis = np.column_stack([np.sin(w * time), np.cos(w * time), np.ones_like(time), time])
    (found, *_), *_ = np.linalg.lstsq(basis, swinging.torque_in[settled], rcond=None)
    (own, *_), *_ = np.linalg.lstsq(basis, steady.torque_in[settled], rcond=None)
    inertia = 2 * STEEL.wheel_mass * STEEL.eccentricity**2
    inertia += (2 * STEEL.wheel_inertia + STEEL.output_inertia) / 15**2
    assert found - own == pytest.approx(inertia * a * w, rel=0.03)


# Tachometer -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("defects", [HEALTHY, LobeDefects.worn(3)], ids=["healthy", "worn"])
def test_tachometer_shows_the_derivative_of_the_angle(defects: LobeDefects) -> None:
    run = raw(defects=defects)
    assert run.output_angle is not None
    assert run.output_speed is not None
    central = (run.output_angle[2:] - run.output_angle[:-2]) * RATE / 2
    # The third derivative of what the contacts do, and what a step of the midpoint rule is off.
    away = np.abs(central - run.output_speed[1:-1])[25_000:]
    assert away.max() < 2e-4
    assert np.ptp(run.output_speed[25_000:]) > 50 * away.max()
    assert run.output_speed[25_000:].mean() == pytest.approx(-SPEED / 15, rel=5e-3)


# Contact points ---------------------------------------------------------------------------------------------


def test_recorded_points_belong_to_the_recorded_forces() -> None:
    """External: on fixed circles. Internal: on circles that turn with the output; both wheels beside them."""
    run = raw(points=True, forces=True, duration=0.25, sampling_rate=1e4, defects=LobeDefects.worn(2))
    assert run.external_points is not None
    assert run.internal_points is not None
    assert run.external_forces is not None
    assert run.internal_forces is not None
    assert run.output_angle is not None
    assert np.array_equal(np.isfinite(run.external_points), run.external_forces > 0)
    assert np.array_equal(np.isfinite(run.internal_points), run.internal_forces > 0)
    outside = 64e-3 * np.exp(2j * np.pi * np.arange(16) / 16)
    inside = 36e-3 * np.exp(1j * (np.pi / 4 * np.arange(8) + run.output_angle[:, None, None]))
    for places, centres in ((run.external_points, outside), (run.internal_points, inside)):
        away = np.abs(places - centres)
        assert away[np.isfinite(away)] == pytest.approx(6e-3, abs=2e-9)
    # An internal sleeve touches its hole about where the cam's direction points from the hole's centre.
    cams = 2.8e-3 * np.exp(1j * run.input_angle)[:, None] * [1, -1]
    toward = (run.internal_points - inside) / 6e-3
    aligned = (toward * np.conj(cams[..., None] / 2.8e-3)).real
    assert np.nanmax(np.abs(np.abs(aligned) - 1)) < 0.01
