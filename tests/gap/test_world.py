"""The training world: its prior by counting, its rigs by their numbers, its summaries by construction."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from scipy import stats

from cyclofeat.gap import World, prepare_world
from cyclofeat.gap.simulations import ERROR_NM, Population
from cyclofeat.gap.summaries.summarise import Kinematics
from cyclofeat.gap.world.cells import recording_cells, turn_samples
from cyclofeat.gap.world.prepare import DrawnMachine, simulate_drawn
from cyclofeat.gap.world.world import EffectPrior, Rigs, Session, draw_session, with_noise_and_drift
from cyclofeat.simulators import (
    BrakeRotor,
    Drift,
    EffectParameter,
    Gain,
    Hum,
    Noise,
    Offset,
    PinErrors,
    Rig,
    Solver,
    TorqueMeterLowPass,
    known_effects,
)
from cyclofeat.simulators.sampling import sample_runs

RATE = 6400.0
SMALL = World(
    effects=(Offset(), Gain(), PinErrors(), Hum()), most=3, sampling_rate=RATE, speeds_rpm=(600, 900),
    n_recordings=4, n_rigs_per_machine=2,
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("world")


@pytest.fixture(scope="module")
def rigs(folder):
    return prepare_world(SMALL, folder, 15)


@pytest.mark.slow
def test_each_number_of_effects_is_as_probable_and_each_effect_as_frequent():
    effects = tuple(effect for effect in list(known_effects().values())[3:13] if effect.vector_names())
    effects += (Noise(), Gain(), Hum(), Offset())
    prior, random = EffectPrior(effects, 6), np.random.default_rng(2)
    drawn = []
    for _ in range(1500):
        in_machine = prior.in_machine(random)
        drawn.append((*in_machine, *prior.on_torque(len(in_machine), random)))
        assert all(effect.needs_simulation() for effect in in_machine)
    numbers = np.bincount([len(effects) for effects in drawn], minlength=7)
    assert stats.chisquare(numbers).pvalue > 1e-3
    names = [effect.effect_id for one in drawn for effect in one]
    assert all(len({e.effect_id for e in one}) == len(one) for one in drawn)
    assert stats.chisquare(np.unique(names, return_counts=True)[1]).pvalue > 1e-3
    # Given their number, an effect of the machine and one of the signal come together as often as any two.
    pairs = [{e.effect_id for e in one} for one in drawn if len(one) == 4]
    both = np.mean([{"noise", effects[0].effect_id} <= pair for pair in pairs])
    n = len(effects)
    expected = 4 * 3 / (n * (n - 1))
    assert abs(both - expected) < 4 * np.sqrt(expected / len(pairs))


@pytest.mark.slow
def test_drawn_rigs_keep_the_error_budget():
    world, samples = World(), []
    for number in range(40):
        random = np.random.default_rng(number)
        session, _ = draw_session(world, 1, random)
        rig = with_noise_and_drift(world.rig, world.may_differ).with_added(*world.prior.in_machine(random))
        rig = rig.at(*session.conditions[0, :2])
        population = Population(rig, 5000, world.sampling_rate, world.wheels)
        samples.append(population.sample(int(session.counts[0]), np.random.SeedSequence(number)))
    fine = [dataclasses.replace(sample, error_nm=None, solver=Solver(5e-6)) for sample in samples]
    errors = [
        np.std(one.run.torque_out[one.plan.n_settling :] - other.run.torque_out[one.plan.n_settling :])
        for one, other in zip(sample_runs(samples), sample_runs(fine, kernel="exact"), strict=True)
    ]
    assert np.quantile(errors, 0.9) < ERROR_NM
    assert np.median(errors) < ERROR_NM / 4


def test_what_the_model_has_is_not_missing():
    every = {name for name, effect in known_effects().items() if effect.vector_names()}
    assert set(World().names) == every
    of_rig = World(rig=Rig.r1().with_added(Drift(of="sensor")))
    assert every - set(of_rig.names) == {effect.effect_id for effect in of_rig.rig.effects}
    with_brake = World(rig=Rig(Rig().gearbox.with_brake(0.02, 1e4, 0.02)))
    assert every - set(with_brake.names) == {"brake_rotor"}


@pytest.mark.slow
def test_rigs_are_as_the_prior_says_and_summaries_show_their_effects(rigs):
    assert len(rigs) == 16 * 2
    assert rigs.machines.tolist() == [k // 2 for k in range(32)]
    assert rigs.values.shape == (32, 4, len(SMALL.cells))
    assert rigs.values.dtype == np.float32
    assert np.isfinite(rigs.values).all()
    assert rigs.present.shape == (32, 4)
    assert rigs.present.sum(axis=1).max() <= 3
    assert rigs.logarithmic == (False, True, True, True)
    sizes = dict(zip(rigs.size_names, np.nan_to_num(rigs.sizes.T), strict=True))
    # Torque times direction: gain * load + direction * offset, but for some 0.5 % of the load.
    mean = rigs.values[:, :, rigs.cells.index("amplitudes: mean")]
    _, load, direction = np.moveaxis(rigs.conditions, 2, 0)
    gain, offset = np.exp(sizes["gain.factor"])[:, None], sizes["offset.offset_nm"][:, None]
    hidden = np.abs(mean - (gain * load + direction * offset)) / load
    assert hidden.max() < 0.012
    assert {*np.unique(direction)} == {-1, 1}
    hum = rigs.values[:, :, rigs.cells.index("mains: line at 50 Hz")].mean(axis=1)
    there = rigs.present[:, rigs.names.index("hum")]
    expected = 20 * sizes["hum.amplitude_nm"][there] / np.log(10) - 10 * np.log10(2)
    np.testing.assert_allclose(hum[there & (hum > -20)], expected[hum[there] > -20], atol=3.5)
    assert np.abs(rigs.speeds / rigs.conditions[:, :, 0] - 1).max() < 0.004


@pytest.mark.slow
def test_a_rig_depends_on_its_own_number_only(rigs, tmp_path):
    few = prepare_world(SMALL, tmp_path, 3)
    np.testing.assert_array_equal(few.numbers, rigs.numbers[:16])
    for name in ("values", "conditions", "counts", "sizes", "speeds"):
        np.testing.assert_array_equal(getattr(few, name), getattr(rigs, name)[:16])


@pytest.mark.slow
def test_an_interrupted_preparation_goes_on(rigs, folder):
    shards = sorted(folder.glob("shard-*.npz"))
    assert len(shards) == 2
    before, kept = shards[1].read_bytes(), shards[0].stat().st_mtime_ns
    shards[1].unlink()
    (folder / ".shard-00001.npz.0000.part").write_bytes(before[:100])
    done = []
    again = prepare_world(SMALL, folder, 15, n_jobs=2, progress=lambda *args: done.append(args))
    assert done == [(2, 2)]
    assert shards[0].stat().st_mtime_ns == kept
    assert sorted(path.name for path in folder.iterdir()) == [*(s.name for s in shards), "world.json"]
    np.testing.assert_array_equal(again.values, rigs.values)
    np.testing.assert_array_equal(again.sizes, rigs.sizes)


@pytest.mark.slow
def test_another_world_does_not_enter_the_folder(rigs, folder, tmp_path):
    with pytest.raises(ValueError, match="empty or hold the same world.* other .*effects, .*most"):
        prepare_world(World(effects=(Offset(),), most=1), folder, 1)
    stated = json.loads((folder / "world.json").read_text(encoding="utf-8"))
    stated["made_with"]["code_sha256"] = "0"
    (tmp_path / "world.json").write_text(json.dumps(stated), encoding="utf-8")
    with pytest.raises(ValueError, match="other versions of code"):
        prepare_world(SMALL, tmp_path, 1)


@pytest.mark.slow
def test_rigs_of_one_machine_share_its_runs(tmp_path):
    world = World(
        rig=Rig(effects=[BrakeRotor()]), effects=(Offset(),), sampling_rate=RATE, most=0,
        speeds_rpm=(900, 901), n_recordings=1, n_rigs_per_machine=3,
    )  # fmt: skip
    rigs = prepare_world(world, tmp_path, 1)
    of_machine = rigs.values.reshape(8, 3, -1)
    np.testing.assert_array_equal(of_machine[:, 0], of_machine[:, 1])
    assert np.unique(of_machine[:, 0], axis=0).shape[0] == 8


@pytest.mark.slow
def test_recordings_of_one_assembly_and_of_a_better_rig_differ_less():
    world = World(may_differ=(PinErrors(2e-5),), sampling_rate=RATE, speeds_rpm=(600, 900))
    shaft = [cell.startswith("shaft lines") for cell in world.cells]
    ones, seeds = np.ones(6, dtype=np.int64), np.random.SeedSequence(3).spawn(6)

    def levels(assemblies, tolerance):
        at = np.array([[900.0, 20.0, 1.0]] * 6)
        session = Session(np.zeros((6, 0)), at, ones * 0, assemblies=assemblies)
        made = simulate_drawn(world, [DrawnMachine((), [()], session, tolerance, seeds)])[0]["values"][0]
        return made[:, shaft]

    each, one = levels(np.arange(6), 1.0), levels(ones, 1.0)
    assert levels(np.arange(6), 0.1).mean() < each.mean() - 5  # dB
    assert one.std(axis=0).mean() < 0.8 * each.std(axis=0).mean()
    two = levels(np.array([4, 4, 4, 2, 2, 2]), 1.0)
    assert two[:3].std(axis=0).mean() < 0.8 * two.std(axis=0).mean()


def test_a_recording_that_cannot_be_made_is_left_out(tmp_path):
    """A filter above the Nyquist frequency: every rig with it has no recordings."""
    impossible = EffectParameter("Hz", 1.0, 1e6, None, stats.loguniform(1e4, 2e4), log=True)

    class TooHigh(TorqueMeterLowPass):
        parameters = TorqueMeterLowPass.parameters | {"cutoff_hz": impossible}

    world = World(effects=(TooHigh(),), sampling_rate=RATE, most=1, speeds_rpm=(900, 901), n_recordings=1)
    rigs = prepare_world(world, tmp_path, 1)
    assert 0 < len(rigs) < 8 * world.n_rigs_per_machine
    assert not rigs.present.any()


@pytest.mark.slow
def test_of_a_load_drift_the_mesh_lines_tell_and_of_a_sensor_drift_not():
    conditions = Kinematics(25_600.0, 10.0)
    n = turn_samples(conditions)
    at = Rig().gearbox.replace(input_speed=20 * np.pi)
    correlations = []
    for effect in (Drift(3.0, 5.0), Drift(3.0, 5.0, of="sensor")):
        rig = Rig(at, [effect, Noise(0.02)])
        runs = [rig.simulate(duration=n / 25_600, random_state=seed) for seed in range(4)]
        values, cells = recording_cells(np.array([run.torque_out for run in runs], np.float32), conditions)
        names = [cell.name for cell in cells]
        correlations.append(values[:, names.index("correlation of phase 4 with the slow torque")].mean())
    of_load, of_sensor = correlations
    assert of_load < -0.8
    assert abs(of_sensor) < 0.4


def test_codes_and_course_by_construction():
    conditions = Kinematics(RATE, 10.0)
    n = turn_samples(conditions)
    x = 22 + np.random.default_rng(0).normal(0, 0.3, n) + np.linspace(-0.5, 0.5, n)
    x = np.minimum(np.round(x * 8) / 8, 22.75)
    x[500:540] = 0.0
    values, cells = recording_cells(x[None].astype(np.float32), conditions)
    found = dict(zip([cell.name for cell in cells], values[0], strict=True))
    assert found["number of values"] == pytest.approx(np.log10(np.unique(x).size))
    assert found["smallest step"] == pytest.approx(np.log10(0.125), abs=1e-6)
    assert found["longest run of a value"] == pytest.approx(np.log(40), abs=0.1)
    assert found["share of zeros"] == pytest.approx(40 / n)
    assert found["share of the largest value"] == pytest.approx(np.log10(np.mean(x == 22.75)))
    assert found["straight line"] > np.log(3)


def test_decays_say_what_the_torque_settles_to():
    conditions = Kinematics(RATE, 10.0)
    time = np.arange(turn_samples(conditions)) / RATE
    ripple = 0.3 * np.sin(2 * np.pi * 160 * time)
    x = np.array([22 + size * np.exp(-time / 0.6) + ripple for size in (1.5, -0.8)])
    values, cells = recording_cells(x.astype(np.float32), conditions)
    found = dict(zip([cell.name for cell in cells], values.T, strict=True))
    np.testing.assert_allclose(found["size of a decay in 0.6 s"], [1.5, -0.8], atol=0.01)
    np.testing.assert_allclose(found["torque settled after a decay in 0.6 s"], 22, atol=0.01)
    left = [found[f"level left by a decay in {time_constant:g} s"] for time_constant in (0.3, 0.6, 1.2, 2.5)]
    assert np.argmin(left, axis=0).tolist() == [1, 1]


def test_slips_tell_a_sawtooth_from_its_mirror_image_and_from_a_drift():
    conditions = Kinematics(RATE, 10.0)
    n = turn_samples(conditions)
    climb = (np.arange(n) / RATE * 4) % 1
    drift = np.cumsum(np.random.default_rng(0).normal(0, 0.01, n))
    x = np.array([22 + climb, 22 - climb, 22 + drift])
    values, cells = recording_cells(x.astype(np.float32), conditions)
    names = [cell.name for cell in cells]
    for box in (28, 14, 7):
        falls, rises, drifts = values[:, names.index(f"skewness of changes in {box} ms")]
        assert falls < -2
        assert rises == pytest.approx(-falls, rel=1e-3)
        assert abs(drifts) < -falls / 2


@pytest.mark.slow
def test_sessions_show_what_is_asked_for(rigs):
    shown = rigs.session(3, [0, 2], counts=False, tachometer=True)
    assert shown.values.shape == (2, len(SMALL.cells))
    assert shown.counts is None
    np.testing.assert_array_equal(shown.speeds_rpm, rigs.speeds[3, [0, 2]])
    with_gap = rigs.of([3])
    with_gap.values[0, 2] = np.nan
    assert len(with_gap.session(0).values) == 3
    assert isinstance(rigs.of(rigs.machines == 1), Rigs)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"speeds_rpm": (700, 350)}, r"speeds_rpm must be a pair \(low, high\) with 0 < low < high"),
        ({"loads_nm": (0, 30)}, "loads_nm must be a pair"),
        ({"effects": (Gain(), Gain()), "most": 1}, "effects must be of different kinds, got gain, gain"),
        ({"effects": (Gain(),)}, "most must be at most 1, got 6"),
        ({"n_recordings": 0}, "n_recordings must be at least 1, got 0"),
    ],
    ids=str,
)
def test_wrong_settings_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        World(**arguments)
