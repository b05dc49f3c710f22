"""The 28-body system against finite differences, brute force, statics, power, and the hand-made reduction."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.optimize import brentq, root
from threadpoolctl import threadpool_limits

from cyclofeat.simulators.reference import (
    ReferenceGearbox,
    Solution,
    ramped_driver,
    ramped_load,
)

SPEED = 52.36
PIT = math.pi / 15
CONSECUTIVE = tuple(range(7))


@pytest.fixture(autouse=True)
def _one_blas_thread() -> Iterator[None]:
    """A 141 x 141 solve is too small to share: threads only make it slower."""
    with threadpool_limits(1):
        yield


class State(NamedTuple):
    phi: float
    omega: float
    alpha: float
    angles: np.ndarray
    rates: np.ndarray
    load: float


def random_state(gearbox: ReferenceGearbox, rng: np.random.Generator) -> State:
    """A state near the rest position, penetrations of some 0.1 mm."""
    phi = rng.uniform(-50, 50)
    omega, alpha = rng.normal(0, SPEED), rng.normal(0, 260)
    angles = gearbox.rest_angles(phi) + rng.normal(0, 2e-3, 3)
    rates = -omega / gearbox.n_lobes + rng.normal(0, 1, 3)
    return State(phi, omega, alpha, angles, rates, rng.normal(0, 22))


def random_gearbox(rng: np.random.Generator, **parameters: Any) -> ReferenceGearbox:
    worn = tuple(tuple(int(lobe) for lobe in np.flatnonzero(rng.random(15) < 0.5)) for _ in range(2))
    parameters = {"worn_lobes": worn, "pin_errors": rng.normal(0, 2e-5, (16, 2))} | parameters
    return ReferenceGearbox(**parameters)


def dot(a: complex, b: complex) -> float:
    return (a * b.conjugate()).real


def cross(a: complex, b: complex) -> float:
    return (a.conjugate() * b).imag


# The reduction, written naively -----------------------------------------------------------------------------


def naive_foot(z: int, e: float, m: float, p: complex, start: float) -> float:
    def trochoid(t: float | np.ndarray) -> Any:
        return e * z / m * np.exp(1j * t) + e * np.exp(1j * z * t)

    def ahead(t: float) -> float:
        return dot(p - trochoid(t), 1j * e * z * cmath.exp(1j * t) * (1 / m + cmath.exp(1j * (z - 1) * t)))

    t = start + np.linspace(-0.1, 0.1, 1001)
    nearest = t[np.argmin(np.abs(p - trochoid(t)))]
    return float(brentq(ahead, nearest - 2e-4, nearest + 2e-4, xtol=1e-16, rtol=1e-15))


def naive_law(g: ReferenceGearbox, gap: float, gap_rate: float, radius: float) -> float:
    if gap >= 0:
        return 0.0
    h_c = (1 - g.wheel_poisson**2) / (math.pi * g.wheel_young)
    h_p = (1 - g.sleeve_poisson**2) / (math.pi * g.sleeve_young)
    k = 4 * g.stiffness_scale / (3 * math.pi * (h_c + h_p)) * math.sqrt(radius)
    share = min(1.0, -gap / 1e-5)
    return max(0.0, share * k * (-gap) ** 1.5 - share * g.contact_damping * gap_rate)


def naive_outline(
    g: ReferenceGearbox, worn: tuple[int, ...], p: complex, rate: complex, start: float
) -> tuple[float, complex]:
    """Sum of magnitudes, and force on the sleeve, of one external sleeve on one wheel (wheel frame)."""
    z, e, m, q = g.n_pins, g.eccentricity, g.shortening, g.pin_radius

    def normal(t: float) -> complex:
        direction = cmath.exp(1j * t) * (1 / m + cmath.exp(1j * (z - 1) * t))
        return direction / abs(direction)

    def trochoid(t: float) -> complex:
        return e * z / m * cmath.exp(1j * t) + e * cmath.exp(1j * z * t)

    def effective_radius(t: float) -> float:
        size = abs(1 / m + cmath.exp(1j * (z - 1) * t))
        kappa = (1 + (z - 1) * (1 + math.cos((z - 1) * t) / m) / size**2) / (e * z * size)
        return 1 / (1 / (1 / kappa - q) + 1 / q)

    t = naive_foot(z, e, m, p, start)
    on_profile, total, force = True, 0.0, 0j
    for lobe in worn:
        tip, pit = 2 * math.pi * lobe / (z - 1), 2 * math.pi * (lobe + 0.5) / (z - 1)
        if abs((t - pit + math.pi) % (2 * math.pi) - math.pi) > math.pi / (z - 1):
            continue  # the half planes below hold near this lobe only
        a = trochoid(tip) - q * normal(tip)
        b = trochoid(pit) - q * normal(pit)
        along = (b - a) / abs(b - a)
        past_tip, past_pit = dot(p - a, 1j * normal(tip)) >= 0, dot(p - b, 1j * normal(pit)) >= 0
        on_profile = not past_tip or past_pit
        if not past_tip:
            continue
        n, gap, radius = -1j * along, dot(p - a, -1j * along) - q, q
        if dot(p - a, along) < 0:
            gap, n = abs(p - a) - q, (p - a) / abs(p - a)
            turned = cmath.phase(n / normal(tip)) / cmath.phase(-1j * along / normal(tip))
            radius = (1 - turned) * effective_radius(tip) + turned * q
        magnitude = naive_law(g, gap, dot(rate, n), radius)
        total, force = total + magnitude, force + magnitude * n
    if on_profile:
        n = normal(t)
        magnitude = naive_law(g, dot(p - trochoid(t), n), dot(rate, n), effective_radius(t))
        total, force = total + magnitude, force + magnitude * n
    return total, force


def naive_reduction(g: ReferenceGearbox, state: State) -> dict[str, Any]:
    """Diagonal mass matrix, joints solved by hand; every multiplier by the balance of its body."""
    phi, omega, alpha, angles, rates, load = state
    z, e, pitch = g.n_pins, g.eccentricity, g.internal_pitch_radius
    psi, psi_rate = angles[2], rates[2]
    pins = [e * z / g.shortening * cmath.exp(2j * math.pi * j / z) for j in range(z)]
    if g.pin_errors is not None:
        pins = [pin + complex(*error) for pin, error in zip(pins, np.asarray(g.pin_errors), strict=True)]
    sleeves = [pitch * cmath.exp(1j * (psi + math.pi * i / 4)) for i in range(8)]
    play = e + g.clearance
    hole_radius = g.internal_sleeve_radius + play
    external = np.zeros((2, z))
    internal = np.zeros((2, 8))
    external_vector = np.zeros((2, z), dtype=complex)
    internal_vector = np.zeros((2, 8), dtype=complex)
    theta_acceleration, reactions, cams = [], [], []
    for k in range(2):
        theta, rate = angles[k], rates[k]
        c = e * cmath.exp(1j * (phi + k * math.pi))
        c_rate = 1j * omega * c
        turn = cmath.exp(1j * theta)
        for j, pin in enumerate(pins):
            p, p_rate = (pin - c) / turn, (-c_rate - 1j * rate * (pin - c)) / turn
            start = 2 * math.pi * j / z - theta
            external[k, j], on_sleeve = naive_outline(g, g.worn_lobes[k], p, p_rate, start)
            external_vector[k, j] = -on_sleeve * turn
        for i, sleeve in enumerate(sleeves):
            # theta + pi/15 (wheel 0) and theta + pi/15 - pi (wheel 1) equal psi in the rest position
            arm = pitch * cmath.exp(1j * (theta + math.pi * i / 4 + math.pi / (z - 1) - k * math.pi))
            d = sleeve - c - arm
            d_rate = 1j * psi_rate * sleeve - c_rate - 1j * rate * arm
            n = d / abs(d)
            radius = g.internal_sleeve_radius * hole_radius / (hole_radius - g.internal_sleeve_radius)
            internal[k, i] = naive_law(g, play - abs(d), -dot(d_rate, n), radius)
            internal_vector[k, i] = internal[k, i] * n
        moment = sum(cross(pin - c, force) for pin, force in zip(pins, external_vector[k], strict=True))
        moment += sum(cross(s - c, force) for s, force in zip(sleeves, internal_vector[k], strict=True))
        theta_acceleration.append(moment / g.wheel_inertia)
        a_c = (1j * alpha - omega**2) * c
        reactions.append(g.wheel_mass * a_c - external_vector[k].sum() - internal_vector[k].sum())
        cams.append(c)
    j_out = g.output_shaft_inertia + 8 * g.sleeve_mass * pitch**2
    on_output = -internal_vector.sum(axis=0)
    moment_out = sum(cross(s, force) for s, force in zip(sleeves, on_output, strict=True))
    psi_acceleration = (load + moment_out) / j_out
    input_torque = sum(cross(c, r) for c, r in zip(cams, reactions, strict=True))
    sleeve_joints = [
        g.sleeve_mass * (1j * psi_acceleration - psi_rate**2) * s - force
        for s, force in zip(sleeves, on_output, strict=True)
    ]
    joints = [sum(reactions), sum(sleeve_joints), *reactions, *sleeve_joints, *external_vector.sum(axis=0)]
    driver = input_torque + g.input_shaft_inertia * alpha
    return {
        "theta_acceleration": np.array(theta_acceleration),
        "psi_acceleration": psi_acceleration,
        "multipliers": np.array([*(part for joint in joints for part in (joint.real, joint.imag)), driver]),
        "cam_reactions": np.array([[r.real, r.imag] for r in reactions]),
        "input_torque": input_torque,
        "driver_torque": driver,
        "output_torque": load - j_out * psi_acceleration,
        "external_force": external,
        "internal_force": internal,
        "external_vector": np.stack([external_vector.real, external_vector.imag], axis=-1),
        "internal_vector": np.stack([internal_vector.real, internal_vector.imag], axis=-1),
    }


def assert_reduction_agrees(gearbox: ReferenceGearbox, state: State) -> Solution:
    solution = gearbox.accelerations(*state)
    for name, expected in naive_reduction(gearbox, state).items():
        got = np.asarray(getattr(solution, name))
        error = np.abs(got - expected).max()
        assert error <= 1e-9 * np.abs(expected).max() + 1e-15, (name, error, expected)
    return solution


def test_reduction_agrees_with_the_full_system() -> None:
    loaded = 0
    for seed in range(48):
        rng = np.random.default_rng(seed)
        gearbox = random_gearbox(rng, clearance=rng.choice([0.0, 3e-5]))
        solution = assert_reduction_agrees(gearbox, random_state(gearbox, rng))
        loaded += solution.external_force.max() > 10 and solution.internal_force.max() > 10
    assert loaded > 36  # the comparison is not one of zeros


def test_reduction_agrees_for_another_geometry() -> None:
    rng = np.random.default_rng(0)
    gearbox = ReferenceGearbox(
        n_pins=14,
        eccentricity=1.5e-3,
        shortening=0.75,
        pin_radius=2.5e-3,
        internal_pitch_radius=18e-3,
        wheel_young=2.2e9,
        wheel_poisson=0.37,
        worn_lobes=((0, 12), (5,)),
    )
    for _ in range(4):
        assert_reduction_agrees(gearbox, random_state(gearbox, rng))


@pytest.mark.parametrize("degrees", [0.0, 0.5, 1.7, 1.9, 6.0, 11.9, 12.1, 13.2, 13.5, 23.9])
def test_reduction_agrees_all_along_a_worn_lobe(degrees: float) -> None:
    gearbox = ReferenceGearbox(worn_lobes=((0,), ()))
    phi, angles = pose_with_sleeve_0_at(gearbox, math.radians(degrees))
    angles += [4e-4, 3e-4, 3e-3]
    rates = -np.array([1, 1, 1]) * SPEED / 15
    assert_reduction_agrees(gearbox, State(phi, SPEED, 0.0, angles, rates, 22.0))


# Bodies and joints ------------------------------------------------------------------------------------------


def test_counts_are_those_of_the_paper() -> None:
    gearbox = ReferenceGearbox()
    u = gearbox.coordinates(0.0, gearbox.rest_angles(0.0))
    assert gearbox.n_bodies == 28
    assert gearbox.jacobian(u).shape == (57, 84)
    masses = np.diag(gearbox.mass_matrix).reshape(28, 3)
    assert masses[:, 0].sum() == pytest.approx(0.2341 + 1.6345 + 2 * 0.5998 + 24 * 0.048)
    assert masses[:, 2].sum() == pytest.approx(1.846e-6 + 1.373e-4 + 2 * 1.57538e-4 + 24 * 1.1013e-5)


@pytest.mark.parametrize("phi", [0.0, 0.3, 2.5, -40.0])
def test_rest_position_touches_everywhere_and_loads_nothing(phi: float) -> None:
    gearbox = ReferenceGearbox()
    angles = gearbox.rest_angles(phi)
    u = gearbox.coordinates(phi, angles)
    assert np.abs(gearbox.constraints(u, phi)).max() < 1e-15
    at = u.reshape(-1, 3)[:, :2] @ [1, 1j]
    p = (at[12:] - at[2:4, None]) * np.exp(-1j * angles[:2, None])
    assert np.abs(p - gearbox.trochoid(gearbox.foot_point(p))).max() < 1e-16 * 1e3
    assert np.exp(15j * angles[1]) == pytest.approx(np.exp(15j * (angles[0] + np.pi)))
    solution = gearbox.accelerations(phi, 0.0, 0.0, angles, np.zeros(3), 0.0)
    assert solution.external_force.max() < 1e-6
    assert solution.internal_force.max() < 1e-6


def test_both_wheels_are_equal_parts() -> None:
    """Turned half a turn, four holes on, wheel 1 has the holes of wheel 0."""
    holes = ReferenceGearbox()._holes
    assert np.roll(holes[1], -4) == pytest.approx(holes[0], abs=1e-16)


def test_constraints_and_their_derivatives() -> None:
    rng = np.random.default_rng(1)
    gearbox = random_gearbox(rng)
    state = random_state(gearbox, rng)
    u = gearbox.coordinates(state.phi, state.angles)
    v = gearbox.velocities(u, state.omega, state.rates)
    d = gearbox.jacobian(u)
    assert np.abs(gearbox.constraints(u, state.phi)).max() < 1e-15
    velocity_constraints = d @ v
    velocity_constraints[-1] -= state.omega
    assert np.abs(velocity_constraints).max() < 1e-13

    elsewhere = u + rng.normal(0, 0.1, u.size)  # the Jacobian must hold off the constraints, too
    step = 1e-6
    columns = [
        (gearbox.constraints(elsewhere + h, 0.0) - gearbox.constraints(elsewhere - h, 0.0)) / (2 * step)
        for h in step * np.eye(u.size)
    ]
    assert gearbox.jacobian(elsewhere) == pytest.approx(np.transpose(columns), abs=1e-9)

    # d2Phi/dt2 = D u'' + (dD/dt) u' = 0, so gamma = -(dD/dt) u' where the driver has no part
    step = 1e-7
    d_rate = (gearbox.jacobian(u + step * v) - gearbox.jacobian(u - step * v)) / (2 * step)
    gamma = gearbox.gamma(u, v, state.alpha)
    assert gamma[:-1] == pytest.approx(-(d_rate @ v)[:-1], abs=1e-6 * np.abs(gamma[:-1]).max())
    assert gamma[-1] == state.alpha
    solution = gearbox.accelerations(*state)
    assert d @ solution.accelerations == pytest.approx(gamma, abs=1e-9 * np.abs(gamma).max())


def test_sleeves_do_not_spin() -> None:
    rng = np.random.default_rng(2)
    gearbox = random_gearbox(rng)
    solution = gearbox.accelerations(*random_state(gearbox, rng))
    spins = solution.accelerations.reshape(-1, 3)[4:, 2]
    assert np.abs(spins).max() <= 1e-12 * np.abs(solution.accelerations).max()


# Profile ----------------------------------------------------------------------------------------------------


def test_foot_point_against_brute_force() -> None:
    rng = np.random.default_rng(3)
    gearbox = ReferenceGearbox()
    t = rng.uniform(0, 2 * np.pi, 200)
    p = gearbox.trochoid(t) + rng.uniform(-1.3e-3, 4e-4, t.size) * gearbox.normal(t)
    foot = gearbox.foot_point(p)
    fine = np.linspace(0, 2 * np.pi, 1_000_000)
    outline = gearbox.trochoid(fine)
    found = np.abs(p - gearbox.trochoid(foot))
    for point, distance, parameter in zip(p, found, foot, strict=True):
        distances = np.abs(point - outline)
        best = np.argmin(distances)
        assert abs(cmath.phase(cmath.exp(1j * (parameter - fine[best])))) < 5e-5
        assert distances[best] - 1e-8 < distance <= distances[best] + 1e-17
    along = (p - gearbox.trochoid(foot)) * np.conj(1j * gearbox.normal(foot))
    assert np.abs(along.real).max() < 1e-16 * 2


def test_foot_point_beyond_the_centre_of_curvature() -> None:
    """At the pit the trochoid's radius is 0.57 mm: farther out the nearest points are two and lie aside."""
    gearbox = ReferenceGearbox()
    p = gearbox.trochoid(PIT) + np.array([0.3e-3, 0.9e-3]) * gearbox.normal(PIT)
    near, far = gearbox.foot_point(p)
    assert near == pytest.approx(PIT, abs=1e-12)
    assert abs(far - PIT) > 0.01
    assert abs(p[1] - gearbox.trochoid(far)) < 0.9e-3


