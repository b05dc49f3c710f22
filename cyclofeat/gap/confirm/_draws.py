"""Sets of effects drawn from the posterior: what a rig may lack, together."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from cyclofeat.gap.confirm._confirm import Confirmed
from cyclofeat.gap.confirm._sessions import sized
from cyclofeat.gap.confirm._sizes import Gaussian
from cyclofeat.gap.posterior import ABSENT, PRESENT, EffectPosterior
from cyclofeat.gap.world import Session
from cyclofeat.simulators import Effect
from cyclofeat.simulators.effects.library import look_alikes


def draw_effects(
    posterior: EffectPosterior, session: Session, confirmed: Confirmed, n_draws: int, *, random_state: int = 0
) -> tuple[tuple[Effect, ...], ...]:
    """Draw sets of missing effects, with sizes, from what the recordings leave possible.

    An effect is present with its probability: always from ``PRESENT`` on, never up to ``ABSENT``. Those of
    different groups of look-alikes are independent; those of a group occur together only as often as their
    probabilities, where they add up to more than 1, make necessary. Sizes of confirmed effects are drawn from
    their joint distribution, those of others each from its own.

    Parameters
    ----------
    posterior : EffectPosterior
    session : Session
    confirmed : Confirmed
        Of that session.
    n_draws : int
    random_state : int

    Returns
    -------
    tuple of tuple of Effect
        One set for each draw.
    """
    random = np.random.default_rng(random_state)
    possible = {name: p for name, p in posterior.presence(session).items() if p > ABSENT}
    known = {effect.effect_id for effect in confirmed.effects}
    others = tuple(
        effect for effect in posterior.world.effects or () if effect.effect_id in possible.keys() - known
    )
    names = [f"{effect.effect_id}.{name}" for effect in others for name in effect.vector_names()]
    middle, spread = posterior.size_distribution(session, names)
    of_others = Gaussian(middle, np.diag(spread**2))
    drawn = []
    for _ in range(n_draws):
        every = sized(confirmed.effects, confirmed.sizes.draw(random)), sized(others, of_others.draw(random))
        present = _present(possible, random)
        drawn.append(tuple(effect for part in every for effect in part if effect.effect_id in present))
    return tuple(drawn)


def _present(probabilities: Mapping[str, float], random: np.random.Generator) -> set[str]:
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
