"""The contacts of the 28-body system: law, worn lobes on a closed outline, runout."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference_tools import PIT, pose_with_sleeve_0_at

from benchmarks.reference_gearbox import ReferenceGearbox
from cyclofeat.simulators import CycloidalGearbox, LobeDefects

WORN = LobeDefects.worn(1, wheels=(0,))


def test_normal_force_law() -> None:
    gearbox = ReferenceGearbox()
    stiffness = 4 * 0.01 / (3 * 2 * (1 - 0.09) / 200e9) * math.sqrt(0.006)
    depth = np.array([1e-4, 1e-5, 5e-6])
    expected = stiffness * depth**1.5 * [1, 1, 0.5]
    still = np.zeros(3)
    assert gearbox.normal_force(-depth, still, 0.006) == pytest.approx(expected)
    assert gearbox.normal_force(-depth, still - 1e-3, 0.006) == pytest.approx(
        expected + 0.15 * np.array([1, 1, 0.5])
    )
    assert np.all(gearbox.normal_force(-depth, still + 1e3, 0.006) == 0)  # never tensile
    assert np.all(gearbox.normal_force(depth, still - 1e3, 0.006) == 0)


def forces_on_sleeve_0(
    gearbox: ReferenceGearbox, t: np.ndarray, push: float
) -> tuple[np.ndarray, np.ndarray]:
    """Magnitudes and vectors of the contact with wheel 0, turned by ``push`` from the rest position."""
    forces = []
    for parameter in t:
        phi = pose_with_sleeve_0_at(parameter)
        u = gearbox.coordinates(phi, gearbox.rest_angles(phi) + np.array([push, 0, 0]))
        magnitude, vector, _, _ = gearbox.contact_forces(u, np.zeros_like(u))
        forces.append((magnitude[0, 0], vector[0, 0]))
    magnitudes, vectors = zip(*forces, strict=True)
    return np.array(magnitudes), np.array(vectors)


def test_chord_carries_from_9_2_to_13_3_degrees_in_the_rest_position() -> None:
    gearbox = ReferenceGearbox(defects=WORN)
    degrees = np.array([0.5, 3.0, 9.2, 9.3, 12.0, 13.3, 13.4, 20.0])
    magnitudes, _ = forces_on_sleeve_0(gearbox, np.deg2rad(degrees), 0.0)
    assert (magnitudes > 1e-3).tolist() == ((degrees > 9.25) & (degrees < 13.33)).tolist()


@pytest.mark.parametrize(("wheel", "lobe"), [(0, 0), (0, 7), (1, 0), (1, 14)])
def test_worn_wheels_and_lobes_are_the_ones_asked_for(wheel: int, lobe: int) -> None:
    """Equal lobes of the two wheels act at the same moment, on opposite sleeves."""
    gearbox = ReferenceGearbox(defects=LobeDefects.worn((lobe,), wheels=(wheel,)))
    phi = pose_with_sleeve_0_at((2 * lobe + 0.9) * PIT)
    u = gearbox.coordinates(phi, gearbox.rest_angles(phi))
    force, _, _, _ = gearbox.contact_forces(u, np.zeros_like(u))
    assert np.argwhere(force > 1e-3).tolist() == [[wheel, 8 * wheel]]


def test_depth_mixes_the_healthy_and_the_worn_outline() -> None:
    t = np.deg2rad([2.0, 9.5, 11.5, 12.5, 15.0])
    healthy, half, worn = (
        forces_on_sleeve_0(ReferenceGearbox(defects=LobeDefects.worn(1, wheels=(0,), depth=depth)), t, -1e-3)[
            1
        ]
        for depth in (0.0, 0.25, 1.0)
    )
    assert np.abs(half - (0.75 * healthy + 0.25 * worn)).max() < 1e-9
    assert healthy == pytest.approx(forces_on_sleeve_0(ReferenceGearbox(), t, -1e-3)[1])
    assert np.abs(worn - healthy).max() > 100


def test_runout_moves_the_profile_of_its_wheel_only() -> None:
    """Moved outwards along the load, the profile bears more on sleeve 0; the other wheel feels nothing."""
    u = ReferenceGearbox().coordinates(0.0, ReferenceGearbox().rest_angles(0.0))
    for wheel in (0, 1):
        runouts = [0j, 0j]
        runouts[wheel] = 2e-5 * np.exp(1j * math.pi / 15 + 1j * math.pi * wheel)
        gearbox = ReferenceGearbox(CycloidalGearbox(wheel_runouts=tuple(runouts)))
        force, _, hole_force, _ = gearbox.contact_forces(u, np.zeros_like(u))
        assert force[wheel].max() > 1
        assert force[1 - wheel].max() < 1e-6
        assert hole_force.max() < 1e-6