def test_profile_is_the_papers_equation_and_curves_as_it_should() -> None:
    gearbox = ReferenceGearbox()
    t = np.linspace(0, 2 * np.pi, 500)
    turn = np.arctan(np.sin(15 * t) / (1 / 0.7 + np.cos(15 * t)))
    u = 0.064 * np.cos(t) + 0.0028 * np.cos(16 * t) - 0.006 * np.cos(t + turn)
    v = 0.064 * np.sin(t) + 0.0028 * np.sin(16 * t) - 0.006 * np.sin(t + turn)
    assert np.abs(gearbox.profile(t) - (u + 1j * v)).max() < 1e-16
    radius = 1e3 * (1 / gearbox.curvature([0.0, np.deg2rad(6.38), PIT]) - 0.006)
    assert radius == pytest.approx([9.16, 7.12, -6.57], abs=0.006)


def test_chord_of_a_worn_lobe() -> None:
    gearbox = ReferenceGearbox()
    t = np.linspace(0, PIT, 10_001)
    outline = gearbox.profile(t)
    chord = outline[-1] - outline[0]
    height = ((outline - outline[0]) * np.conj(-1j * chord / abs(chord))).real
    assert abs(chord) == pytest.approx(13.34e-3, abs=5e-6)
    assert height.max() == pytest.approx(1.25e-3, abs=5e-6)
    assert height.min() == pytest.approx(-0.35e-3, abs=5e-6)


