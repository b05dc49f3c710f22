"""Cumulative logit: counts are ordered, and so is this classifier."""

from __future__ import annotations

import warnings
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import expit, log_expit
from sklearn.exceptions import ConvergenceWarning

from cyclofeat._base.sklearn_private import Interval, fit_context
from cyclofeat.counting.estimators._counter import Counter
from cyclofeat.counting.evaluation.assembly_folds import Float


class OrdinalCounter(Counter):
    """Ordinal regression: one weighted sum of the features, and a threshold between each two classes.

    P(y <= c_j | x) = 1 / (1 + exp(-(t_j - x b))) with t_1 < t_2 < ...: the cumulative logit or proportional
    odds model (McCullagh, J. R. Stat. Soc. B 42 (1980) 109). An L2 penalty ``alpha/2 |b|^2`` on the weights,
    none on the thresholds, is added to the negative log-likelihood.

    Parameters
    ----------
    alpha : float, default=1.0
        Strength of the penalty; 0 for none. The features should be scaled, as by ``StandardScaler``.
    max_iter : int, default=1000
        Largest number of steps.
    tol : float, default=1e-6
        Largest component of the gradient of the mean loss at which the fit ends.

    Attributes
    ----------
    classes_ : ndarray, shape (n_classes,)
        In their order. Counts that training lacks, between others or beyond, are never predicted.
    coef_ : ndarray, shape (n_features,)
        Weights b: a positive one means that the count grows with the feature.
    thresholds_ : ndarray, shape (n_classes - 1,)
        t_j, increasing.
    n_iter_ : int

    Notes
    -----
    With two classes this is logistic regression with C = 1/alpha. Without a penalty, the likelihood of
    separable classes has no finite maximum; the fit then ends with a warning or at a very steep solution.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.random.default_rng(0).normal(size=(300, 1))
    >>> counts = np.digitize(2 * x[:, 0] + np.random.default_rng(1).logistic(size=300), [-1, 1])
    >>> counter = OrdinalCounter(alpha=0).fit(x, counts)
    >>> counter.coef_.round(1), counter.thresholds_.round(1)
    (array([2.3]), array([-0.9,  1.1]))
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "alpha": [Interval(Real, 0, None, closed="left")],
        "max_iter": [Interval(Integral, 1, None, closed="left")],
        "tol": [Interval(Real, 0, None, closed="neither")],
    }

    _kinds: ClassVar[list[type]] = [np.float64]

    def __init__(self, alpha: float = 1.0, max_iter: int = 1000, tol: float = 1e-6) -> None:
        self.alpha = alpha
        self.max_iter = max_iter
        self.tol = tol

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Fit weights and thresholds to features.

        Arguments and errors are those of :meth:`EntropyLadder.fit`.
        """
        features, _, rank = self._labelled(X, y)
        n_features = features.shape[1]
        # Start at weights 0, where the maximum-likelihood thresholds are the logits of the shares.
        below = np.cumsum(np.bincount(rank))[:-1] / rank.size
        first = np.log(below / (1 - below))
        start = np.concatenate([np.zeros(n_features), first[:1], np.log(np.diff(first))])
        found = minimize(
            _loss,
            start,
            args=(features, rank, float(self.alpha)),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": self.max_iter, "maxfun": 20 * self.max_iter, "gtol": self.tol, "ftol": 1e-15},
        )
        if found.nit >= self.max_iter:
            warnings.warn(
                f"fit ended after max_iter={self.max_iter} steps short of tol={self.tol:g}: scale the "
                "features, or raise max_iter or alpha",
                ConvergenceWarning,
                stacklevel=2,
            )
        self.coef_ = found.x[:n_features]
        self.thresholds_ = _thresholds(found.x[n_features:])
        self.n_iter_ = int(found.nit)
        return self

    def predict_proba(self, X: ArrayLike) -> Float:
        """Probability of each class, shape (n_windows, n_classes)."""
        features = self._windows(X)
        distance = self.thresholds_ - (features @ self.coef_)[:, np.newaxis]
        at_most = expit(distance)
        # The last class from the other tail: 1 - (1 - tiny) would be 0.
        proba = np.hstack([np.diff(at_most, axis=1, prepend=0.0), expit(-distance[:, -1:])])
        return np.asarray(proba / proba.sum(axis=1, keepdims=True))


def _thresholds(parameters: Float) -> Float:
    """Return increasing thresholds from the first one and the logarithms of the steps."""
    return np.asarray(parameters[0] + np.concatenate([[0.0], np.cumsum(np.exp(parameters[1:]))]))


def _loss(parameters: Float, X: Float, rank: NDArray[Any], alpha: float) -> tuple[float, Float]:
    """Mean penalised negative log-likelihood and its gradient."""
    n, n_features = X.shape
    weights, free = parameters[:n_features], parameters[n_features:]
    # Infinite ends would give inf - inf in the differences.
    thresholds = np.concatenate([[-np.inf], _thresholds(free), [np.inf]])
    score = X @ weights
    upper, lower = thresholds[rank + 1] - score, thresholds[rank] - score
    # sigmoid(u) - sigmoid(l) = sigmoid(u) sigmoid(-l) (1 - exp(l - u)): exact in both tails
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        gap = np.where(np.isfinite(upper) & np.isfinite(lower), upper - lower, np.inf)
        log_gap = np.log(-np.expm1(-gap))
    log_p = log_expit(upper) + log_expit(-lower) + np.maximum(log_gap, -700.0)
    # d log p/du = sigmoid(-u) + 1/(exp(u - l) - 1), d log p/dl = -sigmoid(l) - the same
    with np.errstate(over="ignore", divide="ignore"):
        between = np.minimum(1.0 / np.expm1(gap), 1e12)
    by_upper = expit(-upper) + between
    by_lower = -expit(lower) - between
    gradient_score = -(by_upper + by_lower)
    n_thresholds = free.size
    of_threshold = np.bincount(rank, by_upper, minlength=n_thresholds + 1)[:-1]
    of_threshold = of_threshold + np.bincount(rank, by_lower, minlength=n_thresholds + 1)[1:]
    # Threshold j is the sum of the first one and all steps up to j.
    later = np.cumsum(of_threshold[::-1])[::-1]
    of_free = np.concatenate([later[:1], later[1:] * np.exp(free[1:])])
    gradient = np.concatenate([X.T @ gradient_score - alpha * weights, of_free])
    loss = -log_p.sum() + 0.5 * alpha * weights @ weights
    return float(loss / n), np.asarray(-gradient / n)
