"""Linear responses: sizes, sets of effects and what they leave, on rigs whose answers are known exactly."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from cyclofeat.gap.confirm.confirm import judge_remainder
from cyclofeat.gap.engine.projection import Change, project
from cyclofeat.gap.engine.sets import Column, fit_responses, subtract_fit, weigh_sets

N_RECORDINGS, N_CELLS = 8, 40
RESPONSES = np.random.default_rng(1).normal(size=(4, N_CELLS)) * 0.2
MIXING = np.eye(N_CELLS) + 0.3 * np.random.default_rng(2).normal(size=(N_CELLS, N_CELLS)) / np.sqrt(N_CELLS)


def cells_of(sizes, seed, n=1, curvature=0.0):
    """Sessions whose cells follow the sizes, with correlated noise that depends on the seed alone."""
    noise = np.random.default_rng(seed).normal(size=(n, N_RECORDINGS, N_CELLS)) @ MIXING
    sizes = np.asarray(sizes, dtype=float)
    return noise + sizes @ RESPONSES[: len(sizes)] + curvature * sizes[0] ** 2 * RESPONSES[3]


def projected(true, at, columns, n_sessions=25, seed=0, curvature=0.0, step=0.3):
    """Projection of a session with ``true`` sizes on the responses of a rig ``at`` others."""
    at, changes = np.asarray(at, dtype=float), []
    for k, column in enumerate(columns):
        places = (step, -step) if column.kind == "size" else (1.0,)
        moved = [
            at + (-at[k] if column.kind == "without" else place) * (np.arange(len(at)) == k)
            for place in places
        ]
        changes.append(
            Change(np.array([cells_of(one, seed, n_sessions, curvature)[:2] for one in moved]), places)
        )
    base = cells_of(at, seed, n_sessions, curvature)
    return project(cells_of(true, 1000 + seed, 1, curvature)[0], base, changes, np.full(N_CELLS, 1e-3))


SIZES = [Column("size", "a", 0.0, 1e-4), Column("size", "b", 0.0, 1e-4)]


@pytest.mark.slow
def test_intervals_of_sizes_hold_the_truth_as_often_as_they_say():
    inside, errors = [], []
    for seed in range(60):
        true = np.random.default_rng(seed).normal(size=2) * 0.3
        fit = fit_responses(projected(true, [0.0, 0.0], SIZES, seed=seed), SIZES, np.full(2, 2.0))
        reach = stats.norm.ppf(0.95) * np.sqrt(np.diag(fit.covariance))
        inside += (np.abs(fit.sizes - true) < reach).tolist()
        errors.append(fit.sizes - true)
    assert np.mean(inside) == pytest.approx(0.9, abs=0.09)
    # The best estimator, which knows the covariance of the cells, errs by this much.
    information = RESPONSES[:2] @ np.linalg.inv(MIXING.T @ MIXING) @ RESPONSES[:2].T * N_RECORDINGS
    best = np.sqrt(np.diag(np.linalg.inv(information)))
    assert np.all(np.std(errors, axis=0) < 1.5 * best)


def test_a_response_that_bends_is_followed():
    true, sizes = [1.0, 0.2], []
    for seed in range(12):
        bent = projected(true, [0.0, 0.0], SIZES, seed=seed, curvature=3.0)
        sizes.append(fit_responses(bent, SIZES, np.full(2, 2.0)).sizes)
    assert np.abs(np.mean(sizes, axis=0) - true).max() < 0.15


def test_noise_of_responses_does_not_hold_a_size_where_it_is():
    """Over a small step the noise of pairs looks like a bend, by which a size could not move on."""
    sizes, step, true = [], 0.1, [1.5, 0.0]
    for seed in range(12):
        random, base = np.random.default_rng([seed, 1]), cells_of([0.0, 0.0], seed, 25)
        changes = []
        for k in range(2):
            places = (step, -step)
            moved = [cells_of(place * np.eye(2)[k], seed, 25)[:2] for place in places]
            noisy = [one + 0.05 * random.normal(size=one.shape) for one in moved]
            changes.append(Change(np.array(noisy), places))
        projection = project(cells_of(true, 1000 + seed)[0], base, changes, np.full(N_CELLS, 1e-3))
        sizes.append(fit_responses(projection, SIZES, np.full(2, 3.0)).sizes)
    assert np.mean(sizes, axis=0)[0] > 0.8 * true[0]


def test_sizes_stay_within_reach_and_without_a_column_there_is_nothing_to_fit():
    fit = fit_responses(projected([1.0, 0.0], [0.0, 0.0], SIZES), SIZES, np.array([0.4, 2.0]))
    assert fit.sizes[0] == 0.4
    assert not fit_responses(
        projected([0.5], [0.5], [Column("with", "c")]), [Column("with", "c")], np.ones(1)
    ).sizes.any()


def test_sets_are_weighed_as_by_integration_over_each_set():
    columns = [
        Column("size", "a", 0.0, 1.0),
        Column("without", "a"),
        Column("with", "b", least=0.3),
        Column("with", "c", least=0.3),
    ]
    at, true = [1.0, 0.0, 0.0, 0.0], [1.2, 0.0, 2.4, 0.0]
    changes, base = [], cells_of(at, 0, 25)
    for places, rigs in (
        ((0.3, -0.3), ([1.3, 0, 0], [0.7, 0, 0])), ((1.0,), ([0, 0, 0],)),
        ((1.0,), ([1, 3, 0],)), ((1.0,), ([1, 0, 3],)),
    ):  # fmt: skip
        changes.append(
            Change(np.array([cells_of([*rig[:1], 0, *rig[1:]], 0, 25)[:2] for rig in rigs]), places)
        )
    projection = project(cells_of(true, 7)[0], base, changes, np.full(N_CELLS, 1e-3))
    presence = {"a": 0.9, "b": 0.3, "c": 0.1} | dict.fromkeys("defghij", 0.0)
    found = weigh_sets(projection, columns, np.zeros(4), presence, 6)
    measured, responses = projection.linearised(np.zeros(4))
    logs = {}
    for flags in itertools.product((0, 1), repeat=3):
        a, b, c = flags
        # Coefficients: Gaussian where free, fixed where the effect is absent.
        mean = np.array([0.0, 1.0 - a, float(b), float(c)])
        variance = np.diag([float(a), 0.0, float(b), float(c)])
        covariance = projection.covariance + responses @ variance @ responses.T
        log = stats.multivariate_normal.logpdf(measured, responses @ mean, covariance)
        for k, flag in ((2, b), (3, c)):
            if flag:
                gain = variance @ responses.T @ np.linalg.inv(covariance)
                after = mean + gain @ (measured - responses @ mean)
                left = (variance - gain @ responses @ variance)[k, k]
                log += stats.norm.logcdf((after[k] - 0.3) / np.sqrt(left)) - stats.norm.logcdf(0.7)
        for name, flag in zip("abc", flags, strict=True):
            p = presence[name]
            log += 0.5 * flag * (math.log(p / (1 - p)) - math.log(3 / 7))
        logs[flags] = log - math.log(math.comb(10, sum(flags)))
    weights = np.exp(np.array([*logs.values()]) - max(logs.values()))
    weights /= weights.sum()
    for k, name in enumerate("abc"):
        exact = sum(w for w, flags in zip(weights, logs, strict=True) if flags[k])
        assert found.probabilities[name] == pytest.approx(exact, abs=1e-6)
    assert found.probabilities["b"] > 0.95 > 0.5 > found.probabilities["c"]
    assert found.strengths["b"] == pytest.approx(0.8, abs=0.25)
    assert found.sizes[0] == pytest.approx(0.2, abs=0.6)
    # Nothing to decide: one set.
    sizes = [column._replace(kind="size") for column in columns]
    assert weigh_sets(projection, sizes, np.zeros(4), presence, 6).probabilities == {}


def test_an_unlikely_effect_among_many_is_found_where_it_explains_the_session():
    """However many effects there are; those that are not varied have odds too."""
    names = [*"abcdefghijklmnopqrst"]
    responses = 0.4 * np.random.default_rng(3).normal(size=(20, N_CELLS))
    base = cells_of([0.0], 0, 25)
    changes = [Change((base[:2] + response)[None], (1.0,)) for response in responses]
    measured = cells_of([0.0], 7)[0] + responses[-1]
    projection = project(measured, base, changes, np.full(N_CELLS, 1e-3))
    columns = [Column("with", name) for name in names]
    presence = dict(zip(names, np.linspace(0.4, 0.02, 20).tolist(), strict=True))
    found = weigh_sets(projection, columns, np.zeros(20), presence, 6).probabilities
    assert found.keys() == presence.keys()
    assert found.pop("t") > 0.95
    assert max(found.values()) < 0.5
    assert sum(found.values()) < sum(presence.values()) / 2


def test_what_no_change_explains_remains():
    columns = [*SIZES[:1], Column("with", "b", least=0.3)]
    p = {name: [] for name in ("itself", "size", "undecided", "strange")}
    for seed in range(15):
        for name, true in (
            ("itself", [0, 0]),
            ("size", [2, 0]),
            ("undecided", [0, 6]),
            ("strange", [0, 0, 0, 6]),
        ):
            projection = projected(true, [0.0, 0.0], columns, seed=seed)
            measured = projection.deviations(cells_of(true, 1000 + seed)[0])[None]
            for kinds in (("size",), ("size", "with")):
                left = [
                    subtract_fit(projection, columns, kinds, one) for one in (projection.sessions, measured)
                ]
                test = judge_remainder(left[0], left[1][0])
                p[name].append(test.p)
    shares = {name: np.mean(np.reshape(values, (-1, 2)) < 0.05, axis=0) for name, values in p.items()}
    assert max(shares["itself"].max(), shares["size"].max(), shares["undecided"][1]) <= 0.2
    assert min(shares["strange"].min(), shares["undecided"][0]) > 0.6