# Contact ----------------------------------------------------------------------------------------------------


def test_normal_force_law() -> None:
    gearbox = ReferenceGearbox()
    stiffness = 4 * 0.01 / (3 * 2 * (1 - 0.09) / 200e9) * math.sqrt(0.006)
    depth = np.array([1e-4, 1e-5, 5e-6])
    expected = stiffness * depth**1.5 * [1, 1, 0.5]
    still = np.zeros(3)
    assert gearbox.normal_force(-depth, still, 0.006) == pytest.approx(expected)
    assert gearbox.normal_force(-depth, still - 1e-3, 0.006) == pytest.approx(
        expected + 0.15 * np.array([1, 1, 0.5])
    )
    assert np.all(gearbox.normal_force(-depth, still + 1e3, 0.006) == 0)  # never tensile
    assert np.all(gearbox.normal_force(depth, still - 1e3, 0.006) == 0)


def pose_with_sleeve_0_at(gearbox: ReferenceGearbox, t: float) -> tuple[float, np.ndarray]:
    """Input angle and angles of the rest position that brings sleeve 0 to parameter ``t`` of wheel 0."""
    phi = 15 * t - math.pi
    return phi, gearbox.rest_angles(phi)


def forces_on_sleeve_0(
    gearbox: ReferenceGearbox, t: np.ndarray, push: float
) -> tuple[np.ndarray, np.ndarray]:
    """Magnitudes and vectors of the contact with wheel 0, turned by ``push`` from the rest position."""
    forces = []
    for parameter in t:
        phi, angles = pose_with_sleeve_0_at(gearbox, parameter)
        u = gearbox.coordinates(phi, angles + np.array([push, 0, 0]))
        magnitude, vector, _, _ = gearbox.contact_forces(u, np.zeros_like(u))
        forces.append((magnitude[0, 0], vector[0, 0]))
    magnitudes, vectors = zip(*forces, strict=True)
    return np.array(magnitudes), np.array(vectors)


