"""Random assemblies: reproducible, inside their bounds, with the stated spread."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cyclofeat.simulators import AssemblyTolerances, CycloidalGearbox

STEEL = CycloidalGearbox.steel()
DRAWN = {
    "stiffness_scale",
    "contact_damping",
    "load_torque",
    "input_speed",
    "clearance",
    "pin_radial_errors",
    "pin_tangential_errors",
    "wheel_runouts",
}
shares = st.floats(0, 0.9)
lengths = st.floats(0, 1e-4)


@st.composite
def tolerances(draw: st.DrawFn) -> AssemblyTolerances:
    low, high = sorted((draw(lengths), draw(lengths)))
    return AssemblyTolerances(
        pin_position=draw(lengths),
        runout=draw(lengths),
        stiffness=draw(shares),
        damping=draw(shares),
        load=draw(shares),
        speed=draw(shares),
        clearance=(low, high),
    )


@settings(derandomize=True, deadline=None, max_examples=60)
@given(tolerances(), st.integers(0, 2**32 - 1), st.sampled_from([4, 14, 16]))
def test_draws_stay_inside_their_bounds(spread: AssemblyTolerances, seed: int, n_pins: int) -> None:
    nominal = STEEL.replace(n_pins=n_pins)
    drawn = spread.draw(nominal, seed)
    for name, width in (
        ("stiffness_scale", spread.stiffness),
        ("contact_damping", spread.damping),
        ("load_torque", spread.load),
        ("input_speed", spread.speed),
    ):
        assert abs(getattr(drawn, name) / getattr(nominal, name) - 1) <= width + 1e-12
    assert spread.clearance[0] <= drawn.clearance <= spread.clearance[1]
    assert len(drawn.pin_radial_errors) == len(drawn.pin_tangential_errors) == n_pins
    assert len(drawn.wheel_runouts) == 2
    assert np.abs([*drawn.pin_radial_errors, *drawn.pin_tangential_errors]).max() <= 6 * spread.pin_position
    assert np.abs(drawn.wheel_runouts).max() <= 9 * spread.runout
    for field in dataclasses.fields(nominal):
        if field.name not in DRAWN:
            assert getattr(drawn, field.name) == getattr(nominal, field.name)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(tolerances(), st.integers(0, 2**32 - 1))
def test_draws_follow_from_the_seed_alone(spread: AssemblyTolerances, seed: int) -> None:
    drawn = spread.draw(STEEL, seed)
    np.random.default_rng(1).random(10)
    assert spread.draw(STEEL, seed) == drawn
    assert spread.draw(STEEL, np.random.default_rng(seed)) == drawn
    # What an assembly had before does not matter, where it is drawn anew.
    assert spread.draw(STEEL.replace(clearance=5e-5, pin_radial_errors=(1e-5,) * 16), seed) == drawn


def test_spread_is_as_stated() -> None:
    drawn = [AssemblyTolerances().draw(STEEL, seed) for seed in range(400)]
    pins = np.array([[*one.pin_radial_errors, *one.pin_tangential_errors] for one in drawn])
    assert pins.std() == pytest.approx(10e-6, rel=0.03)
    assert abs(pins.mean()) < 0.3e-6
    runouts = np.array([one.wheel_runouts for one in drawn])
    assert np.std([runouts.real, runouts.imag]) == pytest.approx(5e-6, rel=0.06)
    for name, width in (("stiffness_scale", 0.25), ("contact_damping", 0.25), ("load_torque", 0.03)):
        relative = np.array([getattr(one, name) for one in drawn]) / getattr(STEEL, name) - 1
        assert np.ptp(relative) > 1.95 * width
        assert relative.std() == pytest.approx(width / 3**0.5, rel=0.1)
    clearances = [one.clearance for one in drawn]
    assert np.mean(clearances) == pytest.approx(15e-6, rel=0.1)
    assert len(set(drawn)) == 400


def test_no_tolerance_leaves_the_gearbox_as_it_is() -> None:
    none = AssemblyTolerances(0, 0, 0, 0, 0, 0, (0.0, 0.0))
    drawn = none.draw(STEEL, 1)
    assert drawn.replace(pin_radial_errors=(), pin_tangential_errors=(), wheel_runouts=()) == STEEL
    assert not np.any([*drawn.pin_radial_errors, *drawn.pin_tangential_errors, *drawn.wheel_runouts])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pin_position": -1e-6}, "pin_position must be finite and not negative, got -1e-06"),
        ({"runout": float("nan")}, "runout must be finite and not negative, got nan"),
        ({"load": 1.0}, "load is a relative half width below 1, got 1.0"),
        ({"clearance": (2e-5, 1e-5)}, r"clearance must be \(lower, upper\) in m, got \(2e-05, 1e-05\)"),
        ({"clearance": 1e-5}, r"clearance must be \(lower, upper\) in m, got 1e-05"),
        ({"clearance": (0.0, float("inf"))}, "clearance must be finite"),
    ],
)
def test_impossible_tolerances_are_refused(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AssemblyTolerances(**options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"load": None}, "load must be a number, got None"),
        ({"pin_position": [1e-6, 1e-6]}, r"pin_position must be a number, got \[1e-06, 1e-06\]"),
        ({"clearance": (0.0, "a")}, r"clearance must be \(lower, upper\) in m, got 'a'"),
    ],
)
def test_tolerances_of_another_type_are_refused(options: dict, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        AssemblyTolerances(**options)


def test_draws_need_a_gearbox_and_a_seed() -> None:
    with pytest.raises(TypeError, match="gearbox must be of type CycloidalGearbox, got 'steel'"):
        AssemblyTolerances().draw("steel", 1)  # type: ignore[arg-type]
    with pytest.raises(
        TypeError, match="seed must be a whole number, a SeedSequence or a Generator, got 'a'"
    ):
        AssemblyTolerances().draw(STEEL, "a")  # type: ignore[arg-type]


def test_a_list_of_two_is_a_range() -> None:
    assert AssemblyTolerances(clearance=[0.0, 3e-5]) == AssemblyTolerances()  # type: ignore[arg-type]
