"""Rigs: what is drawn from them, how their load drifts, and that a file means what it says."""

from __future__ import annotations

import dataclasses
import doctest
import inspect
import json
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cyclofeat.simulators import (
    AssemblyTolerances,
    BrakeRotor,
    CycloidalGearbox,
    Gain,
    Hum,
    LobeDefects,
    ProportionalDrift,
    Quantisation,
    Rig,
    TorqueMeterLowPass,
    effect_library,
    rig,
    settling_time,
    simulate,
)

PRESETS = [Rig.r0(), Rig.r1(), Rig.r2()]
by_name = pytest.mark.parametrize("preset", PRESETS, ids=lambda preset: preset.name)


def test_examples_of_the_docstrings_run():
    result = doctest.testmod(rig)
    assert result.attempted > 0
    assert result.failed == 0


# What is drawn


@by_name
def test_presets_are_what_they_say(preset):
    assert preset.has_brake == (preset.name != "R0")
    assert (preset.load_drift_nm, preset.load_drift_cutoff_hz, preset.load_drift_order) == (3.0, 1.5, 2)
    assert preset.gearbox == CycloidalGearbox.steel()


def test_a_known_brake_is_exact_and_a_free_output_has_none():
    assembly = Rig.r1().assemble(3)
    assert assembly.brake_inertia == 0.02
    assert assembly.meter_stiffness == 1e4
    assert assembly.meter_damping == pytest.approx(2 * 0.02 * math.sqrt(1e4 * 0.02), rel=1e-14)
    assert Rig.r0().assemble(3).brake_inertia == 0


@by_name
def test_assemblies_follow_from_their_seed_alone(preset):
    seed = np.random.SeedSequence(7, spawn_key=(3,))
    assert preset.assemble(5) == preset.assemble(5) == preset.assemble(np.random.default_rng(5))
    assert preset.assemble(seed) == preset.assemble(seed)
    assert preset.assemble(5) != preset.assemble(6)
    moving = np.random.default_rng(5)
    assert preset.assemble(moving) != preset.assemble(moving)


def test_ranges_are_filled_log_uniformly():
    drawn = [Rig.r2().assemble(seed) for seed in range(400)]
    inertia = np.array([a.brake_inertia for a in drawn])
    stiffness = np.array([a.meter_stiffness for a in drawn])
    ratio = np.array([a.meter_damping for a in drawn]) / (2 * np.sqrt(inertia * stiffness))
    for values, (low, high) in (
        (inertia, (0.005, 0.05)),
        (stiffness, (3e3, 3e4)),
        (ratio, (0.01, 0.05)),
        (np.array([a.stiffness_scale for a in drawn]), (0.005, 0.02)),
        (np.array([a.contact_damping for a in drawn]), (75, 300)),
    ):
        share = np.log(values / low) / np.log(high / low)
        assert share.min() >= -1e-12
        assert share.max() <= 1 + 1e-12
        # mean of 400 uniform values: 0.5 +- 0.0144; 4 sigma
        assert abs(share.mean() - 0.5) < 0.058
        assert abs(share.std() - math.sqrt(1 / 12)) < 0.04


def test_one_range_changes_nothing_else_of_an_assembly():
    narrow = Rig.r2().replace(brake_inertia=(0.02, 0.02)).assemble(4)
    wide = Rig.r2().assemble(4)
    assert narrow.meter_stiffness == wide.meter_stiffness
    assert narrow.pin_radial_errors == wide.pin_radial_errors
    assert narrow.brake_inertia == 0.02 != wide.brake_inertia


@pytest.mark.parametrize("seed", [None, 1.0, "1", True, -1])
def test_a_seed_that_is_none_is_refused(seed):
    with pytest.raises((TypeError, ValueError), match=r"seed must .* got"):
        Rig.r1().assemble(seed)
    with pytest.raises((TypeError, ValueError), match=r"seed must .* got"):
        Rig.r1().drift(seed, 1.0)


# The load's drift


