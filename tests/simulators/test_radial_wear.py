"""Radial wear: the worn outline against brute force, and what it does to forces and torque."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from reference_tools import PROBE, SPEED, STIFFNESS, Kernel, State, kernel_state, pose_with_sleeve_0_at
from scipy.spatial import cKDTree

from benchmarks.reference_gearbox import ReferenceGearbox
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.simulators import Campaign, CycloidalGearbox, LobeDefects, simulate, simulate_many
from cyclofeat.simulators.campaign import _design

STEEL = CycloidalGearbox.steel()
LOADED = np.array([1.7e-3, 1.7e-3, 4.1e-3, 0, 0, 0, 0, 0])
WORN = [
    LobeDefects.worn(1, wheels=(0,), wear_um=50),
    LobeDefects.worn(1, wheels=(0,), wear_um=200, wear_share=1.0),
    LobeDefects.worn(1, wheels=(0,), wear_um=60, wear_share=0.3, wear_centre=0.7),
    LobeDefects.pitted(1, wheels=(0,), wear_um=30, length_mm=2.0, wear_centre=0.4),
]
each_worn = pytest.mark.parametrize("defects", WORN, ids=["default", "whole flank", "short", "pit"])


def worn_outline(defects: LobeDefects) -> np.ndarray:
    """Points of lobe 0 of the wheel, 1 um apart: what a pin leaves whose centre sinks by the wear."""
    t = np.linspace(-0.3, 1.3, 30_001) * np.pi / 15
    share = (t / (np.pi / 15) - defects.wear_centre) / defects.wear_share + 0.5
    depth = 1e-6 * defects.wear_um * np.sin(np.pi * np.clip(share, 0, 1)) ** 4
    path = PROBE.profile.trochoid(t) - depth * PROBE.profile.normal(t)
    tangent = np.gradient(path, t)
    return path + 1j * PROBE.pin_radius * tangent / np.abs(tangent)


@each_worn
def test_gap_is_that_of_the_nearest_point_of_the_worn_outline(defects: LobeDefects) -> None:
    """To 1e-9 m for pins pressed in by up to 0.15 mm, as in operation."""
    outline = worn_outline(defects)
    tree = cKDTree(np.column_stack([outline.real, outline.imag]))
    rng = np.random.default_rng(4)
    touched = 0
    for t in np.deg2rad(np.linspace(0.3, 11.7, 30)):
        error = complex(*rng.normal(0, 5e-5, 2))
        errors = {"pin_radial_errors": [error.real] * 16, "pin_tangential_errors": [error.imag] * 16}
        push, phi = rng.uniform(-1e-3, 2e-3), pose_with_sleeve_0_at(t)
        kernel = Kernel(PROBE.replace(**errors), defects)
        force = kernel(np.array([push, *np.zeros(7)]), phi)["external_force"][0, 0]
        centre = PROBE.pin_circle_radius + error - PROBE.eccentricity * np.exp(1j * phi)
        centre *= np.exp(1j * ((phi + np.pi) / 15 - push))
        distance, _ = tree.query([centre.real, centre.imag])
        assert (force / STIFFNESS) ** (2 / 3) == pytest.approx(max(6e-3 - distance, 0.0), abs=1e-9)
        touched += force > 0
    assert 3 < touched < 30


@pytest.mark.parametrize(
    "defects",
    [
        LobeDefects.worn((3, 9), wheels=(1,), wear_um=(50, 10)),
        LobeDefects.worn(5, wear_um=60, wear_share=0.3, wear_centre=0.3),
        LobeDefects.pitted((3,), wheels=(1,), wear_um=30, length_mm=6.0, wear_centre=0.4),
    ],
    ids=["default", "short", "pit"],
)
def test_kernel_agrees_with_the_papers_system(defects: LobeDefects) -> None:
    """The 28 bodies find the nearest point of the path in another way."""
    reference, kernel = ReferenceGearbox(STEEL, defects), Kernel(STEEL, defects)
    healthy = Kernel(STEEL, LobeDefects.healthy())
    differs = 0
    for degrees in np.arange(-1.0, 14.0, 0.5):
        phi = 15 * np.deg2rad(72 + degrees) - np.pi  # sleeve 8 on lobe 3 of wheel 1
        angles = reference.rest_angles(phi) + LOADED[:3]
        state = State(phi, SPEED, 0.0, angles, -SPEED / 15 + np.array([0.1, -0.2, 0.3]), 22.0)
        expected = reference.accelerations(*state)
        got = kernel(kernel_state(reference, state), phi, SPEED, 0.0, 22.0)
        largest = expected.external_force.max()
        for name in ("external_force", "external_vector", "internal_force"):
            assert np.abs(got[name] - getattr(expected, name)).max() < 1e-9 * largest, (name, degrees)
        assert got["input_torque"] == pytest.approx(expected.input_torque, abs=1e-9 * largest)
        differs += abs(healthy(LOADED, phi, SPEED)["external_force"][1, 8] - got["external_force"][1, 8]) > 1
    assert differs > 8


@each_worn
def test_force_along_a_passage_has_no_jump(defects: LobeDefects) -> None:
    """The largest change shrinks with the step; a jump, as of the stiffness at the wear's end, would not."""
    kernel = Kernel(STEEL, defects)

    def force(t: np.ndarray) -> np.ndarray:
        return np.array([kernel(LOADED, pose_with_sleeve_0_at(one))["external_force"][0, 0] for one in t])

    coarse = np.deg2rad(np.arange(0.0, 12.0, 0.02))
    passage = force(coarse)
    assert passage.max() > 50
    for k in np.argsort(np.abs(np.diff(passage)))[-5:]:
        fine = force(np.linspace(coarse[k], coarse[k + 1], 11))
        assert np.abs(np.diff(fine)).max() < 0.15 * abs(passage[k + 1] - passage[k])


