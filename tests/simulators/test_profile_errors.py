"""Displaced lobes, clearance at the pins and polyline profiles: against outlines built point by point."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import naive
import numpy as np
import pytest
from reference_tools import PIT, PROBE, STIFFNESS, Kernel, pose_with_sleeve_0_at, sweep

from cyclofeat.simulators import CycloidalGearbox, LobeDefects, SimulationRun, Solver, simulate

STEEL = CycloidalGearbox.steel()
HEALTHY = LobeDefects.healthy()
R, Q, E = PROBE.pin_circle_radius, PROBE.pin_radius, PROBE.eccentricity


def depths(gearbox: CycloidalGearbox, push: tuple[float, float], phi: float) -> np.ndarray:
    """Penetration that the kernel's forces tell, (2 wheels, 16 pins), 0 where open; wheels turned by push."""
    force = Kernel(gearbox, HEALTHY)(np.array([*push, *np.zeros(6)]), phi)["external_force"]
    return np.asarray((force / STIFFNESS) ** (2 / 3))


def pins_in_wheel(
    gearbox: CycloidalGearbox, wheel: int, push: float, phi: float
) -> tuple[list[complex], list[float]]:
    """Centres of the pins in a wheel's own frame, and about where on the profile they lie."""
    theta = -(phi + math.pi) / 15 + wheel * math.pi + push
    cam = (-1) ** wheel * E * complex(math.cos(phi), math.sin(phi))
    radial = gearbox.pin_radial_errors or [0.0] * 16
    tangential = gearbox.pin_tangential_errors or [0.0] * 16
    found = []
    for j in range(16):
        beta = 2 * math.pi * j / 16
        pin = complex(R + radial[j], tangential[j]) * complex(math.cos(beta), math.sin(beta))
        found.append((pin - cam) * complex(math.cos(theta), -math.sin(theta)))
    return found, [2 * math.pi * j / 16 - theta for j in range(16)]


def point(t: float, depth: float = Q) -> complex:
    return naive.profile_point(t, E, 16, PROBE.shortening, depth)


def displaced(t: float, errors: list[float]) -> complex:
    angle = naive.pitch_error(t, errors)
    return point(t) * complex(math.cos(angle), math.sin(angle))


def true_depths(
    gearbox: CycloidalGearbox, push: tuple[float, float], phi: float, curves: list[Callable[[float], complex]]
) -> np.ndarray:
    """By the nearest of very many points of the outline of either wheel."""
    found = np.zeros((2, 16))
    for wheel, curve in enumerate(curves):
        pins, places = pins_in_wheel(gearbox, wheel, push[wheel], phi)
        for j, (pin, t) in enumerate(zip(pins, places, strict=True)):
            found[wheel, j] = Q - naive.distance_to_curve(pin, curve, t - 0.1, t + 0.1)
    return found


def assert_same_depths(got: np.ndarray, truth: np.ndarray, tolerance: float) -> int:
    assert np.all(got[truth < -tolerance] == 0)  # nothing pressed that does not touch
    assert np.all(got[truth > tolerance] > 0)  # nothing missed
    touching = truth > tolerance
    assert np.all(np.abs(got - truth)[touching] < tolerance)
    return int(touching.sum())


# Pitch errors -----------------------------------------------------------------------------------------------


def errors_of(rng: np.random.Generator, size: float) -> np.ndarray:
    return rng.normal(0, size, 30)


def pitch_error_of_depth(size: float, n: int = 6) -> float:
    """Largest error of the kernel's penetration with pitch errors of ``size`` in m."""
    rng = np.random.default_rng(31)
    worst = 0.0
    for _ in range(n):
        errors = errors_of(rng, size)
        gearbox = PROBE.replace(lobe_pitch_errors=errors)
        push = tuple(rng.normal(0, 1.5e-3, 2))
        phi = rng.uniform(-20, 20)
        angles = (errors / R).reshape(2, 15).tolist()
        curves = [functools.partial(displaced, errors=one) for one in angles]
        truth = true_depths(gearbox, push, phi, curves)
        got = depths(gearbox, push, phi)
        touching = (truth > 1e-6) & (got > 0)
        assert touching.sum() > 8
        worst = max(worst, float(np.abs(got - truth)[touching].max()))
    return worst


