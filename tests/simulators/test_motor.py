"""A motor with speed control turns the input: its current, and the torque that it sees.

Oracles are an integration of gearbox and motor together, transfer functions, and balances of momentum.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from cyclofeat.recordings import Recording
from cyclofeat.simulators import (
    CycloidalGearbox,
    LobeDefects,
    Motor,
    Noise,
    Offset,
    Rig,
    ServoMotor,
    SimulationRun,
    Simulator,
    motor_effects,
    simulate,
)
from cyclofeat.simulators import _kernels as kernels
from cyclofeat.simulators.courses import DriveAndLoad
from cyclofeat.simulators.effects._drive import Cogging, CurrentSensor
from cyclofeat.simulators.motor import drive_run
from cyclofeat.simulators.simulation import Integration, torsion
from cyclofeat.simulators.tables import kernel_input, rest_state

RATE, DT = 25_600.0, 1e-5
WORN = LobeDefects.worn(3, wheels=(0,))
STEEL = CycloidalGearbox.steel()
BRAKED = STEEL.with_brake(0.02, 1e4, 0.02)
SOFT = Motor(
    inertia=8e-5, bandwidth_hz=60, coulomb_nm=0.02, viscous=2e-4, cogging_nm=(0.02, 0.01, 0.01), ripple=0.02
)
START = round(0.45 * RATE)


def cam_inertia(gearbox):
    """Inertia about the input of the wheels' masses on their cams."""
    return 2 * gearbox.wheel_mass * gearbox.eccentricity**2


def inertias(gearbox, motor):
    """Inertia about the input of what turns with it, and of the brake's rotor."""
    z = gearbox.n_lobes
    rigid = motor.inertia + gearbox.input_shaft_inertia + cam_inertia(gearbox)
    rigid += (2 * gearbox.wheel_inertia + gearbox.output_inertia) / z**2
    return rigid, gearbox.brake_inertia / z**2


def gains(gearbox, motor):
    bandwidth = 2 * math.pi * motor.bandwidth_hz
    proportional = bandwidth * sum(inertias(gearbox, motor))
    return proportional, proportional * bandwidth / 4, 2 * math.pi * motor.current_bandwidth_hz


def against(motor, angle, speed):
    """Torque of friction and cogging against the motor."""
    waves = zip(motor.cogging_orders, motor.cogging_nm, motor.cogging_phases, strict=True)
    cogging = sum(size * np.sin(order * angle + phase) for order, size, phase in waves)
    return motor.coulomb_nm + motor.viscous * speed + cogging


def pull(motor, produced, angle):
    return produced * (1 + motor.ripple * np.cos(6 * motor.pole_pairs * angle + motor.ripple_phase))


def together(gearbox, motor, carried, n):
    """Integrate gearbox and motor with the angle as a state: speed, input torque, current times constant.

    The gearbox is the reduced model, one step at a time; the state at the start is that of a given speed.
    """
    proportional, integral, lag = gains(gearbox, motor)
    constants, nothing = kernel_input(gearbox, WORN), np.zeros(0, dtype=int)
    n_before = round(START / RATE / DT)
    course = DriveAndLoad(gearbox, 2 * n_before + 1, DT / 2).piece()
    state = Integration(gearbox, constants, course, DT).run(rest_state(gearbox), 0, n_before, nothing).state
    cam = cam_inertia(gearbox)
    inertia = motor.inertia + gearbox.input_shaft_inertia + cam
    angle, set_speed = course[0, -1], gearbox.input_speed
    speed, acceleration, held, produced = set_speed, 0.0, carried, carried
    memory, steps, result = kernels.new_memory(state), np.array([0, 0.5, 1]) * DT, np.empty((n, 3))
    for i in range(n):
        planned = [
            angle + speed * steps + acceleration * steps**2 / 2,
            speed + acceleration * steps,
            np.full(3, acceleration),
            np.full(3, gearbox.load_torque),
        ]
        done = Integration(gearbox, constants, np.array(planned), DT).run(state, 0, 1, nothing, memory=memory)
        state, torque_in = done.state, done.torques[0, 1]
        result[i] = speed, torque_in, produced
        load = against(motor, angle, speed) + torque_in - cam * acceleration
        acceleration = (pull(motor, produced, angle) - load) / inertia
        middle = speed + DT / 2 * acceleration
        produced += DT * lag * (proportional * (set_speed - middle) + held - produced)
        held += DT * integral * (set_speed - middle)
        angle, speed = angle + DT * middle, speed + DT * acceleration
    return result


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gearbox", "motor", "tolerance"),
    [(STEEL, SOFT, 0.02), (BRAKED, dataclasses.replace(SOFT, bandwidth_hz=80), 0.15)],
    ids=["free output", "brake"],
)
def test_it_agrees_with_gearbox_and_motor_integrated_together(gearbox, motor, tolerance):
    run = simulate(gearbox, WORN, duration=0.57, sampling_rate=RATE)
    made = drive_run(run, motor, START, np.random.default_rng(0))
    carried = run.torque_in[START:].mean() + against(
        dataclasses.replace(motor, cogging_nm=(0, 0, 0)), 0, 52.36
    )
    truth = together(gearbox, motor, carried, round(0.115 / DT))
    at = np.arange(START, START + round(0.11 * RATE))
    times = (at - START) / RATE
    ways = (
        np.gradient(made.input_angle, 1 / RATE),
        made.torque_in,
        made.motor_current * motor.torque_constant,
    )
    assert np.ptp(ways[0][at]) > 4  # rad/s of 52: the motor yields
    for way, true in zip(ways, truth.T, strict=True):
        expected = np.interp(times, np.arange(len(true)) * DT, true)
        assert np.std(way[at] - expected) < tolerance * np.std(expected)
        assert abs(np.mean(way[at] - expected)) < tolerance * np.std(expected)


