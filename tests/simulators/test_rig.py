"""Rigs: what is drawn from them, and that a file means what it says."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.stats import gamma, kstest, lognorm, loguniform, norm, rayleigh, truncnorm, uniform

from cyclofeat.simulators import (
    BrakeRotor,
    Clearance,
    CycloidalGearbox,
    Drift,
    Gain,
    GearboxParameter,
    Hum,
    LobeDefects,
    Noise,
    PinErrors,
    Rig,
    RunOut,
    Scale,
    known_effects,
    simulate,
)
from cyclofeat.simulators.simulation import settling_time

PRESETS = [Rig.r0(), Rig.r1(), Rig.r2()]
by_name = pytest.mark.parametrize("preset", PRESETS, ids=lambda preset: preset.name)


# What is drawn


def test_a_known_brake_is_exact_and_a_free_output_has_none():
    assembly = Rig.r1().draw(3).gearbox
    assert assembly.brake_inertia == 0.02
    assert assembly.meter_stiffness == 1e4
    assert assembly.meter_damping == pytest.approx(2 * 0.02 * math.sqrt(1e4 * 0.02), rel=1e-14)
    assert Rig.r0().draw(3).gearbox.brake_inertia == 0
    assert [preset.has_brake for preset in PRESETS] == [False, True, True]


@by_name
def test_machines_follow_from_their_seed_alone(preset):
    seed = np.random.SeedSequence(7, spawn_key=(3,))
    assert preset.draw(5) == preset.draw(5)
    assert preset.draw(seed) == preset.draw(seed)
    assert preset.draw(5) != preset.draw(6)
    assert not any(effect.has_spread for effect in preset.draw(5).effects)


@pytest.mark.slow
def test_the_spread_of_the_presets_is_as_stated():
    rig = Rig.r0()
    assert rig.effects[0] == PinErrors(10e-6)
    drawn = [rig.draw(seed).gearbox for seed in range(200)]
    runouts = np.array([one.wheel_runouts for one in drawn])
    assert np.std([runouts.real, runouts.imag]) == pytest.approx(5e-6, rel=0.06)
    # of either wheel its own, and normal by component: the squared length is exponential
    assert abs(np.corrcoef(abs(runouts[:, 0]), abs(runouts[:, 1]))[0, 1]) < 0.2
    assert np.mean(abs(runouts) ** 4) / np.mean(abs(runouts) ** 2) ** 2 == pytest.approx(2, rel=0.25)
    steel = CycloidalGearbox.steel()
    for name, width in (
        ("stiffness_scale", 0.25),
        ("contact_damping", 0.25),
        ("load_torque", 0.03),
        ("input_speed", 0.01),
    ):
        relative = np.array([getattr(one, name) for one in drawn]) / getattr(steel, name) - 1
        assert abs(relative).max() <= width + 1e-12
        assert np.ptp(relative) > 1.95 * width
        assert relative.std() == pytest.approx(width / 3**0.5, rel=0.1)
    clearances = np.array([one.clearance for one in drawn])
    assert 0 <= clearances.min() < clearances.max() <= 30e-6
    assert np.mean(clearances) == pytest.approx(15e-6, rel=0.1)
    assert len(set(drawn)) == 200


@pytest.mark.parametrize("preset", [Rig.r0(), Rig.r2()], ids=lambda preset: preset.name)
def test_one_effect_more_or_less_changes_nothing_else_of_an_assembly(preset):
    gearbox = preset.draw(9).gearbox
    assert preset.with_added(Hum((0.1, 0.4)), Drift()).draw(9).gearbox == gearbox
    other = preset.without("load_scale", "noise").draw(9).gearbox
    assert other.replace(load_torque=gearbox.load_torque) == gearbox


VARIANTS = Rig(
    CycloidalGearbox.steel(), [Noise(0.1), PinErrors(1e-5)],
    variants=[[Hum(0.1), Gain(1.02)], [Hum(0.2), Gain(1.01)], [BrakeRotor((0.01, 0.03))], []],
)  # fmt: skip


@pytest.mark.slow
def test_each_assembly_has_one_of_the_variants_with_equal_chances():
    sets = VARIANTS.effect_sets()
    drawn = [VARIANTS.draw(seed) for seed in range(400)]
    labels = [tuple(effect.effect_id for effect in machine.effects) for machine in drawn]
    kinds = [tuple(effect.effect_id for effect in effects) for effects in sets]
    assert kinds[2:] == [("pin_errors", "brake_rotor", "noise"), ("pin_errors", "noise")]
    for k, variant in enumerate(sets[:2]):
        assert sum(machine.effects == variant for machine in drawn) == pytest.approx(100, abs=35), (
            k
        )  # 4 sigma
    assert labels.count(kinds[2]) == pytest.approx(100, abs=35)
    assert len({machine.gearbox.brake_inertia for machine in drawn}) == labels.count(kinds[2]) + 1
    assert drawn == [VARIANTS.draw(seed) for seed in range(400)]


def test_variants_leave_all_else_of_an_assembly_as_it_is():
    plain = VARIANTS.replace(variants=())
    for seed in range(8):
        gearbox = VARIANTS.draw(seed).gearbox
        assert gearbox.pin_radial_errors == plain.draw(seed).gearbox.pin_radial_errors
    assert VARIANTS.has_brake
    assert not plain.has_brake
    assert VARIANTS.without("hum", "brake_rotor").variants == ((Gain(1.02),), (Gain(1.01),), (), ())


def test_the_gearbox_may_have_errors_of_its_own():
    own = CycloidalGearbox.steel(clearance=5e-5, pin_radial_errors=[1e-5] * 16, wheel_runouts=(1e-5j, 0j))
    assert Rig(own).draw(0).gearbox == own
    more = Rig(own, [PinErrors(2e-6), Clearance(1e-5), RunOut(1e-6)]).draw(0).gearbox
    assert more.clearance == pytest.approx(6e-5)
    assert np.abs(np.array(more.pin_radial_errors) - 1e-5).max() < 1e-5
    assert np.abs(np.array(more.wheel_runouts) - [1e-5j, 0]) == pytest.approx([1e-6, 1e-6])


def test_fields_of_the_gearbox_are_set_before_anything_acts_on_them():
    chosen = Rig(effects=[Scale("load", 1.1), GearboxParameter("load_torque", (15.0, 25.0))])
    loads = [chosen.draw(seed).gearbox.load_torque / 1.1 for seed in range(40)]
    assert 15 <= min(loads) < 16 < 24 < max(loads) <= 25
    assert chosen.effects[0].effect_id == "gearbox_parameter"
    with pytest.raises(ValueError, match="a numeric field .* 'load_torqe': did you mean 'load_torque'"):
        Rig(effects=[GearboxParameter("load_torqe", 1.0)])
    with pytest.raises(ValueError, match="shortening must .* got 2.0"):
        Rig(effects=[GearboxParameter("shortening", (0.5, 2.0))])


@pytest.mark.parametrize("seed", [1.0, "1", True, -1])
def test_a_seed_that_is_none_is_refused(seed):
    with pytest.raises((TypeError, ValueError), match=r"random_state must .* got"):
        Rig.r1().draw(seed)


# Settling


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_what_is_left_of_the_start_is_small_after_settling(seed):
    gearbox = Rig.r1().without("speed_scale").draw(seed).gearbox  # an output turn is 46080 samples
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
        ({"name": 1}, "name must be of type str, got 1"),
        ({"gearbox": "steel"}, "gearbox must be of type CycloidalGearbox, got 'steel'"),
        ({"effects": Hum()}, "effects must be several effects like .* got Hum"),
        ({"effects": None}, "effects must be several effects like .* got None"),
        ({"effects": ["hum"]}, r"effects must be several effects like .* got \['hum'\]"),
        ({"effects": [Hum(amplitude_nm=-1)]}, "amplitude_nm of hum must lie between 0 and 1000 Nm, got -1"),
        ({"effects": [RunOut(1e-6, (2,))]}, r"wheels of run_out must be \(0,\), \(1,\) or \(0, 1\), got"),
        ({"effects": [BrakeRotor(), BrakeRotor()]}, "effects must hold one brake_rotor at most, .* got 2"),
        ({"effects": [Noise(uniform(5000, 1))]}, r"must lie between 0 and 1000 Nm, where uniform.* has 0%"),
        ({"effects": [Noise(norm(0.2, -1))]}, "where norm.* has nan%"),
        ({"effects": [Noise(gamma(2.0))]}, "noise must be one of scipy's uniform, loguniform, .* got gamma"),
    ],
)
def test_bad_parameters_are_named(changes, message):
    with pytest.raises((TypeError, ValueError), match=message):
        Rig.r1().replace(**changes)


# Distributions


@pytest.mark.slow
@pytest.mark.parametrize(
    "distribution",
    [
        uniform(0.1, 0.4),
        loguniform(0.01, 1.0),
        norm(loc=0.5, scale=0.1),
        truncnorm(-1.0, 2.0, loc=0.5, scale=0.1),
        lognorm(0.3, scale=0.2),
        rayleigh(scale=0.2),
    ],
    ids=lambda one: one.dist.name,
)
def test_distributions_are_drawn_and_come_back_from_files(distribution, tmp_path):
    chosen = Rig(effects=[Noise(distribution)])
    values = np.array([chosen.draw(seed).effects[0].rms_nm for seed in range(150)])
    assert kstest(values, distribution.cdf).pvalue > 0.001
    chosen.to_json(tmp_path / "rig.json")
    back = Rig.from_json(tmp_path / "rig.json")
    assert back == chosen
    assert back.draw(3) == chosen.draw(3)
    assert distribution.dist.name in repr(chosen)


@pytest.mark.slow
def test_distributions_are_truncated_to_the_bounds():
    values = [Rig(effects=[Noise(norm(0.05, 0.1))]).draw(seed).effects[0].rms_nm for seed in range(200)]
    assert min(values) > 0  # and not 0 again and again
    assert len(set(values)) == 200


# Files


OF_ALL = Rig(effects=known_effects().values(), name="all")


@pytest.mark.parametrize("preset", [*PRESETS, VARIANTS, OF_ALL], ids=lambda preset: preset.name)
def test_a_file_says_everything_and_comes_back_the_same(preset, tmp_path):
    path = tmp_path / "rig.json"
    preset.to_json(path)
    assert Rig.from_json(path) == preset
    recorded = preset.replace(speeds_rpm=(400, 600.5), loads_nm=(22, 22))
    assert Rig.from_dict(json.loads(json.dumps(recorded.to_dict()))) == recorded
    text = path.read_text(encoding="utf-8")
    found = json.loads(text)
    lists = ["effects", "variants"] if preset.variants else ["effects"]
    assert set(found) == {"format", "note", "name", "gearbox", *lists}
    assert {name for name, value in found["gearbox"].items() if value == 22.0} == {"load_torque"}
    # one line to a value, and nothing else but brackets
    inner = sum(len(found[part]) + 1 for part in ("gearbox", *lists))
    assert len(text.splitlines()) == 2 + len(found) + inner


def test_round_trip_keeps_odd_values_to_the_last_bit(tmp_path):
    odd = Rig(
        name="Prüfstand 3 – β",
        gearbox=CycloidalGearbox.abs(
            eccentricity=np.float64(0.1 + 0.2) / 100, contact_law="hunt_crossley", load_torque=22, n_pins=14,
            pin_radial_errors=np.arange(14) * 1e-6 / 3, wheel_runouts=(1e-6 / 3 + 2e-6j, 0j),
        ),
        effects=[
            BrakeRotor([0.01 / 3, 1 / 3], np.array([3e3, 1e4]) / 7, (5e-324, 0.1)),
            Drift(np.float32(0.1), order=np.int64(3)),
            Clearance(uniform(0.0, 1e-5 / 3)),
        ],
    )  # fmt: skip
    path = tmp_path / "rig.json"
    odd.to_json(path)
    assert Rig.from_json(path) == odd
    assert "Prüfstand" in path.read_text(encoding="utf-8")


def test_a_rig_keeps_its_own_copies_of_its_effects():
    mine = Hum(0.2)
    kept = Rig(effects=[mine])
    mine.set_params(amplitude_nm=5.0)
    assert kept.effects == (Hum(0.2),)
    assert hash(kept) == hash(Rig(effects=[Hum(0.2)]))
    assert kept != Rig(effects=[mine])


def test_keys_may_be_left_out(tmp_path):
    path = tmp_path / "rig.json"
    path.write_text('\ufeff{"note": "mine", "gearbox": {"load_torque": 18}, "name": "x"}', encoding="utf-8")
    assert Rig.from_json(path) == Rig(CycloidalGearbox.steel(load_torque=18.0), name="x")
    path.write_text(
        '{"effects": [{"effect": "hum", "harmonics": [1, 0.5]}, {"effect": "gain"}]}', encoding="utf-8"
    )
    assert Rig.from_json(path) == Rig(effects=(Hum(harmonics=(1, 0.5)), Gain()))
    path.write_text("{}", encoding="utf-8")
    assert Rig.from_json(path) == Rig()


BAD_FILES = {
    "not json": ("{'name': 'x'}", "is not valid JSON: .* line 1, column 2"),
    "empty": ("", "is not valid JSON"),
    "a list": ("[1, 2]", r"the file must hold a JSON object {...}, got \[1, 2\]"),
    "deep": ("[" * 100_000, "nested too deeply"),
    "another format": ('{"format": "cyclofeat rig 2"}', "format must be 'cyclofeat rig', got 'cyclof"),
    "effects no list": (
        '{"effects": {"effect": "hum"}}',
        "effects must be a list of objects like .* got {'e",
    ),
    "effect no object": ('{"effects": ["hum"]}', r"effects\[0\]: must be an object like .* got 'hum'"),
    "effect misspelt": (
        '{"effects": [{"effect": "hum"}, {"effect": "torque_low_pass"}]}',
        r"effects\[1\]: unknown effect 'torque_low_pass': did you mean 'torque_meter_low_pass'",
    ),
    "effect key misspelt": (
        '{"effects": [{"effect": "hum", "amplitude": 1}]}',
        r"unknown key 'amplitude' of hum with value 1: did you mean 'amplitude_nm'\?",
    ),
    "effect key twice": (
        '{"effects": [{"effect": "gain", "factor": 1, "factor": 2}]}',
        "'factor' must stand",
    ),
    "effect value": ('{"effects": [{"effect": "gain", "factor": "1"}]}', "factor of gain must be a number"),
    "effect range": ('{"effects": [{"effect": "gain", "factor": [2, 1]}]}', r"low <= high, got \(2, 1\)"),
    "misspelt": ('{"gearbx": [1, 2]}', r"'gearbx' with value \[1, 2\]: did you mean 'gearbox'"),
    "unknown": ('{"zzz": 1}', "unknown key 'zzz' with value 1: known are format, note, gearbox, effects, "),
    "twice": ('{"name": "a", "name": "b"}', "'name' must stand only once"),
    "distribution unknown": (
        '{"effects": [{"effect": "noise", "rms_nm": {"distribution": "normal"}}]}',
        r"effects\[0\]: rms_nm of noise: must be a number, \[low, high\] or .* one of uniform, loguniform",
    ),
    "distribution key": (
        '{"effects": [{"effect": "noise", "rms_nm": {"distribution": "norm", "sale": 1}}]}',
        "unknown key 'sale' of norm with value 1: did you mean 'scale'",
    ),
    "distribution value": (
        '{"effects": [{"effect": "noise", "rms_nm": {"distribution": "norm", "loc": "a"}}]}',
        "loc of norm must be a number, got 'a'",
    ),
    "gearbox no object": ('{"gearbox": "steel"}', "gearbox must hold a JSON object .* got 'steel'"),
    "gearbox misspelt": ('{"gearbox": {"n_pin": 16}}', "'gearbox.n_pin' with value 16: .*'gearbox.n_pins'"),
    "gearbox value": ('{"gearbox": {"pin_radius": "6 mm"}}', "gearbox: pin_radius must be .* got '6 mm'"),
    "gearbox errors": ('{"gearbox": {"cam_errors": [[1, "a"]]}}', "gearbox: cam_errors must be a sequence"),
    "variants": ('{"variants": {"effect": "hum"}}', "variants must be a list of lists of effects, got {"),
    "variant": ('{"variants": [[], {"effect": "hum"}]}', r"variants\[1\]: effects must be a list .* got {"),
    "variant's effect": (
        '{"variants": [[{"effect": "hums"}]]}',
        r"variants\[0\]: effects\[0\]: unknown effect 'hums': did you mean 'hum'",
    ),
    "variant's brake": (
        '{"effects": [{"effect": "brake_rotor"}], "variants": [[], [{"effect": "brake_rotor"}]]}',
        r"effects and variants\[1\] must hold one brake_rotor at most",
    ),
    "name": ('{"name": "\\ud800"}', "name must be a line of printable text"),
}


@pytest.mark.parametrize(("text", "message"), BAD_FILES.values(), ids=BAD_FILES)
def test_a_bad_file_gives_one_clear_line(text, message, tmp_path):
    path = tmp_path / "bad rig.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message) as caught:
        Rig.from_json(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value).removeprefix(str(path))) < 600
    assert "\n" not in str(caught.value)


def test_files_that_are_none_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone.json: no such file; to_json writes"):
        Rig.from_json(tmp_path / "gone.json")
    with pytest.raises(OSError, match="cannot be read"):
        Rig.from_json(tmp_path)
    path = tmp_path / "binary.json"
    path.write_bytes(b'{"name": "\xff\xfe"}')
    with pytest.raises(ValueError, match=r"binary.json: is not text in UTF-8"):
        Rig.from_json(path)


def test_every_parameter_that_is_offered_changes_the_rig() -> None:
    rig = Rig.r1().with_added(Hum(0.1), Hum(0.2))
    parameters = rig.parameters()
    assert len(parameters) > 40
    for name, nominal in parameters.items():
        value = 0.99 * nominal if isinstance(nominal, float) and nominal else 0.0123
        if name in ("gearbox.pin_clearance", "gearbox.clearance"):
            value = 1e-5
        elif name.startswith(("clearance.", "run_out")):
            value = 2e-5
        elif name == "gearbox.brake_inertia":
            continue  # the rig has a brake already
        changed = rig.with_parameters({name: value})
        assert changed != rig, name
        assert changed.with_parameters({name: value}) == changed
    assert rig.with_parameters({}) == rig
