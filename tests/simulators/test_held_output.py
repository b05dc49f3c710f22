"""Torque against deflection with the output held: play, stiffness and hysteresis as they must be."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.simulators import CycloidalGearbox, LobeDefects, torque_deflection
from cyclofeat.simulators.simulation import SimulationDiverged

pytestmark = pytest.mark.slow

STEEL = CycloidalGearbox.steel()
CONSERVATIVE = CycloidalGearbox.steel(contact_law="conservative")


def test_play_is_that_of_the_clearance() -> None:
    """2 c / r of the internal sleeves; what is left without clearance is Hertz's soft start and damping."""
    tight = torque_deflection(STEEL, period=0.5).lost_motion()
    for clearance in (3e-5, 1e-4):
        loose = torque_deflection(STEEL.replace(clearance=clearance), period=0.5)
        expected = 2 * clearance / STEEL.internal_pitch_radius
        assert loose.lost_motion() - tight == pytest.approx(expected, rel=0.02)
    assert tight < 6e-4


def test_compliance_of_the_meter_adds_in_series() -> None:
    stiff = torque_deflection(STEEL, period=0.5)
    soft = torque_deflection(STEEL.replace(meter_stiffness=320.0, meter_damping=0.05), period=0.5)
    added = soft.deflection.max() - stiff.deflection.max()
    assert added == pytest.approx(22.0 / 320, rel=0.03)
    assert soft.stiffness() == pytest.approx(1 / (1 / 320 + 1 / stiff.stiffness()), rel=0.06)


@pytest.mark.slow  # compiles the kernel with friction
def test_hysteresis_is_the_friction_times_the_way() -> None:
    """An input bearing of T rubs over 4 times the largest deflection, as seen from the input."""
    smooth = torque_deflection(CONSERVATIVE, period=0.5)
    rubbing = torque_deflection(CONSERVATIVE.replace(input_bearing_torque=0.1), period=0.5)
    expected = 0.1 * 15 * 4 * rubbing.deflection.max()
    assert rubbing.hysteresis() - smooth.hysteresis() == pytest.approx(expected, rel=0.05)
    assert smooth.hysteresis() < 0.05 * expected
    # What the bearing keeps does not reach the output.
    assert rubbing.held_torque.max() == pytest.approx(22.0 - 1.5, rel=0.01)


def test_torque_is_passed_on_in_full_where_nothing_is_lost() -> None:
    """The reduction is exact with conservative contacts; the papers' law makes something from nothing."""
    ratios = []
    for gearbox in (CONSERVATIVE, STEEL):
        loop = torque_deflection(gearbox, period=1.0)
        ratios.append(np.polyfit(loop.torque, loop.held_torque, 1)[0])
    assert ratios[0] == pytest.approx(1.0, abs=1e-3)
    assert ratios[1] > 1.003


def test_slow_enough_is_quasi_static() -> None:
    fast, slow = (torque_deflection(STEEL, period=period, n_points=400) for period in (0.5, 2.0))
    loaded = np.abs(slow.last_cycle()[0]) > 4  # through the play at zero torque the input flies
    largest = slow.deflection.max()
    assert fast.last_cycle()[1][loaded] == pytest.approx(slow.last_cycle()[1][loaded], abs=0.02 * largest)
    assert slow.hysteresis() < 0.5 * fast.hysteresis()


def test_a_worn_lobe_under_load_softens_the_loop() -> None:
    """Where a chord carries instead of the flank; elsewhere nothing changes."""
    healthy = torque_deflection(STEEL, period=0.5, input_angle=0.5)
    stiffness = [
        torque_deflection(STEEL, LobeDefects.worn((lobe,)), period=0.5, input_angle=0.5).deflection.max()
        for lobe in range(15)
    ]
    changed = np.abs(np.array(stiffness) - healthy.deflection.max()) > 1e-9
    assert 2 < changed.sum() < 13


def test_the_printed_drive() -> None:
    gearbox = CycloidalGearbox.printed_14_pin()
    loop = torque_deflection(gearbox, peak_torque=25.0, period=0.5)
    assert loop.torque.max() == pytest.approx(25.0, rel=0.01)
    # both clearances open the play
    assert loop.lost_motion() > 2 * 5e-5 / 20e-3
    assert loop.cycle.tolist() == sorted(loop.cycle.tolist())


@pytest.mark.parametrize(
    ("error", "options", "message"),
    [
        (ValueError, {"peak_torque": 0.0}, "peak_torque must be positive and finite, got 0.0"),
        (ValueError, {"n_cycles": 0}, "n_cycles must be at least 1"),
        (ValueError, {"input_angle": float("inf")}, "input_angle must be finite"),
        (ValueError, {"period": 1e6}, "more than 1e\\+08"),
        (ValueError, {"defects": LobeDefects.worn((15,))}, "defects name lobe 15"),
        (TypeError, {"gearbox": 3}, "gearbox must be of type CycloidalGearbox, got 3"),
        (TypeError, {"n_points": 100.5}, "n_points must be a whole number, got 100.5"),
    ],
)
def test_bad_input(error: type[Exception], options: dict, message: str) -> None:
    with pytest.raises(error, match=message):
        torque_deflection(**options)


def test_too_few_points_and_divergence_are_found() -> None:
    with pytest.raises(ValueError, match="fewer than 3 points: raise n_points"):
        torque_deflection(STEEL, period=0.2, n_points=8).stiffness()
    with pytest.raises(SimulationDiverged):
        torque_deflection(STEEL.replace(stiffness_scale=100.0), peak_torque=500.0, period=0.05, dt=1e-4)
