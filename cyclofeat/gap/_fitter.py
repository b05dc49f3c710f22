"""How large the missing effect is: parameters with intervals, and the simulator with the effect in it."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import validate_data

from cyclofeat._sklearn import Interval, fit_context
from cyclofeat.gap._fit_interval import BOXES, calibrated
from cyclofeat.gap._fit_model import (
    AT_BOUND,
    FitModel,
    FitSpace,
    as_effects,
    less_means,
    matched_counts,
)
from cyclofeat.gap._fit_search import Estimate, Search, Whitener
from cyclofeat.gap._null import NuisancePrior, summarised_bank
from cyclofeat.gap._recordings import mean_speeds, mixed, per_recording, recordings_of, registered
from cyclofeat.gap._summaries import Cell, summarise_all
from cyclofeat.simulators import (
    CompositeSimulator,
    CycloidalGearbox,
    Effect,
    Rig,
    SimulationFailed,
)

Float = NDArray[np.float64]

_RANDOM_STARTS = 2
_CORRECTIONS = 2
_FITS = 2.0  # loss below which nothing is left to search for
_AT_OPTIMUM = 32  # recordings that correct the optimum and weigh the cells there
_FAR = 2.0  # standard deviations from which a correction is repeated
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
        Mean square of the whitened residuals of recordings simulated with ``theta_``, about 1 where model and
        measurement agree.
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
    ``loss_`` where that is above 1 (Birge 1932). The loss is that of 32 recordings simulated at theta; where
    it is above 2 there and lower where the search ended, theta is that place, and the interval holds both.

    Examples
    --------
    >>> from cyclofeat.gap import make_bank
    >>> from cyclofeat.simulators import Hum
    >>> truth = CompositeSimulator(effects=[Hum(0.3)])
    >>> X = make_bank(truth, NuisancePrior(), [0, 3], n=4, random_state=5).X
    >>> fitter = EffectFitter(Hum(0.1), 25_600, n_interval=12).fit(X, y=[0, 3, 0, 3])
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
        SimulationFailed
            If the simulations with the effect fail where its size is to be stated.
        """
        effects = self._effects()
        windows = validate_data(self, X, dtype=[np.float64, np.float32]).astype(np.float32)
        nuisance = NuisancePrior() if self.nuisance is None else self.nuisance
        composite = nuisance.simulator(self.simulator)
        n_lobes = nuisance.n_lobes(self.simulator, self.input_speed_hz)
        speeds = None if angle is None else mean_speeds(angle, windows.shape, self.sampling_rate)
        windows = registered(windows, self.sampling_rate, self.input_speed_hz, n_lobes)
        of_window, counts = recordings_of(len(windows), y, groups)
        values, cells = summarise_all(windows, self.sampling_rate, self.input_speed_hz, n_lobes, speeds)
        measured = per_recording(values, of_window)
        if len(measured) < 2:
            raise ValueError("groups must hold at least 2 recordings: one has no spread to weigh by, got 1")
        model = FitModel(
            composite=composite,
            nuisance=nuisance,
            effects=effects,
            counts=matched_counts(counts, nuisance, _AT_OPTIMUM),
            by_count=counts is not None,
            n_samples=windows.shape[1],
            sampling_rate=self.sampling_rate,
            input_speed_hz=self.input_speed_hz,
            n_lobes=n_lobes,
            by_tachometer=angle is not None,
            random_state=self.random_state,
            n_jobs=self.n_jobs,
        )
        at = FitSpace(effects)
        self._check_n_interval(1 if counts is None else len(np.unique(counts)), at.widths.size)
        target, n = measured.mean(axis=0), len(measured)
        null = self._null_scatter(model, counts)
        whitener = Whitener(null, null, cells)
        search = Search(model, at, target, np.random.default_rng([self.random_state, 3]))
        for place in self._starts(at, search.random):
            search.visit(place)
        # Weights by how far recordings with about this effect scatter: under drift the slow part does far
        # more than without.
        start = search.best(whitener)
        whitener = Whitener(null, model.centred(model.summaries(start, _AT_OPTIMUM // 2)), cells)
        optimum, estimate = self._optimum(search, null, whitener, cells, n)
        misfit = functools.partial(_misfit, model, measured=measured, null=null, cells=cells)
        line, loss, reach = optimum, math.inf, np.full(optimum.size, np.inf)
        if self.n_interval:
            line, reach = calibrated(
                search, optimum, estimate, measured, counts, self.n_interval, self.alpha,
                np.random.default_rng([self.random_state, 4]),
            )  # fmt: skip
            loss = misfit(line)
        best = line
        if not loss <= _FITS:
            # Where summaries are far from linear in a box, the line may end beside what the search found.
            try:
                of_optimum = misfit(optimum)
            except SimulationFailed:
                if not self.n_interval:
                    raise
                of_optimum = math.inf
            if of_optimum < loss:
                best, loss = optimum, of_optimum
        # The Birge ratio: residuals beyond the scatter say that it is not all that goes wrong. And where line
        # and search disagree, the interval holds both.
        reach = np.maximum(reach * math.sqrt(max(loss, 1.0)), np.abs(line - best))
        self._settle(model, at, best, reach, loss)
        return self

    def _optimum(
        self, search: Search, null: Float, whitener: Whitener, cells: list[Cell], n_measured: int
    ) -> tuple[Float, Estimate]:
        """Search and correct, anew from where it ended as long as the fit is bad and simulations are left."""
        model, at, found = search.model, search.at, []
        while True:
            place = search.run(whitener, self.n_sims)
            for _ in range(_CORRECTIONS):
                # A mean of more recordings than the search had, and weights by their own scatter. What hangs
                # together is taken from those without effect, of which there are more.
                simulated = model.summaries(place, _AT_OPTIMUM)
                scatter = model.centred(simulated)
                # Weights by one half, the step's error by the other: weights fitted to the recordings whose
                # scatter they reduce would promise too much.
                half = _every_other(model.counts[: len(scatter)])
                whitener = Whitener(null, scatter[half], cells)
                _, slope = search.line(place)
                difference = search.target - simulated.mean(axis=0)
                variance = 1 / n_measured + 1 / len(scatter)
                estimate = Estimate(whitener, slope, difference, scatter[~half], variance)
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

    def _effects(self) -> tuple[Effect, ...]:
        given = as_effects(self.effect)
        if not given or not all(isinstance(effect, Effect) for effect in given):
            raise TypeError(f"effect must be an Effect or a sequence of them, got {self.effect!r}")
        for effect in given:
            if not effect.vector_names():
                raise ValueError(f"effect must have a parameter to fit, got {effect!r}")
        return given

    def _check_n_interval(self, n_counts: int, n_parameters: int) -> None:
        least = BOXES * (n_counts + n_parameters + 1)
        if 0 < self.n_interval < least:
            raise ValueError(
                f"n_interval must be 0 or at least {least} for {n_counts} counts of worn lobes and "
                f"{n_parameters} parameters, got {self.n_interval}"
            )

    def _null_scatter(self, model: FitModel, counts: NDArray[np.int64] | None) -> Float:
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
        return less_means(values, bank.counts if counts is not None else np.zeros(len(values), dtype=int))

    def _starts(self, at: FitSpace, random: np.random.Generator) -> list[Float]:
        """The place given and some others."""
        if self.starts is None:
            return [at.given, *(at.from_prior(random) for _ in range(_RANDOM_STARTS))]
        return [at.given, *(FitSpace(as_effects(start)).given for start in self.starts)]

    def _settle(self, model: FitModel, at: FitSpace, best: Float, reach: Float, loss: float) -> None:
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
        ends = np.minimum(best - at.low, at.high - best) < AT_BOUND * (at.high - at.low)
        self.at_bound_ = dict(zip(names, ends.tolist(), strict=True))
        self.loss_ = loss
        self.n_calls_, self.n_failed_ = model.n_calls, model.n_failed

    def _base(self) -> CycloidalGearbox | Rig:
        """Base of the model as it was given: the nuisance prior's tolerances are not part of it."""
        given = self.simulator
        if isinstance(given, CompositeSimulator):
            given = given.base
        if isinstance(given, Rig):
            return given.replace(effects=())
        return CycloidalGearbox.steel() if given is None else given


def _misfit(model: FitModel, place: Float, measured: Float, null: Float, cells: list[Cell]) -> float:
    """Mean square of what is left between measured and simulated means, 1 where nothing but scatter is."""
    simulated = model.summaries(place, _AT_OPTIMUM)
    whitener = Whitener(null, model.centred(simulated), cells)
    left = whitener(measured.mean(axis=0) - simulated.mean(axis=0))
    return float(np.mean(left**2) / (1 / len(measured) + 1 / len(simulated)))


def _every_other(counts: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Every other recording of each count, so that both halves have all counts in equal shares."""
    earlier = [int(np.sum(counts[:i] == count)) for i, count in enumerate(counts)]
    return np.asarray(np.array(earlier) % 2 == 0)
