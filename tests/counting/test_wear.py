"""Depth of radial wear: intervals, runs of windows, visible depths, and models that state them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from small_model import RATE, make_networks_small, recording, recordings_with_wear, shaft_model, wear_model

from cyclofeat.counting import LobeModel, LobeStream, counts_frame
from cyclofeat.counting.calibration.conformal_regressor import ConformalRegressor
from cyclofeat.counting.model.radial_wear import least_visible_depth, runs_of, wear_features
from cyclofeat.models import load_model, save_model
from cyclofeat.models.card import read_card
from cyclofeat.recordings.windower import SAMPLES_PER_TURN

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["trees", "rows"])
def model(request):
    with pytest.MonkeyPatch.context() as patch:
        make_networks_small(patch)
        return wear_model(request.param)


@pytest.fixture(scope="module")
def unseen(model):
    """Recordings of assemblies that the model has not seen, and their answers."""
    recordings = recordings_with_wear(16, seed=1)
    return recordings, [model.count(one) for one in recordings]


def test_intervals_cover_new_assemblies_and_widen_where_values_scatter():
    random = np.random.default_rng(3)
    assembly = np.repeat(np.arange(240), 2)
    place = np.repeat(random.uniform(size=240), 2)
    # What assemblies differ by is shared by both samples of each.
    y = np.repeat(random.normal(size=240), 2) * (0.1 + place) + place
    X = place[:, np.newaxis]
    train, test = assembly < 120, assembly >= 120
    regressor = ConformalRegressor(n_trees=60, coverage=0.8).fit(X[train], y[train], groups=assembly[train])
    low, high = regressor.predict_interval(X[test])
    covered = (low <= y[test]) & (y[test] <= high)
    assert 0.7 < covered.mean() < 0.9
    width = high - low
    assert width[place[test] > 0.7].mean() > 1.5 * width[place[test] < 0.3].mean()
    # Without the assemblies each sample is predicted with the help of its twin.
    alone = ConformalRegressor(n_trees=60, coverage=0.8).fit(X[train], y[train])
    assert alone.ratio_ < 0.8 * regressor.ratio_


def test_too_few_assemblies_promise_nothing():
    X, y = np.arange(6.0)[:, np.newaxis], np.arange(6.0)
    low, high = ConformalRegressor(n_trees=5, coverage=0.9).fit(X, y).predict_interval(X)
    assert np.all(np.isinf(low) & np.isinf(high))


def test_runs_are_windows_that_follow_each_other():
    X = np.arange(7)[:, np.newaxis] + np.array([0.0, 0.5])
    assert_allclose(runs_of(X, 3), [np.r_[0:3:0.5], np.r_[3:6:0.5]])
    used = np.array([1, 1, 0, 1, 1, 1, 1], dtype=bool)
    assert_allclose(runs_of(X, 3, used), [np.r_[3:6:0.5]])
    assert runs_of(X, 3, ~used).shape == (0, 6)


def test_levels_are_those_of_the_torque_in_nm():
    """A line of known amplitude beside one of the shaft, in five output turns."""
    turns = np.arange(5 * 15 * SAMPLES_PER_TURN) / SAMPLES_PER_TURN
    torque = 0.02 * np.cos(2 * np.pi * 9 * 16 / 15 * turns) + 0.5 * np.cos(2 * np.pi * 10 * turns)
    torque = torque + np.random.default_rng(0).normal(0, 0.01, turns.size)
    features = wear_features(np.stack([torque, 3 * torque]), 15)
    n_lines = (features.shape[1] - 30) // 4
    level = features[:, -n_lines:]
    assert level[0, 8] == pytest.approx(np.log(0.02**2), abs=0.1)
    strong = level[0] > np.log(3e-4**2)  # far above the least amplitude
    assert strong.sum() > 10
    assert_allclose(level[1, strong], level[0, strong] + 2 * np.log(3), atol=2e-3)
    assert_allclose(features[1, :-n_lines], features[0, :-n_lines], atol=1e-6)  # of ratios only


def test_visible_is_what_nine_of_ten_assemblies_show():
    log_depth = np.log(np.arange(1.0, 101.0))
    seen = np.arange(100) >= 40
    seen[45] = False
    assert least_visible_depth(log_depth, seen) == pytest.approx(47.0, abs=7)
    assert least_visible_depth(log_depth, np.zeros(100, dtype=bool)) is None


def test_counts_and_depths_of_assemblies_never_seen(unseen):
    recordings, counts = unseen
    pairs = [(r.meta["wear_um"], c.wear_um) for r, c in zip(recordings, counts, strict=True)]
    assert all(depth is not None for _, depth in pairs)
    deep = [(r, c) for r, c in zip(recordings, counts, strict=True) if r.meta["wear_um"] > 50]
    assert np.mean([c.defect_count == r.defect_count for r, c in deep]) >= 0.9
    worn = [(true, depth) for true, depth in pairs if true > 0 and depth.depth_um is not None]
    error = np.median([abs(np.log(depth.depth_um / true)) for true, depth in worn])
    assert error < 0.25
    covered = np.mean([depth.low_um <= true <= depth.high_um for true, depth in worn])
    assert covered >= 0.75  # some 30 assemblies, 90 % promised
    assert all(depth.low_um <= depth.depth_um <= depth.high_um for _, depth in worn)


def test_each_run_of_a_long_recording_is_learned_with_its_count_and_depth(unseen):
    """Recordings of 2, 5 and 3 output turns hold 1, 2 and 1 runs of two, and windows that are in none."""
    varied = recordings_with_wear(24, turns=(2, 5, 3, 2))
    model = LobeModel(n_splits=0, n_trees=25, random_state=0, wear_um=(5, 200)).fit(varied)
    assert model.wear_.accuracy > 0.7
    deep = [one for one in unseen[0] if one.meta["wear_um"] > 50]
    counts = model.count_all(deep)
    assert np.mean([c.defect_count == r.defect_count for r, c in zip(deep, counts, strict=True)]) >= 0.9
    errors = [abs(np.log(c.wear_um.depth_um / r.meta["wear_um"])) for r, c in zip(deep, counts, strict=True)]
    assert np.median(errors) < 0.25


def test_where_no_wear_is_seen_the_answer_says_what_may_be_there(model, unseen):
    for count in unseen[1]:
        assert (count.wear_um.depth_um is None) == (count.defect_count == 0)
    healthy = next(count.wear_um for count in unseen[1] if count.defect_count == 0)
    assert healthy.low_um == 0
    assert healthy.high_um == model.wear_.limit_um
    assert 5 < model.wear_.limit_um < 100
    assert str(healthy) == f"below what can be seen (up to {model.wear_.limit_um:.3g} um may be there)"


def test_a_sound_disc_is_as_frequent_as_keeps_false_alarms_rare(model):
    """One healthy run more than 5 % at most; with equal odds each needs as much evidence as the others."""
    wear = model.wear_
    n_healthy = sum(not one.defect_count for one in recordings_with_wear(24))
    assert wear.false_alarms <= 0.05 + 1 / n_healthy
    assert wear.sound_odds >= 1
    assert model.card_["wear"]["sound_odds"] == wear.sound_odds


@pytest.mark.parametrize("n_runs", [1, 4])
def test_odds_of_a_sound_disc_count_once_however_many_runs_there_are(model, n_runs):
    answers = np.full((n_runs, model.classes_.size), 0.6 / (model.classes_.size - 1))
    answers[:, 0] = 0.4
    equal, seven = (replace(model.wear_, sound_odds=odds).probability(answers) for odds in (1.0, 7.0))
    assert_allclose(seven[0] / seven[1:], 7 * equal[0] / equal[1:])
    assert seven.sum() == pytest.approx(1)


def test_one_window_is_counted_without_a_depth(model):
    made = recording((4, 5, 6), seed=77, height=0.7)
    count = model.count(made)
    assert count.wear_um is None
    needed = "2 output turns in a row of one recording are needed"
    assert f"no depth of wear, and a less accurate count: {needed}" in count.warnings
    assert "wear_um" not in count.to_dict()


def test_a_window_with_a_fault_is_no_part_of_a_run(model):
    """In the middle one of three windows the sensor fails: no two sound ones follow each other."""
    made = recording((4, 5, 6), seed=78, turns=3, height=0.7)
    assert model.count(made).wear_um is not None
    torque = made.torque.copy()
    torque[4500:5500] = torque[4500]
    count = model.count(made.replace(torque=torque))
    assert not count.refused
    assert count.wear_um is None


def test_models_without_wear_say_nothing():
    model = shaft_model()
    assert model.wear_ is None
    assert "wear" not in model.card_
    count = model.count(recording((4, 5, 6), seed=77, turns=2))
    assert count.wear_um is None
    assert not any(key.startswith("wear_um") for key in count.to_dict())


def test_tables_and_json_hold_the_depth(unseen):
    frame = counts_frame(unseen[1])
    first = next(k for k, count in enumerate(unseen[1]) if count.defect_count)
    depth = unseen[1][first].wear_um
    assert frame["wear_um"][first] == depth.depth_um
    assert json.loads(json.dumps(unseen[1][first].to_dict()))["wear_um_low"] == depth.low_um


@pytest.mark.parametrize("suffix", ["skops", "joblib"])
def test_stored_models_state_the_same_depth(model, unseen, tmp_path, suffix):
    if suffix == "skops":
        pytest.importorskip("skops")
    file = save_model(tmp_path / f"model.{suffix}", model)
    assert read_card(file)["training"]["wear"] == model.card_["wear"]
    assert model.card_["wear"]["output_turns"] == 2
    loaded = load_model(file, trusted=True)
    recordings, counts = unseen
    assert loaded.count(recordings[1]).to_dict() == counts[1].to_dict()


def test_the_depth_of_wear_in_a_stream_is_that_of_the_file(model):
    record = recording((2, 3, 4), seed=76, turns=5, height=0.5)
    rising = record.torque + np.linspace(0, 1, record.n_samples)  # the load drifts from window to window
    spoiled = np.where(abs(np.arange(record.n_samples) - 6000) < 60, 22.0, rising)
    for torque in (rising, spoiled):
        stream = LobeStream(model, RATE, angle_is_absolute=True)
        for cut in range(0, record.n_samples, 500):
            stream.push(torque[cut : cut + 500], record.angle[cut : cut + 500])
        mine, theirs = stream.result(), model.count(record.replace(torque=torque))
        assert theirs.wear_um is not None
        assert_allclose(mine.wear_um.depth_um, theirs.wear_um.depth_um, rtol=1e-6)
        assert mine.probability == pytest.approx(theirs.probability)
        assert [one.reason for one in mine.windows] == [one.reason for one in theirs.windows]


@pytest.mark.parametrize(
    ("wear_um", "message"),
    [
        ((0, 200), r"wear_um must be a range \(low, high\) in um with 0 < low < high, got \(0, 200\)"),
        ((50, 50), "with 0 < low < high"),
        ((50, 200), r"must state one depth from 50 to 200 um in meta\[.wear_um.\], that of assembly A1 is 3"),
        ((1, 2, 3), "wear_um must be a pair of numbers"),
    ],
)
def test_depths_must_be_stated_and_within_the_range(wear_um, message):
    shallow = recording((3,), seed=1, turns=2, meta={"wear_um": 30.0})
    healthy = recording((), seed=2, turns=2)
    with pytest.raises(ValueError, match=message):
        LobeModel(wear_um=wear_um).fit([healthy, shallow])
    with pytest.raises(ValueError, match="that of assembly A1 is None"):
        LobeModel(wear_um=(5, 200)).fit([healthy, shallow.replace(meta={})])
