"""Confirmation by simulation: sizes of the named effects, and what they leave unexplained."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cyclofeat.gap.confirm.sessions import MOST_RECORDINGS, limit_recordings, simulate_sessions, with_sizes
from cyclofeat.gap.confirm.sizes import SMALLEST, Gaussian, RemainderTest, judge_remainder, size_posterior
from cyclofeat.gap.posterior.answers import ABSENT, PRESENT
from cyclofeat.gap.posterior.effect_posterior import EffectPosterior
from cyclofeat.gap.world.rigs import Session
from cyclofeat.gap.world.world import TOLERANCES
from cyclofeat.simulators import Effect
from cyclofeat.simulators.effects.library import look_alikes

Float = NDArray[np.float64]

# Rounds of simulation, and the inflation of the spreads from which its sizes are drawn.
_ROUNDS, _WIDER = 2, 1.5
_PRIOR_DRAWS = 400
_REJECTED = 0.02  # p of what is left, below which something else is missing
_NOT_OPEN = 0.05  # p of it with open effects besides, below which these do not explain it
# Sessions at the very sizes, and the factor by which the posterior's sizes must lie nearer to be kept.
_TRIED, _CLEARLY = 24, 2.0


@dataclass(frozen=True)
class Confirmation:
    """Named effects with fitted sizes, and the test of what they leave."""

    effects: tuple[Effect, ...]  # with the most probable sizes
    names: tuple[str, ...]  # of the sizes, as in World.size_names
    sizes: Gaussian = field(repr=False)  # joint distribution on the scale of their fit
    remainder: RemainderTest
    # Whether chance explains what they leave. If not, something else is missing too, and the sizes are those
    # of the posterior, which allow for it: fitted ones would make up for what is missing.
    accepted: bool
    difference: Float = field(repr=False)  # (n_cells,): mean of each summary less the simulated one
    open: bool = False  # they leave more than chance does, but no more than effects that are open would
    # False although accepted: sessions with the fitted sizes lie farther from the measured one than those
    # with the posterior's sizes, which are kept.
    fitted: bool = True

    @property
    def quantiles(self) -> list[tuple[float, float, float]]:
        """0.05, 0.5 and 0.95 quantile of each size, in the parameter's unit."""
        reach = stats.norm.ppf(0.95) * self.sizes.spread
        low, middle, high = (
            [float(getattr(effect, name)) for effect in effects for name in effect.vector_names()]
            for end in (self.sizes.mean - reach, self.sizes.mean, self.sizes.mean + reach)
            for effects in [with_sizes(self.effects, end)]
        )
        return list(zip(low, middle, high, strict=True))


def confirm_effects(
    posterior: EffectPosterior,
    session: Session,
    named: Sequence[str],
    *,
    possible: Sequence[Session] = (),
    n_sessions: int = 96,
    random_state: int,
    n_jobs: int = 1,
    progress: Callable[[str], object] = lambda _: None,
) -> Confirmation:
    """Simulate sessions like a measured one with the named effects, and fit their sizes.

    Twice: with sizes from the posterior, then around those that fit. How much recordings differ anyway is
    fitted as well, so that a rig that is better made than the world states is not taken for another one.

    The fit is linear. Where an effect sets in suddenly, like a limit near the mean torque, it may be far off.
    So sessions are simulated with the very sizes of the fit and of the posterior, and the posterior's sizes
    are kept if theirs lie clearly nearer to the measured one.

    At most 12 of the recordings are used; ``n_sessions`` are simulated each time. ``possible`` sessions are
    simulated like this one and have each effect as often as it is probable: they tell whether effects that
    are open would explain what is left.
    """
    world, shown = posterior.world, limit_recordings(session, MOST_RECORDINGS)
    effects = tuple(effect for effect in world.effects or () if effect.effect_id in named)
    names = tuple(f"{effect.effect_id}.{name}" for effect in effects for name in effect.vector_names())
    columns = [world.size_names.index(name) for name in names]

    def summarise(sessions: Sequence[Session]) -> tuple[Float, Float]:
        features = [_mean_and_spread(posterior.deviations(one)) for one in sessions]
        return np.array(features), posterior.standardised_sizes(sessions)[:, columns]

    def draw_tolerance(sizes: Gaussian, random: np.random.Generator) -> float:
        return float(np.clip(random.normal(sizes.mean[-1], sizes.spread[-1]), *TOLERANCES))

    observed, estimates = (part[0] for part in summarise([shown]))
    prior = _size_prior(effects)
    middle, spread = posterior.size_distribution(shown, names)
    believed = Gaussian(np.r_[middle, prior.mean[-1]], np.diag(np.r_[spread**2, prior.covariance[-1, -1]]))
    before = believed.without_last()
    simulate = functools.partial(simulate_sessions, world, shown, n_jobs=n_jobs)
    n_rounds, wider = (_ROUNDS, _WIDER) if names else (1, 1.0)
    for round_ in range(n_rounds):
        progress(f"simulating the named effects, {round_ + 1} of {n_rounds}")
        drawn = Gaussian(believed.mean, believed.covariance * wider**2)
        simulated = simulate(
            functools.partial(_draw_sizes, effects, drawn.without_last()), n_sessions,
            tolerance=functools.partial(draw_tolerance, drawn),
            random_state=random_state + round_,
        )  # fmt: skip
        sizes = np.column_stack([simulated.sizes[:, columns], simulated.tolerances])
        features, of_simulated = summarise(simulated.sessions)
        believed, fitted, fit = size_posterior(sizes, features, of_simulated, (observed, estimates), prior)
    of_possible = summarise(possible) if possible else None
    others = None if of_possible is None else (of_possible[0], fit(*of_possible))
    remainder = judge_remainder(features, sizes, fitted, observed, believed.mean, others)
    accepted = remainder.p >= _REJECTED

    def features_at(sizes: Gaussian) -> Float:
        at_sizes = simulate(
            lambda _: with_sizes(effects, sizes.mean), _TRIED, random_state=random_state + n_rounds,
            tolerance=lambda _: float(np.clip(believed.mean[-1], *TOLERANCES)),
        )  # fmt: skip
        return summarise(at_sizes.sessions)[0]

    after = believed.without_last()
    kept = accepted and not (names and lies_farther(observed, features_at(after), features_at(before)))
    final = after if kept else before
    simulated_mean = np.mean([one.values.mean(axis=0) for one in simulated.sessions], axis=0)
    return Confirmation(
        with_sizes(effects, final.mean), names, final, remainder, accepted,
        shown.values.mean(axis=0) - simulated_mean, not accepted and remainder.p_open >= _NOT_OPEN, kept,
    )  # fmt: skip


