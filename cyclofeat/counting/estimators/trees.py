"""Base class of the counters, and extremely randomised trees with a fast path for few windows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import ClassifierMixin
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.utils.validation import check_is_fitted, validate_data

from cyclofeat.counting.evaluation.assembly_folds import ordered_classes
from cyclofeat.features.base import CheckedEstimator
from cyclofeat.signal.windows import Float, Int

# Kinds of numbers that windows are kept in.
_KINDS = [np.float64, np.float32]
# Paths through trees up to which scikit-learn's overhead dominates its time.
_MOST_PATHS = 50_000


class PoorOnArbitraryData:
    """Tags of classifiers of torque, whose accuracy scikit-learn cannot test on two coordinates."""

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()  # type: ignore[misc]
        tags.classifier_tags.poor_score = True
        return tags


class Counter(PoorOnArbitraryData, ClassifierMixin, CheckedEstimator):
    """Base of the counters: checked windows, classes in order; a counter states ``_proba`` of windows."""

    classes_: NDArray[Any]

    def predict(self, X: ArrayLike) -> NDArray[Any]:
        """Return the most probable class of each window, shape (n_windows,), the first one in a tie."""
        proba = self.predict_proba(X)  # raises NotFittedError before classes_ is missed
        return np.asarray(self.classes_[np.argmax(proba, axis=1)])

    def predict_proba(self, X: ArrayLike) -> Float:
        """Return the probability of each class for windows as in ``fit``, shape (n_windows, n_classes)."""
        return self._proba(self._windows(X))

    def _proba(self, windows: NDArray[Any]) -> Float:
        raise NotImplementedError

    def _labelled(self, X: ArrayLike, y: ArrayLike) -> tuple[NDArray[Any], NDArray[Any], Int]:
        """Check windows and labels, store the classes; return windows, labels and class indices."""
        windows, labels = validate_data(self, X, y, dtype=_KINDS)
        self.classes_, rank = ordered_classes(labels)
        return windows, labels, rank

    def _windows(self, X: ArrayLike) -> NDArray[Any]:
        """Return checked windows for a prediction by a fitted counter."""
        check_is_fitted(self)
        return np.asarray(validate_data(self, X, reset=False, dtype=_KINDS))


class CountingTrees(PoorOnArbitraryData, ExtraTreesClassifier):
    """Extremely randomised trees over features of windows; parameters as in scikit-learn.

    For few windows all trees are evaluated at once, level by level, because scikit-learn's overhead of some
    50 us per tree would dominate the time.
    """

    def fit(self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> Self:
        """Fit the trees, as scikit-learn does, and make their table."""
        super().fit(X, y, sample_weight=sample_weight)
        self.table_ = TreeTable.of(self) if self.n_outputs_ == 1 else None
        return self

    def __getstate__(self) -> dict[str, Any]:
        """Stack the nodes of all trees: a file of a few arrays is read much faster than one of 300 trees."""
        state: dict[str, Any] = {**super().__getstate__()}
        trees = state.pop("estimators_", None)
        if trees:
            state.pop("table_", None)
            parts = [tree.tree_.__getstate__() for tree in trees]
            state["first_tree"] = trees[0]
            state["stacked_trees"] = {
                "seeds": np.array([tree.random_state for tree in trees]),
                "max_depths": np.array([part["max_depth"] for part in parts]),
                "node_counts": np.array([part["node_count"] for part in parts]),
                "nodes": np.concatenate([part["nodes"] for part in parts]),
                "values": np.concatenate([part["values"] for part in parts]),
            }
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        stacked, first = state.pop("stacked_trees", None), state.pop("first_tree", None)
        super().__setstate__(state)
        if stacked is not None:
            # The first tree has what all of them share.
            kind, arguments, _ = first.tree_.__reduce__()
            ends = np.cumsum(stacked["node_counts"])[:-1]
            nodes, values = np.split(stacked["nodes"], ends), np.split(stacked["values"], ends)
            self.estimators_ = []
            for seed, depth, own_nodes, own_values in zip(
                stacked["seeds"].tolist(), stacked["max_depths"].tolist(), nodes, values, strict=True
            ):
                tree = object.__new__(type(first))
                vars(tree).update(vars(first), random_state=seed, tree_=kind(*arguments))
                stored = {"max_depth": depth, "node_count": len(own_nodes), "nodes": own_nodes}
                tree.tree_.__setstate__(stored | {"values": own_values})
                self.estimators_.append(tree)
        if hasattr(self, "estimators_"):
            self.table_ = TreeTable.of(self) if self.n_outputs_ == 1 else None

    def predict_proba(self, X: ArrayLike) -> Any:
        """Return the probabilities of scikit-learn, except for rounding."""
        check_is_fitted(self)
        features = validate_data(self, X, reset=False, dtype=np.float32)
        if self.table_ is None or len(features) * len(self.estimators_) > _MOST_PATHS:
            return super().predict_proba(X)
        return self.table_.predict_proba(features)


@dataclass(frozen=True)
class TreeTable:
    """All nodes of all trees in one table; a leaf is its own child."""

    roots: NDArray[np.int32]  # (n_trees,)
    feature: NDArray[np.int32]  # (n_nodes,)
    # Rounded down, so that float32 features fall on the side on which they fall in double precision.
    threshold: NDArray[np.float32]
    lower: NDArray[np.int32]  # children for values up to the threshold
    upper: NDArray[np.int32]  # and above it
    share: NDArray[np.float64]  # (n_nodes, n_classes)

    @classmethod
    def of(cls, forest: ExtraTreesClassifier) -> TreeTable:
        trees = [estimator.tree_ for estimator in forest.estimators_]
        roots = np.cumsum([0, *(tree.node_count for tree in trees)])[:-1]
        starts = np.repeat(roots, [tree.node_count for tree in trees])
        nodes = np.arange(starts.size)
        lower = np.concatenate([tree.children_left for tree in trees])
        upper = np.concatenate([tree.children_right for tree in trees])
        exact = np.concatenate([tree.threshold for tree in trees])
        rounded = exact.astype(np.float32)
        rounded = np.where(rounded > exact, np.nextafter(rounded, np.float32(-np.inf)), rounded)
        values = np.concatenate([tree.value[:, 0] for tree in trees])
        return cls(
            roots=roots.astype(np.int32),
            feature=np.maximum(np.concatenate([tree.feature for tree in trees]), 0).astype(np.int32),
            threshold=rounded.astype(np.float32),
            lower=np.where(lower < 0, nodes, lower + starts).astype(np.int32),
            upper=np.where(upper < 0, nodes, upper + starts).astype(np.int32),
            share=values / values.sum(axis=1, keepdims=True),
        )

    def predict_proba(self, X: NDArray[np.float32]) -> NDArray[np.float64]:
        """Mean over trees of the shares in the leaves, shape (n_windows, n_classes)."""
        n_windows, n_features = X.shape
        values = X.ravel()
        node = reached = np.tile(self.roots, n_windows)
        path = np.arange(reached.size)
        first = path // self.roots.size * n_features  # of the window's features
        while path.size:
            below = values.take(first + self.feature.take(node)) <= self.threshold.take(node)
            following = np.where(below, self.lower.take(node), self.upper.take(node))
            on = np.flatnonzero(following != node)  # the others are in their leaves
            path, first, node = path.take(on), first.take(on), following.take(on)
            reached[path] = node
        shares = self.share.take(reached, axis=0).reshape(n_windows, self.roots.size, -1)
        return np.asarray(shares.mean(axis=1))
