"""Confirmation by simulation: formulas on Gaussian summaries, and a small world from end to end."""

from __future__ import annotations

import dataclasses
import functools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from cyclofeat.gap import EffectPosterior, GapSettings, World, find_gap, load_posterior, prepare_world
from cyclofeat.gap.confirm.confirm import Confirmation, confirm_effects, draw_effects, lies_farther
from cyclofeat.gap.confirm.sessions import simulate_sessions
from cyclofeat.gap.confirm.sizes import Gaussian, judge_remainder, size_posterior
from cyclofeat.gap.measured import MeasuredRig
from cyclofeat.gap.posterior.answers import named_effects
from cyclofeat.gap.world.rigs import Session
from cyclofeat.gap.world.world import NOISE_AND_DRIFT
from cyclofeat.recordings import Recording
from cyclofeat.simulators import Drift, Gain, Hum, Noise, Offset, Rig, Scale
from cyclofeat.simulators.effects import ShaftLine, SleeveFriction

RATE, SPEED, N_SIZES, N_FEATURES = 6400.0, 1350.0, 2, 12
PRIOR = Gaussian(np.zeros(N_SIZES), np.eye(N_SIZES))


def linear_world(n, seed):
    """Sizes from the prior, and summaries that follow them with noise of covariance 0.04."""
    random = np.random.default_rng(seed)
    slopes = np.random.default_rng(1).normal(size=(N_SIZES, N_FEATURES))
    sizes = random.normal(size=(n, N_SIZES))
    return sizes, sizes @ slopes + 0.2 * random.normal(size=(n, N_FEATURES)), slopes


def test_the_posterior_of_a_linear_gaussian_world_is_the_exact_one():
    sizes, features, slopes = linear_world(4000, 2)
    _, (observed,), _ = linear_world(1, 3)
    exact = np.linalg.inv(slopes @ slopes.T / 0.04 + np.eye(N_SIZES))
    mean = exact @ slopes @ observed / 0.04
    found, *_ = size_posterior(sizes, features, features[:, :2], (observed, observed[:2]), PRIOR)
    np.testing.assert_allclose(found.mean, mean, atol=0.03)
    np.testing.assert_allclose(found.covariance, exact, atol=0.15 * np.abs(exact).max())


@pytest.mark.slow
def test_intervals_of_sizes_hold_as_often_as_they_say():
    true, observed, _ = linear_world(300, 5)
    inside = []
    for k in range(0, 300, 3):
        sizes, features, _ = linear_world(64, 100 + k)
        found, *_ = size_posterior(sizes, features, features[:, :2], (observed[k], observed[k, :2]), PRIOR)
        inside.append(np.abs(found.mean - true[k]) < stats.norm.ppf(0.95) * found.spread)
    assert np.mean(inside) == pytest.approx(0.9, abs=0.07)


@pytest.mark.slow
def test_what_the_library_does_not_hold_remains_and_what_it_holds_does_not():
    sizes, features, _ = linear_world(96, 7)
    _, observed, _ = linear_world(200, 8)
    both = features[:, :2]
    p, p_of_strange = [], []
    for one in observed[:30]:
        found, fitted, _ = size_posterior(sizes, features, both, (one, one[:2]), PRIOR)
        p.append(judge_remainder(features, sizes, fitted, one, found.mean).p)
        strange = one + 2.0 * (np.arange(N_FEATURES) == 5)
        found, fitted, _ = size_posterior(sizes, features, both, (strange, strange[:2]), PRIOR)
        left = judge_remainder(features, sizes, fitted, strange, found.mean)
        p_of_strange.append(left.p)
    assert np.mean(np.array(p) < 0.05) < 0.15
    assert np.mean(np.array(p_of_strange) < 0.05) > 0.9
    assert np.argmax(np.abs(left.z)) == 5
    assert np.isnan(left.p_open)


