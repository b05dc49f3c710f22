"""Load levels of measured vibration: scores, chance, and what must not matter."""

import dataclasses
import itertools
import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.linear_model import Ridge
from sklearn.utils import Bunch

from benchmarks import _load_level_data, load_levels
from benchmarks.load_levels import evaluate_load_levels
from cyclofeat import signal
from cyclofeat.datasets import load_oedi_gearbox

pytestmark = pytest.mark.slow  # a benchmark is no part of the package

RATE = 12_800.0
CHANNELS = ["a1", "a2", "a3", "a4"]
DIRECTIONS = ["healthy to broken", "broken to healthy"]


def make_dataset(*, n_samples=2048, n_channels=2, load_percent=None, seed=0):
    """Both states at ten loads; white noise on which a tone of 1 kHz grows with the load, by 2 dB a level."""
    random = np.random.default_rng(seed)
    levels = np.tile(np.arange(10), 2)
    time = np.arange(n_samples) / RATE
    signals = random.normal(size=(20, n_samples, n_channels))
    phase = random.uniform(0, 2 * np.pi, size=(20, 1, n_channels))
    tone = np.sin(2 * np.pi * 1000 * time[:, np.newaxis] + phase)
    signals += 1.26 ** levels[:, np.newaxis, np.newaxis] * tone
    return Bunch(
        signals=signals,
        broken_tooth=np.repeat([0, 1], 10),
        load_percent=10 * levels if load_percent is None else load_percent,
        recording_names=[f"{state}{level}" for state in "hb" for level in range(10)],
        channel_names=CHANNELS[:n_channels],
        sampling_rate=RATE,
        sampling_rate_inferred=True,
    )


def changed(**changes):
    return Bunch(**{**make_dataset(n_channels=1), **changes})


def predictions(result):
    return [case.predictions for case in result.cases]


@pytest.fixture(scope="module")
def clear():
    """Result on signals in which the load is plain to see."""
    return evaluate_load_levels(make_dataset(), window_samples=512)


@pytest.fixture(scope="module")
def measured():
    return evaluate_load_levels(load_oedi_gearbox())


# What comes out


def test_every_channel_and_all_together_in_both_directions(clear):
    cases = [(case.channel, case.direction) for case in clear.cases]
    assert cases == list(itertools.product(["a1", "a2", "all"], DIRECTIONS))
    for case in clear.cases:
        state = "b" if case.direction == "healthy to broken" else "h"
        assert case.recordings == tuple(f"{state}{level}" for level in range(10))
        assert case.levels == tuple(range(10))
        assert len(case.predictions) == 10
    assert clear.windows_per_recording == 4
    assert len(clear.features) == len(set(clear.features)) == 11


def test_results_cannot_be_changed(clear):
    with pytest.raises(dataclasses.FrozenInstanceError):
        clear.window_samples = 1


def test_dictionary_is_what_json_gives_back(clear):
    plain = clear.to_dict()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert set(plain) == {*(f.name for f in dataclasses.fields(clear)), "caveats"}
    assert len(plain["cases"]) == 6
    for case in plain["cases"]:
        assert set(case) == {f.name for f in dataclasses.fields(clear.cases[0])}
        assert set(case["per_recording"]) == set(case["per_window"])
        assert set(case["chance"]) == {"accuracy", "best_constant", "constant_error", "uniform_error"}


def test_table_has_its_columns_and_says_what_it_is_not(clear):
    table = clear.table()
    headers = [line for line in table.splitlines() if line.startswith("channel")]
    assert len(headers) == 2  # per recording and per window
    for column in ("direction", "accuracy", "MAE", "chance"):
        assert column in headers[0]
    assert sum(" to " in line and "[" in line for line in table.splitlines()) == 12
    assert max(map(len, table.splitlines())) <= 110
    prose = " ".join(table.split())
    for phrase in (
        "VIBRATION, not torque",
        "another kind of gearbox",
        "nothing about counting lobes",
        "one recording per state and load",
        "unit of the acceleration is not documented",
        "12800 Hz, inferred, not documented",
        "4 per recording, of 512 samples (0.04 s)",
    ):
        assert phrase in prose


def test_a_documented_rate_is_not_called_inferred():
    result = evaluate_load_levels(changed(sampling_rate_inferred=False), window_samples=1024)
    assert "inferred" not in result.table()


# How good it is


def test_loads_plain_to_see_are_all_found(clear):
    for case in clear.cases:
        assert case.predictions == case.levels
        assert case.per_recording.accuracy == 1
        assert case.per_recording.accuracy_interval == (1, 1)
        assert case.per_recording.mean_absolute_error == 0
        assert case.per_window.accuracy > 0.9
        assert case.validation_error < 0.5