@pytest.mark.parametrize("order", [1, 2, 4])
def test_rms_of_the_drift_is_that_of_theory(order):
    cutoff, duration = 1.5, 2000.0
    load = Rig.r1().replace(load_drift_order=order).drift(seed=11, duration=duration)
    values = load(np.arange(0, duration, 1 / 997))  # no multiple of the drift's own spacing
    # Mean square of Gaussian noise: relative std sqrt(2 * integral of rho^2 / T); the integral over all lags
    # is below 1 / cutoff for these filters.
    tolerance = 4 * math.sqrt(2 / (cutoff * duration))
    assert np.mean(values**2) == pytest.approx(9.0, rel=tolerance)
    assert abs(values.mean()) < 4 * 3.0 / math.sqrt(cutoff * duration)


def test_drift_is_stationary_from_the_start():
    first = np.array([Rig.r1().drift(seed, 0.1)(np.array([0.0, 0.05])) for seed in range(600)])
    # relative std of a variance from 600 values: sqrt(2/600) = 0.058; 4 sigma
    np.testing.assert_allclose(first.var(axis=0), 9.0, rtol=0.24)


def test_spectrum_of_the_drift_is_that_of_its_low_pass():
    cutoff, rate, n, segments = 1.5, 256.0, 4096, 400
    load = Rig.r1().drift(seed=5, duration=segments * n / rate)
    values = load(np.arange(segments * n) / rate).reshape(segments, n)
    window = np.hanning(n)
    psd = 2 * np.mean(np.abs(np.fft.rfft(values * window)) ** 2, axis=0) / (rate * np.sum(window**2))
    f = np.fft.rfftfreq(n, 1 / rate)
    # one-sided density of a Butterworth low-pass of order 2 with power 9: its noise bandwidth is
    # cutoff * (pi/4) / sin(pi/4)
    theory = 9.0 / (cutoff * np.pi / 4 / math.sin(np.pi / 4)) / (1 + (f / cutoff) ** 4)
    for low, high in ((0.2, 1), (1, 2), (3, 6), (8, 16)):
        band = (f >= low) & (f < high)
        # about band.sum() / 1.5 independent bins of 400 averages each: below 2 %
        assert psd[band].sum() == pytest.approx(theory[band].sum(), rel=0.08)
    assert psd[f > 40].max() < 1e-5 * theory[1]


def test_broad_drift_reaches_higher_and_adds_its_power():
    preset = Rig.r2()
    t = np.arange(0, 400, 1 / 500)
    both = preset.drift(2, 400)(t)
    slow = preset.replace(broad_drift_nm=0.0).drift(2, 400)(t)
    broad = preset.replace(load_drift_nm=0.0).drift(2, 400)(t)
    np.testing.assert_allclose(both, slow + broad, atol=1e-12)
    assert broad.std() == pytest.approx(0.3, rel=4 * math.sqrt(2 / (25 * 400)))
    assert abs(np.corrcoef(slow, broad)[0, 1]) < 0.1

    def power_above(signal, limit):
        lines = np.abs(np.fft.rfft(signal * np.hanning(t.size))) ** 2
        return lines[np.fft.rfftfreq(t.size, 1 / 500) > limit].sum()

    assert power_above(both, 20) > 20 * power_above(slow, 20)


def test_a_longer_drift_begins_like_a_shorter_one():
    t = np.linspace(0, 1, 333)
    np.testing.assert_array_equal(Rig.r2().drift(8, 1)(t), Rig.r2().drift(8, 20)(t))
    assert not np.array_equal(Rig.r2().drift(8, 1)(t), Rig.r2().drift(9, 1)(t))


def test_no_drift_is_zero_and_times_outside_are_refused():
    still = Rig.r1().replace(load_drift_nm=0.0).drift(0, 1.0)
    np.testing.assert_array_equal(still(np.linspace(0, 1, 5)), 0)
    for time in (-0.1, 2.5, math.nan):
        with pytest.raises(ValueError, match="longer duration"):
            still(np.array([0.0, time]))
    for duration in (0, -1.0, math.inf):
        with pytest.raises(ValueError, match="duration must be"):
            Rig.r1().drift(0, duration)


def test_drift_serves_a_simulation_of_its_duration():
    slow = Rig.r0().replace(load_drift_cutoff_hz=0.5).drift(1, 0.4)
    run = simulate(duration=0.4, load_fluctuation=slow)
    late = run.time > 0.35
    # without a brake the load passes through, but for the ripple
    np.testing.assert_allclose(run.torque_out[late], 22 + slow(run.time[late]), atol=0.2)
    assert abs(slow(run.time[late]).mean()) > 0.3


