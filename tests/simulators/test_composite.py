"""Gearbox or rig with effects: order, seeds, and that it is what its steps are, one after the other."""

from __future__ import annotations

import dataclasses
import doctest
import itertools
import math

import numpy as np
import pytest
from sklearn.base import clone

from cyclofeat.simulators import (
    BrakeRotor,
    Clearance,
    ClockError,
    CompositeSimulator,
    ContactDampingScale,
    ContactStiffnessScale,
    CycloidalGearbox,
    Gain,
    Hum,
    LoadDrift,
    LobeDefects,
    Noise,
    Offset,
    PinErrors,
    Quantisation,
    Rig,
    SensorDrift,
    SpeedWander,
    TorqueMeterLowPass,
    composite,
    effect_library,
    settling_time,
    simulate,
)
from cyclofeat.simulators.effects import Effect, Place, TorqueContext

STEEL = CycloidalGearbox.steel()
FS = 12_800.0
SHORT = {"duration": 0.05, "sampling_rate": FS}
CHAIN = [
    Clearance(10e-6),
    ContactStiffnessScale(1.2),
    LoadDrift(1.0, 5.0),
    TorqueMeterLowPass(400.0),
    Gain(1.1),
    Offset(-0.5),
    Hum(0.3, phase=0.2),
    Quantisation(0.125),
]


def test_examples_of_the_docstrings_run():
    result = doctest.testmod(composite)
    assert result.attempted > 0
    assert result.failed == 0


# The chain


def test_the_order_given_does_not_matter_between_places():
    shuffled = [CHAIN[k] for k in (7, 3, 4, 0, 5, 2, 6, 1)]  # the sensor's three stay in turn
    assert CompositeSimulator(STEEL, shuffled).chain() == tuple(CHAIN)
    one, other = (CompositeSimulator(STEEL, effects).simulate(**SHORT) for effects in (CHAIN, shuffled))
    assert one.torque_out.tobytes() == other.torque_out.tobytes()


def test_effects_of_one_place_are_applied_in_the_order_given():
    plain = CompositeSimulator(STEEL).simulate(**SHORT).torque_out
    for effects, expected in (
        ([Gain(2.0), Offset(1.0)], 2 * plain + 1),
        ([Offset(1.0), Gain(2.0)], 2 * (plain + 1)),
    ):
        np.testing.assert_array_equal(
            CompositeSimulator(STEEL, effects).simulate(**SHORT).torque_out, expected
        )


def test_every_pair_of_the_library_is_sorted_by_place():
    for one, other in itertools.permutations(effect_library().values(), 2):
        places = [effect.place for effect in CompositeSimulator(STEEL, [one(), other()]).chain()]
        assert places == sorted(places)


def test_a_rigs_effects_come_first_and_its_noise_last_before_the_converter():
    rig = Rig.r0().replace(load_drift_nm=0.0, noise_nm=0.3, effects=[Offset(1.0)])
    simulator = CompositeSimulator(rig, [Quantisation(0.25), Gain(2.0)])
    assert simulator.chain() == (Offset(1.0), Gain(2.0), Quantisation(0.25))
    clean = CompositeSimulator(rig.replace(noise_nm=0.0, effects=())).simulate(**SHORT).torque_out
    noise = CompositeSimulator(rig.replace(effects=())).simulate(**SHORT).torque_out - clean
    assert noise.std() == pytest.approx(0.3, rel=0.2)
    found = simulator.simulate(**SHORT).torque_out
    np.testing.assert_allclose(found, 0.25 * np.rint((2 * (clean + 1) + noise) / 0.25), atol=1e-12)


# It is what its steps are


