"""Recordings with fewer samples per input turn than all lobe lines need, and discs of other sizes."""

import copy
import functools
import re

import numpy as np
import pytest
from scipy.signal import resample_poly
from small_model import RATE, SPEED, labelled, recording, recordings_with_wear, shaft_model

from cyclofeat.counting import LobeModel, LobeStream
from cyclofeat.models import load_model, save_model
from cyclofeat.models.card import read_card
from cyclofeat.recordings import Recording
from cyclofeat.recordings.windower import lobe_windower
from cyclofeat.signal.lobes import lines_held
from cyclofeat.signal.speed import follow_speed

# 60 samples per turn, of which a model has 57: it may count at 5 % more speed than it was trained at.
SLOWER, PER_TURN = 4, 57


def slower(one: Recording) -> Recording:
    """The same by a logger of a quarter of the rate, with its anti-alias filter."""
    level = one.torque.mean()
    torque = level + resample_poly(one.torque - level, 1, SLOWER)
    return one.replace(torque=torque, angle=one.angle[::SLOWER], sampling_rate=RATE / SLOWER)


@functools.cache
def slow_model() -> LobeModel:
    return LobeModel(n_splits=0, n_trees=20, random_state=0).fit([slower(one) for one in labelled()])


@pytest.mark.slow
def test_a_model_has_as_many_samples_per_turn_as_its_poorest_recording():
    assert shaft_model().samples_per_turn_ == 128
    assert slow_model().samples_per_turn_ == PER_TURN
    mixed = [slower(one) if one.assembly == "A7" else one for one in labelled()]
    with pytest.warns(UserWarning, match=r"recordings\[\d+\] holds 57 samples per input turn, most"):
        assert LobeModel(n_splits=0, n_trees=5, random_state=0).fit(mixed).samples_per_turn_ == PER_TURN
    n_lines = lines_held(PER_TURN, 1.0, 15)
    assert n_lines == 21
    assert slow_model().counter_.lobe_map_.n_lines == n_lines
    assert "with at least 57 samples per input turn" in slow_model().made_for()
    assert "samples" not in shaft_model().made_for()


@pytest.mark.parametrize("change", [slower, lambda one: one], ids=["its rate", "a higher rate"])
@pytest.mark.parametrize("lobes", [(), (6,), (13, 14, 0)])
def test_it_counts_and_locates_at_its_rate_and_above(lobes, change):
    count = slow_model().count(change(recording(lobes, seed=90, turns=2)))
    assert (count.defect_count, count.lobes, count.refused) == (len(lobes), tuple(sorted(lobes)), False)


def test_without_a_tachometer_the_speed_is_followed_by_fewer_lines():
    one = slower(recording((3, 4, 5), seed=91, turns=2)).replace(angle=None, angle_is_absolute=False)
    count = slow_model().count(one.replace(speed_rpm=510))  # the true one is 500
    assert (count.defect_count, count.refused) == (3, False)
    (found,) = re.findall(r"([\d.]+) RPM found in the torque", count.warnings[0])
    assert float(found) == pytest.approx(500, 1e-4)


def test_a_stream_is_counted_as_the_file():
    one = slower(recording((4, 5, 6), seed=92, turns=3))
    stream = LobeStream(slow_model(), one.sampling_rate, angle_is_absolute=True)
    for torque, angle in zip(np.array_split(one.torque, 7), np.array_split(one.angle, 7), strict=True):
        stream.push(torque, angle)
    pieces, whole = stream.result(), slow_model().count(one)
    assert pieces.n_windows == whole.n_windows == 3
    assert list(pieces.probability.values()) == pytest.approx(list(whole.probability.values()), abs=1e-9)
    assert pieces.lobes == whole.lobes == (4, 5, 6)


@pytest.fixture(scope="module")
def model_of_both():
    return shaft_model().with_coarser(slow_model())


def test_a_coarser_model_counts_what_holds_too_few_samples(model_of_both, tmp_path):
    fast = [recording((1, 2), seed=95, turns=2), recording((), seed=96)]
    slow = [slower(recording((4, 5, 6), seed=97, turns=2)), slower(recording((9,), seed=98))]
    mixed = [fast[0], slow[0], slow[1], fast[1]]
    expected = [
        model.count(one).probability
        for model, one in zip((shaft_model(), slow_model(), slow_model(), shaft_model()), mixed, strict=True)
    ]
    loaded = load_model(save_model(tmp_path / "both.skops", model_of_both))
    card = read_card(save_model(tmp_path / "slow.skops", slow_model()))
    assert (card["samples_per_turn"], card["window_samples"]) == (PER_TURN, round(0.98 * 15 * PER_TURN))
    for model in (model_of_both, loaded):
        assert [model.count(one).probability for one in mixed] == expected
        for one, probability in zip(model.count_all(mixed), expected, strict=True):
            assert one.probability == pytest.approx(probability, abs=1e-9)
        assert model.windows(slow[0]).X.shape == (2, round(0.98 * 15 * PER_TURN))
        assert "with at least 57 samples per input turn" in model.made_for()


