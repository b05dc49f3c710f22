"""The hidden effects: a generator that is the simulator's equal, its truth, oracle and score.

The generator is compiled by itself and no part of the package, so all of this is slow.
"""

from __future__ import annotations

import ast
import hashlib
import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import welch

from benchmarks import gap
from benchmarks._markdown import wilson
from benchmarks.hidden_effects import (
    _answers,
    _ask,
    _effects,
    _equivalence,
    _folders,
    _sets,
    _table,
    _visible,
)
from benchmarks.hidden_effects.__main__ import main
from benchmarks.hidden_effects._machine import Machine, run
from cyclofeat.gap import World, load_posterior
from cyclofeat.gap.confirm.confirm import confirm_effects
from cyclofeat.gap.posterior.answers import named_effects
from cyclofeat.gap.world.rigs import Session
from cyclofeat.gap.world.world import FLOOR
from cyclofeat.simulators import CycloidalGearbox, Drift, Effect, Noise, known_effects
from cyclofeat.simulators.effects.effect import TorqueContext
from cyclofeat.simulators.simulation import settling_time

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow  # a benchmark is no part of the package

HERE = ROOT / "benchmarks" / "hidden_effects"
FS = 25_600
STRENGTHS = ("weak", "medium", "strong")


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
    noise, drift = FLOOR
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


def test_blows_come_once_per_turn() -> None:
    machine, time = Machine(), np.arange(0, 9, 1e-4)
    course = _effects._broken_tooth(machine, {"blow_nm": 2.0}, time, 1.0, np.random.default_rng(0))
    starts = time[1:][np.diff((course > 0).astype(int)) == 1]
    np.testing.assert_allclose(np.diff(starts), 30 * math.pi / machine.speed, atol=3e-4)
    assert course.max() == pytest.approx(2.0, rel=0.05)


def test_effects_beyond_the_library_are_what_they_say() -> None:
    time = np.arange(2 * FS) / FS
    torque = 22 + 0.3 * np.sin(2 * np.pi * 100 * time)
    run = _effects.Run(torque, 52 * time, 0, 22.0)

    def made(effect: str, **values: float) -> Any:
        return _effects._SIGNAL[effect][1](torque, run, values, np.random.default_rng(3)) - torque

    assert np.abs(made("hysteresis", width_nm=0.2)[FS:]).max() == pytest.approx(0.1, rel=1e-6)
    assert np.std(made("supply_modulation", share=0.01, frequency_hz=73)) == pytest.approx(
        0.22 / 2**0.5, rel=0.01
    )
    assert np.std(made("inverter_tone", amplitude_nm=0.1, frequency_hz=4000)) == pytest.approx(
        0.1 / 2**0.5, rel=0.01
    )
    assert np.min(made("dropout", per_second=4, length_s=0.01) + torque) == 0
    spikes = made("spikes", height_nm=2.0, per_second=20)
    assert set(np.round(np.unique(spikes), 9)) <= {-4.0, -2.0, 0.0, 2.0, 4.0}
    assert 15 <= np.count_nonzero(spikes) <= 65
    assert np.mean(made("noise_bursts", rms_nm=0.1, per_second=3) != 0) == pytest.approx(0.15, abs=0.12)


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


def test_another_law_is_another_torque() -> None:
    """What the comparison above would see: a damping of another form, 2 % more stiffness, 1 um of a pin."""
    worn = np.zeros((2, 15), dtype=np.int64)
    worn[0, 3] = 1
    plain, _ = run(Machine(worn=worn), 15_000, 2.1)
    displaced = np.zeros(16, dtype=complex)
    displaced[5] = 1e-6
    for other in (
        Machine(worn=worn, hunt_crossley=True),
        Machine(worn=worn, stiffness=1.02),
        Machine(worn=worn, pins=displaced),
    ):
        changed, _ = run(other, 15_000, 2.1)
        assert np.std((changed - plain)[5000:]) > 0.01 * np.std(plain[5000:])


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


def test_nuisance_is_the_priors() -> None:
    drawn = [_effects.draw_nuisance(np.random.default_rng(seed)) for seed in range(2000)]
    speeds, loads = (np.array([getattr(one, name) for one in drawn]) for name in ("speed", "load"))
    assert np.abs(speeds).max() <= 0.003
    assert np.std(speeds) == pytest.approx(0.003 / np.sqrt(3), rel=0.05)
    assert np.abs(loads).max() <= 0.005
    assert np.std(loads) == pytest.approx(0.005 / np.sqrt(3), rel=0.05)
    pins = np.array([one.pins for one in drawn])
    assert np.std(pins.real) == pytest.approx(5e-6, rel=0.02)
    assert np.std(pins.imag) == pytest.approx(5e-6, rel=0.02)
    assert np.mean([one.wheels == (0,) for one in drawn]) == pytest.approx(0.5, abs=0.05)
    assert {one.first_lobe for one in drawn} == set(range(15))
    turns = np.array([one.start_angle for one in drawn]) / (30 * np.pi)
    assert turns.min() >= 0
    assert turns.max() < 1
    assert np.mean(turns) == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("decoy", ["edges", "speed", "load", "both", "assembly", "disc"])
