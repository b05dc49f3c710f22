"""The 28-body system at rest and in motion: statics and power."""

from __future__ import annotations

import numpy as np
import pytest
from reference_tools import SPEED, random_gearbox, random_state
from scipy.optimize import root

from benchmarks.reference_gearbox import ReferenceGearbox
from cyclofeat.simulators import LobeDefects

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
