"""One number per window and a ladder of thresholds, against discriminant analysis and by hand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

from cyclofeat.counting import EntropyLadder


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
