"""The hidden effects: a generator that is the simulator's equal, and its frozen truth.

The generator is compiled by itself and no part of the package, so all of this is slow.
"""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import json
import math
import runpy
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hidden_effects import _ask, _effects, _equivalence, _folders, _motor, _sets
from benchmarks.hidden_effects._machine import Machine
from cyclofeat.gap import load_posterior
from cyclofeat.gap.confirm.confirm import confirm_effects
from cyclofeat.gap.world.world import NOISE_AND_DRIFT
from cyclofeat.simulators import (
    BrakeRotor,
    CycloidalGearbox,
    Drift,
    Effect,
    LobeDefects,
    Noise,
    Rig,
    known_effects,
)
from cyclofeat.simulators.effects.effect import TorqueContext
from cyclofeat.simulators.motor import Motor, drive_run
from cyclofeat.simulators.simulation import settling_time

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow  # a benchmark is no part of the package

HERE = ROOT / "benchmarks" / "hidden_effects"
FS = 25_600


def theta(effect: str, strength: str = "medium", seed: int = 0) -> dict[str, float]:
    return _sets._theta(effect, strength, 22.0, np.random.default_rng(seed))


def library(effect: str, values: dict[str, float]) -> Effect:
    return known_effects()[effect].with_parameters(**values)


# The generator.


