"""The next measurement: the one that a person at the bench would choose."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.gap import World
from cyclofeat.gap.confirm.next_measurement import rank_measurements
from cyclofeat.gap.world.world import Session

WORLD = World()
ONE, TWO_LOADS, TWO_SPEEDS = [(500, 22, 1)], [(500, 14, 1), (500, 28, 1)], [(400, 22, 1), (600, 22, 1)]
BOTH_WAYS = [(500, 22, 1), (500, 22, -1)]


def ranked(undecided, conditions=ONE, tachometer=False):
    at = np.array(conditions, dtype=float)
    session = Session(np.zeros((len(at), 1)), at, speeds_rpm=at[:, 0] if tachometer else None)
    return rank_measurements(dict.fromkeys(undecided.split(), 0.9), session, WORLD)


@pytest.mark.parametrize(
    ("undecided", "conditions", "what"),
    [
        # Mains hum lies on the 6th order at 500 RPM; at 400 RPM half-way between two.
        ("hum", ONE, "recordings at 400 RPM"),
        ("hum input_shaft_line", ONE, "recordings at 400 RPM"),
        ("hum", TWO_SPEEDS, "a record with the motor off"),
        ("gain offset", ONE, "recordings at 11 Nm"),
        ("gain offset", TWO_LOADS, "recordings in reverse"),
        ("offset bearing_friction", TWO_LOADS, "recordings in reverse"),
        ("offset bearing_friction", [*TWO_LOADS, *BOTH_WAYS], "recordings at 400 RPM"),
        ("clock_error speed_scale", ONE, "recordings with a tachometer"),
        ("noise", ONE, "a record with the motor off"),
        ("brake_rotor", ONE, "recordings at 400 RPM"),
        ("load_warm_up", ONE, "longer records, of several output turns"),
    ],
)
def test_what_decides_most_comes_first(undecided, conditions, what):
    first = ranked(undecided, conditions)[0]
    assert first.what == what
    assert set(undecided.split()) & set(first.decides)


def test_nothing_is_proposed_that_was_done_or_decides_nothing():
    assert ranked("") == ()
    assert all("tachometer" not in row.what for row in ranked("clock_error speed_scale", tachometer=True))
    (reverse,) = [row for row in ranked("offset gain") if "reverse" in row.what]
    assert set(reverse.decides) == {"offset", "gain"}  # what decides about one decides about its look-alike