def test_a_model_is_chosen_by_the_stated_speed_where_there_is_no_tachometer(model_of_both):
    """2,000 Hz are 128 samples per turn at 937 RPM, which may be the true speed where 888 RPM are stated."""
    blind = recording((3,), seed=99).replace(angle=None, angle_is_absolute=False)
    chosen = [model_of_both.suited_to(blind.replace(speed_rpm=rpm)) for rpm in (500, 870, 900, 1500)]
    assert [one.samples_per_turn_ for one in chosen] == [128, 128, PER_TURN, PER_TURN]
    assert LobeStream(model_of_both, RATE, speed_rpm=900).model is chosen[2]
    assert LobeStream(model_of_both, RATE).model is model_of_both


def test_a_coarser_model_must_match():
    with pytest.raises(ValueError, match="must have fewer than 57 samples per turn, got 128"):
        slow_model().with_coarser(shaft_model())
    other = copy.copy(slow_model())
    other.n_lobes_ = 14
    with pytest.raises(ValueError, match="same n_lobes, 15, got one of 14"):
        shaft_model().with_coarser(other)


def test_too_few_samples_are_an_error_that_says_what_to_train():
    with pytest.raises(ValueError, match=r"at least 10\d\d.* Hz at .* RPM .*train --sampling-rate 500\)"):
        shaft_model().count(slower(recording((1,))))
    poor = [one.replace(torque=one.torque[::12], angle=one.angle[::12], sampling_rate=RATE / 12)
            for one in labelled()]  # fmt: skip
    with pytest.raises(ValueError, match=r"sampling_rate of 166.667 Hz is too low .*: 19 samples per input"):
        LobeModel(n_splits=0).fit(poor)


@pytest.mark.slow
def test_the_depth_of_wear_is_learned_too():
    model = LobeModel(n_splits=0, n_trees=15, wear_um=(5, 200), random_state=0)
    model.fit([slower(one) for one in recordings_with_wear(n=12)])
    deep = slower(recording((4, 5, 6), seed=94, turns=2, height=0.6))  # 120 um
    depth = model.count(deep).wear_um
    assert depth.low_um <= 120 <= depth.high_um


@pytest.mark.parametrize("per_turn", [24, 40, 57, 95, 128])
@pytest.mark.parametrize("excess", [1.05, 1.3, 2.2, 7.0, 41.0])
def test_windows_hold_the_highest_line(per_turn, excess):
    """A wave of its order keeps 5/6 of its amplitude, whatever the rate of the recording."""
    order = lines_held(per_turn, 1.0, 15) * 16 / 15
    turns = np.arange(round(16 * excess * per_turn)) / (excess * per_turn)
    torque = 22 + np.cos(2 * np.pi * order * turns)
    one = Recording(torque, excess * per_turn * SPEED)
    (window,) = lobe_windower(15, per_turn).windows([one], [2 * np.pi * turns]).X
    at = np.arange(window.size) / per_turn
    waves = np.column_stack([np.cos(2 * np.pi * order * at), np.sin(2 * np.pi * order * at)])
    assert 5 / 6 < np.hypot(*np.linalg.lstsq(waves, window, rcond=None)[0]) < 1.02


def test_a_speed_is_followed_at_36_samples_per_turn_and_not_at_30():
    time = np.arange(1500) / 300
    true = 2 * np.pi * (8 * time + 0.04 * np.sin(2 * np.pi * 0.3 * time))  # wanders by 1 %
    random = np.random.default_rng(0)
    torque = sum(np.cos(16 / 15 * k * true + random.uniform(0, 7)) for k in range(3, 16))
    torque = torque + random.normal(size=time.size)
    found = follow_speed(torque, 300.0, 500 / 60)
    assert found.fits
    assert np.std(found.angle - true) < 2 * np.pi * 0.005
    with pytest.raises(ValueError, match="sampling_rate must be at least 281.3 Hz to follow 500 RPM"):
        follow_speed(torque, 250.0, 500 / 60)


# Discs with other numbers of lobes than the papers' 15

SIZES = (11, 21)


@functools.cache
def model_of(n_lobes: int) -> LobeModel:
    return LobeModel(n_splits=0, n_trees=20, random_state=0).fit(labelled(n_lobes=n_lobes))


@pytest.mark.parametrize("n_lobes", SIZES)
@pytest.mark.parametrize("n_worn", [0, 1, 3])
def test_a_model_of_another_size_counts_and_locates(n_lobes, n_worn):
    worn = tuple(range(n_lobes - n_worn, n_lobes))  # up to the last lobe
    count = model_of(n_lobes).count(recording(worn, seed=80, turns=2, n_lobes=n_lobes))
    assert (count.defect_count, count.lobes, count.n_windows) == (n_worn, worn, 2)
    assert not count.refused
    assert len(count.lobe_probability) == n_lobes


@pytest.mark.parametrize("n_lobes", SIZES)
def test_it_follows_the_speed_without_a_tachometer(n_lobes):
    one = recording((4, 5, 6), seed=81, turns=2, n_lobes=n_lobes)
    count = model_of(n_lobes).count(one.replace(angle=None, angle_is_absolute=False, speed_rpm=505))
    assert (count.defect_count, count.refused) == (3, False)


def test_a_disc_of_another_size_is_an_error():
    with pytest.raises(ValueError, match="n_lobes of the recording is 21, .* trained for discs of 11"):
        model_of(11).count(recording((1,), n_lobes=21))
    with pytest.raises(ValueError, match="n_lobes must be the same for all recordings, got 11, 21"):
        LobeModel().fit([recording((1,), n_lobes=n_lobes) for n_lobes in SIZES])