def _draw_sizes(
    effects: Sequence[Effect], sizes: Gaussian, random: np.random.Generator
) -> tuple[Effect, ...]:
    return with_sizes(effects, sizes.draw(random))


def lies_farther(observed: Float, simulated: Float, other: Float) -> bool:
    """Return True if simulated summaries lie clearly farther from observed ones than others do.

    By the mean square of the distances from their means, in spreads of one session about them. ``observed``
    has shape (n_summaries,), the others (n_sessions, n_summaries).
    """
    spread = np.hypot(np.sqrt((simulated.var(axis=0) + other.var(axis=0)) / 2), SMALLEST)
    far, near = (
        float(np.mean(((observed - values.mean(axis=0)) / spread) ** 2)) for values in (simulated, other)
    )
    return far > _CLEARLY * near


def _size_prior(effects: Sequence[Effect]) -> Gaussian:
    """Mean and covariance of the sizes, and of the tolerances' factor, before any recording."""
    random = np.random.default_rng(0)
    rows = []
    for _ in range(_PRIOR_DRAWS):
        sizes = [effect.draw_parameters(random).to_vector() for effect in effects]
        rows.append(np.concatenate([*sizes, [random.uniform(*TOLERANCES)]]))
    table = np.array(rows)
    return Gaussian(table.mean(axis=0), np.diag(table.var(axis=0) + 1e-12))


def _mean_and_spread(deviations: Float) -> Float:
    """Mean of the deviations over recordings, and the logarithm of the spread of the first half of them."""
    spread = deviations[:, : deviations.shape[1] // 2].std(axis=0)
    return np.concatenate([deviations.mean(axis=0), np.log(spread + 0.1)])


def draw_effects(
    posterior: EffectPosterior, session: Session, confirmed: Confirmation, n_draws: int, *, random_state: int
) -> tuple[tuple[Effect, ...], ...]:
    """Draw ``n_draws`` sets of missing effects, with sizes, from what the recordings leave possible.

    An effect is present with its probability: always from ``PRESENT`` on, never up to ``ABSENT``. Those of
    different groups of look-alikes are independent; those of a group occur together only as often as their
    probabilities, where they add up to more than 1, make necessary. Sizes of effects that are ``confirmed``
    for the session are drawn from their joint distribution, those of others each from its own.
    """
    random = np.random.default_rng(random_state)
    probabilities = {name: p for name, p in posterior.presence(session).items() if p > ABSENT}
    known = {effect.effect_id for effect in confirmed.effects}
    others = tuple(
        effect for effect in posterior.world.effects or () if effect.effect_id in probabilities.keys() - known
    )
    names = [f"{effect.effect_id}.{name}" for effect in others for name in effect.vector_names()]
    middle, spread = posterior.size_distribution(session, names)
    of_others = Gaussian(middle, np.diag(spread**2))
    drawn = []
    for _ in range(n_draws):
        every = (
            *_draw_sizes(confirmed.effects, confirmed.sizes, random),
            *_draw_sizes(others, of_others, random),
        )
        present = _draw_present(probabilities, random)
        drawn.append(tuple(effect for effect in every if effect.effect_id in present))
    return tuple(drawn)


def _draw_present(probabilities: Mapping[str, float], random: np.random.Generator) -> set[str]:
    """Draw the effects that are present."""
    groups = look_alikes()
    tied = {name for group in groups for name in group}
    present = set()
    for group in (*groups, *((name,) for name in probabilities if name not in tied)):
        # Systematic sampling (Madow 1949): the effects lie end to end, each as long as it is probable, and
        # every point one apart from a random first one picks the effect that it falls on.
        end, first = 0.0, random.random()
        for name in group:
            p = probabilities.get(name, 0.0)
            begin, end = end, end + (1.0 if p >= PRESENT else p)
            if math.ceil(end - first) > math.ceil(begin - first):
                present.add(name)
    return present
