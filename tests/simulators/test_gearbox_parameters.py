"""Parameters of the gearbox and its faults: defaults, presets, refusals, geometry."""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np
import pytest

from benchmarks.reference_gearbox import ReferenceGearbox
from cyclofeat.simulators import CycloidalGearbox, LobeDefects
from cyclofeat.simulators.defects import check_machine
from cyclofeat.simulators.tables import joint_effective_radius, kernel_input, stiffness_factor

STEEL = CycloidalGearbox.steel()


def test_lobes_count_from_0() -> None:
    assert LobeDefects.worn(3).worn_lobes == (0, 1, 2)
    assert LobeDefects.worn(3).wheels == (0, 1)
    assert LobeDefects.worn(3).depth == 1.0
    some = LobeDefects.worn((4, 0), wheels=(0,), depth=0.3)
    assert (some.worn_lobes, some.removed_lobes, some.wheels, some.depth) == ((0, 4), (), (0,), 0.3)
    gone = LobeDefects.removed(7, wheels=(0,))
    assert (gone.worn_lobes, gone.removed_lobes, gone.wheels) == ((), tuple(range(7)), (0,))
    assert LobeDefects.removed((2, 9)).removed_lobes == (2, 9)
    assert LobeDefects.healthy() == LobeDefects.worn(0) == LobeDefects()
    assert LobeDefects.worn(np.int64(2)) == LobeDefects.worn(np.array([1, 0])) == LobeDefects.worn(range(2))


def test_radial_wear_belongs_to_its_lobes() -> None:
    some = LobeDefects.worn((4, 0), wear_um=(20, 50))
    assert (some.worn_lobes, some.wear_um, some.depth) == ((0, 4), (50.0, 20.0), 0.0)
    assert some.defect_count == 2
    assert dataclasses.replace(some, wheels=(0,)).wear_um == some.wear_um
    assert "wear_um=(50.0, 20.0)" in repr(some)
    pitted = LobeDefects.pitted(1, wear_um=5, length_mm=1.5, wear_centre=0.4)
    centre, half = pitted.wear_centre, pitted.wear_share / 2
    outline = STEEL.profile.point(np.linspace(centre - half, centre + half, 2001) * math.pi / 15)
    assert np.abs(np.diff(outline)).sum() == pytest.approx(1.5e-3, rel=1e-5)


def test_defect_count_is_of_distinct_lobes_whichever_wheels_carry_them() -> None:
    assert LobeDefects.healthy().defect_count == 0
    assert LobeDefects.worn(7).defect_count == LobeDefects.worn(7, wheels=(1,)).defect_count == 7
    assert LobeDefects(worn_lobes=(1,), removed_lobes=(4, 5)).defect_count == 3