@pytest.mark.slow
def test_shuffled_labels_are_predicted_no_better_than_by_chance():
    random = np.random.default_rng(1)
    cases = []
    for seed in range(6):
        load = np.concatenate([random.permutation(10), random.permutation(10)]) * 10
        dataset = make_dataset(n_channels=1, load_percent=load, seed=seed)
        cases += evaluate_load_levels(dataset, window_samples=1024).cases[:2]
    scores = [case.per_recording for case in cases]
    # 120 predictions: the standard error of an accuracy of 0.1 is 0.03, of an error of 2.5 levels about 0.15
    assert abs(np.mean([score.accuracy for score in scores]) - 0.1) < 0.06
    assert np.mean([score.mean_absolute_error for score in scores]) > 2.5 - 0.4


def test_what_is_trained_on_does_not_depend_on_the_tested_state():
    """Other signals in the broken state: its penalty and error within the healthy state stay."""
    dataset = make_dataset(n_channels=1)
    other = make_dataset(n_channels=1, seed=5)
    other.signals[:10] = dataset.signals[:10]
    before, after = (evaluate_load_levels(d, window_samples=1024).cases[0] for d in (dataset, other))
    assert before.direction == "healthy to broken"
    assert (before.penalty, before.validation_error) == (after.penalty, after.validation_error)


def test_one_odd_recording_harms_itself_only():
    """Test recordings are predicted one by one: nothing is standardised over the tested state."""
    dataset, odd = make_dataset(n_channels=1), make_dataset(n_channels=1)
    odd.signals[13] *= 1000
    before, after = (evaluate_load_levels(d, window_samples=1024).cases[0] for d in (dataset, odd))
    assert np.delete(before.predictions, 3).tolist() == np.delete(after.predictions, 3).tolist()
    assert before.predictions[3] != after.predictions[3]


def test_neither_unit_nor_rate_matters_to_the_features():
    """But for a constant in the logarithms, which standardising takes away."""
    windows = np.random.default_rng(0).normal(size=(1, 3, 2, 700))
    names, features = load_levels._features_by_channel(windows, RATE)
    _, others = load_levels._features_by_channel(9.81 * windows, 20_000.0)
    sizes = [name in ("log_torque_std_nm", "log_torque_range_nm") for name in names]
    assert sum(sizes) == 2
    assert_allclose(others, features + np.log(9.81) * np.array(sizes), atol=1e-9)


def test_neither_unit_nor_rate_nor_order_of_recordings_matters(clear):
    order = np.random.default_rng(0).permutation(20)
    mixed = make_dataset()
    mixed.signals = 9.81 * mixed.signals
    mixed.sampling_rate = 20_000
    for key in ("signals", "broken_tooth", "load_percent"):
        mixed[key] = mixed[key][order]
    mixed.recording_names = [mixed.recording_names[i] for i in order]
    for case, other in zip(clear.cases, evaluate_load_levels(mixed, window_samples=512).cases, strict=True):
        assert dict(zip(case.recordings, case.predictions, strict=True)) == dict(
            zip(other.recordings, other.predictions, strict=True)
        )


def test_same_seed_same_result_and_the_seed_moves_the_intervals_only(clear):
    assert evaluate_load_levels(make_dataset(), window_samples=512) == clear
    load = 10 * np.concatenate([np.random.default_rng(2).permutation(10), np.arange(10)])
    dataset = make_dataset(n_channels=1, load_percent=load)
    one, two = (evaluate_load_levels(dataset, window_samples=1024, random_state=seed) for seed in (0, 1))
    assert predictions(one) == predictions(two)
    errors = [r.cases[0].per_recording.mean_absolute_error_interval for r in (one, two)]
    assert_allclose(*errors, atol=0.5)
    assert [c.per_window for c in one.cases] != [c.per_window for c in two.cases]


# Scores and chance


@pytest.mark.parametrize("levels", [np.arange(10), np.array([0, 0, 1, 9]), np.array([7])])
def test_chance_agrees_with_counting_every_guess(levels):
    chance = load_levels._chance(levels)
    pairs = list(itertools.product(levels.tolist(), range(10)))
    assert_allclose(chance.accuracy, sum(a == b for a, b in pairs) / len(pairs))
    assert_allclose(chance.uniform_error, sum(abs(a - b) for a, b in pairs) / len(pairs))
    errors = [sum(abs(a - b) for a in levels.tolist()) / len(levels) for b in range(10)]
    assert_allclose(chance.constant_error, min(errors))
    assert chance.best_constant == errors.index(min(errors))


def test_chance_of_ten_balanced_levels(clear):
    for case in clear.cases:
        assert_allclose(dataclasses.astuple(case.chance), (0.1, 4, 2.5, 3.3))


