"""The gearbox as the papers formulate it: 28 planar bodies held together by Lagrange multipliers.

This is the oracle of the simulators, not the product: plain NumPy, one dense solve per evaluation. "Paper B"
is the analysis of lobe defects with coherence and Morris wavelets; its section 3 gives equations 2-16.

Every body has the coordinates x, y and angle, in the order input shaft, output shaft, wheel 0, wheel 1,
8 internal sleeves, ``n_pins`` external sleeves. Every body turns about one revolute joint, whose two
constraints come in the same order; the driver of the input shaft is the last constraint: 84 coordinates and
57 constraints for 16 pins. Angles count counter-clockwise. The output turns against the input and a positive
load torque resists it. Points of the plane are complex numbers x + iy wherever that shortens the geometry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Real = NDArray[np.float64]
Plane = NDArray[np.complex128]
Driver = Callable[[float], tuple[float, float, float]]
Load = Callable[[float], float]

N_INTERNAL = 8
HOUSING, INPUT, OUTPUT = -1, 0, 1  # indices of bodies; the housing is no body and comes last
WHEELS, INTERNAL, EXTERNAL = slice(2, 4), slice(4, 12), slice(12, -1)
RAMP_DEPTH = 1e-5  # m: stiffness and damping reach their full value there (paper B eq. 12-13)
ABSURD_FORCE = 1e5  # N, assumption: five times what a locked gearbox shows, so the integration has diverged


class Solution(NamedTuple):
    """Accelerations, reactions and contact forces of one instant, SI units.

    Attributes
    ----------
    accelerations : ndarray of shape (n_coordinates,)
        x'', y'' in m/s2 and angle'' in rad/s2, body by body.
    theta_acceleration, psi_acceleration : ndarray of shape (2,) and float
        theta_1'' and theta_2'' of the wheels and psi'' of the output shaft in rad/s2.
    multipliers : ndarray of shape (n_constraints,)
        Force of its joint on every body (x, y) in N, then the driver's torque in Nm.
    cam_reactions : ndarray of shape (2, 2)
        Force R_k of cam k on wheel k (x, y) in N: the multipliers of the wheels' joints.
    input_torque : float
        Sum of c_k x R_k over the cams in Nm (paper B section 4).
    driver_torque : float
        The driver's multiplier in Nm: ``input_torque`` plus the input shaft's inertia times alpha.
    output_torque : float
        Minus the moment of the internal-sleeve forces on the output in Nm: load torque - J_out psi''.
    external_force, internal_force : ndarray of shape (2, n_pins) and (2, 8)
        Magnitudes by wheel and sleeve in N; the two contacts that a sleeve may have at a pit are added.
    external_vector, internal_vector : ndarray of shape (2, n_pins, 2) and (2, 8, 2)
        Resulting force (x, y) of the sleeve on the wheel in N, in the fixed frame.
    """

    accelerations: Real
    theta_acceleration: Real
    psi_acceleration: float
    multipliers: Real
    cam_reactions: Real
    input_torque: float
    driver_torque: float
    output_torque: float
    external_force: Real
    internal_force: Real
    external_vector: Real
    internal_vector: Real


class Trajectory(NamedTuple):
    """One row per time step: s, rad, rad/s, and Nm and N as in `Solution`."""

    time: Real  #: (n,)
    phi: Real  #: (n,)
    angles: Real  #: (n, 3): theta_1, theta_2, psi
    rates: Real  #: (n, 3)
    input_torque: Real  #: (n,)
    driver_torque: Real  #: (n,)
    output_torque: Real  #: (n,)
    cam_reactions: Real  #: (n, 2, 2)
    external_force: Real  #: (n, 2, n_pins)
    internal_force: Real  #: (n, 2, 8)


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceGearbox:
    """The multibody gearbox of paper B, solved as written there (eq. 2).

    Parameters
    ----------
    eccentricity : float
        e in m (paper B table 1).
    n_pins : int
        External sleeves z_k; even, so that two equal wheels mesh half a turn apart. There are z_k - 1 lobes.
    shortening : float
        Short-width coefficient m, 0 < m < 1; the sleeves sit on a circle of e z_k / m.
    pin_radius : float
        Radius q of the external sleeves in m.
    internal_pitch_radius, internal_sleeve_radius, clearance : float
        In m. Assumptions, stated in neither paper, like the hole radius: sleeve radius + e + clearance.
    input_shaft_inertia, output_shaft_inertia, wheel_inertia, sleeve_inertia : float
        About the body's own centre of mass in kg m2; masses in kg accordingly (paper B table 2).
    wheel_young, sleeve_young, wheel_poisson, sleeve_poisson : float
        Young's moduli in Pa and Poisson's ratios.
    stiffness_scale, contact_damping : float
        H of paper B eq. 14, and C in N s/m.
    worn_lobes : tuple of two tuples of int
        Worn lobes of wheel 0 and of wheel 1, counted from 0. The half of lobe k from its tip to the pit at
        larger profile parameter is replaced by its chord (paper B section 2).
    pin_errors : array-like of shape (n_pins, 2), optional
        Offsets (x, y) of the external sleeves' fixed points in m.
    """

    eccentricity: float = 2.8e-3
    n_pins: int = 16
    shortening: float = 0.7
    pin_radius: float = 6e-3
    internal_pitch_radius: float = 36e-3
    internal_sleeve_radius: float = 6e-3
    clearance: float = 0.0
    input_shaft_mass: float = 0.2341
    input_shaft_inertia: float = 1.846e-6
    output_shaft_mass: float = 1.6345
    output_shaft_inertia: float = 1.373e-4
    wheel_mass: float = 0.5998
    wheel_inertia: float = 1.57538e-4
    sleeve_mass: float = 0.048
    sleeve_inertia: float = 1.1013e-5
    wheel_young: float = 200e9
    wheel_poisson: float = 0.3
    sleeve_young: float = 200e9
    sleeve_poisson: float = 0.3
    stiffness_scale: float = 0.01
    contact_damping: float = 150.0
    worn_lobes: tuple[tuple[int, ...], tuple[int, ...]] = ((), ())
    pin_errors: ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.n_pins < 4 or self.n_pins % 2:
            raise ValueError(f"n_pins must be even and at least 4, got {self.n_pins}")
        if not 0 < self.shortening < 1:
            raise ValueError(f"shortening must lie between 0 and 1, got {self.shortening}")
        if len(self.worn_lobes) != 2 or not {*sum(self.worn_lobes, ())} <= {*range(self.n_lobes)}:
            raise ValueError(f"worn_lobes must be two tuples of 0..{self.n_lobes - 1}, got {self.worn_lobes!r}")
        if self.pin_errors is not None and np.shape(self.pin_errors) != (self.n_pins, 2):
            raise ValueError(f"pin_errors must be ({self.n_pins}, 2), got {np.shape(self.pin_errors)}")
        if (smallest := 1 / float(self.curvature(self._grid).max())) <= self.pin_radius:
            raise ValueError(f"pin_radius must be below {smallest} m (no undercut), got {self.pin_radius}")

    # The wheel in its own frame -----------------------------------------------------------------------------

    @property
    def n_lobes(self) -> int:
        """Number of lobes z_s of a wheel."""
        return self.n_pins - 1

    @cached_property
    def _grid(self) -> Real:
        """Profile parameters from which the search for a foot point starts, 64 to a lobe."""
        return np.linspace(0.0, 2 * np.pi, 64 * self.n_lobes, endpoint=False)

    @cached_property
    def _grid_points(self) -> Plane:
        return self.trochoid(self._grid)

    def _tangent(self, t: Real) -> Plane:
        """T'(t) = i e z_k e^{it} g(t) in m, with g = 1/m + e^{i z_s t}."""
        g = 1 / self.shortening + np.exp(1j * self.n_lobes * t)
        return np.asarray(1j * self.eccentricity * self.n_pins * np.exp(1j * t) * g)

    def trochoid(self, t: ArrayLike) -> Plane:
        """Centre (complex, m) of a sleeve that touches at parameter ``t`` (rad): paper B eq. 1 without q."""
        turn = np.exp(1j * np.asarray(t, dtype=float))
        return np.asarray(self.eccentricity * (self.n_pins / self.shortening * turn + turn**self.n_pins))

    def normal(self, t: ArrayLike) -> Plane:
        """Outward unit normal (complex) of trochoid and profile at parameter ``t`` (rad)."""
        tangent = self._tangent(np.asarray(t, dtype=float))
        return np.asarray(-1j * tangent / np.abs(tangent))

    def profile(self, t: ArrayLike) -> Plane:
        """Point (complex, m) of the healthy wheel profile at parameter ``t`` (rad): paper B eq. 1."""
        return self.trochoid(t) - self.pin_radius * self.normal(t)

    def curvature(self, t: ArrayLike) -> Real:
        """Curvature of the trochoid in 1/m, positive where convex, at parameter ``t`` (rad)."""
        t = np.asarray(t, dtype=float)
        scale = self.eccentricity * self.n_pins
        size = np.abs(self._tangent(t)) / scale
        bend = 1 + self.n_lobes * (1 + np.cos(self.n_lobes * t) / self.shortening) / size**2
        return np.asarray(bend / (scale * size))

    def foot_point(self, p: Plane) -> Real:
        """Parameter (rad) of the trochoid's nearest point to each of the points ``p`` (wheel frame, m).

        Newton's method on (p - T) . T' = 0, to rounding, guarded by a bracket around the nearest grid point:
        at the pit the trochoid bends outwards with a radius of half a millimetre, beyond which the
        derivative has the wrong sign.
        """
        t = self._grid[np.argmin(np.abs(p[:, None] - self._grid_points), axis=1)]
        low, high = t - self._grid[1], t + self._grid[1]
        for _ in range(60):
            tangent = self._tangent(t)
            offset = p - self.trochoid(t)
            closing = _dot(offset, tangent)
            slope = -(np.abs(tangent) ** 2) * (1 + self.curvature(t) * _dot(offset, self.normal(t)))
            slope += closing * self._stretch(t)
            low, high = np.where(closing > 0, t, low), np.where(closing > 0, high, t)
            newton = t - closing / np.where(slope < 0, slope, -np.inf)
            trusted = (slope < 0) & (newton >= low) & (newton <= high)
            previous, t = t, np.where(trusted, newton, (low + high) / 2)
            if np.abs(t - previous).max() < 1e-15:
                break
        return np.asarray(t)

    def _stretch(self, t: Real) -> Real:
        """(ln |T'|)' of the trochoid."""
        lead = np.exp(1j * self.n_lobes * t)
        return np.asarray((1j * self.n_lobes * lead / (1 / self.shortening + lead)).real)