@pytest.mark.parametrize("push", [0.0, 2e-3, -5e-4])
def test_force_on_a_worn_lobe_is_continuous(push: float) -> None:
    gearbox = ReferenceGearbox(worn_lobes=((0,), ()))
    t = np.deg2rad(np.arange(-0.5, 24.5, 0.02) + 1e-4)
    magnitudes, vectors = forces_on_sleeve_0(gearbox, t, push)
    assert magnitudes.max() > 400  # the chord stands a third of a millimetre proud near the pit
    assert np.abs(np.diff(vectors)).max() < 0.03 * magnitudes.max()


def test_chord_carries_from_9_2_to_13_3_degrees_in_the_rest_position() -> None:
    gearbox = ReferenceGearbox(worn_lobes=((0,), ()))
    degrees = np.array([0.5, 3.0, 9.2, 9.3, 12.0, 13.3, 13.4, 20.0])
    magnitudes, _ = forces_on_sleeve_0(gearbox, np.deg2rad(degrees), 0.0)
    assert (magnitudes > 1e-3).tolist() == ((degrees > 9.25) & (degrees < 13.33)).tolist()


def test_flank_carries_with_the_chord_past_the_pit() -> None:
    """Pressed towards the flank, a sleeve past the pit has two contacts, whose magnitudes add up."""
    worn, healthy = ReferenceGearbox(worn_lobes=((0,), ())), ReferenceGearbox()
    t = np.deg2rad([12.5, 13.0])
    push = -2e-3
    both, both_vector = forces_on_sleeve_0(worn, t, push)
    flank, flank_vector = forces_on_sleeve_0(healthy, t, push)
    assert np.all(flank > 1e-3)
    assert both - flank == pytest.approx(np.abs(both_vector - flank_vector), rel=1e-9)
    assert np.all(both > flank)


