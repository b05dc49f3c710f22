"""Confirmation by simulation: formulas on Gaussian summaries, and a small world from end to end."""

from __future__ import annotations

import copy
import dataclasses
import functools
from types import SimpleNamespace

import numpy as np
import pytest

from cyclofeat.gap import EffectPosterior, GapSettings, World, find_gap, load_posterior, prepare_world
from cyclofeat.gap.confirm.confirm import (
    Confirmation,
    confirm_effects,
    draw_effects,
    settle_presence,
    shorten_move,
    widen_covariance,
)
from cyclofeat.gap.confirm.sessions import TOLERANCE, Point, simulate_pairs, with_likely_size, with_strength
from cyclofeat.gap.engine.projection import project
from cyclofeat.gap.measured import MeasuredRig
from cyclofeat.gap.posterior.answers import named_effects
from cyclofeat.gap.posterior.effect_posterior import Guess
from cyclofeat.gap.world.world import NOISE_AND_DRIFT, Session, size_names
from cyclofeat.recordings import Recording
from cyclofeat.simulators import (
    BrakeRotor,
    Clipping,
    Drift,
    Gain,
    Hum,
    Noise,
    Offset,
    Rig,
    Scale,
    TorqueMeterLowPass,
)
from cyclofeat.simulators.effects import ShaftLine, SleeveFriction

RATE, SPEED = 6400.0, 1350.0


class Stated:
    """A posterior that states sizes of mean 0 and deviation 0.01 of some effects."""

    def __init__(self, names):
        effects = (Noise(), Hum(), Gain(), Offset(), Scale("load", 1.02), Drift(), Drift(of="sensor"))
        self.world = SimpleNamespace(effects=tuple(one for one in effects if one.effect_id in names))

    def guess(self, sessions):
        names = [f"{one.effect_id}.{name}" for one in self.world.effects for name in one.vector_names()]
        return [Guess({}, {}, {}, dict.fromkeys(names, (0.0, 0.01)))]


NO_SIZES = np.zeros(0), np.zeros((0, 0))


def drawn_sets(presence, n=2000, effects=(), sizes=NO_SIZES, seed=0):
    confirmed = Confirmation(effects, *sizes, presence, None, True, None)
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
    sets = drawn_sets({"noise": 0.99, "gain": 0.99, "hum": 0.99}, effects=effects, sizes=(mean, covariance))
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
    few = functools.partial(confirm_effects, n_recordings=100)
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
@pytest.mark.parametrize(
    ("before", "after", "settled"),
    [
        (0.9, 0.99, 0.99), (0.9, 0.6, 0.6), (0.9, 0.01, 0.9),  # the posterior's names stay
        (0.3, 0.96, 0.96), (0.3, 0.9, 0.49), (0.3, 0.4, 0.4), (0.3, 0.01, 0.01),
    ],
)  # fmt: skip
def test_responses_name_only_what_they_are_sure_of(before, after, settled):
    assert settle_presence({"hum": before}, {"hum": after}) == {"hum": settled}


def test_rigs_of_a_pair_share_their_random_numbers_and_none_depends_on_the_others():
    template = measured_session()
    rigs = [((), 1.0), ((Gain(1.1),), 1.0), ((ShaftLine(0.3),), 1.0), ((), 0.5)]
    together = simulate_pairs(SMALL, template, rigs, [3, 2, 1, 2], random_state=3)
    assert [len(cells) for cells in together] == [3, 2, 1, 2]
    for rig, cells in zip(rigs, together, strict=True):
        (alone,) = simulate_pairs(SMALL, template, [rig], [3], random_state=3)
        np.testing.assert_array_equal(cells, alone[: len(cells)])
    mean = next(k for k, cell in enumerate(SMALL.described_cells) if cell.name == "mean")
    np.testing.assert_allclose(together[1][..., mean], 1.1 * together[0][:2, ..., mean], rtol=1e-5)


