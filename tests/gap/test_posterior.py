"""The joint posterior on rigs made by formula, whose truth is known without simulation."""

from __future__ import annotations

import dataclasses
import itertools
import sys

import numpy as np
import pytest
from scipy.stats import multivariate_t
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from benchmarks.hidden_effects._table import calibration_error
from cyclofeat.gap import EffectPosterior, World, load_posterior
from cyclofeat.gap.check import PosteriorScore
from cyclofeat.gap.posterior.calibration import (
    cause_logits,
    gain_and_offset,
    mean_coefficients,
    mean_predictors,
    quantiles_of,
    spread_power,
)
from cyclofeat.gap.world.world import Rigs, Session
from cyclofeat.simulators import Gain, Hum, Offset

pytestmark = pytest.mark.slow

CELLS = ("speed: input speed by the mesh lines", "amplitudes: mean", "hum", "noise", "other")
SIZES = ("hum.amplitude_nm", "offset.offset_nm", "gain.factor", "unseen.size")
N_RECORDINGS = 6


def made(n_rigs, seed):
    """Rigs whose hum is plain, whose offset and gain move the mean alone, and with an effect nobody sees."""
    random = np.random.default_rng(seed)
    machines = np.arange(n_rigs) // 2
    present = random.random((n_rigs, 4)) < 0.35
    sizes = np.column_stack(
        [random.normal(0, 0.7, n_rigs), random.choice([-1, 1], n_rigs) * random.uniform(0.8, 3, n_rigs),
         random.choice([-1, 1], n_rigs) * random.uniform(0.05, 0.1, n_rigs), random.normal(size=n_rigs)]
    )  # fmt: skip
    speed, load = random.uniform(350, 700, (2, n_rigs, 3))
    load = 10 + 20 * (load - 350) / 350
    direction = random.choice([-1, 1], (n_rigs, 3))
    three = random.random(n_rigs) < 0.5
    at = np.where(three[:, None], np.arange(N_RECORDINGS) % 3, 0)
    conditions = np.stack([np.take_along_axis(one, at, 1) for one in (speed, load, direction)], axis=2)
    counts = random.integers(0, 8, (n_rigs, N_RECORDINGS))
    values = random.normal(size=(n_rigs, N_RECORDINGS, len(CELLS)))
    values[:, :, 0] = 0.1 * random.normal(size=counts.shape)
    values[:, :, 2] += conditions[:, :, 0] / 50 + counts + np.where(present[:, :1], 6 + sizes[:, :1], 0)
    effect = np.where(present, np.where([True, True, False, False], sizes, np.expm1(sizes)), 0)
    mean = conditions[:, :, 1] * (1 + effect[:, 2:3]) + conditions[:, :, 2] * effect[:, 1:2]
    values[:, :, 1] = mean + 0.02 * values[:, :, 1]
    return Rigs(
        names=("hum", "offset", "gain", "unseen"), size_names=SIZES, logarithmic=(True, False, True, False),
        cells=CELLS, numbers=np.arange(n_rigs), machines=machines, values=values.astype(np.float32),
        conditions=conditions, counts=counts,
        speeds=conditions[:, :, 0] * (1 + random.normal(0, 1e-3, counts.shape)),
        sizes=np.where(present, sizes, np.nan),
        world=World(effects=(Hum(), Offset(), Gain()), most=3).to_dict(),
    )  # fmt: skip


@pytest.fixture(scope="module")
def rigs():
    return made(4000, 2)


@pytest.fixture(scope="module")
def posterior(rigs):
    return EffectPosterior(1, epochs=22).fit(rigs.of(rigs.machines < 1600))


@pytest.fixture(scope="module")
def few(rigs):
    return rigs.of(rigs.machines < 120)


@pytest.fixture(scope="module")
def hasty(few):
    """A posterior that is right in form only."""
    return EffectPosterior(1, epochs=2).fit(few)


@pytest.fixture(scope="module")
def held_out(rigs):
    return rigs.of(rigs.machines >= 1600)


def sessions_of(rigs):
    return [rigs.session(k) for k in range(len(rigs))]


def recalls(posterior, rigs):
    """Share of the rigs with each effect in which it is named."""
    named = posterior.predict_proba(sessions_of(rigs)) > 0.5
    return {name: named[rigs.present[:, k], k].mean() for k, name in enumerate(rigs.names)}


