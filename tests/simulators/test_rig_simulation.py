"""Simulated rigs: order of effects, seeds, and that a record is what its steps are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cyclofeat.simulators import (
    BrakeRotor,
    Clearance,
    ClockError,
    Courses,
    CycloidalGearbox,
    Drift,
    Gain,
    Hum,
    LobeDefects,
    Noise,
    Offset,
    PinErrors,
    Quantisation,
    Rig,
    Scale,
    SpeedWander,
    TorqueMeterLowPass,
    simulate,
)
from cyclofeat.simulators.effects import Effect
from cyclofeat.simulators.effects.effect import TorqueContext
from cyclofeat.simulators.simulation import settling_time

STEEL = CycloidalGearbox.steel()
FS = 12_800.0
SHORT = {"duration": 0.05, "sampling_rate": FS}
CHAIN = [
    Clearance(10e-6), Scale("contact_stiffness", 1.2), Drift(1.0, 5.0), TorqueMeterLowPass(400.0), Gain(1.1),
    Offset(-0.5), Hum(0.3, phase=0.2), Quantisation(0.125),
]  # fmt: skip


# The chain


def test_the_order_given_does_not_matter_between_places():
    shuffled = [CHAIN[k] for k in (7, 3, 4, 0, 5, 2, 6, 1)]  # the sensor's three stay in turn
    assert Rig(STEEL, shuffled).effects == tuple(CHAIN)
    one, other = (Rig(STEEL, effects).simulate(random_state=0, **SHORT) for effects in (CHAIN, shuffled))
    assert one.torque_out.tobytes() == other.torque_out.tobytes()


def test_effects_of_one_place_are_applied_in_the_order_given():
    plain = Rig(STEEL).simulate(random_state=0, **SHORT).torque_out
    for effects, expected in (
        ([Gain(2.0), Offset(1.0)], 2 * plain + 1),
        ([Offset(1.0), Gain(2.0)], 2 * (plain + 1)),
    ):
        np.testing.assert_array_equal(
            Rig(STEEL, effects).simulate(random_state=0, **SHORT).torque_out, expected
        )


# It is what its steps are


def generator(seed, *key):
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def test_the_composite_is_simulate_and_the_steps_by_hand():
    """All by hand but the hooks: seeds, settling, the sum of the loads, the cut."""
    seed, n = 6, 640
    drift, second = Drift(1.0, 5.0), Drift(0.5, 20.0)
    effects = [Noise(0.2), second, Hum(0.3), TorqueMeterLowPass(400.0), PinErrors(5e-6), BrakeRotor(), drift]
    keys = {id(effect): (*effect.effect_id.encode(), 0, int(effect is drift)) for effect in effects}
    noise, _, hum, low_pass, pins, brake, _ = effects
    gearbox = pins.change_gearbox(STEEL, generator(seed, *keys[id(pins)], 1))
    gearbox = brake.change_gearbox(gearbox, generator(seed, *keys[id(brake)], 1))
    assert Rig(STEEL, effects).draw(seed).gearbox == gearbox
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
        courses=Courses(load_fluctuation=lambda t: loads[0](t) + loads[1](t)),
    )
    torque = run.torque_out[skipped:]
    for effect in (low_pass, noise, hum):
        context = TorqueContext(gearbox, run.input_angle[skipped:])
        torque = effect.change_torque(torque, FS, generator(seed, *keys[id(effect)], 4), context)
    found = Rig(STEEL, effects).simulate(
        LobeDefects.worn(2), duration=n / FS, sampling_rate=FS, random_state=seed
    )
    assert found.gearbox == gearbox
    assert found.defects == LobeDefects.worn(2)
    np.testing.assert_array_equal(found.torque_out, torque)
    np.testing.assert_array_equal(found.input_angle, run.input_angle[skipped:])
    np.testing.assert_array_equal(found.torque_in, run.torque_in[skipped:])


# Each effect in the whole


def test_a_drift_of_the_load_reaches_the_gearbox_and_one_of_the_sensor_does_not():
    plain = Rig(STEEL).simulate(random_state=0, **SHORT)
    load, sensor = (
        Rig(STEEL, [Drift(3.0, of=of)]).simulate(random_state=0, **SHORT) for of in ("load", "sensor")
    )
    assert abs(load.torque_in - plain.torque_in).mean() > 0.01
    np.testing.assert_array_equal(sensor.torque_in, plain.torque_in)
    assert abs(sensor.torque_out - plain.torque_out).mean() > 0.1


def test_clock_error_moves_the_hum_and_leaves_the_length():
    simulator = Rig(STEEL, [ClockError(0.02), Hum(50.0, 100.0, phase=0.0), Quantisation(0.25)])
    run = simulator.simulate(duration=0.2, sampling_rate=FS, random_state=0)
    assert run.torque_out.size == run.input_angle.size == run.torque_in.size == 2560
    time = np.arange(2560) / FS
    basis = np.exp(2j * np.pi * 100.0 / 1.02 * time)
    hum = run.torque_out - run.torque_out.mean()
    assert abs(np.mean(hum * basis.conj())) == pytest.approx(25.0, rel=0.01)
    # codes come after the clock
    np.testing.assert_array_equal(run.torque_out * 4, np.rint(run.torque_out * 4))
    speed = np.polyfit(time, run.input_angle, 1)[0]
    assert speed == pytest.approx(STEEL.input_speed / 1.02, rel=1e-9)


@pytest.mark.parametrize("relative", [0.05, -0.05])
def test_the_last_samples_are_as_true_as_the_others(relative):
    hum = Hum(50.0, 500.0, phase=0.3)
    moved, bare = (
        Rig(STEEL, [ClockError(relative), *more]).simulate(duration=0.1, sampling_rate=FS, random_state=0)
        for more in ([hum], [])
    )
    instants = np.arange(1280) / (1 + relative) / FS
    expected = 50.0 * np.sin(2 * np.pi * 500.0 * instants + 0.3)
    found = moved.torque_out - bare.torque_out
    assert np.abs(found - expected)[60:].max() < 50 * 2e-5  # the first lie at the record's beginning


# Seeds


def test_the_same_seed_gives_the_same_record():
    simulator = Rig.r2().with_added(Noise(0.1), Hum())
    first = simulator.simulate(random_state=3, **SHORT)
    assert first.torque_out.tobytes() == simulator.simulate(random_state=3, **SHORT).torque_out.tobytes()
    assert first.torque_out.tobytes() != simulator.simulate(random_state=4, **SHORT).torque_out.tobytes()
    assert first.gearbox == simulator.draw(3).gearbox
    sequence = np.random.SeedSequence(3)
    sequence.spawn(4)
    again = simulator.simulate(random_state=sequence, **SHORT)
    assert first.torque_out.tobytes() == again.torque_out.tobytes()
    assert sequence.n_children_spawned == 4


def test_the_assembly_follows_from_its_own_seed_and_drift_and_noise_from_the_runs():
    rig_of_ranges = Rig(STEEL, [PinErrors((2e-6, 2e-5)), Noise((0.1, 0.5)), Drift(2.0, 20.0)])
    one, other = (
        rig_of_ranges.plan_run(random_state=seed, assembly=7, **SHORT).simulate() for seed in (1, 2)
    )
    assert one.plan.machine == other.plan.machine == rig_of_ranges.draw(7)
    assert one.run.gearbox == other.run.gearbox
    first, second = (run.record().torque_out - run.run.torque_out[-640:] for run in (one, other))
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.2  # other noise
    moved = one.run.torque_out[-640:].mean() - other.run.torque_out[-640:].mean()
    assert abs(moved) > 0.05  # another drift, of the same rms


def test_a_longer_record_begins_like_a_shorter_one():
    simulator = Rig.r1().with_added(Noise(0.2), Drift(of="sensor"), Hum(0.1), Quantisation(0.05))
    short, long = (
        simulator.simulate(duration=t, sampling_rate=FS, random_state=0).torque_out for t in (0.05, 0.2)
    )
    np.testing.assert_array_equal(short, long[: short.size])


# Parameters by name


def test_parameters_have_names():
    named = Rig(STEEL, [Hum(0.1), Hum((0.2, 0.3), 150.0), Gain(1.1)])
    parameters = named.parameters()
    assert parameters["gearbox.load_torque"] == 22.0
    assert parameters["hum_2.frequency_hz"] == 150.0
    assert parameters["hum_2.amplitude_nm"] == (0.2, 0.3)
    changed = named.with_parameters(
        {"hum_2.amplitude_nm": 0.7, "gain.factor": 1.2, "gearbox.load_torque": 18.0}
    )
    assert changed.effects == (Hum(0.1), Hum(0.7, 150.0), Gain(1.2))
    assert changed.gearbox == STEEL.replace(load_torque=18.0)
    assert named.effects[1].amplitude_nm == (0.2, 0.3)
    with pytest.raises(
        ValueError, match=r"unknown key 'hum.amplitude' of rig 'rig' with value 1.0: did you mean 'hum"
    ):
        named.with_parameters({"hum.amplitude": 1.0})
    with pytest.raises(
        ValueError, match=r"unknown key 'zzz' of rig 'rig' with value 1.0: known are gearbox.ecc"
    ):
        named.with_parameters({"zzz": 1.0})
    with pytest.raises(ValueError, match="amplitude_nm of hum must lie between"):
        named.with_parameters({"hum.amplitude_nm": -1.0})


def test_effects_are_replaced_added_and_taken_away():
    both = Rig(STEEL, [Drift(1.0), Drift(2.0), Hum()])
    assert both.with_effects(Drift(3.0), Gain()).effects == (Drift(3.0), Hum(), Gain())
    assert both.with_added(Drift(3.0)).effects == (Drift(1.0), Drift(2.0), Drift(3.0), Hum())
    assert both.without("load_drift", "gain").effects == (Hum(),)
    assert both.effects == (Drift(1.0), Drift(2.0), Hum())


# Bad input


@pytest.mark.parametrize(
    ("gearbox", "effects", "arguments", "message"),
    [
        (STEEL.with_brake(0.02, 1e4, 0.1), [BrakeRotor()], {}, "one brake_rotor at most, .* got 2 brakes"),
        (STEEL, (), {"duration": -1.0}, "duration must be positive and finite, got -1.0"),
        (STEEL, (), {"duration": 1e-6}, "duration 1e-06 s is shorter than one sample at 12800 Hz"),
        (STEEL, (), {"sampling_rate": math.inf}, "sampling_rate must be positive and finite, got inf"),
        (STEEL, (), {"random_state": -1}, "random_state must be at least 0, got -1"),
        (STEEL, (), {"courses": 1.0}, "courses is not taken here"),
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
def test_bad_input_is_named(gearbox, effects, arguments, message):
    with pytest.raises((TypeError, ValueError), match=message):
        Rig(gearbox, effects).simulate(**(SHORT | {"random_state": 0} | arguments))


# Speed, last: the input's fluctuation


def test_wander_of_the_speed_shows_in_the_angle():
    """The rate of the input's angle is the mean speed and what the effect says."""
    wander = SpeedWander(0.01, 3.0)
    key = (*b"speed_wander", 0, 0, 3)
    run = Rig(STEEL, [wander]).simulate(duration=0.6, sampling_rate=FS, random_state=4)
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
        Rig(STEEL, [one]).simulate(duration=1.2, sampling_rate=FS, start_angle=0.0, random_state=0)
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
    base = Rig.r1().with_added(Noise(0.05))
    chains: list[list[Effect]] = [[], [Hum(0.2)], [Offset(0.5), Quantisation(0.05)]]
    run = base.plan_run(duration=0.2, random_state=4, chains=[[ClockError(-0.05)]]).simulate()
    for chain in chains:
        alone = base.with_added(*chain).simulate(duration=0.2, random_state=4)
        assert np.array_equal(run.record(chain).torque_out, alone.torque_out)
    with pytest.raises(ValueError, match=r"the gearbox answers Clearance"):
        run.record([Clearance(1e-5)])
    with pytest.raises(ValueError, match=r"effects need \d+ samples, the machine ran for \d+"):
        run.record([ClockError(-0.05), ClockError(-0.05), ClockError(-0.05)])
