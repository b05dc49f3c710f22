"""Counter that decides for each lobe whether it is worn."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit, softmax
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import check_is_fitted

from cyclofeat._base.sklearn_private import Interval, StrOptions, fit_context
from cyclofeat.counting.calibration.pooling import pool_opinions, pool_weights, safe_log
from cyclofeat.counting.estimators._counter import Counter
from cyclofeat.counting.estimators._lobe_map import held_lobe_map
from cyclofeat.counting.estimators._lobe_network import (
    begins_by_mesh,
    lobe_logits,
    logits_anywhere,
    platt,
    train_network,
    training_views,
    views_of_lobes,
)
from cyclofeat.counting.estimators.lobe_locator import known_lobes
from cyclofeat.counting.estimators.lobe_sets import Bool, best_sets, inclusion, log_counts, turned
from cyclofeat.counting.estimators.trees import CountingTrees
from cyclofeat.counting.evaluation.assembly_folds import (
    Float,
    Folds,
    Int,
    aligned_proba,
    assemblies_of,
    drawn_seed,
    grouped_folds,
    of_windows,
)
from cyclofeat.counting.evaluation.scores import window_weights
from cyclofeat.signal import lobes
from cyclofeat.signal.windows import Complex

# Limit of the logits of lobes: practically certain, and the product of 15 odds does not overflow.
_SURE = 9.0
# Rounds in which the positions of worn lobes are estimated again, if only their number is known.
_GUESSES = 3


@dataclass(eq=False, repr=False)
class LobeCounter(Counter):
    """Counter of worn lobes and their positions, from the probability of each lobe.

    The whitened torque, folded at the lobe frequency, gives each lobe a slot
    (``cyclofeat.signal.lobes``). The fold turned until a slot comes first is one example of a worn or a
    sound lobe, so that what is learned about one lobe holds for all. A small network on these views gives the
    odds of each lobe; trees on the features of :class:`~cyclofeat.features.LobeMap` the odds of each count.
    Both opinions of the count are pooled with weights learned on held-out assemblies, which calibrates it;
    the lobes are then those most probable given the count.

    Parameters
    ----------
    sampling_rate : float
        Samples per second of the windows, in Hz.
    input_speed_hz : float, default=500/60
        Nominal input speed in turns per second.
    n_lobes : int, default=15
        Number of lobes z_s of a disc.
    pattern : {"any", "consecutive"}, default="any"
        Which sets of lobes are thought possible: any, or neighbours only.
    points_per_lobe : {1, 2, 4, 8, 16}, default=8
        Resolution of the fold.
    n_trees : int, default=300
        Trees for the count.
    n_hidden : int, default=64
        Units of the network's one hidden layer.
    n_epochs : int, default=30
        Times that the network learns from all lobes of all windows.
    n_splits : int, default=5
        Folds by assembly on which the opinions are weighed; less where a class has fewer assemblies.
    random_state : int or None, default=0
        Seed of trees, network and folds.
    speed_tolerance : float, default=0.015
        As of :class:`~cyclofeat.features.LobeMap`; 0 for windows over the angle of the shaft.

    Attributes
    ----------
    classes_ : ndarray, shape (n_classes,)
        Counts in training, in order.
    calibrated_ : bool
        Whether there were enough assemblies to hold some out.
    weights_ : ndarray, shape (2,)
        Exponents of the two opinions of the count: trees on the lobe map, and lobes.
    lobe_network_ : Pipeline or None
        Scaling, then the network; None where the classes are no counts from 0 to ``n_lobes``: then there are
        no lobes to find.
    count_trees_ : CountingTrees
    lobe_map_ : LobeMap
    calibration_ : ndarray, shape (2,)
        Intercept and slope by which held-out logits of lobes become probabilities.

    Notes
    -----
    Let p_k be the calibrated probability of lobe k. For ``pattern="any"`` lobes are independent given the
    fold: the count is Poisson-binomial, and given a count n a set S of n lobes has a probability in
    proportion to the product over S of p_k/(1 - p_k) (the conditional Bernoulli law; Chen and Liu, Statistica
    Sinica 7 (1997) 875). For ``"consecutive"`` the n_lobes rows of n neighbours share it.

    *Where a slot begins.* It is known if a tachometer states the passage of lobe 0. Otherwise the fold is
    computed from eight places within a lobe. The network is also trained on folds that begin between two
    lobes, and the place that looks least like those is chosen. (The phase of the mesh line would be wrong by
    up to half a slot if every other lobe is worn.) Lobes are then numbered from the first slot that begins in
    the window. The count never uses a tachometer.

    *Neighbours or not.* The contact zones of neighbouring lobes overlap, so the effect of a row of worn lobes
    is not the sum of their single effects. To count both rows and separate lobes, train on both;
    ``make_rig_recordings(lobes="mixed")`` makes such recordings.

    *Without known lobes* (``worn`` not given) worn lobes are assumed to be neighbours: first around the
    centre of the fold's energy, then in three rounds where held-out networks find them most probable. Such
    positions are not reliable: rows can be off by some lobes, differently for each count.

    Examples
    --------
    >>> import numpy as np
    >>> random = np.random.default_rng(0)
    >>> counts = np.tile([0, 2, 4], 12)
    >>> slot = np.arange(46_080) / 25_600 * 500 / 60 * 16 / 15 * 15
    >>> torque = [
    ...     (slot.astype(int) % 15 < n) * np.sin(2 * np.pi * slot) ** 3 + 0.3 * random.normal(size=slot.size)
    ...     for n in counts
    ... ]
    >>> counter = LobeCounter(sampling_rate=25_600, n_trees=50).fit(torque, counts)
    >>> counter.predict(torque[:3])
    array([0, 2, 4])
    >>> counter.predict_lobes(torque[:3]).sum(axis=1)
    array([0, 2, 4])
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "sampling_rate": [Interval(Real, 0, None, closed="neither")],
        "input_speed_hz": [Interval(Real, 0, None, closed="neither")],
        "n_lobes": [Interval(Integral, 3, 44, closed="both")],
        "pattern": [StrOptions({"any", "consecutive"})],
        "points_per_lobe": [Interval(Integral, 1, 16, closed="both")],
        "n_trees": [Interval(Integral, 1, None, closed="left")],
        "n_hidden": [Interval(Integral, 1, None, closed="left")],
        "n_epochs": [Interval(Integral, 1, None, closed="left")],
        "n_splits": [Interval(Integral, 2, None, closed="left")],
        "random_state": ["random_state"],
        "speed_tolerance": [Interval(Real, 0, 0.2, closed="left")],
    }

    sampling_rate: float
    input_speed_hz: float = 500 / 60
    n_lobes: int = 15
    pattern: str = "any"
    points_per_lobe: int = 8
    n_trees: int = 300
    n_hidden: int = 64
    n_epochs: int = 30
    n_splits: int = 5
    random_state: int | None = 0
    speed_tolerance: float = lobes.SPEED_TOLERANCE

    @fit_context(prefer_skip_nested_validation=True)
    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        worn: ArrayLike | None = None,
        passage: ArrayLike | None = None,
        groups: ArrayLike | None = None,
    ) -> Self:
        """Fit to windows with known counts and, better, known worn lobes.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)
            Windows of torque in Nm.
        y : array-like, shape (n_windows,)
            Number of worn lobes.
        worn : array-like of bool, shape (n_windows, n_lobes), optional
            Whether each lobe is worn. Together with ``passage``.
        passage : array-like, shape (n_windows,), optional
            When lobe 0 passes the cam's direction, see :func:`passage_of_lobe_zero`.
        groups : array-like, shape (n_windows,), optional
            Assembly of each window. Without groups every window counts as one assembly; if windows share an
            assembly, the calibration is then learned on windows like those in training.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If there is one class only, shapes do not match, ``worn`` is given without ``passage`` or
            disagrees with ``y``, or ``points_per_lobe`` does not divide 16.
        """
        windows, labels, rank = self._labelled(X, y)
        if 16 % self.points_per_lobe:
            raise ValueError(f"points_per_lobe must be 1, 2, 4, 8 or 16, got {self.points_per_lobe}")
        counts = _counts(self.classes_, self.n_lobes)
        known = self._known_lobes(labels, worn, passage, counts)
        begins = None if passage is None else _begins(passage, len(windows))
        member = assemblies_of(groups, len(windows))
        seed = drawn_seed(self.random_state)
        self.lobe_map_ = held_lobe_map(
            self.sampling_rate, self.input_speed_hz, self.n_lobes, self.speed_tolerance
        ).fit(windows)
        found = self.lobe_map_.lines(windows)
        features = self.lobe_map_.from_lines(found)
        folds = grouped_folds(rank, member, self.n_splits, seed)
        self.calibrated_ = bool(folds)
        self.count_trees_ = CountingTrees(self.n_trees, random_state=seed).fit(features, rank)
        self.lobe_network_, held_out = None, None
        self.calibration_: Float = np.array([0.0, 1.0])
        if counts is not None and 0 < counts[rank].sum() < counts[rank].size * self.n_lobes:
            if begins is None:
                begins = begins_by_mesh(found.lines, self.n_lobes)
            if known is None:
                known = self._guess(found.lines, begins, counts[rank], folds, seed)
            self.lobe_network_ = self._network(found.lines, begins, known, seed)
            by_lobe, held_out = np.full((2, *known.shape), np.nan)
            for train, test in folds:
                network = self._network(found.lines[train], begins[train], known[train], seed)
                by_lobe[test] = self._lobe_logits(network, found.lines[test], begins[test])
                held_out[test] = self._lobe_logits(network, found.lines[test], None)
            self.calibration_ = platt(by_lobe, known)
        self.weights_ = self._weigh(features, rank, member, folds, held_out, seed)
        return self

    def predict_proba(self, X: ArrayLike) -> Float:
        """Calibrated probability of each count, shape (n_windows, n_classes), of windows as for ``fit``."""
        return self.proba_of_lines(self._lines(X))

    def predict_lobe_proba(self, X: ArrayLike, passage: ArrayLike | None = None) -> Float:
        """Return the probability of each lobe given the count: they add up to the expected count.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)
            Windows of torque in Nm.
        passage : array-like, shape (n_windows,), optional
            When lobe 0 passes the cam's direction. Without it lobes are numbered from the one whose slot is
            the first to begin in the window.

        Returns
        -------
        ndarray, shape (n_windows, n_lobes)

        Raises
        ------
        ValueError
            If training had no counts from which lobes could be learned.
        """
        proba, logits = self._both(X, passage)
        given = inclusion(logits, self.pattern)[:, self.classes_.astype(int)]
        return np.asarray(np.einsum("wc,wck->wk", proba, given))

    def predict_lobes(self, X: ArrayLike, passage: ArrayLike | None = None) -> Bool:
        """Return the most probable set of as many worn lobes as :meth:`predict` counts.

        Arguments and errors are those of :meth:`predict_lobe_proba`; the result is a table of bool of the
        same shape.
        """
        proba, logits = self._both(X, passage)
        counts = self.classes_.astype(int)[np.argmax(proba, axis=1)]
        return best_sets(logits, counts, self.pattern)

    def _both(self, X: ArrayLike, passage: ArrayLike | None) -> tuple[Float, Float]:
        """Probability of each count, and calibrated logits of the lobes."""
        check_is_fitted(self)
        if self.lobe_network_ is None:
            raise ValueError(
                f"y in fit must hold numbers of worn lobes from 0 to n_lobes={self.n_lobes} for lobes to be "
                f"found, got {self.classes_.tolist()}"
            )
        found = self._lines(X)
        anywhere = self._logits(found, None)
        proba = self._count_proba(found, anywhere)
        if passage is None:
            return proba, anywhere
        return proba, self._logits(found, _begins(passage, len(found.lines)))

    def _from_lines(self, found: lobes.LobeLines, passage: ArrayLike) -> Float:
        """Return the probability that each lobe is worn, whatever the count, from given lobe lines."""
        return np.asarray(expit(self._logits(found, _begins(passage, len(found.lines)))))

    def proba_of_lines(self, lines: lobes.LobeLines) -> Float:
        """Return what :meth:`predict_proba` does, of windows whose lobe lines are at hand."""
        return self._count_proba(lines, self._logits(lines, None))

    def _lines(self, X: ArrayLike) -> lobes.LobeLines:
        windows = self._windows(X)  # raises NotFittedError before lobe_map_ is used
        lines: lobes.LobeLines = self.lobe_map_.lines(windows)
        return lines

    def _count_proba(self, found: lobes.LobeLines, logits: Float) -> Float:
        features = self.lobe_map_.from_lines(found)
        by_map = aligned_proba(self.count_trees_, features, np.arange(self.classes_.size))
        return pool_opinions(self._opinions(by_map, logits), self.weights_)

    def _opinions(self, by_map: Float, logits: Float) -> Float:
        """Logarithms of the two opinions of the count, shape (2, n_windows, n_classes)."""
        if self.lobe_network_ is None:
            return np.stack([safe_log(by_map), np.zeros_like(by_map)])
        by_lobes = softmax(log_counts(logits, self.pattern)[:, self.classes_.astype(int)], axis=-1)
        return np.stack([safe_log(by_map), safe_log(by_lobes)])

    def _known_lobes(
        self, y: NDArray[Any], worn: ArrayLike | None, passage: ArrayLike | None, counts: Int | None
    ) -> Bool | None:
        if worn is None:
            return None
        known, _ = known_lobes(worn, passage, len(y), self.n_lobes)
        if counts is None or not np.array_equal(known.sum(axis=1), y):
            raise ValueError("y must hold the number of lobes that worn marks in each window, it does not")
        return known

    def _network(self, lines: Complex, begins: Float, worn: Bool, seed: int) -> Pipeline | None:
        """Trained network; None where lobes are all worn or all sound."""
        if worn.min() == worn.max():
            return None
        X, kind = training_views(lines, begins, worn, self.points_per_lobe, seed)
        return train_network(X, kind, self.n_hidden, self.n_epochs, seed)

    def _lobe_logits(self, network: Pipeline | None, lines: Complex, begins: Float | None) -> Float:
        """Return the logits of the lobes, with slots from ``begins`` on or where the network finds them."""
        if begins is None:
            return logits_anywhere(network, lines, self.n_lobes, self.points_per_lobe)
        return lobe_logits(network, views_of_lobes(lines, begins, self.n_lobes, self.points_per_lobe))[0]

    def _guess(self, lines: Complex, begins: Float, n_worn: Int, folds: Folds, seed: int) -> Bool:
        """Estimate the worn row, first at the energy of the fold, then where held-out networks find it."""
        begun = lobes.fold(lobes.shift(lines, begins), self.n_lobes)
        first = np.round(lobes.energy_centre(begun) * self.n_lobes - n_worn / 2).astype(int)
        worn = turned(np.arange(self.n_lobes) < n_worn[:, np.newaxis], first)
        for _ in range(_GUESSES if folds else 0):
            logits = np.zeros(worn.shape)
            for train, test in folds:
                logits[test] = self._lobe_logits(
                    self._network(lines[train], begins[train], worn[train], seed), lines[test], begins[test]
                )
            worn = best_sets(np.nan_to_num(logits), n_worn, "consecutive")
        return worn

    def _logits(self, found: lobes.LobeLines, begins: Float | None) -> Float:
        """Calibrated logits of the lobes."""
        if self.lobe_network_ is None:
            return np.zeros((len(found.lines), self.n_lobes))
        return self._calibrated(self._lobe_logits(self.lobe_network_, found.lines, begins))

    def _calibrated(self, logits: Float) -> Float:
        intercept, slope = self.calibration_
        return np.asarray(np.clip(intercept + slope * logits, -_SURE, _SURE))

    def _weigh(
        self, features: Float, rank: Int, member: Int, folds: Folds, held_out: Float | None, seed: int
    ) -> Float:
        """Learn the exponents of the two opinions on held-out assemblies."""
        by_map = np.full((rank.size, self.classes_.size), np.nan)
        for train, test in folds:
            trees = CountingTrees(self.n_trees, random_state=seed).fit(features[train], rank[train])
            by_map[test] = aligned_proba(trees, features[test], np.arange(self.classes_.size))
        if held_out is None:
            held_out = np.zeros((rank.size, self.n_lobes))
        usable = np.isfinite(by_map).all(axis=1) & np.isfinite(held_out).all(axis=1)
        if not usable.any():
            return np.array([1.0, 0.0])
        opinions = self._opinions(by_map[usable], self._calibrated(held_out[usable]))
        n_assemblies = np.unique(member[usable]).size
        return pool_weights(opinions, rank[usable], window_weights(member)[usable], n_assemblies)


def _begins(passage: ArrayLike, n_windows: int) -> Float:
    return np.asarray(of_windows("passage", passage, n_windows), dtype=float)


def _counts(classes: NDArray[Any], n_lobes: int) -> Int | None:
    """Return the classes as whole numbers from 0 to n_lobes; None if they are something else."""
    if classes.dtype.kind not in "iuf":
        return None
    counts = classes.astype(np.int64)
    return counts if np.all(counts == classes) and counts[0] >= 0 and counts[-1] <= n_lobes else None
