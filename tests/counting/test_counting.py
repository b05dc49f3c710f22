"""Counting: pipelines, grouped evaluation, locating, models for whole recordings."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import butter, sosfilt
from small_model import first_of_each, recording, shaft_model, small_model

from cyclofeat.counting import LobeModel, Protocol, evaluate, make_lobe_counter, passage_of_lobe_zero
from cyclofeat.counting.model.turning import turning_of
from cyclofeat.recordings import Recording, Windower

SPEED = 500 / 60


@pytest.fixture(scope="module")
def windows(surrogates):
    return Windower(input_speed_hz=SPEED).windows(surrogates)


@pytest.fixture(scope="module")
def model(surrogates):
    """Trained on six assemblies of each count, the last two of each left for testing."""
    known = [r for r, seen in zip(surrogates, first_of_each(surrogates, 6), strict=True) if seen]
    return LobeModel(n_splits=0, n_trees=60, random_state=0).fit(known)


# Evaluation


@pytest.mark.slow
def test_the_lobe_map_counts_where_the_entropy_cannot(windows):
    """Finding 3 of the toolkit's facts, on few assemblies: far above, against near, chance (0.25)."""
    by_map, by_entropy = (
        evaluate(
            make_lobe_counter(25_600, kind=kind, n_trees=60), windows.X, windows.y, windows.groups,
            protocol=Protocol(n_splits=4, random_state=0),
        ).accuracy
        for kind in ("lobe_map", "entropy")
    )  # fmt: skip
    assert by_map >= 0.9
    assert by_entropy <= 0.6


# Locating


def test_a_sixteenth_of_a_turn_of_the_cam_brings_the_next_lobe():
    start = np.array([0.3, 0.3 + 2 * np.pi / 16, 0.3 + 2 * np.pi * 15 / 16])
    first, second, again = passage_of_lobe_zero(start)
    assert (first - second) % 1 == pytest.approx(1 / 15)
    assert first == pytest.approx(again)
    assert_allclose(passage_of_lobe_zero(start + 15 * 2 * np.pi), passage_of_lobe_zero(start))


def test_lobe_zero_passes_when_the_cam_points_at_its_tip():
    """At phi = 14 pi/16 ... the cam's direction in the wheel's frame, phi - theta_1, is a whole turn."""
    passage = passage_of_lobe_zero([0.0])[0]
    phi = passage * 15 / 16 * 2 * np.pi  # 15/16 of a turn a period
    theta = -(phi + np.pi) / 15
    assert np.cos(phi - theta) == pytest.approx(1)


# Whole recordings


def test_counts_and_positions_of_recordings_never_seen(model, surrogates):
    unseen = [r for r, seen in zip(surrogates, first_of_each(surrogates, 6), strict=True) if not seen]
    counts = [model.count(r) for r in unseen]
    assert np.mean([c.defect_count == r.defect_count for c, r in zip(counts, unseen, strict=True)]) >= 7 / 8
    assert all(c.absolute for c in counts)
    # Six assemblies of each class are few to learn positions from: most lobes right, not every set.
    overlap = [
        len(set(c.lobes) & set(r.worn_lobes)) / r.defect_count
        for c, r in zip(counts, unseen, strict=True)
        if r.defect_count == c.defect_count != 0
    ]
    assert np.mean(overlap) >= 0.7
    for count in counts:
        assert len(count.lobes) == count.defect_count
        assert len(count.lobe_probability) == 15
        assert sum(count.probability.values()) == pytest.approx(1)


def test_without_an_angle_positions_are_relative_and_said_to_be(model, surrogates):
    recording = surrogates[-1]
    blind = model.count(recording.replace(angle=None, angle_is_absolute=False))
    seeing = model.count(recording)
    assert not blind.absolute
    assert any("relative" in warning for warning in blind.warnings)
    # The same lobes, counted from another one.
    assert any({(lobe + k) % 15 for lobe in blind.lobes} == {*seeing.lobes} for k in range(15))


def test_windows_of_one_recording_are_combined(model, surrogates):
    recording = surrogates[0]
    once = model.count(recording)
    both = model.count(joined([recording, recording]))
    assert (once.n_windows, both.n_windows) == (1, 2)
    assert [window.defect_count for window in both.windows] == [once.defect_count] * 2
    least = min(window.probability for window in both.windows)
    assert max(both.probability.values()) >= min(least, max(once.probability.values())) - 1e-6