def test_decoys_stay_inside_the_prior(decoy: str) -> None:
    common = [0.7, 0.2, 0.4, 0.9]
    drawn = [_effects.draw_nuisance(np.random.default_rng(seed), decoy, common) for seed in range(50)]
    assert max(abs(one.speed) for one in drawn) <= 0.003
    assert max(abs(one.load) for one in drawn) <= 0.005
    assert len({one.start_angle for one in drawn}) == 50
    if decoy in ("edges", "speed", "both"):
        assert all(abs(one.speed) == 0.003 for one in drawn)
    if decoy in ("speed", "both"):
        assert len({one.speed for one in drawn}) == 1
    if decoy in ("load", "both"):
        assert {one.load for one in drawn} == {0.005}
    if decoy == "assembly":
        assert all(np.array_equal(one.pins, drawn[0].pins) for one in drawn)
    if decoy == "disc":
        assert {(one.first_lobe, one.wheels) for one in drawn} == {(13, (0,))}


def test_slow_process_has_the_stated_density() -> None:
    rms, cutoff = 0.7, 2.0
    time = np.arange(2**15) / 512
    width = cutoff * (np.pi / 4) / np.sin(np.pi / 4)
    found, squares = [], []
    for seed in range(60):
        x = _effects.slow_process(np.random.default_rng(seed), rms, cutoff, time)
        frequencies, psd = welch(x, 512, nperseg=2**13, detrend=False)
        found.append(psd)
        squares.append(np.mean(x**2))
    assert np.sqrt(np.mean(squares)) == pytest.approx(rms, rel=0.06)
    density = rms**2 / width / (1 + (frequencies / cutoff) ** 4)
    inside = (frequencies > 0.2) & (frequencies < 15)
    ratio = np.mean(found, axis=0)[inside] / density[inside]
    assert np.mean(ratio) == pytest.approx(1, abs=0.03)
    assert np.all(np.abs(10 * np.log10(ratio)) < 1.5)


def test_second_mode_is_in_the_machine() -> None:
    two = Machine(rotor=(0.006, 1.5e4, 0.02), second_rotor=(0.015, 5e3, 0.02))
    one = Machine(rotor=(0.021, 1.5e4, 0.02))
    quiet = [run(machine, 2 * FS)[0][-FS:] for machine in (two, one)]
    assert abs(np.std(quiet[0]) / np.std(quiet[1]) - 1) > 0.1


# The sets.


def test_truth_is_what_code_and_tables_give() -> None:
    text = (HERE / "truth.json").read_text(encoding="utf-8")
    assert text == _sets.truth_text()
    digest = (HERE / "truth.sha256").read_text(encoding="utf-8").split()[0]
    assert hashlib.sha256(text.encode()).hexdigest() == digest
    assert json.loads(text)["sets"].keys() == _sets.definitions().keys()


def test_kinds_and_numbers() -> None:
    sets = list(_sets.definitions().values())
    assert Counter(one.kind for one in sets) == {"null": 400, "single": 400, "several": 300, "outside": 100}
    assert sum(bool(one.decoy) for one in sets) == 100
    assert sum(len(one.conditions) == 3 for one in sets) == pytest.approx(400, abs=15)
    assert sum(one.conditions == (_sets.STANDARD,) for one in sets) == pytest.approx(400, abs=15)
    assert Counter(len(one.effects) for one in sets if one.kind == "several") == dict.fromkeys(
        range(2, 7), 60
    )


def test_every_effect_of_the_training_world_is_hidden_alone_in_three_strengths() -> None:
    singles = Counter(
        (effect, strength)
        for one in _sets.definitions().values()
        if one.kind == "single"
        for effect, strength, _ in one.effects
    )
    names = World().names
    assert sorted(_sets.effect_names("sizes.csv")) == sorted(names)
    assert min(singles[name, strength] for name in names for strength in STRENGTHS) == 4
    assert not set(_sets.effect_names("beyond.csv")) & set(known_effects())


