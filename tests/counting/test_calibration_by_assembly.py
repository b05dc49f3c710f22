"""Probabilities of held-out assemblies: against scikit-learn's calibration, by simulation and by hand."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn import config_context
from sklearn.base import clone
from sklearn.calibration import CalibratedClassifierCV
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.metrics import log_loss
from sklearn.model_selection import GroupKFold, cross_validate
from sklearn.naive_bayes import GaussianNB
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from cyclofeat.counting import GroupCalibratedCounter, Protocol, evaluate
from cyclofeat.counting.calibration.pooling import combine_proba, learn_dependence, pool_weights
from cyclofeat.counting.evaluation.assembly_folds import grouped_folds


def assemblies(n=120, windows=3, seed=0, n_classes=4, shared=0.5, own=0.3, n_features=8):
    """Windows of assemblies that share most of their deviation: what grouping is about."""
    random = np.random.default_rng(seed)
    group = np.repeat(np.arange(n), windows)
    y = group % n_classes
    place = np.linspace(-1, 1, n_classes)[y][:, np.newaxis] * np.ones(n_features)
    common = random.normal(scale=shared * 2, size=(n, n_features))[group]
    return place + common + random.normal(scale=own, size=place.shape), y, group


@pytest.mark.slow
def test_the_temperature_is_scikit_learns_on_the_same_folds():
    X, y, groups = assemblies()
    trees = ExtraTreesClassifier(50, random_state=0)
    ours = GroupCalibratedCounter(trees, random_state=3).fit(X, y, groups=groups)
    seed = int(np.random.RandomState(3).randint(2**31 - 1))
    folds = grouped_folds(y, groups, 5, seed)
    assert all(not set(groups[train]) & set(groups[test]) for train, test in folds)
    try:
        theirs = CalibratedClassifierCV(trees, method="temperature", ensemble=False, cv=folds).fit(X, y)
    except ValueError:
        pytest.skip("temperature scaling came with scikit-learn 1.8")
    # Ours counts no probability below 0.001 and takes one of 122 assemblies for wrong.
    new, truth, _ = assemblies(seed=1)
    assert_allclose(ours.predict_proba(new), theirs.predict_proba(new), atol=0.05)
    assert log_loss(truth, ours.predict_proba(new)) <= log_loss(truth, theirs.predict_proba(new)) + 0.01


def test_held_out_answers_do_not_know_the_windows_assembly():
    """Features that tell the assembly and nothing else: its own windows are known, all others are guessed."""
    groups = np.repeat(np.arange(60), 2)
    y = np.random.default_rng(0).integers(2, size=60)[groups]
    X = np.eye(60)[groups]
    counter = GroupCalibratedCounter(ExtraTreesClassifier(20, random_state=0), random_state=0)
    held_out = counter._fit_cross_val_proba(X, y, groups)
    assert counter.counter_.score(X, y) == 1
    assert np.mean(held_out.argmax(axis=1) == y) < 0.7
    assert np.isnan(counter._fit_cross_val_proba(X, y, np.zeros(120))).all()


def test_a_copy_holds_all_that_the_fitted_counter_holds():
    X, y, groups = assemblies(n=20)
    counter = GroupCalibratedCounter(GaussianNB(), random_state=0).fit(X, y, groups=groups)
    assert vars(pickle.loads(pickle.dumps(counter))).keys() == vars(counter).keys()


class TakesPassages(GaussianNB):
    """Remembers the passages that it was fitted with."""

    def fit(self, X, y, passage=None):
        self.passage_ = passage
        return super().fit(X, y)


@pytest.mark.parametrize("routing", [False, True])
def test_metadata_reach_the_counter_in_its_pipeline(routing):
    X, y, groups = assemblies(n=20)
    inner = TakesPassages()
    pipeline = make_pipeline(StandardScaler(), inner) if routing else inner
    counter = GroupCalibratedCounter(pipeline, random_state=0)
    with config_context(enable_metadata_routing=routing):
        counter.fit(X, y, groups=groups, passage=np.arange(len(y)))
    fitted = counter.counter_[-1] if routing else counter.counter_
    assert_array_equal(fitted.passage_, np.arange(len(y)))
    with pytest.raises(TypeError, match="fit got worn, which no step of counter="):
        counter.fit(X, y, worn=np.zeros(len(y)))


@pytest.mark.slow
def test_calibration_by_assembly_lowers_the_error_that_evaluate_reports():
    """A forest sure of itself by windows of the same assembly, and one that spreads over eight classes."""
    X, y, groups = assemblies(n=240, windows=2, n_classes=8, shared=0.1, n_features=12)
    trees = ExtraTreesClassifier(20, random_state=0)
    protocol = Protocol(random_state=0)
    plain = evaluate(trees, X, y, groups, protocol=protocol)
    ours = evaluate(GroupCalibratedCounter(trees, random_state=0), X, y, groups, protocol=protocol)
    assert plain.calibration_error > 0.1
    assert ours.calibration_error < 0.6 * plain.calibration_error
    assert abs(ours.accuracy - plain.accuracy) < 0.03


@pytest.mark.slow
def test_temperature_never_changes_the_count_and_needs_the_groups():
    X, y, groups = assemblies()
    trees = ExtraTreesClassifier(50, random_state=0)
    plain = trees.fit(X, y)
    seeing = GroupCalibratedCounter(trees, random_state=0).fit(X, y, groups=groups)
    blind = GroupCalibratedCounter(trees, random_state=0).fit(X, y)
    new, truth, _ = assemblies(seed=1)
    assert_array_equal(seeing.predict(new), plain.predict(new))
    # folds that split assemblies see copies of their test windows: too low a temperature
    assert blind.temperature_ < 0.8 * seeing.temperature_
    assert log_loss(truth, seeing.predict_proba(new)) < log_loss(truth, blind.predict_proba(new))


def test_pool_weights_recover_the_power_that_was_taken():
    """Labels drawn from p, opinions p^(1/2.5) and pure noise: powers 2.5 and 0."""
    random = np.random.default_rng(0)
    p = random.dirichlet(np.ones(4), size=20_000)
    rank = np.array([random.choice(4, p=row) for row in p])
    noise = np.log(random.dirichlet(np.ones(4), size=20_000))
    found = pool_weights(np.stack([np.log(p) / 2.5, noise]), rank, np.arange(20_000))
    assert_allclose(found, [2.5, 0.0], atol=0.06)


def test_perfect_held_out_answers_do_not_make_certain():
    """Twenty assemblies all right: one of 22 is taken for wrong."""
    X = np.repeat([0.0, 1.0], 10)[:, np.newaxis] + np.linspace(0, 0.1, 20)[:, np.newaxis]
    counter = GroupCalibratedCounter(GaussianNB(), random_state=0).fit(X, np.repeat([0, 1], 10))
    assert 0.9 < counter.predict_proba(X).max(axis=1).min() < 0.97


def test_a_class_with_one_assembly_leaves_probabilities_as_they_are():
    X, y, _ = assemblies(n=8, windows=2)
    counter = GroupCalibratedCounter(GaussianNB(), random_state=0).fit(X, y, groups=y)
    assert counter.temperature_ == 1
    assert counter.dependence_ is None
    # but for the floor of 0.001 that every opinion has
    assert_allclose(counter.predict_proba(X), GaussianNB().fit(X, y).predict_proba(X), atol=3e-3)


# Recordings


def test_probabilities_of_windows_are_multiplied_unless_many_are_worth_one():
    p = np.array([[0.6, 0.3, 0.1], [0.2, 0.7, 0.1], [0.3, 0.4, 0.3], [0.9, 0.05, 0.05]])
    product = p[0] * p[1] * p[3]
    assert_allclose(combine_proba(p, np.array([1, 1, 0, 1]), 0.0), [p[2], product / product.sum()])
    assert_allclose(combine_proba(p[[0] * 5], np.zeros(5, dtype=int), 1.0), p[:1])


def windows_of_recordings(copies, n=3000, seed=0):
    """Calibrated windows of recordings of two classes: all alike, or each with noise of its own."""
    random = np.random.default_rng(seed)
    truth = random.integers(0, 2, n)
    distinct = 1 if copies else 4
    seen = np.where(truth, 1.0, -1.0)[:, np.newaxis] + random.normal(scale=1.5, size=(n, distinct))
    log_odds = np.repeat(2 * seen / 1.5**2, 4 // distinct, axis=1).ravel()
    p = 1 / (1 + np.exp(-log_odds))
    return np.column_stack([1 - p, p]), np.repeat(truth, 4), np.repeat(np.arange(n), 4)


@pytest.mark.parametrize(("copies", "expected"), [(False, 0.0), (True, 1.0)])
def test_dependence_is_learned_from_held_out_recordings(copies, expected):
    proba, rank, member = windows_of_recordings(copies)
    learned = learn_dependence(proba, rank, member)
    assert learned == pytest.approx(expected, abs=0.05)
    combined = combine_proba(proba, member, learned)
    truth = rank[::4]
    said = combined.max(axis=1).mean()
    assert said == pytest.approx(np.mean(combined.argmax(axis=1) == truth), abs=0.02)


def test_a_calibrated_counter_learns_the_dependence():
    X, y, groups = assemblies(windows=4, shared=0.5)
    trees = ExtraTreesClassifier(40, random_state=0)
    counter = GroupCalibratedCounter(trees, random_state=0).fit(X, y, groups=groups)
    # windows share most of their deviation, so that four are worth little more than one
    assert counter.dependence_ > 0.5
    new, truth, names = assemblies(windows=4, shared=0.5, seed=5)
    proba = counter.predict_proba(new)
    learned, product = (combine_proba(proba, names, rho) for rho in (counter.dependence_, 0.0))
    assert_array_equal(learned.argmax(axis=1), product.argmax(axis=1))
    assert log_loss(truth[::4], learned) < log_loss(truth[::4], product)


def test_groups_come_through_scikit_learns_metadata_routing():
    X, y, groups = assemblies(n=60)
    counter = GroupCalibratedCounter(GaussianNB(), random_state=0)
    returned = {"return_estimator": True, "return_indices": True}
    with config_context(enable_metadata_routing=True):
        counter.set_fit_request(groups=True)
        result = cross_validate(counter, X, y, params={"groups": groups}, cv=GroupKFold(3), **returned)
    for fitted, train in zip(result["estimator"], result["indices"]["train"], strict=True):
        again = clone(counter).fit(X[train], y[train], groups=groups[train])
        assert fitted.temperature_ == pytest.approx(again.temperature_)