def test_a_drifting_speed_does_not_move_the_lobes():
    """Ten turns without a tachometer, the last of them slower by a hundredth: the lobes stay."""
    model = small_model()
    for slowing in (0.0, 0.01):
        made = recording((4, 5, 6), seed=99, turns=10, slowing=slowing)
        found = model.count(made.replace(angle=None, angle_is_absolute=False))
        assert found.n_windows == 10
        # counted from the first to pass, which is a lobe and a half from lobe 0
        assert found.lobes == (3, 4, 5)
        assert min(found.lobe_probability[lobe] for lobe in found.lobes) > 0.6


@pytest.mark.slow
def test_recordings_of_several_rates_and_speeds_train_a_model(surrogates):
    """Every second recording at half the rate; and a disc that turns 10 % faster is counted alike."""
    mixed = [
        one.replace(torque=one.torque[::n], angle=one.angle[::n], sampling_rate=25_600 / n)
        for one, n in zip(surrogates, [1, 2] * 16, strict=True)
    ]
    model = LobeModel(n_splits=0, n_trees=60, random_state=0).fit(mixed)
    low, high = model.card_["speeds_rpm"]
    assert 490 < low < 500 < high < 510
    for one in surrogates[:8]:
        faster = one.replace(sampling_rate=1.04 * 25_600.0, speed_rpm=520.0)
        assert model.count(faster).probability == pytest.approx(model.count(one).probability, abs=1e-6)
    with pytest.raises(ValueError, match=r"sampling_rate must be at least 10\d\d\.?\d* Hz at 49\d"):
        model.count(one.replace(torque=one.torque[::32], angle=one.angle[::32], sampling_rate=800.0))


def test_training_needs_labels_of_more_than_one_kind(surrogates):
    with pytest.raises(ValueError, match="must all state their defect_count"):
        LobeModel().fit([surrogates[0].replace(defect_count=None, worn_lobes=None)])
    with pytest.raises(ValueError, match="at least two defect counts, got 0 only"):
        LobeModel().fit([r for r in surrogates if r.defect_count == 0])


@pytest.mark.parametrize("share", [0.9, 1 / 2, 1 / 3, 1 / 4, 2.0])
def test_a_disc_at_another_speed_is_refused_and_not_called_healthy(model, surrogates, share):
    """The stated speed is wrong, there is no tachometer: only the torque tells."""
    worn = max(surrogates, key=lambda recording: recording.defect_count)
    long = np.tile(worn.torque, max(1, round(share)))
    samples = np.arange(round(long.size / share))
    other = np.interp(share * samples, np.arange(long.size), long)
    other += np.random.default_rng(0).normal(0, 0.2, other.size)  # of the sensor: another speed leaves it
    found = model.count(worn.replace(torque=other, angle=None, angle_is_absolute=False))
    assert found.refused
    assert re.search("the stated 500 RPM", found.reason)
    assert not model.count(worn.replace(angle=None, angle_is_absolute=False)).refused


def filtered(torque):
    return sosfilt(butter(4, 50, fs=25_600, output="sos"), torque - torque[0]) + torque[0]


def test_spoiled_recordings_are_refused_with_the_reason(model, surrogates):
    for one in surrogates[::8]:
        count = model.count(one.replace(torque=filtered(one.torque)))
        assert count.refused
        assert count.reason.startswith("a low-pass filter has removed")
        assert [window.reason for window in count.windows] == [count.reason]
        facts = count.to_dict()
        assert (facts["defect_count"], facts["refused_defect_count"]) == (None, count.defect_count)


def joined(recordings):
    """One recording after the other, without a tachometer and without a jump between them."""
    torque = recordings[0].torque
    for one in recordings[1:]:
        torque = np.concatenate([torque, one.torque + torque[-5:].mean() - one.torque[:5].mean()])
    return recordings[0].replace(torque=torque, angle=None, angle_is_absolute=False)


def test_two_discs_in_one_recording_are_refused(model, surrogates):
    healthy = [one for one in surrogates if one.defect_count == 0]
    worn = [one for one in surrogates if one.defect_count == 5]
    count = model.count(joined([healthy[0], healthy[1], worn[0], worn[1]]))
    assert count.refused
    assert "two discs" in count.reason
    assert not model.count(joined([worn[0], worn[1]])).refused


def test_a_creeping_speed_is_followed_or_refused(model, surrogates):
    """The speed rises by 5 % over the recording, without a tachometer."""
    for worn in [one for one in surrogates if one.defect_count == 5][:3]:
        twice = joined([worn, worn]).torque
        moments = np.cumsum(np.linspace(0.975, 1.025, twice.size))
        torque = np.interp(moments, np.arange(twice.size), twice)
        count = model.count(worn.replace(torque=torque, angle=None, angle_is_absolute=False))
        assert count.refused or count.defect_count == 5