@pytest.mark.parametrize(("wheel", "lobe"), [(0, 0), (0, 7), (1, 0), (1, 14)])
def test_worn_wheels_and_lobes_are_the_ones_asked_for(wheel: int, lobe: int) -> None:
    """Equal lobes of the two wheels act at the same moment, on opposite sleeves."""
    gearbox = ReferenceGearbox(worn_lobes=((lobe,), ()) if wheel == 0 else ((), (lobe,)))
    phi, angles = pose_with_sleeve_0_at(gearbox, (2 * lobe + 0.9) * PIT)
    u = gearbox.coordinates(phi, angles)
    force, _, _, _ = gearbox.contact_forces(u, np.zeros_like(u))
    assert np.argwhere(force > 1e-3).tolist() == [[wheel, 8 * wheel]]


# Balance ----------------------------------------------------------------------------------------------------


def static_equilibrium(gearbox: ReferenceGearbox, phi: float, load: float) -> np.ndarray:
    def unbalanced(offset: np.ndarray) -> np.ndarray:
        angles = gearbox.rest_angles(phi) + 1e-3 * offset
        solution = gearbox.accelerations(phi, 0.0, 0.0, angles, np.zeros(3), load)
        return 1e-4 * np.append(solution.theta_acceleration, solution.psi_acceleration)

    found = root(unbalanced, [1.0, 1.0, 3.0], tol=1e-13)
    assert np.abs(unbalanced(found.x)).max() < 1e-7
    return gearbox.rest_angles(phi) + 1e-3 * found.x