# Settling


@pytest.mark.parametrize("seed", [0, 1])
def test_what_is_left_of_the_start_is_small_after_settling(seed):
    fixed_speed = AssemblyTolerances(speed=0.0)  # 500 RPM: an output turn is 46080 samples
    gearbox = Rig.r1().replace(tolerances=fixed_speed).assemble(seed)
    turn, begin = 46_080, math.ceil(settling_time(gearbox) * 25_600)
    torque = simulate(gearbox, LobeDefects.worn(2), duration=(begin + 2 * turn) / 25_600).torque_out
    left = torque[begin : begin + turn] - torque[begin + turn :]
    assert np.abs(torque[: begin // 3] - torque[turn : turn + begin // 3]).max() > 1
    assert left.std() < 0.01 * torque[begin:].std()


def test_settling_follows_damping():
    free = CycloidalGearbox.steel()
    assert settling_time(free) == pytest.approx(0.2 + 0.12)
    slow, fast = (settling_time(free.with_brake(0.05, 3e3, ratio)) for ratio in (0.01, 0.05))
    assert slow > fast > 0.32
    soft = free.replace(contact_law="hunt_crossley", contact_damping=0.5)
    assert 0.32 <= settling_time(soft.with_brake(0.02, 1e4, 0.02)) < 3
    undamped = free.replace(contact_damping=0.0).with_brake(0.02, 1e4, 0.0)
    assert settling_time(undamped) == math.inf
    assert settling_time(free.replace(load_torque=0.0).with_brake(0.02, 1e4, 0.02)) < 3


# Parameters


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": ""}, "name must be a line of printable text, got ''"),
        ({"name": "a\nb"}, "name must be a line"),
        ({"name": 1}, "name must be text, got 1"),
        ({"gearbox": "steel"}, "gearbox must be of type CycloidalGearbox, got 'steel'"),
        ({"tolerances": None}, "tolerances must be of type AssemblyTolerances"),
        ({"gearbox": CycloidalGearbox.steel(clearance=1e-5)}, "gearbox.clearance is drawn .* tolerances.cl"),
        ({"gearbox": Rig.r1().assemble(0)}, "is drawn for each assembly"),
        ({"brake_inertia": None}, "brake_inertia must be given with meter_stiffness and meter_damping_ratio"),
        ({"brake_inertia": 0.02}, r"brake_inertia must be a pair of numbers \(low, high\), got 0.02"),
        ({"brake_inertia": (0.1, 0.02)}, r"0 < low <= high, got \(0.1, 0.02\)"),
        ({"meter_stiffness": (0.0, 1e4)}, "meter_stiffness must be"),
        ({"meter_stiffness": (1e4,)}, "meter_stiffness must be a pair .* got 1 values"),
        ({"meter_damping_ratio": (0.02, 1.0)}, "meter_damping_ratio must be .* high < 1, got"),
        ({"contact_stiffness_factor": (1, math.inf)}, "contact_stiffness_factor must be .* finite, got inf"),
        ({"contact_damping_factor": None}, "contact_damping_factor must be a pair"),
        ({"load_drift_nm": -1}, "load_drift_nm must not be negative"),
        ({"load_drift_nm": math.nan}, "load_drift_nm must be .* finite, got nan"),
        ({"noise_nm": "0.2"}, "noise_nm must be a number of Nm, got '0.2'"),
        ({"noise_nm": True}, "noise_nm must be a number of Nm, got True"),
        ({"load_drift_cutoff_hz": 0.0}, "load_drift_cutoff_hz must lie above 0"),
        ({"broad_drift_cutoff_hz": 1e5}, "broad_drift_cutoff_hz must lie above 0 and up to 1000 Hz"),
        ({"load_drift_order": 2.0}, "load_drift_order must be a whole number, got 2.0"),
        ({"load_drift_order": 9}, "load_drift_order must lie between 1 and 8, got 9"),
        ({"effects": Hum()}, "effects must be a sequence of effects, got Hum"),
        ({"effects": None}, "effects must be a sequence of effects, got None"),
        ({"effects": ["hum"]}, "effects must hold effects like Hum.* got 'hum'"),
        ({"effects": [Hum(amplitude_nm=-1)]}, "amplitude_nm of hum must lie between 0 and 1000 Nm, got -1"),
        ({"effects": [BrakeRotor()]}, "effects must hold no brake_rotor where the rig has a brake, .* got 2"),
    ],
)
def test_bad_parameters_are_named(changes, message):
    with pytest.raises((TypeError, ValueError), match=message):
        Rig.r1().replace(**changes)


