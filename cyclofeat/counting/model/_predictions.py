"""Predictions of whole recordings in scikit-learn's way."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.metrics import accuracy_score

from cyclofeat.counting.estimators._counter import PoorOnArbitraryData
from cyclofeat.counting.evaluation.assembly_folds import Float, Int
from cyclofeat.counting.model.lobe_count import LobeCount
from cyclofeat.recordings import Recording

#: What ``predict`` returns for a recording that is refused.
REFUSED = -1


class RecordingPredictions(PoorOnArbitraryData, ClassifierMixin, BaseEstimator):
    """Base of classifiers of recordings, which have ``classes_`` and ``count_all``."""

    classes_: NDArray[Any]

    def count_all(self, recordings: Iterable[Recording]) -> list[LobeCount]:
        """Count and locate the worn lobes of many recordings."""
        raise NotImplementedError

    def predict(self, recordings: Iterable[Recording]) -> Int:
        """Return the number of worn lobes of each recording.

        Parameters
        ----------
        recordings : iterable of Recording

        Returns
        -------
        ndarray of int, shape (n_recordings,)
            -1 (:data:`REFUSED`) for a recording that is refused, see :attr:`LobeCount.refused`. The reason is
            in the answer of ``count_all``.

        Raises
        ------
        TypeError, ValueError
            As ``count_all``.
        """
        answers = self.count_all(recordings)
        return self._labels([REFUSED if one.refused else one.defect_count for one in answers])

    def predict_proba(self, recordings: Iterable[Recording]) -> Float:
        """Return the probability of each count for each recording.

        Parameters
        ----------
        recordings : iterable of Recording

        Returns
        -------
        ndarray, shape (n_recordings, n_classes)
            :attr:`LobeCount.probability`, columns in the order of ``classes_``. The row of a refused
            recording holds the probabilities that it would have, so that each row sums to 1; only
            :meth:`predict` and ``count_all`` say that it is refused.

        Raises
        ------
        TypeError, ValueError
            As ``count_all``.
        """
        rows = [[*one.probability.values()] for one in self.count_all(recordings)]
        return np.array(rows, dtype=np.float64).reshape(-1, len(self.classes_))

    def score(
        self,
        recordings: Sequence[Recording],
        y: ArrayLike | None = None,
        sample_weight: ArrayLike | None = None,
    ) -> float:
        """Return the share of recordings that are counted right; refused ones are not.

        Parameters
        ----------
        recordings : sequence of Recording
        y : array-like of int, shape (n_recordings,), optional
            True counts; default, the ``defect_count`` of the recordings.
        sample_weight : array-like, shape (n_recordings,), optional

        Returns
        -------
        float

        Raises
        ------
        TypeError, ValueError
            As ``count_all``, and where there is no recording or no true count.
        """
        given = list(recordings)
        if not given:
            raise ValueError("recordings must hold at least one recording, got none")
        true = y
        if true is None:
            stated = [one.defect_count for one in given if one.defect_count is not None]
            if len(stated) < len(given):
                place = next(k for k, one in enumerate(given) if one.defect_count is None)
                raise ValueError(f"recording {place} states no defect_count: give the true counts as y")
            true = self._labels(stated)
        return float(accuracy_score(true, self.predict(given), sample_weight=sample_weight))

    def _labels(self, counts: Sequence[int]) -> Int:
        """Return the labels of counts, as ``classes_`` has them."""
        return np.array(counts, dtype=np.int64)

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        return tags