def test_a_spoiled_window_is_left_out(model, surrogates):
    worn = next(one for one in surrogates if one.defect_count == 5)
    torque = worn.torque.copy()
    torque[20_000:24_000] = torque[20_000]
    count = model.count(joined([worn, worn.replace(torque=torque), worn]))
    assert [window.reason[:20] for window in count.windows] == ["", "9% of the samples ar", ""]
    assert (count.refused, count.n_windows, count.defect_count) == (False, 2, 5)
    lost = "9% of the samples are lost"
    assert any(note.startswith(f"1 of 3 windows left out: {lost}") for note in count.warnings)
    without_majority = model.count(joined([worn, worn.replace(torque=torque)]))
    assert without_majority.refused
    assert without_majority.reason.startswith(f"only 1 of its 2 windows have its count, 1 left out: {lost}")


@pytest.mark.slow
def test_the_speed_of_a_worn_disc_need_not_be_stated(model, surrogates):
    worn = next(one for one in surrogates if one.defect_count == 5)
    blind = worn.replace(angle=None, angle_is_absolute=False)
    stated, searched = (model.count(blind.replace(speed_rpm=speed)) for speed in (worn.speed_rpm, None))
    assert (searched.defect_count, searched.refused) == (stated.defect_count, stated.refused)
    assert searched.warnings[0].startswith("neither tachometer nor stated speed: ")
    # A motor's own lines may be taken for a disc's: its current only proposes a speed.
    current = blind.replace(speed_rpm=None, quantity="motor_current")
    with pytest.raises(ValueError, match=r"its motor current allows \d+(\.\d+)? RPM"):
        turning_of(current, 15)


@pytest.mark.parametrize("seed", range(3))
def test_lines_too_faint_to_be_believed_still_tell_the_speed(seed):
    """Each of them has hardly more power than the noise in its bin."""
    random, rate, rpm = np.random.default_rng(seed), 2000, 110.0
    lobes = 2 * np.pi * 16 / 15 * rpm / 60 * np.arange(15.3 / rpm * 60 * rate) / rate
    torque = 22 + random.normal(0, 1, lobes.size)
    torque += sum(0.02 * np.cos(k * lobes + random.uniform(0, 6.3)) for k in range(3, 60))
    turning = turning_of(Recording(torque, rate, speed_rpm=1.015 * rpm), 15)
    assert "not confirmed" in turning.doubt
    assert turning.speed_hz == pytest.approx(rpm / 60, rel=1e-3)


@pytest.mark.slow
def test_a_model_refuses_what_it_was_not_made_for(model, surrogates):
    recording = surrogates[0]
    noise = np.random.default_rng(0).normal(22, 1, recording.n_samples)
    with pytest.raises(ValueError, match="nor a speed, and its output torque .* RPM: give speed_rpm="):
        model.count(recording.replace(torque=noise, speed_rpm=None, angle=None, angle_is_absolute=False))
    with pytest.raises(ValueError, match="quantity of the recording is input_torque.*load_default_model"):
        model.count(recording.replace(quantity="input_torque"))
    faster = model.count(recording.replace(sampling_rate=1.2 * recording.sampling_rate, speed_rpm=600))
    assert re.match(r"it turns at (59|60)\d\.?\d* RPM, but the model was trained at", faster.reason)
    with pytest.raises(ValueError, match="short"):
        model.count(recording.replace(torque=recording.torque[:1000], angle=None, angle_is_absolute=False))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("share", "n_blocks"), [(0.1, 1), (0.1, 4), (0.2, 8), (0.02, 2)])
def test_a_recording_without_some_of_its_blocks_is_refused(seed, share, n_blocks):
    """What is left lies side by side, as if nothing were missing; the angle says otherwise."""
    whole = recording((4, 5, 6), seed=100 + seed, turns=4)
    random = np.random.default_rng(seed)
    starts = (np.arange(n_blocks) + 0.8 * random.random(n_blocks)) * whole.n_samples / n_blocks
    length = int(share * whole.n_samples / n_blocks)
    lost = np.concatenate([int(start) + np.arange(length) for start in starts])
    torque, angle = (np.delete(values, lost) for values in (whole.torque, whole.angle))
    count = shaft_model().count(whole.replace(torque=torque, angle=angle))
    assert count.refused
    assert "the angle jumps" in count.reason or "it turns at" in count.reason
    # Without a tachometer nothing says so, but a count that is given is right.
    unknown = whole.replace(torque=torque, angle=None, angle_is_absolute=False)
    count = shaft_model().count(unknown)
    assert count.refused or count.defect_count == 3
