"""The reduced kernel against the papers' 28-body system: accelerations, torques, every force, a trajectory.

The two share nothing but the equations. Where the kernel describes its contacts anew both compute the feet of
the pins to rounding, and all must agree to 1e-9; along a trajectory the kernel's descriptions are up to 0.5
degrees of the input old, which costs 1e-5 of the largest force. Errors are shares of the largest contact
force, with the lever arm of the pins where they are torques.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from reference_tools import (
    SPEED,
    Kernel,
    State,
    kernel_state,
    kernels,
    midpoint_path,
    random_lobes,
    random_state,
)

from benchmarks.reference_gearbox import ReferenceGearbox
from cyclofeat.simulators import CycloidalGearbox, LobeDefects
from cyclofeat.simulators.tables import kernel_input

STEEL = CycloidalGearbox.steel()
OTHER = CycloidalGearbox(
    n_pins=14,
    eccentricity=1.5e-3,
    shortening=1.5e-3 * 14 / 34e-3,
    pin_radius=3.5e-3,
    internal_pitch_radius=20e-3,
    internal_sleeve_radius=9e-3,
    clearance=5e-5,
)
TORQUES = ("input_torque", "output_torque")
FORCES = ("external_force", "internal_force", "external_vector", "internal_vector")
HEALTHY = LobeDefects.healthy()


def displaced(gearbox: CycloidalGearbox, rng: np.random.Generator) -> CycloidalGearbox:
    """With pins off by 30 um and runout of 10 um."""
    radial, tangential = rng.normal(0, 3e-5, (2, gearbox.n_pins))
    runouts = rng.normal(0, 1e-5, (2, 2)) @ np.array([1, 1j])
    return gearbox.replace(pin_radial_errors=radial, pin_tangential_errors=tangential, wheel_runouts=runouts)


def worn(gearbox: CycloidalGearbox, rng: np.random.Generator) -> LobeDefects:
    wheels = [(0,), (1,), (0, 1)][rng.integers(3)]
    return LobeDefects.worn(
        random_lobes(rng, gearbox.n_lobes), wheels=wheels, depth=float(rng.choice([1.0, 0.5]))
    )


def in_operation(reference: ReferenceGearbox, rng: np.random.Generator) -> State:
    """Near the deflections under 22 Nm."""
    phi = rng.uniform(-50, 50)
    angles = reference.rest_angles(phi) + np.array([1.7e-3, 1.7e-3, 4.1e-3]) + rng.normal(0, 2e-4, 3)
    rates = -SPEED / reference.n_lobes + rng.normal(0, 0.3, 3)
    return State(phi, SPEED, rng.choice([0.0, 260.0]), angles, rates, 22.0)


def far_out(reference: ReferenceGearbox, rng: np.random.Generator) -> State:
    """Displaced by 0.5 to 1.7 mm, as where lobes of both wheels have been removed."""
    phi = rng.uniform(-50, 50)
    push = rng.choice([-1, 1]) * rng.uniform(0.014, 0.04)
    angles = reference.rest_angles(phi) + push + rng.normal(0, 1e-3, 3)
    return State(phi, SPEED, 0.0, angles, -SPEED / 15 + rng.normal(0, 1, 3), 22.0)


def errors(reference: ReferenceGearbox, kernel: Kernel, state: State) -> tuple[dict[str, float], np.ndarray]:
    """Errors of the kernel by name, and the reference's forces on the external sleeves."""
    gearbox = kernel.gearbox
    expected = reference.accelerations(*state)
    start = kernel_state(reference, state)
    got = kernel(start, state.phi, state.omega, state.alpha, state.load)
    force = max(expected.external_force.max(), expected.internal_force.max(), 1.0)
    lever = gearbox.pin_circle_radius
    scale = dict.fromkeys(FORCES, force) | dict.fromkeys(TORQUES, force * lever)
    scale["theta_acceleration"] = force * lever / gearbox.wheel_inertia
    scale["psi_acceleration"] = force * lever / gearbox.output_inertia
    away = {
        name: float(np.abs(got[name] - getattr(expected, name)).max() / unit) for name, unit in scale.items()
    }
    return away, expected.external_force