def generator(seed, *key):
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def test_the_composite_is_simulate_and_the_steps_by_hand():
    """All by hand but the hooks: seeds, settling, the sum of the loads, the cut."""
    seed, n = 6, 640
    drift, second = LoadDrift(1.0, 5.0), LoadDrift(0.5, 20.0)
    effects = [Noise(0.2), second, Hum(0.3), TorqueMeterLowPass(400.0), PinErrors(5e-6), BrakeRotor(), drift]
    keys = {id(effect): (*effect.effect_id.encode(), 0, int(effect is drift)) for effect in effects}
    noise, _, hum, low_pass, pins, brake, _ = effects
    gearbox = pins.change_gearbox(STEEL, generator(seed, *keys[id(pins)], 1))
    gearbox = brake.change_gearbox(gearbox, generator(seed, *keys[id(brake)], 1))
    skipped = math.ceil(settling_time(gearbox) * FS)
    loads = [
        one.load_fluctuation(gearbox, (skipped + n) / FS + 64 / FS, generator(seed, *keys[id(one)], 2))
        for one in (second, drift)
    ]
    run = simulate(
        gearbox,
        LobeDefects.worn(2),
        duration=(skipped + n) / FS,
        sampling_rate=FS,
        start_angle=generator(seed, 2).uniform(0, 30 * np.pi),
        load_fluctuation=lambda t: loads[0](t) + loads[1](t),
    )
    torque = run.torque_out[skipped:]
    for effect in (low_pass, noise, hum):
        context = TorqueContext(gearbox, run.input_angle[skipped:])
        torque = effect.change_torque(torque, FS, generator(seed, *keys[id(effect)], 4), context)
    found = CompositeSimulator(STEEL, effects).simulate(
        LobeDefects.worn(2), duration=n / FS, sampling_rate=FS, seed=seed
    )
    assert found.gearbox == gearbox
    assert found.seed == seed
    assert found.defects == LobeDefects.worn(2)
    np.testing.assert_array_equal(found.torque_out, torque)
    np.testing.assert_array_equal(found.input_angle, run.input_angle[skipped:])
    np.testing.assert_array_equal(found.torque_in, run.torque_in[skipped:])


@pytest.mark.parametrize("effects", [[], [kind().neutral() for kind in effect_library().values()]], ids=len)
def test_without_effects_and_from_rest_it_is_simulate(effects):
    options = {"duration": 0.1, "sampling_rate": FS, "start_angle": 0.7, "forces": True}
    found = CompositeSimulator(STEEL, effects).simulate(LobeDefects.worn(1), settled=False, **options)
    plain = simulate(STEEL, LobeDefects.worn(1), **options)
    for item in dataclasses.fields(plain):
        if isinstance(getattr(plain, item.name), np.ndarray):
            assert getattr(found, item.name).tobytes() == getattr(plain, item.name).tobytes(), item.name
    assert found.gearbox == plain.gearbox


def test_the_default_base_is_steel():
    one, other = (CompositeSimulator(*base).simulate(**SHORT) for base in ((), (STEEL,)))
    np.testing.assert_array_equal(one.torque_out, other.torque_out)


def test_from_rest_the_low_pass_starts_at_rest():
    run = CompositeSimulator(STEEL, [TorqueMeterLowPass(20.0)]).simulate(
        settled=False, duration=0.1, sampling_rate=FS
    )
    plain = simulate(STEEL, duration=0.1, sampling_rate=FS, start_angle=run.input_angle[0])
    padded = np.r_[np.full(20_000, plain.torque_out[0]), plain.torque_out]
    context = TorqueContext(from_rest=True)
    expected = TorqueMeterLowPass(20.0).change_torque(padded, FS, np.random.default_rng(0), context)[20_000:]
    np.testing.assert_allclose(run.torque_out, expected, atol=1e-9)


def test_the_record_begins_settled_by_default():
    run = CompositeSimulator(STEEL).simulate(**SHORT)
    assert run.torque_out.size == run.input_angle.size == 640
    assert abs(run.torque_out.mean() - 22) < 0.1
    assert CompositeSimulator(STEEL).simulate(settled=False, **SHORT).torque_out.mean() < 6


# Each effect in the whole


def test_brake_rotor_is_the_gearbox_with_a_brake():
    with_effect = CompositeSimulator(STEEL, [BrakeRotor(0.02, 1e4, 0.1)]).simulate(**SHORT)
    with_brake = CompositeSimulator(STEEL.with_brake(0.02, 1e4, 0.1)).simulate(**SHORT)
    np.testing.assert_array_equal(with_effect.torque_out, with_brake.torque_out)