@pytest.mark.slow
@each_worn
def test_an_old_description_is_as_good_as_a_new_one(defects: LobeDefects) -> None:
    """Where the wear ends its curvature jumps, which costs 1e-4 of a force, for short wear 1e-3."""
    kept, anew = Kernel(STEEL, defects, remember=True), Kernel(STEEL, defects)
    worst = 0.0
    for t in np.arange(0.0, np.deg2rad(12.0), SPEED * 3e-5 / 15):
        phi = pose_with_sleeve_0_at(t)
        got, expected = (kernel(LOADED, phi, SPEED)["external_force"] for kernel in (kept, anew))
        worst = max(worst, np.abs(got - expected).max() / expected.max())
    assert 0 < worst < (5e-4 if defects.wear_share > 0.3 else 2e-3)


def test_a_fine_polyline_is_worn_as_the_smooth_profile() -> None:
    defects = LobeDefects.worn(1, wheels=(0,), wear_um=40)
    smooth, corners = (Kernel(STEEL.replace(profile_points=n), defects) for n in (0, 15_000))
    for t in np.deg2rad((1.0, 4.5, 6.0, 7.5, 10.0)):
        expected, got = (k(LOADED, pose_with_sleeve_0_at(t))["external_force"][0] for k in (smooth, corners))
        assert got[0] == pytest.approx(expected[0], rel=2e-3, abs=1e-3)


