"""Contact parameters by material and geometry (paper B eq. 12-16)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators import _kernels
from cyclofeat.simulators.gearbox import CycloidalGearbox

_LAWS = {
    "paper": _kernels.PAPER_LAW,
    "hunt_crossley": _kernels.HUNT_CROSSLEY_LAW,
    "conservative": _kernels.CONSERVATIVE_LAW,
}


def stiffness_factor(gearbox: CycloidalGearbox) -> float:
    """Contact stiffness over the root of the effective radius, in N/m^2.

    K = 4 H / (3 pi (h_c + h_p)) sqrt(R), h = (1 - nu^2) / (pi E) (paper B eq. 14-16).
    """
    wheel = (1 - gearbox.wheel_poisson_ratio**2) / (math.pi * gearbox.wheel_youngs_modulus)
    sleeve = (1 - gearbox.sleeve_poisson_ratio**2) / (math.pi * gearbox.sleeve_youngs_modulus)
    return 4 * gearbox.stiffness_scale / (3 * math.pi * (wheel + sleeve))


def joint_effective_radius(gearbox: CycloidalGearbox) -> float:
    """Effective radius r_s r_h / (r_h - r_s) of an internal sleeve in its hole, in m."""
    sleeve = gearbox.internal_sleeve_radius
    difference = gearbox.eccentricity + gearbox.clearance
    return sleeve * (sleeve + difference) / difference


def pin_centres(gearbox: CycloidalGearbox) -> NDArray[np.complex128]:
    """Positions x + iy of the external sleeves' axles, with their errors, in m: shape (n_pins,)."""
    angles = 2 * np.pi * np.arange(gearbox.n_pins) / gearbox.n_pins
    errors = np.asarray(gearbox.pin_radial_errors or 0.0) + 1j * np.asarray(
        gearbox.pin_tangential_errors or 0.0
    )
    return np.asarray((gearbox.pin_circle_radius + errors) * np.exp(1j * angles))


def sleeve_centres(gearbox: CycloidalGearbox, output_angle: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Positions x + iy of the internal sleeves' axles in m, at angles (n,) of the output: (n, n_sleeves)."""
    angles = 2 * np.pi * np.arange(gearbox.n_internal_sleeves) / gearbox.n_internal_sleeves
    return np.asarray(gearbox.internal_pitch_radius * np.exp(1j * (angles + output_angle[:, np.newaxis])))


def contact_constants(gearbox: CycloidalGearbox, constant_radius: float) -> _kernels.ContactConstants:
    """Constants of one kind of contact; ``constant_radius`` (m) is that of the conservative law."""
    return _kernels.ContactConstants(
        law=_LAWS[gearbox.contact_law],
        stiffness_factor=stiffness_factor(gearbox),
        damping=float(gearbox.contact_damping),
        inverse_ramp=1 / gearbox.contact_ramp,
        constant_radius=float(constant_radius),
    )