def test_a_drift_of_the_load_reaches_the_gearbox_and_one_of_the_sensor_does_not():
    plain = CompositeSimulator(STEEL).simulate(**SHORT)
    load, sensor = (
        CompositeSimulator(STEEL, [kind(3.0)]).simulate(**SHORT) for kind in (LoadDrift, SensorDrift)
    )
    assert abs(load.torque_in - plain.torque_in).mean() > 0.01
    np.testing.assert_array_equal(sensor.torque_in, plain.torque_in)
    assert abs(sensor.torque_out - plain.torque_out).mean() > 0.1


def test_clock_error_moves_the_hum_and_leaves_the_length():
    simulator = CompositeSimulator(STEEL, [ClockError(0.02), Hum(50.0, 100.0, phase=0.0), Quantisation(0.25)])
    run = simulator.simulate(duration=0.2, sampling_rate=FS)
    assert run.torque_out.size == run.input_angle.size == run.torque_in.size == 2560
    time = np.arange(2560) / FS
    basis = np.exp(2j * np.pi * 100.0 / 1.02 * time)
    hum = run.torque_out - run.torque_out.mean()
    assert abs(np.mean(hum * basis.conj())) == pytest.approx(25.0, rel=0.01)
    # codes come after the clock
    np.testing.assert_array_equal(run.torque_out * 4, np.rint(run.torque_out * 4))
    speed = np.polyfit(time, run.input_angle, 1)[0]
    assert speed == pytest.approx(STEEL.input_speed / 1.02, rel=1e-9)


@pytest.mark.parametrize("relative", [0.03, -0.03])
@pytest.mark.parametrize("noisy", ["effect", "rig"])
def test_the_clock_samples_the_same_noise_at_other_instants(noisy, relative):
    rig = Rig.r0().replace(load_drift_nm=0.0, noise_nm=float(noisy == "rig"))
    effects = [Noise(float(noisy == "effect"))]
    plain, moved = (
        CompositeSimulator(rig, [*effects, *more]).simulate(duration=0.2, sampling_rate=FS).torque_out
        for more in ((), (ClockError(relative),))
    )
    assert plain.size == moved.size == 2560
    at = np.arange(2560) / (1 + relative)
    known = at < 2559
    near = np.interp(at[known], np.arange(2560), plain)
    # straight lines between white samples keep at least 0.8 of the correlation; other noise would have none
    assert np.corrcoef(near, moved[known])[0, 1] > 0.7


@pytest.mark.parametrize("relative", [0.05, -0.05])
def test_the_last_samples_are_as_true_as_the_others(relative):
    hum = Hum(50.0, 500.0, phase=0.3)
    moved, bare = (
        CompositeSimulator(STEEL, [ClockError(relative), *more]).simulate(duration=0.1, sampling_rate=FS)
        for more in ([hum], [])
    )
    instants = np.arange(1280) / (1 + relative) / FS
    expected = 50.0 * np.sin(2 * np.pi * 500.0 * instants + 0.3)
    found = moved.torque_out - bare.torque_out
    assert np.abs(found - expected)[60:].max() < 50 * 2e-5  # the first lie at the record's beginning


# Seeds


def test_the_same_seed_gives_the_same_record():
    simulator = CompositeSimulator(Rig.r2(), [Noise(0.1), Hum()])
    first = simulator.simulate(seed=3, **SHORT)
    assert first.torque_out.tobytes() == simulator.simulate(seed=3, **SHORT).torque_out.tobytes()
    assert first.torque_out.tobytes() != simulator.simulate(seed=4, **SHORT).torque_out.tobytes()
    sequence = np.random.SeedSequence(3)
    sequence.spawn(4)
    again = simulator.simulate(seed=sequence, **SHORT)
    assert first.torque_out.tobytes() == again.torque_out.tobytes()
    assert sequence.n_children_spawned == 4
    assert (first.seed, again.seed) == (3, None)


