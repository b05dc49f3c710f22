"""Sets of counts with a chosen coverage, and their refusals."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, clone
from sklearn.pipeline import Pipeline

from cyclofeat._base.sklearn_private import Interval, StrOptions, fit_context
from cyclofeat.counting.calibration.training_domain import TrainingDomain
from cyclofeat.counting.estimators._counter import Counter
from cyclofeat.counting.evaluation.assembly_folds import (
    Float,
    Int,
    aligned_proba,
    assemblies_of,
    drawn_seed,
    fit_clone,
    grouped_folds,
    held_out_proba,
)

Bool = NDArray[np.bool_]

OUTSIDE = "outside the training data"
NO_CLASS = "no count fits"


@dataclass(frozen=True)
class CountSet:
    """Answer of :meth:`ConformalCounter.predict_counts` for one window.

    Attributes
    ----------
    counts : tuple
        Counts that cannot be excluded at the coverage asked for; empty if refused.
    refused : bool
    reason : str
        Why refused, else empty.
    distance : float
        From the training windows, in units of the largest distance inside; NaN without a domain.
    """

    counts: tuple[Any, ...]
    refused: bool
    reason: str
    distance: float

    def __str__(self) -> str:
        return f"refused: {self.reason}" if self.refused else "{" + ", ".join(map(str, self.counts)) + "}"


@dataclass(eq=False, repr=False)
class ConformalCounter(Counter):
    """Counter that answers with a set of counts and refuses windows unlike its training.

    A class belongs to the set unless its probability is lower than what the true class had in all but a share
    ``1 - coverage`` of calibration assemblies (conformal prediction; Vovk, Gammerman and Shafer, Algorithmic
    Learning in a Random World, 2005). The *assembly* is the unit: windows of one assembly are no replicates.

    Parameters
    ----------
    counter : classifier
        With ``predict_proba``; cloned, not changed.
    coverage : float, default=0.9
        Share of new windows (or assemblies, see ``unit``) whose set holds the true count.
    per_class : bool, default=False
        Whether each class has its own threshold (Mondrian): coverage then holds for each class, not only
        over all. It takes at least coverage/(1 - coverage) calibration assemblies per class, 9 for 0.9; a
        class with fewer is in every set.
    method : {"split", "cross"}, default="split"
        ``"split"``: some assemblies calibrate and do not train; the coverage is guaranteed. ``"cross"``:
        every assembly calibrates with what a counter says that has not seen it, and the counter is then
        fitted to all; no assembly is lost, and the coverage holds to good approximation, without a guarantee.
    nonconformity : {"lac", "aps"}, default="lac"
        How little a class fits: ``"lac"``: 1 - its probability; the smallest sets, which may be empty.
        ``"aps"``: the sum of the probabilities down to its own; never empty, more even over hard and easy
        windows.
    unit : {"window", "assembly"}, default="window"
        What coverage counts. ``"window"``: one window of a new assembly. ``"assembly"``: all windows of a new
        assembly at once (with as many windows as those in calibration); its score is its worst window's.
    calibration_size : float, default=0.3
        Share of assemblies that calibrate, for ``"split"``: one fold of 1/size, rounded, or of as many as
        the rarest class has assemblies.
    n_splits : int, default=5
        Folds by assembly, for ``"cross"``.
    domain : TrainingDomain, "default" or None, default="default"
        What is outside; cloned, not changed. ``"default"``: ``TrainingDomain()``. None: nothing is.
    random_state : int or None, default=0
        Seed of the split.

    Attributes
    ----------
    classes_ : ndarray, shape (n_classes,)
    counter_ : classifier
    domain_ : TrainingDomain or None
        Fitted to the features that ``counter_`` sees.
    thresholds_ : ndarray, shape (n_classes,)
        Largest score within a set; infinite where calibration assemblies are too few.
    n_calibration_ : ndarray of int, shape (n_classes,)
        Calibration assemblies of each class.

    Notes
    -----
    *Threshold.* Each of the G calibration assemblies has the mass 1/(G + 1), shared evenly by its windows;
    infinity has the same mass. The threshold is the quantile of that distribution at ``coverage``. The
    coverage is then at least ``coverage`` (Lee, Barber and Willett, arXiv:2306.06342).

    *Refusals* are empty sets. They count as misses: over windows like those in training, coverage can fall
    short by as much as ``domain.false_refusal``. ``predict`` and ``predict_proba`` of a refused window are
    those of the counter and are not reliable.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.naive_bayes import GaussianNB
    >>> random = np.random.default_rng(0)
    >>> counts = np.tile([0, 1, 2], 60)
    >>> X = counts[:, np.newaxis] + random.normal(scale=0.5, size=(180, 2))
    >>> counter = ConformalCounter(GaussianNB(), coverage=0.95).fit(X, counts)
    >>> for answer in counter.predict_counts([[1.0, 1.0], [0.5, 0.5], [9.0, -9.0]]):
    ...     print(answer)
    {1}
    {0, 1}
    refused: outside the training data
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "counter": [BaseEstimator],
        "coverage": [Interval(Real, 0, 1, closed="neither")],
        "per_class": ["boolean"],
        "method": [StrOptions({"split", "cross"})],
        "nonconformity": [StrOptions({"lac", "aps"})],
        "unit": [StrOptions({"window", "assembly"})],
        "calibration_size": [Interval(Real, 0, 0.5, closed="right")],
        "n_splits": [Interval(Integral, 2, None, closed="left")],
        "domain": [TrainingDomain, StrOptions({"default"}), None],
        "random_state": ["random_state"],
    }

    counter: Any
    coverage: float = 0.9
    per_class: bool = False
    method: str = "split"
    nonconformity: str = "lac"
    unit: str = "window"
    calibration_size: float = 0.3
    n_splits: int = 5
    domain: TrainingDomain | str | None = "default"
    random_state: int | None = 0

    @fit_context(prefer_skip_nested_validation=False)
    def fit(self, X: ArrayLike, y: ArrayLike, groups: ArrayLike | None = None) -> Self:
        """Fit the counter, the thresholds and the domain.

        Arguments and errors are those of :meth:`GroupCalibratedCounter.fit`. Where windows share an assembly
        and ``groups`` are not given, sets are too small.
        """
        windows, labels, rank = self._labelled(X, y)
        member = assemblies_of(groups, len(windows))
        seed = drawn_seed(self.random_state)
        proba = self._calibrate(windows, labels, rank, member, seed)
        held_out: Bool = np.asarray(np.isfinite(proba).all(axis=1))
        scores = np.full(len(labels), np.nan)
        scores[held_out] = self._scores(proba[held_out])[np.arange(held_out.sum()), rank[held_out]]
        self._set_thresholds(scores, rank, member, held_out)
        self.domain_ = None
        if self.domain is not None and np.unique(member).size > 1:
            domain = TrainingDomain() if isinstance(self.domain, str) else clone(self.domain)
            self.domain_ = domain.fit(features_seen(self.counter_, windows), rank, member)
        return self

    def _calibrate(self, X: NDArray[Any], y: NDArray[Any], rank: Int, member: Int, seed: int) -> Float:
        """Fit ``counter_`` and return probabilities of windows held out from it, NaN for the others."""
        proba = np.full((len(y), self.classes_.size), np.nan)
        n_splits = self.n_splits if self.method == "cross" else max(round(1 / self.calibration_size), 2)
        folds = grouped_folds(rank, member, n_splits, seed)
        if folds and self.method == "split":
            train, test = folds[0]
            self.counter_ = fit_clone(self.counter, X[train], y[train], groups=member[train])
            proba[test] = aligned_proba(self.counter_, X[test], self.classes_)
            return proba
        self.counter_ = fit_clone(self.counter, X, y, groups=member)
        return held_out_proba(self.counter, X, y, member, self.classes_, folds) if folds else proba

    def _set_thresholds(self, scores: Float, rank: Int, member: Int, held_out: Bool) -> None:
        n_classes = self.classes_.size
        of_class = [held_out & (rank == c) for c in range(n_classes)]
        self.n_calibration_ = np.array([np.unique(member[rows]).size for rows in of_class])
        worst = self.unit == "assembly"
        self.thresholds_ = np.array(
            [
                conformal_threshold(scores[rows], member[rows], self.coverage, worst)
                for rows in (of_class if self.per_class else [held_out] * n_classes)
            ]
        )

    def _scores(self, proba: Float) -> Float:
        """Nonconformity of each class, shape (n_windows, n_classes)."""
        if self.nonconformity == "lac":
            return 1 - proba
        order = np.argsort(-proba, axis=1, kind="stable")
        sums = np.cumsum(np.take_along_axis(proba, order, axis=1), axis=1)
        result = np.empty_like(proba)
        np.put_along_axis(result, order, sums, axis=1)
        # The most probable class is in every set.
        np.put_along_axis(result, order[:, :1], 0.0, axis=1)
        return result

    def predict_proba(self, X: ArrayLike) -> Float:
        """Probability of each class by the counter, refused or not; shape (n_windows, n_classes)."""
        return self._proba(self._windows(X))

    def predict_set(self, X: ArrayLike) -> Bool:
        """Mark the classes that cannot be excluded.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)
            As for :meth:`fit`.

        Returns
        -------
        ndarray of bool, shape (n_windows, n_classes)
            Rows without any are refusals.
        """
        windows = self._windows(X)
        inside = self._scores(self._proba(windows)) <= self.thresholds_
        return np.asarray(inside & ~(self._distance(windows) > 1)[:, np.newaxis])

    def predict_counts(self, X: ArrayLike) -> list[CountSet]:
        """Return a :class:`CountSet` for each window of ``X``, shape (n_windows, n_samples)."""
        windows = self._windows(X)
        inside = self._scores(self._proba(windows)) <= self.thresholds_
        distance = self._distance(windows)
        answers = []
        for row, far in zip(inside, distance, strict=True):
            reason = OUTSIDE if far > 1 else "" if row.any() else NO_CLASS
            counts = () if reason else tuple(self.classes_[row].tolist())
            answers.append(CountSet(counts, bool(reason), reason, float(far)))
        return answers

    def _proba(self, X: NDArray[Any]) -> Float:
        return aligned_proba(self.counter_, X, self.classes_)

    def _distance(self, X: NDArray[Any]) -> Float:
        if self.domain_ is None:
            return np.full(len(X), np.nan)
        return np.asarray(self.domain_.distance(features_seen(self.counter_, X)))


