"""The bodies, joints and profile of the 28-body system against finite differences and brute force."""

from __future__ import annotations

import cmath

import numpy as np
import pytest
from reference_tools import PIT, random_gearbox, random_state

from benchmarks.reference_gearbox import ReferenceGearbox

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
    assert angles[1] - angles[0] == pytest.approx(np.pi)  # with the holes of wheel 0, four further on
    solution = gearbox.accelerations(phi, 0.0, 0.0, angles, np.zeros(3), 0.0)
    assert solution.external_force.max() < 1e-6
    assert solution.internal_force.max() < 1e-6


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
    assert gearbox.jacobian(elsewhere) == pytest.approx(np.transpose(columns), abs=1e-8)

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
    t = rng.uniform(0, 2 * np.pi, 60)
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
