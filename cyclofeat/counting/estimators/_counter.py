"""Base class of the counters."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from cyclofeat.counting.evaluation.assembly_folds import Int, ordered_classes


class PoorOnArbitraryData:
    """Tags of classifiers of torque, whose accuracy scikit-learn cannot test on two coordinates."""

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()  # type: ignore[misc]
        tags.classifier_tags.poor_score = True
        return tags


class Counter(PoorOnArbitraryData, ClassifierMixin, BaseEstimator):
    """Base of the counters: ``predict`` from ``predict_proba``, checked windows, classes in order."""

    classes_: NDArray[Any]
    # Kinds of numbers that windows are kept in.
    _kinds: ClassVar[list[type]] = [np.float64, np.float32]

    def predict(self, X: ArrayLike) -> NDArray[Any]:
        """Return the most probable class of each window, shape (n_windows,), the first one in a tie."""
        proba = self.predict_proba(X)  # raises NotFittedError before classes_ is missed
        return np.asarray(self.classes_[np.argmax(proba, axis=1)])

    def _labelled(self, X: ArrayLike, y: ArrayLike) -> tuple[NDArray[Any], NDArray[Any], Int]:
        """Check windows and labels, store the classes; return windows, labels and class indices."""
        windows, labels = validate_data(self, X, y, dtype=self._kinds)
        self.classes_, rank = ordered_classes(labels)
        return windows, labels, rank

    def _windows(self, X: ArrayLike) -> NDArray[Any]:
        """Return checked windows for a prediction by a fitted counter."""
        check_is_fitted(self)
        return np.asarray(validate_data(self, X, reset=False, dtype=self._kinds))