def conformal_threshold(scores: Float, member: Int, coverage: float, worst: bool) -> float:
    """Return the quantile of scores at ``coverage``; each assembly weighs 1, by all windows or the worst."""
    if scores.size == 0:
        return float("inf")
    _, which, size = np.unique(member, return_inverse=True, return_counts=True)
    if worst:
        largest = np.full(size.size, -np.inf)
        np.maximum.at(largest, which, scores)
        scores, mass = largest, np.ones(size.size)
    else:
        mass = 1.0 / size[which]
    order = np.argsort(scores, kind="stable")
    reached = np.cumsum(mass[order]) >= coverage * (size.size + 1) - 1e-9
    return float(scores[order][np.argmax(reached)]) if reached.any() else float("inf")


def features_seen(counter: Any, X: NDArray[Any]) -> Float:
    """Return the features that a fitted counter uses, or the windows if it has no step for features."""
    inner = getattr(counter, "counter_", None)
    if inner is not None:
        return features_seen(inner, X)
    lobe_map = getattr(counter, "lobe_map_", None)
    if lobe_map is not None:
        return np.asarray(lobe_map.transform(X))
    if isinstance(counter, Pipeline) and len(counter.steps) > 1:
        return np.asarray(counter[:-1].transform(X))
    return np.asarray(X)