def test_one_effect_more_changes_no_random_number_of_another():
    base = [Noise(1.0), SensorDrift(2.0)]
    plain = CompositeSimulator(STEEL, base).simulate(**SHORT).torque_out
    for extra in (Hum(0.5), Offset(0.5), Noise(0.1, 1.0)):
        more = CompositeSimulator(STEEL, [*base, extra]).simulate(**SHORT).torque_out
        other = CompositeSimulator(STEEL, [extra]).simulate(**SHORT).torque_out
        bare = CompositeSimulator(STEEL).simulate(**SHORT).torque_out
        if not isinstance(extra, Noise):  # alone it is the first of its name, there the second
            np.testing.assert_allclose(more - plain, other - bare, atol=1e-12)
        np.testing.assert_allclose((more - plain).std(), (other - bare).std(), rtol=0.4, atol=1e-12)


def test_two_effects_of_one_kind_are_independent():
    bare = CompositeSimulator(STEEL).simulate(duration=0.4, sampling_rate=FS).torque_out
    both = CompositeSimulator(STEEL, [Noise(1.0)] * 2).simulate(duration=0.4, sampling_rate=FS).torque_out
    # twice the same noise would have twice the rms
    assert (both - bare).std() == pytest.approx(math.sqrt(2), rel=4 / math.sqrt(2 * both.size))


def test_noise_of_two_effects_and_of_the_rig_have_nothing_in_common():
    rig = Rig.r0().replace(load_drift_nm=0.0, noise_nm=0.0)
    bare, own, effect = (
        CompositeSimulator(one, more).simulate(duration=0.4, sampling_rate=FS).torque_out
        for one, more in ((rig, ()), (rig.replace(noise_nm=1.0), ()), (rig, [Noise(1.0)]))
    )
    assert abs(np.corrcoef(own - bare, effect - bare)[0, 1]) < 4 / math.sqrt(bare.size)


def test_ranges_are_drawn_anew_by_each_seed_and_only_they():
    simulator = CompositeSimulator(
        STEEL, [BrakeRotor((0.005, 0.05)), Noise((0.1, 0.5)), ContactDampingScale()]
    )
    drawn = [simulator.assemble(seed)[1] for seed in range(30)]
    inertia = np.array([brake.inertia for _, brake, _ in drawn])
    noise = np.array([noise.rms_nm for _, _, noise in drawn])
    assert len(set(inertia)) == 30
    assert 0.005 < inertia.min() < 0.01 < 0.03 < inertia.max() < 0.05
    assert abs(np.corrcoef(np.log(inertia), np.log(noise))[0, 1]) < 0.6
    fixed = simulator.set_params(noise__rms_nm=0.2).assemble(5)[1]
    assert fixed[1] == drawn[5][1]
    assert fixed[2] == Noise(0.2)


def test_a_longer_record_begins_like_a_shorter_one():
    simulator = CompositeSimulator(Rig.r1(), [Noise(0.2), SensorDrift(), Hum(0.1), Quantisation(0.05)])
    short, long = (simulator.simulate(duration=t, sampling_rate=FS).torque_out for t in (0.05, 0.2))
    np.testing.assert_array_equal(short, long[: short.size])


# As an estimator


def test_clone_and_nested_parameters():
    simulator = CompositeSimulator(Rig.r1(), [Hum(0.1), Hum(0.2, 150.0), Gain(1.1)])
    again = clone(simulator)
    assert again is not simulator
    assert again.effects[0] is not simulator.effects[0]
    assert again.get_params() == simulator.get_params()
    assert simulator.get_params()["hum_2__frequency_hz"] == 150.0
    again.set_params(hum_2__amplitude_nm=0.7, gain__factor=1.2)
    assert [e.get_params() for e in again.effects] == [
        e.get_params() for e in (Hum(0.1), Hum(0.7, 150.0), Gain(1.2))
    ]
    assert simulator.effects[1].amplitude_nm == 0.2
    assert again.set_params(effects=[Offset()], base=STEEL, offset__offset_nm=2.0).effects == [Offset(2.0)]
    for bad in ("zzz", "hum__zzz", "hum"):
        with pytest.raises(
            ValueError, match=f"unknown parameter '{bad}' of CompositeSimulator: known are base"
        ):
            simulator.set_params(**{bad: 1})


# Files