def test_score_agrees_with_counting_by_hand():
    levels = np.array([0, 5, 9])
    predicted = np.array([[0, 0], [5, 7], [3, 8]])
    score = load_levels._score(levels, predicted, random_state=0)
    assert_allclose(score.accuracy, 3 / 6)
    assert_allclose(score.mean_absolute_error, (2 + 6 + 1) / 6)
    # All 27 draws of three recordings of three, each as likely
    draws = list(itertools.product(range(3), repeat=3))
    error = np.abs(predicted - levels[:, np.newaxis]).mean(axis=1)
    every = [error[list(draw)].mean() for draw in draws]
    assert_allclose(
        score.mean_absolute_error_interval,
        np.percentile(every, [2.5, 97.5], method="inverted_cdf"),
        atol=1e-12,
    )
    assert score.accuracy_interval == (0, 1)


def test_nearest_level_rounds_halves_up_and_stays_within_the_classes():
    values = np.array([-3.0, -0.4, 0.5, 1.5, 2.49, 8.5, 40.0])
    assert_array_equal(load_levels._nearest_level(values), [0, 0, 1, 2, 2, 9, 9])


def test_windows_keep_to_their_recording_and_channel():
    dataset = make_dataset(n_samples=700)
    windows = _load_level_data.cut(_load_level_data.checked(dataset), 300)
    assert windows.shape == (2, 20, 2, 300)
    assert_array_equal(windows[1, 13, 1], dataset.signals[13, 300:600, 1])


# Measured data


def naive_features(window, rate):
    low, mid, high = rate / 16, rate / 8, rate / 4
    bands = [(high, rate / 2), (mid, high), (low, mid), (0, low)]
    std = window.std(ddof=1)
    deviation = window - window.mean()
    variance = (deviation**2).mean()
    row = [
        np.log(std),
        np.log(window.max() - window.min()),
        np.log(np.abs(window).max() / np.sqrt((window**2).mean())),
        (deviation**3).mean() / variance**1.5,
        np.log((deviation**4).mean() / variance**2),
        signal.shannon_entropy(signal.welch_psd(window, rate, "matlab_pwelch")[1]),
    ]
    frequencies, psd = signal.welch_psd(window, rate, "ripple")
    return [*row, *(signal.shannon_entropy(psd, frequencies, band) for band in (None, *bands))]


def naive_prediction(train, levels, test, penalty):
    mean, std = train.mean(axis=0), train.std(axis=0)
    return Ridge(alpha=penalty).fit((train - mean) / std, levels).predict((test - mean) / std)


