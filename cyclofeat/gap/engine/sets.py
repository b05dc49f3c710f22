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

MOST_CANDIDATES = 13  # effects that may be present or not: their sets are enumerated
_LEAST_STRENGTH = 0.3  # of an added effect, in units of its guessed size
_PRIOR_WEIGHT = 0.5  # of the log odds of earlier probabilities; calibrated on simulated sets
_SURE = 2e-3  # earlier probabilities are no nearer to 0 or 1
_STEPS, _BACKWARDS = 30, (1.0, 0.5, 0.25, 0.1)


class Column(NamedTuple):
    """What a change of a rig does.

    ``kind`` is "size" of an effect that the rig has ("" for what no effect is), "without" an effect that it
    has, or "with" one that it lacks. ``mean`` and ``precision`` are those of the prior of the coefficient.
    """

    kind: str
    effect: str
    mean: float = 1.0
    precision: float = 1.0


@dataclass(frozen=True)
class LinearFit:
    """Sizes and sets that explain a session.

    ``sizes`` by column, 0 for columns that are no size, with their ``covariance``; with sets, over those that
    have all effects of the rig. ``probabilities`` of effects by name; ``strengths`` of added effects by name,
    each over the sets that have it.
    """

    sizes: Float
    covariance: Float
    probabilities: Mapping[str, float] = field(default_factory=dict)
    strengths: Mapping[str, float] = field(default_factory=dict)


def fit_responses(projection: Projection, columns: Sequence[Column], reach: Float) -> LinearFit:
    """Fit the sizes of all columns, by Gauss-Newton steps from the middle and from either side of each size.

    Parameters
    ----------
    projection : Projection
    columns : sequence of Column
        One for each change; those that are no size keep 0.
    reach : ndarray, shape (n_changes,)
        Largest change of each size.

    Returns
    -------
    LinearFit
        The misfit widens the covariance.
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
    """Return what the best changes of some kinds leave of the mean deviations of sessions.

    ``deviations`` has the shape (n_sessions, n_recordings, n_cells), the result (n_sessions, n_cells).
    """
    free = [k for k, column in enumerate(columns) if column.kind in kinds]
    _, responses = projection.linearised(np.zeros(len(columns)))
    weighted = np.linalg.solve(projection.covariance, responses[:, free]).T
    before = np.diag([columns[k].precision for k in free])
    gain = np.linalg.solve(weighted @ responses[:, free] + before, weighted)
    changes = projection.statistics(deviations) @ gain.T
    return np.asarray(deviations.mean(axis=1) - changes @ projection.slopes[free])


def weigh_sets(
    projection: Projection,
    columns: Sequence[Column],
    sizes: Float,
    presence: Mapping[str, float],
    most: int,
) -> LinearFit:
    """Return the posterior over the sets of effects that columns add or leave out.

    Parameters
    ----------
    projection : Projection
    columns : sequence of Column
        One for each change of the projection.
    sizes : ndarray, shape (n_changes,)
        Sizes around which responses are linear.
    presence : mapping from str to float
        Earlier probability of each effect that is known.
    most : int
        Largest number of effects at once. Before, each number is equally probable, and each set of it.

    Returns
    -------
    LinearFit
        What the best set leaves widens all errors.
    """
    shown = {change for change, _ in projection.terms}
    candidates = sorted(
        {column.effect for k, column in enumerate(columns) if column.kind != "size" and k in shown},
        key=lambda name: -presence[name],
    )[:MOST_CANDIDATES]
    certain = {column.effect for column in columns if column.kind in ("size", "without")} - {"", *candidates}
    measured, responses = projection.linearised(sizes)
    odds = {
        name: math.log(p / (1 - p)) - math.log(most / 2 / (len(presence) - most / 2))
        for name in candidates
        for p in [min(max(presence[name], _SURE), 1 - _SURE)]
    }
    misfit, precision = 1.0, np.linalg.inv(projection.covariance)
    for _ in range(3):
        hessian = responses.T @ precision @ responses / misfit
        gradient = responses.T @ precision @ measured / misfit
        rows = []
        for flags in itertools.product((False, True), repeat=len(candidates)):
            present = certain | {name for name, flag in zip(candidates, flags, strict=True) if flag}
            if len(present) > most:
                continue
            prior = _PRIOR_WEIGHT * sum(odds.get(name, 0.0) for name in present)
            prior -= math.log(math.comb(len(presence), len(present)))
            evidence, values, covariance = _solve_set(hessian, gradient, columns, shown, present)
            rows.append((evidence + prior, present, values, covariance))
        best = max(rows, key=lambda row: row[0])
        left = measured - responses @ best[2]
        freedom = max(len(measured) - int(np.count_nonzero(np.diag(best[3]))), 1)
        misfit = max(float(left @ precision @ left) / freedom, 1.0)
    logarithms = np.array([row[0] for row in rows])
    values = np.array([row[2] for row in rows])

    def shares_of(names: set[str]) -> Float:
        has = np.array([names <= row[1] for row in rows])
        return np.asarray(np.exp(np.where(has, logarithms, -np.inf) - logsumexp(logarithms[has])))

    shares, whole = (
        shares_of(set()),
        shares_of({column.effect for column in columns if column.kind == "without"}),
    )
    mean = whole @ values
    apart = values - mean
    covariance = np.einsum("s,sjk->jk", whole, np.array([row[3] for row in rows]))
    return LinearFit(
        mean,
        covariance + np.einsum("s,sj,sk->jk", whole, apart, apart),
        {name: float(shares @ [name in row[1] for row in rows]) for name in candidates},
        {
            column.effect: float(shares_of({column.effect}) @ values[:, k])
            for k, column in enumerate(columns)
            if column.kind == "with" and column.effect in candidates
        },
    )


def _solve_set(
    hessian: Float, gradient: Float, columns: Sequence[Column], shown: set[int], present: set[str]
) -> tuple[float, Float, Float]:
    """Return log evidence, coefficients and their covariance, both by column; fixed ones have no variance."""
    coefficients = np.zeros(len(columns))
    free = []
    for k in sorted(shown):
        column = columns[k]
        if column.kind == "without":
            coefficients[k] = column.effect not in present
        elif not column.effect or column.effect in present:
            free.append(k)
    left = gradient - hessian @ coefficients
    evidence = float(coefficients @ (gradient + left) / 2)
    mean, before = np.array([(columns[k].mean, columns[k].precision) for k in free]).reshape(-1, 2).T
    covariance = np.linalg.inv(hessian[np.ix_(free, free)] + np.diag(before))
    target = left[free] + before * mean
    values = covariance @ target
    evidence += float(target @ values - mean @ (before * mean)) / 2
    evidence += float(np.linalg.slogdet(covariance)[1] + np.log(before).sum()) / 2
    added = np.array([columns[k].kind == "with" for k in free], dtype=bool)
    # An added effect has a strength that is positive, and not tiny.
    spread = np.sqrt(np.diag(covariance))
    after = norm.logcdf((values - _LEAST_STRENGTH) / spread) - norm.logcdf(
        (mean - _LEAST_STRENGTH) * np.sqrt(before)
    )
    coefficients[free] = values
    whole = np.zeros_like(hessian)
    whole[np.ix_(free, free)] = covariance
    return evidence + float(after[added].sum()), coefficients, whole
