"""Counting lobe by lobe: which lobes are worn, and so how many."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logit, logsumexp
from sklearn.linear_model import LogisticRegression
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted

from cyclofeat import lobes
from cyclofeat._sklearn import Interval, StrOptions, fit_context
from cyclofeat.counting._base import Counter
from cyclofeat.counting._folds import (
    Float,
    Folds,
    Int,
    aligned_proba,
    assemblies_of,
    grouped_folds,
    of_windows,
    pool_weights,
    pooled,
    safe_log,
    shares,
    softmax,
)
from cyclofeat.counting._trees import CountingTrees
from cyclofeat.features import LobeMap

Bool = NDArray[np.bool_]

# Logits of lobes beyond this say no more than "sure"; 15 of them still multiply without overflow.
_SURE = 9.0
# Phase of the mesh line, in turns, at the passage of a worn lobe on the assumed rigs; without a tachometer
# any constant would do, it only settles where a slot begins.
_MESH_PHASE = 0.5
# Rounds in which the places of worn lobes are guessed anew where only their number is known.
_GUESSES = 3


class LobeCounter(Counter):
    """Count and positions of worn lobes together, from a probability of each lobe of being worn.

    The whitened torque, folded at the lobe frequency, gives each lobe a slot (:mod:`cyclofeat.lobes`). A slot
    seen together with the others - the fold turned until that slot comes first - is one example of a worn or
    a sound lobe, so that what is learned about one lobe holds for all, and a fold begun at another lobe gives
    the same answers at other places. Trees on these views give the odds of each lobe; other trees, on the
    features of :class:`~cyclofeat.features.LobeMap`, the odds of each count. Both opinions of the count are
    pooled with weights learned on held-out assemblies, which calibrates it; the lobes are then those most
    probable given the count.

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
    points_per_lobe : {1, 2, 4, 8, 16}, default=4
        Resolution of the fold.
    n_trees : int, default=300
        Trees for the count.
    n_lobe_trees : int, default=100
        Trees for the lobes.
    min_samples_leaf : int, default=3
        Of the trees for the lobes.
    max_features : float, default=0.3
        Share of the points of a view that a split of the trees for the lobes chooses from.
    n_splits : int, default=5
        Folds by assembly on which the opinions are weighed; less where a class has fewer assemblies.
    random_state : int or None, default=0
        Seed of the trees and folds.

    Attributes
    ----------
    classes_ : ndarray, shape (n_classes,)
        Counts in training, in order.
    weights_ : ndarray, shape (2,)
        Exponents of the two opinions of the count: trees on the lobe map, and lobes.
    lobe_trees_ : CountingTrees or None
        None where the classes are no counts from 0 to ``n_lobes``: then there are no lobes to find.
    count_trees_ : CountingTrees
    lobe_map_ : LobeMap
    mesh_phase_ : float
        Phase of line ``n_lobes`` at the beginning of a slot, in turns.
    calibration_ : ndarray, shape (2,)
        Intercept and slope by which held-out logits of lobes become probabilities.
    n_features_in_ : int
    feature_names_in_ : ndarray of str
        If ``fit`` was given a data frame.

    See Also
    --------
    LobeLocator : Probability of each lobe only, given a tachometer.

    Notes
    -----
    Let p_k be the calibrated probability of lobe k. For ``pattern="any"`` lobes are independent given the
    fold: the count is Poisson-binomial, and given a count n a set S of n lobes has a probability in
    proportion to the product over S of p_k/(1 - p_k) (the conditional Bernoulli law; Chen and Liu, Statistica
    Sinica 7 (1997) 875). For ``"consecutive"`` the n_lobes rows of n neighbours share it.

    *Where a slot begins.* A tachometer that tells the passage of lobe 0 fixes it. Otherwise the phase of lobe
    line ``n_lobes`` does: it is the mesh line, every lobe adds to it with the same phase whichever are worn.
    What it cannot tell is which lobe is which: lobes are then numbered from the one whose slot is the first
    to begin in the window.

    *Without known lobes* (``worn`` not given) those worn are taken for neighbours, at first about the centre
    of the fold's energy, then thrice where held-out trees see them most. It serves the count; the positions
    themselves are not to be relied on: rows can be off by some lobes, differently for each count.

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
    >>> counter = LobeCounter(sampling_rate=25_600, n_trees=50, n_lobe_trees=50).fit(torque, counts)
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
        "n_lobe_trees": [Interval(Integral, 1, None, closed="left")],
        "min_samples_leaf": [Interval(Integral, 1, None, closed="left")],
        "max_features": [Interval(Real, 0, 1, closed="right")],
        "n_splits": [Interval(Integral, 2, None, closed="left")],
        "random_state": ["random_state"],
    }

    def __init__(
        self,
        sampling_rate: float,
        input_speed_hz: float = 500 / 60,
        n_lobes: int = 15,
        pattern: str = "any",
        points_per_lobe: int = 4,
        n_trees: int = 300,
        n_lobe_trees: int = 100,
        min_samples_leaf: int = 3,
        max_features: float = 0.3,
        n_splits: int = 5,
        random_state: int | None = 0,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.input_speed_hz = input_speed_hz
        self.n_lobes = n_lobes
        self.pattern = pattern
        self.points_per_lobe = points_per_lobe
        self.n_trees = n_trees
        self.n_lobe_trees = n_lobe_trees
        self.min_samples_leaf = min_samples_leaf
        self.max_features = max_features
        self.n_splits = n_splits
        self.random_state = random_state

    @fit_context(prefer_skip_nested_validation=True)
    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        worn: ArrayLike | None = None,
        passage: ArrayLike | None = None,
        groups: ArrayLike | None = None,
    ) -> Self:
        """Learn from windows whose number of worn lobes is known, better still which ones.

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
            Assembly of each window. Without groups every window is taken for an assembly of its own; where
            windows share one, the counter then learns how sure it is of what it has seen.

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
        begins = None if passage is None else self._begins(passage, len(windows))
        member = assemblies_of(groups, len(windows))
        # one number for all that is random, however often it is used
        seed = int(check_random_state(self.random_state).randint(2**31 - 1))
        self.lobe_map_ = LobeMap(
            self.sampling_rate, input_speed_hz=self.input_speed_hz, n_lobes=self.n_lobes
        ).fit(windows)
        found = self.lobe_map_.lines(windows)
        features = self.lobe_map_._from_lines(found)
        folds = grouped_folds(rank, member, self.n_splits, seed)
        self.mesh_phase_ = self._learn_phase(found.lines, begins, known)
        self.count_trees_ = self._count_trees(seed).fit(features, rank)
        self.lobe_trees_, held_out = None, np.full((len(labels), self.n_lobes), np.nan)
        self.calibration_: Float = np.array([0.0, 1.0])
        if counts is not None and 0 < counts[rank].sum() < counts[rank].size * self.n_lobes:
            samples = self._samples(found.lines, begins, known)
            if known is None:
                samples = self._guess(found.lines, samples, counts[rank], folds, seed)
            self.lobe_trees_ = self._lobe_trees(seed).fit(*samples.rows(np.arange(len(labels))))
            held_out = self._held_out_lobes(samples, folds, seed)
            self.calibration_ = _platt(held_out, samples.worn)
        self.weights_ = self._weigh(features, rank, member, folds, held_out, seed)
        return self

    def predict_proba(self, X: ArrayLike) -> Float:
        """Calibrated probability of each count.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)
            Windows of torque in Nm.

        Returns
        -------
        ndarray, shape (n_windows, n_classes)
        """
        found = self._lines(X)
        return self._count_proba(found, self._logits(found, None))

    def predict_lobe_proba(self, X: ArrayLike, passage: ArrayLike | None = None) -> Float:
        """Probability that each lobe is worn, reconciled with the count: they add up to the expected count.

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
        inclusion = _inclusion(logits, self.pattern)
        return np.asarray(np.einsum("wc,wck->wk", proba, inclusion[:, self.classes_.astype(int)]))

    def predict_lobes(self, X: ArrayLike, passage: ArrayLike | None = None) -> Bool:
        """The worn lobes: the most probable set of as many as :meth:`predict` counts.

        Parameters
        ----------
        X, passage
            As for :meth:`predict_lobe_proba`.

        Returns
        -------
        ndarray of bool, shape (n_windows, n_lobes)

        Raises
        ------
        ValueError
            As for :meth:`predict_lobe_proba`.
        """
        proba, logits = self._both(X, passage)
        counts = self.classes_.astype(int)[np.argmax(proba, axis=1)]
        return _best_sets(logits, counts, self.pattern)

    def _both(self, X: ArrayLike, passage: ArrayLike | None) -> tuple[Float, Float]:
        """Probability of each count, and calibrated logits of the lobes."""
        check_is_fitted(self)
        if self.lobe_trees_ is None:
            raise ValueError(
                f"y in fit must hold numbers of worn lobes from 0 to n_lobes={self.n_lobes} for lobes to be "
                f"found, got {self.classes_.tolist()}"
            )
        found = self._lines(X)
        by_mesh = self._logits(found, None)
        proba = self._count_proba(found, by_mesh)
        if passage is None:
            return proba, by_mesh
        return proba, self._logits(found, self._begins(passage, len(found.lines)))

    def _lines(self, X: ArrayLike) -> lobes.LobeLines:
        windows = self._windows(X)
        found: lobes.LobeLines = self.lobe_map_.lines(windows)
        return found

    def _count_proba(self, found: lobes.LobeLines, logits: Float) -> Float:
        features = self.lobe_map_._from_lines(found)
        by_map = aligned_proba(self.count_trees_, features, np.arange(self.classes_.size))
        return pooled(self._opinions(by_map, logits), self.weights_)

    def _opinions(self, by_map: Float, logits: Float) -> Float:
        """Logarithms of the two opinions of the count, shape (2, n_windows, n_classes)."""
        if self.lobe_trees_ is None:
            return np.stack([safe_log(by_map), np.zeros_like(by_map)])
        by_lobes = softmax(_log_counts(logits, self.pattern)[:, self.classes_.astype(int)])
        return np.stack([safe_log(by_map), safe_log(by_lobes)])

    def _known_lobes(
        self, y: NDArray[Any], worn: ArrayLike | None, passage: ArrayLike | None, counts: Int | None
    ) -> Bool | None:
        if worn is None:
            return None
        if passage is None:
            raise ValueError(
                "passage must be given together with worn: it says when the lobes pass, got None"
            )
        known = np.asarray(worn, dtype=bool)
        if known.shape != (len(y), self.n_lobes):
            raise ValueError(
                f"worn must have shape (n_windows, n_lobes) = {(len(y), self.n_lobes)}, got {known.shape}"
            )
        if counts is None or not np.array_equal(known.sum(axis=1), y):
            raise ValueError("y must hold the number of lobes that worn marks in each window, it does not")
        return known

    def _begins(self, passage: ArrayLike, n_windows: int) -> Float:
        begins = of_windows("passage", passage, n_windows).astype(float)
        if not np.isfinite(begins).all():
            raise ValueError("passage must hold one finite number per window, got NaN or infinity")
        return begins

    def _count_trees(self, seed: int) -> CountingTrees:
        return CountingTrees(self.n_trees, random_state=seed)

    def _lobe_trees(self, seed: int) -> CountingTrees:
        return CountingTrees(
            self.n_lobe_trees,
            min_samples_leaf=self.min_samples_leaf,
            max_features=self.max_features,
            random_state=seed,
        )

    def _learn_phase(self, lines: lobes.Complex, begins: Float | None, known: Bool | None) -> float:
        """Phase of the mesh line at the passage of lobe 0, in turns, where that passage is known."""
        if begins is None or known is None:
            return _MESH_PHASE
        mesh = lobes.shift(lines, begins)[:, self.n_lobes - 1]
        mean = mesh[known.any(axis=1)].sum()
        return float(np.angle(mean) / (2 * np.pi)) if mean else _MESH_PHASE

    def _by_mesh(self, lines: lobes.Complex) -> Float:
        """Where the first slot begins in the window, as a share of the fold, by the mesh line's phase."""
        phase = np.angle(lines[:, self.n_lobes - 1]) / (2 * np.pi)
        return np.asarray((self.mesh_phase_ - phase) % 1.0 / self.n_lobes)

    def _views(self, lines: lobes.Complex, begins: Float) -> Float:
        """The fold seen from each lobe: (n_windows, n_lobes, n_lobes * points_per_lobe), of unit std."""
        folded = lobes.fold(lobes.shift(lines, begins), self.n_lobes, 16)
        points = folded.reshape(len(lines), self.n_lobes, self.points_per_lobe, -1).mean(axis=3)
        scale = points.std(axis=(1, 2), keepdims=True)
        points = np.divide(points, scale, out=np.zeros_like(points), where=scale > 0)
        turn = (np.arange(self.n_lobes) + np.arange(self.n_lobes)[:, np.newaxis]) % self.n_lobes
        return np.asarray(points[:, turn].reshape(len(lines), self.n_lobes, -1))

    def _samples(self, lines: lobes.Complex, begins: Float | None, known: Bool | None) -> _Samples:
        """Views by the mesh line and, where there is a tachometer, by it as well."""
        by_mesh = self._by_mesh(lines)
        views = [self._views(lines, by_mesh)]
        if begins is None or known is None:
            return _Samples(views, [np.zeros(views[0].shape[:2], dtype=bool)])
        turned = _turned(known, np.round((begins - by_mesh) * self.n_lobes).astype(int))
        return _Samples([*views, self._views(lines, begins)], [turned, known])

    def _guess(
        self, lines: lobes.Complex, samples: _Samples, n_worn: Int, folds: Folds, seed: int
    ) -> _Samples:
        """Neighbours worn where the fold has its energy, then where held-out trees see them."""
        folded = lobes.fold(lobes.shift(lines, self._by_mesh(lines)), self.n_lobes)
        centre = lobes.energy_centre(folded) * self.n_lobes
        first = np.round(centre - n_worn / 2).astype(int)
        worn = _turned(np.arange(self.n_lobes) < n_worn[:, np.newaxis], first)
        for _ in range(_GUESSES if folds else 0):
            logits = self._held_out_lobes(_Samples(samples.views, [worn]), folds, seed)
            worn = _best_sets(np.nan_to_num(logits), n_worn, "consecutive")
        return _Samples(samples.views, [worn])

    def _held_out_lobes(self, samples: _Samples, folds: Folds, seed: int) -> Float:
        """Logits of lobes by trees that have not seen the assembly; NaN where there are no folds."""
        logits = np.full(samples.worn.shape, np.nan)
        for train, test in folds:
            X, worn = samples.rows(train)
            if worn.min() == worn.max():
                continue
            trees = self._lobe_trees(seed).fit(X, worn)
            logits[test] = _lobe_logits(trees, samples.views[0][test])
        return logits

    def _logits(self, found: lobes.LobeLines, begins: Float | None) -> Float:
        """Calibrated logits of the lobes."""
        if self.lobe_trees_ is None:
            return np.zeros((len(found.lines), self.n_lobes))
        views = self._views(found.lines, self._by_mesh(found.lines) if begins is None else begins)
        intercept, slope = self.calibration_
        return np.asarray(np.clip(intercept + slope * _lobe_logits(self.lobe_trees_, views), -_SURE, _SURE))

    def _weigh(
        self, features: Float, rank: Int, member: Int, folds: Folds, held_out: Float, seed: int
    ) -> Float:
        """Exponents of the two opinions, learned where neither has seen the assembly."""
        by_map = np.full((rank.size, self.classes_.size), np.nan)
        for train, test in folds:
            trees = self._count_trees(seed).fit(features[train], rank[train])
            by_map[test] = aligned_proba(trees, features[test], np.arange(self.classes_.size))
        usable = np.isfinite(by_map).all(axis=1)
        if self.lobe_trees_ is not None:
            usable &= np.isfinite(held_out).all(axis=1)
        if not usable.any():
            return np.array([1.0, 0.0])
        intercept, slope = self.calibration_
        logits = np.clip(intercept + slope * held_out[usable], -_SURE, _SURE)
        return pool_weights(
            self._opinions(by_map[usable], logits),
            rank[usable],
            shares(member)[usable],
            np.unique(member[usable]).size,
        )


