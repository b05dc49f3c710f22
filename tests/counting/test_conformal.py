"""Thresholds of conformal prediction, and refusals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.distance import mahalanobis
from sklearn.covariance import LedoitWolf

from cyclofeat.counting import TrainingDomain
from cyclofeat.counting.calibration.conformal_regressor import conformal_threshold
from cyclofeat.counting.evaluation.assembly_folds import grouped_folds
from cyclofeat.datasets import make_rig_recordings
from cyclofeat.features import LobeMap


def assemblies(n=400, windows=3, seed=0, shared=0.5, own=0.15):
    random = np.random.default_rng(seed)
    group = np.repeat(np.arange(n), windows)
    y = group % 4
    common = random.normal(scale=shared, size=(n, 2))[group]
    return y[:, np.newaxis] + common + random.normal(scale=own, size=(group.size, 2)), y, group


# Thresholds


def test_thresholds_by_hand():
    scores = np.array([0.1, 0.4, 0.2, 0.3])
    own = np.arange(4)
    assert conformal_threshold(scores, own, 0.6) == 0.3  # third of four: 3/5
    assert conformal_threshold(scores, own, 0.61) == 0.4
    assert conformal_threshold(scores, own, 0.81) == np.inf
    # two assemblies: half of 1/3 each window
    pairs = np.array([0, 0, 1, 1])
    assert conformal_threshold(scores, pairs, 0.5) == 0.3


# Refusals


def test_distances_and_thresholds_of_the_domain_by_hand():
    X, y, groups = assemblies(n=80, windows=1)

    def by_hand(X, y, of):
        location, scale = X.mean(axis=0), X.std(axis=0)
        scaled = (X - location) / scale
        means = np.stack([scaled[y == c].mean(axis=0) for c in range(4)])
        precision = LedoitWolf(assume_centered=True).fit(scaled - means[y]).precision_
        rows = (of - location) / scale
        return np.array([[mahalanobis(row, mean, precision) for mean in means] for row in rows])

    domain = TrainingDomain(false_refusal=0.1).fit(X, y)
    held_out = np.empty((80, 4))
    seed = int(np.random.RandomState(0).randint(2**31 - 1))
    for train, test in grouped_folds(y, groups, 5, seed):
        held_out[test] = by_hand(X[train], y[train], X[test])
    spreads = np.array([np.sqrt(np.mean(held_out[y == c, c] ** 2)) for c in range(4)])
    largest = np.sort((held_out / spreads).min(axis=1))[int(np.ceil(0.9 * 81)) - 1]
    assert_allclose(domain.thresholds_, largest * spreads)
    assert_allclose(domain.distance(X), (by_hand(X, y, X) / domain.thresholds_).min(axis=1))


def test_features_lower_than_the_lowest_that_counts_are_no_reason_to_refuse():
    random = np.random.default_rng(5)
    X = random.normal(size=(400, 3))
    lowest = np.array([0.0, 0.0, -np.inf])
    domain = TrainingDomain(lowest).fit(X)
    raised = TrainingDomain().fit(np.maximum(X, lowest))
    quiet, loud = np.array([[-50.0, -50.0, 0.0]]), np.array([[50.0, 0.0, 0.0]])
    assert_allclose(domain.distance(quiet), raised.distance([[0.0, 0.0, 0.0]]))
    outside = domain.distance(np.vstack([quiet, loud, [[0.0, 0.0, -50.0]]])) > 1
    assert outside.tolist() == [False, True, True]
    assert domain._rank_unlike(np.vstack([loud, [[0.0, 0.0, -50.0]]]))[:, 0].tolist() == [0, 2]
    with pytest.raises(ValueError, match=r"lowest must hold one value .*, shape \(3,\), got shape \(2,\)"):
        TrainingDomain([0.0, 0.0]).fit(X)


def test_a_class_that_scatters_more_is_refused_no_more_often():
    random = np.random.default_rng(8)
    scatter = np.array([3.0, 1.0, 1.0, 1.0])

    def drawn(n):
        y = np.arange(n) % 4
        return 40.0 * y[:, np.newaxis] + scatter[y, np.newaxis] * random.normal(size=(n, 5)), y

    domain = TrainingDomain(false_refusal=0.1).fit(*drawn(800))
    X, y = drawn(4000)
    outside = [np.mean(domain.distance(X[y == c]) > 1) for c in range(4)]
    assert max(outside) <= 0.15
    assert min(outside) >= 0.06


def test_a_class_of_one_assembly_or_of_equal_windows_has_a_finite_threshold():
    X, y, groups = assemblies(n=40)
    one = np.where(np.arange(len(y)) < (groups == 0).sum(), 9, y)  # the first assembly alone
    equal = np.where((y == 0)[:, np.newaxis], 1.0, X)
    for domain in (TrainingDomain().fit(X, one, groups), TrainingDomain().fit(equal, y, groups)):
        assert np.all((domain.thresholds_ > 0) & np.isfinite(domain.thresholds_))


@pytest.mark.slow
def test_the_stated_share_of_assemblies_is_refused():
    rates = []
    for seed in range(20):
        X, y, groups = assemblies(n=100, seed=seed)
        domain = TrainingDomain(false_refusal=0.1).fit(X, y, groups)
        new, _, names = assemblies(n=400, seed=1000 + seed)
        outside = domain.distance(new) > 1
        rates.append(np.bincount(names, outside).astype(bool).mean())
    assert 0.06 <= np.mean(rates) <= 0.115


def test_few_assemblies_cannot_promise_few_refusals():
    X, y, groups = assemblies(n=12)
    domain = TrainingDomain(false_refusal=0.01).fit(X, y, groups)
    assert domain.false_refusal_ == pytest.approx(1 / 13)
    with pytest.raises(ValueError, match="groups must name at least 2 assemblies, got 1"):
        TrainingDomain().fit(X, y, np.zeros(len(X)))


@pytest.mark.slow
def test_torque_that_the_counter_was_not_made_for_is_refused():
    """Another speed, no gear signal, nine worn lobes: from rig R1, against 5 % refusals of its like."""
    options = {"rig": "R1", "kernel": "batch"}  # whose noise is 0.2 Nm
    training = make_rig_recordings(12, (0, 1, 3, 5, 7), random_state=21, **options)
    new = make_rig_recordings(6, (0, 1, 3, 5, 7), random_state=22, **options)
    nine = make_rig_recordings(10, [9], random_state=23, **options)
    X, y = np.stack([r.torque for r in training]), np.array([r.defect_count for r in training])
    lobe_map = LobeMap(25_600)
    domain = TrainingDomain(false_refusal=0.05).fit(lobe_map.fit_transform(X), y)
    steps = np.arange(X.shape[1])
    alike = np.stack([r.torque for r in new])

    def refused(windows):
        return np.mean(domain.distance(lobe_map.transform(np.stack(windows))) > 1)

    assert refused(alike) <= 0.17
    assert refused([np.interp((1.2 * steps) % steps[-1], steps, row) for row in alike]) == 1
    assert refused([np.interp(0.8 * steps, steps, row) for row in alike]) == 1
    assert refused(22 + np.random.default_rng(0).normal(scale=0.2, size=(100, X.shape[1]))) >= 0.95
    assert refused([r.torque for r in nine]) >= 0.7