def test_sizes_lie_inside_the_librarys_priors() -> None:
    for one in _sets.definitions().values():
        for name, values in one.hidden:
            if name in known_effects():
                effect = library(name, values)
                assert set(values) == set(effect.vector_names())
                for key, value in values.items():
                    low, high = effect.parameters[key].prior.ppf([1e-4, 1 - 1e-4])
                    assert low <= value <= high, (one.name, name, key)


def test_conditions_and_recordings() -> None:
    for one in _sets.definitions().values():
        fit, hold = ([p for p in one.recordings if p.part == part] for part in ("fit", "hold"))
        n = len(one.conditions)
        assert len(fit) == {1: 8, 3: 12}[n]
        assert len(hold) == (0 if one.kind == "null" else len(fit))
        for at in (*one.conditions, *((one.between,) if one.between else ())):
            assert 350 <= at.speed_rpm <= 700
            assert 10 <= at.load_nm <= 30
            assert at.direction in (1, -1)
        if n == 3:
            loads = [at.load_nm for at in one.conditions]
            assert max(loads) >= 1.999 * min(loads)
            assert sum(p.condition == one.between for p in hold) in (0, 6)
        elif hold:
            assert sum(p.count % 2 for p in hold) == 4  # counts that no fit has seen


def test_sets_that_share_a_machine_differ_on_the_signal_only() -> None:
    shared: dict[int, list[_sets.Definition]] = {}
    for one in _sets.definitions().values():
        shared.setdefault(one.machine, []).append(one)
    assert len(shared) < 1000
    for sets in shared.values():
        assert len({(one.kind, one.conditions, one.decoy) for one in sets}) == 1
        assert len({str(_folders._in_machine(one)) for one in sets}) == 1
        assert len({str(sorted(one.hidden)) for one in sets}) == len(sets)


def test_folders_are_read_and_the_same_every_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A set's folder holds what the generator gives, and one beside it that shares its machine."""
    first = next(one for one in _sets.definitions().values() if [n for n, _ in one.hidden] == ["gain"])
    _folders.generate([first.name], tmp_path, 1)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        one.name for one in _sets.definitions().values() if one.machine == first.machine
    )
    _folders.generate([first.name], tmp_path, 1)
    assert "0 sets" in capsys.readouterr().out
    fit, hold = _folders.read_set(first.name, tmp_path)
    planned, (torque,) = next(_folders.recordings_of([first]))
    np.testing.assert_array_equal(fit[0].torque, torque)
    assert [len(fit), len(hold)] == [
        sum(p.part == part for p in first.recordings) for part in ("fit", "hold")
    ]
    assert (fit[0].speed_rpm, fit[0].load_nm) == (planned.condition.speed_rpm, planned.condition.load_nm)
    sign = np.sign(torque.mean())
    assert sign == planned.condition.direction
    factor = dict(first.hidden)["gain"]["factor"]
    assert sign * torque.mean() == pytest.approx(factor * planned.condition.load_nm, rel=0.02)
    session = _ask.session_of(first.name, tmp_path)
    assert np.all(np.abs(session.values[:, 0]) < 1)  # speed in % of the stated one


# The oracle.


def test_the_oracles_distance_is_that_of_the_samples() -> None:
    random = np.random.default_rng(0)
    distances = []
    for _ in range(10):
        blocks = np.arange(32) % 4
        pairs = random.normal(size=(32, 40)) + 10 * blocks[:, None]
        with_it, without = pairs + 0.1 * random.normal(size=(32, 40)), pairs
        with_it = with_it + np.r_[3.0, np.zeros(39)]
        same = without + 1e-3 * random.normal(size=(32, 40))
        distances.append([_visible.distance(one, without, blocks) for one in (with_it, same)])
    seen, unseen = np.mean(distances, axis=0)
    assert 2.0 < seen < 3.3
    assert abs(unseen) < 0.2


def test_the_oracle_has_judged_every_effect_of_every_set_and_no_other() -> None:
    known = _visible.visible()
    assert set(known) == set(_sets.set_names(["single", "several"]))
    for name, sigmas in known.items():
        assert set(sigmas) == {effect for effect, _ in _sets.definitions()[name].hidden}
    seen = [sigma >= _visible.SIGMA for sigmas in known.values() for sigma in sigmas.values()]
    page = " ".join((HERE / "README.md").read_text(encoding="utf-8").split())
    assert f"Of the {len(seen):,} effects" in page
    assert f"it sees {sum(seen):,}." in page


# The score.


def answered(name: str, seen: set[str] | None = None, **probabilities: float) -> _answers.Answer:
    truth = _sets.definitions()[name]
    effects = [{"id": effect, "probability": p} for effect, p in probabilities.items()]
    hidden = {effect for effect, _ in truth.hidden}
    return _answers.Answer(truth, frozenset(hidden if seen is None else seen), {"effects": effects})


