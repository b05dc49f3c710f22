"""Domain of training windows, outside which a counter refuses."""

from __future__ import annotations

import re
from dataclasses import KW_ONLY, dataclass
from numbers import Real
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.covariance import LedoitWolf
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import check_is_fitted, validate_data

from cyclofeat._base.sklearn_private import Interval, fit_context
from cyclofeat.counting.evaluation.assembly_folds import assemblies_of, drawn_seed, grouped_folds, of_windows
from cyclofeat.features import LobeMap
from cyclofeat.features.base import CheckedEstimator, at_least, parameter
from cyclofeat.signal.windows import Float, Int

# Values from which slots, prominence and contrast of lines count (assumption): lower lines are as absent.
_ABSENT_DB = [-np.inf, 0.0, -5.0]
# Line or slot in the name of a feature of the lobe map.
_NUMBERED = re.compile(r"\((k|slot)(\d+)")


@dataclass(eq=False, repr=False)
class TrainingDomain(CheckedEstimator):
    """Domain of the training windows in the space of their features.

    A window's distance to a class is the Mahalanobis distance to its mean, with the covariance about all
    class means, shrunk (Ledoit and Wolf, J. Multivariate Anal. 88 (2004) 365), in units of the largest
    distance to this class inside the domain. A window is outside if it is farther than 1 from every class.

    Parameters
    ----------
    lowest : array-like, shape (n_features,), optional
        Lower values of the features count as these, so that a machine that is quieter than those in training
        is not outside for that. Default: all values count.
    false_refusal : float, default=0.03
        Share of assemblies like those in training of which at least one window is called outside.
    n_splits : int, default=5
        Folds by assembly in which distances of held-out assemblies are taken.
    random_state : int or None, default=0
        Seed of the folds.

    Attributes
    ----------
    thresholds_ : ndarray, shape (n_classes,)
        Largest Mahalanobis distance to each class inside the domain.
    false_refusal_ : float
        Share that n assemblies can guarantee: ``false_refusal``, or 1/(n + 1) with few of them.

    Notes
    -----
    Each class has its own spread, the root mean square distance of its training windows, each measured while
    its assembly is held out: features of sound discs scatter more than those of worn ones. Thresholds are t
    times the spreads, where t is the k-th smallest of the n assemblies' largest held-out distances in
    spreads of the nearest class, k = ceil((1 - false_refusal)(n + 1)). A new assembly that is exchangeable
    with them and has as many windows lies outside with a probability of about ``false_refusal_``, and of at
    most that if the spreads are known. A window inside the domain can still be counted wrong.

    Examples
    --------
    >>> import numpy as np
    >>> X = np.random.default_rng(0).normal(size=(100, 2))
    >>> domain = TrainingDomain().fit(X)
    >>> domain.distance([[0.0, 0.5], [6.0, 0.0]]) > 1
    array([False,  True])
    """

    lowest: ArrayLike | None = parameter(
        None, "array-like", None
    )  # of models saved before there was one, too
    _: KW_ONLY
    false_refusal: float = parameter(0.03, Interval(Real, 0, 1, closed="neither"))
    n_splits: int = parameter(5, at_least(2))
    random_state: int | None = parameter(0, "random_state")

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X: ArrayLike, y: ArrayLike | None = None, groups: ArrayLike | None = None) -> Self:
        """Learn the domain of training windows.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_features)
            Features, best those that the counter sees.
        y : array-like, shape (n_windows,), optional
            Classes. Without them all windows are one cloud.
        groups : array-like, shape (n_windows,), optional
            Assembly of each window. Without groups every window counts as one assembly.

        Returns
        -------
        self
        """
        features: Float = validate_data(self, X, dtype=np.float64, ensure_min_samples=2)
        if self.lowest is not None and np.shape(self.lowest) != (features.shape[1],):
            raise ValueError(
                f"lowest must hold one value per feature, shape ({features.shape[1]},), got shape "
                f"{np.shape(self.lowest)}"
            )
        features = self._raise_lowest(features)
        n_windows = len(features)
        member = assemblies_of(groups, n_windows)
        n_assemblies = int(member.max()) + 1
        if n_assemblies < 2:
            raise ValueError("groups must name at least 2 assemblies, got 1: nothing can be held out")
        rank: Int = np.zeros(n_windows, dtype=np.int64)
        if y is not None:
            rank = np.asarray(np.unique(of_windows("y", y, n_windows), return_inverse=True)[1])
        seed = drawn_seed(self.random_state)
        # If a class has a single assembly, the folds ignore the classes.
        folds = grouped_folds(rank, member, self.n_splits, seed)
        folds = folds or grouped_folds(np.zeros_like(rank), member, self.n_splits, seed)
        held_out: Float = np.full((n_windows, int(rank.max()) + 1), np.inf)
        for train, test in folds:
            present = self._place(features[train], rank[train])
            held_out[np.ix_(test, present)] = self._mahalanobis(features[test])
        # Root mean square distance of each class's windows to it.
        own = held_out[np.arange(n_windows), rank]
        # A class of a single assembly is absent where that is held out.
        squares = np.where(np.isfinite(own), own, held_out.min(axis=1)) ** 2
        spreads = np.sqrt(np.bincount(rank, squares) / np.bincount(rank))
        # Without a spread of its own, as of equal windows, a class has that of all.
        spreads = np.where(spreads > 0, spreads, np.sqrt(squares.mean()) or 1.0)
        farthest = np.zeros(n_assemblies)
        np.maximum.at(farthest, member, (held_out / spreads).min(axis=1))
        k = min(int(np.ceil((1 - self.false_refusal) * (n_assemblies + 1) - 1e-9)), n_assemblies)
        self._place(features, rank)
        self.thresholds_ = np.maximum(np.sort(farthest)[k - 1] * spreads, np.finfo(float).tiny)
        self.false_refusal_ = max(float(self.false_refusal), 1 - n_assemblies / (n_assemblies + 1))
        return self

    def _place(self, X: Float, rank: Int) -> Int:
        """Learn means and covariance; return the ranks that are present."""
        self.location_ = X.mean(axis=0)
        spread = X.std(axis=0)
        # A constant feature is not scaled: its changes then count in its own unit.
        self.scale_ = np.where(spread > 1e-12 * np.maximum(np.abs(self.location_), 1e-300), spread, 1.0)
        scaled = (X - self.location_) / self.scale_
        present, which = np.unique(rank, return_inverse=True)
        self.means_ = np.stack([scaled[which == c].mean(axis=0) for c in range(present.size)])
        residual = scaled - self.means_[which]
        self.precision_ = np.eye(X.shape[1])
        if np.any(residual):
            self.precision_ = np.asarray(LedoitWolf(assume_centered=True).fit(residual).precision_)
        return np.asarray(present)

    def _raise_lowest(self, X: Float) -> Float:
        return X if self.lowest is None else np.maximum(X, self.lowest)

    def _mahalanobis(self, X: Float) -> Float:
        offset = ((X - self.location_) / self.scale_)[:, np.newaxis] - self.means_
        squared = np.einsum("nci,ij,ncj->nc", offset, self.precision_, offset, optimize=True)
        return np.asarray(np.sqrt(np.maximum(squared, 0.0)))

    def _class_distances(self, X: ArrayLike) -> Float:
        """Return the distance to each class in units of the largest inside, shape (n_windows, n_classes)."""
        check_is_fitted(self)
        features: Float = validate_data(self, X, reset=False, dtype=np.float64)
        return np.asarray(self._mahalanobis(self._raise_lowest(features)) / self.thresholds_)

    def _rank_unlike(self, X: ArrayLike) -> Int:
        """Return the features of each window by their shares in its squared distance, the largest first."""
        nearest = self.means_[self._class_distances(X).argmin(axis=1)]
        offset = (self._raise_lowest(np.asarray(X)) - self.location_) / self.scale_ - nearest
        return np.asarray(np.argsort(-offset * (offset @ self.precision_), axis=1))

    def distance(self, X: ArrayLike) -> Float:
        """Return the distance to the nearest class, in units of the largest distance to it inside the domain.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_features)

        Returns
        -------
        ndarray, shape (n_windows,)
        """
        return np.asarray(self._class_distances(X).min(axis=1))


