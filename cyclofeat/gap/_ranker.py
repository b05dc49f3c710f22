"""What is missing: names for a disagreement, with look-alikes and the measurement that tells them apart."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from cyclofeat._sklearn import Interval, fit_context
from cyclofeat.gap._learned import FOLDS, Learned, log_scaled, sharpened
from cyclofeat.gap._locator import GapLocator
from cyclofeat.gap._names import different_names
from cyclofeat.gap._null import NuisancePrior
from cyclofeat.gap._table import EffectTable, make_table
from cyclofeat.simulators import CompositeSimulator, CycloidalGearbox, Effect, Rig, effect_library

Float = NDArray[np.float64]

# Draws of an effect from which it can be learned; of one that a model cannot have all fail.
_FEWEST_DRAWS = 3
_REFINED = 20  # pairs of draws whose distance is taken in all combinations of cells


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


@dataclass(frozen=True)
class RankedPair:
    """Two effects in the order of their probability.

    Attributes
    ----------
    effects : tuple of Effect
        With the parameters of the draws that come nearest.
    probability : float
        Among all pairs; no more than a weight by distance, to choose what is fitted.
    """

    effects: tuple[Effect, ...]
    probability: float

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(effect.effect_id for effect in self.effects)


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
    n_draws : int, default=60
        Sets of parameters per effect.
    n_simulations : int, default=4
        Simulated recordings per set, each also without the effect from the same random numbers.
    n_null : int, default=160
        Recordings without any effect.
    n_recordings : int, default=8
        Recordings that a comparison is expected to have. Another number is learned when it comes.
    n_trees : int, default=400
    alpha : float, default=0.05
        Level of the refusal (``unknown_``), and of the gate: what would not be found is not learned.
    random_state : int, default=0
    n_jobs : int, default=1
    cache : path, optional
        Folder in which the table is kept.

    Attributes
    ----------
    table_ : EffectTable
    classes_ : list of str
        Effects.
    left_out_ : tuple of str
        Those of the default library that this model cannot have, or not at this rate.
    confusion_ : ndarray, shape (n_classes, n_classes)
        Shares of out-of-fold names by true effect, rows adding up to one.
    temperature_ : float
        By which the forest's votes are sharpened so that they become probabilities out of fold.
    detectable_ : dict from str to float
        Share of the sets of each effect that would be found at all.
    tie_groups_ : list of tuple of str
        Effects that are confused with each other in more than a fifth of the cases; gain and offset, and
        drift of load and of sensor, always.
    ranking_, proba_, conformal_p_, unknown_, next_measurement_
        Set by :meth:`rank`.

    Notes
    -----
    A set's deviation is the mean change by the effect, recording against recording, plus the mean of
    ``n_recordings`` residuals: the table serves comparisons of any number of recordings. Features are the
    deviations of means, cell by cell and uncorrelated, and of spreads over their standard errors, on a
    logarithmic scale with sign.
    ``unknown_`` comes from a Gaussian per effect on their leading components: where the conformal p of every
    effect is below alpha, the library does not hold the effect. The probabilities are conditional on the
    library, and stay below one half where two look-alikes share them.

    Examples
    --------
    >>> ranker = EffectRanker(25_600, library=["hum", "offset"], n_draws=8, n_simulations=2, n_null=16)
    >>> ranker.fit().classes_
    ['hum', 'offset']
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "sampling_rate": [Interval(Real, 0, None, closed="neither")],
        "simulator": [CompositeSimulator, Rig, CycloidalGearbox, None],
        "nuisance": [NuisancePrior, None],
        "library": [list, tuple, None],
        "input_speed_hz": [Interval(Real, 0, None, closed="neither")],
        "duration_s": [Interval(Real, 0, None, closed="neither")],
        "n_draws": [Interval(Integral, FOLDS, None, closed="left")],
        "n_simulations": [Interval(Integral, 2, None, closed="left")],
        "n_null": [Interval(Integral, 16, None, closed="left")],
        "n_recordings": [Interval(Integral, 2, None, closed="left")],
        "n_trees": [Interval(Integral, 1, None, closed="left")],
        "alpha": [Interval(Real, 0, 1, closed="neither")],
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
        n_draws: int = 60,
        n_simulations: int = 4,
        n_null: int = 160,
        n_recordings: int = 8,
        n_trees: int = 400,
        alpha: float = 0.05,
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
        self.n_simulations = n_simulations
        self.n_null = n_null
        self.n_recordings = n_recordings
        self.n_trees = n_trees
        self.alpha = alpha
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
        self.classes_ = self._names(nuisance.simulator(self.simulator))
        table = make_table(
            self.simulator,
            nuisance,
            self.classes_,
            n_draws=self.n_draws,
            n_recordings=self.n_simulations,
            n_null=self.n_null,
            n_samples=round(self.duration_s * self.sampling_rate),
            sampling_rate=self.sampling_rate,
            input_speed_hz=self.input_speed_hz,
            random_state=self.random_state,
            n_jobs=self.n_jobs,
            cache=self.cache,
        )
        made = [name for name in self.classes_ if len(_simulated(table, name)) >= _FEWEST_DRAWS]
        self.left_out_ = tuple(name for name in self.classes_ if name not in made)
        if not made or (self.left_out_ and self.library is not None):
            raise ValueError(
                "library must hold effects that this model and rate can have, got "
                f"{', '.join(self.left_out_)}"
            )
        self.classes_ = made
        self.table_ = table.of(made)
        self._learned: dict[int, Learned] = {}
        learned = self._learn(self.n_recordings)
        self.temperature_, self.confusion_ = learned.temperature, learned.confusion
        self.tie_groups_, self.detectable_ = learned.tie_groups, learned.detectable
        return self

    def rank(self, locator: GapLocator, without: Sequence[str] = ()) -> list[Ranked]:
        """Name what a fitted locator has found.

        Parameters
        ----------
        locator : GapLocator
            Fitted with the same model, prior, rate and window length.
        without : sequence of str
            Effects that are not considered: those that the model already has.

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
        n_cells = self.table_.null.shape[1]
        if locator.simulated_.shape[1] < n_cells:
            raise ValueError(
                f"locator must have summaries of {n_cells} cells like the table, got "
                f"{locator.measured_.shape[1]}: same sampling_rate?"
            )
        learned = self._learn(len(locator.measured_))
        features = learned.scale.features(*self._deviation(locator), len(locator.measured_))[np.newaxis]
        votes = sharpened(learned.forest.predict_proba(features), learned.temperature)[0]
        left = np.array([name not in without for name in self.classes_])
        if not left.any():
            raise ValueError(f"without must leave an effect to name, got all of {', '.join(self.classes_)}")
        votes = np.where(left, votes, 0.0) / votes[left].sum()
        p = learned.typical.conformal_p(features)[0]
        self.proba_ = dict(zip(self.classes_, votes.tolist(), strict=True))
        self.conformal_p_ = dict(zip(self.classes_, p.tolist(), strict=True))
        self.unknown_ = bool(p[left].max() <= self.alpha)
        kinds = effect_library()
        order = [k for k in np.argsort(-votes, kind="stable") if left[k]]
        self.ranking_ = [
            Ranked(
                effect_id=self.classes_[k],
                summary=kinds[self.classes_[k]].summary(),
                probability=float(votes[k]),
                look_alikes=learned.look_alikes(self.classes_[k]),
                next_measurement=kinds[self.classes_[k]].separated_by,
            )
            for k in order
        ]
        self.next_measurement_ = self.ranking_[0].next_measurement
        return self.ranking_

    def nearest(self, name: str, locator: GapLocator, n_nearest: int = 1) -> list[Effect]:
        """Draws of an effect that change the summaries most like what a locator has found: where to start.

        Parameters
        ----------
        name : str
            Effect.
        locator : GapLocator
            Fitted.
        n_nearest : int
            How many, the nearest first.
        """
        scale = self._learn(len(locator.measured_)).scale
        wanted, _ = self._deviation(locator)
        vectors, shifts = self._draws(name)
        n = len(locator.measured_)
        distance = np.linalg.norm(scale.of_means(shifts, n) - scale.of_means(wanted, n), axis=1)
        kind = effect_library()[name]()
        return [kind.from_vector(vector) for vector in vectors[np.argsort(distance)[:n_nearest]]]

    def nearest_pairs(self, locator: GapLocator) -> list[RankedPair]:
        """Pairs of effects in the order of how much two of their draws together look like what was found.

        What two draws change together is taken from what each changes alone: levels that both raise add up as
        powers, all else as it is.

        Parameters
        ----------
        locator : GapLocator
            Fitted.

        Returns
        -------
        list of RankedPair
            The most probable first; each has the draws that come nearest. None of a library of one effect.
        """
        scale = self._learn(len(locator.measured_)).scale
        wanted, _ = self._deviation(locator)
        n = len(locator.measured_)
        target = scale.of_means(wanted, n)
        in_db = np.array([cell.unit == "dB" for cell in locator.cells_])[self._in_table(locator)]
        in_errors = (scale.spread / np.sqrt(n)).astype(np.float32)
        coarse_target = target[: in_db.size].astype(np.float32)
        # Single precision halves the time, of which this takes most.
        draws = {}
        for name in self.classes_:
            vectors, shifts = self._draws(name)
            if len(vectors):
                draws[name] = (vectors, shifts.astype(np.float32))
        kinds = effect_library()
        nearest = []
        for names in itertools.combinations(draws, 2):
            (vectors_a, a), (vectors_b, b) = (draws[name] for name in names)
            together = _together(a, b, in_db).reshape(-1, in_db.size)
            coarse = np.linalg.norm(log_scaled(together / in_errors) - coarse_target, axis=1)
            near = np.argsort(coarse)[:_REFINED]
            distance = np.linalg.norm(scale.of_means(together[near], n) - target, axis=1)
            i, k = divmod(int(near[distance.argmin()]), len(b))
            best = zip(names, (vectors_a[i], vectors_b[k]), strict=True)
            effects = tuple(kinds[name]().from_vector(vector) for name, vector in best)
            nearest.append((float(distance.min()), effects))
        nearest.sort(key=lambda one: one[0])
        odds = np.exp([nearest[0][0] - distance for distance, _ in nearest])
        odds = odds / odds.sum()
        return [RankedPair(effects, float(share)) for (_, effects), share in zip(nearest, odds, strict=True)]

    def _deviation(self, locator: GapLocator) -> tuple[Float, Float]:
        """Deviation of the measured means from the locator's own bank, and the variances over recordings."""
        kept = self._in_table(locator)
        simulated = locator.centred(locator.simulated_, locator.bank_.counts)[:, kept]
        measured = locator.centred(locator.measured_, locator.counts_)[:, kept]
        return measured.mean(axis=0) - simulated.mean(axis=0), measured.var(axis=0, ddof=1)

    def _draws(self, name: str) -> tuple[Float, Float]:
        """Parameters and mean changes of an effect's draws, without those whose simulation failed."""
        simulated = _simulated(self.table_, name)
        return self.table_.vectors[name][simulated], self.table_.shifts(name)[simulated]

    def _in_table(self, locator: GapLocator) -> NDArray[np.bool_]:
        """Which of a locator's cells the table has: all but those of the tachometer."""
        found = np.array(["tachometer" not in cell.name for cell in locator.cells_])
        if (locator.sampling_rate, locator.input_speed_hz) != (self.sampling_rate, self.input_speed_hz):
            raise ValueError(
                "locator must compare recordings of the ranker's rate and speed, "
                f"{self.sampling_rate:g} Hz and {self.input_speed_hz:g} turns/s, "
                f"got {locator.sampling_rate:g} and {locator.input_speed_hz:g}"
            )
        if found.sum() != self.table_.null.shape[1]:
            raise ValueError(
                f"locator must compare the {self.table_.null.shape[1]} figures of the ranker's table, got "
                f"{found.sum()}: windows of another length?"
            )
        return found

    def _names(self, composite: CompositeSimulator) -> list[str]:
        known = effect_library()
        if self.library is not None:
            return list(different_names(self.library, known, "library"))
        rig = composite.to_rig()
        braked = rig.has_brake or any(effect.effect_id == "brake_rotor" for effect in rig.effects)
        return [name for name in known if not (braked and name == "brake_rotor")]

    def _learn(self, n_recordings: int) -> Learned:
        if n_recordings not in self._learned:
            self._learned[n_recordings] = Learned(
                self.table_, n_recordings, self.n_trees, self.alpha, self.random_state, self.n_jobs
            )
        return self._learned[n_recordings]


def _simulated(table: EffectTable, name: str) -> NDArray[np.intp]:
    """Draws of an effect none of whose simulations failed."""
    return np.flatnonzero(np.all(np.isfinite(table.shifts(name)), axis=1))


def _together(first: NDArray[Any], second: NDArray[Any], in_db: NDArray[np.bool_]) -> NDArray[Any]:
    """What two effects change together, from what each changes alone: (n_first, n_second, n_cells)."""
    a, b = first[:, None], second[None]
    power = 10 ** (a / 10) + 10 ** (b / 10) - 1
    as_powers = in_db & (a > 0) & (b > 0)
    return np.where(as_powers, 10 * np.log10(np.maximum(power, 1)), a + b)