@pytest.mark.parametrize(
    ("state_of", "gearbox", "with_pins", "with_wear"),
    [
        (lambda g, r: random_state(g, r, 1e-4), STEEL, False, False),
        (lambda g, r: random_state(g, r, 1e-4), STEEL, False, True),
        (lambda g, r: random_state(g, r, 1e-4), OTHER, False, True),
        (in_operation, STEEL, False, False),
        (in_operation, STEEL, False, True),
        (in_operation, STEEL, True, False),
        (in_operation, STEEL, True, True),
        (lambda g, r: random_state(g, r, 1e-3), OTHER, False, True),
        (lambda g, r: random_state(g, r, 2e-3), STEEL, True, True),
        (far_out, STEEL, True, False),
    ],
    ids=[
        "small-healthy", "small-worn", "small-other-geometry", "operation-healthy", "operation-worn",
        "operation-pins", "operation-pins-worn", "other-geometry", "wide-pins-worn", "far-pins",
    ],
)  # fmt: skip
def test_kernel_agrees_with_the_papers_system(
    state_of: Callable[[ReferenceGearbox, np.random.Generator], State],
    gearbox: CycloidalGearbox,
    with_pins: bool,
    with_wear: bool,
) -> None:
    rng = np.random.default_rng(2)
    loaded = 0
    for _ in range(60):
        drawn = displaced(gearbox, rng) if with_pins else gearbox
        defects = worn(gearbox, rng) if with_wear else HEALTHY
        reference = ReferenceGearbox(drawn, defects)
        away, force = errors(reference, Kernel(drawn, defects), state_of(reference, rng))
        for name, error in away.items():
            assert error < 1e-9, name
        loaded += force.max() > 1
    assert loaded > 20


@pytest.mark.slow
@pytest.mark.parametrize(("push", "depth"), [(0.0, 1.0), (1e-4, 0.5), (-1e-4, 1.0)])
def test_kernel_agrees_all_along_a_worn_lobe(push: float, depth: float) -> None:
    """Vertex, chord, chord with the flank's end, chord with the flank: in steps of 0.1 degrees."""
    defects = LobeDefects.worn((3,), wheels=(1,), depth=depth)
    reference, kernel = ReferenceGearbox(STEEL, defects), Kernel(STEEL, defects)
    touched = 0
    for degrees in np.arange(-1.0, 25.0, 0.1):
        # Sleeve 8 touches wheel 1 at t = pi - theta_2.
        phi = 15 * np.deg2rad(72 + degrees) - np.pi
        angles = reference.rest_angles(phi) + np.array([0.0, push, 0.0])
        state = State(phi, SPEED, 0.0, angles, -SPEED / 15 + np.array([0.1, -0.2, 0.3]), 22.0)
        away, force = errors(reference, kernel, state)
        touched += force[1, 8] > 1
        assert max(away.values()) < 1e-9, degrees
    assert touched > 30


def run_both(
    gearbox: CycloidalGearbox, defects: LobeDefects, phi: float, n_steps: int
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Both models from the same loaded state at full speed, by the same midpoint rule."""
    dt, offset = 1e-5, np.array([1.7e-3, 1.7e-3, 4.1e-3])
    times = np.arange(2 * n_steps + 1) * dt / 2
    steady = np.full_like(times, SPEED)
    state = np.zeros(kernels.N_STATE)
    state[:3] = offset
    torques, motion = np.empty((n_steps, 2)), np.empty((n_steps, 8))
    external, internal = np.empty((n_steps + 1, 2, 16, 3)), np.empty((n_steps + 1, 2, 8, 3))
    finished = kernels.integrate(
        2, n_steps, dt, phi + SPEED * times, steady, 0 * times, np.full_like(times, 22.0), state,
        *kernel_input(gearbox, defects), kernels.new_memory(state), 1e4, 1e4, 1e4, torques,
        np.arange(n_steps), motion, external, internal,
    )  # fmt: skip
    assert finished == n_steps
    reference = ReferenceGearbox(gearbox, defects)
    start = np.append(reference.rest_angles(phi) + offset, [-SPEED / 15] * 3)
    angles, solutions = midpoint_path(reference, start, phi, dt, n_steps)
    rest = np.array([reference.rest_angles(phi + SPEED * time) for time in times[:-1:2]])
    fast = {
        "angles": motion[:, :3] + rest,
        "output_torque": torques[:, 0],
        "input_torque": torques[:, 1],
        "external_force": external[:-1, ..., 0],
        "internal_force": internal[:-1, ..., 0],
    }
    slow = {name: np.array([getattr(one, name) for one in solutions]) for name in fast if name != "angles"}
    return fast, {"angles": angles, **slow}


@pytest.mark.slow
@pytest.mark.parametrize("with_pins", [False, True])
def test_same_trajectory_through_an_impact(with_pins: bool) -> None:
    """14 ms in which the worn lobes of both wheels pass the load."""
    gearbox = displaced(STEEL, np.random.default_rng(3)) if with_pins else STEEL
    fast, slow = run_both(gearbox, LobeDefects.worn(1), phi=5.4, n_steps=1400)
    force = slow["external_force"].max()
    assert force > 600  # the impact is in
    assert slow["external_force"][-1].max() < 0.5 * force  # and over
    for name, tolerance in {
        "angles": 3e-8,
        "output_torque": 2e-4,
        "input_torque": 5e-5,
        "external_force": 2e-5 * force,
        "internal_force": 2e-6 * force,
    }.items():
        error = np.abs(fast[name] - slow[name]).max()
        assert error < tolerance, (name, error)
