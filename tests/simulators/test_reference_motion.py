"""The 28-body system at rest and in motion: statics, power, integration, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from reference_tools import SPEED, random_gearbox, random_state
from scipy.optimize import root

from cyclofeat.simulators import CycloidalGearbox, LobeDefects
from cyclofeat.simulators.reference import ReferenceGearbox, ramped_driver, ramped_load

# Balance ----------------------------------------------------------------------------------------------------


def static_equilibrium(gearbox: ReferenceGearbox, phi: float, load: float) -> np.ndarray:
    def unbalanced(offset: np.ndarray) -> np.ndarray:
        angles = gearbox.rest_angles(phi) + 1e-3 * offset
        solution = gearbox.accelerations(phi, 0.0, 0.0, angles, np.zeros(3), load)
        return 1e-4 * np.append(solution.theta_acceleration, solution.psi_acceleration)

    found = root(unbalanced, [1.0, 1.0, 3.0], tol=1e-13)
    assert np.abs(unbalanced(found.x)).max() < 1e-7
    return gearbox.rest_angles(phi) + 1e-3 * found.x


@pytest.mark.parametrize("defects", [LobeDefects(), LobeDefects.worn(7, wheels=(0,)), LobeDefects.worn(7)])
@pytest.mark.parametrize("phi", [0.1, 1.4])
def test_statics(defects: LobeDefects, phi: float) -> None:
    gearbox = ReferenceGearbox(defects=defects)
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


@pytest.mark.slow
def test_integration_is_of_second_order() -> None:
    gearbox = ReferenceGearbox()
    state = np.append(static_equilibrium(gearbox, 0.3, 22.0), [-SPEED / 15] * 3)
    ends = []
    for steps in (10, 20, 40, 160):
        run = gearbox.integrate(0.0, 2e-4, 2e-4 / steps, state, steady(0.3), lambda t: 22.0)
        ends.append(np.append(run.angles[-1], 1e-4 * run.rates[-1]))
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert 3.2 < errors[0] / errors[1] < 5
    assert 3.2 < errors[1] / errors[2] < 5


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
    gearbox = ReferenceGearbox(CycloidalGearbox(stiffness_scale=1.0))
    state = np.append(gearbox.rest_angles(0.3) + np.array([0.0, 0.0, 0.02]), np.zeros(3))
    with pytest.raises(FloatingPointError, match=r"t = .* N between .* smaller dt"):
        gearbox.integrate(0.0, 1e-3, 1e-4, state, steady(0.3), lambda t: 22.0)