@pytest.mark.parametrize(
    ("effect", "twice"),
    [
        (Noise(0.2), Noise(0.4)),
        (Gain(1.1), Gain(1.21)),
        (Scale("contact_stiffness", 1.5), Scale("contact_stiffness", 2.25)),
        (TorqueMeterLowPass(300.0), TorqueMeterLowPass(300.0)),
        (Clipping(25.0), Clipping(25.0)),
    ],
)
def test_an_effect_that_is_twice_as_strong(effect, twice):
    np.testing.assert_allclose(with_strength(effect, 2.0).to_vector(), twice.to_vector())
    assert with_strength(effect, 0.0) == with_strength(effect, 0.3)


def test_a_size_that_may_lie_on_either_side_is_tried_one_deviation_away():
    added, mean, least = with_likely_size(Offset(-0.3), 0.4)
    assert (added.offset_nm, mean, least) == (pytest.approx(-0.5), pytest.approx(0.6), -np.inf)
    assert with_strength(added, -0.6).offset_nm == pytest.approx(0.3)
    assert with_likely_size(Noise(0.1), 0.4) == (Noise(0.1), 1.0, 0.3)
    assert with_strength(Noise(0.1), -0.6).rms_nm == pytest.approx(0.03)


def test_sizes_change_to_both_sides_and_at_the_end_of_their_range_twice_to_one():
    stiffness, name = Scale("contact_stiffness", 1.5), "contact_stiffness_scale.factor"
    low, high = stiffness.vector_bounds()
    for vector, signs in ((low / 2, (1, -1)), (high, (-1, -1)), (low, (1, 1))):
        guesses = {name: (0.0, 1.0), TOLERANCE: (0.75, 0.4)}
        point = Point((stiffness.from_vector(vector),), 1.0, guesses, {})
        of_stiffness, of_tolerance = point.size_changes()
        assert tuple(np.sign(of_stiffness.places)) == signs
        for place, (effects, tolerance) in zip(of_stiffness.places, of_stiffness.rigs, strict=True):
            np.testing.assert_allclose(effects[0].to_vector(), vector + place)
            assert tolerance == 1.0
        assert of_tolerance.rigs[0][1] != 1.0


def test_what_is_left_unexplained_widens_sizes_up_to_their_guess():
    known, spreads = np.array([[0.01, 0.01], [0.01, 0.04]]), np.array([0.5, 2.0])
    np.testing.assert_allclose(widen_covariance(known, 0.7, spreads), known)
    data = np.linalg.inv(known) - np.diag(spreads**-2)
    for excess in (1.0, 4.0, 1e9):
        wider = np.linalg.inv(data / excess + np.diag(spreads**-2))
        np.testing.assert_allclose(widen_covariance(known, excess, spreads), wider, rtol=1e-9)
    np.testing.assert_allclose(wider, np.diag(spreads**2), atol=1e-6)
    # A size that the recordings know exactly, as a limit in all of them.
    known[0], known[:, 0] = 0.0, 0.0
    for excess in (1.0, 4.0):
        exact = widen_covariance(known, excess, spreads)
        np.linalg.cholesky(exact)
        assert exact[0, 0] < 1e-10 * spreads[0] ** 2
        np.testing.assert_allclose(exact[1:, 1:], widen_covariance(known[1:, 1:], excess, spreads[1:]))


def test_sizes_that_compensate_each_other_change_together():
    """Along the principal axes, by their deviations, from what the guess says."""
    rotor = BrakeRotor(0.02, 12_000.0, 0.03)
    names = [*size_names([rotor]), TOLERANCE]
    guesses = dict(zip(names, [(-4.0, 0.5), (9.0, 0.6), (-3.0, 1.4), (0.75, 0.4)], strict=True))
    known = 0.03 * np.array([[1.0, 1.9, 0.0], [1.9, 4.0, 0.0], [0.0, 0.0, 1.0]])
    point = Point((rotor,), 0.5, guesses, {"brake_rotor": known})
    changes = point.size_changes()
    steps = np.array([change.places[0] for change in changes])
    axes = point.axes * steps
    np.testing.assert_allclose((axes @ axes.T)[:3, :3], known, rtol=1e-9)
    for change, axis in zip(changes[:3], axes.T, strict=False):
        moved = np.concatenate([effect.to_vector() for effect in change.rigs[0][0]])
        np.testing.assert_allclose(moved, point.coordinates[:3] + axis[:3])
    means = [change.column.mean for change in changes]
    expected = [guesses[name][0] for name in names] - point.coordinates
    np.testing.assert_allclose(point.axes @ means, expected)
    # The guess is one of independent deviations of 1 along all axes.
    scaled = point.axes / np.array([guesses[name][1] for name in names])[:, None]
    np.testing.assert_allclose(scaled.T @ scaled, np.eye(4), atol=1e-12)
    assert {change.column.precision for change in changes} == {1.0}