def test_defects_cannot_change() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        LobeDefects.worn(1).depth = 0.5  # type: ignore[misc]
    assert hash(LobeDefects.worn(2)) == hash(LobeDefects.worn((1, 0)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LobeDefects.worn(-1), "lobes must be a number of lobes from 0, or their indices, got -1"),
        (lambda: LobeDefects.worn(2.5), "lobes must be a number of lobes .* got 2.5"),
        (lambda: LobeDefects(worn_lobes=3), "worn_lobes must be distinct whole numbers from 0, got 3"),
        (lambda: LobeDefects.worn((0, 0)), r"worn_lobes must be distinct whole numbers from 0, got \(0, 0\)"),
        (lambda: LobeDefects.worn((0.5,)), r"worn_lobes must be distinct .* got \(0.5,\)"),
        (lambda: LobeDefects.removed((-1, 2)), r"removed_lobes must be distinct .* got \(-1, 2\)"),
        (lambda: LobeDefects.worn(1, wheels=(2,)), r"wheels must be \(0,\), \(1,\) or \(0, 1\), got \(2,\)"),
        (lambda: LobeDefects.worn(1, depth=1.5), r"depth must lie between 0 .* and 1 .* got 1.5"),
        (lambda: LobeDefects.worn(1, wear_um=201), "wear_um must lie between 0 and 200 um, got 201"),
        (lambda: LobeDefects.worn(1, wear_um=math.nan), "wear_um must be finite, got nan"),
        (lambda: LobeDefects.worn(2, wear_um=(1, 2, 3)), "one for each worn lobe, got 3 values for 2 worn"),
        (lambda: LobeDefects.worn(1, depth=0.5, wear_um=50), "depth must be 0 with wear_um .* got 0.5"),
        (lambda: LobeDefects.worn(1, wear_share=0.3), "wear_share and wear_centre have no effect without"),
        (lambda: LobeDefects.worn(1, wear_um=9, wear_share=0), "wear_share must lie above 0 and up to 1"),
        (
            lambda: LobeDefects.worn(1, wear_um=9, wear_centre=0.2),
            "wear_centre must lie between 0.3 and 0.7, so that a wear_share of 0.6 .* got 0.2",
        ),
        (
            lambda: LobeDefects.pitted(1, wear_um=9, length_mm=8, wear_centre=0.9),
            "length_mm must be at most 5.41 about wear_centre, got 8",
        ),
        (
            lambda: check_machine(STEEL, LobeDefects.pitted(1, wear_um=20, length_mm=1)),
            "wear_um must be at most 12.6 with wear_share=0.112 .* a pin reaches no deeper .* got 20",
        ),
        (
            lambda: LobeDefects(worn_lobes=(1, 2), removed_lobes=(2,)),
            r"worn_lobes and removed_lobes must not overlap, both hold \[2\]",
        ),
        (
            lambda: check_machine(STEEL, LobeDefects.removed((3, 15))),
            r"defects name lobe 15 \(from 0\), but the wheel has 15 lobes",
        ),
    ],
)
def test_impossible_defects_are_refused(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        *(({"depth": depth}, "depth must be a number, got") for depth in ("deep", [0.5], True)),
        *(
            ({"wear_um": wear}, "wear_um must be a number of um, or one for each worn lobe, got")
            for wear in ("deep", 3j, (1, None))
        ),
    ],
)
def test_defects_of_another_type_are_refused(given: dict, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        LobeDefects.worn(2, **given)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"load_torque": 10**400}, "load_torque must be finite, got 1000"),
        ({"eccentricity": 0.0}, "eccentricity must be positive and finite, got 0.0"),
        ({"eccentricity": math.nan}, "eccentricity must be positive and finite, got nan"),
        ({"clearance": -1e-6}, "clearance must be finite and not negative, got -1e-06"),
        ({"shortening": 1.0}, "shortening must lie between 0 and 1, got 1.0"),
        ({"n_pins": 3}, "n_pins must be at least 4, got 3"),
        ({"n_internal_sleeves": 129}, "n_internal_sleeves must be at most 128, got 129"),
        ({"wheel_poisson_ratio": 0.7}, "wheel_poisson_ratio must lie between 0 and 0.5, got 0.7"),
        ({"contact_law": "hertz"}, "contact_law must be one of .* got 'hertz'"),
        ({"brake_inertia": 0.1}, "brake_inertia needs a meter_stiffness above 0 .* got 0"),
        ({"pin_radial_errors": (0.0, 0.0)}, "pin_radial_errors must be empty or hold 16 values, got 2"),
        ({"wheel_runouts": (0j,) * 3}, "wheel_runouts must be empty or hold 2 values, got 3"),
        ({"pin_tangential_errors": (math.inf,) * 16}, "pin_tangential_errors must be finite"),
        ({"pin_radius": 0.014}, "pin_radius must be below 0.0131227 m, else undercut, got 0.014"),
    ],
)
def test_impossible_gearboxes_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        CycloidalGearbox(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"load_torque": [22.0]}, "load_torque must be a number, got [22.0]"),
        ({"ramp_time": True}, "ramp_time must be a number, got True"),
        ({"profile_points": "smooth"}, "profile_points must be a whole number, got 'smooth'"),
        (
            {"pin_radial_errors": 0.0},
            "pin_radial_errors must be a sequence of numbers (m), or empty, got 0.0",
        ),
        ({"pin_radial_errors": np.zeros((16, 2))}, "pin_radial_errors must be a sequence of numbers (m)"),
        ({"lobe_pitch_errors": ["a"] * 30}, "lobe_pitch_errors must be a sequence of numbers (m)"),
        ({"wheel_runouts": ["1", "2"]}, "wheel_runouts must be a sequence of complex numbers (m)"),
    ],
)
def test_parameters_of_another_type_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(TypeError, match=re.escape(message)) as caught:
        CycloidalGearbox(**changes)
    assert "\n" not in str(caught.value)


