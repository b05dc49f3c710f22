"""What the tests of the 28-body system and of the kernel share: states, and the two models side by side."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from benchmarks.reference_gearbox import ReferenceGearbox
from cyclofeat.simulators import Courses, CycloidalGearbox, LobeDefects, SimulationRun, Solver, simulate
from cyclofeat.simulators import _kernels as kernels  # tests of the kernels take them from here
from cyclofeat.simulators.gearbox import RPM
from cyclofeat.simulators.tables import kernel_input, rest_state, stiffness_factor

SPEED = 500 * RPM
PIT = math.pi / 15
# With one effective radius, no damping and no ramp the force tells the penetration: F = STIFFNESS depth^1.5.
PROBE = CycloidalGearbox.steel(contact_law="conservative", contact_damping=0.0, contact_ramp=1e-12)
STIFFNESS = stiffness_factor(PROBE) * PROBE.pin_radius**0.5


class State(NamedTuple):
    phi: float
    omega: float
    alpha: float
    angles: np.ndarray
    rates: np.ndarray
    load: float


def simulate_with(
    gearbox: CycloidalGearbox | None = None, defects: LobeDefects | None = None, **options: Any
) -> SimulationRun:
    """``simulate``, with the fields of Courses and Solver among its options."""
    grouped = {
        name: kind(**{f.name: options.pop(f.name) for f in dataclasses.fields(kind) if f.name in options})
        for name, kind in (("courses", Courses), ("solver", Solver))
    }
    return simulate(gearbox, defects, **grouped, **options)


def random_state(gearbox: ReferenceGearbox, rng: np.random.Generator, spread: float = 2e-3) -> State:
    """A state near the rest position; a spread of 2 mrad makes penetrations of some 0.1 mm."""
    phi = rng.uniform(-50, 50)
    omega, alpha = rng.normal(0, SPEED), rng.normal(0, 260)
    angles = gearbox.rest_angles(phi) + rng.normal(0, spread, 3)
    rates = -omega / gearbox.n_lobes + rng.normal(0, 1, 3)
    return State(phi, omega, alpha, angles, rates, rng.normal(0, 22))


def midpoint_path(
    reference: ReferenceGearbox, state: np.ndarray, phi: float, dt: float, n_steps: int
) -> tuple[np.ndarray, list[Any]]:
    """Angles and solutions of the 28 bodies at every step of the midpoint rule, at full speed and load."""
    angles, solutions = [], []
    for step in range(n_steps):
        middle = state
        for share in (0.0, 0.5):
            turned = phi + SPEED * (step + share) * dt
            solution = reference.accelerations(turned, SPEED, 0.0, middle[:3], middle[3:], 22.0)
            slope = np.r_[middle[3:], solution.theta_acceleration, solution.psi_acceleration]
            if share == 0:
                angles.append(state[:3])
                solutions.append(solution)
            middle = state + dt / 2 * slope
        state = state + dt * slope
    return np.array(angles), solutions


def random_lobes(rng: np.random.Generator, n_lobes: int = 15) -> tuple[int, ...]:
    return tuple(int(lobe) for lobe in np.flatnonzero(rng.random(n_lobes) < 0.5))


def random_gearbox(rng: np.random.Generator) -> ReferenceGearbox:
    """A system with worn lobes, displaced pins and runout."""
    radial, tangential = rng.normal(0, 2e-5, (2, 16))
    gearbox = CycloidalGearbox(
        pin_radial_errors=radial, pin_tangential_errors=tangential,
        wheel_runouts=rng.normal(0, 1e-5, (2, 2)) @ [1, 1j],
    )  # fmt: skip
    wheels = [(0,), (1,), (0, 1)][rng.integers(3)]
    depth = float(rng.choice([1.0, rng.uniform()]))
    return ReferenceGearbox(gearbox, LobeDefects.worn(random_lobes(rng), wheels=wheels, depth=depth))


def pose_with_sleeve_0_at(t: float) -> float:
    """Input angle of the rest position that brings sleeve 0 to parameter ``t`` of wheel 0."""
    return 15 * t - math.pi


def kernel_state(reference: ReferenceGearbox, state: State) -> np.ndarray:
    """The kernel's state: deviations from the rest position, and their rates."""
    result = np.zeros(kernels.N_STATE)
    result[:3] = state.angles - reference.rest_angles(state.phi)
    result[4:7] = state.rates + state.omega / reference.n_lobes
    return result


class Kernel:
    """The kernel's right-hand side for one gearbox, called like a function.

    Every call describes the contacts anew; with ``remember`` only where the kernel itself would.
    """

    def __init__(self, gearbox: CycloidalGearbox, defects: LobeDefects, remember: bool = False) -> None:
        self.gearbox = gearbox
        self.rest = rest_state(gearbox)
        self.memory = kernels.new_memory(self.rest) if remember else None
        self.constants = tuple(kernel_input(gearbox, defects))

    def __call__(
        self, state: np.ndarray, phi: float, omega: float = 0.0, alpha: float = 0.0, load: float = 0.0
    ) -> dict[str, Any]:
        """Accelerations, torques and forces in SI units, named as in ``Solution``.

        Euler's rule with a step of 1 s adds the accelerations to the rates.
        """
        start = self.rest.copy()
        start[: state.size] = state
        after, torques = start.copy(), np.zeros((1, kernels.N_RESULT))
        external = np.zeros((2, 2, self.gearbox.n_pins, 3))
        internal = np.zeros((2, 2, self.gearbox.n_internal_sleeves, 3))
        memory = kernels.new_memory(start) if self.memory is None else self.memory
        steady = (np.full(3, value) for value in (phi, omega, alpha, load))
        kernels.integrate(
            1, 1, 1.0, *steady, after, *self.constants, memory, np.inf, np.inf, np.inf, torques,
            np.zeros(1, dtype=int), np.zeros((1, start.size)), external, internal,
        )  # fmt: skip
        change = after - start
        return {
            "theta_acceleration": change[4:6],
            "psi_acceleration": change[6],
            "brake_acceleration": change[7],
            "spin_acceleration": change[8:],
            "output_torque": torques[0, 0],
            "input_torque": torques[0, 1],
            "external_force": external[0, ..., 0],
            "internal_force": internal[0, ..., 0],
            "external_vector": external[0, ..., 1:],
            "internal_vector": internal[0, ..., 1:],
        }


def sweep(gearbox: CycloidalGearbox, defects: LobeDefects, t: np.ndarray, push: float) -> np.ndarray:
    """Sleeve 0 over the parameters ``t`` of wheel 0, which is turned by ``push`` and at rest otherwise.

    Returns the force on the sleeve and the moment on the wheel over the pins' radius, in N: (n, 2).
    """
    kernel = Kernel(gearbox, defects)
    found = []
    for parameter in t:
        result = kernel(np.array([push, *np.zeros(7)]), pose_with_sleeve_0_at(parameter))
        moment = result["theta_acceleration"][0] * gearbox.wheel_inertia
        found.append((result["external_force"][0, 0], moment / gearbox.pin_circle_radius))
    return np.array(found)
