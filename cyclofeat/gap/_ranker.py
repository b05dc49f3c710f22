"""What is missing: names for a disagreement, with look-alikes and the measurement that tells them apart."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any, ClassVar, Self

import joblib
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.sparse.csgraph import connected_components
from sklearn.base import BaseEstimator
from sklearn.covariance import LedoitWolf
from sklearn.decomposition import PCA
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.model_selection import StratifiedKFold, cross_val_predict
from sklearn.utils.validation import check_is_fitted

from cyclofeat._files import write_whole
from cyclofeat._sklearn import Interval, fit_context
from cyclofeat.gap._locator import GapLocator
from cyclofeat.gap._null import NuisancePrior, cache_key, record
from cyclofeat.gap._summaries import summarise
from cyclofeat.simulators import CompositeSimulator, CycloidalGearbox, Effect, Rig, effect_library

Float = NDArray[np.float64]

NONE = "none"
_TIE = 0.2  # symmetric share of confusion from which two effects count as look-alikes
_COMPONENTS = 12
_FOLDS = 5


@dataclass(frozen=True)
class Ranked:
    """One effect in the order of its probability.

    Attributes
    ----------
    effect_id : str
    summary : str
        What the effect is, in one line.
    probability : float
        Among the effects of the library, given that something is missing.
    look_alikes : tuple of str
        Effects that these measurements cannot tell from it.
    next_measurement : str
        What would tell it from them.
    """

    effect_id: str
    summary: str
    probability: float
    look_alikes: tuple[str, ...]
    next_measurement: str


class EffectRanker(BaseEstimator):
    """Which effect of the library would explain a disagreement?

    ``fit`` simulates each effect many times, its parameters drawn from their priors, under the same prior of
    what differs anyway, and learns what each does to the summaries. ``rank`` names what a
    :class:`GapLocator` has found.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    simulator : CompositeSimulator, Rig or CycloidalGearbox, optional
        The model, as given to the locator.
    nuisance : NuisancePrior, optional
    library : sequence of str, optional
        Effects that are considered, of :func:`cyclofeat.simulators.effect_library`. Default: all that fit
        the model (no second brake).
    input_speed_hz : float, default=500 / 60
    duration_s : float, default=1.8
        Length of the simulated recordings; the measured ones' should be the same.
    n_draws : int, default=40
        Sets of recordings per effect.
    n_recordings : int, default=3
        Recordings in a set, with the same parameters.
    counts : sequence of int, optional
        Counts of worn lobes in a set, gone through in turn. Default: those of the prior.
    n_trees : int, default=400
    random_state : int, default=0
    n_jobs : int, default=1
    cache : path, optional
        Folder in which the table is kept.

    Attributes
    ----------
    classes_ : list of str
        Effects, and ``"none"``.
    confusion_ : ndarray, shape (n_classes, n_classes)
        Shares of out-of-fold names by true effect, rows adding up to one.
    temperature_ : float
        By which the forest's votes are sharpened so that they become probabilities out of fold.
    tie_groups_ : list of tuple of str
        Effects that are confused with each other in more than a fifth of the cases.
    ranking_, proba_, conformal_p_, unknown_, next_measurement_
        Set by :meth:`rank`.

    Notes
    -----
    Features are the summaries' mean deviations in standard deviations of one recording, on a logarithmic
    scale with sign. ``unknown_`` comes from a Gaussian per effect on their leading components: where the
    conformal p of every effect is below alpha, the library does not hold the effect. The probabilities are
    conditional on the library, and stay below one half where two look-alikes share them.

    Examples
    --------
    >>> ranker = EffectRanker(25_600, library=["hum", "offset"], n_draws=8, n_recordings=2)
    >>> ranker.fit().classes_
    ['hum', 'offset', 'none']
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "sampling_rate": [Interval(Real, 0, None, closed="neither")],
        "simulator": [CompositeSimulator, Rig, CycloidalGearbox, None],
        "nuisance": [NuisancePrior, None],
        "library": [list, tuple, None],
        "input_speed_hz": [Interval(Real, 0, None, closed="neither")],
        "duration_s": [Interval(Real, 0, None, closed="neither")],
        "n_draws": [Interval(Integral, _FOLDS, None, closed="left")],
        "n_recordings": [Interval(Integral, 1, None, closed="left")],
        "counts": [list, tuple, None],
        "n_trees": [Interval(Integral, 1, None, closed="left")],
        "random_state": [Interval(Integral, 0, None, closed="left")],
        "n_jobs": [Integral],
        "cache": [str, os.PathLike, None],
    }

    def __init__(
        self,
        sampling_rate: float,
        simulator: CompositeSimulator | Rig | CycloidalGearbox | None = None,
        nuisance: NuisancePrior | None = None,
        library: Sequence[str] | None = None,
        input_speed_hz: float = 500 / 60,
        duration_s: float = 1.8,
        n_draws: int = 40,
        n_recordings: int = 3,
        counts: Sequence[int] | None = None,
        n_trees: int = 400,
        random_state: int = 0,
        n_jobs: int = 1,
        cache: str | os.PathLike[str] | None = None,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.simulator = simulator
        self.nuisance = nuisance
        self.library = library
        self.input_speed_hz = input_speed_hz
        self.duration_s = duration_s
        self.n_draws = n_draws
        self.n_recordings = n_recordings
        self.counts = counts
        self.n_trees = n_trees
        self.random_state = random_state
        self.n_jobs = n_jobs
        self.cache = cache

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X: Any = None, y: Any = None) -> Self:
        """Simulate the table, or take it from the cache, and learn from it.

        Parameters
        ----------
        X, y : ignored
            The table is simulated.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If the library names an unknown effect.
        """
        nuisance = NuisancePrior() if self.nuisance is None else self.nuisance
        composite = nuisance.simulator(self.simulator)
        names = self._names(composite)
        self.classes_ = [*names, NONE]
        values, counts, self.spread_, self.count_means_ = self._table(composite, nuisance)
        labels = np.repeat(np.arange(len(self.classes_)), self.n_draws)
        means = np.array([self.count_means_[count] for count in counts])
        features = _scaled((values - means).mean(axis=1) / self.spread_)
        forest = ExtraTreesClassifier(
            self.n_trees, min_samples_leaf=2, random_state=self.random_state, n_jobs=self.n_jobs
        )
        folds = StratifiedKFold(_FOLDS, shuffle=True, random_state=self.random_state)
        votes = cross_val_predict(forest, features, labels, cv=folds, method="predict_proba")
        self.temperature_ = _temperature(votes, labels)
        self.forest_ = forest.fit(features, labels)
        found = votes.argmax(axis=1)
        self.confusion_ = np.zeros((len(self.classes_), len(self.classes_)))
        np.add.at(self.confusion_, (labels, found), 1 / self.n_draws)
        self.tie_groups_ = _ties(self.confusion_[:-1, :-1], names)
        self.typical_ = _Typical(features, labels, folds)
        return self

    def rank(self, locator: GapLocator) -> list[Ranked]:
        """Name what a fitted locator has found.

        Parameters
        ----------
        locator : GapLocator
            Fitted with the same model, prior, rate and window length.

        Returns
        -------
        list of Ranked
            Most probable first; also kept as ``ranking_``, with ``proba_`` (dict from effect to
            probability), ``conformal_p_`` (likewise), ``unknown_`` (bool) and ``next_measurement_``.

        Raises
        ------
        ValueError
            If the locator's summaries are others than the table's.
        """
        check_is_fitted(self)
        check_is_fitted(locator)
        if locator.measured_.shape[1] != len(self.spread_):
            raise ValueError(
                f"locator must have summaries of {len(self.spread_)} cells like the table, got "
                f"{locator.measured_.shape[1]}: same sampling_rate?"
            )
        # Against the locator's own bank: the measured counts are known there, or are those of the prior.
        simulated = locator.centred(locator.simulated_, locator.bank_.counts).mean(axis=0)
        difference = locator.centred(locator.measured_, locator.counts_).mean(axis=0) - simulated
        features = _scaled(difference / self.spread_)[np.newaxis]
        votes = _sharpened(self.forest_.predict_proba(features), self.temperature_)[0, :-1]
        votes = votes / votes.sum()
        names = self.classes_[:-1]
        self.proba_ = dict(zip(names, votes.tolist(), strict=True))
        p = self.typical_.conformal_p(features)[0, :-1]
        self.conformal_p_ = dict(zip(names, p.tolist(), strict=True))
        self.unknown_ = bool(p.max() < locator.alpha)
        kinds = effect_library()
        self.ranking_ = [
            Ranked(
                effect_id=names[k],
                summary=kinds[names[k]].summary(),
                probability=float(votes[k]),
                look_alikes=tuple(name for name in self._group(names[k]) if name != names[k]),
                next_measurement=kinds[names[k]].separated_by,
            )
            for k in np.argsort(-votes)
        ]
        self.next_measurement_ = self.ranking_[0].next_measurement
        return self.ranking_

    def _group(self, name: str) -> tuple[str, ...]:
        return next((group for group in self.tie_groups_ if name in group), (name,))

    def _names(self, composite: CompositeSimulator) -> list[str]:
        known = effect_library()
        if self.library is not None:
            unknown = [name for name in self.library if name not in known]
            if unknown or not self.library:
                raise ValueError(f"library must name effects of {', '.join(known)}, got {self.library!r}")
            return list(self.library)
        base = composite.base
        assert isinstance(base, Rig)
        braked = base.has_brake or any(effect.effect_id == "brake_rotor" for effect in composite.effects)
        return [name for name in known if not (braked and name == "brake_rotor")]

    def _table(
        self, composite: CompositeSimulator, nuisance: NuisancePrior
    ) -> tuple[Float, NDArray[np.int64], Float, dict[int, Float]]:
        """Summaries (n_sets, n_recordings, n_cells), counts of a set, one recording's spread, count means."""
        chosen = tuple(nuisance.defect_counts if self.counts is None else self.counts)
        counts = np.array([chosen[k % len(chosen)] for k in range(self.n_recordings)])
        n_null = max(10 * len(chosen), self.n_draws)
        file = None
        if self.cache is not None:
            file = Path(self.cache) / f"effects-{self._key(composite, nuisance)}.npz"
        if file is not None and file.exists():
            with np.load(file) as stored:
                values, null = stored["values"], stored["null"]
        else:
            work = joblib.Parallel(n_jobs=self.n_jobs)
            jobs = [(name, draw, counts) for name in self.classes_ for draw in range(self.n_draws)]
            jobs += [(NONE, self.n_draws + k, np.array([chosen[k % len(chosen)]])) for k in range(n_null)]
            found = work(joblib.delayed(self._summaries_of)(composite, nuisance, *job) for job in jobs)
            n_sets = len(self.classes_) * self.n_draws
            values, null = np.array(found[:n_sets]), np.vstack(found[n_sets:])
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
                write_whole(file, lambda stream: np.savez(stream, values=values, null=null))
        of_null = np.array([chosen[k % len(chosen)] for k in range(n_null)])
        means = {int(count): null[of_null == count].mean(axis=0) for count in set(chosen)}
        spread = (null - np.array([means[int(c)] for c in of_null])).std(axis=0, ddof=len(set(chosen)))
        return values, counts, np.maximum(spread, 1e-6), means

    def _summaries_of(
        self, composite: CompositeSimulator, nuisance: NuisancePrior, name: str, draw: int, counts: Any
    ) -> Float:
        """Summaries of one set: the same effect with the same parameters in all its recordings."""
        stream = np.random.SeedSequence([self.random_state, *name.encode()], spawn_key=(draw,))
        for_effect, *for_runs = stream.spawn(1 + len(counts))
        effects: list[Effect] = []
        if name != NONE:
            effects = [effect_library()[name]().draw_parameters(np.random.default_rng(for_effect))]
        base = composite.base
        assert isinstance(base, Rig)
        simulator = CompositeSimulator(base, (*composite.effects, *effects))
        n_samples = round(self.duration_s * self.sampling_rate)
        torque = [
            record(simulator, nuisance, int(count), n_samples, self.sampling_rate, seed)[0]
            for count, seed in zip(counts, for_runs, strict=True)
        ]
        values, _ = summarise(np.array(torque), self.sampling_rate, self.input_speed_hz, base.gearbox.n_lobes)
        return values

    def _key(self, composite: CompositeSimulator, nuisance: NuisancePrior) -> str:
        elsewhere = ("simulator", "nuisance", "n_jobs", "cache", "n_trees")
        own = {name: value for name, value in self.get_params(deep=False).items() if name not in elsewhere}
        return cache_key(composite, nuisance, own, self.classes_)


