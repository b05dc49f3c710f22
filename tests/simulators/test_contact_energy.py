"""The worn lobe's outline is closed: the force has no jump."""

from __future__ import annotations

import numpy as np
import pytest
from reference_tools import sweep

from cyclofeat.simulators import CycloidalGearbox, LobeDefects

STEEL = CycloidalGearbox.steel()
# Push on the wheels (rad), radial error of the pin (m), depth of the wear: every two of their values meet.
PUSHED = [
    (push, error, 1.0 if (i + j) % 2 else 0.5)
    for i, push in enumerate((0.0, 2e-3, -2e-3))
    for j, error in enumerate((0.0, 3e-5, -3e-5))
]


def with_radial_error(gearbox: CycloidalGearbox, error: float) -> CycloidalGearbox:
    return gearbox.replace(pin_radial_errors=np.full(16, error))


@pytest.mark.slow
@pytest.mark.parametrize(("push", "radial_error", "depth"), PUSHED)
def test_force_over_a_worn_lobe_has_no_jump(push: float, radial_error: float, depth: float) -> None:
    """In steps of 0.002 degrees; where the change is largest it shrinks with the steps, a jump would not.

    Where a step of 0.02 degrees changes less than a small one may, nothing is hidden in it.
    """
    gearbox, defects = with_radial_error(STEEL, radial_error), LobeDefects.worn(1, wheels=(0,), depth=depth)
    coarse = np.deg2rad(np.arange(-1.0, 25.0, 0.02) + 1e-5)
    force = sweep(gearbox, defects, coarse, push)
    largest = force[:, 0].max()
    assert largest > 500 * depth
    changes = np.abs(np.diff(force, axis=0))
    steep = (changes > 0.003 * largest).any(axis=1) | (changes == changes.max(axis=0)).any(axis=1)
    between = [np.linspace(coarse[k], coarse[k + 1], 11)[1:-1] for k in np.flatnonzero(steep)]
    t = np.sort(np.concatenate([coarse, *between]))
    changes = np.abs(np.diff(sweep(gearbox, defects, t, push), axis=0))
    assert changes.max() < 0.003 * largest
    changes[np.diff(t) > np.deg2rad(0.003)] = 0
    for column in (0, 1):
        worst = int(np.argmax(changes[:, column]))
        fine = sweep(gearbox, defects, np.linspace(t[worst], t[worst + 1], 11), push)
        assert np.abs(np.diff(fine[:, column])).max() < 0.11 * changes[worst, column]


@pytest.mark.slow
@pytest.mark.parametrize("removed", [(0,), (14, 0), (0, 1)])
def test_force_at_the_edges_of_removed_lobes_has_no_jump(removed: tuple[int, ...]) -> None:
    """The outline ends in the tips beside them."""
    defects = LobeDefects.removed(removed, wheels=(0,))
    gearbox = with_radial_error(STEEL, -5e-5)
    t = np.deg2rad(np.arange(-26.0, 50.0, 0.01) + 1e-5)
    force = sweep(gearbox, defects, t, 0.0)[:, 0]
    assert force.max() > 5
    assert np.all(force[(t > np.deg2rad(2.5)) & (t < np.deg2rad(21.5))] == 0)
    assert np.abs(np.diff(force)).max() < 0.01 * force.max()