@dataclass(frozen=True)
class _Samples:
    """Views (each (n_windows, n_lobes, n_points)) and what is worn in them, for one or two alignments."""

    views: list[Float]
    labels: list[Bool]

    @property
    def worn(self) -> Bool:
        return self.labels[0]

    def rows(self, windows: NDArray[np.intp]) -> tuple[Float, Bool]:
        X = np.concatenate([view[windows] for view in self.views])
        return X.reshape(-1, X.shape[-1]), np.concatenate([worn[windows] for worn in self.labels]).ravel()


def _counts(classes: NDArray[Any], n_lobes: int) -> Int | None:
    """Classes as whole numbers from 0 to n_lobes; None where they are something else."""
    if classes.dtype.kind not in "iuf":
        return None
    counts = classes.astype(np.int64)
    return counts if np.all(counts == classes) and counts[0] >= 0 and counts[-1] <= n_lobes else None


def _lobe_logits(trees: CountingTrees, views: Float) -> Float:
    proba = trees.predict_proba(views.reshape(-1, views.shape[-1]))[:, 1].reshape(views.shape[:2])
    # as many trees as there are cannot tell less than half a tree from none
    least = 0.5 / len(trees.estimators_)
    return np.asarray(logit(np.clip(proba, least, 1 - least)))