class _Typical:
    """How typical features are of each class: a Gaussian per class on the leading components.

    The conformal p of a class is the share of its own cases that are no more typical, each judged like the
    new one by the Gaussian that was made without it (cross-conformal, Vovk 2015).
    """

    def __init__(self, features: Float, labels: NDArray[np.intp], folds: StratifiedKFold) -> None:
        # Per fold: components and Gaussians, and how far the cases of each class lie that they have not seen.
        # Components too are made without them: those that a sample spreads along most flatter it.
        self.folds: list[tuple[PCA, list[tuple[LedoitWolf, Float]]]] = []
        for train, test in folds.split(features, labels):
            components = PCA(min(_COMPONENTS, features.shape[1])).fit(features[train])
            known, left_out = (components.transform(features[part]) for part in (train, test))
            of_class = []
            for k in np.unique(labels):
                gaussian = LedoitWolf().fit(known[labels[train] == k])
                of_class.append((gaussian, gaussian.mahalanobis(left_out[labels[test] == k])))
            self.folds.append((components, of_class))

    def conformal_p(self, features: Float) -> Float:
        """p of each class, shape (n, n_classes)."""
        farther: Float | float = 0.0
        total = np.zeros(len(self.folds[0][1]))
        for components, of_class in self.folds:
            points = components.transform(features)
            farther = farther + np.column_stack(
                [
                    np.sum(own[None] >= gaussian.mahalanobis(points)[:, None], axis=1)
                    for gaussian, own in of_class
                ]
            )
            total += [own.size for _, own in of_class]
        return np.asarray((farther + 1) / (total + 1))