@pytest.mark.slow
def test_depth_on_displaced_lobes() -> None:
    """Exact to first order in the errors: what is left falls with their square."""
    worst = {size: pitch_error_of_depth(size) for size in (2e-5, 1e-5)}
    # A tilt of 0.01 rad between two lobes, squared, on half a pin's radius.
    assert worst[2e-5] < 3e-7
    assert worst[1e-5] < 0.35 * worst[2e-5]


def test_a_lobes_pitch_error_moves_that_lobe_and_the_flank_before_it() -> None:
    """From the pit before its tip to the pit after it; by less force where it gives way to the load."""
    push = 2e-3
    gearbox = PROBE.replace(lobe_pitch_errors=np.eye(30)[4] * 2e-5)
    for degrees in np.arange(0.5, 360, 4.0):
        phi = pose_with_sleeve_0_at(np.deg2rad(degrees))
        change = depths(gearbox, (push, push), phi) - depths(PROBE, (push, push), phi)
        place = np.array([(2 * np.pi * j / 16 - 0 + np.deg2rad(degrees)) / (2 * PIT) for j in range(16)]) % 15
        reached = (place > 3.45) & (place < 4.6)
        assert np.all(change[0][~reached] == 0)
        assert np.all(change[1] == 0)


@functools.cache
def raw(gearbox: CycloidalGearbox, defects: LobeDefects = HEALTHY, **options: Any) -> SimulationRun:
    return simulate(
        gearbox, defects, sampling_rate=1e5, solver=Solver(decimation="pick"), **{"duration": 0.45} | options
    )


@pytest.mark.slow
@pytest.mark.parametrize("push", [0.0, 2e-3, -2e-3])
@pytest.mark.parametrize(
    "defects",
    [
        HEALTHY,
        LobeDefects.worn(2, wheels=(0,)),
        LobeDefects.worn((0,), depth=0.5),
        LobeDefects(worn_lobes=(1,), removed_lobes=(0,)),
    ],
    ids=["healthy", "worn", "partly", "beside a removed one"],
)
def test_force_on_displaced_lobes_has_no_jump(defects: LobeDefects, push: float) -> None:
    """Over borders, tips and pits of three lobes: where the change is largest it shrinks with the steps."""
    errors = np.zeros(30)
    errors[:4] = 3e-5, -3e-5, 2e-5, -1e-5
    gearbox = STEEL.replace(lobe_pitch_errors=errors, pin_radial_errors=[-2e-5] * 16)
    t = np.deg2rad(np.arange(-3.0, 50.0, 0.04) + 1e-4)
    force = sweep(gearbox, defects, t, push)
    assert force[:, 0].max() > (0.3 if push == 0 else 20)
    changes = np.abs(np.diff(force, axis=0))
    for column in (0, 1):
        worst = int(np.argmax(changes[:, column]))
        fine = sweep(gearbox, defects, np.linspace(t[worst], t[worst + 1], 11), push)
        assert np.abs(np.diff(fine[:, column])).max() < 0.2 * changes[worst, column]


def worn_depths(pin: complex, error: float) -> tuple[float, float]:
    """Penetrations into chord and flank of worn lobe 0 that is displaced by the angle ``error``."""
    turn = complex(math.cos(error), -math.sin(error))
    tip, pit = point(0.0), point(PIT)
    # The chord's line goes on beyond the pit, where the corner is re-entrant.
    end = tip + 1.2 * (pit - tip)
    chord = Q - naive.distance_to_curve(pin * turn, lambda s: tip + s * (end - tip), 0.0, 1.0)
    flank = Q - naive.distance_to_curve(pin * turn, point, PIT, PIT + 0.1)
    return max(chord, 0.0), max(flank, 0.0)


@pytest.mark.parametrize("error", [0.0, 4e-5, -4e-5])
def test_worn_lobe_is_displaced_as_a_whole(error: float) -> None:
    """Chord, vertex and flank's end against the nearest of many points; the next lobe has the same error."""
    gearbox = PROBE.replace(lobe_pitch_errors=[error, error, *[0.0] * 28])
    kernel = Kernel(gearbox, LobeDefects.worn(1, wheels=(0,)))
    push = -1e-3
    both = 0
    for degrees in np.arange(1.0, 14.4, 0.2):
        phi = pose_with_sleeve_0_at(np.deg2rad(degrees))
        pins, _ = pins_in_wheel(PROBE, 0, push, phi)
        chord, flank = worn_depths(pins[0], error / R)
        got = kernel(np.array([push, *np.zeros(7)]), phi)["external_force"][0, 0]
        expected = STIFFNESS * (chord**1.5 + flank**1.5)
        assert got == pytest.approx(expected, rel=2e-3, abs=1e-3)
        both += chord > 0 and flank > 0
    assert both >= 3


