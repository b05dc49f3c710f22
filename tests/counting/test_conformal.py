"""Sets of counts against MAPIE and crepes, coverage by assembly, and refusals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.distance import mahalanobis
from sklearn.covariance import LedoitWolf
from sklearn.naive_bayes import GaussianNB

from cyclofeat.counting import (
    ConformalCounter,
    TrainingDomain,
    conformal_threshold,
    grouped_folds,
    make_lobe_counter,
)
from cyclofeat.datasets import make_rig_recordings


def points(n=600, seed=0, n_classes=4, spread=0.5):
    random = np.random.default_rng(seed)
    y = np.arange(n) % n_classes
    return y[:, np.newaxis] + random.normal(scale=spread, size=(n, 2)), y


def assemblies(n=400, windows=3, seed=0, shared=0.5, own=0.15):
    random = np.random.default_rng(seed)
    group = np.repeat(np.arange(n), windows)
    y = group % 4
    common = random.normal(scale=shared, size=(n, 2))[group]
    return y[:, np.newaxis] + common + random.normal(scale=own, size=(group.size, 2)), y, group


def split_of(counter, y):
    """The windows that train and those that calibrate, as the counter divides them."""
    return folds_of(y, max(round(1 / counter.calibration_size), 2), counter.random_state)[0]


def folds_of(y, n_splits, random_state):
    seed = int(np.random.RandomState(random_state).randint(2**31 - 1))
    return grouped_folds(y, np.arange(len(y)), n_splits, seed)


# Oracles


@pytest.mark.parametrize("coverage", [0.8, 0.9, 0.95])
def test_split_sets_are_those_of_mapie(coverage):
    classification = pytest.importorskip("mapie.classification")
    X, y = points()
    ours = ConformalCounter(GaussianNB(), coverage=coverage, domain=None).fit(X, y)
    _, calibrate = split_of(ours, y)
    theirs = classification.SplitConformalClassifier(
        ours.counter_, confidence_level=coverage, prefit=True, conformity_score="lac"
    ).conformalize(X[calibrate], y[calibrate])
    new, _ = points(seed=1)
    assert_array_equal(ours.predict_set(new), theirs.predict_set(new)[1][:, :, 0])


@pytest.mark.parametrize("per_class", [False, True])
def test_split_and_mondrian_sets_are_those_of_crepes(per_class):
    crepes = pytest.importorskip("crepes")
    X, y = points()
    ours = ConformalCounter(GaussianNB(), coverage=0.85, per_class=per_class, domain=None).fit(X, y)
    _, calibrate = split_of(ours, y)
    theirs = crepes.WrapClassifier(ours.counter_)
    theirs.calibrate(X[calibrate], y[calibrate], class_cond=per_class)
    new, _ = points(seed=1)
    sets = theirs.predict_set(new, confidence=0.85, smoothing=False, labels=False)
    # a class is in crepes' set if its p-value exceeds 0.15, in ours if its score is at most the threshold
    assert np.mean(ours.predict_set(new) == np.asarray(sets, dtype=bool)) > 0.995


# Coverage


def realised(unit, coverage, n_trials=25):
    """Share of new windows, and of new assemblies with all windows, whose sets hold the truth."""
    windows, whole = [], []
    for seed in range(n_trials):
        X, y, groups = assemblies(n=160, seed=seed)
        counter = ConformalCounter(GaussianNB(), coverage=coverage, unit=unit, domain=None)
        counter.fit(X, y, groups=groups)
        new, truth, _ = assemblies(n=200, seed=1000 + seed)
        covered = counter.predict_set(new)[np.arange(len(truth)), truth]
        windows.append(covered.mean())
        whole.append(covered.reshape(-1, 3).all(axis=1).mean())
    return np.mean(windows), np.mean(whole)


@pytest.mark.slow
def test_coverage_is_of_windows_or_of_whole_assemblies():
    window, whole = realised("window", 0.9)
    assert 0.89 <= window <= 0.93
    assert whole < window
    window, whole = realised("assembly", 0.9)
    assert 0.89 <= whole <= 0.93
    assert window > whole


@pytest.mark.slow
def test_windows_taken_for_assemblies_promise_more_than_they_keep():
    """The reason for groups: spread of coverage over data sets, with few assemblies of many windows."""
    kept = {True: [], False: []}
    for seed in range(25):
        X, y, groups = assemblies(n=40, windows=8, seed=seed, own=0.02)
        new, truth, _ = assemblies(n=400, windows=1, seed=1000 + seed, own=0.02)
        for grouped in kept:
            counter = ConformalCounter(GaussianNB(), domain=None, calibration_size=0.3)
            counter.fit(X, y, groups=groups if grouped else None)
            kept[grouped].append(counter.predict_set(new)[np.arange(len(truth)), truth].mean())
    assert np.mean(kept[True]) >= 0.89
    assert np.mean(kept[False]) < 0.87


def test_mondrian_covers_the_hard_class_too():
    random = np.random.default_rng(0)
    y = np.arange(3000) % 3
    spread = np.array([0.1, 0.1, 0.6])[y]  # windows of class 2 fall on class 1
    X = y[:, np.newaxis] + spread[:, np.newaxis] * random.normal(size=(3000, 1))
    by_class = {}
    for per_class in (False, True):
        counter = ConformalCounter(GaussianNB(), per_class=per_class, domain=None).fit(X[::2], y[::2])
        sets, truth = counter.predict_set(X[1::2]), y[1::2]
        by_class[per_class] = min(sets[truth == c, c].mean() for c in range(3))
    assert by_class[False] < 0.85
    assert by_class[True] > 0.86


def test_cross_calibration_loses_no_assembly_and_covers():
    X, y, groups = assemblies(n=80)
    counter = ConformalCounter(GaussianNB(), method="cross", domain=None).fit(X, y, groups=groups)
    assert_array_equal(counter.n_calibration_, 20)
    new, truth, _ = assemblies(n=2000, seed=9)
    assert counter.predict_set(new)[np.arange(len(truth)), truth].mean() == pytest.approx(0.9, abs=0.05)


def test_adaptive_sets_are_never_empty_and_cover():
    X, y = points(1200, spread=0.7)
    counter = ConformalCounter(GaussianNB(), nonconformity="aps", domain=None).fit(X, y)
    new, truth = points(1200, spread=0.7, seed=1)
    sets = counter.predict_set(new)
    assert sets.any(axis=1).all()
    assert sets[np.arange(len(truth)), truth].mean() >= 0.88
    assert sets[np.arange(len(truth)), counter.predict(new)].all()


def test_thresholds_by_hand():
    scores = np.array([0.1, 0.4, 0.2, 0.3])
    own = np.arange(4)
    assert conformal_threshold(scores, own, 0.6, worst=False) == 0.3  # third of four: 3/5
    assert conformal_threshold(scores, own, 0.61, worst=False) == 0.4
    assert conformal_threshold(scores, own, 0.81, worst=False) == np.inf
    # two assemblies: half of 1/3 each window
    pairs = np.array([0, 0, 1, 1])
    assert conformal_threshold(scores, pairs, 0.5, worst=False) == 0.3
    assert conformal_threshold(scores, pairs, 0.5, worst=True) == 0.4
    assert conformal_threshold(scores[:0], own[:0], 0.5, worst=True) == np.inf


def test_a_class_with_too_few_assemblies_is_in_every_set():
    X, y, groups = assemblies(n=48, windows=1)
    counter = ConformalCounter(GaussianNB(), per_class=True, domain=None).fit(X, y, groups=groups)
    assert counter.n_calibration_.max() < 9
    assert np.isinf(counter.thresholds_).all()
    assert counter.predict_set(X).all()


# Refusals


def test_distances_and_thresholds_of_the_domain_by_hand():
    X, y = points(80)

    def by_hand(X, y, of):
        location, scale = X.mean(axis=0), X.std(axis=0)
        scaled = (X - location) / scale
        means = np.stack([scaled[y == c].mean(axis=0) for c in range(4)])
        precision = LedoitWolf(assume_centered=True).fit(scaled - means[y]).precision_
        return np.array(
            [[mahalanobis(row, mean, precision) for mean in means] for row in (of - location) / scale]
        )

    domain = TrainingDomain(false_refusal=0.1).fit(X, y)
    held_out = np.empty((80, 4))
    for train, test in folds_of(y, 5, 0):
        held_out[test] = by_hand(X[train], y[train], X[test])
    spreads = np.array([np.sqrt(np.mean(held_out[y == c, c] ** 2)) for c in range(4)])
    largest = np.sort((held_out / spreads).min(axis=1))[int(np.ceil(0.9 * 81)) - 1]
    assert_allclose(domain.thresholds_, largest * spreads)
    assert_allclose(domain.class_distances(X), by_hand(X, y, X) / domain.thresholds_)
    assert_allclose(domain.distance(X), domain.class_distances(X).min(axis=1))
    assert_allclose(domain.decision_function(X), 1 - domain.distance(X))


def test_a_class_that_scatters_more_is_refused_no_more_often():
    random = np.random.default_rng(8)
    scatter = np.array([3.0, 1.0, 1.0, 1.0])

    def drawn(n):
        y = np.arange(n) % 4
        return 40.0 * y[:, np.newaxis] + scatter[y, np.newaxis] * random.normal(size=(n, 5)), y

    domain = TrainingDomain(false_refusal=0.1).fit(*drawn(800))
    X, y = drawn(4000)
    outside = [np.mean(domain.predict(X[y == c]) == -1) for c in range(4)]
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
        outside = domain.predict(new) == -1
        rates.append(np.bincount(names, outside).astype(bool).mean())
    assert 0.06 <= np.mean(rates) <= 0.115


def test_few_assemblies_cannot_promise_few_refusals():
    X, y, groups = assemblies(n=12)
    domain = TrainingDomain(false_refusal=0.01).fit(X, y, groups)
    assert domain.false_refusal_ == pytest.approx(1 / 13)
    with pytest.raises(ValueError, match="groups must name at least 2 assemblies, got 1"):
        TrainingDomain().fit(X, y, np.zeros(len(X)))


def test_a_refused_window_has_an_empty_set_and_a_reason():
    X, y = points()
    counter = ConformalCounter(GaussianNB(), coverage=0.8).fit(X, y)
    strange = np.vstack([X[:5], [[0.0, 30.0]]])
    assert not counter.predict_set(strange)[-1].any()
    answer = counter.predict_counts(strange)[-1]
    assert answer.refused
    assert answer.counts == ()
    assert answer.distance > 1
    assert str(answer) == "refused: outside the training data"
    for answer, row in zip(counter.predict_counts(X), counter.predict_set(X), strict=True):
        assert answer.counts == tuple(counter.classes_[row])
        assert answer.refused == (not row.any())
        assert not answer.refused or answer.reason in (
            "outside the training data",
            "no count fits",
        )


@pytest.mark.slow
def test_torque_that_the_counter_was_not_made_for_is_refused():
    """Another speed, no gear signal, nine worn lobes: from rig R1, against 5 % refusals of its like."""
    options = {"rig": "R1", "n_jobs": 2}  # whose noise is 0.2 Nm
    training = make_rig_recordings(12, (0, 1, 3, 5, 7), random_state=21, **options)
    new = make_rig_recordings(6, (0, 1, 3, 5, 7), random_state=22, **options)
    nine = make_rig_recordings(10, [9], random_state=23, **options)
    X, y = np.stack([r.torque for r in training]), np.array([r.defect_count for r in training])
    domain = TrainingDomain(false_refusal=0.05)
    counter = ConformalCounter(make_lobe_counter(25_600, n_trees=30), domain=domain).fit(X, y)
    random = np.random.default_rng(0)
    steps = np.arange(X.shape[1])
    alike = np.stack([r.torque for r in new])
    faster = np.stack([np.interp((1.2 * steps) % steps[-1], steps, row) for row in alike])
    slower = np.stack([np.interp(0.8 * steps, steps, row) for row in alike])
    noise = 22 + random.normal(scale=0.2, size=(100, X.shape[1]))
    refused = {
        name: np.mean([one.distance > 1 for one in counter.predict_counts(windows)])
        for name, windows in {
            "alike": alike,
            "faster": faster,
            "slower": slower,
            "noise": noise,
            "nine": np.stack([r.torque for r in nine]),
        }.items()
    }
    assert refused["alike"] <= 0.17
    assert refused["faster"] == refused["slower"] == 1
    assert refused["noise"] >= 0.95, refused
    assert refused["nine"] >= 0.7
