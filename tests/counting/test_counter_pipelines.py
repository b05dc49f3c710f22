"""Ready counters of every kind on assemblies never seen; the ladder against discriminant analysis."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from small_model import first_of_each

from cyclofeat.counting import EntropyLadder, LobeCounter, make_lobe_counter
from cyclofeat.counting.estimators.pipelines import KINDS
from cyclofeat.counting.estimators.trees import CountingTrees

SAMPLING_RATE = 25_600


@pytest.fixture(scope="module")
def data(surrogates):
    y = np.array([r.defect_count for r in surrogates])
    return np.stack([r.torque for r in surrogates]), y, first_of_each(surrogates, 6)


def test_trees_asked_together_answer_as_one_by_one():
    random = np.random.default_rng(0)
    X = random.normal(size=(300, 6)).round(1)  # many values on thresholds
    y = random.integers(0, 4, 300)
    trees = CountingTrees(40, random_state=0, min_samples_leaf=2)
    trees.fit(X, y, sample_weight=random.uniform(size=300))
    new = random.normal(size=(50, 6)).round(1)
    together = trees.predict_proba(new)
    assert_allclose(together, np.mean([tree.predict_proba(new) for tree in trees.estimators_], axis=0))
    # the many go the other way, and say the same
    many = trees.predict_proba(np.repeat(new, 120, axis=0))
    assert_allclose(many[::120], together)
    assert np.array_equal(trees.predict(new), trees.classes_[together.argmax(axis=1)])


# A parameter of the last step and one of what comes before it, for each kind
PARAMETERS = {
    "lobe_map": {"trees__max_features": 0.5, "lobe_map__ar_order": 12, "lobe_map__n_lines": 30},
    "features": {"trees__max_features": 0.5, "features__preset": "ripple"},
    "entropy": {"trees__max_features": 0.5, "entropy__preset": "ripple"},
    "ladder": {"ladder__column": -1, "entropy__preset": "ripple"},
    "trees": {"n_splits": 2, "n_lines": 30},
    "network": {"n_splits": 0, "n_epochs": 30},
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_takes_parameters_and_counts(kind, data):
    X, y, train = data
    counter = make_lobe_counter(SAMPLING_RATE, kind=kind, n_trees=20).set_params(**PARAMETERS[kind])
    copy = clone(counter)
    assert PARAMETERS[kind].items() <= copy.get_params().items()
    if kind == "network":
        return  # test_rows.py trains it
    copy.fit(X[train], y[train])
    proba = copy.predict_proba(X[~train])
    assert_allclose(proba.sum(axis=1), 1)
    assert copy.classes_.tolist() == [0, 1, 3, 5]
    # The entropy cannot, and eight assemblies are few for 340 features.
    if kind not in ("entropy", "ladder", "features"):
        assert np.mean(copy.predict(X[~train]) == y[~train]) >= 6 / 8


def test_unknown_kinds_are_refused():
    assert type(make_lobe_counter(SAMPLING_RATE, kind="trees")) is LobeCounter
    with pytest.raises(ValueError, match=r"kind must be one of \('lobe_map'.*got 'forest'"):
        make_lobe_counter(SAMPLING_RATE, kind="forest")


# A ladder


def drawn(means, n=40, seed=0):
    random = np.random.default_rng(seed)
    y = np.repeat(np.arange(len(means)), n)
    return random.normal(np.asarray(means)[y], 0.5)[:, np.newaxis], y


@pytest.mark.parametrize("sign", [1, -1])
def test_in_order_it_is_discriminant_analysis_with_equal_priors(sign):
    X, y = drawn([0.0, 1.0, 1.7, 3.0])
    ladder = EntropyLadder().fit(sign * X, y)
    oracle = LinearDiscriminantAnalysis(priors=[0.25] * 4).fit(sign * X, y)
    grid = np.linspace(-4, 4, 81)[:, np.newaxis]
    assert ladder.increasing_ == (sign > 0)
    assert_array_equal(ladder.predict(grid), oracle.predict(grid))
    # the oracle divides the sum of squares by the windows, the ladder by the degrees of freedom
    ladder.spread_ *= np.sqrt((len(y) - 4) / len(y))
    assert_allclose(ladder.predict_proba(grid), oracle.predict_proba(grid), atol=1e-9)


def test_the_most_probable_class_lies_between_its_thresholds():
    X, y = drawn([5.0, 4.0, 2.0])
    ladder = EntropyLadder().fit(X, y)
    grid = np.linspace(0, 7, 701)
    by_threshold = (grid[:, np.newaxis] < ladder.thresholds_).sum(axis=1)
    assert_array_equal(ladder.predict(grid[:, np.newaxis]), by_threshold)
    assert_allclose(ladder.predict_proba(grid[:, np.newaxis]).sum(axis=1), 1)


def test_classes_out_of_order_share_a_rung():
    """Means 0, 2, 1, 3: pooling adjacent violators puts classes 1 and 2 on their common mean."""
    X = np.array([0.0, 0.1, 2.0, 2.1, 1.0, 1.1, 3.0, 3.1])[:, np.newaxis]
    ladder = EntropyLadder().fit(X, [0, 0, 1, 1, 2, 2, 3, 3])
    assert_allclose(ladder.rungs_, [0.05, 1.55, 1.55, 3.05])
    assert_allclose(ladder.predict_proba([[1.5]])[0, 1], ladder.predict_proba([[1.5]])[0, 2])
    assert ladder.predict([[1.5]]) == [1]


def test_a_column_counts_from_either_end():
    X, y = drawn([0.0, 2.0])
    three = np.hstack([X, np.zeros_like(X), -X])
    first, last = EntropyLadder(column=0).fit(three, y), EntropyLadder(column=-1).fit(three, y)
    assert_array_equal(first.predict(three), last.predict(three))
    assert first.increasing_
    assert not last.increasing_
    with pytest.raises(ValueError, match="column must be one of the 3 features, got column=3"):
        EntropyLadder(column=3).fit(three, y)


def test_windows_of_a_class_all_alike():
    ladder = EntropyLadder().fit([[1.0], [1.0], [2.0], [2.0]], ["a", "a", "b", "b"])
    assert_array_equal(ladder.predict([[1.4], [1.6]]), ["a", "b"])
    assert np.isfinite(ladder.predict_proba([[1.5], [1e6]])).all()