@pytest.mark.parametrize("worn", [((), ()), (CONSECUTIVE, ()), (CONSECUTIVE, CONSECUTIVE)])
@pytest.mark.parametrize("phi", [0.1, 1.4])
def test_statics(worn: tuple[tuple[int, ...], tuple[int, ...]], phi: float) -> None:
    gearbox = ReferenceGearbox(worn_lobes=worn)
    load = 22.0
    angles = static_equilibrium(gearbox, phi, load)
    assert angles[2] > gearbox.rest_angles(phi)[2]  # the load turns the output its own way
    solution = gearbox.accelerations(phi, 0.0, 0.0, angles, np.zeros(3), load)
    assert solution.output_torque == pytest.approx(load, abs=1e-6)
    assert solution.driver_torque == pytest.approx(solution.input_torque, rel=1e-9)
    assert solution.input_torque == pytest.approx(load / 15, rel=0.25)
    at = gearbox.coordinates(phi, angles).reshape(-1, 3)[:, :2]
    joints = solution.multipliers[:-1].reshape(-1, 2)
    on_housing = [0, 1, *range(12, 28)]
    assert joints[on_housing].sum(axis=0) == pytest.approx(0, abs=1e-6)
    moment = (at[:, 0] * joints[:, 1] - at[:, 1] * joints[:, 0])[on_housing].sum()
    assert moment == pytest.approx(-load - solution.driver_torque, abs=1e-6)