def _platt(logits: Float, worn: Bool) -> Float:
    """Intercept and slope of the logistic regression of worn lobes on held-out logits (Platt)."""
    usable = np.isfinite(logits)
    if not usable.any() or worn[usable].min() == worn[usable].max():
        return np.array([0.0, 1.0])
    fitted = LogisticRegression(C=1e3).fit(logits[usable][:, np.newaxis], worn[usable])
    return np.array([fitted.intercept_[0], max(fitted.coef_[0, 0], 0.0)])


def _turned(worn: Bool, slots: Int) -> Bool:
    """Each row turned by its number of slots: what was lobe 0 is then at that place."""
    n_lobes = worn.shape[1]
    return np.asarray(np.take_along_axis(worn, (np.arange(n_lobes) - slots[:, np.newaxis]) % n_lobes, axis=1))


def _symmetric(odds: Float) -> Float:
    """Elementary symmetric polynomials e_0 ... e_n of n odds in the last axis: sums of products over sets."""
    sums = np.zeros((*odds.shape[:-1], odds.shape[-1] + 1))
    sums[..., 0] = 1.0
    for k in range(odds.shape[-1]):
        sums[..., 1:] += odds[..., k, np.newaxis] * sums[..., :-1]
    return sums


def _rows_of_neighbours(logits: Float) -> Float:
    """Sum of logits of the n neighbours from lobe k on: shape (n_windows, n_lobes + 1 counts, n_lobes)."""
    n_lobes = logits.shape[1]
    ahead = np.stack([np.roll(logits, -j, axis=1) for j in range(n_lobes)], axis=1)
    return np.concatenate([np.zeros_like(ahead[:, :1]), np.cumsum(ahead, axis=1)], axis=1)