def test_what_open_effects_would_leave_as_well_is_told_from_what_they_would_not():
    """Half of the rigs that are possible have an effect on summary 5, and none has one on summary 6."""
    sizes, features, _ = linear_world(96, 7)
    _, possible, _ = linear_world(32, 9)
    possible[::2, 5] += np.random.default_rng(0).uniform(0.5, 3.0, 16)
    _, (one,), _ = linear_world(1, 8)

    def left(column):
        changed = one + 2.0 * (np.arange(N_FEATURES) == column)
        found, fitted, fit = size_posterior(sizes, features, features[:, :2], (changed, changed[:2]), PRIOR)
        others = possible, fit(possible, possible[:, :2])
        return judge_remainder(features, sizes, fitted, changed, found.mean, others)

    assert left(5).p < 0.001
    assert left(5).p_open > 0.05


def test_sizes_are_compared_by_sessions_simulated_with_them():
    random = np.random.default_rng(0)
    observed, near = random.normal(size=30), random.normal(size=(24, 30))
    assert lies_farther(observed, near + 4.0, near)
    assert not lies_farther(observed, near, near + 4.0)
    assert not lies_farther(observed, near + 0.1, near)


class Stated:
    """A posterior that states given probabilities, and sizes of mean 0 and deviation 0.01."""

    def __init__(self, presence):
        effects = (Noise(), Hum(), Gain(), Offset(), Scale("load", 1.02), Drift(), Drift(of="sensor"))
        self.world = SimpleNamespace(effects=tuple(one for one in effects if one.effect_id in presence))
        self.presence = lambda session: presence

    def size_distribution(self, session, names):
        return np.zeros(len(names)), np.full(len(names), 0.01)


NO_SIZES = Gaussian(np.zeros(0), np.zeros((0, 0)))


def drawn_sets(presence, n=2000, effects=(), sizes=NO_SIZES, seed=0):
    confirmed = Confirmation(effects, (), sizes, None, True, None)
    return draw_effects(Stated(presence), None, confirmed, n, random_state=seed)


def present_in(sets, name):
    return np.array([any(effect.effect_id == name for effect in effects) for effects in sets])


@pytest.mark.slow
def test_effects_are_drawn_with_their_probabilities_and_look_alikes_apart():
    presence = {
        "noise": 0.97, "hum": 0.3, "gain": 0.5, "offset": 0.35, "load_scale": 0.04, "load_drift": 0.7,
        "sensor_drift": 0.6, "clearance": np.nan,
    }  # fmt: skip
    sets = drawn_sets(presence)
    share = {name: present_in(sets, name).mean() for name in presence}
    for name, certain in (("noise", 1), ("load_scale", 0), ("clearance", 0)):
        assert share[name] == certain
    for name in ("hum", "gain", "offset", "load_drift", "sensor_drift"):
        assert share[name] == pytest.approx(presence[name], abs=0.045), name  # 4 sigma
    assert not np.any(present_in(sets, "gain") & present_in(sets, "offset"))
    drifts = present_in(sets, "load_drift"), present_in(sets, "sensor_drift")
    assert np.all(drifts[0] | drifts[1])
    assert np.mean(drifts[0] & drifts[1]) == pytest.approx(0.3, abs=0.045)
    both = np.mean(present_in(sets, "hum") & present_in(sets, "gain"))
    assert both == pytest.approx(0.3 * 0.5, abs=0.035)


def test_the_same_seed_draws_the_same_sets():
    presence = {"noise": 0.5, "gain": 0.5}
    assert drawn_sets(presence, 20) == drawn_sets(presence, 20)
    assert drawn_sets(presence, 20) != drawn_sets(presence, 20, seed=1)
    assert drawn_sets({}, 3) == ((), (), ())


