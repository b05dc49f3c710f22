"""Counter of worn lobes and of where they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, MISSING, dataclass
from functools import cached_property
from numbers import Integral
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit, logit, logsumexp, softmax

from cyclofeat._base.sklearn_private import Interval, StrOptions, fit_context
from cyclofeat.counting.calibration.pooling import learn_dependence, pool_opinions, pool_weights, safe_log
from cyclofeat.counting.estimators._lobe_network import PLACES, Weights, log_odds, place_turns, train_network
from cyclofeat.counting.estimators.lobe_positions import (
    best_sets,
    coarse_views,
    lobe_logits,
    lobes_apart,
    log_counts,
    logits_anywhere,
    platt_calibration,
    row_starts,
    views_to_learn,
)
from cyclofeat.counting.estimators.trees import Counter, CountingTrees
from cyclofeat.counting.evaluation.assembly_folds import (
    Folds,
    aligned_proba,
    assemblies_of,
    drawn_seed,
    grouped_folds,
    held_out_proba,
    of_windows,
)
from cyclofeat.features import LobeMap
from cyclofeat.features.base import INPUT_SPEED_HZ, POSITIVE, SPEED_TOLERANCE, at_least, parameter
from cyclofeat.signal import lobes
from cyclofeat.signal.windows import Bool, Complex, Float, Int

# Trees for the lobes.
_LOBE_TREES = 200
# Limit of the logits of lobes: practically certain, and the product of 15 odds does not overflow.
_SURE = 9.0
# Phase of the mesh line, in turns, at the passage of a worn lobe on the assumed rigs. It defines where slots
# begin in training without known lobes.
_MESH_PHASE = 0.5
# Share of an input turn over which the network's autoregressive model reaches: the resonance of rotor and
# torque meter is one pair of its poles, the others follow the slope of the spectrum. A longer one would take
# out the pattern of the worn lobes as well.
_AR_TURNS = 1 / 16
# Logarithms of a network's probabilities are limited to this.
_LEAST_LOG = -12.0
# Windows whose places are tried at once, to limit the memory.
_BLOCK = 256


@dataclass(eq=False, repr=False)
class LobeCounter(Counter):
    """Counter of worn lobes that also locates them.

    The torque is whitened and folded at the lobe frequency (``cyclofeat.signal.lobes``), which gives each
    lobe a slot. The fold turned until a slot comes first is one *view* of the disc: what is learned about one
    lobe holds for all. Probabilities of counts are calibrated on held-out assemblies.

    ``kind="trees"`` counts by extremely randomised trees on the features of
    :class:`~cyclofeat.features.LobeMap` and locates by trees on the views. Any lobes may be worn.

    ``kind="network"`` counts rows of neighbouring lobes, more accurately than trees where it learns from some
    hundred assemblies of each count. A network gives the probability of a row of each length that begins at
    the first lobe of a view, from the complex lobe lines; that of a count is the sum over all beginnings. It
    learns from variants of each window, as of other machines. Training needs JAX and Optax (the extra
    ``prepare``); predictions need numpy alone.

    Parameters
    ----------
    sampling_rate : float
        Samples per second of the windows, in Hz.
    kind : {"trees", "network"}, default="trees"
        What counts and locates.
    input_speed_hz : float, default=500/60
        Nominal input speed in turns per second.
    n_lobes : int, default=15
        Number of lobes z_s of a disc.
    n_lines : int, default=44
        Lobe lines that are used, where windows hold as many. More tell counts better apart at low speeds.
    n_trees : int, default=300
        Trees for the count.
    n_epochs : int, optional
        Times that a network sees each window, in other variants. Default: 40, and more where windows are few,
        so that it learns from 600 batches at least.
    n_splits : int, optional
        Folds by assembly on which probabilities are calibrated, less where a class has fewer assemblies; for
        less than 2 nothing is calibrated. Default: 5 for trees and 3 for networks, which answer together.
    random_state : int or None, default=None
        Seed of trees, networks and folds.
    speed_tolerance : float, default=0.015
        See :class:`~cyclofeat.features.LobeMap`; 0 for windows over the angle of the shaft.

    Attributes
    ----------
    classes_ : ndarray, shape (n_classes,)
        Counts in training, in order.
    calibrated_ : bool
        Whether there were enough assemblies to hold some out.
    dependence_ : float or None
        See :class:`GroupCalibratedCounter`.
    pattern_ : {"consecutive", "any"}
        Which sets of lobes are thought possible: neighbours only, unless worn lobes in training are apart.
    weights_ : ndarray, shape (n_opinions,)
        Powers of what is pooled to the probability of a count, learned on held-out assemblies. Of trees: the
        probabilities by the lobe map and, if ``pattern_`` is ``"any"``, those by the single lobes. Of
        networks: the odds of a row, the probabilities of its length, and the odds for and against a sound
        disc.
    count_trees_, lobe_trees_ : CountingTrees or None
        None for networks; ``lobe_trees_`` also where training did not know worn and sound lobes.
    lobe_calibration_ : ndarray, shape (2,), or None
        Intercept and slope by which logits of single lobes become probabilities (Platt); only if ``pattern_``
        is ``"any"``.
    networks_ : list of dict from str to ndarray
        Weights of the networks, one for each fold.
    lobe_map_ : LobeMap

    Notes
    -----
    *Single lobes.* If ``pattern_`` is ``"any"``, lobes are taken to be independent given the fold: with the
    probability p_k of lobe k the count is Poisson-binomial, and given a count n a set S of n lobes has a
    probability in proportion to the product over S of p_k/(1 - p_k) (the conditional Bernoulli law; Chen and
    Liu, Statistica Sinica 7 (1997) 875). ``docs/counting.md`` says how to train for rows and separate lobes.

    *Where a slot begins.* Lobes are numbered as on the disc if a tachometer states the passage of lobe 0.
    Otherwise slots are begun at several places within a lobe, and the place with the most decided lobes is
    taken; if ``pattern_`` is ``"any"``, that which looks least like views that begin between two lobes.

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
    >>> worn = np.arange(15) < counts[:, np.newaxis]
    >>> counter = LobeCounter(sampling_rate=25_600, n_trees=50, random_state=0)
    >>> counter = counter.fit(torque, counts, worn=worn, passage=np.zeros(36))
    >>> counter.predict(torque[:3])
    array([0, 2, 4])
    >>> np.flatnonzero(counter.predict_lobes(torque[1:2], passage=[0.0]))
    array([0, 1])
    """

    sampling_rate: float = parameter(MISSING, POSITIVE)
    _: KW_ONLY
    kind: str = parameter("trees", StrOptions({"trees", "network"}))
    input_speed_hz: float = parameter(*INPUT_SPEED_HZ)
    n_lobes: int = parameter(15, Interval(Integral, 3, 44, closed="both"))
    n_lines: int = parameter(lobes.N_LINES, at_least(lobes.FEWEST_LINES))
    n_trees: int = parameter(300, at_least(1))
    n_epochs: int | None = parameter(None, at_least(1), None)
    n_splits: int | None = parameter(None, at_least(0), None)
    random_state: int | None = parameter(None, "random_state")
    speed_tolerance: float = parameter(*SPEED_TOLERANCE)

    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        groups: ArrayLike | None = None,
        worn: ArrayLike | None = None,
        passage: ArrayLike | None = None,
    ) -> Self:
        """Fit to windows with known counts and, better, known worn lobes.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)
            Windows of torque in Nm.
        y : array-like, shape (n_windows,)
            Number of worn lobes.
        groups : array-like, shape (n_windows,), optional
            Assembly of each window. Without groups every window counts as one: if windows share an assembly,
            the counter is then too sure.
        worn : array-like of bool, shape (n_windows, n_lobes), optional
            Whether each lobe is worn. Together with ``passage``. Without it trees only count, and networks
            take a row to lie about the centre of the fold's energy: positions are then not reliable.
        passage : array-like, shape (n_windows,), optional
            When lobe 0 passes the cam's direction, see :func:`passage_of_lobe_zero`.

        Returns
        -------
        self

        Raises
        ------
        ImportError, ValueError
            If JAX or Optax is missing for networks; if there is one class only, shapes do not match, ``worn``
            is given without ``passage``, disagrees with ``y``, or marks no rows of neighbours for networks.
        """
        self._fit_cross_val_proba(X, y, groups, worn, passage)
        return self

    @fit_context(prefer_skip_nested_validation=True)
    def _fit_cross_val_proba(
        self, X: ArrayLike, y: ArrayLike, groups: ArrayLike | None = None, worn: ArrayLike | None = None,
        passage: ArrayLike | None = None,
    ) -> Float:  # fmt: skip
        """Fit; return calibrated probabilities of the windows by parts that have not seen their assembly.

        NaN without folds.
        """
        windows, labels, rank = self._labelled(X, y)
        member = assemblies_of(groups, len(windows))
        known, begins = self._known_lobes(labels, worn, passage)
        seed = drawn_seed(self.random_state)
        network = self.kind == "network"
        n_splits = (3 if network else 5) if self.n_splits is None else self.n_splits
        folds = grouped_folds(rank, member, n_splits, seed) if n_splits >= 2 else []
        disc = self.sampling_rate, self.input_speed_hz, self.n_lobes
        n_lines = lobes.lines_held(*disc, self.speed_tolerance, self.n_lines)
        self.lobe_map_ = LobeMap(*disc, n_lines, speed_tolerance=self.speed_tolerance)
        if network:
            rate = lobes.whitened_rate(*disc, n_lines)
            self.lobe_map_.set_params(ar_order=round(_AR_TURNS * rate / self.input_speed_hz))
        lines = self.lobe_map_.fit(windows).lines(windows)
        self.__dict__.pop("_single_precision", None)  # of an earlier fit
        self.calibrated_ = bool(folds)
        self.pattern_ = "any" if known is not None and lobes_apart(known) else "consecutive"
        self.count_trees_: CountingTrees | None = None
        self.lobe_trees_: CountingTrees | None = None
        self.networks_: list[Weights] = []
        self.lobe_calibration_: Float | None = None
        if network:
            opinions = self._fit_networks(lines.lines, labels, rank, known, begins, folds, seed)
            self.weights_: Float = np.array([1.0, 1.0, 0.0, 0.0])
        else:
            opinions = self._fit_trees(lines, labels, known, begins, folds, seed)
            self.weights_ = np.array([1.0, 0.0][: len(opinions)])
        self.dependence_: float | None = None
        proba = np.full(opinions.shape[1:], np.nan)
        if folds:
            held_out = np.isfinite(opinions).all(axis=(0, 2))
            opinions, rank, member = opinions[:, held_out], rank[held_out], member[held_out]
            self.weights_ = pool_weights(opinions, rank, member)
            proba[held_out] = pool_opinions(opinions, self.weights_)
            self.dependence_ = learn_dependence(proba[held_out], rank, member)
        return proba

    def _proba(self, windows: NDArray[Any]) -> Float:
        return self._proba_of_lines(self.lobe_map_.lines(windows))

    def predict_lobe_proba(self, X: ArrayLike, passage: ArrayLike | None = None) -> Float:
        """Return the probability that each lobe is worn.

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
            Those of a network add up to the expected count. ``ValueError`` unless the counter ``locates``.
        """
        return self._lobe_proba_of_lines(self._lines(X), passage)

    def predict_lobes(self, X: ArrayLike, passage: ArrayLike | None = None) -> Bool:
        """Return the most probable set of as many worn lobes as :meth:`predict` counts.

        Parameters
        ----------
        X, passage
            See :meth:`predict_lobe_proba`, also for the errors.

        Returns
        -------
        ndarray of bool, shape (n_windows, n_lobes)
        """
        lines = self._lines(X)
        proba = self._proba_of_lines(lines)
        share = np.clip(self._lobe_proba_of_lines(lines, passage, proba), expit(-_SURE), expit(_SURE))
        return best_sets(logit(share), self.classes_.astype(int)[np.argmax(proba, axis=1)], self.pattern_)

    @property
    def locates(self) -> bool:
        """Whether training had counts, and worn and sound lobes, from which positions could be learned."""
        is_count = self.classes_.dtype.kind in "iuf"
        return is_count and (self.lobe_trees_ is not None or bool(self.networks_))

    def _proba_of_lines(self, lines: lobes.LobeLines, features: Float | None = None) -> Float:
        """Return what :meth:`predict_proba` does, of windows whose lobe lines, and features, are at hand."""
        if self.kind == "network":
            opinions = self._row_opinions(self._log_counts(self._single_precision, lines.lines))
            return pool_opinions(opinions, self.weights_)
        if features is None:
            features = self.lobe_map_.from_lines(lines)
        opinions = safe_log(aligned_proba(self.count_trees_, features, self.classes_))[np.newaxis]
        if self.pattern_ == "any":
            by_lobe = self._log_counts_by_lobe(self._lobe_proba_of_lines(lines))
            opinions = np.concatenate([opinions, by_lobe[np.newaxis]])
        return pool_opinions(opinions, self.weights_)

    def _lobe_proba_of_lines(
        self, lines: lobes.LobeLines, passage: ArrayLike | None = None, proba: Float | None = None
    ) -> Float:
        """Return what :meth:`predict_lobe_proba` does, of windows whose lobe lines are at hand.

        ``proba`` are the probabilities of counts, where they are at hand too.
        """
        if not self.locates:
            raise ValueError(
                "to locate lobes, y in fit must hold numbers of worn lobes, and worn both kinds of lobes; "
                f"got the classes {self.classes_.tolist()}"
            )
        if self.kind == "network" and proba is None:
            proba = self._proba_of_lines(lines)
        n_windows = len(lines.lines)
        if passage is None and self.pattern_ == "any":
            assert self.lobe_trees_ is not None
            return self._calibrate(logits_anywhere(self.lobe_trees_, lines.lines, self.n_lobes))
        if passage is None:
            starts = np.arange(PLACES)[:, np.newaxis] / (PLACES * self.n_lobes) * np.ones(n_windows)
            places = np.stack([self._lobe_proba(lines.lines, start, proba) for start in starts])
            # The place with the most decided lobes.
            best = np.abs(places - 0.5).sum(axis=2).argmax(axis=0)
            return np.asarray(places[best, np.arange(n_windows)])
        begins = np.asarray(of_windows("passage", passage, n_windows), dtype=float)
        return self._lobe_proba(lines.lines, begins, proba)

    def _lobe_proba(self, lines: Complex, begins: Float, proba: Float | None) -> Float:
        """Return the probability of each lobe, with slots from ``begins`` on."""
        if self.pattern_ == "any":
            assert self.lobe_trees_ is not None
            return self._calibrate(lobe_logits(self.lobe_trees_, lines, begins, self.n_lobes)[0])
        if self.lobe_trees_ is not None:
            share = self.lobe_trees_.predict_proba(coarse_views(lines, begins, self.n_lobes))[:, 1]
            return np.asarray(share.reshape(len(lines), self.n_lobes))
        assert proba is not None
        at_lobes = lobes.shift(lines, begins)
        # Of each class, where its row begins.
        rows = np.mean(
            [self._log_rows(network, at_lobes, 1)[0] for network in self._single_precision], axis=0
        )
        first = softmax(rows.transpose(0, 2, 1), axis=-1)
        worn = np.zeros(first.shape[::2])
        for k in np.flatnonzero(~self._sound):
            for j in range(min(int(self.classes_[k]), self.n_lobes)):
                worn += proba[:, [k]] * np.roll(first[:, k], j, axis=1)
        return np.asarray(np.clip(worn, 0.0, 1.0))

    def _lines(self, X: ArrayLike) -> lobes.LobeLines:
        windows = self._windows(X)  # raises NotFittedError before lobe_map_ is used
        lines: lobes.LobeLines = self.lobe_map_.lines(windows)
        return lines

    def _known_lobes(
        self, y: NDArray[Any], worn: ArrayLike | None, passage: ArrayLike | None
    ) -> tuple[Bool | None, Float | None]:
        """Return the table of worn lobes and when lobe 0 passes, checked; None where they are not known."""
        if worn is None:
            return None, None
        if passage is None:
            raise ValueError(
                "passage must be given together with worn: it says when the lobes pass, got None"
            )
        known = np.asarray(worn, dtype=bool)
        if known.shape != (len(y), self.n_lobes):
            expected = (len(y), self.n_lobes)
            raise ValueError(f"worn must have shape (n_windows, n_lobes) = {expected}, got {known.shape}")
        if not np.array_equal(known.sum(axis=1), y):
            raise ValueError("y must hold the number of lobes that worn marks in each window, it does not")
        if self.kind == "network" and lobes_apart(known):
            raise ValueError("worn must hold rows of neighbours, use kind='trees' for other lobes")
        return known, np.asarray(of_windows("passage", passage, len(y)), dtype=float)

    # Trees

    def _fit_trees(
        self, lines: lobes.LobeLines, y: NDArray[Any], worn: Bool | None, begins: Float | None,
        folds: Folds, seed: int,
    ) -> Float:  # fmt: skip
        """Grow the trees; return logarithms of held-out probabilities, (n_opinions, n_windows, n_classes)."""
        features = self.lobe_map_.from_lines(lines)
        trees = CountingTrees(self.n_trees, random_state=self.random_state)
        by_map = held_out_proba(trees, features, y, self.classes_, folds)
        self.count_trees_ = trees.fit(features, y)
        if worn is None or begins is None or worn.min() == worn.max():
            self.pattern_ = "consecutive"
            return safe_log(by_map)[np.newaxis]
        if self.pattern_ == "consecutive":
            trees = CountingTrees(
                _LOBE_TREES, min_samples_leaf=3, max_features=0.5, random_state=self.random_state
            )
            self.lobe_trees_ = trees.fit(coarse_views(lines.lines, begins, self.n_lobes), worn.ravel())
            return safe_log(by_map)[np.newaxis]
        every = np.arange(len(y))
        self.lobe_trees_ = self._grow_lobe_trees(lines.lines, begins, worn, every, seed)
        known, anywhere = np.full((2, *worn.shape), np.nan)
        for train, test in folds:
            trees = self._grow_lobe_trees(lines.lines, begins, worn, train, seed)
            known[test] = lobe_logits(trees, lines.lines[test], begins[test], self.n_lobes)[0]
            anywhere[test] = logits_anywhere(trees, lines.lines[test], self.n_lobes)
        self.lobe_calibration_ = platt_calibration(known, worn)
        return np.stack([safe_log(by_map), self._log_counts_by_lobe(self._calibrate(anywhere))])

    def _grow_lobe_trees(
        self, lines: Complex, begins: Float, worn: Bool, rows: NDArray[np.intp], seed: int
    ) -> CountingTrees:
        """Grow trees that judge lobes one by one, on some of the windows."""
        trees = CountingTrees(_LOBE_TREES, min_samples_leaf=3, max_features=0.3, random_state=seed)
        return trees.fit(*views_to_learn(lines[rows], begins[rows], worn[rows], seed))

    def _calibrate(self, logits: Float) -> Float:
        """Return calibrated probabilities of lobes."""
        assert self.lobe_calibration_ is not None
        intercept, slope = self.lobe_calibration_
        return np.asarray(expit(np.clip(intercept + slope * logits, -_SURE, _SURE)))

    def _log_counts_by_lobe(self, lobe_proba: Float) -> Float:
        """Return the logarithm of the probability of each count, if lobes are independent."""
        counts = log_counts(logit(lobe_proba))[:, self.classes_.astype(int)]
        return safe_log(softmax(counts, axis=-1))

    # Networks

    def _fit_networks(
        self, lines: Complex, y: NDArray[Any], rank: Int, worn: Bool | None, begins: Float | None,
        folds: Folds, seed: int,
    ) -> Float:  # fmt: skip
        """Train the networks; return the held-out opinions of the count, (4, n_windows, n_classes)."""
        if worn is not None and begins is not None:
            first: Int = row_starts(worn).argmax(axis=1)
        else:
            counts = y.astype(float) if y.dtype.kind in "iuf" else rank.astype(float)
            begins = np.zeros(len(y))
            if lines.shape[1] >= self.n_lobes:
                phase = np.angle(lines[:, self.n_lobes - 1]) / (2 * np.pi)
                begins = np.asarray((_MESH_PHASE - phase) % 1.0 / self.n_lobes)
            centre = lobes.energy_centre(lobes.fold(lobes.shift(lines, begins), self.n_lobes))
            first = np.round(centre * self.n_lobes - counts / 2).astype(np.int64) % self.n_lobes
        # The number of each window's length; sound discs have no row, theirs is -1.
        length = np.where(self._sound, -1, np.cumsum(~self._sound) - 1)[rank]
        begins = begins + first / self.n_lobes
        every = np.arange(len(rank))
        self.networks_ = [
            train_network(
                lines[rows], length[rows], begins[rows], n_lobes=self.n_lobes,
                n_lengths=int((~self._sound).sum()), n_epochs=self.n_epochs, random_state=seed + number,
            )
            for number, (rows, _) in enumerate(folds or [(every, every)])
        ]  # fmt: skip
        logs = np.full((rank.size, self.classes_.size), np.nan)
        for network, (_, rows) in zip(self._single_precision, folds, strict=False):
            logs[rows] = self._log_counts([network], lines[rows])
        return self._row_opinions(logs)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what follows from the networks."""
        state = super().__getstate__()
        return {name: value for name, value in state.items() if name != "_single_precision"}

    @cached_property
    def _single_precision(self) -> list[Weights]:
        """Networks in single precision, in which numpy is fast; files hold half precision only."""
        return [
            {name: values.astype(np.float32) for name, values in network.items()}
            for network in self.networks_
        ]

    @property
    def _sound(self) -> Bool:
        """Mark the class of a sound disc, where there is one."""
        is_number = self.classes_.dtype.kind in "iuf"
        return np.asarray(self.classes_ == 0) if is_number else np.zeros(self.classes_.size, dtype=bool)

    def _log_rows(self, network: Weights, lines: Complex, n_places: int) -> tuple[Float, Float]:
        """Return the log odds of each class with a row at each place, and of a sound disc.

        Shapes are (n_windows, n_lobes * n_places, n_classes), where the class of a sound disc has zeros, and
        (n_windows,).
        """
        turns = place_turns(self.n_lobes, lines.shape[1], n_places)
        rows, sound = log_odds(np, network, lines.astype(np.complex64), turns)
        logs = np.zeros((*rows.shape[:2], self.classes_.size))
        logs[..., ~self._sound] = rows
        return logs, sound

    def _log_counts(self, networks: Sequence[Weights], lines: Complex) -> Float:
        """Return the log odds of each class against no row, (n_windows, n_classes), means over the networks.

        The mean is taken after the sum over the places. The sum of one network holds the peaks of its own
        noise, on which probabilities are calibrated; means at each place have lower peaks.
        """
        logs = np.zeros((len(lines), self.classes_.size))
        for k in range(0, len(logs), _BLOCK):
            answers = [self._log_rows(network, lines[k : k + _BLOCK], PLACES) for network in networks]
            logs[k : k + _BLOCK] = np.mean(
                [logsumexp(rows, axis=1) - sound[:, np.newaxis] for rows, sound in answers], axis=0
            )
        logs[:, self._sound] = 0.0
        return logs

    def _row_opinions(self, logs: Float) -> Float:
        """Return the log-probability terms to pool: of a row, of its length, and of no row."""
        sound = np.broadcast_to(self._sound.astype(float), logs.shape)
        total = logsumexp(logs[:, ~self._sound], axis=1, keepdims=True)
        any_row = np.where(self._sound, 0.0, np.clip(total, _LEAST_LOG, -_LEAST_LOG))
        length = np.where(self._sound, 0.0, np.maximum(logs - total, _LEAST_LOG))
        return np.stack([any_row, length, sound, -sound])