# Clearance --------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("clearance", [1e-6, 1e-5, 1e-4])
def test_depth_with_clearance(clearance: float) -> None:
    """The outline lies so much deeper: exact."""
    rng = np.random.default_rng(33)
    gearbox = PROBE.replace(
        pin_clearance=clearance,
        pin_radial_errors=rng.normal(0, 2e-5, 16),
        pin_tangential_errors=rng.normal(0, 2e-5, 16),
    )
    curves = [functools.partial(point, depth=Q + clearance)] * 2
    touching = 0
    for _ in range(8):
        push, phi = tuple(rng.normal(0, 4e-3, 2)), rng.uniform(-20, 20)
        truth = true_depths(gearbox, push, phi, curves)
        touching += assert_same_depths(depths(gearbox, push, phi), truth, 2e-9)
    assert touching > 30


def test_clearance_is_taken_up_by_the_loaded_side() -> None:
    """Under load the output lags behind by half of each dead zone, and the torque stays what it is."""
    plain, loose = raw(STEEL), raw(STEEL.replace(pin_clearance=2e-5))
    settled = slice(35_000, None)
    assert plain.output_angle is not None
    assert loose.output_angle is not None
    lag = (loose.output_angle - plain.output_angle)[settled].mean()
    assert lag == pytest.approx(2e-5 / (E * 15), rel=0.25)
    assert loose.torque_out[settled].mean() == pytest.approx(22, abs=1e-2)


# Pins far out -----------------------------------------------------------------------------------------------


def test_gap_does_not_jump_where_the_kernel_begins_to_search() -> None:
    """Just below and just above the displacement of 0.7 times the trochoid's radius at the pit."""
    limit = 0.7 / abs(float(PROBE.profile.curvature(PIT)))
    rng = np.random.default_rng(13)
    for _ in range(40):
        direction, phi = np.exp(2j * np.pi * rng.random(16)), rng.uniform(-20, 20)
        beside = [limit * (1 + sign * 1e-9) * direction for sign in (-1, 1)]
        below, above = (
            depths(PROBE.replace(pin_radial_errors=one.real, pin_tangential_errors=one.imag), (0, 0), phi)
            for one in beside
        )
        assert np.abs(below - above).max() < 1e-11


# Polyline ---------------------------------------------------------------------------------------------------


def corners(n: int) -> list[complex]:
    return [point(2 * math.pi * k / n) for k in range(n)]


@pytest.mark.parametrize("n", [60, 150, 721])
def test_depth_on_a_polyline(n: int) -> None:
    rng = np.random.default_rng(34)
    gearbox, outline = PROBE.replace(profile_points=n), corners(n)
    touching = 0
    for _ in range(3):
        push, phi = tuple(rng.normal(0, 3e-3, 2)), rng.uniform(-20, 20)
        truth = np.array(
            [
                [
                    Q - naive.distance_to_polyline(p, outline)
                    for p in pins_in_wheel(gearbox, w, push[w], phi)[0]
                ]
                for w in (0, 1)
            ]
        )
        touching += assert_same_depths(depths(gearbox, push, phi), truth, 1e-10)
    assert touching > 20


def test_fine_polylines_converge_to_the_profile() -> None:
    """Chords cut off spacing^2 curvature / 8: four times less for half the spacing."""
    rng = np.random.default_rng(35)
    poses = [(tuple(rng.uniform(1e-3, 4e-3, 2)), phi) for phi in rng.uniform(-20, 20, 60)]
    away = []
    for n in (1500, 3000, 6000):
        gearbox = PROBE.replace(profile_points=n)
        change = [depths(gearbox, *pose) - depths(PROBE, *pose) for pose in poses]
        away.append(float(np.abs(change).mean()))
    assert away[0] / away[1] == pytest.approx(4, rel=0.15)
    assert away[1] / away[2] == pytest.approx(4, rel=0.15)
