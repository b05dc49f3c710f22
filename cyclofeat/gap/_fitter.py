"""How large the missing effect is: parameters with intervals, and the simulator with the effect in it."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import joblib
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from scipy.stats import qmc
from sklearn.base import BaseEstimator
from sklearn.utils.validation import validate_data

from cyclofeat._sklearn import Interval, fit_context
from cyclofeat.gap._calibration import Calibration, slopes
from cyclofeat.gap._locator import smallest_spreads
from cyclofeat.gap._null import SPARE, NuisancePrior, machine, summarised_bank
from cyclofeat.gap._recordings import mean_speeds, mixed, per_recording, recordings_of, registered
from cyclofeat.gap._summaries import Cell, summarise_all
from cyclofeat.gap._whitening import uncorrelating
from cyclofeat.simulators import (
    CompositeSimulator,
    CycloidalGearbox,
    Effect,
    MachineRun,
    Rig,
    SimulationFailed,
    SimulationRun,
)
from cyclofeat.simulators.effects import EffectParameter, LogUniform, Uniform

Float = NDArray[np.float64]

_PER_STEP = 4  # simulated recordings behind one evaluation
_BEYOND_PRIOR = 1.0  # how far beyond the prior's ends is searched, in its own width on a fitter's scale
_OUTLIER = 3.0  # whitened residual from which a cell counts less
_AT_BOUND = 0.01  # share of the searched range
_ROUNDS = 4
_RANDOM_STARTS = 2
_PER_ROUND = 3
_WIDEST = 0.25  # radius of the first round, in widths of the prior
_NEAR = 0.01  # distance below which places weigh alike
_CORRECTIONS = 2
_FITS = 2.0  # loss below which nothing is left to search for
_AT_OPTIMUM = 32  # recordings that correct the optimum and weigh the cells there
_BOXES = 3  # in which recordings for the interval are spread, each around what the last one said
_FIRST_BOX = 0.15  # half its width, in widths of the prior
_LEAST_BOX, _WIDEST_BOX = 0.01, 0.5
_REACH = 3.0  # half the width of the next box, in standard deviations
_APART = 10_000  # first seed of these recordings
_LEAST_LEFT = 0.5  # of variance: few recordings do not show that something hardly scatters at all
_FAR = 2.0  # standard deviations from which a correction is repeated
_FAILED = 50.0  # whitened residual of every cell where the simulation fails
_BANK = 200
# A parameter whose interval is wider than this share of the prior's has hardly been told by the recordings.
_TELLING = 0.7


class EffectFitter(BaseEstimator):
    """Fit an effect to measured recordings, on summaries and never sample by sample.

    Parameters
    ----------
    effect : Effect or sequence of Effect
        What is missing; its parameters are where the search starts.
    sampling_rate : float
        Samples per second in Hz.
    simulator : CompositeSimulator, Rig or CycloidalGearbox, optional
        The model without the effect.
    nuisance : NuisancePrior, optional
    input_speed_hz : float, default=500 / 60
    n_sims : int, default=400
        Simulated recordings that the search may take; those for the interval come on top.
    n_interval : int, default=144
        Simulated recordings around the optimum, for the interval; with 0 it is the whole range searched.
    starts : sequence of (Effect or sequence of Effect), optional
        Further places to search from; the best of all is taken. Default: two from the prior.
    alpha : float, default=0.1
        The intervals hold the parameter with a chance of 1 - alpha.
    random_state : int, default=0
    n_jobs : int, default=1
    cache : path, optional
        Folder in which the bank is kept.

    Attributes
    ----------
    theta_ : dict from str to float
        Parameters by ``"effect_id.parameter"``, in their units.
    theta_ci_ : dict from str to tuple of float
        Interval of each.
    effects_ : tuple of Effect
        The effects with these parameters.
    simulator_ : CompositeSimulator
        The model with the effects.
    identifiable_ : dict from str to bool
        Whether the recordings tell the parameter: changing it moves the summaries, and its interval is
        narrower than what was assumed before.
    at_bound_ : dict from str to bool
        Whether the optimum lies at the end of the searched range: the true value may lie beyond.
    loss_ : float
        Mean square of the whitened residuals at the optimum, 1 where model and measurement agree.
    n_calls_ : int
        Simulated recordings.
    n_failed_ : int
        Those that failed.

    Notes
    -----
    With S the mean summary of the measured recordings and s(theta) that of simulated ones of the same counts,
    always from the same random numbers, theta minimises sum rho(L^-1 (S - s(theta))): rho grows linearly
    beyond three standard errors, and L L' is the covariance of recordings without effect (shrunk towards the
    diagonal: Ledoit and Wolf 2004). Then 32 recordings at the optimum give a better mean and each cell's
    scatter with the effect, for one more Gauss-Newton step theta + H L^-1 (S - s), H = (J'J)^-1 J', J the
    whitened derivative.

    J comes from few simulations and rough ones, so the step's own error is no measure of theta's. The
    interval rests on ``n_interval`` recordings of known parameters, spread evenly over three boxes: around
    the optimum, and around what the box before said. T = H L^-1 s, one statistic for each parameter with the
    derivative from all boxes before and the search, is measured, and a straight line through the T of the
    box, with a level for each count, is turned around (linear calibration: Brown 1982). Theta's covariance
    then has the scatter of single recordings, measured or simulated, whichever is larger, and the line's own
    uncertainty. Intervals take Student's t with the line's degrees of freedom, and are widened by the root of
    ``loss_`` where that is above 1 (Birge 1932).

    Examples
    --------
    >>> from cyclofeat.gap import make_bank
    >>> from cyclofeat.simulators import Hum
    >>> truth = CompositeSimulator(effects=[Hum(0.3)])
    >>> X = make_bank(truth, NuisancePrior(), [0, 3], n=4, random_state=5).X
    >>> fitter = EffectFitter(Hum(0.1), 25_600, n_interval=8).fit(X, y=[0, 3, 0, 3])
    >>> round(fitter.theta_["hum.amplitude_nm"], 1)
    0.3
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        "effect": [Effect, list, tuple],
        "sampling_rate": [Interval(Real, 0, None, closed="neither")],
        "simulator": [CompositeSimulator, Rig, CycloidalGearbox, None],
        "nuisance": [NuisancePrior, None],
        "input_speed_hz": [Interval(Real, 0, None, closed="neither")],
        "n_sims": [Interval(Integral, 1, None, closed="left")],
        "n_interval": [Interval(Integral, 0, None, closed="left")],
        "starts": [list, tuple, None],
        "alpha": [Interval(Real, 0, 1, closed="neither")],
        "random_state": [Interval(Integral, 0, None, closed="left")],
        "n_jobs": [Integral],
        "cache": [str, os.PathLike, None],
    }

    def __init__(
        self,
        effect: Effect | Sequence[Effect],
        sampling_rate: float,
        simulator: CompositeSimulator | Rig | CycloidalGearbox | None = None,
        nuisance: NuisancePrior | None = None,
        input_speed_hz: float = 500 / 60,
        n_sims: int = 400,
        n_interval: int = 144,
        starts: Sequence[Effect | Sequence[Effect]] | None = None,
        alpha: float = 0.1,
        random_state: int = 0,
        n_jobs: int = 1,
        cache: str | os.PathLike[str] | None = None,
    ) -> None:
        self.effect = effect
        self.sampling_rate = sampling_rate
        self.simulator = simulator
        self.nuisance = nuisance
        self.input_speed_hz = input_speed_hz
        self.n_sims = n_sims
        self.n_interval = n_interval
        self.starts = starts
        self.alpha = alpha
        self.random_state = random_state
        self.n_jobs = n_jobs
        self.cache = cache

    @fit_context(prefer_skip_nested_validation=True)
    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike | None = None,
        groups: ArrayLike | None = None,
        angle: ArrayLike | None = None,
    ) -> Self:
        """Fit the effect's parameters.

        Parameters
        ----------
        X : array-like, shape (n_windows, n_samples)
            Measured torque in Nm, at least one output turn per window.
        y : array-like of int, shape (n_windows,), optional
            Known counts of worn lobes.
        groups : array-like, shape (n_windows,), optional
            Recording of each window. Default: each window is a recording of its own.
        angle : array-like, shape (n_windows, n_samples), optional
            Angle of the input shaft in rad, by a tachometer.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If an effect has no parameter to fit, there are fewer than two recordings, windows are too short,
            or the data do not belong together.
        """
        effects = self._effects()
        windows = validate_data(self, X, dtype=[np.float64, np.float32]).astype(np.float32)
        nuisance = NuisancePrior() if self.nuisance is None else self.nuisance
        composite = nuisance.simulator(self.simulator)
        n_lobes = nuisance.gearbox(self.simulator).n_lobes
        speeds = None if angle is None else mean_speeds(angle, windows.shape, self.sampling_rate)
        windows = registered(windows, self.sampling_rate, self.input_speed_hz, n_lobes)
        of_window, counts = recordings_of(len(windows), y, groups)
        values, cells = summarise_all(windows, self.sampling_rate, self.input_speed_hz, n_lobes, speeds)
        measured = per_recording(values, of_window)
        if len(measured) < 2:
            raise ValueError("groups must hold at least 2 recordings: one has no spread to weigh by, got 1")
        model = _Model(
            composite=composite,
            nuisance=nuisance,
            effects=effects,
            counts=_matched(counts, nuisance, _AT_OPTIMUM),
            n_samples=windows.shape[1],
            sampling_rate=self.sampling_rate,
            input_speed_hz=self.input_speed_hz,
            n_lobes=n_lobes,
            by_tachometer=angle is not None,
            random_state=self.random_state,
            n_jobs=self.n_jobs,
        )
        at = _Space(effects)
        self._check_n_interval(1 if counts is None else len(np.unique(counts)), at.widths.size)
        target, n = measured.mean(axis=0), len(measured)
        null = self._null_scatter(model, counts)
        whitener = _Whitener(null, null, cells)
        search = _Search(model, at, target, np.random.default_rng([self.random_state, 3]))
        for place in self._starts(at, search.random):
            search.visit(place)
        # Weights by how far recordings with about this effect scatter: under drift the slow part does far
        # more than without.
        start = search.best(whitener)
        whitener = _Whitener(null, model.centred(model.summaries(start, _AT_OPTIMUM // 2)), cells)
        best, estimate = self._optimum(search, null, whitener, cells, n)
        reach = np.full(best.size, np.inf)
        if self.n_interval:
            best, reach = self._calibrated(search, best, estimate, measured, counts)
        self._settle(model, at, best, estimate, reach)
        return self

    def _optimum(
        self, search: _Search, null: Float, whitener: _Whitener, cells: list[Cell], n_measured: int
    ) -> tuple[Float, _Estimate]:
        """Search and correct, anew from where it ended as long as the fit is bad and simulations are left."""
        model, at, found = search.model, search.at, []
        while True:
            place = search.run(whitener, self.n_sims)
            for _ in range(_CORRECTIONS):
                # A mean of more recordings than the search had, and weights by their own scatter. What hangs
                # together is taken from those without effect, of which there are more.
                simulated = model.summaries(place, _AT_OPTIMUM)
                scatter = model.centred(simulated)
                # Weights by one half, the interval by the other: weights fitted to the recordings whose
                # scatter they reduce would promise too much.
                half = _every_other(model.counts[: len(scatter)])
                whitener = _Whitener(null, scatter[half], cells)
                _, slope = search.line(place)
                difference = search.target - simulated.mean(axis=0)
                variance = 1 / n_measured + 1 / len(scatter)
                estimate = _Estimate(whitener, slope, difference, scatter[~half], variance)
                moved = at.clipped(place + np.clip(estimate.step, -search.radius, search.radius))
                far = np.any(np.abs(moved - place) > _FAR * estimate.deviation)
                found.append((estimate.loss, moved, estimate))
                place = moved
                if not far:
                    break
            if estimate.loss < _FITS or model.n_asked >= self.n_sims:
                break
            search.visit(place)
        _, best, estimate = min(found, key=lambda one: one[0])
        return best, estimate

    def _calibrated(
        self,
        search: _Search,
        best: Float,
        estimate: _Estimate,
        measured: Float,
        counts: NDArray[np.int64] | None,
    ) -> tuple[Float, Float]:
        """Parameters and half of their intervals, by recordings of known parameters around the best."""
        model, at = search.model, search.at
        radius = np.maximum(_FIRST_BOX * at.widths, _REACH * np.minimum(estimate.deviation, at.widths))
        spread = qmc.Halton(best.size, rng=np.random.default_rng([self.random_state, 4]))
        told = estimate.weighted(measured)
        of_told = np.zeros(len(measured), dtype=np.int64) if counts is None else counts
        drawn, values, labels = np.empty((0, best.size)), np.empty((0, told.shape[1])), of_told[:0]
        turn = None
        for k in range(_BOXES):
            share = len(range(k, self.n_interval, _BOXES))
            low, high = at.clipped(best - radius), at.clipped(best + radius)
            places = low + spread.random(share) * (high - low)
            simulated, done, own = model.scattered(places, counts, _APART + k * self.n_interval)
            places, simulated = places[done], estimate.weighted(simulated)
            own = 0 * own if counts is None else own
            drawn, values = np.vstack([drawn, places]), np.vstack([values, simulated])
            labels = np.r_[labels, own]
            # Means over the search's own recordings have a level of their own, and weigh as many.
            searched, means = search.within(low, high)
            following = np.linalg.pinv(
                slopes(
                    np.vstack([drawn, searched]),
                    np.vstack([values, estimate.weighted(means)]),
                    np.r_[labels, np.full(len(searched), -1)],
                    np.r_[np.ones(len(drawn)), np.full(len(searched), _PER_STEP)],
                )
            )
            # Statistics that these very recordings chose would promise too much, but for the first step.
            turn = following if turn is None else turn
            line = Calibration(places, simulated @ turn.T, own, best, at.widths / 2)
            found, covariance = line.solve(told @ turn.T, of_told)
            deviation = np.sqrt(np.diag(covariance))
            # A line holds in its box.
            best = np.clip(found, low, high)
            if k > 0:
                # What is told narrows; what is not is spread as widely as it may be, or the little that is
                # known of its slope would blur all others.
                radius = np.clip(_REACH * deviation, _LEAST_BOX * at.widths, _WIDEST_BOX * at.widths)
            turn = following
        # The Birge ratio: residuals beyond the scatter say that it is not all that goes wrong.
        deviation = deviation * math.sqrt(max(estimate.loss, 1.0))
        return best, float(stats.t.ppf(1 - self.alpha / 2, line.degrees)) * deviation

    def _effects(self) -> tuple[Effect, ...]:
        given = as_effects(self.effect)
        if not given or not all(isinstance(effect, Effect) for effect in given):
            raise TypeError(f"effect must be an Effect or a sequence of them, got {self.effect!r}")
        for effect in given:
            if not effect.vector_names():
                raise ValueError(f"effect must have a parameter to fit, got {effect!r}")
        return given

    def _check_n_interval(self, n_counts: int, n_parameters: int) -> None:
        least = _BOXES * (n_counts + n_parameters + 1)
        if 0 < self.n_interval < least:
            raise ValueError(
                f"n_interval must be 0 or at least {least} for {n_counts} counts of worn lobes and "
                f"{n_parameters} parameters, got {self.n_interval}"
            )

    def _null_scatter(self, model: _Model, counts: NDArray[np.int64] | None) -> Float:
        """Summaries of recordings without the effect, less the mean of their count."""
        bank, values = summarised_bank(
            self.simulator,
            model.nuisance,
            None if counts is None else mixed(counts, _BANK),
            sampling_rate=self.sampling_rate,
            input_speed_hz=self.input_speed_hz,
            with_tachometer=model.by_tachometer,
            cache=self.cache,
            n=_BANK,
            n_samples=model.n_samples,
            random_state=self.random_state,
            n_jobs=self.n_jobs,
        )
        return _less_means(values, bank.counts if counts is not None else np.zeros(len(values), dtype=int))

    def _starts(self, at: _Space, random: np.random.Generator) -> list[Float]:
        """The place given and some others."""
        if self.starts is None:
            return [at.given, *(at.from_prior(random) for _ in range(_RANDOM_STARTS))]
        return [at.given, *(_Space(as_effects(start)).given for start in self.starts)]

    def _settle(self, model: _Model, at: _Space, best: Float, estimate: _Estimate, reach: Float) -> None:
        low, high = at.clipped(best - reach), at.clipped(best + reach)
        self.effects_ = at.effects(best)
        self.simulator_ = CompositeSimulator(self._base(), (*model.composite.effects, *self.effects_))
        names, bottom, top = at.names, at.natural(low), at.natural(high)
        self.theta_ = dict(zip(names, at.natural(best).tolist(), strict=True))
        self.theta_ci_ = {
            name: (float(min(a, b)), float(max(a, b))) for name, a, b in zip(names, bottom, top, strict=True)
        }
        told = 2 * reach < _TELLING * at.widths
        self.identifiable_ = dict(zip(names, told.tolist(), strict=True))
        ends = np.minimum(best - at.low, at.high - best) < _AT_BOUND * (at.high - at.low)
        self.at_bound_ = dict(zip(names, ends.tolist(), strict=True))
        self.loss_ = estimate.loss
        self.n_calls_, self.n_failed_ = model.n_calls, model.n_failed

    def _base(self) -> CycloidalGearbox | Rig:
        """Base of the model as it was given: the nuisance prior's tolerances are not part of it."""
        given = self.simulator
        if isinstance(given, CompositeSimulator):
            given = given.base
        if isinstance(given, Rig):
            return given.replace(effects=())
        return CycloidalGearbox.steel() if given is None else given


def as_effects(effect: Effect | Sequence[Effect]) -> tuple[Effect, ...]:
    """One effect or several, as several."""
    return (effect,) if isinstance(effect, Effect) else tuple(effect)


@dataclass
class _Model:
    """Mean summaries of simulated recordings as a function of the effects' parameters."""

    composite: CompositeSimulator
    nuisance: NuisancePrior
    effects: tuple[Effect, ...]
    counts: NDArray[np.int64]
    n_samples: int
    sampling_rate: float
    input_speed_hz: float
    n_lobes: int
    by_tachometer: bool
    random_state: int
    n_jobs: int
    n_calls: int = 0
    n_asked: int = 0
    n_failed: int = 0
    _runs: dict[bytes, list[MachineRun | None]] = field(default_factory=dict, repr=False)

    def mean(self, place: Float) -> Float:
        """Mean over the recordings behind one evaluation, NaN if none could be simulated."""
        self.n_asked += _PER_STEP
        values = self._values(place, _PER_STEP)
        return np.asarray(values.mean(axis=0)) if len(values) else np.full(1, np.nan)

    def summaries(self, place: Float, n: int) -> Float:
        """Summaries of n recordings, (n, n_cells)."""
        values = self._values(place, n)
        if len(values) < n / 2:
            raise SimulationFailed("the simulations at the optimum fail: the effect's size cannot be stated")
        return values

    def centred(self, values: Float) -> Float:
        """Less the mean of each count."""
        return _less_means(values, self.counts[: len(values)])

    def _values(self, place: Float, n: int) -> Float:
        in_machine, on_torque = self._parted(place)
        runs = [run for run in self._machines(in_machine, n) if run is not None]
        if not runs:
            return np.empty((0, 0))
        try:
            return self._summarised([run.record(on_torque) for run in runs])
        except ValueError:  # a filter beyond half of the sampling rate, say: no such rig
            self.n_failed += len(runs)
            return np.empty((0, 0))

    def scattered(
        self, places: Float, known: NDArray[np.int64] | None, first: int
    ) -> tuple[Float, NDArray[np.bool_], NDArray[np.int64]]:
        """One recording at each place: summaries of those that succeed, which these are, and their counts."""
        of_model = np.array(self.nuisance.defect_counts) if known is None else np.sort(known)
        counts = np.resize(of_model, len(places))
        jobs = (
            joblib.delayed(self._recorded)(place, first + k, int(counts[k])) for k, place in enumerate(places)
        )
        records = joblib.Parallel(n_jobs=self.n_jobs)(jobs)
        done = np.array([record is not None for record in records])
        self.n_calls += len(places)
        self.n_failed += int(np.sum(~done))
        if np.sum(done) < len(places) / 2:
            raise SimulationFailed("the simulations at the optimum fail: the effect's size cannot be stated")
        return self._summarised([record for record in records if record is not None]), done, counts[done]

    def _recorded(self, place: Float, i: int, count: int) -> SimulationRun | None:
        in_machine, on_torque = self._parted(place)
        run = self._run(self._with(in_machine), i, count)
        try:
            return None if run is None else run.record(on_torque)
        except ValueError:
            return None

    def _parted(self, place: Float) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
        """Effects that the gearbox answers, and those on the torque alone."""
        effects = _Space(self.effects).effects(place)
        return (
            tuple(effect for effect in effects if effect.needs_simulation()),
            tuple(effect for effect in effects if not effect.needs_simulation()),
        )

    def _with(self, effects: tuple[Effect, ...]) -> CompositeSimulator:
        return CompositeSimulator(self.composite.base, (*self.composite.effects, *effects))

    def _summarised(self, records: list[SimulationRun]) -> Float:
        X = np.array([record.torque_out for record in records], dtype=np.float32)
        angles = np.array([[record.input_angle[0], record.input_angle[-1]] for record in records])
        X = registered(X, self.sampling_rate, self.input_speed_hz, self.n_lobes)
        speeds = None
        if self.by_tachometer:
            turned = (angles[:, 1] - angles[:, 0]) / (2 * np.pi)
            speeds = turned / (self.n_samples - 1) * self.sampling_rate
        return summarise_all(X, self.sampling_rate, self.input_speed_hz, self.n_lobes, speeds)[0]

    def _machines(self, effects: tuple[Effect, ...], n: int) -> list[MachineRun | None]:
        """The first n runs of the machine with these effects, each made once."""
        key = repr([effect.to_dict() for effect in effects]).encode()
        if effects:
            # Parameters left behind are not asked for again: one set of runs is kept.
            self._runs = {key: self._runs[key]} if key in self._runs else {}
        runs = self._runs.setdefault(key, [])
        simulator, missing = self._with(effects), range(len(runs), n)
        made = joblib.Parallel(n_jobs=self.n_jobs)(
            joblib.delayed(self._run)(simulator, i, int(self.counts[i % len(self.counts)])) for i in missing
        )
        self.n_calls += len(missing)
        self.n_failed += sum(run is None for run in made)
        runs += made
        return runs[:n]

    def _run(self, simulator: CompositeSimulator, i: int, count: int) -> MachineRun | None:
        seed = np.random.SeedSequence([self.random_state, 1], spawn_key=(i,))
        try:
            return machine(
                simulator, self.nuisance, count, self.n_samples, self.sampling_rate, seed, spare=SPARE
            )
        except SimulationFailed:
            return None


class _Space:
    """The fitted parameters of several effects as one vector, within bounds."""

    def __init__(self, effects: Sequence[Effect]) -> None:
        self._effects = tuple(effects)
        self.names = [f"{e.effect_id}.{name}" for e in effects for name in e.vector_names()]
        if len(set(self.names)) < len(self.names):
            raise ValueError(f"effect must name each effect once, got {', '.join(self.names)}")
        self._parameters: list[EffectParameter] = [
            e.parameters[name] for e in effects for name in e.vector_names()
        ]
        ends = np.array([_prior_ends(parameter) for parameter in self._parameters])
        self.widths = ends[:, 1] - ends[:, 0]
        bounds = [e.vector_bounds() for e in effects]
        lowest, highest = (np.concatenate([bound[k] for bound in bounds]) for k in range(2))
        beyond = _BEYOND_PRIOR * self.widths
        self.low = np.maximum(ends[:, 0] - beyond, lowest)
        self.high = np.minimum(ends[:, 1] + beyond, highest)

    @property
    def given(self) -> Float:
        """The effects as they were given, moved off the bounds."""
        values = []
        for effect in self._effects:
            try:
                values.append(effect.to_vector())
            except ValueError:  # neutral in a logarithm: the middle of the prior instead
                values.append(np.full(len(effect.vector_names()), np.nan))
        middle = (self.low + self.high) / 2
        given = np.concatenate(values)
        return self.inside(np.where(np.isfinite(given), given, middle))

    def from_prior(self, random: np.random.Generator) -> Float:
        """A place drawn from the priors."""
        drawn = [effect.draw_parameters(random).to_vector() for effect in self._effects]
        return self.inside(np.concatenate(drawn))

    def inside(self, place: Float) -> Float:
        """Moved off the bounds by a hundredth of the range, as a search has to start."""
        margin = 1.1 * _AT_BOUND * (self.high - self.low)
        return np.clip(place, self.low + margin, self.high - margin)

    def clipped(self, place: Float) -> Float:
        return np.clip(place, self.low, self.high)

    def effects(self, place: Float) -> tuple[Effect, ...]:
        found, start = [], 0
        for effect in self._effects:
            size = len(effect.vector_names())
            found.append(effect.from_vector(place[start : start + size]))
            start += size
        return tuple(found)

    def natural(self, place: Float) -> Float:
        """The parameters in their units."""
        return np.array(
            [getattr(e, name) for e in self.effects(place) for name in e.vector_names()], dtype=float
        )


class _Whitener:
    """Deviations in standard deviations of one recording, uncorrelated."""

    def __init__(self, correlated: Float, scatter: Float, cells: list[Cell]) -> None:
        smallest = smallest_spreads(cells)
        self._scale = np.sqrt(scatter.var(axis=0) + smallest**2)
        self._turn = uncorrelating(correlated / np.sqrt(correlated.var(axis=0) + smallest**2))
        # What hangs together may hang together otherwise with the effect.
        left = np.mean(self(scatter) ** 2, axis=0)
        self._turn = self._turn / np.sqrt(np.maximum(left, _LEAST_LEFT))

    def __call__(self, values: Float) -> Float:
        """Whitened along the last axis, which is that of the cells."""
        return np.asarray((values / self._scale) @ self._turn)


class _Estimate:
    """One more Gauss-Newton step, and its standard deviation."""

    def __init__(
        self, whitener: _Whitener, derivative: Float, difference: Float, scatter: Float, variance: float
    ) -> None:
        jacobian = whitener(derivative.T).T
        residuals = whitener(difference)
        self._whitener, self._weights = whitener, _weights(residuals / math.sqrt(variance))
        inverse = np.linalg.pinv(self._weights[:, None] * jacobian)
        self.step = inverse @ (self._weights * residuals)
        spread = inverse @ self.weighted(scatter).T
        covariance = spread @ spread.T / len(scatter) * variance
        self.deviation = np.sqrt(np.diag(covariance))
        left = residuals - jacobian @ self.step
        self.loss = float(np.mean(left**2) / variance)

    def weighted(self, values: Float) -> Float:
        """Summaries of recordings, whitened, with the weights of least squares."""
        return self._whitener(values) * self._weights


def _weights(residuals: Float) -> Float:
    """Weights of least squares that stand for a loss linear in far outliers."""
    return np.asarray((1 + (residuals / _OUTLIER) ** 2) ** -0.25)


class _Search:
    """Search by rounds of places around the best so far, and straight lines through what they gave.

    Contacts make the summaries rough on the scale of a finite difference: a line through several places says
    where it goes down, a difference of two neighbours does not.
    """

    def __init__(self, model: _Model, at: _Space, target: Float, random: np.random.Generator) -> None:
        self.model, self.at, self.target, self.random = model, at, target, random
        self.radius = _WIDEST * at.widths
        self._places: list[Float] = []
        self._means: list[Float] = []

    def visit(self, place: Float) -> None:
        """Simulate at a place, if it is a new one."""
        place = self.at.clipped(place)
        if not any(np.array_equal(place, known) for known in self._places):
            self._places.append(place)
            self._means.append(self.model.mean(place))

    def within(self, low: Float, high: Float) -> tuple[Float, Float]:
        """Places in a box, and their mean summaries."""
        inside = [
            k
            for k, place in enumerate(self._places)
            if np.all((low <= place) & (place <= high)) and np.all(np.isfinite(self._means[k]))
        ]
        return (
            np.array([self._places[k] for k in inside]).reshape(-1, low.size),
            np.array([self._means[k] for k in inside]).reshape(-1, self.target.size),
        )

    def best(self, whitener: _Whitener) -> Float:
        """The place of the smallest loss so far."""
        losses = [_loss(_residuals(whitener, self.target, mean)) for mean in self._means]
        return self._places[int(np.argmin(losses))]

    def run(self, whitener: _Whitener, n_sims: int) -> Float:
        """Rounds with a radius that shrinks; the last best place."""
        self.radius = _WIDEST * self.at.widths
        size = self.at.widths.size
        for _ in range(_ROUNDS):
            centre = self.best(whitener)
            offsets = qmc.Halton(size, rng=self.random).random(_PER_ROUND + 2 * size) * 2 - 1
            for offset in offsets:
                self.visit(centre + offset * self.radius)
            centre = self.best(whitener)
            mean, slope = self.line(centre)
            residuals = whitener(self.target - mean) * math.sqrt(_PER_STEP)
            step = _descent(whitener(slope.T).T, residuals / math.sqrt(_PER_STEP), _weights(residuals))
            self.visit(centre + np.clip(step, -self.radius, self.radius))
            self.radius = self.radius / 2
            if self.model.n_asked >= n_sims:
                break
        return self.best(whitener)

    def line(self, centre: Float) -> tuple[Float, Float]:
        """Mean summary at a place and its slope there, (n_cells,) and (n_cells, n_parameters)."""
        usable = [k for k, mean in enumerate(self._means) if np.all(np.isfinite(mean))]
        if len(usable) < 2:
            raise SimulationFailed("the simulations fail: the effect's size cannot be searched for")
        offsets = (np.array([self._places[k] for k in usable]) - centre) / self.at.widths
        distance = np.linalg.norm(offsets, axis=1)
        nearest = np.argsort(distance)[: 3 * offsets.shape[1] + 3]
        weights = 1 / (distance[nearest] + _NEAR)
        design = np.column_stack([np.ones(nearest.size), offsets[nearest]]) * weights[:, None]
        values = np.array([self._means[usable[k]] for k in nearest]) * weights[:, None]
        found = np.linalg.lstsq(design, values, rcond=1e-6)[0]
        return found[0], found[1:].T / self.at.widths


def _descent(jacobian: Float, residuals: Float, weights: Float) -> Float:
    """Step of Gauss and Newton with weights."""
    return np.asarray(np.linalg.pinv(weights[:, None] * jacobian) @ (weights * residuals))


def _residuals(whitener: _Whitener, target: Float, found: Float) -> Float:
    if not np.all(np.isfinite(found)):
        return np.full(target.size, _FAILED)
    return whitener(target - found) * math.sqrt(_PER_STEP)


def _loss(residuals: Float) -> float:
    return float(np.sum(2 * (np.sqrt(1 + (residuals / _OUTLIER) ** 2) - 1)))


def _less_means(values: Float, counts: NDArray[Any]) -> Float:
    """Values less the mean of their count, scaled up for what the mean takes out of few of them."""
    left = np.zeros_like(values)
    for count in np.unique(counts):
        own = values[counts == count]
        left[counts == count] = (own - own.mean(axis=0)) * math.sqrt(len(own) / max(len(own) - 1, 1))
    return left


def _every_other(counts: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Every other recording of each count, so that both halves have all counts in equal shares."""
    earlier = [int(np.sum(counts[:i] == count)) for i, count in enumerate(counts)]
    return np.asarray(np.array(earlier) % 2 == 0)


def _matched(counts: NDArray[np.int64] | None, nuisance: NuisancePrior, n: int) -> NDArray[np.int64]:
    """Counts of the simulated recordings: those measured, spread evenly over each evaluation's."""
    known = np.sort(np.array(nuisance.defect_counts) if counts is None else counts)
    at = ((np.arange(_PER_STEP) + 0.5) * len(known) / _PER_STEP).astype(int)
    return np.asarray(np.tile(known[at], -(-n // _PER_STEP)))


def _prior_ends(parameter: EffectParameter) -> tuple[float, float]:
    """Where nearly all of a prior lies, on a fitter's scale."""
    prior = parameter.prior
    assert prior is not None
    low, high = (prior.quantile(share) for share in (0.01, 0.99))
    if isinstance(prior, (Uniform, LogUniform)):
        low, high = prior.low, prior.high
    return (math.log(low), math.log(high)) if parameter.log else (low, high)
