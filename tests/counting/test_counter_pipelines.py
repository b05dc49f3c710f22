"""Ready counters of every kind: parameters, recordings of assemblies never seen."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.base import clone
from small_model import first_of_each

from cyclofeat.counting import LobeCounter, make_lobe_counter
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