def test_arrays_are_taken_as_what_they_mean() -> None:
    gearbox = CycloidalGearbox(pin_radial_errors=np.zeros(16), wheel_runouts=[1e-6, 2e-6j])
    assert gearbox.pin_radial_errors == (0.0,) * 16
    assert gearbox.wheel_runouts == (1e-6, 2e-6j)
    assert hash(gearbox) == hash(gearbox.replace())


def test_presets_are_the_papers() -> None:
    assert CycloidalGearbox() == STEEL
    assert STEEL.input_speed_hz == pytest.approx(500 / 60)
    assert (STEEL.n_lobes, STEEL.pin_circle_radius) == (15, pytest.approx(64e-3))
    assert STEEL.output_inertia == pytest.approx(1.373e-4 + 8 * 0.048 * 36e-3**2)
    plastic = CycloidalGearbox.abs(load_torque=5.0)
    assert (plastic.wheel_youngs_modulus, plastic.contact_damping) == (2.2e9, 20.0)
    assert (plastic.load_torque, plastic.eccentricity) == (5.0, STEEL.eccentricity)


def test_contact_parameters_are_those_of_the_papers_system() -> None:
    """Paper B eq. 14-16, and the effective radius of a sleeve in a hole that is wider by e."""
    for gearbox in (STEEL, CycloidalGearbox.abs()):
        reference = ReferenceGearbox(gearbox)
        for radius in (3e-3, 6e-3):
            force = stiffness_factor(gearbox) * radius**0.5 * 1e-4**1.5
            found = reference.normal_force(np.array(-1e-4), np.array(0.0), radius)
            assert force == pytest.approx(float(found))
    assert joint_effective_radius(STEEL) == pytest.approx(6e-3 * 8.8e-3 / 2.8e-3)


def test_profile_is_that_of_the_papers_system() -> None:
    for gearbox in (
        STEEL,
        CycloidalGearbox(eccentricity=1.5e-3, n_pins=14, shortening=0.6, pin_radius=3.5e-3),
    ):
        profile, reference = gearbox.profile, ReferenceGearbox(gearbox)
        t = np.linspace(0, 7, 300)
        assert np.abs(profile.trochoid(t) - reference.trochoid(t)).max() < 1e-16
        assert np.abs(profile.point(t) - reference.profile(t)).max() < 1e-16
        assert np.abs(profile.normal(t) - reference.normal(t)).max() < 1e-13
        assert profile.curvature(t) == pytest.approx(reference.curvature(t), rel=1e-10)
        assert np.all(profile.effective_radius(t) > 0)


def test_effective_radius_has_the_sign_of_the_flank() -> None:
    """Concave flanks make it larger than the pin's radius: 3.6 mm at the tip, 69.7 mm at the pit."""
    radii = STEEL.profile.effective_radius([0.0, np.deg2rad(6.38), np.pi / 15])
    assert 1e3 * radii == pytest.approx([3.625, 3.26, 69.75], abs=0.01)
    concave = -6.57e-3
    assert radii[2] == pytest.approx(1 / (1 / concave + 1 / 6e-3), rel=0.02)


def test_effective_radius_with_clearance_is_that_of_the_deeper_outline() -> None:
    loose = STEEL.replace(pin_clearance=5e-5)
    places = np.linspace(0.0, np.pi / 15, 7)
    outline = 1 / loose.profile.curvature(places) - loose.pin_radius - loose.pin_clearance
    expected = 1 / (1 / loose.pin_radius + 1 / outline)
    assert loose.profile.effective_radius(places, loose.pin_clearance) == pytest.approx(expected, rel=1e-12)
    found = kernel_input(loose, LobeDefects.healthy()).wheel
    assert (found.tip_radius, found.pit_radius) == pytest.approx(expected[[0, -1]], rel=1e-12)
    assert abs(expected[-1] / STEEL.profile.effective_radius(np.pi / 15) - 1) > 1e-3


def test_outline_is_closed_and_holds_the_chords() -> None:
    profile = STEEL.profile
    healthy, worn = profile.outline(), profile.outline((0, 7), points_per_lobe=100)
    assert healthy.size == 3000
    assert np.abs(np.diff(np.append(worn, worn[0]))).max() < 1e-3
    tip, pit = profile.chord()
    assert worn[700 + 25] == pytest.approx((tip + pit) / 2 * np.exp(2j * np.pi * 7 / 15))
    assert np.abs(worn[100:700] - profile.outline(points_per_lobe=100)[100:700]).max() == 0