@pytest.mark.slow
def test_sizes_of_confirmed_effects_are_drawn_together_and_the_others_beside():
    effects = (Noise(), Gain())
    mean = np.array([*Noise(0.3).to_vector(), *Gain(1.1).to_vector()])
    covariance = np.array([[0.01, -0.0008], [-0.0008, 0.0001]])
    sets = drawn_sets(
        {"noise": 0.99, "gain": 0.99, "hum": 0.99}, effects=effects, sizes=Gaussian(mean, covariance)
    )
    vectors = np.array([np.concatenate([one.to_vector() for one in effects]) for effects in sets])
    assert [one.effect_id for one in sets[0]] == ["noise", "gain", "hum"]
    np.testing.assert_allclose(vectors.mean(axis=0)[:2], mean, atol=0.01)
    np.testing.assert_allclose(np.cov(vectors[:, :2].T), covariance, rtol=0.15)
    assert vectors[:, 2].std() == pytest.approx(0.01, rel=0.1)
    assert abs(np.corrcoef(vectors.T)[2, :2]).max() < 0.09


SMALL = World(
    effects=(Noise(), Gain(), ShaftLine()), most=2, sampling_rate=RATE,
    speeds_rpm=(0.95 * SPEED, 1.05 * SPEED), wheels=((0,),), defect_counts=(0, 2), n_recordings=5,
    n_rigs_per_machine=6,
)  # fmt: skip


def learned(world, folder):
    return EffectPosterior(1, epochs=40).fit(prepare_world(world, folder, 40))


@pytest.fixture(scope="module")
def posterior(tmp_path_factory):
    return learned(SMALL, tmp_path_factory.mktemp("world"))


def recordings(*effects, loads=(22.0,), n=6, seed=0, quantity="output_torque"):
    """Recordings of a rig with effects, at one load or several."""
    rig = Rig().with_added(*NOISE_AND_DRIFT, *effects)
    made = []
    for i in range(n):
        load = loads[i % len(loads)]
        at = rig.replace(gearbox=rig.gearbox.replace(input_speed=SPEED * np.pi / 30, load_torque=load))
        run = at.simulate(
            duration=954 / SPEED, sampling_rate=RATE, random_state=100 * seed + i, quantity=quantity
        )
        stated = {"assembly": i, "speed_rpm": SPEED, "load_nm": load}
        made.append(Recording.from_run(run, quantity=quantity, with_angle=False, **stated))
    return made


SETTINGS = GapSettings(n_bank=12, n_after=12, n_report=12, n_permutations=499, random_state=0)


@pytest.mark.slow
def test_what_is_missing_is_named_sized_and_closes_the_gap(posterior, monkeypatch):
    few = functools.partial(confirm_effects, n_sessions=32)
    monkeypatch.setattr("cyclofeat.gap._workflow.confirm_effects", few)
    told = []
    result = find_gap(
        # In more noise a line of the shaft would not show, and its absence would be open.
        recordings(Noise(0.06), loads=(22.0, 14.0), n=8), recordings(Noise(0.06), n=4, seed=1),
        posterior=posterior, settings=SETTINGS, progress=told.append,
    )  # fmt: skip
    assert [effect.effect_id for effect in result.named] == ["noise"]
    assert result.effect("noise").state == "missing"
    (size,) = result.effect("noise").sizes
    assert size.low < size.value < size.high
    assert size.value == pytest.approx(0.06, rel=0.05)
    assert result.verdict == "disagree"
    assert len(result.where) == 2
    assert not result.remainder.unexplained
    assert result.proof[0].result.grr > 0.8
    assert result.rig.gearbox == Rig().gearbox
    drawn = [one for effects in result.posterior_rig.variants for one in effects if one.effect_id == "noise"]
    assert len(drawn) == len(result.posterior_rig.variants) == 200
    low, high = np.quantile([one.rms_nm for one in drawn], [0.05, 0.95])
    assert (low, high) == pytest.approx((size.low, size.high), rel=0.02)
    assert {overlay.condition.load_nm for overlay in result.overlays} == {22.0, 14.0}
    assert told[0] == "comparing measurement and model"
    assert told[-1] == "judging on recordings held out"


