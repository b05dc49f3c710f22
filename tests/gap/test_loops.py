"""Effects in torque-deflection loops: friction, play and compliance against the simulator and by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cyclofeat.gap import find_loop_gap
from cyclofeat.gap.cases.held_drive import (
    HeldDrive,
    Loop,
    centre_loop,
    contact_deflection,
    elastic_torque,
    loop_session,
)
from cyclofeat.simulators import CycloidalGearbox, torque_deflection

pytestmark = pytest.mark.slow  # each compiles, or searches
DRIVE = CycloidalGearbox.printed_14_pin()
FRICTION = {"coulomb": 2.0, "spread": 0.5, "load_share": 0.3}


def triangle(peak: float, n: int = 400) -> np.ndarray:
    return peak * np.interp(np.arange(n) / (n - 1), [0, 0.25, 0.75, 1], [0, 1, -1, 0])


def loop_of(rig, peak: float, noise: float = 0.0, seed: int = 0) -> SimpleNamespace:
    """A loop made with known parameters, and noise of that share of its rms."""
    torque = triangle(peak)
    ((x,),) = HeldDrive(DRIVE, 0.1).simulate([Loop(torque, 1.0)], [rig])
    error = np.random.default_rng(seed).normal(size=x.size)
    return SimpleNamespace(torque=torque, deflection=x + noise * x.std() * error)


def test_friction_is_the_play_operator_by_brute_force():
    """Many small steps, each moving only where |T - E| would exceed the friction of the load carried."""
    random = np.random.default_rng(3)
    turning = np.r_[0, random.uniform(-20, 20, 8), 25, -25, 0]
    torque = np.interp(np.linspace(0, len(turning) - 1, 700), np.arange(len(turning)), turning)
    coulomb, share = 2.0, 0.3
    elastic, expected = 0.0, np.empty_like(torque)
    for _ in range(2):
        for k, t in enumerate(torque):
            step = 2e-3
            while t - elastic > coulomb + share * abs(elastic):
                elastic += step
            while elastic - t > coulomb + share * abs(elastic):
                elastic -= step
            expected[k] = elastic
    assert elastic_torque(torque, coulomb, share) == pytest.approx(expected, abs=5e-3)
    # Many at once are each alone.
    both = elastic_torque(torque, np.array([0.5, coulomb]), np.array([0.1, share]))
    assert both[0] == pytest.approx(elastic_torque(torque, 0.5, 0.1))
    assert both[1] == pytest.approx(expected, abs=5e-3)


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_a_factor_on_the_contacts_is_that_factor_in_the_simulation(factor):
    stiffer = DRIVE.replace(
        clearance=5e-5, pin_clearance=5e-5, stiffness_scale=factor * DRIVE.stiffness_scale
    )
    run = torque_deflection(stiffer, peak_torque=30.0, n_cycles=1)
    n = run.torque.size
    at = slice(n // 4 + 5, n // 2 - 30)  # the branch on which the torque falls
    here = contact_deflection(DRIVE, run.held_torque[at], 5e-5, 1 / factor)
    assert here == pytest.approx(run.deflection[at], rel=0.02)


def test_a_drive_with_all_three_effects_is_that_in_the_simulation():
    """The series of parts against the integration of the whole drive; friction in the input's bearing."""
    rig = {
        "clearance": {"clearance": 5e-5}, "friction": FRICTION | {"spread": 0.0, "load_share": 0.0},
        "torsional_compliance": {"compliance": 1 / 400},
    }  # fmt: skip
    drive = DRIVE.replace(
        clearance=5e-5, pin_clearance=5e-5, meter_stiffness=400.0, input_bearing_torque=2.0 / DRIVE.n_lobes
    )
    torque, deflection = torque_deflection(drive, peak_torque=20.0, period=2.0).last_cycle()
    ((series,),) = HeldDrive(DRIVE, 0.1).simulate([Loop(torque, 1.0)], [rig])
    error = centre_loop(series) - centre_loop(deflection)
    assert np.sqrt(np.mean(error**2)) < 0.06 * np.sqrt(np.mean(centre_loop(deflection) ** 2))
    areas = [abs(np.trapezoid(x, torque)) for x in (series, deflection)]
    assert areas[0] == pytest.approx(areas[1], rel=0.1)


def test_friction_and_compliance_are_named_with_their_sizes_and_nothing_else():
    truth = {"friction": FRICTION, "torsional_compliance": {"compliance": 1 / 350}}
    gap = find_loop_gap([loop_of(truth, peak, 0.02, seed) for seed, peak in enumerate((5, 10, 18, 28))])
    assert {name for name, p in gap.probabilities.items() if p >= 0.5} == truth.keys() == gap.rig.keys()
    assert gap.rig["torsional_compliance"]["compliance"] == pytest.approx(1 / 350, rel=0.05)
    for name, value in FRICTION.items():
        assert gap.rig["friction"][name] == pytest.approx(value, rel=0.2)
    frame = gap.to_frame()
    assert set(frame["effect"][:2]) == truth.keys()
    assert frame["probability"].is_monotonic_decreasing
    assert "rad/Nm" in gap.describe_sizes("torsional_compliance")
    assert "torsional_compliance: missing" in str(gap)


def test_no_effect_is_named_where_the_model_is_right():
    gap = find_loop_gap([loop_of({}, peak, 0.02, seed) for seed, peak in enumerate((5, 15, 25, 35))])
    assert max(gap.probabilities.values()) < 0.5
    assert gap.rig == {}


def test_what_matters_is_the_largest_opening_of_a_loop():
    loop = loop_of({"torsional_compliance": {"compliance": 1 / 300}}, 5.0)
    assert loop_session([loop]).problem.floors == pytest.approx(0.02)
    loop.deflection = loop.deflection + np.linspace(0, 0.3, 400) * loop.deflection.std()
    assert loop_session([loop]).problem.floors == pytest.approx(0.3, rel=0.1)


@pytest.mark.parametrize(
    ("torque", "message"),
    [
        ([1.0] * 9, "swing through zero"),
        ([0.0, 120.0, 0.0, -120.0] * 3, "not exceed 115 Nm"),
        ([0.0, np.nan] * 5, "finite"),
    ],
)
def test_bad_loops_are_named(torque, message):
    with pytest.raises(ValueError, match=message):
        find_loop_gap([SimpleNamespace(torque=torque, deflection=[0.0] * len(torque))])


def test_too_few_loops_are_named():
    with pytest.raises(ValueError, match="at least one loop"):
        find_loop_gap([])
    with pytest.raises(ValueError, match="at least 3 recordings, got 2"):
        find_loop_gap([loop_of({"torsional_compliance": {"compliance": 0.01}}, 5.0)] * 2)
