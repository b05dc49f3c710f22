"""Classifier of one effect's presence and regressors of one parameter's quantiles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.calibration import CalibratedClassifierCV
from sklearn.ensemble import HistGradientBoostingClassifier, HistGradientBoostingRegressor
from sklearn.model_selection import GroupKFold
from sklearn.pipeline import make_pipeline

Float = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Quantiles of a size; the outer and the inner pair are corrected by split conformal prediction.
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_FOLDS = 3
_FEWEST = 20  # machines with an effect from which it is learned
_CALIBRATING = 0.25  # share of the rigs that corrects the intervals


class Screening(TransformerMixin, BaseEstimator):
    """Choose the columns that follow a target most, or whose distance from their median does.

    Trees could choose by themselves; from a fifth of the columns they do so in a fifth of the time. The
    distance finds columns that an effect of either sign moves to either side.
    """

    def __init__(self, n_columns: int = 300) -> None:
        self.n_columns = n_columns

    def fit(self, X: Float, y: NDArray[Any]) -> Screening:
        target = np.asarray(y, dtype=float) - np.mean(y)
        scores = [_correlation(x, target) for x in (X, np.abs(X - np.median(X, axis=0)))]
        self.columns_ = np.sort(np.argsort(-np.maximum(*scores), kind="stable")[: self.n_columns])
        return self

    def transform(self, X: Float) -> Float:
        return X[:, self.columns_]


def _correlation(X: Float, target: Float) -> Float:
    """Return the size of the correlation of each column with a centred target; 0 for a constant column."""
    centred = X - X.mean(axis=0)
    norm = np.linalg.norm(centred, axis=0) * np.linalg.norm(target)
    return np.asarray(np.abs(target @ centred) / np.where(norm > 0, norm, np.inf))


def fit_presence(X: Float, present: Flags, groups: NDArray[Any], max_iter: int, random_state: int) -> Any:
    """Fit a calibrated classifier; rows of one group stay in one fold."""
    trees = HistGradientBoostingClassifier(
        max_iter=max_iter, learning_rate=0.08, max_leaf_nodes=6, min_samples_leaf=10, l2_regularization=1.0,
        max_features=0.3, random_state=random_state,
    )  # fmt: skip
    folds = list(GroupKFold(_FOLDS).split(X, present, groups))
    return CalibratedClassifierCV(make_pipeline(Screening(), trees), cv=folds).fit(X, present)


class SizeRegressor(BaseEstimator):
    """Quantiles of a parameter, corrected by split conformal prediction (Romano et al. 2019).

    Attributes
    ----------
    models_ : list of estimator
        One for each of ``QUANTILES``.
    margins_ : ndarray, shape (2,)
        What the outer and the inner interval are widened by.
    """

    def __init__(self, max_iter: int = 100, random_state: int = 0) -> None:
        self.max_iter = max_iter
        self.random_state = random_state

    def fit(self, X: Float, y: Float, groups: NDArray[Any]) -> SizeRegressor:
        names = np.unique(groups)
        random = np.random.default_rng(self.random_state)
        calibrating = np.isin(groups, random.choice(names, round(_CALIBRATING * names.size), replace=False))
        self.models_ = [self._model(share).fit(X[~calibrating], y[~calibrating]) for share in QUANTILES]
        predicted = self._uncorrected(X[calibrating])
        self.margins_ = np.array(
            [
                _margin(predicted[:, [k, -1 - k]], y[calibrating], QUANTILES[-1 - k] - QUANTILES[k])
                for k in range(len(QUANTILES) // 2)
            ]
        )
        return self

    def predict(self, X: Float) -> Float:
        """Return the quantiles, shape (n, 5), increasing."""
        shift = np.r_[-self.margins_, 0.0, self.margins_[::-1]]
        return np.sort(self._uncorrected(X) + shift, axis=1)

    def _uncorrected(self, X: Float) -> Float:
        return np.sort(np.column_stack([model.predict(X) for model in self.models_]), axis=1)

    def _model(self, share: float) -> Any:
        trees = HistGradientBoostingRegressor(
            loss="quantile", quantile=share, max_iter=self.max_iter, learning_rate=0.08, max_leaf_nodes=8,
            min_samples_leaf=10, random_state=self.random_state,
        )  # fmt: skip
        return make_pipeline(Screening(100), trees)


def _margin(interval: Float, y: Float, share: float) -> float:
    """Return the margin by which intervals hold at least ``share`` of the values, as of new ones."""
    outside = np.sort(np.maximum(interval[:, 0] - y, y - interval[:, 1]))
    rank = min(int(np.ceil(share * (y.size + 1))), y.size)
    return float(outside[rank - 1])


def enough(groups: NDArray[Any]) -> bool:
    """Return True if an effect can be learned from rows of these machines."""
    return np.unique(groups).size >= _FEWEST
