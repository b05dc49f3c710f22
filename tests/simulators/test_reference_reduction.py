"""The 28-body system against a reduction to three coordinates, written by hand and naively."""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
import pytest
from reference_tools import SPEED, State, pose_with_sleeve_0_at, random_gearbox, random_state
from scipy.optimize import brentq

from cyclofeat.simulators.reference import ReferenceGearbox, Solution


def dot(a: complex, b: complex) -> float:
    return (a * b.conjugate()).real


def cross(a: complex, b: complex) -> float:
    return (a.conjugate() * b).imag


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

    def law(gap: float, n: complex, radius: float) -> float:
        return naive_law(g, gap, dot(rate, n), radius)

    t = naive_foot(z, e, m, p, start)
    contacts = []  # (width, magnitude, normal)
    flank = 1.0
    for lobe in worn:
        tip, pit = 2 * math.pi * lobe / (z - 1), 2 * math.pi * (lobe + 0.5) / (z - 1)
        if abs((t - pit + math.pi) % (2 * math.pi) - math.pi) > math.pi / (z - 1):
            continue  # the half planes below hold near this lobe only
        a = trochoid(tip) - q * normal(tip)
        b = trochoid(pit) - q * normal(pit)
        along = (b - a) / abs(b - a)
        past_tip, past_pit = dot(p - a, 1j * normal(tip)) >= 0, dot(p - b, 1j * normal(pit)) >= 0
        if not past_tip:
            continue
        n, gap, radius = -1j * along, dot(p - a, -1j * along) - q, q
        if dot(p - a, along) < 0:
            gap, n = abs(p - a) - q, (p - a) / abs(p - a)
            turned = (n / normal(tip)).imag / (-1j * along / normal(tip)).imag
            radius = (1 - turned) * effective_radius(tip) + turned * q
        contacts.append((g.depth, law(gap, n, radius), n))
        if not past_pit:
            flank = 1 - g.depth
            n = (p - b) / abs(p - b)
            contacts.append((g.depth, law(abs(p - b) - q, n, effective_radius(pit)), n))
    contacts.append((flank, law(dot(p - trochoid(t), normal(t)), normal(t), effective_radius(t)), normal(t)))
    return sum(width * force for width, force, _ in contacts), sum(
        width * force * n for width, force, n in contacts
    )


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
            p = (pin - c) / turn - g.wheel_runouts[k]
            p_rate = (-c_rate - 1j * rate * (pin - c)) / turn
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
        assert error <= 1e-9 * np.abs(expected).max() + 1e-13, (name, error, expected)
    return solution


@pytest.mark.slow
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
@pytest.mark.parametrize("push", [4e-4, -2e-3])
@pytest.mark.parametrize("depth", [1.0, 0.4])
def test_reduction_agrees_all_along_a_worn_lobe(degrees: float, push: float, depth: float) -> None:
    gearbox = ReferenceGearbox(worn_lobes=((0,), ()), depth=depth)
    phi = pose_with_sleeve_0_at(math.radians(degrees))
    angles = gearbox.rest_angles(phi) + np.array([push, 3e-4, 3e-3])
    rates = -np.array([1, 1, 1]) * SPEED / 15
    assert_reduction_agrees(gearbox, State(phi, SPEED, 0.0, angles, rates, 22.0))