@pytest.mark.bench
def test_what_is_missing_is_found_in_the_input_torque_too(tmp_path):
    """The noise is 0.3 / 15 Nm there, and counts times the reduction."""
    quantity = "input_torque"
    posterior = learned(dataclasses.replace(SMALL, quantity=quantity), tmp_path)
    posterior = load_posterior(posterior.save(tmp_path / "of_input.npz"))
    measured = recordings(Noise(0.3), n=8, quantity=quantity)
    held_out = recordings(Noise(0.3), n=4, seed=1, quantity=quantity)
    result = find_gap(measured, held_out, posterior=posterior, settings=SETTINGS)
    assert [effect.effect_id for effect in result.named] == ["noise"]
    assert result.effect("noise").sizes[0].value == pytest.approx(0.3, rel=0.1)
    assert result.proof[0].result.grr > 0.8
    assert any("multiplied by 15, the reduction" in warning for warning in result.warnings)
    with pytest.raises(
        ValueError, match=r"must be 'input_torque', from which .* got 'output_torque': prepare"
    ):
        find_gap(recordings(n=4), posterior=posterior, settings=SETTINGS)


def test_of_look_alikes_that_share_their_probability_the_first_is_named():
    presence = {"noise": 0.9, "gain": 0.3, "offset": 0.35, "load_drift": 0.6, "sensor_drift": 0.3, "hum": 0.4}
    assert named_effects(presence) == ["noise", "offset", "load_drift"]
    assert named_effects({"gain": 0.2, "offset": 0.2, "hum": np.nan}) == []


@pytest.mark.slow
def test_sessions_are_like_the_measured_one_and_of_their_seed():
    template = simulate_sessions(SMALL, measured_session(), lambda _: (), 1, random_state=0).sessions[0]

    def draw(random):
        return (Noise(float(random.uniform(0.1, 0.3))),)

    one, other = (simulate_sessions(SMALL, template, draw, 3, random_state=4) for _ in range(2))
    np.testing.assert_array_equal(one.sizes, other.sizes)
    for session, same in zip(one.sessions, other.sessions, strict=True):
        np.testing.assert_array_equal(session.values, same.values)
        np.testing.assert_array_equal(session.conditions, template.conditions)
    assert len({tuple(sizes) for sizes in one.sizes.tolist()}) == 3


@pytest.mark.slow
def test_sessions_of_a_rig_without_tolerances_differ_by_noise_alone():
    template = measured_session()
    tight, usual = (
        simulate_sessions(SMALL, template, lambda _: (), 2, tolerance=lambda _: factor, random_state=0)  # noqa: B023
        for factor in (0.0, 1.0)
    )
    np.testing.assert_array_equal(tight.tolerances, 0)
    speed = next(k for k, cell in enumerate(SMALL.described_cells) if "input speed" in cell.name)
    spread = [made.sessions[0].values[:, speed].std() for made in (tight, usual)]
    assert spread[0] < 0.2 * spread[1]


@pytest.mark.slow
def test_drawn_friction_that_is_too_steep_for_the_time_step_is_no_warning_to_a_user():
    world = World(
        effects=(SleeveFriction(),), most=1, sampling_rate=RATE, speeds_rpm=(0.95 * SPEED, 1.05 * SPEED),
        wheels=((0,),), n_recordings=4,
    )  # fmt: skip
    template = Session(np.zeros((1, len(world.cells))), np.array([[SPEED, 22.0, 1.0]]), np.array([0]))
    made = simulate_sessions(world, template, lambda _: (SleeveFriction(1.0),), 1, random_state=0)
    assert len(made.sessions) == 1


def measured_session():
    return MeasuredRig.of(recordings(n=4), SMALL.rig, RATE).session()


@pytest.mark.slow
def test_a_rig_without_effects_needs_nothing_more_than_what_stays_open(posterior):
    session = measured_session()
    confirmed = confirm_effects(posterior, session, [], n_sessions=24, random_state=0)
    assert confirmed.effects == ()
    assert confirmed.quantiles == []
    assert confirmed.remainder.p > 0.001
