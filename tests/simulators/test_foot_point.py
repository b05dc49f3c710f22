"""The kernel's gap between pin and profile against the nearest of very many points."""

from __future__ import annotations

import numpy as np
import pytest
from reference_tools import PROBE, STIFFNESS, Kernel

from cyclofeat.simulators import LobeDefects


def nearest(p: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Signed distance of each point from the trochoid: a grid, twice refined around its best point."""
    profile = PROBE.profile
    best = start
    for half_width, n in ((0.06, 2001), (1.2e-4, 801), (6e-7, 801)):
        t = best[:, None] + np.linspace(-half_width, half_width, n)
        distances = np.abs(profile.trochoid(t) - p[:, None])
        best = t[np.arange(len(p)), distances.argmin(axis=1)]
    outward = ((p - profile.trochoid(best)) * np.conj(profile.normal(best))).real
    return distances.min(axis=1) * np.sign(outward)


def gaps(displacement: np.ndarray, phi: float) -> tuple[np.ndarray, np.ndarray]:
    """True gap, and the kernel's (0 where open), of 16 pins displaced (complex, m) at the rest position."""
    gearbox = PROBE.replace(pin_radial_errors=displacement.real, pin_tangential_errors=displacement.imag)
    force = Kernel(gearbox, LobeDefects.healthy())(np.zeros(8), phi)["external_force"][0]
    angles, theta = 2 * np.pi * np.arange(16) / 16, -(phi + np.pi) / 15
    pins = (PROBE.pin_circle_radius + displacement) * np.exp(1j * angles)
    p = (pins - PROBE.eccentricity * np.exp(1j * phi)) * np.exp(-1j * theta)
    return nearest(p, angles - theta), -((force / STIFFNESS) ** (2 / 3))


def displacements(rng: np.random.Generator, largest: float) -> np.ndarray:
    return largest * np.sqrt(rng.random(16)) * np.exp(2j * np.pi * rng.random(16))


@pytest.mark.slow
@pytest.mark.parametrize("largest", [0.1e-3, 0.2e-3, 0.29e-3, 0.39e-3])
def test_gap_of_displaced_pins(largest: float) -> None:
    """Displaced in any direction; operation stays below 0.15 mm. Beyond 0.4 mm the kernel searches first."""
    rng = np.random.default_rng(11)
    open_pins = 0
    for _ in range(60):
        truth, fast = gaps(displacements(rng, largest), rng.uniform(-20, 20))
        assert np.all(fast[truth > 0] == 0)  # nothing pressed that does not touch
        assert np.all(fast[truth < -1e-7] < 0)  # nothing missed
        touching = truth < -1e-7
        assert np.abs(fast - truth)[touching].max() < 1e-10
        open_pins += np.sum(truth > 0)
    assert 300 < open_pins < 660


def test_gap_of_pins_far_out() -> None:
    """Displaced by 0.5 to 1.5 mm, where one Newton step would end anywhere."""
    rng = np.random.default_rng(12)
    for _ in range(60):
        away = rng.uniform(0.5e-3, 1.5e-3, 16) * np.exp(2j * np.pi * rng.random(16))
        truth, fast = gaps(away, rng.uniform(-20, 20))
        assert np.all(fast[truth > 0] == 0)
        touching = truth < -1e-7
        assert np.abs(fast - truth)[touching].max() < 1e-10


def test_gap_does_not_jump_where_the_kernel_begins_to_search() -> None:
    """Just below and just above the displacement of 0.7 times the trochoid's radius at the pit."""
    limit = 0.7 / abs(float(PROBE.profile.curvature(np.pi / 15)))
    rng = np.random.default_rng(13)
    for _ in range(40):
        direction = np.exp(2j * np.pi * rng.random(16))
        phi = rng.uniform(-20, 20)
        (_, below), (_, above) = (gaps(limit * (1 + sign * 1e-9) * direction, phi) for sign in (-1, 1))
        assert np.abs(below - above).max() < 1e-11
