"""Estimator that trains a model for whole recordings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils.validation import check_is_fitted

from cyclofeat.counting.evaluation.assembly_folds import Int
from cyclofeat.counting.model._predictions import RecordingPredictions
from cyclofeat.counting.model.lobe_count import LobeCount
from cyclofeat.counting.model.lobe_model import LobeModel
from cyclofeat.recordings import Recording


@dataclass(eq=False, repr=False)
class RecordingCounter(RecordingPredictions):
    """Classifier of recordings: :meth:`LobeModel.train` as an estimator of scikit-learn.

    ``X`` is a list of :class:`~cyclofeat.Recording` everywhere, so that ``cross_val_predict`` and its like
    split recordings; give them the assemblies as ``groups`` and a splitter that holds groups together, such
    as ``StratifiedGroupKFold``.

    Parameters
    ----------
    n_trees : int
        Trees of the counter.
    n_splits : int
        Folds of the cross-validation whose result goes on the model's card; 0 for none.
    random_state : int
        Seed of the trees.
    wear_um : (low, high), optional
        Range of radial wear in um whose depth is learned, see :meth:`LobeModel.train`.

    Attributes
    ----------
    model_ : LobeModel
        To store with :func:`cyclofeat.models.save_model`.
    classes_ : ndarray of int, shape (n_classes,)
        What ``y`` has for the counts of ``model_.classes_``.

    Examples
    --------
    >>> from sklearn.model_selection import StratifiedGroupKFold, cross_val_predict
    >>> counter = RecordingCounter(n_trees=100)
    >>> assemblies = [one.assembly for one in recordings]  # doctest: +SKIP
    >>> folds = StratifiedGroupKFold(5)
    >>> cross_val_predict(counter, recordings, counts, groups=assemblies, cv=folds)  # doctest: +SKIP
    """

    n_trees: int = 300
    n_splits: int = 0
    random_state: int = 0
    wear_um: tuple[float, float] | None = None

    def fit(self, recordings: Sequence[Recording], y: ArrayLike | None = None) -> Self:
        """Train a model.

        Parameters
        ----------
        recordings : sequence of Recording
            As for :meth:`LobeModel.train`.
        y : array-like of int, shape (n_recordings,), optional
            True counts, or other numbers for the counts that the recordings state; default, the
            ``defect_count`` of the recordings.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            As :meth:`LobeModel.train`; where ``y`` has another length than ``recordings``, or parts or joins
            what their ``defect_count`` states.
        """
        known = list(recordings)
        labels = np.array([one.defect_count for one in known]) if y is None else np.asarray(y)
        if labels.shape != (len(known),):
            raise ValueError(
                f"y must hold one count per recording, shape ({len(known)},), got shape {labels.shape}"
            )
        known = [
            one if one.defect_count is not None else one.replace(defect_count=label)
            for one, label in zip(known, labels.tolist(), strict=True)
        ]
        # cross_val_predict numbers the classes for predict_proba: other labels of the same counts.
        label_of = {one.defect_count: label for one, label in zip(known, labels.tolist(), strict=True)}
        again = [label_of[one.defect_count] for one in known]
        if again != labels.tolist() or len({*again}) < len(label_of):
            raise ValueError("y contradicts the defect_count of recordings: leave one of them out")
        self.model_ = LobeModel.train(
            known,
            n_trees=self.n_trees,
            n_splits=self.n_splits,
            random_state=self.random_state,
            wear_um=self.wear_um,
        )
        self.classes_ = np.array([label_of[count] for count in self.model_.classes_.tolist()])
        return self

    def _labels(self, counts: Sequence[int]) -> Int:
        label_of = dict(zip(self.model_.classes_.tolist(), self.classes_.tolist(), strict=True))
        return super()._labels([label_of.get(count, count) for count in counts])

    def count_all(self, recordings: Iterable[Recording]) -> list[LobeCount]:
        """Count and locate the worn lobes of many recordings, see :meth:`LobeModel.count_all`."""
        check_is_fitted(self)
        return self.model_.count_all(recordings)
