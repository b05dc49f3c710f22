"""Regression with intervals of a chosen coverage."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import RegressorMixin
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.model_selection import GroupKFold
from sklearn.utils.validation import check_is_fitted, validate_data

from cyclofeat._base.sklearn_private import Interval, fit_context
from cyclofeat.counting.evaluation.assembly_folds import assemblies_of, drawn_seed
from cyclofeat.features.base import CheckedEstimator, at_least, parameter
from cyclofeat.signal.windows import Float, Int

# Added to the spread of the trees, as a share of its median: an error is never sure to be nothing.
_LEAST_SPREAD = 0.25


@dataclass(eq=False, repr=False)
class ConformalRegressor(RegressorMixin, CheckedEstimator):
    """Extremely randomised trees that predict a number with an interval of a chosen coverage.

    Every assembly is predicted by trees that have not seen it (cross-conformal prediction; Vovk, Cross-
    conformal predictors, 2015). The error of each prediction is divided by the spread of the trees'
    predictions, and the interval is that spread times the quantile of these ratios: wide where trees
    disagree (Papadopoulos et al., Normalized nonconformity measures, 2008). The *assembly* is the unit. The
    coverage holds to good approximation, without a guarantee, and on average over all values, not for each.

    Half the interval is ``ratio_`` times the trees' spread plus ``least_spread_``; infinite where assemblies
    are too few. ``held_out_`` are predictions of the training's ``values_`` by trees that have not seen their
    assembly, NaN where there is only one.
    """

    n_trees: int = parameter(300, at_least(2))
    # Share of new assemblies whose interval holds the true value.
    coverage: float = parameter(0.9, Interval(Real, 0, 1, closed="neither"))
    n_splits: int = parameter(5, at_least(2))  # folds by assembly, no more than there are assemblies
    random_state: int | None = parameter(0, "random_state")

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X: ArrayLike, y: ArrayLike, groups: ArrayLike | None = None) -> Self:
        """Fit to values ``y`` of samples; ``groups`` are their assemblies, by default each its own."""
        features, values = validate_data(self, X, y, dtype=np.float64, y_numeric=True)
        values = np.asarray(values, dtype=np.float64)
        member = assemblies_of(groups, len(features))
        seed = drawn_seed(self.random_state)
        spread = np.full(len(values), np.nan)
        self.held_out_: Float = np.full(len(values), np.nan)
        n_folds = min(self.n_splits, np.unique(member).size)
        if n_folds > 1:
            folds = GroupKFold(n_folds, shuffle=True, random_state=seed)
            for train, test in folds.split(features, values, member):
                trees = self._trees(seed).fit(features[train], values[train])
                self.held_out_[test], spread[test] = _mean_and_spread(trees, features[test])
        self.values_ = values
        self.trees_ = self._trees(seed).fit(features, values)
        self.least_spread_, self.ratio_ = 0.0, float("inf")
        if np.isfinite(spread).all():
            # Values that are all alike have no spread.
            self.least_spread_ = max(_LEAST_SPREAD * float(np.median(spread)), np.finfo(float).tiny)
            ratio = np.abs(values - self.held_out_) / (spread + self.least_spread_)
            self.ratio_ = conformal_threshold(ratio, member, self.coverage)
        return self

    def _trees(self, seed: int) -> ExtraTreesRegressor:
        return ExtraTreesRegressor(self.n_trees, max_features=0.3, min_samples_leaf=2, random_state=seed)

    def predict(self, X: ArrayLike) -> Float:
        """Return the predicted value of each sample, shape (n_samples,)."""
        return self._predicted(X)[0]

    def predict_interval(self, X: ArrayLike) -> tuple[Float, Float]:
        """Return the lower and the upper end of the interval of each sample, shape (n_samples,) each."""
        mean, spread = self._predicted(X)
        width = self.ratio_ * (spread + self.least_spread_)
        return mean - width, mean + width

    def _predicted(self, X: ArrayLike) -> tuple[Float, Float]:
        check_is_fitted(self)
        features: NDArray[Any] = validate_data(self, X, reset=False, dtype=np.float64)
        return _mean_and_spread(self.trees_, features)


def conformal_threshold(scores: Float, member: Int, coverage: float) -> float:
    """Return the quantile of scores at ``coverage``, where each assembly weighs 1.

    Each of the G calibration assemblies has the mass 1/(G + 1), shared evenly by its samples; infinity has
    the same mass. The coverage is then at least ``coverage`` (Lee, Barber and Willett, arXiv:2306.06342).
    """
    _, which, size = np.unique(member, return_inverse=True, return_counts=True)
    order = np.argsort(scores, kind="stable")
    reached = np.cumsum((1.0 / size[which])[order]) >= coverage * (size.size + 1) - 1e-9
    return float(scores[order][np.argmax(reached)]) if reached.any() else float("inf")


def _mean_and_spread(trees: ExtraTreesRegressor, X: NDArray[Any]) -> tuple[Float, Float]:
    """Return mean and standard deviation of the trees' predictions, shape (n_samples,) each."""
    # As the forest does, which would otherwise check them again for each tree.
    features = np.asarray(X, dtype=np.float32)
    answers = np.stack([tree.predict(features, check_input=False) for tree in trees.estimators_])
    return answers.mean(axis=0), answers.std(axis=0)