# Files


@by_name
def test_a_file_says_everything_and_comes_back_the_same(preset, tmp_path):
    path = tmp_path / "rig.json"
    preset.to_json(path)
    assert Rig.from_json(path) == preset
    found = json.loads(path.read_text(encoding="utf-8"))
    fields = {item.name for item in dataclasses.fields(Rig)}
    assert set(found) == fields | {"format", "note"}
    assert found["load_drift_nm"] == 3.0
    # one line to a value, and nothing else but brackets
    inner = sum(len(found[part]) + 1 for part in ("gearbox", "tolerances"))
    assert len(path.read_text(encoding="utf-8").splitlines()) == 2 + len(found) + inner


def test_round_trip_keeps_odd_values_to_the_last_bit(tmp_path):
    odd = Rig(
        name="Prüfstand 3 – β",
        gearbox=CycloidalGearbox.abs(
            eccentricity=np.float64(0.1 + 0.2) / 100, contact_law="hunt_crossley", load_torque=22, n_pins=14.0
        ),
        tolerances=AssemblyTolerances(pin_position=1e-5 / 3, clearance=(1e-6 / 3, 1e-5)),
        brake_inertia=[0.01 / 3, 1 / 3],
        meter_stiffness=np.array([3e3, 1e4]) / 7,
        meter_damping_ratio=(5e-324, 0.1),
        load_drift_nm=np.float32(0.1),
        load_drift_order=np.int64(3),
    )
    path = tmp_path / "rig.json"
    odd.to_json(path)
    assert Rig.from_json(path) == odd
    assert "Prüfstand" in path.read_text(encoding="utf-8")


def test_effects_stand_in_the_file_one_to_a_line(tmp_path):
    path = tmp_path / "rig.json"
    effects = [Hum(amplitude_nm=(0.1, 0.4)), TorqueMeterLowPass(300), Quantisation(0.05)]
    corrected = Rig.r1().replace(effects=effects)
    corrected.to_json(path)
    assert Rig.from_json(path) == corrected
    text = path.read_text(encoding="utf-8")
    assert '    {"effect": "torque_meter_low_pass", "cutoff_hz": 300.0, "order": 2},\n' in text
    assert '    {"effect": "quantisation", "lsb_nm": 0.05, "full_scale_nm": null}\n' in text
    found = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert found["effects"] == [effect.to_dict() for effect in effects]
    assert found["format"] == "cyclofeat rig 2"


def test_effects_of_a_file_may_leave_keys_out(tmp_path):
    path = tmp_path / "rig.json"
    path.write_text('{"effects": [{"effect": "hum", "harmonics": [1, 0.5]}, {"effect": "gain"}]}')
    assert Rig.from_json(path) == Rig(effects=(Hum(harmonics=(1, 0.5)), Gain()))


def test_files_of_the_first_format_are_still_read(tmp_path):
    path = tmp_path / "rig.json"
    Rig.r2().to_json(path)
    content = json.loads(path.read_text(encoding="utf-8"))
    del content["effects"]
    content["format"] = "cyclofeat rig 1"
    path.write_text(json.dumps(content), encoding="utf-8")
    assert Rig.from_json(path) == Rig.r2()


@st.composite
def any_effects(draw):
    """Effects with any values and ranges within the bounds of their parameters."""
    drawn = []
    kinds = [*effect_library().values(), ProportionalDrift]
    for kind in draw(st.lists(st.sampled_from(kinds), max_size=4, unique=True)):
        values = {}
        for name, parameter in kind.parameters.items():
            ends = st.floats(parameter.low, min(parameter.high, 1e9), exclude_min=True)
            ranges = st.tuples(ends, ends).map(sorted).map(tuple)
            values[name] = draw(st.one_of(ends, ranges) if kind is not Quantisation else ends)
        if kind is Quantisation:
            values["full_scale_nm"] = draw(st.sampled_from([math.inf, 2e3]))
        if "phase" in inspect.signature(kind).parameters:
            values["phase"] = draw(st.none() | st.floats(-1e3, 1e3))
        if "order" in inspect.signature(kind).parameters:
            values["order"] = draw(st.integers(1, 8))
        drawn.append(kind(**values))
    return drawn