def _log_counts(logits: Float, pattern: str) -> Float:
    """Logarithm of each count's probability up to a constant, shape (n_windows, n_lobes + 1)."""
    if pattern == "any":
        return np.asarray(np.log(_symmetric(np.exp(logits))))
    return np.asarray(logsumexp(_rows_of_neighbours(logits), axis=2))


def _inclusion(logits: Float, pattern: str) -> Float:
    """Probability that lobe k is among n worn ones: shape (n_windows, n_lobes + 1 counts, n_lobes)."""
    n_lobes = logits.shape[1]
    if pattern == "any":
        odds = np.exp(logits)
        others = np.stack([np.delete(odds, k, axis=1) for k in range(n_lobes)], axis=1)
        # sets of n with lobe k: lobe k, and n - 1 of the others
        with_lobe = odds[:, :, np.newaxis] * _symmetric(others)
        result = np.zeros((len(logits), n_lobes + 1, n_lobes))
        result[:, 1:] = with_lobe.transpose(0, 2, 1) / _symmetric(odds)[:, 1:, np.newaxis]
        return result
    first = softmax(_rows_of_neighbours(logits))
    result = np.zeros_like(first)
    for n in range(1, n_lobes + 1):
        result[:, n] = sum(np.roll(first[:, n], j, axis=1) for j in range(n))
    return result


def _best_sets(logits: Float, counts: Int, pattern: str) -> Bool:
    """The most probable set of the given number of lobes, shape (n_windows, n_lobes)."""
    n_lobes = logits.shape[1]
    if pattern == "any":
        place = np.argsort(np.argsort(-logits, axis=1, kind="stable"), axis=1)
        return np.asarray(place < counts[:, np.newaxis])
    first = np.argmax(_rows_of_neighbours(logits)[np.arange(len(logits)), counts], axis=1)
    return _turned(np.arange(n_lobes) < counts[:, np.newaxis], first)
