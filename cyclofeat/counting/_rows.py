"""Counter of rows of neighbouring worn lobes: where a row begins, and how long it is."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp
from sklearn.ensemble import BaggingClassifier
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from cyclofeat._base.sklearn_private import Interval, fit_context
from cyclofeat.counting._assembly_folds import (
    Float,
    Int,
    assemblies_of,
    drawn_seed,
    grouped_folds,
    of_windows,
)
from cyclofeat.counting._base import Counter
from cyclofeat.counting._combine import learn_dependence
from cyclofeat.counting._lobe_map import held_lobe_map
from cyclofeat.counting._lobe_network import begins_by_mesh
from cyclofeat.counting._lobe_sets import Bool
from cyclofeat.counting._pooling import pool_weights, pooled, softmax
from cyclofeat.counting.scores import shares
from cyclofeat.features import LobeMap
from cyclofeat.signal import lobes
from cyclofeat.signal.windows import Complex

# Places within a lobe at which a row is looked for, where no tachometer says where lobes pass.
_PLACES = 8
# Places between two lobes whose views are examples of what is no beginning of a row.
_BESIDE = (0.25, 0.5, 0.75)
# Share of the views at lobes that are such examples too, and of each of those between lobes.
_SHARE_AT, _SHARE_BESIDE = 0.3, 0.075
# Share of an input turn over which the autoregressive model reaches: the resonance of rotor and torque meter
# is one pair of its poles, the others follow the slope of the spectrum. A longer one would take out the
# pattern of the worn lobes as well.
_AR_TURNS = 1 / 16
# Networks whose probabilities are averaged.
_N_NETWORKS = 3
# Windows learned from, with their variants; least and largest number of variants of each, itself included.
_N_LEARNED, _LEAST_VARIANTS, _MOST_VARIANTS = 25_600, 2, 8
# Standard deviations of a variant: gain in dB and phase in rad of each smooth term over the lobe lines, shift
# as a share of a lobe. Number of terms.
_GAIN_DB, _PHASE, _SHIFT, _N_TERMS = 2.0, 0.2, 0.05, 4
# Lower lobe lines hold the brake's drift.
_LOWEST_LINE = 3
# Logarithms of probabilities are limited to this.
_LEAST_LOG = -12.0
# Windows whose places are tried at once, to limit the memory.
_BLOCK = 256


@dataclass(eq=False, repr=False)
class RowCounter(Counter):
    """Counter of neighbouring worn lobes, from the lobe lines seen from each lobe.

    The complex lobe lines of a window (:mod:`cyclofeat.signal.lobes`), turned until a given lobe comes first,
    are one *view* of the disc. One small network tells whether a row of worn lobes begins at the first lobe
    of a view. Another tells how long a row is that begins there. What is learned at one lobe holds for all.
    The probability of a count is the sum over all beginnings; that of each lobe follows from the same terms.

    The machine to be counted is none of those in training. So the networks also learn from variants of each
    window, whose lobe lines have another gain and phase, smooth over the lines, as behind another rotor and
    torque meter.

    Parameters
    ----------
    sampling_rate : float
        Samples per second of the windows, in Hz.
    input_speed_hz : float, default=500/60
        Nominal input speed in turns per second.
    n_lobes : int, default=15
        Number of lobes of a disc.
    n_epochs : int, default=20
        Times that the first network learns from all its views. The second learns twice as often.
    n_splits : int, default=5
        Folds by assembly on which probabilities are calibrated; less where a class has fewer assemblies, and
        none for less than 2.
    random_state : int or None, default=0
        Seed of the networks and folds.
    speed_tolerance : float, default=0.015
        As of :class:`~cyclofeat.features.LobeMap`; 0 for windows over the angle of the shaft.

    Attributes
    ----------
    classes_ : ndarray, shape (n_classes,)
        Counts in training, in order.
    calibrated_ : bool
        Whether there were enough assemblies to hold some out.
    dependence_ : float or None
        As of :class:`GroupCalibratedCounter`.
    weights_ : ndarray, shape (4,)
        Powers of the odds of a row and of the probabilities of its length, and log odds for and against a
        sound disc, learned on held-out assemblies.
    networks_ : list of Pipeline
        Scaling, then three networks with equal votes: of beginnings and of lengths. The second is missing
        where all worn windows have one count.
    lobe_map_ : LobeMap

    Notes
    -----
    Counting needs no tachometer: a row is looked for at eight places within each lobe, and the first network
    is trained on views from between two lobes too.

    Where training does not know the worn lobes (``worn`` not given) a row is taken to lie about the centre of
    the fold's energy. Counts are then less accurate, and positions are not reliable.

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
    >>> counter = RowCounter(sampling_rate=25_600).fit(torque, counts, worn, passage=np.zeros(36))
    >>> counter.predict(torque[:3])
    array([0, 2, 4])
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "sampling_rate": [Interval(Real, 0, None, closed="neither")],
        "input_speed_hz": [Interval(Real, 0, None, closed="neither")],
        "n_lobes": [Interval(Integral, 3, 44, closed="both")],
        "n_epochs": [Interval(Integral, 1, None, closed="left")],
        "n_splits": [Interval(Integral, 0, None, closed="left")],
        "random_state": ["random_state"],
        "speed_tolerance": [Interval(Real, 0, 0.2, closed="left")],
    }

    sampling_rate: float
    input_speed_hz: float = 500 / 60
    n_lobes: int = 15
    n_epochs: int = 20
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
            If there is one class only, shapes do not match, ``worn`` is given without ``passage``, or holds
            lobes that are no row of neighbours.
        """
        windows, labels, rank = self._labelled(X, y)
        member = assemblies_of(groups, len(windows))
        seed = drawn_seed(self.random_state)
        self.lobe_map_: LobeMap = held_lobe_map(
            self.sampling_rate, self.input_speed_hz, self.n_lobes, self.speed_tolerance
        )
        rate = lobes.whitened_rate(
            self.sampling_rate, self.input_speed_hz, self.n_lobes, self.lobe_map_.n_lines
        )
        self.lobe_map_.set_params(ar_order=round(_AR_TURNS * rate / self.input_speed_hz)).fit(windows)
        lines = self.lobe_map_.lines(windows).lines
        begins, first = self._rows(lines, labels, rank, worn, passage)
        folds = grouped_folds(rank, member, self.n_splits, seed) if self.n_splits >= 2 else []
        self.networks_ = self._trained(lines, rank, begins, first, seed)
        self.calibrated_ = bool(folds)
        self.weights_: Float = np.array([1.0, 1.0, 0.0, 0.0])
        self.dependence_: float | None = None
        if folds:
            held_out = np.full((rank.size, self.classes_.size), np.nan)
            for train, test in folds:
                networks = self._trained(lines[train], rank[train], begins[train], first[train], seed)
                held_out[test] = self._log_counts(networks, lines[test])
            known = np.isfinite(held_out).all(axis=1)
            opinions, rank, member = self._opinions(held_out[known]), rank[known], member[known]
            weights = shares(np.unique(member, return_inverse=True)[1])
            self.weights_ = pool_weights(opinions, rank, weights, np.unique(member).size)
            self.dependence_ = learn_dependence(pooled(opinions, self.weights_), rank, member)
        return self

    def predict_proba(self, X: ArrayLike) -> Float:
        """Calibrated probability of each count, shape (n_windows, n_classes), of windows as for ``fit``."""
        windows = self._windows(X)
        return self.proba_of_lines(self.lobe_map_.lines(windows))

    def proba_of_lines(self, lines: lobes.LobeLines) -> Float:
        """Return what :meth:`predict_proba` does, of windows whose lobe lines are at hand."""
        return pooled(self._opinions(self._log_counts(self.networks_, lines.lines)), self.weights_)

    def _from_lines(self, found: lobes.LobeLines, passage: ArrayLike, proba: Float | None = None) -> Float:
        """Return the probability that each lobe is worn, from given lobe lines, and of counts if at hand."""
        begins = np.asarray(of_windows("passage", passage, len(found.lines)), dtype=float)
        by_place = self._log_rows(self.networks_, found.lines, [begins])
        first = softmax(by_place.transpose(0, 2, 1))  # of each class
        proba = self.proba_of_lines(found) if proba is None else proba
        worn = np.zeros(first.shape[::2])
        for k in np.flatnonzero(~self._sound):
            for j in range(min(int(self.classes_[k]), self.n_lobes)):
                worn += proba[:, [k]] * np.roll(first[:, k], j, axis=1)
        return np.asarray(np.clip(worn, 0.0, 1.0))

    @property
    def _sound(self) -> Bool:
        """Mark the class of a sound disc, where there is one."""
        is_number = self.classes_.dtype.kind in "iuf"
        return np.asarray(self.classes_ == 0) if is_number else np.zeros(self.classes_.size, dtype=bool)

    def _rows(
        self, lines: Complex, y: NDArray[Any], rank: Int, worn: ArrayLike | None, passage: ArrayLike | None
    ) -> tuple[Float, Int]:
        """Return where slots begin, as a share of the fold, and the first worn lobe of each window."""
        if worn is not None:
            if passage is None:
                raise ValueError(
                    "passage must be given together with worn: it says when the lobes pass, got None"
                )
            known: Bool = np.asarray(worn, dtype=bool)
            if known.shape != (len(y), self.n_lobes):
                raise ValueError(
                    f"worn must have shape (n_windows, n_lobes) = {(len(y), self.n_lobes)}, got {known.shape}"
                )
            starts = known & ~np.roll(known, 1, axis=1)
            if (starts.sum(axis=1) > 1).any():
                raise ValueError("worn must hold rows of neighbours, use LobeCounter for other lobes")
            return np.asarray(of_windows("passage", passage, len(y)), dtype=float), starts.argmax(axis=1)
        counts = y.astype(float) if y.dtype.kind in "iuf" else rank.astype(float)
        begins = begins_by_mesh(lines, self.n_lobes) if lines.shape[1] >= self.n_lobes else np.zeros(len(y))
        centre = lobes.energy_centre(lobes.fold(lobes.shift(lines, begins), self.n_lobes))
        return begins, np.round(centre * self.n_lobes - counts / 2).astype(np.int64) % self.n_lobes

    def _trained(self, lines: Complex, rank: Int, begins: Float, first: Int, seed: int) -> list[Pipeline]:
        """Train the networks of beginnings and of lengths."""
        random = np.random.default_rng(seed)
        row = ~self._sound[rank]
        begin = row[:, np.newaxis] & (np.arange(self.n_lobes) == first[:, np.newaxis])
        rows: list[Float] = []
        others: list[Float] = []
        n_variants = int(np.clip(_N_LEARNED // len(rank), _LEAST_VARIANTS, _MOST_VARIANTS))
        for variant in range(n_variants):
            seen = _varied(lines, self.n_lobes, random) if variant else lines
            at = _views(seen, begins, self.n_lobes)
            rows.append(at[row, first[row]])
            others.append(at[~begin & (random.random(begin.shape) < _SHARE_AT)])
            for place in _BESIDE:
                beside = _views(seen, begins + place / self.n_lobes, self.n_lobes)
                others.append(beside[random.random(begin.shape) < _SHARE_BESIDE])
        examples = np.concatenate(rows + others)
        n_rows = n_variants * int(row.sum())
        is_row = np.arange(len(examples)) < n_rows
        networks = [_network((64,), 0.1, self.n_epochs, examples, is_row, seed)]
        if np.unique(rank[row]).size > 1:
            lengths = np.tile(rank[row], n_variants)
            networks.append(_network((128, 64), 1.0, 2 * self.n_epochs, examples[:n_rows], lengths, seed))
        return networks

    def _log_rows(self, networks: list[Pipeline], lines: Complex, begins: Sequence[Float]) -> Float:
        """Return the log odds of each class with a row at each place, (n_windows, n_places, n_classes).

        Places are the lobes, with slots from each of ``begins`` on. Zero for the class of a sound disc.
        """
        at = np.concatenate([_views(lines, one, self.n_lobes) for one in begins], axis=1)
        views = at.reshape(-1, at.shape[-1])
        is_row = _log_proba(networks[0], views, np.array([False, True]))
        logs = np.zeros((len(views), self.classes_.size))
        worn = np.flatnonzero(~self._sound)
        if len(networks) > 1:
            logs[:, worn] = _log_proba(networks[1], views, worn)
        logs[:, worn] += (is_row[:, 1] - is_row[:, 0])[:, np.newaxis]
        return logs.reshape(*at.shape[:2], -1)

    def _log_counts(self, networks: list[Pipeline], lines: Complex) -> Float:
        """Return the log odds of each class over no row, (n_windows, n_classes)."""
        logs = np.zeros((len(lines), self.classes_.size))
        worn = ~self._sound
        for k in range(0, len(logs), _BLOCK):
            block = lines[k : k + _BLOCK]
            turns = np.arange(_PLACES) / (_PLACES * self.n_lobes)
            by_place = self._log_rows(networks, block, [np.full(len(block), turn) for turn in turns])
            logs[k : k + _BLOCK, worn] = logsumexp(by_place[..., worn], axis=1)
        return logs

    def _opinions(self, logs: Float) -> Float:
        """Return what is pooled: odds of a row, probabilities of its length, and one for and against none."""
        sound = np.broadcast_to(self._sound.astype(float), logs.shape)
        total = logsumexp(logs[:, ~self._sound], axis=1, keepdims=True)
        any_row = np.where(self._sound, 0.0, np.clip(total, _LEAST_LOG, -_LEAST_LOG))
        length = np.where(self._sound, 0.0, np.maximum(logs - total, _LEAST_LOG))
        return np.stack([any_row, length, sound, -sound])


def _views(lines: Complex, begins: Float, n_lobes: int) -> Float:
    """Return the lobe lines seen from each lobe, of unit power: (n_windows, n_lobes, 2 n_lines)."""
    number = np.arange(min(_LOWEST_LINE, lines.shape[1]), lines.shape[1] + 1)
    kept = lines[:, number - 1].astype(np.complex64)
    power = np.sqrt((np.abs(kept) ** 2).sum(axis=1))
    scale = np.where(power > 0, power, 1)[:, np.newaxis, np.newaxis]
    turns = begins[:, np.newaxis] + np.arange(n_lobes) / n_lobes
    turned = np.exp(2j * np.pi * turns[..., np.newaxis] * number).astype(np.complex64)
    seen = kept[:, np.newaxis] * turned
    return np.concatenate([seen.real, seen.imag], axis=2) / scale


def _varied(lines: Complex, n_lobes: int, random: np.random.Generator) -> Complex:
    """Return lobe lines as another machine might show them: gain and phase changed smoothly, and a shift."""
    n_windows, n_lines = lines.shape
    term = np.arange(1, _N_TERMS + 1)[:, np.newaxis]
    smooth = np.cos(np.pi * term * np.arange(1, n_lines + 1) / n_lines) / term
    gain = 10 ** (_GAIN_DB / 20 * random.normal(size=(n_windows, _N_TERMS)) @ smooth)
    phase = random.normal(size=(n_windows, 1)) + random.normal(size=(n_windows, _N_TERMS)) @ smooth
    turns: Float = random.normal(0.0, _SHIFT / n_lobes, size=(n_windows,))
    return lobes.shift(lines * gain * np.exp(1j * _PHASE * phase), turns)


def _network(
    hidden: tuple[int, ...], alpha: float, n_epochs: int, views: Float, target: NDArray[Any], seed: int
) -> Pipeline:
    network = MLPClassifier(hidden, alpha=alpha, batch_size=min(200, len(views)), max_iter=n_epochs)
    voting = BaggingClassifier(network, n_estimators=_N_NETWORKS, bootstrap=False, random_state=seed)
    pipeline = make_pipeline(StandardScaler(), voting)
    with warnings.catch_warnings():
        # A fixed number of epochs: at convergence the network would overfit.
        warnings.simplefilter("ignore", ConvergenceWarning)
        pipeline.fit(views, target)
    for fitted in voting.estimators_:
        # What training needs alone is two thirds of a file.
        vars(fitted).pop("_optimizer", None)
    return pipeline


def _log_proba(network: Pipeline, views: Float, classes: NDArray[Any]) -> Float:
    """Return log probabilities, one column for each class; the least of those not in training."""
    logs = np.full((len(views), classes.size), _LEAST_LOG)
    seen = np.flatnonzero(np.isin(classes, network.classes_))
    logs[:, seen] = np.log(np.maximum(_votes(network, views), np.exp(_LEAST_LOG)))
    return logs


def _votes(network: Pipeline, views: Float) -> Float:
    """Return ``network.predict_proba(views)``, without checks that take longer than a window's answer."""
    scaling, voting = network[0], network[1]
    scaled = ((views - scaling.mean_) / scaling.scale_).astype(views.dtype)
    return np.asarray(np.mean([_answer(one, scaled) for one in voting.estimators_], axis=0))


def _answer(network: MLPClassifier, views: Float) -> Float:
    *hidden, last = zip(network.coefs_, network.intercepts_, strict=True)
    for weights, bias in hidden:
        views = np.maximum(views @ weights + bias, 0)
    odds = views @ last[0] + last[1]
    # Of two classes, the network tells the odds of the second.
    return softmax(odds if odds.shape[1] > 1 else np.hstack([np.zeros_like(odds), odds]))