@pytest.mark.parametrize("share", [1.0, 0.5, 0.25])
def test_of_a_long_move_the_part_is_taken_that_leads_closest(share):
    base = np.random.default_rng(0).normal(size=(20, 8, 30))

    def simulate(rigs, numbers):
        rms = [effects[0].rms_nm for effects, _ in rigs]
        return [base[:n] + np.log(one / 0.1) for one, n in zip(rms, numbers, strict=True)]

    session = Session(base[0] + share, np.array([[SPEED, 22.0, 1.0]] * 8), np.zeros(8))
    projection = project(session.values, base, [], np.full(30, 1e-3))
    point = Point((Noise(0.1),), 0.75, {"noise.rms_nm": (-2.3, 0.5), TOLERANCE: (0.75, 0.4)}, {})
    move = np.linalg.solve(point.axes, [1.0, 0.0])
    end = dataclasses.replace(point.moved(move), tolerance=0.5)
    found = shorten_move(projection, session, point, end, move, simulate)
    assert found.effects[0].rms_nm == pytest.approx(0.1 * np.exp(share))
    assert found.tolerance == 0.5


@pytest.mark.slow
def test_sessions_of_a_rig_without_tolerances_differ_by_noise_alone():
    cells = simulate_pairs(SMALL, measured_session(), [((), 0.0), ((), 1.0)], [1, 1], random_state=0)
    speed = next(k for k, cell in enumerate(SMALL.described_cells) if "input speed" in cell.name)
    tight, usual = (of_rig[0, :, speed].std() for of_rig in cells)
    assert tight < 0.2 * usual


@pytest.mark.slow
def test_drawn_friction_that_is_too_steep_for_the_time_step_is_no_warning_to_a_user():
    world = World(
        effects=(SleeveFriction(),), most=1, sampling_rate=RATE, speeds_rpm=(0.95 * SPEED, 1.05 * SPEED),
        wheels=((0,),), n_recordings=4,
    )  # fmt: skip
    template = Session(np.zeros((1, len(world.cells))), np.array([[SPEED, 22.0, 1.0]]), np.array([0]))
    (cells,) = simulate_pairs(world, template, [((SleeveFriction(1.0),), 1.0)], [1], random_state=0)
    assert np.isfinite(cells).all()


def measured_session():
    return MeasuredRig.of(recordings(n=4), SMALL.rig, RATE).session()


@pytest.mark.slow
def test_a_rig_without_effects_needs_nothing_more_than_what_stays_open(posterior):
    session = measured_session()
    presence = dict.fromkeys(SMALL.names, 0.01)
    confirmed = confirm_effects(
        of_rigs(posterior, 100_000), session, presence, n_recordings=80, random_state=0
    )
    assert confirmed.effects == ()
    assert confirmed.quantiles == {}
    assert confirmed.presence == presence
    assert confirmed.remainder.p > 0.001


def of_rigs(posterior, n_rigs):
    """The posterior as if it had learned from so many rigs."""
    known = copy.copy(posterior)
    known.n_rigs_ = n_rigs
    return known


@pytest.mark.slow
@pytest.mark.parametrize(("n_rigs", "named"), [(240, "noise"), (100_000, "gain")])
def test_what_networks_name_stays_if_they_know_many_rigs(posterior, n_rigs, named):
    """With few, responses name what the networks take to be absent, and take away what they name."""
    session = MeasuredRig.of(recordings(Noise(0.06), n=5), SMALL.rig, RATE).session()
    presence = {"noise": 0.03, "gain": 0.7, "input_shaft_line": 0.03}
    confirmed = confirm_effects(
        of_rigs(posterior, n_rigs), session, presence, n_recordings=80, random_state=0
    )
    assert [one.effect_id for one in confirmed.effects] == [named]