def one_of(kind: str, *effects: str) -> str:
    return next(
        name for name, one in _sets.definitions().items()
        if one.kind == kind and (not effects or {e for e, _ in one.hidden} == set(effects))
    )  # fmt: skip


def test_ties_count_as_one_and_invisible_effects_may_be_named_or_not() -> None:
    gain = one_of("single", "gain")
    assert answered(gain, gain=0.9, hum=0.1).exact
    tied = answered(gain, offset=0.6, hum=0.1)
    assert tied.right
    assert not tied.exact
    assert not answered(gain, gain=0.9, hum=0.7).right
    assert not answered(gain, gain=0.2).right
    assert answered(gain, seen=set(), gain=0.2).right
    assert answered(gain, seen=set(), gain=0.7).right
    assert tied.told_apart(["gain"], ["offset"]) is False
    assert tied.told_apart(["hum"]) is None
    one_of_two = answered(gain, gain=0.3, load_scale=0.4, offset=0.2)
    assert one_of_two.told_apart(["gain"], ["offset"]) is False
    assert one_of_two.told_apart(["offset"], ["gain", "load_scale"]) is True
    shared = answered(gain, gain=0.3, offset=0.3, hum=0.1)
    assert shared.right
    assert shared.named == set()


def test_a_claim_is_wrong_if_present_and_absent_or_absent_and_visible() -> None:
    gain = one_of("single", "gain")
    assert not answered(gain, gain=0.01, offset=0.97).wrong_claim
    assert not answered(gain, gain=0.01, offset=0.5, load_scale=0.01).wrong_claim
    assert answered(gain, gain=0.01, offset=0.01, load_scale=0.01).wrong_claim
    assert not answered(gain, seen=set(), gain=0.01).wrong_claim
    assert answered(gain, gain=0.97, hum=0.99).wrong_claim
    assert answered(gain, hum=0.5).claims() == {"hum": "unresolved"}


def test_figures_by_hand() -> None:
    null, gain, hum = one_of("null"), one_of("single", "gain"), one_of("single", "hum")
    outside = one_of("outside")
    every = [
        answered(null, hum=0.95, gain=0.05), answered(gain, gain=0.95, hum=0.05),
        answered(hum, hum=0.45, gain=0.05), answered(outside, hum=0.95),
    ]  # fmt: skip
    size = dict(_sets.definitions()[gain].hidden)["gain"]["factor"]
    every[1].result["effects"][0]["sizes"] = {"factor": {"value": 1.1 * size, "low": 0.0, "high": size / 2}}
    found = {one.name: one for one in _table.figures(every)}
    assert found['null: verdict "disagree"'].value is None
    assert found["null: an effect with probability 0.5 or more"].value == 1
    assert found["1 effect: right group, nothing else"].value == 0.5
    assert found["1 effect: median error of sizes"].value == pytest.approx(0.1)
    assert found["precision, by groups"].value == 0.5
    assert found["recall of visible effects, by groups"].value == 0.5
    assert found["1 effect: 90 % intervals that cover"].value == 0
    confident, unflagged = (
        found["inside: wrong name with 0.9 or more"],
        found["outside, not flagged: wrong name with 0.9 or more"],
    )
    hidden = {effect for effect, _ in _sets.definitions()[outside].hidden}
    assert (confident.value, confident.n, confident.met) == (1 / 3, 3, False)
    assert (unflagged.value, unflagged.n, unflagged.met) == (float("hum" not in hidden), 1, None)
    assert "| 1 | 2 |" in _table.markdown(every)


def test_wilson_by_hand() -> None:
    low, high = wilson(8, 10)
    assert (low, high) == pytest.approx((0.4902, 0.9433), abs=1e-4)


def test_results_are_read_from_files(tmp_path: Path) -> None:
    name = one_of("single", "hum")
    result = {
        "format": _answers.FORMAT,
        "verdict": "disagree",
        "effects": [{"id": "hum", "probability": 0.9}],
    }
    (tmp_path / f"{name}.json").write_text(json.dumps(result), encoding="utf-8")
    (read,) = _answers.read_answers(tmp_path)
    assert read.named == read.true == {"hum"}
    (tmp_path / f"{name}.json").write_text(json.dumps(result | {"format": "other"}), encoding="utf-8")
    with pytest.raises(ValueError, match="format must be"):
        _answers.read_answers(tmp_path)
    with pytest.raises(ValueError, match=r"holds no <set>\.json"):
        _answers.read_answers(tmp_path / "none")


