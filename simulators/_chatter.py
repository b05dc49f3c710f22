"""Damping rates by friction, which must not be too fast for the time step."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators.contact import pin_centres, sleeve_centres
from cyclofeat.simulators.gearbox import CycloidalGearbox

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Bodies that friction damps: two wheels, the output shaft, and all sleeves (about their axles).
_OUTPUT = 2
_FIRST_SPIN = 3


def friction_rates(
    gearbox: CycloidalGearbox, phi: Float, omega: Float, motion: Float, external: Float, internal: Float
) -> Float:
    """Largest damping rate by friction in 1/s, if sleeves stick to wheels and axles, (n,).

    Friction at rest is a damper of force times coefficient over the transition speed. With S the sliding
    speeds per unit of the bodies' rates, G these slopes and M the inertias, the damping rates are the
    eigenvalues of M^-1 S' G S. The slope of the output's bearing is that at the shaft's speed. ``phi`` and
    ``omega`` (n,) are of the input, ``motion`` (n, n_state) and the sleeves' forces (n, 2, n_sleeves, 3) as
    the kernel gathers them.
    """
    n_pins, n_sleeves = gearbox.n_pins, gearbox.n_internal_sleeves
    inertias = np.full(_FIRST_SPIN + n_pins + n_sleeves, gearbox.sleeve_inertia)
    inertias[:_FIRST_SPIN] = gearbox.wheel_inertia, gearbox.wheel_inertia, gearbox.output_inertia
    centres = gearbox.eccentricity * np.array([1, -1]) + np.asarray(gearbox.cam_errors or (0j, 0j))
    cams = centres * np.exp(1j * phi)[:, None]
    pins = np.tile(pin_centres(gearbox), (phi.size, 1))
    sleeves = sleeve_centres(gearbox, motion[:, 2] - phi / gearbox.n_lobes)
    bearing = np.zeros((phi.size, 1, inertias.size))
    bearing[..., _OUTPUT] = 1.0
    turning = (motion[:, 6] - omega / gearbox.n_lobes)[:, None] / gearbox.bearing_transition_speed
    coulomb = gearbox.output_bearing_torque / gearbox.bearing_transition_speed * (1 - np.tanh(turning) ** 2)
    rubbing = [
        (bearing, coulomb + gearbox.output_bearing_viscosity),
        *_of_sleeves(gearbox, _Sleeves(pins, gearbox.pin_radius, _FIRST_SPIN), external, cams, bearing * 0.0),
        *_of_sleeves(
            gearbox,
            _Sleeves(sleeves, gearbox.internal_sleeve_radius, _FIRST_SPIN + n_pins),
            internal,
            cams,
            bearing,
        ),
    ]
    slides, slopes = (np.concatenate(parts, axis=1) for parts in zip(*rubbing, strict=True))
    scaled = slides * np.sqrt(slopes)[..., None] / np.sqrt(inertias)
    return np.asarray(np.linalg.eigvalsh(np.swapaxes(scaled, 1, 2) @ scaled)[:, -1])


class _Sleeves(NamedTuple):
    """One kind of sleeves: their axles (n, n_sleeves), radius, and the first of them among the bodies."""

    axles: Complex
    radius: float
    first: int


def _of_sleeves(
    gearbox: CycloidalGearbox, sleeves: _Sleeves, forces: Float, cams: Complex, carrier: Float
) -> Iterator[tuple[Float, Float]]:
    """Sliding speeds per unit of the bodies' rates (n, n_sleeves, n_bodies), and slopes (n, n_sleeves).

    The axles turn about the origin with the bodies' rates times ``carrier`` (n, 1, n_bodies).
    """
    axles, radius, first = sleeves
    vector = forces[..., 1] + 1j * forces[..., 2]
    size = np.abs(vector)
    toward = vector / np.where(size > 0, size, 1.0)  # from the sleeve to the wheel
    spin = np.zeros((*axles.shape, carrier.shape[2]))
    sleeve = np.arange(axles.shape[1])
    spin[:, sleeve, first + sleeve] = radius
    at_rest = gearbox.sleeve_static_friction or gearbox.sleeve_friction
    for w in range(2):
        normal = toward[:, w].conj()
        slide = -spin - (axles * normal).real[..., None] * carrier
        slide[..., w] = ((axles + radius * toward[:, w] - cams[:, w, None]) * normal).real
        viscous = gearbox.sleeve_viscous_friction * (size[:, w] > 0)
        yield slide, at_rest * size[:, w] / gearbox.friction_transition_speed + viscous
    on_axle = np.abs(vector.sum(axis=1))
    yield spin - radius * carrier, gearbox.journal_friction * on_axle / gearbox.friction_transition_speed