@pytest.mark.parametrize(
    "base",
    [
        STEEL,
        None,
        CycloidalGearbox.abs(load_torque=18.0),
        STEEL.replace(clearance=12e-6),
        Rig.r2(),
        Rig.r0().replace(effects=[Offset(1.0)]),
    ],
    ids=["steel", "default", "abs", "clearance", "R2", "R0 with offset"],
)
def test_a_file_simulates_the_same(base, tmp_path):
    simulator = CompositeSimulator(base, [Noise((0.1, 0.3)), TorqueMeterLowPass(500.0), PinErrors(5e-6)])
    path = tmp_path / "corrected.json"
    simulator.to_json(path)
    back = CompositeSimulator.from_json(path)
    assert isinstance(back.base, Rig)
    assert back.base.effects == ()
    assert back.chain() == simulator.chain()
    one, other = (s.simulate(LobeDefects.worn(1), seed=2, **SHORT) for s in (simulator, back))
    np.testing.assert_array_equal(one.torque_out, other.torque_out)
    # and it is a rig, wherever a rig is taken
    assert Rig.from_json(path) == back.to_rig() == simulator.to_rig()


def test_a_brake_of_a_bare_gearbox_comes_back():
    braked = STEEL.with_brake(0.02, 1e4, 0.03)
    back = CompositeSimulator(braked).to_rig().assemble(0)
    for name in ("brake_inertia", "meter_stiffness", "meter_damping", "clearance", "stiffness_scale"):
        assert getattr(back, name) == pytest.approx(getattr(braked, name), rel=1e-15)


def test_errors_of_single_pins_cannot_be_written(tmp_path):
    gearbox = STEEL.replace(pin_radial_errors=(1e-6,) * 16)
    with pytest.raises(
        ValueError, match="gearbox.pin_radial_errors must be empty .* give tolerances.pin_pos"
    ):
        CompositeSimulator(gearbox).to_json(tmp_path / "x.json")
    assert not (tmp_path / "x.json").exists()


# Bad input