def test_what_can_be_seen_is_named_and_what_cannot_keeps_its_prior(posterior, held_out):
    assert recalls(posterior, held_out)["hum"] > 0.97
    found = posterior.predict_proba(sessions_of(held_out))
    assert abs(found[:, 3].mean() - 0.35) < 0.06
    assert found[:, 3].std() < 0.12
    # The calibration rests on as many machines as the held-out rigs: it may err as much as chance does here.
    random = np.random.default_rng(0)
    drawn = random.random((50, found.size)) < found.ravel()
    by_chance = np.mean([calibration_error(found.ravel(), present) for present in drawn])
    assert calibration_error(found.ravel(), held_out.present.ravel()) < 2 * by_chance


def test_gain_and_offset_come_apart_at_several_loads_and_directions_only(posterior, held_out):
    one = np.ptp(held_out.conditions[:, :, 1], axis=1) == 0
    apart = np.abs(held_out.conditions[:, :, 1].max(axis=1) / held_out.conditions[:, :, 1].min(axis=1)) > 1.6

    def right(rows):
        found = recalls(posterior, held_out.of(rows))
        return min(found["offset"], found["gain"])

    assert right(apart) > 0.85
    assert right(one) < right(apart) - 0.1


def test_intervals_hold_as_often_as_they_say_and_sizes_are_in_their_unit(posterior, held_out):
    found = np.array([[*guess.sizes.values()] for guess in posterior.guess(sessions_of(held_out))])
    assert np.all(np.diff(found, axis=2) >= 0)
    true = np.where(held_out.logarithmic, np.exp(held_out.sizes), held_out.sizes)
    inside = (found[:, :, 0] <= true) & (true <= found[:, :, 4])
    for k, name in enumerate(SIZES):
        assert 0.8 <= inside[held_out.present[:, k], k].mean() <= 0.98, name
    rows = np.flatnonzero(held_out.present[:, 0])
    found = found[rows]
    true = np.exp(held_out.sizes[rows, 0])
    assert np.median(np.abs(np.log(found[:, 0, 2] / true))) < 0.4
    # Of a size that no recording shows, the interval is that of the prior.
    of_unseen = np.median(found[:, 3], axis=0)
    np.testing.assert_allclose(of_unseen, [-1.64, -0.67, 0, 0.67, 1.64], atol=0.45)


def test_an_effect_is_seen_from_the_size_at_which_half_of_the_rigs_are_named(posterior, held_out):
    # Of the hum nearly all is named, of what nobody sees nothing: it is in no world, and has no limit.
    seen_from = posterior.visible_from
    assert list(seen_from) == ["hum", "offset", "gain"]
    assert seen_from["hum"][0] == "amplitude_nm"
    assert np.isnan(seen_from["hum"][1])
    assert seen_from["hum"][2] < 0.4
    assert seen_from["gain"][1] == pytest.approx(1 / seen_from["gain"][2])
    visible, presence = (
        np.array([[*stated.values()] for stated in column])
        for column in zip(
            *((one.visible, one.presence) for one in posterior.guess(sessions_of(held_out))), strict=True
        )
    )
    assert np.all(np.isnan(visible[:, 3]))
    assert np.all(visible[:, :3] <= presence[:, :3])
    truly = np.nan_to_num(np.abs(held_out.sizes[:, 1])) > posterior.limits_[1]
    assert visible[:, 1].mean() == pytest.approx(truly.mean(), abs=0.04)


def test_the_order_of_recordings_does_not_matter(hasty, held_out):
    for counts in (True, False):
        one = held_out.session(3, counts=counts, tachometer=True)
        other = held_out.session(3, [4, 1, 0, 5, 3, 2], counts=counts, tachometer=True)
        np.testing.assert_allclose(
            list(hasty.presence(one).values()), list(hasty.presence(other).values()), rtol=1e-5, atol=1e-7
        )


def test_sessions_of_any_number_of_recordings(hasty, rigs):
    session = rigs.session(0, counts=False)
    many = Session(np.vstack([session.values] * 7)[:40], np.vstack([session.conditions] * 7)[:40])
    for one in (rigs.session(0, [0, 1, 2, 3]), session, many):
        found = hasty.presence(one)
        assert list(found) == list(rigs.names)
        assert all(0 <= p <= 1 for p in found.values())
        sizes = hasty.guess([one])[0].sizes
        assert list(sizes) == list(SIZES)
        assert sizes["hum.amplitude_nm"].shape == (5,)


