"""Confirmation by simulation: which effects are missing, how large they are, and what they leave unexplained.

The posterior's networks guess. The session is then simulated with the guessed effects and, with the same
random numbers, with each size changed, each effect left out, and each undecided effect added. Sets and sizes
that explain the measured session are those of a linear model of these responses, which is made again around
them until they stand.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import block_diag
from sklearn.covariance import LedoitWolf
from sklearn.model_selection import KFold

from cyclofeat.gap.confirm.sessions import (
    MOST_RECORDINGS,
    TOLERANCE,
    DrawnRig,
    Point,
    RigChange,
    limit_recordings,
    relative_units,
    simulate_pairs,
    with_sizes,
    with_strength,
)
from cyclofeat.gap.engine.projection import Change, Projection, estimate_by_spreads, log_spreads, project
from cyclofeat.gap.engine.sets import Column, fit_responses, subtract_fit, weigh_sets
from cyclofeat.gap.posterior.answers import ABSENT, NAMED, PRESENT, named_effects
from cyclofeat.gap.posterior.effect_posterior import EffectPosterior
from cyclofeat.gap.summaries.summarise import smallest_spreads
from cyclofeat.gap.world.world import TOLERANCES, Session, World, size_names
from cyclofeat.simulators import Effect
from cyclofeat.simulators.effects.library import look_alikes

Float = NDArray[np.float64]

_ROUNDS_OF_SIZES, _MOST_ROUNDS = 2, 5
# Sessions that give a response, and that give the response of what differs between recordings anyway.
_PAIRS, _PAIRS_OF_TOLERANCE = 2, 8
_SHARES, _SESSIONS_OF_SHARE = (1.0, 0.5, 0.25), 4  # of a long move, and those that tell which is the best
# The posterior's spreads are taken this much wider as a prior, since it has seen the same recordings.
_WIDER = 2.0
# Deviations of sizes over those of a linear model without error, so that nine of ten intervals of 90 % hold
# the sizes in recordings of an independent simulator; and those within which a size stands.
_MODEL_ERROR, _STANDS = 1.3, 2.0
_MOST_ADDED = 12  # effects, the most probable first
_MANY_RIGS = 20_000  # from which a posterior's names stay, and what it takes to be absent is not tried
_UNSURE = 0.49  # probability of an effect that responses alone name, unless they are sure of it
_EXACT = 1e-6  # share of a guess's deviation that a size is known to at best: a limit may show exactly
_REJECTED = 0.02  # p of what is left, below which something else is missing
_FOLDS, _SMALLEST = 5, 0.05  # differences far below the spread of a recording, about 1, have no consequence
_NOT_OPEN = 0.05  # p with undecided effects besides, below which these do not explain it


@dataclass(frozen=True)
class RemainderTest:
    """Test of whether a session differs from simulated ones of the corrected rig.

    ``p`` is the share of sessions of the corrected rig that lie as far, ``z`` (n_summaries,) are the
    differences in standard deviations of a session, ``excess`` is the squared distance over a typical
    session's. ``p_undecided`` is the p if undecided effects may explain the differences.
    """

    p: float
    z: Float
    excess: float
    p_undecided: float = math.nan


def judge_remainder(simulated: Float, observed: Float) -> RemainderTest:
    """Compare what a fit leaves of a session, (n_summaries,), with what it leaves of simulated sessions.

    Squared Mahalanobis distances have their covariance from other sessions, shrunk; the p is that of
    Student's t in their logarithm.
    """
    centre, spread = simulated.mean(axis=0), np.hypot(simulated.std(axis=0, ddof=1), _SMALLEST)
    left, z = (simulated - centre) / spread, (observed - centre) / spread
    distances, of_folds = np.empty(len(left)), []
    for rest, held in KFold(_FOLDS).split(left):
        model = LedoitWolf().fit(left[rest])
        distances[held] = model.mahalanobis(left[held])
        of_folds.append(model.mahalanobis(z[None])[0])
    above = float(np.log(np.mean(of_folds)) - np.log(distances).mean())
    error = np.log(distances).std(ddof=1) * np.sqrt(1 + 1 / len(left))
    return RemainderTest(float(stats.t.sf(above / error, len(left) - 1)), z, float(np.exp(above)))


@dataclass(frozen=True)
class Confirmation:
    """Effects that explain a session, with sizes, and the test of what they leave."""

    effects: tuple[Effect, ...]  # named ones, with their sizes
    mean: Float = field(repr=False)  # (n_sizes,): of all their sizes on the scale of the fit
    covariance: Float = field(repr=False)  # (n_sizes, n_sizes)
    presence: Mapping[str, float] = field(repr=False)  # probability of each effect
    remainder: RemainderTest
    accepted: bool  # chance explains what they leave; if not, the sizes are wider for it
    difference: Float = field(repr=False)  # (n_cells,): mean of each summary less the simulated one
    open: bool = False  # they leave more than chance does, but no more than undecided effects would

    @property
    def quantiles(self) -> dict[str, tuple[float, float, float]]:
        """0.05, 0.5 and 0.95 quantile of each size by name, in the parameter's unit."""
        reach = stats.norm.ppf(0.95) * np.sqrt(np.diag(self.covariance))
        ends = [
            [float(getattr(one, name)) for one in with_sizes(self.effects, at) for name in one.vector_names()]
            for at in (self.mean - reach, self.mean, self.mean + reach)
        ]
        return dict(zip(size_names(self.effects), zip(*ends, strict=True), strict=True))