@pytest.mark.parametrize("file", ["_machine.py", "_effects.py"])
def test_generator_takes_nothing_but_dimensions_from_the_package(file: str) -> None:
    taken = [
        f"{node.module}.{alias.name}"
        for node in ast.walk(ast.parse((HERE / file).read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if (node.module or "").startswith("cyclofeat")
    ]
    assert set(taken) <= {"cyclofeat.simulators.CycloidalGearbox"}


def test_floor_is_that_of_the_training_world() -> None:
    noise, drift = NOISE_AND_DRIFT
    assert isinstance(noise, Noise)
    assert isinstance(drift, Drift)
    assert noise.rms_nm == _effects.FLOOR_NOISE
    assert (drift.rms_nm, drift.cutoff_hz) == (_effects.FLOOR_DRIFT, _effects.FLOOR_CUTOFF)


@pytest.mark.parametrize(
    "effect", ["torque_meter_low_pass", "sensor_warm_up", "gain", "offset", "quantisation", "clipping",
               "clock_error"]
)  # fmt: skip
def test_signal_effects_without_chance_are_the_librarys(effect: str) -> None:
    """The same waveform through both, away from the ends; in reverse too."""
    time = np.arange(2 * FS) / FS
    values = theta(effect)
    for way in (1, -1):
        torque = way * (22 + 0.3 * np.sin(2 * np.pi * 133 * time) + 0.1 * np.sin(2 * np.pi * 1900 * time))
        run = _effects.Run(torque, 52 * time, 0, way * 22.0)
        here = _effects._SIGNAL[effect][1](torque, run, values, np.random.default_rng(0))
        context = TorqueContext(gearbox=CycloidalGearbox.steel(), input_angle=run.angle)
        there = library(effect, values).change_torque(torque, FS, np.random.default_rng(0), context)
        inner = slice(FS // 2, FS)
        # A thousandth of the ripple: what either's interpolation of a fast clock leaves.
        np.testing.assert_allclose(here[inner], there[inner], atol=4e-4)


@pytest.mark.parametrize("effect", ["sensor_drift", "noise", "hum", "input_shaft_line", "output_shaft_line"])
def test_random_signal_effects_have_the_librarys_power(effect: str) -> None:
    time = np.arange(4 * FS) / FS
    torque, values = np.zeros(time.size), theta(effect)
    run = _effects.Run(torque, 2 * np.pi * 15 * time, 0, 0.0)
    context = TorqueContext(gearbox=CycloidalGearbox.steel(), input_angle=run.angle)
    powers = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        here = _effects._SIGNAL[effect][1](torque, run, values, random)
        there = library(effect, values).change_torque(torque, FS, random, context)
        powers.append([np.mean(here**2), np.mean(there**2)])
    mean, error = np.mean(powers, axis=0), np.std(powers, axis=0) / math.sqrt(60)
    assert abs(mean[0] - mean[1]) < 4 * np.hypot(*error) + 1e-3 * mean[1]


def test_lost_samples_lose_the_librarys_share_in_blocks() -> None:
    torque = np.random.default_rng(0).normal(size=8 * FS)
    values = {"share": 0.05, "block": 40.0}
    run = _effects.Run(torque, torque, 0, 0.0)
    made = [_effects._lost_samples(torque, run, values, np.random.default_rng(1)),
            library("lost_samples", values).change_torque(torque, FS, np.random.default_rng(1))]  # fmt: skip
    for one in made:
        held = np.diff(one) == 0
        assert np.mean(held) == pytest.approx(0.05, rel=0.02)
        assert np.sum(np.diff(held.astype(int)) == 1) == pytest.approx(torque.size * 0.05 / 40, rel=0.02)


@pytest.mark.parametrize(
    "effect", ["load_drift", "proportional_drift", "stick_slip", "rattle", "load_warm_up"]
)
def test_courses_of_the_load_are_the_librarys(effect: str) -> None:
    """Mean, rms and rms of the slope, over many courses."""
    values = theta(effect)
    time = np.arange(0, 6, 5e-5)
    gearbox, machine = CycloidalGearbox.steel(), Machine()
    moments = np.empty((80, 2, 3))
    for seed in range(80):
        random = np.random.default_rng(seed)
        here = _effects._LOAD[effect](machine, values, time, 0.0, random)
        fluctuation = library(effect, values).load_fluctuation(gearbox, 6.0, random)
        assert fluctuation is not None
        for k, course in enumerate((here, fluctuation(time))):
            course = course[time > 1]
            slope = np.diff(course[::20]) / 1e-3
            moments[seed, k] = course.mean(), np.mean(course**2), np.mean(slope**2)
    error = np.hypot(*(moments.std(axis=0) / math.sqrt(80)))
    assert np.all(np.abs(np.diff(moments.mean(axis=0), axis=0)) < 4 * error + 1e-9)


@pytest.mark.parametrize("condition", _equivalence.CONDITIONS, ids=lambda condition: condition.name)
def test_same_run_same_torque(condition: _equivalence.Condition) -> None:
    """At a time step at which the simulator has converged, sample by sample over the settled part."""
    here, there = _equivalence.both(condition, duration=0.7, dt=2.5e-6)
    assert abs(here.mean() - there.mean()) < 2e-5
    assert np.std(here - there) < 0.002 * np.std(there)
    for low, high in ((50, 500), (500, 2000)):
        assert _equivalence.level(here, low, high) == pytest.approx(
            _equivalence.level(there, low, high), abs=0.02
        )


@pytest.mark.parametrize(("worn", "effects"), [((), ()), (range(4), [BrakeRotor(0.018, 9000.0, 0.03)])])
def test_the_motor_drives_as_the_simulators(worn, effects) -> None:
    rig = Rig(effects=effects)
    run = rig.simulate(
        LobeDefects.removed(worn), duration=0.6, sampling_rate=FS, quantity="input_torque", random_state=1
    )
    servo = _motor.drawn_servo(22.0, 500 / 60 * 2 * math.pi, np.random.default_rng(3))
    servo = dataclasses.replace(servo, noise_nm=0.0, lsb_nm=1e-9)
    random = np.random.default_rng(0)
    current, angle = _motor.drive(servo, run.torque_in, run.input_angle, run.gearbox, FS, random)
    same = {one.name for one in dataclasses.fields(servo)} & {one.name for one in dataclasses.fields(Motor)}
    ripple, phase = servo.ripple
    amplitudes, phases = zip(*servo.cogging, strict=True)
    motor = Motor(
        **{name: getattr(servo, name) for name in same} | {"ripple": ripple, "ripple_phase": phase},
        cogging_nm=amplitudes, cogging_phases=phases,
    )  # fmt: skip
    driven = drive_run(run, motor, 0, random)
    settled = slice(FS // 4, None)
    expected = driven.motor_current[settled]
    assert np.std(current[settled] - expected) < 0.02 * np.std(expected)
    assert np.mean(current[settled]) == pytest.approx(np.mean(expected), rel=1e-4)
    np.testing.assert_allclose(angle[settled], driven.input_angle[settled], atol=1e-3)


def test_settling_is_the_simulators() -> None:
    for rotor in ((0.005, 2e4, 0.05), (0.02, 1e4, 0.02), (0.06, 4e3, 0.008)):
        there = settling_time(CycloidalGearbox.steel().with_brake(*rotor))
        assert _effects.settling(Machine(rotor=rotor)) == pytest.approx(there, rel=0.02)
    assert _effects.settling(Machine()) == pytest.approx(settling_time(CycloidalGearbox.steel()))


@pytest.mark.bench
def test_summaries_agree_in_distribution() -> None:
    here, there, cells, counts = _equivalence.distributions(80)
    z = _equivalence.standardised(here, there, counts)
    # Above 2 kHz the simulator's own time step shows; the levels there are below 1e-7 Nm^2.
    below = np.array([not cell.low_hz > 2000 for cell in cells])
    assert 0.7 < np.sqrt(np.mean(z[below] ** 2)) < 1.3
    assert np.mean(np.abs(z[below]) > 3) < 0.03


@pytest.mark.bench
def test_locator_finds_nothing_where_nothing_is_hidden() -> None:
    alarms, _ = _equivalence.false_alarms(30)
    assert alarms <= 5  # 1.5 expected; more than 5 has a chance of 0.3 %


# The sets.


def test_truth_is_what_code_and_tables_give() -> None:
    text = (HERE / "truth.json").read_text(encoding="utf-8")
    assert text == _sets.truth_text()
    digest = (HERE / "truth.sha256").read_text(encoding="utf-8").split()[0]
    assert hashlib.sha256(text.encode()).hexdigest() == digest
    assert json.loads(text)["sets"].keys() == _sets.definitions().keys()


# The packaged posterior.


def test_the_packaged_posterior_names_strong_effects_of_another_simulator(tmp_path: Path) -> None:
    """Of each of these effects the first strong single is said to be present, and no other effect."""
    sets = json.loads((HERE / "truth.json").read_text(encoding="utf-8"))["sets"]
    posterior = load_posterior()
    for effect in ("brake_rotor", "clipping", "rattle"):  # of the machine, of the signal, of the load
        name = next(
            name
            for name, one in sets.items()
            if one.get("strengths") == ["strong"] and list(one["effects"]) == [effect]
        )
        _folders.generate([name], tmp_path, 1)
        presence = posterior.presence(_ask.session_of(name, tmp_path))
        assert [other for other, p in presence.items() if p >= 0.95] == [effect]


def test_a_limit_just_above_the_mean_torque_is_sized_although_its_response_bends(tmp_path: Path) -> None:
    """Responses to one side alone would put it where it clips the whole recording."""
    name = "set_cf66100a"
    _folders.generate([name], tmp_path, 1)
    session, posterior = _ask.session_of(name, tmp_path), load_posterior()
    confirmed = confirm_effects(
        posterior, session, posterior.presence(session), n_recordings=100, random_state=0
    )
    assert confirmed.quantiles["clipping.limit_nm"][1] == pytest.approx(18.07, rel=0.02)


# The gallery shows these two without running them; they assert what they find.
@pytest.mark.parametrize("name", ["own_simulator", pytest.param("workflow", marks=pytest.mark.bench)])
def test_example_names_what_is_hidden(name, monkeypatch):
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda *_, **__: None)
    runpy.run_path(str(ROOT / "examples" / "gap" / f"{name}.py"), run_name="__main__")