def flat_run(gearbox=STEEL, torque_in=lambda angle: 1.5 + 0 * angle, seconds=1.0):
    """A run at constant speed whose input torque is a function of the angle, without any gearbox."""
    angle = gearbox.input_speed * np.arange(round(seconds * RATE)) / RATE
    torque = torque_in(angle)
    return SimulationRun(gearbox, LobeDefects.healthy(), RATE, 15 * torque, torque, angle)


def amplitude(values, angle, order):
    """Complex amplitude at an order, over whole turns."""
    whole = angle < angle[0] + 2 * math.pi * math.floor((angle[-1] - angle[0]) / (2 * math.pi))
    weight = np.gradient(angle)[whole] * np.exp(-1j * order * angle[whole])
    return 2 * np.sum(values[whole] * weight) / np.sum(np.gradient(angle)[whole])


STIFF = Motor(bandwidth_hz=1_500, current_bandwidth_hz=20_000, pole_pairs=5, slots=12, torque_constant=0.5)


def passed(gearbox, motor, order):
    """Current times torque constant per Nm of a wave of torque, by the transfer function of the loop."""
    s = 1j * order * gearbox.input_speed
    proportional, integral, lag = gains(gearbox, motor)
    plant = inertias(gearbox, motor)[0] * s
    if gearbox.brake_inertia:
        stiffness, damping = torsion(gearbox)
        spring, rotor = stiffness / s + damping, gearbox.brake_inertia * s
        plant += spring * rotor / (spring + rotor) / 15**2
    control = (proportional + integral / s) * lag / (s + lag)
    return control / (plant + control)


@pytest.mark.parametrize("gearbox", [STEEL, BRAKED], ids=["free output", "brake"])
@pytest.mark.parametrize("order", [4, 13])
def test_small_waves_of_torque_pass_as_the_linear_loop_says(gearbox, order):
    motor = Motor(bandwidth_hz=50, current_bandwidth_hz=300, torque_constant=0.5)
    run = flat_run(gearbox, lambda angle: 1.5 + 1e-4 * np.cos(order * angle))
    made = drive_run(run, motor, 0, np.random.default_rng(0))
    late = slice(round(0.5 * RATE), None)
    current = amplitude(0.5 * made.motor_current[late], run.input_angle[late], order)
    assert current == pytest.approx(1e-4 * passed(gearbox, motor, order), rel=0.01)