def test_shown_sessions_are_parts_of_the_whole() -> None:
    conditions = np.array([(500.0, 22.0, 1)] * 12)
    session = Session(np.arange(24.0).reshape(12, 2), conditions, np.arange(12))
    part = _ask.shown(session, 4, counts=False)
    assert part.values[:, 0].tolist() == [0, 6, 12, 18]
    assert part.counts is None
    assert _ask.shown(session).counts is not None


def test_wrong_arguments(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="kinds must be of"):
        _sets.set_names(["pairs"])
    with pytest.raises(SystemExit):
        main(["generate"])
    name = one_of("single", "hum")
    result = {"format": _answers.FORMAT, "effects": [{"id": "hum", "probability": 0.9}]}
    (tmp_path / f"{name}.json").write_text(json.dumps(result), encoding="utf-8")
    assert main(["score", str(tmp_path)]) == 0
    assert "1 of 400 single" in (tmp_path / "score.md").read_text(encoding="utf-8")


class Guess:
    """A posterior that has learned two effects of three."""

    names_ = ("hum", "gain", "noise")
    size_names_ = ("hum.amplitude_nm", "gain.factor", "noise.rms_nm")

    def predict_proba(self, sessions: list[Session]) -> np.ndarray:
        return np.tile([0.9, 0.2, np.nan], (len(sessions), 1))

    def predict_visible(self, sessions: list[Session]) -> np.ndarray:
        return np.tile([0.88, 0.01, np.nan], (len(sessions), 1))

    def predict_quantiles(self, sessions: list[Session]) -> np.ndarray:
        return np.tile([[0.1, 0.2, 0.3, 0.4, 0.5], [1.0] * 5, [np.nan] * 5], (len(sessions), 1, 1))


def test_what_a_posterior_says_is_a_result() -> None:
    name = one_of("single", "hum")
    session = Session(np.zeros((8, 2)), np.array([(500.0, 22.0, 1)] * 8), np.zeros(8, dtype=np.int64))
    (result,) = _ask.names_of(Guess(), [session])
    assert [one["id"] for one in result["effects"]] == ["hum", "gain"]
    assert result["effects"][0]["sizes"] == {"amplitude_nm": {"value": 0.3, "low": 0.1, "high": 0.5}}
    (answer,) = _answers.answers({name: json.loads(json.dumps(result))})
    assert answer.named == {"hum"}
    assert answer.claims()["hum"] == "unresolved"
    assert answer.perhaps_seen() == {"hum"}  # a gain would be too small
    text = "\n".join(gap.by_posterior(Guess(), {name: session}))
    assert "| all recordings, counts unknown | 1 | 1 | 1 | 1 |" in text


def test_the_whole_workflow_is_run_on_sets_of_every_kind() -> None:
    chosen = gap.whole_names(_sets.set_names(), 12)
    assert Counter(_sets.definitions()[name].kind for name in chosen) == {
        "several": 6, "single": 2, "outside": 2, "null": 2,
    }  # fmt: skip


def test_the_packaged_posterior_names_strong_effects_of_another_simulator(tmp_path: Path) -> None:
    """Of each of these effects the first strong single is said to be present, and no other effect."""
    sets = json.loads((HERE / "truth.json").read_text(encoding="utf-8"))["sets"]
    posterior = load_posterior()
    for effect in ("brake_rotor", "clipping", "noise", "quantisation", "rattle"):
        name = next(
            name
            for name, one in sets.items()
            if one.get("strengths") == ["strong"] and list(one["effects"]) == [effect]
        )
        _folders.generate([name], tmp_path, 1)
        presence = posterior.presence(_ask.session_of(name, tmp_path))
        assert [other for other, p in presence.items() if p >= 0.95] == [effect]


@pytest.mark.slow
def test_where_the_linear_fit_fails_the_sizes_of_the_posterior_stand(tmp_path: Path) -> None:
    """A limit just above the mean torque: fitted, it would clip the whole recording."""
    name = "set_cf66100a"
    _folders.generate([name], tmp_path, 1)
    session, posterior = _ask.session_of(name, tmp_path), load_posterior()
    confirmed = confirm_effects(
        posterior, session, named_effects(posterior.presence(session)), random_state=0
    )
    stated = {name: row[1] for name, row in zip(confirmed.names, confirmed.quantiles, strict=True)}
    assert not confirmed.fitted
    assert stated["clipping.limit_nm"] == pytest.approx(18.07, rel=0.04)
    assert stated["clipping.limit_nm"] == pytest.approx(posterior.sizes(session)["clipping.limit_nm"][2])