def test_a_saved_posterior_answers_alike_without_a_pickle(hasty, held_out, tmp_path):
    path = hasty.save(tmp_path / "posterior.npz")
    loaded = load_posterior(path)
    sessions = [held_out.session(k) for k in range(50)]
    # Weights have 11 bits.
    np.testing.assert_allclose(loaded.predict_proba(sessions), hasty.predict_proba(sessions), atol=0.01)
    for one, other in zip(loaded.guess(sessions), hasty.guess(sessions), strict=True):
        np.testing.assert_allclose([*one.sizes.values()], [*other.sizes.values()], rtol=0.02, atol=0.02)
    again = load_posterior(loaded.save(tmp_path / "again.npz"))
    np.testing.assert_array_equal(again.predict_proba(sessions), loaded.predict_proba(sessions))
    assert sorted(file.name for file in tmp_path.iterdir()) == ["again.npz", "posterior.npz"]
    assert again.get_params() == hasty.get_params()
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(
        ValueError, match="posterior.npz holds no posterior of effects that this version reads"
    ):
        load_posterior(path)
    for written in (lambda file: np.savez(file, values=np.zeros(3)), lambda file: np.save(file, 1.0)):
        with path.open("wb") as file:
            written(file)
        with pytest.raises(ValueError, match=r"holds no posterior of effects .*; cyclofeat gap --prepare"):
            load_posterior(path)


def test_equal_seeds_give_equal_posteriors(hasty, few):
    other = clone(hasty).fit(few)
    session = [few.session(0)]
    np.testing.assert_array_equal(hasty.predict_proba(session), other.predict_proba(session))
    assert other.get_params() == hasty.get_params()


def test_networks_are_averaged_and_progress_is_told(few):
    told = []
    posterior = EffectPosterior(2, epochs=2).fit(few, progress=lambda done, total: told.append((done, total)))
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert len(posterior.networks_) == 2
    weights = [network["answer"] for network in posterior.networks_]
    assert not np.allclose(*weights)


def test_a_posterior_goes_on_from_another_one(posterior, hasty, few, held_out):
    gone_on = EffectPosterior(1, epochs=2).fit(few, start=posterior)
    assert gone_on.n_rigs_ == posterior.n_rigs_ + len(few)
    before, after = (
        PosteriorScore.of(one.predict_proba(sessions_of(held_out)), held_out.present, held_out.names)
        for one in (hasty, gone_on)
    )
    assert after.sets_right_with_ties > before.sets_right_with_ties + 0.1
    assert recalls(gone_on, held_out)["hum"] > 0.95


def test_a_posterior_goes_on_with_other_effects(posterior, few, held_out):
    """Without the gain, in another order, and with one that the first has not learned."""

    def other(some):
        return dataclasses.replace(
            some, names=("new", "offset", "hum"), size_names=("new.size", SIZES[1], SIZES[0]),
            logarithmic=(False, False, True), sizes=some.sizes[:, [3, 1, 0]],
            world=World(effects=(Offset(), Hum()), most=2, quantity="input_torque").to_dict(),
        )  # fmt: skip

    gone_on = EffectPosterior(1, epochs=2).fit(other(few), start=posterior)
    assert gone_on.n_rigs_ == len(few)  # of its own world alone
    assert recalls(gone_on, other(held_out))["hum"] > 0.95
    place = (posterior.size_names_.index(SIZES[0]), gone_on.size_names_.index(SIZES[0]))
    before, after = (one.size_mean_[k] for one, k in zip((posterior, gone_on), place, strict=True))
    assert before == after


