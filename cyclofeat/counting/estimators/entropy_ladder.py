"""Counter by one number per window and a ladder of thresholds, as in the papers."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import softmax
from sklearn.isotonic import IsotonicRegression

from cyclofeat._base.sklearn_private import fit_context
from cyclofeat.counting.estimators.trees import Counter
from cyclofeat.features.base import parameter
from cyclofeat.signal.windows import Float


@dataclass(eq=False, repr=False)
class EntropyLadder(Counter):
    """Count by one number per window that rises, or falls, with the number of worn lobes.

    The papers read the number of worn lobes from the Shannon entropy of the spectrum, which falls from 1 to 7
    worn lobes on their rig. Each class has a rung, the rungs are in order, and a window belongs to the
    nearest one.

    Parameters
    ----------
    column : int, default=0
        Which of the features is read; negative ones count from the end.

    Attributes
    ----------
    classes_ : ndarray, shape (n_classes,)
        In their order.
    rungs_ : ndarray, shape (n_classes,)
        Mean of the feature at each class; classes whose means are not in order share a rung.
    thresholds_ : ndarray, shape (n_classes - 1,)
        Between neighbouring classes, half way from rung to rung.
    spread_ : float
        Standard deviation of windows about the means of their classes, pooled.
    increasing_ : bool
        Whether the feature rises with the class.

    Notes
    -----
    The rungs are the isotonic regression of the feature on the class (pool adjacent violators), rising or
    falling, whichever gives the smaller sum of squares. For the probabilities, each class is a Gaussian about
    its rung with the common ``spread_``, and all classes are equally frequent. If classes share a rung, the
    first is predicted.

    Examples
    --------
    >>> ladder = EntropyLadder().fit([[4.1], [3.9], [3.1], [2.9], [1.0], [1.2]], [0, 0, 1, 1, 2, 2])
    >>> ladder.increasing_, ladder.thresholds_.round(2)
    (False, array([3.5 , 2.05]))
    >>> ladder.predict([[3.4], [2.0]])
    array([1, 2])
    """

    column: int = parameter(0, Integral)

    @fit_context(prefer_skip_nested_validation=False)
    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Place the rungs.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_features)
            Features, such as those of a :class:`~cyclofeat.features.SpectralEntropy`.
        y : array-like, shape (n_windows,)
            Classes; their order is that of ``numpy.unique``.

        Returns
        -------
        self
        """
        values, _, rank = self._labelled(X, y)
        z = self._read(values)
        size = np.bincount(rank)
        means = np.bincount(rank, z) / size
        rising, falling = (
            IsotonicRegression(increasing=up).fit_transform(np.arange(means.size), means, sample_weight=size)
            for up in (True, False)
        )
        # A tie means one rung for all classes: the direction is then irrelevant.
        self.increasing_ = bool(np.sum(size * (rising - means) ** 2) <= np.sum(size * (falling - means) ** 2))
        self.rungs_ = np.asarray(rising if self.increasing_ else falling, dtype=np.float64)
        self.thresholds_ = (self.rungs_[:-1] + self.rungs_[1:]) / 2
        freedom = max(z.size - means.size, 1)
        self.spread_ = float(np.sqrt(np.sum((z - means[rank]) ** 2) / freedom))
        return self

    def _proba(self, windows: NDArray[Any]) -> Float:
        """Return the probability of each class, by distance to the rungs."""
        z = self._read(windows)
        # Without any spread within classes the nearest rung is practically certain.
        spread = max(self.spread_, 1e-9 * float(np.ptp(self.rungs_)), np.finfo(float).tiny ** 0.25)
        return np.asarray(softmax(-0.5 * ((z[:, np.newaxis] - self.rungs_) / spread) ** 2, axis=-1))

    def _read(self, X: NDArray[Any]) -> Float:
        n_columns = X.shape[1]
        if not -n_columns <= self.column < n_columns:
            raise ValueError(f"column must be one of the {n_columns} features, got column={self.column}")
        return np.asarray(X[:, self.column], dtype=np.float64)
