"""Counter of rows of neighbouring worn lobes: where a row begins, and how long it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logsumexp, softmax

from cyclofeat._base.sklearn_private import Interval, fit_context
from cyclofeat.counting.calibration.pooling import learn_dependence, pool_opinions, pool_weights
from cyclofeat.counting.estimators._counter import Counter
from cyclofeat.counting.estimators._lobe_map import held_lobe_map
from cyclofeat.counting.estimators._lobe_network import begins_by_mesh
from cyclofeat.counting.estimators._row_network import (
    PLACES,
    Weights,
    log_odds,
    train,
    turns_of_places,
)
from cyclofeat.counting.estimators.lobe_locator import known_lobes
from cyclofeat.counting.estimators.lobe_sets import Bool
from cyclofeat.counting.evaluation.assembly_folds import (
    Float,
    Int,
    assemblies_of,
    drawn_seed,
    grouped_folds,
    of_windows,
)
from cyclofeat.counting.evaluation.scores import window_weights
from cyclofeat.features import LobeMap
from cyclofeat.signal import lobes
from cyclofeat.signal.windows import Complex

# Share of an input turn over which the autoregressive model reaches: the resonance of rotor and torque meter
# is one pair of its poles, the others follow the slope of the spectrum. A longer one would take out the
# pattern of the worn lobes as well.
_AR_TURNS = 1 / 16
# Logarithms of probabilities are limited to this.
_LEAST_LOG = -12.0
# Windows whose places are tried at once, to limit the memory.
_BLOCK = 256


@dataclass(eq=False, repr=False)
class RowCounter(Counter):
    """Counter of neighbouring worn lobes, from the lobe lines seen from each lobe.

    The complex lobe lines of a window (``cyclofeat.signal.lobes``), turned until a given lobe comes first,
    are one *view* of the disc. A network tells how probable a row of each length is that begins at the first
    lobe of a view. What is learned at one lobe holds for all. The probability of a count is the sum over all
    beginnings; that of each lobe follows from the same terms.

    The machine to be counted is none of those in training. So the network learns from variants of each
    window, whose lobe lines have another gain and phase, smooth over the lines, as behind another rotor and
    torque meter; some also have noise or the impacts of a neighbouring machine.

    Parameters
    ----------
    sampling_rate : float
        Samples per second of the windows, in Hz.
    input_speed_hz : float, default=500/60
        Nominal input speed in turns per second.
    n_lobes : int, default=15
        Number of lobes of a disc.
    n_lines : int, default=44
        Lobe lines that are used, where windows hold as many. More tell counts better apart at low speeds,
        where the disturbance of a lobe is short.
    n_epochs : int, optional
        Times that a network sees each window, in other variants. Default: 40, and more where windows are few,
        so that it learns from 600 batches at least.
    n_splits : int, default=3
        Folds by assembly, less where a class has fewer assemblies. One network is trained without each, and
        probabilities are calibrated on what it says of the windows held out; all of them answer together.
        For less than 2 one network learns from all windows, and nothing is calibrated.
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
    networks_ : list of dict from str to ndarray
        Weights of the networks.
    oob_decision_function_ : ndarray, shape (n_windows, n_classes)
        Probabilities of each window in training by the network that did not see its assembly. NaN without
        folds. Copies and files do not hold it.
    lobe_map_ : LobeMap

    Notes
    -----
    Training needs JAX and Optax (the extra ``prepare``); answers need numpy alone.

    Counting needs no tachometer: a row is looked for at four places within each lobe, and a network is
    trained on windows that begin anywhere.

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
    >>> counter = RowCounter(sampling_rate=25_600, n_epochs=50)
    >>> counter = counter.fit(torque, counts, worn, passage=np.zeros(36))
    >>> counter.predict(torque[:3])
    array([0, 2, 4])
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "sampling_rate": [Interval(Real, 0, None, closed="neither")],
        "input_speed_hz": [Interval(Real, 0, None, closed="neither")],
        "n_lobes": [Interval(Integral, 3, 44, closed="both")],
        "n_lines": [Interval(Integral, lobes.FEWEST_LINES, None, closed="left")],
        "n_epochs": [Interval(Integral, 1, None, closed="left"), None],
        "n_splits": [Interval(Integral, 0, None, closed="left")],
        "random_state": ["random_state"],
        "speed_tolerance": [Interval(Real, 0, 0.2, closed="left")],
    }

    sampling_rate: float
    input_speed_hz: float = 500 / 60
    n_lobes: int = 15
    n_lines: int = lobes.N_LINES
    n_epochs: int | None = None
    n_splits: int = 3
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
        """Fit as :meth:`LobeCounter.fit` does, to worn lobes that are neighbours.

        Raises
        ------
        ImportError
            If JAX or Optax is not installed.
        ValueError
            As of :meth:`LobeCounter.fit`, and if ``worn`` holds lobes that are no row of neighbours.
        """
        windows, labels, rank = self._labelled(X, y)
        member = assemblies_of(groups, len(windows))
        seed = drawn_seed(self.random_state)
        self.lobe_map_: LobeMap = held_lobe_map(
            self.sampling_rate, self.input_speed_hz, self.n_lobes, self.speed_tolerance, self.n_lines
        )
        rate = lobes.whitened_rate(
            self.sampling_rate, self.input_speed_hz, self.n_lobes, self.lobe_map_.n_lines
        )
        self.lobe_map_.set_params(ar_order=round(_AR_TURNS * rate / self.input_speed_hz)).fit(windows)
        lines = self.lobe_map_.lines(windows).lines
        begins, first = self._rows(lines, labels, rank, worn, passage)
        folds = grouped_folds(rank, member, self.n_splits, seed) if self.n_splits >= 2 else []
        # The number of each window's length; sound discs have no row, theirs is -1.
        length = np.where(self._sound, -1, np.cumsum(~self._sound) - 1)[rank]
        begins = begins + first / self.n_lobes
        every = np.arange(len(rank))
        self.calibrated_ = bool(folds)
        self.__dict__.pop("_answering", None)  # of an earlier fit
        self.networks_: list[Weights] = [
            train(
                lines[rows], length[rows], begins[rows], n_lobes=self.n_lobes,
                n_lengths=int((~self._sound).sum()), n_epochs=self.n_epochs, random_state=seed + number,
            )
            for number, (rows, _) in enumerate(folds or [(every, every)])
        ]  # fmt: skip
        self.weights_: Float = np.array([1.0, 1.0, 0.0, 0.0])
        self.dependence_: float | None = None
        self.oob_decision_function_: Float = np.full((rank.size, self.classes_.size), np.nan)
        if folds:
            held_out = np.full_like(self.oob_decision_function_, np.nan)
            for network, (_, rows) in zip(self._answering, folds, strict=True):
                held_out[rows] = self._log_counts([network], lines[rows])
            known = np.isfinite(held_out).all(axis=1)
            opinions, rank, member = self._opinions(held_out[known]), rank[known], member[known]
            weights = window_weights(np.unique(member, return_inverse=True)[1])
            self.weights_ = pool_weights(opinions, rank, weights, np.unique(member).size)
            self.oob_decision_function_[known] = pool_opinions(opinions, self.weights_)
            self.dependence_ = learn_dependence(self.oob_decision_function_[known], rank, member)
        return self

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in super().__getstate__().items() if name != "_answering"}

    @cached_property
    def _answering(self) -> list[Weights]:
        """Networks in single precision, in which numpy is fast; files hold half precision only."""
        return [
            {name: values.astype(np.float32) for name, values in network.items()}
            for network in self.networks_
        ]

    def predict_proba(self, X: ArrayLike) -> Float:
        """Calibrated probability of each count, shape (n_windows, n_classes), of windows as for ``fit``."""
        windows = self._windows(X)
        return self.proba_of_lines(self.lobe_map_.lines(windows))

    def proba_of_lines(self, lines: lobes.LobeLines) -> Float:
        """Return what :meth:`predict_proba` does, of windows whose lobe lines are at hand."""
        return pool_opinions(self._opinions(self._log_counts(self._answering, lines.lines)), self.weights_)

    def _from_lines(self, found: lobes.LobeLines, passage: ArrayLike, proba: Float | None = None) -> Float:
        """Return the probability that each lobe is worn, from given lobe lines, and of counts if at hand."""
        begins = np.asarray(of_windows("passage", passage, len(found.lines)), dtype=float)
        at_lobes = lobes.shift(found.lines, begins)
        # Of each class, where its row begins.
        rows = np.mean([self._log_rows(network, at_lobes, 1)[0] for network in self._answering], axis=0)
        first = softmax(rows.transpose(0, 2, 1), axis=-1)
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
            known, begins = known_lobes(worn, passage, len(y), self.n_lobes)
            starts = known & ~np.roll(known, 1, axis=1)
            if (starts.sum(axis=1) > 1).any():
                raise ValueError("worn must hold rows of neighbours, use LobeCounter for other lobes")
            return begins, starts.argmax(axis=1)
        counts = y.astype(float) if y.dtype.kind in "iuf" else rank.astype(float)
        begins = begins_by_mesh(lines, self.n_lobes) if lines.shape[1] >= self.n_lobes else np.zeros(len(y))
        centre = lobes.energy_centre(lobes.fold(lobes.shift(lines, begins), self.n_lobes))
        return begins, np.round(centre * self.n_lobes - counts / 2).astype(np.int64) % self.n_lobes

    def _log_rows(self, network: Weights, lines: Complex, n_places: int) -> tuple[Float, Float]:
        """Return the log odds of each class with a row at each place, and of a sound disc.

        Shapes are (n_windows, n_lobes * n_places, n_classes), where the class of a sound disc has zeros, and
        (n_windows,).
        """
        turns = turns_of_places(self.n_lobes, lines.shape[1], n_places)
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

    def _opinions(self, logs: Float) -> Float:
        """Return what is pooled: odds of a row, probabilities of its length, and one for and against none."""
        sound = np.broadcast_to(self._sound.astype(float), logs.shape)
        total = logsumexp(logs[:, ~self._sound], axis=1, keepdims=True)
        any_row = np.where(self._sound, 0.0, np.clip(total, _LEAST_LOG, -_LEAST_LOG))
        length = np.where(self._sound, 0.0, np.maximum(logs - total, _LEAST_LOG))
        return np.stack([any_row, length, sound, -sound])