@settings(max_examples=60, deadline=None)
@given(effects=any_effects())
def test_any_effects_come_back_to_the_last_bit(effects):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.json"
        rig_with = Rig(effects=effects)
        rig_with.to_json(path)
        back = Rig.from_json(path)
    assert back == rig_with
    assert [effect.get_params() for effect in back.effects] == [effect.get_params() for effect in effects]


def test_a_rig_keeps_its_own_copies_of_its_effects():
    mine = Hum(0.2)
    kept = Rig(effects=[mine])
    mine.set_params(amplitude_nm=5.0)
    assert kept.effects == (Hum(0.2),)
    assert hash(kept) == hash(Rig(effects=[Hum(0.2)]))
    assert kept != Rig(effects=[mine])


def test_keys_may_be_left_out(tmp_path):
    path = tmp_path / "rig.json"
    path.write_text('\ufeff{"note": "mine", "gearbox": {"load_torque": 18}, "noise_nm": 1}', encoding="utf-8")
    assert Rig.from_json(path) == Rig(gearbox=CycloidalGearbox.steel(load_torque=18.0), noise_nm=1.0)
    path.write_text("{}", encoding="utf-8")
    assert Rig.from_json(path) == Rig.r0()


BAD_FILES = {
    "not json": ("{'name': 'x'}", "is not valid JSON: .* line 1, column 2"),
    "empty": ("", "is not valid JSON"),
    "cut off": ('{"name": "R1", "gearbox": {', "is not valid JSON"),
    "a list": ("[1, 2]", r"the file must hold a JSON object {...}, got \[1, 2\]"),
    "deep": ("[" * 100_000, "nested too deeply"),
    "another format": (
        '{"format": "cyclofeat rig 9"}',
        "'cyclofeat rig 2' or 'cyclofeat rig 1', got 'cyclof",
    ),
    "effects too early": (
        '{"format": "cyclofeat rig 1", "effects": []}',
        "effects need the format 'cyclofeat",
    ),
    "effects no list": (
        '{"effects": {"effect": "hum"}}',
        "effects must be a list of objects like .* got {'e",
    ),
    "effect no object": ('{"effects": ["hum"]}', r"effects\[0\]: must be an object like .* got 'hum'"),
    "effect without name": ('{"effects": [{"rms_nm": 1}]}', r"effects\[0\]: must be an object like"),
    "effect misspelt": (
        '{"effects": [{"effect": "hum"}, {"effect": "torque_low_pass"}]}',
        r"effects\[1\]: unknown effect 'torque_low_pass': did you mean 'torque_meter_low_pass' \(Low-pass in",
    ),
    "effect unknown": (
        '{"effects": [{"effect": "zzz"}]}',
        "unknown effect 'zzz': known are pin_errors, lobe_pitch_errors,",
    ),
    "effect key misspelt": (
        '{"effects": [{"effect": "hum", "amplitude": 1}]}',
        r"unknown key 'amplitude' of hum with value 1: did you mean 'amplitude_nm'\?",
    ),
    "effect key unknown": (
        '{"effects": [{"effect": "gain", "zzz": 1}]}',
        "unknown key 'zzz' of gain with value 1: known are factor",
    ),
    "effect key twice": (
        '{"effects": [{"effect": "gain", "factor": 1, "factor": 2}]}',
        "'factor' must stand",
    ),
    "effect value": ('{"effects": [{"effect": "gain", "factor": "1"}]}', "factor of gain must be a number"),
    "effect null": ('{"effects": [{"effect": "gain", "factor": null}]}', "factor of gain must be a number"),
    "effect range": ('{"effects": [{"effect": "gain", "factor": [2, 1]}]}', r"low <= high, got \(2, 1\)"),
    "effect NaN": ('{"effects": [{"effect": "offset", "offset_nm": NaN}]}', "must lie between .* got nan"),
    "effect order": (
        '{"effects": [{"effect": "load_drift", "order": 2.5}]}',
        "order of load_drift must be a whole",
    ),
    "two brakes": (
        '{"effects": [{"effect": "brake_rotor"}, {"effect": "brake_rotor"}]}',
        "got 2 brakes in all",
    ),
    "note": ('{"note": 3}', "note must be text, got 3"),
    "misspelt": ('{"brake_inertai": [1, 2]}', r"'brake_inertai' with value \[1, 2\]: did you mean 'brake_i"),
    "unknown": ('{"zzz": 1}', "unknown key 'zzz' with value 1: known are name, gearbox"),
    "twice": ('{"noise_nm": 1, "noise_nm": 2}', "'noise_nm' must stand only once"),
    "gearbox no object": ('{"gearbox": "steel"}', "gearbox must hold a JSON object .* got 'steel'"),
    "gearbox misspelt": ('{"gearbox": {"n_pin": 16}}', "'gearbox.n_pin' with value 16: .*'gearbox.n_pins'"),
    "gearbox text": (
        '{"gearbox": {"pin_radius": "6 mm"}}',
        "gearbox.pin_radius must be a number, got '6 mm'",
    ),
    "gearbox null": ('{"gearbox": {"pin_radius": null}}', "gearbox.pin_radius must be a number, got None"),
    "gearbox flag": ('{"gearbox": {"pin_radius": true}}', "gearbox.pin_radius must be a number, got True"),
    "gearbox NaN": ('{"gearbox": {"pin_radius": NaN}}', "gearbox.pin_radius must be .* finite, got nan"),
    "gearbox huge": ('{"gearbox": {"pin_radius": 1e999}}', "gearbox.pin_radius must be .* finite, got inf"),
    "gearbox fraction": ('{"gearbox": {"n_pins": 16.5}}', "gearbox.n_pins must be a whole number, got 16.5"),
    "gearbox range": ('{"gearbox": {"pin_radius": -1}}', "gearbox: pin_radius must be positive, got -1"),
    "gearbox law": ('{"gearbox": {"contact_law": "hertz"}}', "contact_law must be one of .* got 'hertz'"),
    "gearbox law type": ('{"gearbox": {"contact_law": 1}}', "gearbox.contact_law must be text, got 1"),
    "gearbox drawn": ('{"gearbox": {"clearance": 0}}', "gearbox.clearance is drawn .* give tolerances.clear"),
    "tolerances": ('{"tolerances": {"speed": 1.5}}', "tolerances: speed is a relative .* got 1.5"),
    "tolerances pair": ('{"tolerances": {"clearance": 1e-5}}', "tolerances.clearance must be a pair"),
    "brake alone": ('{"brake_inertia": [0.02, 0.02]}', "meter_stiffness and meter_damping_ratio must be giv"),
    "brake text": ('{"brake_inertia": ["a", 1]}', "brake_inertia must be a pair of numbers .* got 'a'"),
    "order": ('{"load_drift_order": "two"}', "load_drift_order must be a whole number, got 'two'"),
    "digits": ('{"noise_nm": ' + "9" * 5000 + "}", "noise_nm must be .* finite, got inf"),
    "long whole": ('{"noise_nm": ' + "9" * 400 + "}", "noise_nm must be .* finite, got 999"),
    "noise": ('{"noise_nm": -0.1}', "noise_nm must not be negative"),
    "name": ('{"name": "\\ud800"}', "name must be a line of printable text"),
}


@pytest.mark.parametrize(("text", "message"), BAD_FILES.values(), ids=BAD_FILES)
def test_a_bad_file_gives_one_clear_line(text, message, tmp_path):
    path = tmp_path / "bad rig.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message) as caught:
        Rig.from_json(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value).removeprefix(str(path))) < 400
    assert "\n" not in str(caught.value)


def test_files_that_are_none_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone.json: no such file; Rig.to_json"):
        Rig.from_json(tmp_path / "gone.json")
    with pytest.raises(OSError, match="cannot be read"):
        Rig.from_json(tmp_path)
    path = tmp_path / "binary.json"
    path.write_bytes(b'{"name": "\xff\xfe"}')
    with pytest.raises(ValueError, match=r"binary.json: is not text in UTF-8"):
        Rig.from_json(path)