def _scaled(deviations: Float) -> Float:
    """Logarithmic with sign: effects differ by orders of magnitude in strength."""
    return np.sign(deviations) * np.log1p(np.abs(deviations))


def _sharpened(votes: Float, temperature: float) -> Float:
    logits = np.log(np.maximum(votes, 1e-4)) / temperature
    powers = np.exp(logits - logits.max(axis=1, keepdims=True))
    return np.asarray(powers / powers.sum(axis=1, keepdims=True))


def _temperature(votes: Float, labels: NDArray[np.intp]) -> float:
    """Temperature of the smallest out-of-fold log loss."""

    def loss(log_temperature: float) -> float:
        sharp = _sharpened(votes, float(np.exp(log_temperature)))
        return float(-np.mean(np.log(np.maximum(sharp[np.arange(len(labels)), labels], 1e-12))))

    return float(np.exp(minimize_scalar(loss, bounds=(-3.0, 2.0), method="bounded").x))


def _ties(confusion: Float, names: list[str]) -> list[tuple[str, ...]]:
    symmetric = (confusion + confusion.T) / 2
    np.fill_diagonal(symmetric, 0.0)
    _, of = connected_components(symmetric > _TIE, directed=False)
    groups = [tuple(np.array(names)[of == k].tolist()) for k in np.unique(of)]
    return [group for group in groups if len(group) > 1]
