"""Extremely randomised trees that answer about a few windows without a call per tree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import issparse
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.utils.validation import check_is_fitted, validate_data

# Paths through trees up to which scikit-learn's overhead outweighs its faster loop.
_MOST_PATHS = 200_000


class CountingTrees(ExtraTreesClassifier):
    """Extremely randomised trees over features of windows; parameters as in scikit-learn.

    Of a few windows all trees are asked in one compiled loop: scikit-learn's overhead of some 80 us per tree
    would be most of what a single window costs.

    Says of itself that it scores poorly on arbitrary data, so that scikit-learn's conformance suite does not
    ask it to tell clouds of points with two coordinates apart, of which no lobe map can be made.
    """

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.classifier_tags.poor_score = True
        return tags

    def fit(self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> Self:
        """As in scikit-learn."""
        super().fit(X, y, sample_weight=sample_weight)
        self.side_by_side_ = _SideBySide.of(self) if self.n_outputs_ == 1 else None
        return self

    def predict_proba(self, X: ArrayLike) -> Any:
        """As in scikit-learn, equal but for rounding."""
        check_is_fitted(self)
        together = self.side_by_side_
        if together is None or issparse(X):
            return super().predict_proba(X)
        features = validate_data(self, X, reset=False, dtype=np.float32, ensure_all_finite=False)
        few = len(features) * len(self.estimators_) <= _MOST_PATHS
        # those that are not finite are refused, or sent the way of missing values
        if not few or not np.isfinite(features).all():
            return super().predict_proba(X)
        return together.predict_proba(features)


@dataclass(frozen=True)
class _SideBySide:
    """All nodes of all trees in one table; a leaf is its own child.

    Attributes
    ----------
    roots : ndarray of int, shape (n_trees,)
    feature : ndarray of int, shape (n_nodes,)
    threshold : ndarray of float32, shape (n_nodes,)
        Rounded down, so that float32 features fall on the side on which they fall in double precision.
    left, right : ndarray of int, shape (n_nodes,)
    share : ndarray of float32, shape (n_nodes, n_classes)
    """

    roots: NDArray[np.int32]
    feature: NDArray[np.int32]
    threshold: NDArray[np.float32]
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    share: NDArray[np.float64]

    @classmethod
    def of(cls, forest: ExtraTreesClassifier) -> _SideBySide:
        trees = [estimator.tree_ for estimator in forest.estimators_]
        roots = np.cumsum([0, *(tree.node_count for tree in trees)])[:-1]
        left, right = (
            np.concatenate(
                [
                    np.where(getattr(tree, side) < 0, np.arange(tree.node_count), getattr(tree, side)) + root
                    for tree, root in zip(trees, roots, strict=True)
                ]
            )
            for side in ("children_left", "children_right")
        )
        exact = np.concatenate([tree.threshold for tree in trees])
        rounded = exact.astype(np.float32)
        rounded = np.where(rounded > exact, np.nextafter(rounded, np.float32(-np.inf)), rounded)
        values = np.concatenate([tree.value[:, 0] for tree in trees])
        return cls(
            roots=roots.astype(np.int32),
            feature=np.maximum(np.concatenate([tree.feature for tree in trees]), 0).astype(np.int32),
            threshold=rounded.astype(np.float32),
            left=left.astype(np.int32),
            right=right.astype(np.int32),
            share=values / values.sum(axis=1, keepdims=True),
        )

    def predict_proba(self, X: NDArray[np.float32]) -> NDArray[np.float64]:
        """Mean over trees of the shares in the leaves, shape (n_windows, n_classes)."""
        return np.asarray(
            _mean_share(X, self.roots, self.feature, self.threshold, self.left, self.right, self.share)
        )


def _compiled(function: Callable[..., Any]) -> Any:
    """Compiled at its first call, and kept on disk where a folder can be written."""
    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:
        return numba.njit(nogil=True)(function)


@_compiled
def _mean_share(
    X: NDArray[np.float32],
    roots: NDArray[np.int32],
    feature: NDArray[np.int32],
    threshold: NDArray[np.float32],
    left: NDArray[np.int32],
    right: NDArray[np.int32],
    share: NDArray[np.float64],
) -> NDArray[np.float64]:
    mean = np.zeros((X.shape[0], share.shape[1]))
    for root in roots:  # all windows through one tree, while it is in the processor's cache
        for i in range(X.shape[0]):
            node = root
            while left[node] != node:
                node = left[node] if X[i, feature[node]] <= threshold[node] else right[node]
            mean[i] += share[node]
    return mean / roots.size