@pytest.mark.parametrize(
    ("base", "effects", "arguments", "message"),
    [
        ("R1", (), {}, "base must be a CycloidalGearbox or a Rig, got 'R1'"),
        (STEEL, Hum(), {}, "effects must be a sequence of effects"),
        (STEEL, [3], {}, "effects must hold effects like Hum.* got 3"),
        (STEEL, [Gain(-1)], {}, "factor of gain must lie between"),
        (STEEL, [BrakeRotor(), BrakeRotor()], {}, "without a brake, got one with brake_inertia 0.02"),
        (Rig.r1(), [BrakeRotor()], {}, "without a brake, got one with brake_inertia 0.02"),
        (STEEL, (), {"duration": -1.0}, "duration must be positive and finite, got -1.0"),
        (STEEL, (), {"duration": 1e-6}, "duration 1e-06 s is shorter than one sample at 12800 Hz"),
        (STEEL, (), {"sampling_rate": math.inf}, "sampling_rate must be positive and finite, got inf"),
        (STEEL, (), {"seed": None}, "seed must be a whole number or a SeedSequence, got None"),
        (STEEL, (), {"seed": -1}, "seed must not be negative, got -1"),
        (STEEL, (), {"load_fluctuation": 1.0}, "load_fluctuation is not taken here"),
        (STEEL, (), {"zzz": 1.0}, "zzz"),
        (STEEL, [TorqueMeterLowPass(6400.0)], {}, "below the Nyquist frequency 6400 Hz, got 6400"),
        (
            STEEL.replace(contact_damping=0.0).with_brake(0.02, 1e4, 1e-7),
            (),
            {},
            "must have more damping: it settles in",
        ),
        (STEEL, (), {"defects": LobeDefects.worn((15,))}, "lobe 15"),
    ],
)
def test_bad_input_is_named(base, effects, arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        CompositeSimulator(base, effects).simulate(**(SHORT | arguments))


def test_an_effect_of_ones_own_takes_its_place():
    class Square(Effect):
        """Squares the torque: an effect that the library does not have."""

        effect_id = "square"
        place = Place.SENSOR

        def __init__(self):
            pass

        def change_torque(self, torque, sampling_rate, random, context=None):
            assert context.gearbox.load_torque == 22
            assert context.input_angle.shape == torque.shape
            return torque**2

    plain = CompositeSimulator(STEEL).simulate(**SHORT).torque_out
    squared = CompositeSimulator(STEEL, [Quantisation(0.0), Square()]).simulate(**SHORT).torque_out
    np.testing.assert_array_equal(squared, plain**2)


# Speed, last: the input's fluctuation


def test_wander_of_the_speed_shows_in_the_angle():
    """The rate of the input's angle is the mean speed and what the effect says."""
    wander = SpeedWander(0.01, 3.0)
    key = (*b"speed_wander", 0, 0, 3)
    run = CompositeSimulator(STEEL, [wander]).simulate(duration=0.6, sampling_rate=FS, seed=4)
    skipped = math.ceil(settling_time(STEEL) * FS)
    expected = wander.speed_fluctuation(STEEL, 0.6 + skipped / FS + 64 / FS, generator(4, *key))
    time = (skipped + np.arange(1, run.input_angle.size - 1)) / FS
    # a central difference of the angle is the mean speed over two samples
    found = (run.input_angle[2:] - run.input_angle[:-2]) * FS / 2
    within = (np.arange(100) + 0.5) / 50 - 1
    mean = expected((time[:, None] + within / FS).ravel()).reshape(-1, 100).mean(axis=1)
    np.testing.assert_allclose(found, STEEL.input_speed + mean, rtol=1e-7)
    assert 0.002 < found.std() / STEEL.input_speed < 0.05


@pytest.mark.parametrize("order", [1.0, 6.0])
def test_ripple_of_the_speed_is_locked_to_the_shaft(order):
    ripple = SpeedWander(0.005, 2.0, ripple=0.004, ripple_order=order, phase=0.4)
    without = SpeedWander(0.005, 2.0)
    both, slow = (
        CompositeSimulator(STEEL, [one]).simulate(duration=1.2, sampling_rate=FS, start_angle=0.0)
        for one in (ripple, without)
    )
    speed = np.gradient(both.input_angle, 1 / FS) - np.gradient(slow.input_angle, 1 / FS)
    # folded over the angle, not over time, it is one pure wave with the phase given
    turns = (slow.input_angle - slow.input_angle[0]) / (2 * np.pi)
    whole = turns < np.floor(turns[-1])
    wave = 2 * np.mean((speed * np.exp(-1j * order * slow.input_angle) * np.gradient(turns))[whole])
    wave /= np.mean(np.gradient(turns)[whole])
    expected = 0.004 * STEEL.input_speed * np.exp(1j * (0.4 - np.pi / 2))
    assert wave == pytest.approx(expected, rel=0.01)


def test_speed_wander_has_its_rms_and_adds_no_mean():
    values = SpeedWander(0.01, 2.0).speed_fluctuation(STEEL, 1500.0, np.random.default_rng(3))(
        np.arange(0, 1500, 1 / 97)
    )
    assert np.mean((values / STEEL.input_speed) ** 2) == pytest.approx(1e-4, rel=4 * math.sqrt(2 / 3000))
    assert abs(values.mean()) < 4 * 0.01 * STEEL.input_speed / math.sqrt(3000)


def test_one_run_of_the_machine_is_recorded_by_several_chains() -> None:
    """The same, bit for bit, as a simulation for each; and what the gearbox answers is refused."""
    base = Rig.r1().replace(noise_nm=0.1)
    chains: list[list[Effect]] = [[], [Hum(0.2)], [Offset(0.5), Quantisation(0.05)]]
    run = CompositeSimulator(base, [Noise(0.05)]).run_machine(duration=0.2, seed=4, spare_s=0.02)
    for chain in chains:
        alone = CompositeSimulator(base, [Noise(0.05), *chain]).simulate(duration=0.2, seed=4)
        assert np.array_equal(run.record(chain).torque_out, alone.torque_out)
    with pytest.raises(ValueError, match=r"the gearbox answers Clearance"):
        run.record([Clearance(1e-5)])
    with pytest.raises(ValueError, match=r"effects need \d+ samples, the machine ran for \d+"):
        run.record([ClockError(-0.05), ClockError(-0.05), ClockError(-0.05)])
