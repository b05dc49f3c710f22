"""Protocols of evaluation, scores by hand, intervals against the binomial law."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import binom
from sklearn import config_context
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.dummy import DummyClassifier
from sklearn.metrics import confusion_matrix, f1_score
from sklearn.model_selection import GridSearchCV, StratifiedGroupKFold
from sklearn.naive_bayes import GaussianNB
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler

from cyclofeat.counting import GroupCalibratedCounter, Protocol, evaluate
from cyclofeat.counting.evaluation.assembly_folds import fit_clone
from cyclofeat.counting.evaluation.scores import (
    calibration_sums,
    expected_calibration_error,
    limits_at_ends,
    rule_of_three,
)


class Recorder(ClassifierMixin, BaseEstimator):
    """Predicts what the windows hold; remembers which windows it was fitted to and asked about."""

    calls: list = []  # noqa: RUF012 - shared by clones on purpose
    fits: list = []  # noqa: RUF012

    def fit(self, X, y, groups=None):
        self.classes_ = np.unique(y)
        self.seen_ = set(np.asarray(X)[:, 2].astype(int))
        self.groups_ = None if groups is None else set(groups)
        Recorder.fits.append((self.seen_, self.groups_))
        return self

    def predict(self, X):
        Recorder.calls.append((self.seen_, set(X[:, 2].astype(int)), self.groups_))
        return X[:, 0]

    def predict_proba(self, X):
        right = np.equal.outer(X[:, 0], self.classes_)
        return np.where(right, 0.8, 0.2 / (len(self.classes_) - 1))

    def predict_lobes(self, X, passage):
        return np.arange(4) < (X[:, 0] + passage)[:, np.newaxis]


def held(answers, groups):
    """Windows that hold the answer, noise and their number."""
    n = len(answers)
    return np.column_stack([answers, np.random.default_rng(0).normal(size=n), np.arange(n)])


class Elsewhere(GaussianNB):
    """Cannot be fitted in this process."""

    def __init__(self, here=0):
        super().__init__()
        self.here = here

    def fit(self, X, y):
        assert os.getpid() != self.here
        return super().fit(X, y)


@pytest.fixture(autouse=True)
def _forget():
    Recorder.calls, Recorder.fits = [], []


GROUPS = np.repeat(np.arange(24), 2)
THREE = Protocol(n_splits=3, random_state=0)
COUNTS = GROUPS % 3


def test_folds_fitted_in_processes_give_the_same_scores():
    X = COUNTS[:, np.newaxis] + np.random.default_rng(1).normal(0, 0.6, (COUNTS.size, 3))
    told = []
    alone = evaluate(GaussianNB(), X, COUNTS, GROUPS, protocol=THREE)
    in_processes = replace(THREE, n_jobs=2, progress=lambda *done: told.append(done))
    together = evaluate(Elsewhere(os.getpid()), X, COUNTS, GROUPS, protocol=in_processes)
    assert together.to_dict() == alone.to_dict()
    assert 0 < alone.accuracy < 1
    assert told == [(1, 3), (2, 3), (3, 3)]
    with pytest.raises(AssertionError):
        evaluate(Elsewhere(os.getpid()), X, COUNTS, GROUPS, protocol=THREE)


# Protocols


def test_one_assembly_is_left_out_at_a_time_and_groups_are_handed_over():
    protocol = Protocol("leave-one-condition-out", conditions=GROUPS)
    result = evaluate(Recorder(), held(COUNTS, GROUPS), COUNTS, GROUPS, protocol=protocol)
    assert len(Recorder.calls) == 24
    for k, (seen, asked, groups) in enumerate(Recorder.calls):
        assert asked == {2 * k, 2 * k + 1}
        assert not seen & asked
        assert groups == set(range(24)) - {k}
    assert result.protocol == "leave-one-condition-out"
    assert result.accuracy == 1


def test_a_condition_is_left_out_together_with_its_assemblies():
    """Assembly 0 ran under both loads: when 18 Nm is tested, its windows at 22 Nm do not train."""
    load = np.where(GROUPS < 12, 18, 22)
    load[1] = 22
    protocol = Protocol("leave-one-condition-out", conditions=load)
    result = evaluate(Recorder(), held(COUNTS, GROUPS), COUNTS, GROUPS, protocol=protocol)
    (seen_18, asked_18, _), (seen_22, asked_22, _) = Recorder.calls
    assert asked_18 == set(np.flatnonzero(load == 18))
    assert asked_22 == set(np.flatnonzero(load == 22))
    assert seen_18 == set(range(24, 48))
    assert 0 not in seen_22
    assert result.by_condition == {18: 1.0, 22: 1.0}


def test_a_fitted_counter_is_only_tested_and_may_know_counts_that_the_test_lacks():
    fitted = Recorder().fit(held(COUNTS, GROUPS), COUNTS)
    test = COUNTS < 2
    result = evaluate(
        fitted, held(COUNTS, GROUPS)[test], COUNTS[test], GROUPS[test], protocol=Protocol("nothing")
    )
    ((_, asked, _),) = Recorder.calls
    assert asked == set(np.flatnonzero(test))
    assert_array_equal(result.classes, [0, 1, 2])
    assert result.probabilities.shape == (32, 3)
    assert (result.accuracy, result.protocol) == (1, "nothing")


def search(steps, **grid):
    return GridSearchCV(steps, grid, cv=StratifiedGroupKFold(2))


@pytest.mark.parametrize("routing", [False, True])
@pytest.mark.parametrize(
    "counter",
    [
        make_pipeline(StandardScaler(with_mean=False, with_std=False), Recorder()),
        make_pipeline(FunctionTransformer(), GroupCalibratedCounter(Recorder())),
        search(make_pipeline(FunctionTransformer(), Recorder()), functiontransformer__validate=[False]),
    ],
    ids=["pipeline", "calibrated", "search"],
)
def test_groups_reach_steps_of_pipelines_and_searches(counter, routing):
    with config_context(enable_metadata_routing=routing):
        result = evaluate(counter, held(COUNTS, GROUPS), COUNTS, GROUPS, protocol=THREE)
    assert result.accuracy == 1
    assert len(Recorder.fits) >= 3
    for seen, groups in Recorder.fits:
        assert len(groups) == len({number // 2 for number in seen}) == len(seen) / 2


def test_metadata_leave_no_trace_in_the_counter_and_obey_its_requests():
    with config_context(enable_metadata_routing=True):
        refusing = make_pipeline(FunctionTransformer(), Recorder().set_fit_request(groups=False))
    evaluate(refusing, held(COUNTS, GROUPS), COUNTS, GROUPS, protocol=THREE)
    assert all(groups is None for _, _, groups in Recorder.calls)
    fitted = fit_clone(make_pipeline(Recorder()), held(COUNTS, GROUPS), COUNTS, groups=GROUPS)
    assert not hasattr(fitted[0], "_metadata_request")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"groups": None}, "groups must name the assembly.*recognises the recording"),
        ({"hold_out": "shuffled"}, "hold_out must be .*'stratified'.*got 'shuffled'"),
        ({"hold_out": "leave-one-condition-out"}, "conditions must name the condition of every window"),
        ({"hold_out": "leave-one-condition-out", "conditions": np.ones(48)}, "at least two conditions"),
        (
            {"hold_out": "leave-one-condition-out", "conditions": COUNTS},
            "condition 0 holds count 0, which no assembly of another condition has",
        ),
        ({"conditions": [1, 2]}, "conditions must hold one value per window"),
        ({"lobes": np.ones((48, 4))}, r"lobes must be a tuple \(worn, passage\)"),
        ({"lobes": (np.ones(48), np.ones(48))}, r"worn must have shape \(n_windows, n_lobes\)"),
        ({"groups": np.zeros(48)}, "class 0 has 1 assembly, fewer than n_splits = 5"),
        ({"groups": GROUPS[:5]}, r"groups must hold one value per window, shape \(48,\), got shape \(5,\)"),
        ({"y": COUNTS.astype(str)}, "y must hold defect counts.*'0'"),
        ({"y": COUNTS[:, np.newaxis]}, r"y must hold one value per window, .* got shape \(48, 1\)"),
        ({"X": np.full((48, 3), np.nan)}, "X contains NaN"),
        ({"X": np.vstack([held(COUNTS, GROUPS)[:47], np.ones(3)])}, "window 47 is constant"),
        ({"X": np.arange(48.0)}, "Expected 2D array"),
        ({"n_splits": 1}, "n_splits must be at least 2, got 1"),
        ({"confidence": 95}, "confidence must lie between 0 and 1, got 95"),
    ],
)
def test_bad_input(changes, message):
    arguments = {"X": held(COUNTS, GROUPS), "y": COUNTS, "groups": GROUPS, **changes}
    options = ("hold_out", "conditions", "n_splits", "confidence")
    protocol = {name: arguments.pop(name) for name in options if name in arguments}
    with pytest.raises(ValueError, match=message):
        evaluate(Recorder(), **arguments, protocol=Protocol(**protocol))


# Scores


def test_scores_by_hand():
    """Assemblies 0 and 1 wrong by one in both windows, the others right; 0.8 said each time."""
    answers = COUNTS.copy()
    answers[GROUPS == 0] = 1
    answers[GROUPS == 1] = 2
    passage = np.where(np.arange(48) % 2, 0, 1)  # every second window places one lobe too many
    result = evaluate(
        Recorder(), held(answers, GROUPS), COUNTS, GROUPS,
        lobes=(np.arange(4) < COUNTS[:, np.newaxis], passage),
    )  # fmt: skip
    assert result.accuracy == pytest.approx(22 / 24)
    assert result.mean_absolute_error == pytest.approx(2 / 24)
    assert result.macro_f1 == pytest.approx(f1_score(COUNTS, answers, average="macro"))
    assert_array_equal(result.predictions, answers)
    assert_array_equal(result.confusion, confusion_matrix(COUNTS, answers))
    assert_array_equal(result.group_accuracy, [0, 0, *[1] * 22])
    assert_allclose(result.confusion_interval[:, 2, 2], 1)
    assert result.calibration_error == pytest.approx(22 / 24 - 0.8)
    assert result.exact_lobes == pytest.approx(22 / 48)
    scores = json.loads(json.dumps(result.to_dict()))
    assert scores["exact_lobes"] == pytest.approx(22 / 48)
    assert "by_condition" not in scores


def test_calibration_error_by_hand():
    """Two bins: 0.9 said and 0.5 right in half of the weight; 0.6 said and all right in the other."""
    said = np.array([0.91, 0.91, 0.61, 0.61])
    right = np.array([True, False, True, True])
    sums = calibration_sums(said, right, np.ones(4), np.arange(4))
    assert expected_calibration_error(sums.sum(axis=0)) == pytest.approx(0.5 * 0.41 + 0.5 * 0.39)
    # an assembly of many windows weighs no more than one of few
    member = np.array([0, 1, 1, 1])
    sums = calibration_sums(said, right, np.array([1, 1 / 3, 1 / 3, 1 / 3]), member)
    expected = (abs(0.91 * 4 / 3 - 1) + abs(0.61 * 2 / 3 - 2 / 3)) / 2
    assert expected_calibration_error(sums.sum(axis=0)) == pytest.approx(expected)


# Intervals


def test_without_a_single_error_the_rule_of_three_bounds_the_accuracy():
    result = evaluate(Recorder(), held(COUNTS, GROUPS), COUNTS, GROUPS)
    bound = rule_of_three(24, 0.95)
    assert bound == pytest.approx(3 / 24, abs=0.01)
    assert binom.pmf(0, 24, bound) == pytest.approx(0.05)
    assert result.accuracy_interval == (1 - bound, 1.0)
    assert result.macro_f1_interval == (1 - bound, 1.0)
    assert result.mean_absolute_error_interval == (0.0, bound)
    wrong = evaluate(Recorder(), held((COUNTS + 1) % 3, GROUPS), COUNTS, GROUPS)
    assert wrong.accuracy_interval == (0.0, bound)
    assert limits_at_ends(0.5, (0.4, 0.6), 24, 0.95) == (0.4, 0.6)


def test_intervals_are_of_assemblies_not_of_windows():
    """Twelve windows each, right or wrong together: 24 assemblies, not 288 windows."""
    groups = np.repeat(np.arange(24), 12)
    y = groups % 3
    answers = np.where(groups < 12, y, (y + 1) % 3)
    result = evaluate(Recorder(), held(answers, groups), y, groups, protocol=Protocol(random_state=0))
    expected = binom.ppf([0.025, 0.975], 24, 0.5) / 24
    assert_allclose(result.accuracy_interval, expected, atol=0.03)


def test_counters_without_probabilities_have_no_calibration_error():
    class Plain(BaseEstimator):
        def fit(self, X, y):
            return self

        def predict(self, X):
            return np.zeros(len(X))

    result = evaluate(Plain(), held(COUNTS, GROUPS), COUNTS, GROUPS)
    assert result.calibration_error is None
    assert result.probabilities is None
    assert evaluate(DummyClassifier(), held(COUNTS, GROUPS), COUNTS, GROUPS).calibration_error is not None
