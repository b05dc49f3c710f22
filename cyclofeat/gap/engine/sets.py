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
from scipy.special import logsumexp
from scipy.stats import norm

from cyclofeat.gap.engine.projection import Projection

Float = NDArray[np.float64]

_MOST_CANDIDATES = 13  # effects that may be present or not: their sets are enumerated
_LEAST_STRENGTH = 0.3  # of an added effect, in units of its guessed size
_PRIOR_WEIGHT = 0.5  # of the log odds of earlier probabilities; calibrated on simulated sets
_FIXED = 1e12  # precision of a coefficient that is fixed
_SURE = 2e-3  # earlier probabilities are no nearer to 0 or 1
_STEPS, _BACKWARDS = 30, (1.0, 0.5, 0.25, 0.1)


class Column(NamedTuple):
    """What a change of a rig does.

    ``kind`` is "size" of an effect that the rig has ("" for what no effect is), "without" an effect that it
    has, or "with" one that it lacks. ``mean`` and ``precision`` are those of the coefficient's prior.
    """

    kind: str
    effect: str
    mean: float = 1.0
    precision: float = 1.0


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
    best set leaves widens all errors.
    """
    shown = np.zeros(len(columns), dtype=bool)
    shown[[change for change, _ in projection.terms]] = True
    kinds = np.array([column.kind for column in columns])
    owners = [column.effect for column in columns]
    candidates = sorted(
        {owners[k] for k in np.flatnonzero(shown & (kinds != "size"))}, key=lambda name: -presence[name]
    )[:_MOST_CANDIDATES]
    certain = {owners[k] for k in np.flatnonzero(kinds != "with")} - {"", *candidates}
    sure = {"", *certain}  # "" is no effect: always there
    every = np.array([*itertools.product((False, True), repeat=len(candidates))], dtype=bool)
    flags = every[len(certain) + every.sum(axis=1) <= most]
    # Each number of effects is equally probable, but for the odds.
    before = np.clip([presence[name] for name in candidates], _SURE, 1 - _SURE)
    odds = np.log(before / (1 - before)) - math.log(most / 2 / (len(presence) - most / 2))
    ways = [math.comb(len(presence), len(certain) + n) for n in flags.sum(axis=1).tolist()]
    prior = _PRIOR_WEIGHT * (flags @ odds) - np.log(ways)
    has = np.array(
        [
            flags[:, candidates.index(owner)] if owner in candidates else np.full(len(flags), owner in sure)
            for owner in owners
        ]
    ).T
    measured, responses = projection.linearised(sizes)
    misfit, precision = 1.0, np.linalg.inv(projection.covariance)
    for _ in range(3):
        hessian = responses.T @ precision @ responses / misfit
        gradient = responses.T @ precision @ measured / misfit
        evidence, values, covariance = _solve_sets(hessian, gradient, columns, has & shown, shown)
        best = int(np.argmax(evidence + prior))
        left = measured - responses @ values[best]
        freedom = max(len(measured) - int(np.count_nonzero(np.diag(covariance[best]))), 1)
        misfit = max(float(left @ precision @ left) / freedom, 1.0)
    logarithms = evidence + prior

    def shares_of(sets: NDArray[np.bool_]) -> Float:
        return np.asarray(np.exp(np.where(sets, logarithms, -np.inf) - logsumexp(logarithms[sets])))

    shares = shares_of(np.ones(len(flags), dtype=bool))
    whole = shares_of(np.asarray(has[:, kinds == "without"].all(axis=1)))
    mean = whole @ values
    apart = values - mean
    return LinearFit(
        mean,
        np.einsum("s,sjk->jk", whole, covariance) + np.einsum("s,sj,sk->jk", whole, apart, apart),
        dict(zip(candidates, (shares @ flags).tolist(), strict=True)),
        {
            owners[k]: float(shares_of(has[:, k]) @ values[:, k])
            for k in np.flatnonzero(kinds == "with")
            if owners[k] in candidates
        },
    )


def _solve_sets(
    hessian: Float, gradient: Float, columns: Sequence[Column], present: NDArray[np.bool_], shown: Float
) -> tuple[Float, Float, Float]:
    """Return log evidence, coefficients and their covariance of sets, the first axis of each.

    ``present`` (n_sets, n_columns): whether a set has the effect of a column. Fixed ones have no variance.
    """
    kinds = np.array([column.kind for column in columns])
    mean, before = np.array([(column.mean, column.precision) for column in columns]).reshape(-1, 2).T
    free = present & (kinds != "without")
    fixed = np.where((kinds == "without") & shown, ~present, 0.0)
    left = gradient - fixed @ hessian
    before, mean = np.where(free, before, _FIXED), np.where(free, mean, 0.0)
    covariance = np.linalg.inv(hessian + before[:, None] * np.eye(len(columns)))
    target = np.where(free, left, 0.0) + before * mean
    values = np.einsum("sjk,sk->sj", covariance, target)
    evidence = np.sum(fixed * (gradient + left) + target * values - before * mean**2, axis=1) / 2
    evidence += (np.linalg.slogdet(covariance)[1] + np.log(before).sum(axis=1)) / 2
    # An added effect has a strength that is positive, and not tiny.
    spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    after = norm.logcdf((values - _LEAST_STRENGTH) / spread) - norm.logcdf(
        (mean - _LEAST_STRENGTH) * np.sqrt(before)
    )
    evidence += np.sum(after, axis=1, where=free & (kinds == "with"))
    return evidence, np.where(free, values, fixed), covariance * (free[:, :, None] & free[:, None])