def test_a_stiff_control_is_the_given_speed():
    run = simulate(STEEL, WORN, duration=0.6, sampling_rate=RATE)
    motor = dataclasses.replace(STIFF, coulomb_nm=0.03, viscous=1e-3)
    made = drive_run(run, motor, START, np.random.default_rng(0))
    after = slice(START + 500, -100)
    np.testing.assert_allclose(made.input_angle[after], run.input_angle[after], atol=5e-4)
    ripple = run.torque_in[after].std()
    assert np.std(made.torque_in[after] - run.torque_in[after]) < 0.01 * ripple
    expected = run.torque_in[after] + 0.03 + 1e-3 * STEEL.input_speed
    assert np.std(0.5 * made.motor_current[after] - expected) < 0.03 * ripple
    assert abs(np.mean(0.5 * made.motor_current[after] - expected)) < 1e-4
    np.testing.assert_array_equal(made.torque_in[:START], run.torque_in[:START])


def test_momentum_is_balanced():
    run = simulate(STEEL, WORN, duration=0.75, sampling_rate=RATE)
    made = drive_run(run, SOFT, START, np.random.default_rng(0))
    angle = made.input_angle[START:-10]
    speed = np.gradient(angle, 1 / RATE)
    net = pull(SOFT, SOFT.torque_constant * made.motor_current[START:-10], angle)
    net -= made.torque_in[START:-10] + against(SOFT, angle, speed)
    windup = run.output_angle + run.input_angle / 15  # by the angle of the input
    expected = np.interp(angle, run.input_angle, windup) - angle / 15
    np.testing.assert_allclose(made.output_angle[START:-10], expected, atol=1e-6)
    turned = np.cumsum(made.output_speed[START:-10]) / RATE
    assert np.std(made.output_angle[START:-10] - turned) < 1e-4
    gained = (SOFT.inertia + STEEL.input_shaft_inertia) * (speed[-1] - speed[1])
    assert np.trapezoid(net[1:], dx=1 / RATE) == pytest.approx(gained, abs=2e-6)
    # in steady state the mean current carries the mean torque and the friction
    assert abs(net.mean()) < 1e-3


def test_cogging_and_ripple_stand_at_their_orders():
    motor = dataclasses.replace(
        STIFF, cogging_nm=(0.03, 0.02, 0.01), cogging_phases=(0.3, 1.0, 2.0), ripple=0.01, ripple_phase=0.5
    )
    assert motor.cogging_orders == (60, 12, 10)
    made = drive_run(flat_run(), motor, 0, np.random.default_rng(0))
    late = slice(round(0.2 * RATE), None)
    angle, torque = made.input_angle[late], 0.5 * made.motor_current[late]
    expected = dict(zip(motor.cogging_orders, motor.cogging_nm, strict=True)) | {30: 0.01 * 1.5}
    for order in range(1, 90):
        wanted = expected.get(order, 0.0) * abs(passed(STEEL, motor, order))
        assert abs(amplitude(torque, angle, order)) == pytest.approx(wanted, rel=0.01, abs=4e-4), order


def test_the_sensor_adds_offset_noise_and_steps():
    motor = dataclasses.replace(STIFF, offset_nm=0.05, noise_nm=0.02, lsb_nm=0.01)
    run = flat_run(seconds=0.4)
    made = drive_run(run, motor, 0, np.random.default_rng(0))
    errors = 0.5 * made.motor_current - 1.5
    assert errors.mean() == pytest.approx(0.05, abs=1e-3)
    assert errors.std() == pytest.approx(math.hypot(0.02, 0.01 / math.sqrt(12)), rel=0.03)
    codes = 0.5 * made.motor_current / 0.01
    np.testing.assert_allclose(codes, np.rint(codes), atol=1e-6)
    clean = drive_run(run, STIFF, 0, np.random.default_rng(0))
    np.testing.assert_array_equal(made.torque_in, clean.torque_in)  # the motor does not feel its sensor


@pytest.mark.parametrize("rate", [4_000.0, 8_000.0])
def test_the_logging_rate_does_not_matter(rate):
    runs = [simulate(STEEL, WORN, duration=0.65, sampling_rate=one) for one in (RATE, rate)]
    fine, coarse = (
        drive_run(run, SOFT, round(0.45 * run.sampling_rate), np.random.default_rng(0)) for run in runs
    )
    at = np.arange(round(0.45 * rate), round(0.64 * rate))
    expected = np.interp(at / rate, fine.time, fine.motor_current)
    assert np.std(coarse.motor_current[at] - expected) < 0.01 * np.std(expected)


