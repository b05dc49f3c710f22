"""Cumulative logit against statsmodels, logistic regression and its own derivatives."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import approx_fprime
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression

from cyclofeat.counting import OrdinalCounter
from cyclofeat.counting.estimators.ordinal_counter import _loss


def drawn(n=300, seed=0):
    random = np.random.default_rng(seed)
    X = random.normal(size=(n, 4))
    return X, np.digitize(X @ [1, -0.5, 0, 2] + random.logistic(size=n), [-2, 0, 1])


def test_without_penalty_it_is_statsmodels_ordered_model():
    ordinal_model = pytest.importorskip("statsmodels.miscmodels.ordinal_model")
    X, y = drawn()
    fitted = ordinal_model.OrderedModel(y, X, distr="logit").fit(method="bfgs", disp=False, gtol=1e-8)
    thresholds = np.asarray(fitted.model.transform_threshold_params(fitted.params[4:]))[1:-1]
    counter = OrdinalCounter(alpha=0).fit(X, y)
    assert_allclose(counter.coef_, fitted.params[:4], atol=1e-4)
    assert_allclose(counter.thresholds_, thresholds, atol=1e-4)
    assert_allclose(counter.predict_proba(X), fitted.predict(X), atol=1e-4)


def test_two_classes_are_logistic_regression():
    X, y = drawn()
    y = y > 1
    oracle = LogisticRegression(C=1 / 3, tol=1e-8).fit(X, y)
    counter = OrdinalCounter(alpha=3, tol=1e-8).fit(X, y)
    assert_allclose(counter.coef_, oracle.coef_[0], atol=1e-4)
    assert_allclose(counter.thresholds_, -oracle.intercept_, atol=1e-4)
    assert_allclose(counter.predict_proba(X), oracle.predict_proba(X), atol=1e-4)


@pytest.mark.parametrize("alpha", [0.0, 0.7])
def test_the_gradient_is_that_of_the_loss(alpha):
    X, y = drawn(60)
    for seed in range(3):
        at = np.random.default_rng(seed).normal(size=7)
        numerical = approx_fprime(at, lambda p: _loss(p, X, y, alpha)[0], 1e-7)
        assert_allclose(_loss(at, X, y, alpha)[1], numerical, atol=1e-5)


def test_far_out_neither_loss_nor_probabilities_break():
    """e^800 overflows: sums of the features in the hundreds must not."""
    X, y = drawn(60)
    loss, gradient = _loss(np.array([900.0, -900, 900, 900, 0, 1, 1]), X, y, 1.0)
    assert np.isfinite(loss)
    assert np.isfinite(gradient).all()
    proba = OrdinalCounter().fit(X, y).predict_proba(1e4 * X)
    assert np.isfinite(proba).all()
    assert_allclose(proba.sum(axis=1), 1)


def test_a_count_that_training_lacks_is_not_predicted():
    X, y = drawn()
    lacking = y != 2
    counter = OrdinalCounter().fit(X[lacking], y[lacking])
    assert_array_equal(counter.classes_, [0, 1, 3])
    assert counter.predict_proba(X).shape == (300, 3)
    assert set(counter.predict(X)) <= {0, 1, 3}
    # of the windows in between, neighbours are predicted rather than the other end
    assert np.mean(np.abs(counter.predict(X[~lacking]) - 2) == 1) > 0.8


def test_the_expected_count_grows_with_the_weighted_sum():
    X, y = drawn()
    counter = OrdinalCounter().fit(X, y)
    order = np.argsort(X @ counter.coef_)
    assert np.all(np.diff(counter.predict_proba(X)[order] @ counter.classes_) >= 0)
    assert np.all(np.diff(counter.thresholds_) > 0)


def test_the_penalty_shrinks():
    X, y = drawn()
    sizes = [np.linalg.norm(OrdinalCounter(alpha=alpha).fit(X, y).coef_) for alpha in (0, 10, 1000)]
    assert sizes[0] > sizes[1] > sizes[2] > 0


def test_a_fit_cut_short_says_so():
    X, y = drawn()
    with pytest.warns(ConvergenceWarning, match="max_iter=2 steps.*raise max_iter or alpha"):
        OrdinalCounter(max_iter=2).fit(X, y)
