"""Everything at rest: forces times lever arms, worked out by hand, balance the load.

The equilibrium is found by a root finder on the kernel's accelerations; the moments then come from magnitudes
and places of the contacts alone.
"""

from __future__ import annotations

import numpy as np
import pytest
from reference_tools import Kernel
from scipy.optimize import root

from cyclofeat.simulators import CycloidalGearbox, LobeDefects
from cyclofeat.simulators.simulation import contact_points
from cyclofeat.simulators.tables import pin_centres, sleeve_centres

STEEL = CycloidalGearbox.steel()
RNG = np.random.default_rng(40)
UNEQUAL = STEEL.replace(
    pin_radial_errors=RNG.normal(0, 1e-5, 16),
    pin_tangential_errors=RNG.normal(0, 1e-5, 16),
    lobe_pitch_errors=RNG.normal(0, 1e-5, 30),
    wheel_runouts=(1e-5, -1e-5j),
    cam_errors=(5e-6j, 1e-5),
    pin_clearance=5e-6,
    clearance=1e-5,
)
HEALTHY = LobeDefects.healthy()


def equilibrium(
    gearbox: CycloidalGearbox, defects: LobeDefects, phi: float, load: float
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Deflections of wheels and output (rad) at which nothing accelerates, and the forces there."""
    kernel = Kernel(gearbox, defects)

    def accelerations(deflection: np.ndarray) -> np.ndarray:
        got = kernel(np.append(deflection * 1e-3, np.zeros(5)), phi, load=load)
        moments = [
            *got["theta_acceleration"] * gearbox.wheel_inertia,
            got["psi_acceleration"] * gearbox.output_inertia,
        ]
        return np.array(moments)

    found = root(accelerations, [1.7, 1.7, 4.1], method="hybr", options={"xtol": 1e-13})
    assert np.abs(found.fun).max() < 1e-8 * load, found.message
    deflection = found.x * 1e-3
    return deflection, kernel(np.append(deflection, np.zeros(5)), phi, load=load)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray((np.conj(a) * b).imag)


@pytest.mark.slow
@pytest.mark.parametrize("phi", [0.0, 1.0, 4.0])
@pytest.mark.parametrize(
    ("gearbox", "defects", "load"),
    [
        (STEEL, HEALTHY, 22.0),
        (STEEL, LobeDefects.worn(7), 22.0),
        (UNEQUAL, LobeDefects.worn((0, 3, 8), wheels=(0,), depth=0.5), 22.0),
        (UNEQUAL, LobeDefects.removed(3, wheels=(1,)), 30.0),
        (STEEL.replace(contact_law="hunt_crossley", contact_damping=1.0), HEALTHY, 5.0),
        (CycloidalGearbox.abs(), HEALTHY, 22.0),
        (STEEL.replace(sleeve_friction=0.1, journal_friction=0.05, output_bearing_torque=1.0), HEALTHY, 22.0),
    ],
    ids=["healthy", "worn", "unequal", "removed", "hunt-crossley", "abs", "friction at rest"],
)
def test_contact_moments_balance_the_load(
    gearbox: CycloidalGearbox, defects: LobeDefects, load: float, phi: float
) -> None:
    deflection, got = equilibrium(gearbox, defects, phi, load)
    # Everything below: magnitudes and places only.
    external = np.concatenate([got["external_force"][..., None], got["external_vector"]], axis=-1)
    internal = np.concatenate([got["internal_force"][..., None], got["internal_vector"]], axis=-1)
    pins = np.exp(2j * np.pi * np.arange(16) / 16) * (
        gearbox.pin_circle_radius
        + np.asarray(gearbox.pin_radial_errors or 0.0)
        + 1j * np.asarray(gearbox.pin_tangential_errors or 0.0)
    )
    psi = deflection[2] - phi / 15
    sleeves = gearbox.internal_pitch_radius * np.exp(1j * (psi + np.pi / 4 * np.arange(8)))
    places = (
        contact_points(pin_centres(gearbox), gearbox.pin_radius, external),
        contact_points(sleeve_centres(gearbox, np.array([psi])), gearbox.internal_sleeve_radius, internal),
    )
    cams = (gearbox.eccentricity * np.array([1, -1]) + np.asarray(gearbox.cam_errors or 0j)) * np.exp(
        1j * phi
    )
    on_wheels, about_cams = [], np.zeros(2)
    for where, centres, size, radius in (
        (places[0], pins, external[..., 0], gearbox.pin_radius),
        (places[1], sleeves, internal[..., 0], gearbox.internal_sleeve_radius),
    ):
        touching = size > 0
        toward = np.where(touching, (where - centres) / radius, 0)
        assert np.abs(toward)[touching] == pytest.approx(1, abs=1e-9)
        # Two contacts of one sleeve at a pit add up as vectors.
        force = toward * np.abs(external[..., 1] + 1j * external[..., 2] if where is places[0] else size)
        on_wheels.append(force)
        about_cams += np.nansum(cross(np.where(touching, where, 0) - cams[:, None], force), axis=1)
    bears = np.abs(cross(sleeves, on_wheels[1])).sum()
    assert bears > 0.9 * load
    tolerance = 1e-7 * bears
    # Wheels: no moment about their cams. Output: the sleeves' moment is the load.
    assert np.abs(about_cams).max() < tolerance
    assert cross(sleeves, on_wheels[1]).sum() == pytest.approx(load, abs=tolerance)
    assert got["output_torque"] == pytest.approx(load, abs=tolerance)
    # The drive holds what the cams bear, and the housing, through the pins, what is left of both.
    drive = -cross(cams, sum(force.sum(axis=1) for force in on_wheels)).sum()
    assert got["input_torque"] == pytest.approx(drive, abs=tolerance)
    assert drive + load + cross(pins, on_wheels[0]).sum() == pytest.approx(0, abs=tolerance)