def test_a_motor_that_stalls_is_an_error():
    run = flat_run(torque_in=lambda angle: 1.5 + 1.4 * np.sin(2 * angle))
    with pytest.raises(ValueError, match=r"does not hold the speed at t = .*inertia \(1e-06 kg m2\)"):
        drive_run(run, Motor(inertia=1e-6, bandwidth_hz=10), 0, np.random.default_rng(0))


# -- in rigs


def current_of(*effects, **options):
    return Rig(effects=effects).simulate(
        WORN, duration=0.1, sampling_rate=4_000, random_state=2, quantity="motor_current", **options
    )


def test_a_rig_records_each_quantity_of_one_machine():
    rig = Rig(effects=[Offset(1.5), *motor_effects()])
    options = {"duration": 0.1, "sampling_rate": 4_000, "random_state": 2}
    plain = rig.without("offset").simulate(WORN, **options)
    shifts = {"output_torque": 1.5, "input_torque": 0.1, "motor_current": 0.0}
    for quantity, shift in shifts.items():
        recording = Recording.from_run(rig.simulate(WORN, quantity=quantity, **options), quantity=quantity)
        bare = Recording.from_run(plain, quantity=quantity)
        np.testing.assert_allclose(recording.torque - bare.torque, shift, atol=1e-12)
        np.testing.assert_array_equal(recording.angle, bare.angle)
    assert np.ptp(np.diff(plain.input_angle)) > 1e-4  # the true angle, which is not even
    given = rig.without(*(effect.effect_id for effect in motor_effects())).simulate(WORN, **options)
    assert given.motor_current is None
    assert np.ptp(np.diff(given.input_angle)) < 1e-12


def test_equal_seeds_give_equal_currents_and_assemblies_differ():
    rig = Rig(effects=motor_effects())
    motors = [rig.draw(seed).motor for seed in range(20)]
    assert {one.pole_pairs for one in motors} <= set(range(3, 9))
    assert {one.slots % 3 for one in motors} == {0}
    assert all(9 <= one.slots <= 24 and 30 <= one.bandwidth_hz <= 100 for one in motors)
    assert len({one.cogging_phases for one in motors}) == 20
    np.testing.assert_array_equal(
        current_of(*motor_effects()).motor_current, current_of(*motor_effects()).motor_current
    )
    assert Rig.from_dict(rig.to_dict()) == rig


def test_one_effect_of_the_motor_is_a_motor():
    assert Rig(effects=[Cogging(0.1)]).draw(0).motor.cogging_nm[0] == 0.1
    assert Rig(effects=[ServoMotor(torque_constant=0.7)]).draw(0).motor.torque_constant == 0.7
    assert Rig().draw(0).motor is None
    assert Rig(variants=[[CurrentSensor()], []]).has_motor
    assert not Rig(effects=[Noise()]).has_motor


def test_motors_suit_their_gearbox():
    light = motor_effects(CycloidalGearbox.steel(load_torque=2.2))
    heavy = motor_effects(CycloidalGearbox.steel(load_torque=22.0))
    np.testing.assert_allclose(np.array(heavy[0].inertia) / light[0].inertia, 10)
    np.testing.assert_allclose(np.array(heavy[2].common_nm) / light[2].common_nm, 10)
    assert Rig(effects=motor_effects(CycloidalGearbox.steel(load_torque=0.0))).draw(0).motor.inertia > 0


@dataclasses.dataclass(frozen=True)
class Own(Simulator):
    def simulate(self, time, angle, speed, load, gearbox, defects):
        return load, angle


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (current_of, "quantity motor_current needs a motor: add motor_effects"),
        (lambda: Rig(effects=[Cogging(), Cogging()]), "each motor effect once at most, got cogging, c"),
        (
            lambda: Rig(effects=[ServoMotor()], simulator=Own()),
            "simulator must be None for a rig with a motor",
        ),
        (lambda: Motor(inertia=0.0), "inertia must be positive and finite, got 0.0"),
        (lambda: Motor(slots=0), "slots must be at least 1, got 0"),
        (lambda: Rig().simulate(quantity="power", random_state=0), "quantity must be one of 'output_torque'"),
        (
            lambda: Rig(simulator=Own()).simulate(quantity="input_torque", random_state=0),
            "quantity must be 'output_torque' for a user's simulator",
        ),
    ],
)
def test_what_cannot_be_recorded_is_an_error(act, words):
    with pytest.raises(ValueError, match=words):
        act()
