"""Descriptions of contacts hold until they are renewed: against describing them anew at every evaluation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
from reference_tools import SPEED, Kernel, kernels

from cyclofeat.simulators import CycloidalGearbox, LobeDefects, _outline

STEEL = CycloidalGearbox.steel()
RNG = np.random.default_rng(8)
UNEQUAL = STEEL.replace(
    pin_radial_errors=RNG.normal(0, 2e-5, 16),
    pin_tangential_errors=RNG.normal(0, 2e-5, 16),
    wheel_runouts=(1e-5 + 2e-5j, -2e-5j),
    lobe_pitch_errors=RNG.normal(0, 2e-5, 30),
    pin_clearance=1e-5,
    clearance=2e-5,
)
PRINTED = CycloidalGearbox.abs(n_pins=14, eccentricity=1.5e-3, shortening=0.6, pin_radius=3.5e-3)


def shaken(size: float, period: float) -> Callable[[int], np.ndarray]:
    """Deviations of both wheels and the output around the loaded state, with a period in evaluations."""

    def state(i: int) -> np.ndarray:
        found = np.zeros(8)
        swing = np.sin(2 * np.pi * i / period + np.array([0.0, 1.0, 2.0]))
        found[:3] = np.array([1.7e-3, 1.7e-3, 4.1e-3]) + size * swing
        found[4:7] = size * np.cos(2 * np.pi * i / period + np.array([0.0, 1.0, 2.0])) * 50
        return found

    return state


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gearbox", "defects"),
    [
        (STEEL, LobeDefects.healthy()),
        (UNEQUAL, LobeDefects.worn((0, 1, 5), depth=0.6)),
        (PRINTED, LobeDefects.worn(7)),
        (UNEQUAL, LobeDefects(worn_lobes=(2, 9), removed_lobes=(3, 4, 10))),
        (STEEL, LobeDefects.worn(7)),
    ],
    ids=["nominal, healthy", "unequal, some worn", "14 pins, 7 worn", "unequal, removed", "nominal, 7 worn"],
)
@pytest.mark.parametrize("size", [1e-4, 1e-3, 1e-2], ids=["quiet", "ringing", "slipping"])
def test_an_old_description_is_as_good_as_a_new_one(
    gearbox: CycloidalGearbox, defects: LobeDefects, size: float
) -> None:
    """Over a fifth of an input turn in half steps, from any place: no contact is missed, none is invented."""
    kept, anew = Kernel(gearbox, defects, remember=True), Kernel(gearbox, defects)
    state = shaken(size, 2000.0)
    largest = 0.0
    for i in range(0, 5000, 10):  # of which three or four share a description
        phi = 3.0 + SPEED * 5e-6 * i
        got, expected = (k(state(i), phi, SPEED)["external_force"] for k in (kept, anew))
        largest = max(largest, expected.max())
        error = np.abs(got - expected).max()
        assert error < 3e-4 * expected.max(), (i, error)
    assert largest > 5


def test_the_kernels_know_which_outline_they_were_compiled_with() -> None:
    """numba's cache on disk looks at one file: a change of the outline has to change the kernels' too."""
    source = Path(_outline.__file__).read_bytes()
    assert crc32(source) == kernels.OUTLINE_CHECKSUM, f"set OUTLINE_CHECKSUM = {crc32(source):#x}"
