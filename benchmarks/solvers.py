"""The simulator's right-hand side under scipy's ``solve_ivp``, at the accuracy of the midpoint rule.

The kernel describes contacts anew only after a wheel has moved on, so the fifth digit of a force depends on
the history of the right-hand side. The midpoint rule and scipy's solvers all use that right-hand side; the
reference for their errors describes all contacts anew at every call.

The comparison uses the output torque at 25 kHz, the result of a simulation. The midpoint rule has it at every
step; scipy's solvers interpolate their states, from which one compiled loop computes the torque.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from cyclofeat.simulators import CycloidalGearbox, LobeDefects, _kernels
from cyclofeat.simulators.tables import kernel_input

METHODS = ("RK45", "DOP853", "LSODA")
TOLERANCES = tuple(10.0 ** (-k / 4) for k in range(4, 41))
SAMPLING_RATE = 25_000.0


@dataclass(frozen=True)
class Problem:
    """A settled gearbox at constant speed and load.

    ``function(t, y)`` and ``described_anew(t, y)`` return the rates of the state, ``torques(times, states,
    anew)`` the output torque; ``start`` is the state at t = 0, ``scale`` the size of each of its entries.
    """

    function: Callable[[float, np.ndarray], np.ndarray]
    described_anew: Callable[[float, np.ndarray], np.ndarray]
    torques: Callable[[np.ndarray, np.ndarray, bool], np.ndarray]
    start: np.ndarray
    scale: np.ndarray
    duration: float

    @property
    def times(self) -> np.ndarray:
        """Times in s at which the torque is compared."""
        return np.arange(round(self.duration * SAMPLING_RATE) + 1) / SAMPLING_RATE

    def solved(self, method: str, tolerance: float, *, anew: bool = False) -> np.ndarray:
        """Output torque in Nm at ``times`` by ``solve_ivp``."""
        found = solve_ivp(
            self.described_anew if anew else self.function,
            (0.0, self.duration),
            self.start,
            method,
            self.times,
            rtol=tolerance,
            atol=tolerance * self.scale,
        )
        if not found.success:
            raise RuntimeError(f"{method} failed: {found.message}")
        return self.torques(found.t, np.ascontiguousarray(found.y.T), anew)

    def reference(self) -> np.ndarray:
        """The same to about ten digits: tight tolerance, contacts described anew at every call."""
        return self.solved("DOP853", 1e-11, anew=True)


def problem(
    gearbox: CycloidalGearbox,
    defects: LobeDefects,
    phi: float,
    start: np.ndarray,
    scale: np.ndarray,
    duration: float,
) -> Problem:
    """Wrap the kernel's right-hand side; the tables are compiled in to make calls fast."""
    memory = _kernels.new_memory(start)
    speed, load, z = gearbox.input_speed, gearbox.load_torque, float(gearbox.n_lobes)
    (wheel, joint, contact, joint_contact, body, _, pins, mounts, lobes, wear, sleeves) = tuple(
        kernel_input(gearbox, defects)
    )

    @njit(error_model="numpy")
    def evaluate(t, y, anew, memory, rates, result):  # type: ignore[no-untyped-def]
        if anew:
            memory[0][:] = np.inf
        angle = phi + speed * t
        _kernels.derivatives(
            angle, math.cos(angle), math.sin(angle), math.cos(angle / z), -math.sin(angle / z), speed, 0.0,
            load, y, wheel, joint, contact, joint_contact, body, None, pins, mounts, lobes, wear, sleeves,
            memory, rates, result,
        )  # fmt: skip

    @njit(error_model="numpy")
    def torques_along(times, states, anew, memory, rates, result, torques):  # type: ignore[no-untyped-def]
        for i in range(times.size):
            evaluate(times[i], states[i], anew, memory, rates, result)
            torques[i] = result[0]

    result = np.empty(_kernels.N_RESULT)

    def function(t: float, y: np.ndarray) -> np.ndarray:
        rates = np.empty(y.size)
        evaluate(t, y, False, memory, rates, result)
        return rates

    def described_anew(t: float, y: np.ndarray) -> np.ndarray:
        rates = np.empty(y.size)
        evaluate(t, y, True, memory, rates, result)
        return rates

    def torques(times: np.ndarray, states: np.ndarray, anew: bool) -> np.ndarray:
        found = np.empty(times.size)
        torques_along(times, states, anew, memory, np.empty(states.shape[1]), result, found)
        return found

    return Problem(function, described_anew, torques, start, scale, duration)


def loosest(problem: Problem, method: str, reference: np.ndarray, error: float) -> float | None:
    """Return the loosest tolerance with which a method is accurate enough; None if none is."""
    for tolerance in TOLERANCES:
        if rms(problem.solved(method, tolerance) - reference) <= error:
            return tolerance
    return None


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))