def test_a_start_that_does_not_fit_is_refused(hasty, few):
    with pytest.raises(
        ValueError, match=r"start must have summaries like the 5 of the rigs, got one with 5: "
    ):
        EffectPosterior(1).fit(dataclasses.replace(few, cells=("other", *CELLS[1:])), start=hasty)
    with pytest.raises(ValueError, match=r"start must have learned counts of \[0, 2, 4, 6\], .* \[0, 1"):
        EffectPosterior(1).fit(dataclasses.replace(few, counts=few.counts // 2 * 2), start=hasty)
    with pytest.raises(ValueError, match="start must have 2 networks, got 1"):
        EffectPosterior(2).fit(few, start=hasty)
    with pytest.raises(NotFittedError):
        EffectPosterior(1).fit(few, start=EffectPosterior())


def test_an_effect_that_too_few_machines_have_is_left_out(rigs):
    few = rigs.of(rigs.machines < 120)
    few.sizes[10:, 3] = np.nan
    posterior = EffectPosterior(1, epochs=2).fit(few)
    assert np.isnan(posterior.presence(few.session(0))["unseen"])
    assert np.isnan(posterior.guess([few.session(0)])[0].sizes["unseen.size"]).all()


def test_without_jax_training_says_what_to_install(few, monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", None)
    with pytest.raises(ImportError, match=r"needs JAX and Optax: pip install jax optax"):
        EffectPosterior(1, epochs=1).fit(few)


def test_bad_input_is_named(hasty, rigs):
    with pytest.raises(NotFittedError):
        EffectPosterior().presence(rigs.session(0))
    wrong = Session(np.zeros((3, 2)), np.ones((3, 3)))
    with pytest.raises(ValueError, match=r"session must hold recordings with the 5 .* got .*\(3, 2\)"):
        hasty.presence(wrong)
    for conditions, message in (
        ((900, 20, 1), r"speeds in RPM from 35\d\.?\d* to .*, got 900 to 900"),
        ((500, 50, 1), "loads in Nm from 10"),
    ):
        with pytest.raises(ValueError, match=message):
            hasty.presence(Session(np.zeros((1, 5)), np.array([conditions], dtype=float)))
    with pytest.raises(ValueError, match=r"counts of \[0, 1, .*, 7\], like the world .* got \[9\]"):
        hasty.presence(Session(np.zeros((1, 5)), np.array([[500.0, 20.0, 1.0]]), counts=np.array([9])))
    with pytest.raises(ValueError, match="epochs must be at least 1, got 0"):
        EffectPosterior(epochs=0).fit(rigs)
    with pytest.raises(ValueError, match="rigs must hold at least 100 recordings of rigs without an effect"):
        EffectPosterior().fit(rigs.of(rigs.present.any(axis=1)))


# The pieces against formulas


def test_causes_of_the_mean_by_the_evidence_of_eight_models():
    """The evidence of each set of causes is a multivariate t density."""
    random = np.random.default_rng(3)
    load, direction = random.uniform(10, 30, (5, 9)), random.choice([-1.0, 1.0], (5, 9))
    conditions = np.stack([np.full((5, 9), 500.0), load, direction], axis=2)
    shown = np.arange(9) < np.array([[9], [8], [7], [5], [4]])
    error = np.hypot(0.003 * load, 0.05)
    moved = np.array([[0.0, 0.0], [0.02, 0.0], [0.0, -0.3], [0.004, 0.1], [0.0, 0.0]])
    mean = load * (1 + moved[:, :1]) + moved[:, 1:] * direction + random.normal(0, error)
    said = cause_logits(mean, conditions, shown)
    spreads, chances = np.array([0.03, 0.5, 0.15]), np.array([0.18, 0.09, 0.09])
    for k in range(5):
        rows = shown[k]
        causes = np.stack([load[k], direction[k], np.ones(9)])[:, rows] / error[k, rows] * spreads[:, None]
        y = ((mean[k] - load[k]) / error[k])[rows]
        weights = {}
        for chosen in itertools.product((False, True), repeat=3):
            some = causes[list(chosen)]
            density = multivariate_t(np.zeros(y.size), np.eye(y.size) + some.T @ some, df=6).pdf(y)
            weights[chosen] = density * np.prod(np.where(chosen, chances, 1 - chances))
        for cause in range(3):
            there = sum(weight for chosen, weight in weights.items() if chosen[cause])
            truth = np.log(there / (sum(weights.values()) - there))
            assert said[k, cause] == pytest.approx(np.clip(truth, -8, 8), abs=1e-6)


def test_what_moves_the_mean_alone_is_learned_where_nothing_else_does():
    names = ("gain", "load_warm_up", "hum", "offset")
    random = np.random.default_rng(5)
    n = 6000
    present = random.random((n, 4)) < 0.3
    causes = np.where(present[:, [0, 3, 2]], 3.0, -3.0) + random.normal(0, 1.5, (n, 3))
    causes[present[:, 1]] = random.normal(0, 3.0, (present[:, 1].sum(), 3))
    logits = random.normal(-1.0, 0.1, (n, 4))
    logits[:, 1] = np.where(present[:, 1], 4.0, -4.0)
    predictors = mean_predictors(logits, causes, names)
    coefficients = mean_coefficients(predictors, present, names)
    assert np.isfinite(coefficients).all(axis=1).tolist() == [True, False, False, True]
    found = predictors @ coefficients[0, :-1] + coefficients[0, -1] > 0
    cold = ~present[:, 1]
    assert np.mean(found[cold] == present[cold, 0]) > 0.95
    assert np.mean(found[~cold] == present[~cold, 0]) < 0.75
    few = mean_coefficients(predictors[:200], present[:200], names)
    assert np.isnan(few).all()


def test_the_power_of_spreads_is_found_with_a_factor_for_each_size():
    random = np.random.default_rng(4)
    spreads = np.exp(random.normal(-1.0, 0.5, (3000, 4)))
    errors = random.normal(0, [0.5, 1.0, 2.0, 4.0] * spreads**1.4)
    errors[random.random(errors.shape) < 0.8] = np.nan
    assert spread_power(errors, spreads) == pytest.approx(1.4, abs=0.08)
    power = spread_power(errors, spreads)
    covered = np.abs(errors / spreads**power) <= quantiles_of(errors / spreads**power)[:, 4]
    for wide in (spreads > 0.5, spreads < 0.25):
        assert covered[wide & np.isfinite(errors)].mean() == pytest.approx(0.9, abs=0.03)
    assert spread_power(np.full((30, 2), np.nan), np.ones((30, 2))) == 1.0


def test_gain_and_offset_by_least_squares():
    random = np.random.default_rng(2)
    load, direction = random.uniform(10, 30, 12), random.choice([-1.0, 1.0], 12)
    conditions = np.column_stack([np.full(12, 500.0), load, direction])
    # At one load and direction the prior shares the deviation out. Recordings not shown are not used.
    same = np.array([[500.0, 22.0, 1.0]] * 12)
    mean = np.stack([1.03 * load + 0.4 * direction, np.r_[np.full(6, 23.0), np.full(6, 1e3)]])
    shown = np.stack([np.ones(12, dtype=bool), np.arange(12) < 6])
    apart, together = gain_and_offset(mean, np.stack([conditions, same]), shown)
    gain, offset = np.sinh(apart[3:5]) * (0.003, 0.05)
    assert gain == pytest.approx(0.03, abs=0.002)
    assert offset == pytest.approx(0.4, abs=0.03)
    assert apart[-1] == pytest.approx(np.log(0.1), abs=0.1)
    gain, offset = np.sinh(together[3:5]) * (0.003, 0.05)
    assert gain * 22 + offset == pytest.approx(1.0, rel=0.01)
    assert offset / (22 * gain) == pytest.approx(1.0 / (22 * 0.06) ** 2, rel=1e-6)
    # Alone, each is a least-squares fit to deviations in units of their errors, and leaves the rest of them.
    error = np.hypot(0.003 * load, 0.05)
    deviation = (mean[0] - load) / error
    for k, cause in enumerate((load / error, direction / error, 1 / error)):
        z, left = linear_fit(cause, deviation)
        assert np.sinh(apart[k]) == pytest.approx(z)
        assert apart[9 + k] == pytest.approx(np.log(left / 12 + 0.1))
    assert apart[12] == pytest.approx(np.log(deviation @ deviation / 12 + 0.1))


def linear_fit(cause, deviation):
    """Slope over its standard error for errors of 1, and the sum of squares left."""
    (slope,), (left,), *_ = np.linalg.lstsq(cause[:, None], deviation, rcond=None)
    return slope * np.sqrt(cause @ cause), left


def test_padding_changes_no_answer(hasty, held_out):
    """Sessions of 4 and 6 recordings, together and each by itself."""
    few, many = held_out.session(0, [0, 1, 2, 3], counts=False), held_out.session(1, tachometer=True)
    together = hasty.predict_proba([few, many])
    np.testing.assert_allclose(together[0], hasty.predict_proba([few])[0], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(together[1], hasty.predict_proba([many])[0], rtol=1e-5, atol=1e-7)


def test_calibration_error_is_that_of_a_coin():
    random = np.random.default_rng(0)
    p = random.random(20_000)
    assert calibration_error(p, random.random(20_000) < p) < 0.015
    assert calibration_error(np.full(1000, 0.9), np.arange(1000) % 2 == 0) == pytest.approx(0.4)