def test_input_torque_without_load_accelerates_the_wheels_only() -> None:
    gearbox = ReferenceGearbox()
    alpha = SPEED / 0.2
    solution = gearbox.accelerations(0.0, 0.0, alpha, gearbox.rest_angles(0.0), np.zeros(3), 0.0)
    assert solution.input_torque == pytest.approx(2 * 0.5998 * 0.0028**2 * alpha, rel=1e-9)
    assert solution.driver_torque == pytest.approx(solution.input_torque + 1.846e-6 * alpha, rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_power_is_accounted_for(seed: int) -> None:
    """Rate of kinetic energy = driver + load + contacts; joints do no work."""
    rng = np.random.default_rng(seed)
    gearbox = random_gearbox(rng)
    state = random_state(gearbox, rng)
    solution = gearbox.accelerations(*state)
    u = gearbox.coordinates(state.phi, state.angles)
    v = gearbox.velocities(u, state.omega, state.rates)
    at, speed = u.reshape(-1, 3)[:, :2], v.reshape(-1, 3)[:, :2]
    contacts = 0.0
    for sleeves, vectors in (
        (slice(12, 28), solution.external_vector),
        (slice(4, 12), solution.internal_vector),
    ):
        for wheel in (2, 3):
            arm = at[sleeves] - at[wheel]
            carried = speed[wheel] + v[3 * wheel + 2] * np.column_stack([-arm[:, 1], arm[:, 0]])
            contacts += np.sum(vectors[wheel - 2] * (carried - speed[sleeves]))
    kinetic = v @ gearbox.mass_matrix @ solution.accelerations
    powers = [solution.driver_torque * state.omega, state.load * state.rates[2], contacts]
    assert kinetic == pytest.approx(sum(powers), abs=1e-9 * np.abs([kinetic, *powers]).max())


# Integration ------------------------------------------------------------------------------------------------


def steady(phi: float) -> Any:
    return lambda t: (phi + SPEED * t, SPEED, 0.0)


def test_integration_is_of_second_order() -> None:
    gearbox = ReferenceGearbox()
    state = np.append(static_equilibrium(gearbox, 0.3, 22.0), [-SPEED / 15] * 3)
    ends = []
    for steps in (10, 20, 40, 640):
        run = gearbox.integrate(0.0, 2e-4, 2e-4 / steps, state, steady(0.3), lambda t: 22.0)
        ends.append(np.append(run.angles[-1], 1e-4 * run.rates[-1]))
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert 3.2 < errors[0] / errors[1] < 5
    assert 3.2 < errors[1] / errors[2] < 5


def test_healthy_gearbox_under_load() -> None:
    """Means and healthy forces of an independent implementation (2 %), over two mesh periods."""
    gearbox = ReferenceGearbox()
    state = np.append(static_equilibrium(gearbox, 0.3, 22.0), [-SPEED / 15] * 3)
    run = gearbox.integrate(0.0, 0.015, 1e-5, state, steady(0.3), lambda t: 22.0)
    assert run.time.shape == (1501,)
    assert run.external_force.shape == (1501, 2, 16)
    assert run.internal_force.shape == (1501, 2, 8)
    assert run.phi[-1] == pytest.approx(0.3 + SPEED * 0.015)
    assert run.angles[-1] - run.angles[0] == pytest.approx([-SPEED * 0.001] * 3, rel=0.02)
    assert run.output_torque.mean() == pytest.approx(22.0, rel=0.02)
    assert run.input_torque.mean() == pytest.approx(1.454, rel=0.02)
    assert run.external_force.max() == pytest.approx(99, rel=0.02)
    assert run.internal_force.max() == pytest.approx(163, rel=0.02)


def test_start_from_rest_with_the_papers_ramps() -> None:
    driver, load = ramped_driver(), ramped_load()
    assert driver(0.1) == pytest.approx((1.309, 26.18, 261.8))
    assert driver(0.2) == pytest.approx((5.236, 52.36, 0.0))
    assert driver(0.2 - 1e-12)[0] == pytest.approx(driver(0.2)[0])  # unlike eq. 6 as printed
    assert (load(0.1), load(0.2), load(0.5)) == (11.0, 22.0, 22.0)
    gearbox = ReferenceGearbox()
    state = np.append(gearbox.rest_angles(0.0), np.zeros(3))
    run = gearbox.integrate(0.0, 1e-3, 1e-5, state, driver, load)
    assert run.input_torque[0] == pytest.approx(2.462e-3, rel=1e-3)
    assert np.all(np.isfinite(run.angles))
    assert run.output_torque[-1] > 0


def test_divergence_is_reported_with_time_contact_and_advice() -> None:
    gearbox = ReferenceGearbox(stiffness_scale=1.0)
    state = np.append(gearbox.rest_angles(0.3) + np.array([0.0, 0.0, 0.02]), np.zeros(3))
    with pytest.raises(FloatingPointError, match=r"t = .* N between internal sleeve \d .* smaller dt"):
        gearbox.integrate(0.0, 1e-3, 1e-4, state, steady(0.3), lambda t: 22.0)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"n_pins": 15}, "n_pins"),
        ({"shortening": 1.0}, "shortening"),
        ({"worn_lobes": ((15,), ())}, "worn_lobes"),
        ({"worn_lobes": ((0,),)}, "worn_lobes"),
        ({"pin_errors": np.zeros((2, 16))}, "pin_errors"),
        ({"pin_radius": 0.014}, "pin_radius"),
    ],
)
def test_impossible_parameters_are_refused(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ReferenceGearbox(**parameters)
