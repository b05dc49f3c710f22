"""The joint posterior on rigs made by formula, whose truth is known without simulation."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from threadpoolctl import threadpool_limits

from cyclofeat.gap.posterior import (
    EffectPosterior,
    calibration_error,
    gain_and_offset,
    load_posterior,
    random_session,
    score_posterior,
)
from cyclofeat.gap.world import Rigs, Session

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
    )  # fmt: skip


@pytest.fixture(autouse=True, scope="module")
def _one_thread():
    """Trees of a few rows are too small to share: threads only make them slower."""
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="module")
def rigs():
    return made(1200, 1)


@pytest.fixture(scope="module")
def posterior(rigs):
    return EffectPosterior(max_iter=30).fit(rigs.of(rigs.machines < 400))


@pytest.fixture(scope="module")
def held_out(rigs):
    return rigs.of(rigs.machines >= 400)


def test_what_can_be_seen_is_named_and_what_cannot_keeps_its_prior(posterior, held_out):
    score = score_posterior(posterior, held_out)
    assert score.effect_recall["hum"] > 0.97
    assert score.effect_precision["hum"] > 0.97
    sessions = [held_out.session(k) for k in range(len(held_out))]
    found = posterior.predict_proba(sessions)
    assert abs(found[:, 3].mean() - 0.35) < 0.06
    assert found[:, 3].std() < 0.12
    # The calibration rests on as many machines as the held-out rigs: it may err as much as chance does here.
    random = np.random.default_rng(0)
    drawn = random.random((50, found.size)) < found.ravel()
    by_chance = np.mean([calibration_error(found.ravel(), present) for present in drawn])
    assert score.calibration_error < 2 * by_chance


def test_gain_and_offset_come_apart_at_several_loads_and_directions_only(posterior, held_out):
    one = np.ptp(held_out.conditions[:, :, 1], axis=1) == 0
    apart = np.abs(held_out.conditions[:, :, 1].max(axis=1) / held_out.conditions[:, :, 1].min(axis=1)) > 1.6

    def right(rows):
        score = score_posterior(posterior, held_out.of(rows))
        return min(score.effect_recall["offset"], score.effect_recall["gain"])

    assert right(apart) > 0.85
    assert right(one) < right(apart) - 0.1


def test_intervals_hold_as_often_as_they_say_and_sizes_are_in_their_unit(posterior, held_out):
    score = score_posterior(posterior, held_out)
    assert set(score.coverage) == set(SIZES)
    for name, coverage in score.coverage.items():
        assert 0.8 <= coverage <= 0.98, name
    rows = np.flatnonzero(held_out.present[:, 0])
    found = posterior.predict_quantiles([held_out.session(k) for k in rows])
    assert np.all(np.diff(found, axis=2) >= 0)
    true = np.exp(held_out.sizes[rows, 0])
    assert np.median(np.abs(np.log(found[:, 0, 2] / true))) < 0.4
    # Of a size that no recording shows, the interval is that of the prior.
    of_unseen = np.median(found[:, 3], axis=0)
    np.testing.assert_allclose(of_unseen, [-1.64, -0.67, 0, 0.67, 1.64], atol=0.45)


def test_the_order_of_recordings_does_not_matter(posterior, held_out):
    for counts in (True, False):
        one = held_out.session(3, counts=counts, tachometer=True)
        other = held_out.session(3, [4, 1, 0, 5, 3, 2], counts=counts, tachometer=True)
        np.testing.assert_allclose(
            list(posterior.presence(one).values()), list(posterior.presence(other).values()), rtol=1e-9
        )


def test_sessions_of_any_number_of_recordings(posterior, rigs):
    session = rigs.session(0, counts=False)
    many = Session(np.vstack([session.values] * 7)[:40], np.vstack([session.conditions] * 7)[:40])
    for one in (rigs.session(0, [0, 1, 2, 3]), session, many):
        found = posterior.presence(one)
        assert list(found) == list(rigs.names)
        assert all(0 <= p <= 1 for p in found.values())
        sizes = posterior.sizes(one)
        assert list(sizes) == list(SIZES)
        assert sizes["hum.amplitude_nm"].shape == (5,)


def test_views_are_random_subsets_without_failed_recordings(rigs):
    one = rigs.of([0])
    one.values[0, 2] = np.nan
    random = np.random.default_rng(0)
    views = [random_session(one, 0, random) for _ in range(60)]
    assert {len(view.values) for view in views} == {4, 5}
    assert all(np.isfinite(view.values).all() for view in views)
    assert {(view.counts is None, view.speeds_rpm is None) for view in views} == {
        (True, True), (True, False), (False, True), (False, False),
    }  # fmt: skip


def test_a_saved_posterior_answers_to_the_last_bit(posterior, held_out, tmp_path):
    path = posterior.save(tmp_path / "posterior.joblib")
    loaded = load_posterior(path, trusted=True)
    sessions = [held_out.session(k) for k in range(5)]
    np.testing.assert_array_equal(loaded.predict_proba(sessions), posterior.predict_proba(sessions))
    np.testing.assert_array_equal(loaded.predict_quantiles(sessions), posterior.predict_quantiles(sessions))
    assert [file.name for file in tmp_path.iterdir()] == ["posterior.joblib"]
    with pytest.raises(ValueError, match="is a pickle, which can run any code.*trusted=True"):
        load_posterior(path)
    path.write_bytes(path.read_bytes()[:0])
    with pytest.raises(EOFError):
        load_posterior(path, trusted=True)


def test_equal_seeds_give_equal_posteriors(rigs):
    few = rigs.of(rigs.machines < 120)
    one, other = (EffectPosterior(max_iter=5, n_views=1).fit(few) for _ in range(2))
    session = [few.session(0)]
    np.testing.assert_array_equal(one.predict_proba(session), other.predict_proba(session))
    assert clone(one).get_params() == one.get_params()


def test_an_effect_that_too_few_machines_have_is_left_out(rigs):
    few = rigs.of(rigs.machines < 120)
    few.sizes[10:, 3] = np.nan
    posterior = EffectPosterior(max_iter=5, n_views=1).fit(few)
    assert "unseen" not in posterior.classifiers_
    assert np.isnan(posterior.presence(few.session(0))["unseen"])
    assert np.isnan(posterior.sizes(few.session(0))["unseen.size"]).all()
    score = score_posterior(posterior, rigs.of(rigs.machines >= 400))
    assert score.effect_recall["unseen"] == 0
    assert "unseen.size" not in score.coverage


def test_bad_input_is_named(posterior, rigs):
    with pytest.raises(NotFittedError):
        EffectPosterior().presence(rigs.session(0))
    wrong = Session(np.zeros((3, 2)), np.ones((3, 3)))
    with pytest.raises(ValueError, match=r"session must hold recordings with the 5 .* got .*\(3, 2\)"):
        posterior.presence(wrong)
    for conditions, message in (
        ((900, 20, 1), r"speeds in RPM from 35\d\.?\d* to .*, got 900 to 900"),
        ((500, 50, 1), "loads in Nm from 10"),
    ):
        with pytest.raises(ValueError, match=message):
            posterior.presence(Session(np.zeros((1, 5)), np.array([conditions], dtype=float)))
    with pytest.raises(ValueError, match=r"counts of \[0, 1, .*, 7\], like the world .* got \[9\]"):
        posterior.presence(Session(np.zeros((1, 5)), np.array([[500.0, 20.0, 1.0]]), counts=np.array([9])))
    with pytest.raises(ValueError, match="n_views must be at least 1, got 0"):
        EffectPosterior(n_views=0).fit(rigs)
    with pytest.raises(ValueError, match="rigs must hold at least 100 recordings of rigs without an effect"):
        EffectPosterior().fit(rigs.of(rigs.present.any(axis=1)))


# The pieces against formulas


def test_gain_and_offset_by_least_squares():
    random = np.random.default_rng(2)
    load, direction = random.uniform(10, 30, 12), random.choice([-1.0, 1.0], 12)
    conditions = np.column_stack([np.full(12, 500.0), load, direction])
    gain, offset, *_, remainder = gain_and_offset(1.03 * load + 0.4 * direction, conditions)
    assert gain == pytest.approx(0.03, abs=0.002)
    assert offset == pytest.approx(0.4, abs=0.03)
    assert remainder == pytest.approx(np.log(0.1), abs=0.1)
    # At one load and direction the prior shares the deviation out.
    same = np.array([[500.0, 22.0, 1.0]] * 12)
    gain, offset, *_ = gain_and_offset(np.full(12, 23.0), same)
    assert gain * 22 + offset == pytest.approx(1.0, rel=0.01)
    assert offset / (22 * gain) == pytest.approx(1.0 / (22 * 0.06) ** 2, rel=1e-6)


def test_calibration_error_is_that_of_a_coin():
    random = np.random.default_rng(0)
    p = random.random(20_000)
    assert calibration_error(p, random.random(20_000) < p) < 0.015
    assert calibration_error(np.full(1000, 0.9), np.arange(1000) % 2 == 0) == pytest.approx(0.4)


def test_scores_count_sets_and_ties(held_out):
    class Fixed:
        """Names a gain where there is an offset or a gain, and always knows of the others."""

        regressors_ = ()

        def predict_proba(self, sessions):
            present = held_out.present.astype(float)
            present[:, 2] = np.maximum(present[:, 1], present[:, 2])
            present[:, 1] = 0
            return present

        def predict_quantiles(self, sessions):
            return np.zeros((len(sessions), 4, 5))

    class Unlearned(Fixed):
        """Has not learned the last effect."""

        def predict_proba(self, sessions):
            return np.column_stack([super().predict_proba(sessions)[:, :3], np.full(len(sessions), np.nan)])

    present = held_out.present
    # Offsets with a probability of 0, and gains with one of 1 that are offsets: of three effects.
    wrong = present[:, 1].sum() + (present[:, 1] & ~present[:, 2]).sum()
    error = score_posterior(Unlearned(), held_out).calibration_error
    assert error == pytest.approx(wrong / present[:, :3].size)
    score = score_posterior(Fixed(), held_out)
    assert all(share == 1 for share in score.with_ties.values())
    assert score.between(0, 4) == pytest.approx(np.mean(~present[:, 1]))
    named = present[:, [0, 3]].sum() + (present[:, 1] | present[:, 2]).sum()
    right = present[:, [0, 2, 3]].sum()
    assert score.precision == pytest.approx(right / named)
    assert score.recall == pytest.approx(right / present.sum())
    assert score.effect_recall["offset"] == 0
    assert np.isnan(score.effect_precision["offset"])
    assert np.isnan(score.between(5, 6))