def test_no_wear_is_the_healthy_gearbox_to_the_last_bit() -> None:
    options = {"duration": 0.1, "start_angle": 1.0}
    healthy, unworn = (simulate(STEEL, d, **options) for d in (None, LobeDefects.worn(7, wear_um=0)))
    assert np.array_equal(healthy.torque_out, unworn.torque_out)
    hardly = simulate(STEEL, LobeDefects.worn(7, wear_um=1e-6), **options)
    assert 0 < np.abs(hardly.torque_out - healthy.torque_out).max() < 1e-6


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="vectors exist in compiled functions only")
def test_lobe_lines_grow_with_the_wear() -> None:
    """The first 40 harmonics of 16/15 of the input speed, over one output turn; those of the mesh apart."""
    defects = [LobeDefects.worn(1, wear_um=um) for um in (0, 5, 10, 20, 40)]
    gearbox = STEEL.replace(ramp_time=0.02)
    runs = simulate_many(gearbox, defects, duration=2.0, sampling_rate=10_000.0, kernel="batch")
    last_turn = np.array([run.torque_out[-18_000:] for run in runs])
    # Without what the healthy gearbox has from its start on.
    lines = np.abs(np.fft.rfft(last_turn[1:] - last_turn[0]))
    lobe_lines = np.sqrt((np.delete(lines[:, 16 : 16 * 41 : 16], np.s_[14::15], axis=1) ** 2).sum(axis=1))
    assert np.all(lobe_lines[1:] > 1.5 * lobe_lines[:-1])
    other_lines = np.sqrt((np.delete(lines[:, : 16 * 41], np.s_[::16], axis=1) ** 2).sum(axis=1))
    assert np.all(lobe_lines > other_lines), lobe_lines / other_lines


def test_recordings_state_the_wear_that_was_drawn() -> None:
    options = {"rig": "R0", "duration": 0.05, "random_state": 3}
    worn = make_rig_recordings(2, [0, 2], wear_um=(20, 100), **options)
    chord = make_rig_recordings(2, [0, 2], **options)
    depths = [recording.meta["wear_um"] for recording in worn]
    assert depths[0] == depths[2] == 0
    assert 20 <= min(depths[1], depths[3]) < max(depths[1], depths[3]) <= 100
    assert [one.worn_lobes for one in worn] == [one.worn_lobes for one in chord]
    assert np.array_equal(worn[0].torque, chord[0].torque)
    assert not np.array_equal(worn[1].torque, chord[1].torque)
    assert "wear_um" not in chord[1].meta
    for given in ((100, 20), -1, 300):
        with pytest.raises(ValueError, match="wear_um must be a range within 0 to 200 um, got"):
            make_rig_recordings(1, [1], wear_um=given, **options)


@pytest.mark.slow
def test_a_share_of_the_recordings_has_radial_wear_and_the_others_the_chord() -> None:
    options = {"rig": "R0", "duration": 0.005, "random_state": 3}
    mixed = make_rig_recordings(24, [2], wear_um=(20, 100), radial_share=0.3, **options)
    radial = make_rig_recordings(24, [2], wear_um=(20, 100), **options)
    chord = make_rig_recordings(24, [2], **options)
    is_radial = ["wear_um" in one.meta for one in mixed]
    for one, other in zip(mixed, np.where(is_radial, radial, chord), strict=True):
        assert one == other
    assert abs(sum(is_radial) - 24 * 0.3) <= 3 * np.sqrt(24 * 0.3 * 0.7)  # binomial
    with pytest.raises(ValueError, match=r"radial_share must be above 0 and at most 1, got 1\.2"):
        make_rig_recordings(1, [1], wear_um=50, radial_share=1.2, **options)
    with pytest.raises(ValueError, match=r"radial_share needs wear_um, got 0\.5 without"):
        make_rig_recordings(1, [1], radial_share=0.5, **options)


def test_campaigns_explore_the_wear() -> None:
    campaign = Campaign(rig="R0", defect_counts=(0, 2), repeats=1, wear_um=(20, 100), duration=0.02)
    plans = list(campaign.plans())
    assert "wear_um" in campaign.explored_names
    assert 20 <= plans[1].values["wear_um"] <= 100
    rows = [result.row for result in _design.simulate_runs(campaign.replace(kernel="exact"), plans)]
    assert [row["wear_um"] for row in rows] == [0.0, plans[1].values["wear_um"]]
    assert all(row.keys() == _design.table_columns(campaign).keys() for row in rows)
    assert Campaign.from_dict(campaign.to_dict()) == campaign
    with pytest.raises(ValueError, match="depth has no effect with wear_um: leave it out, got 0.5"):
        campaign.replace(depth=0.5)