def lowest_seen(counter: Any) -> Float | None:
    """Return the values below which lobe lines are absent, of a fitted counter of a lobe map; else None."""
    lobe_map = _features_of(counter)
    if not isinstance(lobe_map, LobeMap):
        return None
    return np.repeat(_ABSENT_DB, [2 * lobe_map.n_lobes, lobe_map.n_lines, lobe_map.n_lines])


def feature_words(counter: Any, n_features: int) -> list[str]:
    """Return each feature that a fitted counter sees in words."""
    lobe_map = _features_of(counter)
    if not isinstance(lobe_map, LobeMap):
        return [f"feature {number}" for number in range(n_features)]
    numbers = _NUMBERED.findall(" ".join(lobe_map.get_feature_names_out()))
    return [f"lobe line {int(at)}" if kind == "k" else f"lobe slot {int(at) + 1}" for kind, at in numbers]


def _features_of(counter: Any) -> Any:
    """Return what turns windows into the features of a fitted counter; None if it takes them as they are."""
    inner = getattr(counter, "counter_", None)
    if inner is not None:
        return _features_of(inner)
    if isinstance(counter, Pipeline) and len(counter) > 1:
        return counter[0] if len(counter) == 2 else counter[:-1]
    return getattr(counter, "lobe_map_", None)


def features_seen(counter: Any, X: NDArray[Any]) -> Float:
    """Return the features that a fitted counter uses, or the windows if it has no step for features."""
    features = _features_of(counter)
    return np.asarray(X if features is None else features.transform(X))