def confirm_effects(
    posterior: EffectPosterior,
    session: Session,
    presence: Mapping[str, float],
    *,
    n_recordings: int = 200,
    random_state: int,
    n_jobs: int = 1,
    progress: Callable[[str], object] = lambda _: None,
) -> Confirmation:
    """Find the effects and sizes with which simulated sessions are like a measured one.

    Sizes are settled first, because a wrong size looks like another effect; then undecided effects are added
    and named ones left out. How much recordings differ anyway is fitted too, so that a rig better made than
    the world states is not taken for another one. ``presence`` holds the posterior's probabilities. At most
    12 of the recordings are used; ``n_recordings`` are simulated of each rig around which responses are
    taken.
    """
    world, shown = posterior.world, limit_recordings(session, MOST_RECORDINGS)
    before = {one.effect_id: p for one in world.effects or () if np.isfinite(p := presence[one.effect_id])}
    guessed, guesses = _guess_sizes(posterior, shown)
    after, named, dropped = dict(before), set(named_effects(before)), set[str]()
    effects = tuple(guessed[name] for name in before if name in named)
    point = Point(effects, guesses[TOLERANCE][0], guesses, {})
    rounds: list[Confirmation] = []
    reliable = posterior.n_rigs_ >= _MANY_RIGS
    simulate = functools.partial(simulate_pairs, world, shown, random_state=random_state, n_jobs=n_jobs)
    for number in itertools.count(0 if named else _ROUNDS_OF_SIZES - 1):
        of_sets = number >= _ROUNDS_OF_SIZES
        progress(f"simulating {'undecided' if of_sets else 'the named'} effects, round {number + 1}")
        least = ABSENT if reliable else 0.0
        left = [name for name in before.keys() - named if before[name] > least or name in dropped]
        undecided = sorted(left, key=lambda name: (-before[name], name))[:_MOST_ADDED]
        changes = point.size_changes()
        if of_sets:
            changes += point.set_changes(guessed[name] for name in undecided)
        added = {one.column.effect: one.rigs[0][0][-1] for one in changes if one.column.kind == "with"}
        n_sessions = max(-(-n_recordings // len(shown.values)), _PAIRS_OF_TOLERANCE + 2)
        projection, columns = _simulate_responses(world, shown, point, changes, n_sessions, simulate)
        reach = np.array([2 * abs(change.places[0]) for change in changes])
        fit = fit_responses(projection, columns, reach)
        if of_sets:
            fit = weigh_sets(projection, columns, fit.sizes, before, world.prior.most)
        after |= fit.probabilities
        own = slice(len(point.names))
        moved = point.moved(np.clip(fit.sizes, -reach, reach)[own])
        move = np.asarray(np.linalg.solve(point.axes, moved.coordinates - point.coordinates))
        # Responses may change on a long step.
        linear, bent = fit.covariance[own, own], np.diag((move / 2) ** 2)
        leeway = _STANDS**2 * linear + bent
        spreads = np.sqrt(np.diag(leeway))
        stands = bool(np.all(np.abs(move) <= spreads))
        if not stands:
            moved = shorten_move(projection, shown, point, moved, move, simulate)
        present = {effect.effect_id: effect for effect in moved.effects}
        named = set(named_effects(after)) if of_sets else set(present)
        stands &= named == present.keys()
        dropped |= present.keys() - named
        guessed |= present | {
            name: with_strength(added[name], fit.strengths.get(name, 1.0)) for name in named - present.keys()
        }
        if of_sets:
            settled = settle_presence(before, after) if reliable else dict(after)
            others = [guessed[name] for name in named_effects(settled) if name not in present]
            covariance = point.axes @ (_MODEL_ERROR**2 * linear + bent) @ point.axes.T
            rounds.append(_conclude(projection, columns, shown, moved, covariance, settled, others))
            # An effect that the last round names gets one more for its sizes.
            if stands or number >= _MOST_ROUNDS - (named <= present.keys()):
                break
        leeway += np.diag(np.maximum(move**2 - spreads**2, 0))
        wider = point.axes @ leeway @ point.axes.T
        of_effect = {name: np.array(point.owners) == name for name in point.owners}
        known = {name: wider[np.ix_(rows, rows)] for name, rows in of_effect.items()}
        effects = tuple(guessed[name] for name in before if name in named)
        point = Point(effects, moved.tolerance, guesses, known)
    # A round that chance explains is as good as any other; of others, the closest to the session.
    return rounds[-1] if rounds[-1].accepted else min(rounds, key=lambda one: one.remainder.excess)


def settle_presence(before: Mapping[str, float], after: Mapping[str, float]) -> dict[str, float]:
    """Return the probabilities of effects by what names them more reliably.

    What the posterior names stays named: it was there where responses took it away. What it does not name is
    named if responses are sure of it, and otherwise stays undecided, however probable: half of it was there.
    """
    settled = dict(after)
    for name, p in before.items():
        if p >= NAMED > after[name]:
            settled[name] = p
        elif p < NAMED <= after[name] < PRESENT:
            settled[name] = _UNSURE
    return settled


def _guess_sizes(
    posterior: EffectPosterior, session: Session
) -> tuple[dict[str, Effect], dict[str, tuple[float, float]]]:
    """Return effects with the posterior's sizes (or their own), and mean and deviation of each coordinate."""
    fitted = posterior.guess([session])[0].fitted
    guessed, guesses = {}, {TOLERANCE: (float(np.mean(TOLERANCES)), float(np.ptp(TOLERANCES)) / 12**0.5)}
    for effect in posterior.world.effects or ():
        names = size_names([effect])
        middle, spread = np.array([fitted[name] for name in names]).reshape(-1, 2).T
        known = np.isfinite(middle) & np.isfinite(spread)
        vector = np.clip(np.where(known, middle, effect.to_vector()), *effect.vector_bounds())
        guessed[effect.effect_id] = effect.from_vector(vector)
        widths = np.where(known, _WIDER * spread, relative_units(effect))
        guesses |= dict(zip(names, zip(vector.tolist(), widths.tolist(), strict=True), strict=True))
    return guessed, guesses


def _simulate_responses(
    world: World, session: Session, point: Point, changes: Sequence[RigChange], n_sessions: int,
    simulate: Callable[[Sequence[DrawnRig], Sequence[int]], list[Float]],
) -> tuple[Projection, list[Column]]:  # fmt: skip
    """Simulate sessions of a rig and its changes, and project the measured session on the responses.

    Returns the columns of the changes too; the spreads between recordings tell what differs anyway.
    """
    place = point.names.index(TOLERANCE)
    rigs: list[DrawnRig] = [(point.effects, point.tolerance)]
    numbers = [n_sessions]
    for k, change in enumerate(changes):
        rigs += change.rigs
        numbers += [_PAIRS_OF_TOLERANCE if k == place else _PAIRS] * len(change.rigs)
    base, *changed = simulate(rigs, numbers)
    next_cells = iter(changed)
    cells = [Change(np.array([next(next_cells) for _ in change.rigs]), change.places) for change in changes]
    floors = smallest_spreads([*world.described_cells])
    projection = project(session.values, base, cells, floors)
    columns = [change.column for change in changes]
    estimate, error = estimate_by_spreads(projection, place, projection.deviations(session.values))
    columns[place] = columns[place]._replace(mean=estimate, precision=error**-2)
    return projection, columns


def shorten_move(
    projection: Projection, session: Session, point: Point, end: Point, move: Float,
    simulate: Callable[[Sequence[DrawnRig], Sequence[int]], list[Float]],
) -> Point:  # fmt: skip
    """Return the point on the way to the end whose simulated sessions are closest to the measured one.

    Responses change on a long ``move`` (along the axes): all of it may lead away.
    """
    places = [dataclasses.replace(point.moved(share * move), tolerance=end.tolerance) for share in _SHARES]
    cells = simulate(
        [(place.effects, point.tolerance) for place in places], [_SESSIONS_OF_SHARE] * len(places)
    )
    distances = [projection.distance(session.values, of_place) for of_place in cells]
    return places[int(np.argmin(distances))]


def _conclude(
    projection: Projection, columns: Sequence[Column], session: Session, point: Point, covariance: Float,
    presence: Mapping[str, float], added: Sequence[Effect],
) -> Confirmation:  # fmt: skip
    """Return what a round concludes: its sizes, wider where they leave more than chance does.

    Effects of the point that are no longer named are left out; ``added`` ones have the sizes of their guess.
    """
    remainder = _judge(projection, columns, session)
    accepted = remainder.p >= _REJECTED
    named = set(named_effects(presence))
    kept = [effect for effect in point.effects if effect.effect_id in named]
    own = np.array([owner in named for owner in point.owners])
    spreads = np.array([point.guesses[name][1] for name in np.array(point.names)[own]])
    covariance = block_diag(
        widen_covariance(covariance[np.ix_(own, own)], 1.0 if accepted else remainder.excess, spreads),
        np.diag([point.guesses[name][1] ** 2 for name in size_names(added)]),
    )
    mean = np.concatenate([point.coordinates[own], *(effect.to_vector() for effect in added)])
    return Confirmation(
        (*kept, *added), mean, covariance, presence, remainder, accepted,
        session.values.mean(axis=0) - projection.centre.mean(axis=0),
        not accepted and remainder.p_undecided >= _NOT_OPEN,
    )  # fmt: skip


def widen_covariance(covariance: Float, excess: float, spreads: Float) -> Float:
    """Return a covariance (n, n) of which the recordings' share counts ``excess`` times less, if above 1.

    The share of the guess, whose deviations are ``spreads`` (n,), stays: sizes are no less known than before.
    """
    share, before = 1 / max(excess, 1.0), np.diag(spreads**-2)
    known = np.linalg.inv(covariance + np.diag((_EXACT * spreads) ** 2))
    return np.asarray(np.linalg.inv(share * known + (1 - share) * before))


def _judge(projection: Projection, columns: Sequence[Column], session: Session) -> RemainderTest:
    """Compare what the sizes of the rig, and undecided effects, leave of a session and of simulated ones."""

    def leave(deviations: Float, *kinds: str) -> Float:
        mean = subtract_fit(projection, columns, kinds, deviations)
        return np.hstack([mean, log_spreads(deviations)])

    measured = projection.deviations(session.values)[None]
    test, undecided = (
        judge_remainder(leave(projection.sessions, *kinds), leave(measured, *kinds)[0])
        for kinds in (("size",), ("size", "with"))
    )
    return dataclasses.replace(test, p_undecided=undecided.p)


def draw_effects(
    posterior: EffectPosterior, session: Session, confirmed: Confirmation, n_draws: int, *, random_state: int
) -> tuple[tuple[Effect, ...], ...]:
    """Draw ``n_draws`` sets of missing effects, with sizes, from what the recordings leave possible.

    An effect is present with its probability: always from ``PRESENT`` on, never up to ``ABSENT``. Look-alikes
    occur together only as often as their probabilities, where they add up to more than 1, make necessary;
    others are independent. Sizes of effects that are ``confirmed`` are drawn from their joint distribution,
    those of others each from its own.
    """
    random = np.random.default_rng(random_state)
    probabilities = {name: p for name, p in confirmed.presence.items() if p > ABSENT}
    known = {effect.effect_id for effect in confirmed.effects}
    others = tuple(
        effect for effect in posterior.world.effects or () if effect.effect_id in probabilities.keys() - known
    )
    fitted = posterior.guess([session])[0].fitted
    middle, spread = np.array([fitted[name] for name in size_names(others)]).reshape(-1, 2).T
    factor = np.linalg.cholesky(confirmed.covariance)
    drawn = []
    for _ in range(n_draws):
        every = (
            *with_sizes(confirmed.effects, confirmed.mean + factor @ random.normal(size=len(factor))),
            *with_sizes(others, middle + spread * random.normal(size=spread.size)),
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
