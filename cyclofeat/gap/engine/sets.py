"""Posterior over sets of effects and their sizes, for statistics that are linear in both.

Errors are Gaussian. The sizes of each set are integrated out exactly; all sets are enumerated.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit, logsumexp
from scipy.stats import norm

from cyclofeat.gap.engine.projection import Projection

Float = NDArray[np.float64]
Flags = NDArray[np.bool_]

_MOST_CANDIDATES = 13  # effects that are varied: all their sets are enumerated
_PRIOR_WEIGHT = 0.5  # of the log odds of earlier probabilities; calibrated on simulated sets
_FIXED = 1e12  # precision of a coefficient that is fixed
_SURE = 2e-3  # earlier probabilities are no nearer to 0 or 1
_STEPS, _BACKWARDS = 30, (1.0, 0.5, 0.25, 0.1)


class Column(NamedTuple):
    """What a change of a rig does.

    ``kind`` is "size" of an effect that the rig has ("" for what no effect is), "without" an effect that it
    has, or "with" one that it lacks. ``mean`` and ``precision`` are those of the coefficient's prior, which
    is above ``least`` if the effect is added.
    """

    kind: str
    effect: str
    mean: float = 1.0
    precision: float = 1.0
    least: float = -math.inf


@dataclass(frozen=True)
class LinearFit:
    """Sizes and sets that explain a session.

    ``sizes`` by column, 0 for columns that are no size, with their ``covariance``; with sets, over those that
    have all effects of the rig. ``probabilities`` of effects, and ``strengths`` of added ones, by name.
    """

    sizes: Float
    covariance: Float
    probabilities: Mapping[str, float] = field(default_factory=dict)
    strengths: Mapping[str, float] = field(default_factory=dict)


def fit_responses(projection: Projection, columns: Sequence[Column], reach: Float) -> LinearFit:
    """Fit the sizes of all columns, by Gauss-Newton steps from the middle and from either side of each size.

    Columns, one for each change, keep 0 if they are no size. ``reach`` (n_changes,) is the largest change of
    each size. The misfit widens the covariance.
    """
    free = [k for k, column in enumerate(columns) if column.kind == "size"]
    mean, before = np.array([(columns[k].mean, columns[k].precision) for k in free]).reshape(-1, 2).T
    used = [row for row, (change, _) in enumerate(projection.terms) if change in free]
    precision = np.linalg.inv(projection.covariance[np.ix_(used, used)])

    def linear_model(sizes: Float) -> tuple[Float, Float]:
        every = np.zeros(len(columns))
        every[free] = sizes
        measured, responses = projection.linearised(every)
        return measured[used], responses[np.ix_(used, free)]

    def loss(sizes: Float) -> float:
        measured, responses = linear_model(sizes)
        left = measured - responses @ sizes
        return float(left @ precision @ left + before @ (sizes - mean) ** 2)

    limits = reach[free]
    starts = np.vstack([np.zeros(len(free)), np.diag(limits / 2), -np.diag(limits / 2)])
    ends = []
    for sizes in starts:
        for _ in range(_STEPS):
            measured, responses = linear_model(sizes)
            hessian = responses.T @ precision @ responses + np.diag(before)
            step = np.linalg.solve(hessian, responses.T @ precision @ measured + before * mean) - sizes
            tried = [np.clip(sizes + share * step, -limits, limits) for share in _BACKWARDS]
            better = next((one for one in tried if loss(one) < loss(sizes) - 1e-6), None)
            if better is None:
                break
            sizes = better
        ends.append(sizes)
    best = min(ends, key=loss)
    measured, responses = linear_model(best)
    left = measured - responses @ best
    misfit = max(float(left @ precision @ left) / max(len(used) - len(free), 1), 1.0)
    covariance = np.zeros((len(columns), len(columns)))
    information = responses.T @ precision @ responses / misfit
    covariance[np.ix_(free, free)] = np.linalg.inv(information + np.diag(before))
    every = np.zeros(len(columns))
    every[free] = best
    return LinearFit(every, covariance)


def subtract_fit(
    projection: Projection, columns: Sequence[Column], kinds: Collection[str], deviations: Float
) -> Float:
    """Return what the best changes of some kinds leave of mean deviations, (n_sessions, n_cells)."""
    free = [k for k, column in enumerate(columns) if column.kind in kinds]
    _, responses = projection.linearised(np.zeros(len(columns)))
    weighted = np.linalg.solve(projection.covariance, responses[:, free]).T
    before = np.diag([columns[k].precision for k in free])
    gain = np.linalg.solve(weighted @ responses[:, free] + before, weighted)
    changes = projection.statistics(deviations) @ gain.T
    return np.asarray(deviations.mean(axis=1) - changes @ projection.slopes[free])


def weigh_sets(
    projection: Projection, columns: Sequence[Column], sizes: Float, presence: Mapping[str, float], most: int
) -> LinearFit:
    """Return the posterior over the sets of effects that columns, one for each change, add or leave out.

    Responses are linear around ``sizes`` (n_changes,). ``presence`` is the earlier probability of each known
    effect. Each number of effects up to ``most`` is equally probable before, and each set of it. What the
    best set leaves widens all errors. Of many effects, those are varied that the best set gains most by
    adding them or leaving them out; the others have the odds of doing so.
    """
    names, owners = [*presence], np.array([column.effect for column in columns])
    kinds = np.array([column.kind for column in columns])
    shown = np.isin(np.arange(len(columns)), [change for change, _ in projection.terms])
    own = np.isin(names, owners[kinds != "with"])
    open_ones = np.isin(names, owners[shown & (kinds != "size")])
    odds = _PRIOR_WEIGHT * logit(np.clip([*presence.values()], _SURE, 1 - _SURE))
    # Each number of effects is equally probable, but for the odds.
    odds -= _PRIOR_WEIGHT * math.log(most / 2 / (len(names) - most / 2))
    measured, responses = projection.linearised(sizes)
    precision = np.linalg.inv(projection.covariance)

    def columns_of(sets: Flags) -> Flags:
        of_owners = [sets[:, names.index(owner)] if owner else np.full(len(sets), True) for owner in owners]
        return np.array(of_owners).T

    def solve(sets: Flags) -> tuple[Float, Float, Float]:
        weighted = responses.T @ precision / misfit
        evidence, *found = _solve_sets(
            weighted @ responses, weighted @ measured, columns, columns_of(sets) & shown, shown
        )
        ways = [math.comb(len(names), n) for n in sets.sum(axis=1).tolist()]
        return evidence + sets @ odds - np.log(ways), *found

    best, misfit = own, 1.0
    for _ in range(3):
        evidence = solve(np.vstack([best, best ^ np.eye(len(names), dtype=bool)]))[0]
        gains = np.where(open_ones, evidence[1:] - evidence[0], -np.inf)
        order = np.argsort(np.where(best ^ own, -np.inf, -gains), kind="stable")
        varied = order[: min(open_ones.sum(), _MOST_CANDIDATES)]
        sets = np.repeat(best[None], 2 ** len(varied), axis=0)
        sets[:, varied] = [*itertools.product((False, True), repeat=len(varied))]
        sets = sets[sets.sum(axis=1) <= max(most, own.sum())]
        evidence, values, covariance = solve(sets)
        first = int(np.argmax(evidence))
        best = sets[first]
        left = measured - responses @ values[first]
        freedom = max(len(measured) - int(np.count_nonzero(np.diag(covariance[first]))), 1)
        misfit = max(float(left @ precision @ left) / freedom, 1.0)

    def shares_of(chosen: Flags) -> Float:
        return np.asarray(np.exp(np.where(chosen, evidence, -np.inf) - logsumexp(evidence[chosen])))

    has = columns_of(sets)
    whole = shares_of(np.asarray(has[:, kinds == "without"].all(axis=1)))
    mean = whole @ values
    apart = values - mean
    probabilities = expit(np.where(best, -gains, gains))
    probabilities[varied] = shares_of(np.full(len(sets), True)) @ sets[:, varied]
    return LinearFit(
        mean,
        np.einsum("s,sjk->jk", whole, covariance) + np.einsum("s,sj,sk->jk", whole, apart, apart),
        {name: float(probabilities[k]) for k, name in enumerate(names) if open_ones[k]},
        {
            owners[k]: float(shares_of(has[:, k]) @ values[:, k])
            for k in np.flatnonzero((kinds == "with") & has.any(axis=0))
        },
    )


def _solve_sets(
    hessian: Float, gradient: Float, columns: Sequence[Column], present: Flags, shown: Flags
) -> tuple[Float, Float, Float]:
    """Return log evidence, coefficients and their covariance of sets, the first axis of each.

    ``present`` (n_sets, n_columns): whether a set has the effect of a column. Fixed ones have no variance.
    """
    kinds = np.array([column.kind for column in columns])
    mean, before, least = np.array([column[2:] for column in columns]).reshape(-1, 3).T
    free = present & (kinds != "without")
    fixed = np.where((kinds == "without") & shown, ~present, 0.0)
    left = gradient - fixed @ hessian
    before, mean = np.where(free, before, _FIXED), np.where(free, mean, 0.0)
    covariance = np.linalg.inv(hessian + before[:, None] * np.eye(len(columns)))
    target = np.where(free, left, 0.0) + before * mean
    values = np.einsum("sjk,sk->sj", covariance, target)
    evidence = np.sum(fixed * (gradient + left) + target * values - before * mean**2, axis=1) / 2
    evidence += (np.linalg.slogdet(covariance)[1] + np.log(before).sum(axis=1)) / 2
    spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    above = norm.logcdf((values - least) / spread) - norm.logcdf((mean - least) * np.sqrt(before))
    evidence += np.sum(above, axis=1, where=free & (kinds == "with"))
    return evidence, np.where(free, values, fixed), covariance * (free[:, :, None] & free[:, None])
