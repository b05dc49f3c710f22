"""Sizes of missing effects: parameters with intervals, and the model with the effects in it."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.checks import whole
from cyclofeat.gap.comparison import Comparison
from cyclofeat.gap.size._interval import BOXES, calibrated
from cyclofeat.gap.size._model import AT_BOUND, AT_OPTIMUM, FitModel, FitSpace, less_own_means
from cyclofeat.gap.size._search import Estimate, Search, Whitener
from cyclofeat.gap.summaries import Measured
from cyclofeat.simulators import Effect, Rig, SimulationFailed

Float = NDArray[np.float64]
OneOrMore = Effect | Sequence[Effect]

_RANDOM_STARTS = 2
_CORRECTIONS = 2
_FITS = 2.0  # the search ends at a loss below this
_FAR = 2.0  # a correction of more standard deviations than this is repeated
# A parameter is identifiable if its interval is narrower than this share of the prior's.
_NARROWER = 0.7


@dataclass(frozen=True)
class FittedParameter:
    """Parameter of a fitted effect.

    Attributes
    ----------
    effect, name : str
    value : float
        In ``unit``.
    low, high : float
        Its interval of 90 %.
    unit : str
        ``"1"`` for a pure number.
    identifiable : bool
        Whether the recordings fix it: changing it moves the summaries, and its interval is narrower than the
        prior's.
    at_bound : bool
        Whether it lies at an end of the searched range: the true value may lie beyond.
    """

    effect: str
    name: str
    value: float
    low: float
    high: float
    unit: str
    identifiable: bool = True
    at_bound: bool = False


@dataclass(frozen=True)
class FittedEffects:
    """Result of :func:`fit_effects`.

    Attributes
    ----------
    effects : tuple of Effect
        With the fitted parameters.
    rig : Rig
        The model with the effects.
    parameters : tuple of FittedParameter
    loss : float
        Mean square of the whitened residuals of recordings simulated with the effects, about 1 where model
        and measurement agree.
    n_calls, n_failed : int
        Recordings that were simulated, and whose simulation failed.
    """

    effects: tuple[Effect, ...]
    rig: Rig
    parameters: tuple[FittedParameter, ...]
    loss: float
    n_calls: int
    n_failed: int

    def __getitem__(self, name: str) -> FittedParameter:
        """Parameter named ``"effect_id.parameter"``."""
        return next(row for row in self.parameters if f"{row.effect}.{row.name}" == name)


def fit_effects(
    comparison: Comparison,
    measured: Measured,
    effects: OneOrMore,
    *,
    starts: Sequence[OneOrMore] | None = None,
    n_sims: int = 400,
    n_interval: int = 144,
) -> FittedEffects:
    """Fit the parameters of effects to the summaries of measured recordings.

    Parameters
    ----------
    comparison : Comparison
    measured : Measured
        At least two recordings.
    effects : Effect or sequence of Effect
        Missing effects; the search starts from their parameters.
    starts : sequence of (Effect or sequence of Effect), optional
        Further places to search from; the best of all is taken. Default: two from the prior.
    n_sims : int, default=400
        Simulated recordings that the search may take; those for the interval come on top.
    n_interval : int, default=144
        Simulated recordings around the optimum, for the intervals; with 0 each is the whole range searched.

    Returns
    -------
    FittedEffects
        Kept in the comparison's cache.

    Raises
    ------
    TypeError, ValueError
        If an effect has no parameter to fit, an argument is out of its range, or there are fewer than two
        recordings.
    SimulationFailed
        If the simulations with the effects fail.

    Notes
    -----
    *Search.* Let S be the mean summary of the measured recordings and s(theta) that of simulated recordings
    with the same counts, always from the same random numbers. Theta minimises sum rho(L^-1 (S - s(theta))).
    The loss rho is linear beyond three standard errors; L L' is the covariance of recordings without effect,
    shrunk towards the diagonal (Ledoit and Wolf 2004). Then 32 recordings are simulated at the optimum. They
    give a better mean, and the scatter of each cell with the effect, for one more Gauss-Newton step theta + H
    L^-1 (S - s), where H = (J'J)^-1 J' and J is the whitened derivative.

    *Interval.* J comes from few, noisy simulations, so the error of the step does not measure the error of
    theta. Instead ``n_interval`` recordings of known parameters are simulated, spread evenly over three
    boxes: the first around the optimum, each other around the estimate of the box before. Each recording is
    reduced to one statistic per parameter, T = H L^-1 s, with the derivative from the search and all boxes
    before. A straight line through the T of the box, with a level for each count, is inverted (linear
    calibration: Brown 1982). The covariance of theta contains the scatter of single recordings (the larger
    one of measured and simulated) and the uncertainty of the line. Intervals use Student's t with the degrees
    of freedom of the line, and are widened by the root of the loss if that is above 1 (Birge 1932).

    *Loss.* It is computed from 32 recordings simulated at theta. If it is above 2 and smaller at the end of
    the search, theta is the end of the search, and the interval contains both.

    Examples
    --------
    >>> from cyclofeat.simulators import Hum
    >>> truth = Comparison(sampling_rate=25_600, rig=Rig(effects=[Hum(0.3)]))
    >>> comparison = truth.replace(rig=None, n_bank=40)
    >>> measured = comparison.measured(truth.bank(4, [0, 3], random_state=5).X, y=[0, 3, 0, 3])
    >>> round(fit_effects(comparison, measured, Hum(0.1), n_interval=12)["hum.amplitude_nm"].value, 1)
    0.3
    """
    first = _checked(effects)
    others = None if starts is None else [_checked(start) for start in starts]
    measured.check_several()
    whole("n_sims", n_sims, 1)
    n_counts, n_parameters = len(np.unique(measured.counts_or_zeros)), FitSpace(first).widths.size
    least = BOXES * (n_counts + n_parameters + 1)
    if 0 != whole("n_interval", n_interval, 0) < least:
        raise ValueError(
            f"n_interval must be 0 or at least {least} for {n_counts} counts of worn lobes and "
            f"{n_parameters} parameters, got {n_interval}"
        )
    stated = [[effect.to_dict() for effect in place] for place in (first, *(others or ()))]
    return comparison.remember(
        lambda: _fitted(comparison, measured, first, others, n_sims, n_interval),
        "fit", comparison.text, dataclasses.replace(measured), others is None, stated, n_sims, n_interval,
        code=("signal", "gap"),
    )  # fmt: skip


def _checked(effects: OneOrMore) -> tuple[Effect, ...]:
    given = (effects,) if isinstance(effects, Effect) else tuple(effects)
    if not given or not all(isinstance(effect, Effect) for effect in given):
        raise TypeError(f"effects must be an Effect or a sequence of them, got {effects!r}")
    for effect in given:
        if not effect.vector_names():
            raise ValueError(f"effects must have a parameter to fit, got {effect!r}")
    return given


def _fitted(
    comparison: Comparison,
    measured: Measured,
    effects: tuple[Effect, ...],
    starts: list[tuple[Effect, ...]] | None,
    n_sims: int,
    n_interval: int,
) -> FittedEffects:
    model = FitModel(comparison, effects, measured.counts)
    search = Search(model, measured.values.mean(axis=0), np.random.default_rng([comparison.random_state, 3]))
    bank = comparison.bank_like(measured)
    null = less_own_means(comparison.summaries(bank), bank.counts if model.by_count else 0 * bank.counts)
    weigh = functools.partial(Whitener, null, cells=measured.cells)
    if starts is None:
        places = [model.space.from_prior(search.random) for _ in range(_RANDOM_STARTS)]
    else:
        places = [FitSpace(start).given for start in starts]
    for place in (model.space.given, *places):
        search.visit(place)
    # Weights from the scatter of recordings with about this effect: a drift scatters the slow part more.
    start = search.best(weigh(null))
    whitener = weigh(model.centred(model.summaries(start, AT_OPTIMUM // 2)))
    optimum, estimate = _optimum(search, weigh, whitener, measured.n_recordings, n_sims)
    misfit = functools.partial(_misfit, model, measured.values, weigh)
    best, loss, reach = optimum, math.inf, np.full(optimum.size, np.inf)
    if n_interval:
        random = np.random.default_rng([comparison.random_state, 4])
        best, reach = calibrated(search, estimate, optimum, measured, n_interval, random)
        loss = misfit(best)
    line = best
    if not loss <= _FITS:
        # If the summaries are far from linear in a box, the line may miss the optimum of the search.
        try:
            of_optimum = misfit(optimum)
        except SimulationFailed:
            if not n_interval:
                raise
            of_optimum = math.inf
        if of_optimum < loss:
            best, loss = optimum, of_optimum
    # Birge ratio: residuals larger than the scatter show that there are other errors. If line and search
    # disagree, the interval contains both.
    reach = np.maximum(reach * math.sqrt(max(loss, 1.0)), np.abs(line - best))
    return FittedEffects(
        effects=model.space.effects(best),
        rig=comparison.corrected_rig(model.space.effects(best)),
        parameters=_parameters(model.space, best, reach),
        loss=loss,
        n_calls=model.n_calls,
        n_failed=model.n_failed,
    )


def _optimum(
    search: Search, weigh: Callable[[Float], Whitener], whitener: Whitener, n_measured: int, n_sims: int
) -> tuple[Float, Estimate]:
    """Search and correct; repeat from the end of the search while the fit is bad and simulations remain."""
    model, space, ends = search.model, search.space, []
    while True:
        place = search.run(whitener, n_sims)
        for _ in range(_CORRECTIONS):
            # A mean of more recordings than in the search, and weights from their scatter. The correlations
            # are those of the recordings without effect, which are more numerous.
            simulated = model.summaries(place, AT_OPTIMUM)
            scatter = model.centred(simulated)
            # Weights from one half, the error of the step from the other: with the same recordings the error
            # would be too small.
            half = _every_other(model.counts[: len(scatter)])
            whitener = weigh(scatter[half])
            _, slope = search.line(place)
            difference = search.target - simulated.mean(axis=0)
            variance = 1 / n_measured + 1 / len(scatter)
            estimate = Estimate(whitener, slope, difference, scatter[~half], variance)
            moved = space.clipped(place + np.clip(estimate.step, -search.radius, search.radius))
            far = np.any(np.abs(moved - place) > _FAR * estimate.deviation)
            ends.append((estimate.loss, moved, estimate))
            place = moved
            if not far:
                break
        if estimate.loss < _FITS or model.n_asked >= n_sims:
            break
        search.visit(place)
    _, best, estimate = min(ends, key=lambda one: one[0])
    return best, estimate


def _parameters(space: FitSpace, best: Float, reach: Float) -> tuple[FittedParameter, ...]:
    values = [
        space.natural(place) for place in (best, space.clipped(best - reach), space.clipped(best + reach))
    ]
    identifiable = 2 * reach < _NARROWER * space.widths
    at_bound = np.minimum(best - space.low, space.high - best) < AT_BOUND * (space.high - space.low)
    rows = []
    for k, name in enumerate(space.names):
        value, one_end, other_end = (float(place[k]) for place in values)
        effect, _, parameter = name.partition(".")
        rows.append(
            FittedParameter(
                effect, parameter, value, min(one_end, other_end), max(one_end, other_end), space.units[k],
                bool(identifiable[k]), bool(at_bound[k]),
            )
        )  # fmt: skip
    return tuple(rows)


def _misfit(model: FitModel, measured: Float, weigh: Callable[[Float], Whitener], place: Float) -> float:
    """Mean square of the whitened difference of the means; 1 if it is due to scatter alone."""
    simulated = model.summaries(place, AT_OPTIMUM)
    whitener = weigh(model.centred(simulated))
    left = whitener(measured.mean(axis=0) - simulated.mean(axis=0))
    return float(np.mean(left**2) / (1 / len(measured) + 1 / len(simulated)))


def _every_other(counts: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mask of every other recording of each count, so that both halves have equal shares of all counts."""
    earlier = [int(np.sum(counts[:i] == count)) for i, count in enumerate(counts)]
    return np.asarray(np.array(earlier) % 2 == 0)
