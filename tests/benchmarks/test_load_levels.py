"""Load levels of measured vibration: beside a case worked out step by step, and the table in the docs."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.linear_model import Ridge

from benchmarks import load_levels
from cyclofeat import signal
from cyclofeat.datasets import load_oedi_gearbox

pytestmark = pytest.mark.slow  # a benchmark is no part of the package

RATE = 12_800.0


@pytest.fixture(scope="module")
def measured():
    return load_levels.all_cases(load_oedi_gearbox())


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
    data, case = load_oedi_gearbox(), measured[number]
    rows, levels, recordings = {0: [], 1: []}, {0: [], 1: []}, {0: [], 1: []}
    for i in range(20):
        for start in (0, 4096):
            parts = [naive_features(data.signals[i, start : start + 4096, c], RATE) for c in channels]
            rows[data.broken_tooth[i]].append(np.concatenate(parts))
            levels[data.broken_tooth[i]].append(data.load_percent[i] // 10)
            recordings[data.broken_tooth[i]].append(i)
    train, test = np.array(rows[state]), np.array(rows[1 - state])
    known = np.array(levels[state])
    errors = {}
    for penalty in load_levels.PENALTIES:
        found = []
        for i in set(recordings[state]):
            out = np.array(recordings[state]) == i
            found.append(np.abs(naive_prediction(train[~out], known[~out], train[out], penalty) - known[out]))
        errors[penalty] = np.mean(found)
    assert case.penalty == min(errors, key=errors.get)
    assert_allclose(case.validation_error, errors[case.penalty], rtol=1e-6)
    raw = naive_prediction(train, known, test, case.penalty).reshape(10, 2)
    assert_array_equal(case.by_window, np.clip(np.round(raw), 0, 9))
    assert_array_equal(case.predicted, np.clip(np.round(raw.mean(axis=1)), 0, 9))
    assert_array_equal(case.levels, levels[1 - state][::2])


def test_neither_unit_nor_rate_matters_to_the_features():
    """But for a constant in two logarithms, which standardising takes away."""
    signals = np.random.default_rng(0).normal(size=(3, 2 * load_levels.WINDOW, 1))
    (features,) = load_levels.channel_features(signals, RATE)
    (others,) = load_levels.channel_features(9.81 * signals, 20_000.0)
    shifts = np.zeros(11)
    shifts[:2] = np.log(9.81)
    assert_allclose(others - features, np.broadcast_to(shifts, features.shape), atol=1e-9)


def test_scores_agree_with_counting_by_hand():
    accuracy, error = load_levels.scores(np.array([0, 5, 9]), np.array([[0, 0], [5, 7], [3, 8]]))
    assert_allclose((accuracy[0], error[0]), (3 / 6, (2 + 6 + 1) / 6))
    assert accuracy[1:] == (0, 1)
    assert error[1:] == (0, 3.5)


def test_docs_quote_the_printed_scores(measured):
    docs = (Path(__file__).parents[2] / "docs" / "data.md").read_text(encoding="utf-8")
    for pair in zip(measured[::2], measured[1::2], strict=True):
        scored = [load_levels.scores(case.levels, case.predicted) for case in pair]
        words = [f"{accuracy:.2f}, {error:.2f}" for (accuracy, *_), (error, *_) in scored]
        assert f"| {pair[0].channel} | {' | '.join(words)} |" in docs


def test_the_command_prints_the_table(capsys):
    load_levels.main([])
    assert "a4       healthy to broken  0.50 [0.20, 0.80]  0.70 [0.20, 1.20]" in capsys.readouterr().out