@pytest.mark.parametrize(("number", "state", "channels"), [(7, 1, [3]), (8, 0, [0, 1, 2, 3])])
def test_a_case_agrees_with_one_worked_step_by_step(measured, number, state, channels):
    """Window by window, each recording of the training state left out in turn, no shared arrays."""
    data, case = load_oedi_gearbox(), measured.cases[number]
    rows, levels, recordings = {0: [], 1: []}, {0: [], 1: []}, {0: [], 1: []}
    for i in range(20):
        for start in (0, 4096):
            parts = [naive_features(data.signals[i, start : start + 4096, c], RATE) for c in channels]
            rows[data.broken_tooth[i]].append(np.concatenate(parts))
            levels[data.broken_tooth[i]].append(data.load_percent[i] // 10)
            recordings[data.broken_tooth[i]].append(i)
    train, test = np.array(rows[state]), np.array(rows[1 - state])
    known, true = np.array(levels[state]), np.array(levels[1 - state])
    errors = {}
    for penalty in load_levels._PENALTIES:
        found = []
        for i in set(recordings[state]):
            out = np.array(recordings[state]) == i
            found.append(np.abs(naive_prediction(train[~out], known[~out], train[out], penalty) - known[out]))
        errors[penalty] = np.mean(found)
    assert case.penalty == min(errors, key=errors.get)
    assert_allclose(case.validation_error, errors[case.penalty], rtol=1e-6)
    raw = naive_prediction(train, known, test, case.penalty)
    by_window = np.clip(np.round(raw), 0, 9)
    assert case.predictions == tuple(np.clip(np.round(raw.reshape(10, 2).mean(axis=1)), 0, 9))
    assert_allclose(case.per_window.accuracy, np.mean(by_window == true))
    assert_allclose(case.per_window.mean_absolute_error, np.mean(np.abs(by_window - true)))


def test_measured_vibration_runs_through(measured):
    assert (measured.window_samples, measured.windows_per_recording) == (4096, 2)
    assert measured.sampling_rate == RATE
    assert measured.sampling_rate_inferred
    assert [case.channel for case in measured.cases[::2]] == [*CHANNELS, "all"]
    for case in measured.cases:
        assert_allclose(dataclasses.astuple(case.chance), (0.1, 4, 2.5, 3.3))
        assert case.validation_error < 1.5  # within one state the load is seen by every channel
        for score in (case.per_recording, case.per_window):
            assert score.accuracy_interval[0] <= score.accuracy <= score.accuracy_interval[1]


def test_measured_load_carries_over_on_the_fourth_channel_and_not_on_all(measured):
    """As found, better or worse: a change that moves this should be noticed."""
    error = {(c.channel, c.direction): c.per_recording.mean_absolute_error for c in measured.cases}
    assert all(error["a4", direction] < 1.5 for direction in DIRECTIONS)
    assert error["a2", DIRECTIONS[0]] > 3.3  # worse than guessing


# Wrong arguments


@pytest.mark.parametrize("dataset", [None, [1, 2], np.zeros((20, 4096, 4)), "oedi"])
def test_something_else_than_a_bunch(dataset):
    with pytest.raises(TypeError, match="dataset must be the Bunch"):
        evaluate_load_levels(dataset)


@pytest.mark.parametrize("key", _load_level_data.KEYS)
def test_missing_part(key):
    dataset = changed()
    del dataset[key]
    with pytest.raises(ValueError, match=f"missing: {key}"):
        evaluate_load_levels(dataset)


def broken_signal(value, samples):
    signals = np.array(make_dataset(n_channels=1).signals)
    signals[3, samples, 0] = value
    return signals


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"signals": np.zeros((20, 2048))}, r"signals must have shape .* got \(20, 2048\)"),
        ({"signals": np.zeros((20, 0, 1))}, r"signals must have shape"),
        ({"signals": [[1.0], [1.0, 2.0]]}, "signals must be an array, got rows of different lengths"),
        ({"signals": np.full((20, 2048, 1), "1")}, "signals must hold real numbers"),
        ({"signals": np.zeros((20, 2048, 1), complex)}, "signals must hold real numbers"),
        ({"signals": broken_signal(np.nan, 7)}, "signals must be finite"),
        (
            {"signals": broken_signal(1.5, slice(1024, 2048))},
            "window 1 of recording h3, channel a1, is const",
        ),
        ({"signals": np.ones((19, 2048, 1))}, "broken_tooth must hold one value for each of 19 recordings"),
        ({"channel_names": ["a1", "a2"]}, "channel_names must be 1 different names"),
        ({"channel_names": ["all"]}, "none of them 'all'"),
        ({"channel_names": "a1"}, "channel_names must be a list of names"),
        ({"recording_names": ["h0"]}, "recording_names must hold one value"),
        ({"broken_tooth": np.repeat([0, 2], 10)}, r"broken_tooth must hold values of \[0, 1\] only, got 2"),
        ({"broken_tooth": np.zeros(20)}, "every level .* the broken recordings lack"),
        ({"load_percent": np.tile(np.arange(10), 2)}, "load_percent must hold values of .* only, got 1"),
        ({"load_percent": np.repeat(np.arange(10) * 10, 2)}, r"the healthy recordings lack \[50, 60"),
        ({"load_percent": ["0"] * 20}, "load_percent must hold real numbers"),
        ({"sampling_rate": 0.0}, "sampling_rate must be positive and finite, in Hz, got 0.0"),
        ({"sampling_rate": np.nan}, "sampling_rate must be positive"),
        ({"sampling_rate": "12800"}, "sampling_rate must be positive"),
    ],
)
def test_wrong_part(changes, message):
    with pytest.raises(ValueError, match=message):
        evaluate_load_levels(changed(**changes), window_samples=1024)


@pytest.mark.parametrize("window_samples", [255, 0, -1, 2049])
def test_window_that_does_not_fit(window_samples):
    with pytest.raises(ValueError, match=f"between 256 and the 2048 samples .* got {window_samples}"):
        evaluate_load_levels(changed(), window_samples=window_samples)


@pytest.mark.parametrize("name", ["window_samples", "random_state"])
@pytest.mark.parametrize("value", [1024.0, "1024", None, True])
def test_integers_only(name, value):
    with pytest.raises(TypeError, match=f"{name} must be an integer"):
        evaluate_load_levels(changed(), **{"window_samples": 1024, name: value})


def test_negative_seed():
    with pytest.raises(ValueError, match="random_state must not be negative, got -1"):
        evaluate_load_levels(changed(), window_samples=1024, random_state=-1)


def test_the_command_prints_the_table(capsys):
    load_levels.main([])
    out = capsys.readouterr().out
    for word in ("a1", "accuracy", "chance", "vibration"):
        assert word in out
