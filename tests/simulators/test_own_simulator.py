"""Simulators of users: a joint whose torque is a formula, in rigs, runs, files and worlds."""

from __future__ import annotations

import dataclasses
import json
import pickle
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.stats import loguniform

from cyclofeat.datasets import make_rig_recordings
from cyclofeat.gap import Comparison, World, prepare_world
from cyclofeat.simulators import (
    CycloidalGearbox,
    Drift,
    Effect,
    EffectParameter,
    Gain,
    LobeDefects,
    Noise,
    Offset,
    Rig,
    Scale,
    SimulationFailed,
    Simulator,
    load_effects,
    register_effect,
    simulate_many,
    unregister_effect,
)
from cyclofeat.simulators.sampling import sample_runs

RATE = 2000.0
SHORT: dict[str, Any] = {"duration": 0.5, "sampling_rate": RATE}


@dataclass(frozen=True)
class Cardan(Simulator):
    """Universal joint: a wave twice per turn of the input, and 0.1 Nm for each worn lobe."""

    depth: float = 0.1
    fails_above: float = 1e9

    def simulate(self, time, angle, speed, load, gearbox, defects):  # type: ignore[no-untyped-def]
        if load.mean() > self.fails_above:
            raise SimulationFailed("the joint locks")
        return load * (1 + self.depth * np.cos(2 * angle)) + 0.1 * defects.defect_count, angle


class Misaligned(Effect):
    """Shafts at a larger angle than stated."""

    parameters: ClassVar = {
        "factor": EffectParameter("1", 1.0, 20.0, neutral=1.0, prior=loguniform(2.0, 8.0), log=True)
    }

    def change_simulator(self, simulator, random):  # type: ignore[no-untyped-def]
        return dataclasses.replace(simulator, depth=self.factor * simulator.depth)


OWN = Rig(CycloidalGearbox.steel(load_torque=20.0), name="joint", simulator=Cardan())


@pytest.fixture
def misaligned() -> Iterator[type[Effect]]:
    """The effect, known to files and worlds; forgotten afterwards."""
    yield register_effect(Misaligned)
    unregister_effect("misaligned")


# What the simulator is asked, and what becomes of its answer


def test_a_record_is_what_the_formula_says() -> None:
    run = OWN.simulate(LobeDefects.worn(3), random_state=0, **SHORT)
    np.testing.assert_allclose(run.torque_out, 20 * (1 + 0.1 * np.cos(2 * run.input_angle)) + 0.3)
    assert run.torque_out.shape == (1000,)
    np.testing.assert_allclose(np.diff(run.input_angle) * RATE, OWN.gearbox.input_speed)
    assert run.kernel == "Cardan"
    other = OWN.simulate(**SHORT, random_state=1)
    assert other.input_angle[0] != run.input_angle[0]
    given = OWN.simulate(random_state=0, **SHORT, start_angle=0.25)
    assert given.input_angle[0] == 0.25


def test_effects_on_load_speed_and_torque_act_as_on_the_gearbox() -> None:
    rig = OWN.with_added(Scale("speed", 1.1), Drift(0.5, 4.0), Gain(2.0), Offset(-1.0))
    run = rig.simulate(**SHORT, random_state=3)
    np.testing.assert_allclose(np.diff(run.input_angle) * RATE, 1.1 * OWN.gearbox.input_speed)
    load = (run.torque_out + 1) / 2 / (1 + 0.1 * np.cos(2 * run.input_angle))
    assert 0.1 < load.std() < 1.5
    assert np.abs(np.diff(load)).max() < 0.03  # below 4 Hz
    drift = rig.plan_run(**SHORT, random_state=3).arguments["courses"].load_fluctuation
    np.testing.assert_allclose(load, 20 + drift(run.time), atol=1e-9)


def test_an_effect_changes_the_simulator() -> None:
    plain, more = (rig.simulate(random_state=0, **SHORT) for rig in (OWN, OWN.with_added(Misaligned(3.0))))
    np.testing.assert_allclose(more.torque_out - 20, 3 * (plain.torque_out - 20), atol=1e-12)
    neutral = OWN.with_added(Misaligned(1.0)).simulate(random_state=0, **SHORT)
    np.testing.assert_array_equal(neutral.torque_out, plain.torque_out)
    drawn = OWN.with_added(Misaligned((2.0, 4.0))).draw(5)
    assert drawn.simulator == Cardan(0.1 * drawn.effects[0].factor)
    with pytest.raises(ValueError, match=r"simulator must be given for Misaligned\(\), which changes it"):
        Rig(effects=[Misaligned()])


@pytest.mark.parametrize("kernel", ["auto", "exact"])
def test_runs_of_many_machines_keep_their_order(kernel: str) -> None:
    gearbox = Rig()
    rigs = [OWN, gearbox, OWN.replace(simulator=Cardan(fails_above=10.0)), OWN.with_added(Offset(1.0))]
    plans = [rig.plan_run(duration=0.02, sampling_rate=RATE, random_state=k) for k, rig in enumerate(rigs)]
    first, of_gearbox, failed, last = sample_runs(plans, kernel=kernel)
    assert isinstance(failed, SimulationFailed)
    assert [run.run.kernel == "Cardan" for run in (first, of_gearbox, last)] == [True, False, True]
    for plan, run in ((plans[0], first), (plans[3], last)):
        np.testing.assert_array_equal(run.record().torque_out, plan.simulate().record().torque_out)


def test_surrogates_and_many_runs_are_the_simulators_too() -> None:
    recordings = make_rig_recordings(1, (0, 4), rig=OWN, duration=0.5, sampling_rate=RATE, random_state=0)
    means = [recording.torque.mean() for recording in recordings]
    np.testing.assert_allclose(means, [20.0, 20.4], atol=0.1)
    (run,) = simulate_many(simulator=Cardan(0.0), duration=0.1, sampling_rate=RATE)
    np.testing.assert_array_equal(run.torque_out, 22.0)


# Files


def test_rigs_and_worlds_come_back_from_json(misaligned, tmp_path) -> None:  # type: ignore[no-untyped-def]
    rig = OWN.with_added(Misaligned(2.5)).replace(simulator=Cardan(0.2))
    rig.to_json(tmp_path / "rig.json")
    assert Rig.from_json(tmp_path / "rig.json") == rig != OWN
    world = World(rig=OWN, effects=(Misaligned(), Gain()), most=1)
    assert World.from_dict(json.loads(json.dumps(world.to_dict()))) == world
    assert "simulator" not in Rig().to_dict()
    changed = rig.to_dict() | {"simulator": {"class": "Unheard", "depth": 1.0}}
    with pytest.raises(ValueError, match="simulator must be of a defined class, got 'Unheard'"):
        Rig.from_dict(changed)


def test_a_name_that_two_modules_define_is_not_guessed() -> None:
    source = "@dataclass(frozen=True)\nclass Twice(Cardan):\n    'Of some module.'"
    modules = [{"__name__": name, "Cardan": Cardan, "dataclass": dataclass} for name in ("a", "b")]
    exec(source, modules[0])
    exec(source, modules[0])  # as a cell of a notebook that is run again: the newer class counts
    kept = modules[0]["Twice"](0.3)
    assert type(Rig.from_dict({"simulator": kept._to_dict()}).simulator) is type(kept)
    exec(source, modules[1])
    with pytest.raises(ValueError, match="simulator must be of one class, but a and b define Twice: rename"):
        Rig.from_dict({"simulator": kept._to_dict()})


FILE = """
from dataclasses import dataclass, replace
from cyclofeat.simulators import Effect, EffectParameter, Simulator

@dataclass(frozen=True)
class Steady(Simulator):
    torque: float = 1.0

    def simulate(self, time, angle, speed, load, gearbox, defects):
        return self.torque + 0 * load, angle

class Heavier(Effect):
    parameters = {"by": EffectParameter("Nm", 0, 10, neutral=0.0)}

    def change_simulator(self, simulator, random):
        return replace(simulator, torque=simulator.torque + self.by)
"""


def test_a_file_of_effects_may_hold_the_simulator_and_travels_with_it(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "steady.py"
    path.write_text(FILE, encoding="utf-8")
    (heavier,) = load_effects(path).values()
    steady = {"class": "Steady", "torque": 3.0}
    rig = Rig.from_dict({"simulator": steady, "effects": [heavier(2.0).to_dict()]})
    sent = pickle.dumps(rig)
    path.unlink()
    del sys.modules[heavier.__module__]  # as in another process
    came = pickle.loads(sent)
    unregister_effect("heavier")
    assert came.to_dict() == rig.to_dict()
    np.testing.assert_array_equal(came.simulate(random_state=0, **SHORT).torque_out, 5.0)


# What goes wrong


class NoDataclass(Cardan):
    """Without the decorator: its parameters would be lost."""

    reach: float = 1.0


@dataclass(frozen=True)
class WithTable(Cardan):
    """A field that no file can hold."""

    table: Any = ()


@pytest.mark.parametrize(
    ("simulator", "message"),
    [
        (NoDataclass(), r"NoDataclass must have the decorator @dataclass\(frozen=True\)"),
        (
            WithTable(table=[1.0]),
            r"table of WithTable must be a finite number, text, True or False, got \[1.0\]",
        ),
        (lambda time: time, "simulator must be of type Simulator, got <function"),
    ],
    ids=["no dataclass", "table", "function"],
)
def test_a_simulator_of_another_kind_is_refused(simulator: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        OWN.replace(simulator=simulator)


@dataclass(frozen=True)
class Faulty(Simulator):
    """What is wrong with the answer is a parameter."""

    fault: str = "short"

    def simulate(self, time, angle, speed, load, gearbox, defects):  # type: ignore[no-untyped-def]
        gap = np.where(np.arange(angle.size) == 7, np.nan, angle)
        answers = {"short": (load[:-1], angle), "nan": (load, gap), "torque alone": load, "nothing": None}
        return answers[self.fault]


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("short", r"simulate of Faulty\(fault='short'\) must return torque of shape \(1000,\), got \(999,\)"),
        ("nan", "must return finite input_angle, or raise SimulationFailed, got nan at sample 7 of 1000"),
        ("torque alone", r"raised ValueError: too many values to unpack"),
        ("nothing", "raised TypeError: cannot unpack|raised TypeError: .*NoneType.* iterable"),
        ("unheard", "raised KeyError: 'unheard'"),
    ],
)
def test_a_wrong_answer_names_the_simulator(fault: str, message: str) -> None:
    with pytest.raises(RuntimeError, match=message) as caught:
        OWN.replace(simulator=Faulty(fault)).simulate(random_state=0, **SHORT)
    assert "Faulty" in str(caught.value)


# The gap


def test_a_world_considers_what_its_simulator_answers(misaligned) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match="quantity must be 'output_torque' for a user's simulator"):
        World(rig=OWN, quantity="input_torque")
    own, of_gearbox = set(World(rig=OWN).names), set(World().names)
    assert own - of_gearbox == {"misaligned"}
    assert {"pin_errors", "clearance", "brake_rotor"} <= of_gearbox - own
    assert {"load_drift", "speed_wander", "noise", "gain", "hum"} <= own


@pytest.mark.slow
def test_a_world_is_simulated_by_it(misaligned, tmp_path) -> None:  # type: ignore[no-untyped-def]
    world = World(
        rig=OWN, effects=(Misaligned(), Offset(), Noise()), most=2, sampling_rate=RATE,
        speeds_rpm=(600, 700), n_recordings=4, n_rigs_per_machine=3,
    )  # fmt: skip
    rigs = prepare_world(world, tmp_path, 8)
    assert rigs.values.shape == (24, 4, len(world.cells))
    assert np.isfinite(rigs.values).all()
    mean = rigs.values[:, :, rigs.cells.index("amplitudes: mean")]
    _, load, direction = np.moveaxis(rigs.conditions, 2, 0)
    offset = np.nan_to_num(rigs.sizes[:, rigs.size_names.index("offset.offset_nm")])[:, None]
    # But for 0.5 % of the load, by which it may differ.
    hidden = np.abs(mean - load - 0.1 * rigs.counts - direction * offset) / load
    assert hidden.max() < 0.012
    ripple = rigs.values[:, :, rigs.cells.index("amplitudes: level of the ripple")]
    factor = np.exp(np.nan_to_num(rigs.sizes[:, rigs.size_names.index("misaligned.factor")]))[:, None]
    quiet = ~rigs.present[:, rigs.names.index("noise")]
    expected = 20 * np.log10(0.1 * factor * load / np.sqrt(2))
    np.testing.assert_allclose(ripple[quiet], expected[quiet], atol=0.2)


def test_a_broken_simulator_ends_a_preparation_and_a_locked_one_is_left_out(tmp_path) -> None:  # type: ignore[no-untyped-def]
    small: dict[str, Any] = {
        "effects": (Offset(),), "most": 1, "sampling_rate": RATE, "speeds_rpm": (600, 601), "n_recordings": 1,
    }  # fmt: skip
    with pytest.raises(RuntimeError, match="Faulty.*must return torque of shape"):
        prepare_world(World(rig=OWN.replace(simulator=Faulty()), **small), tmp_path / "broken", 1)
    rigs = prepare_world(
        World(rig=OWN.replace(simulator=Cardan(fails_above=20.0)), **small), tmp_path / "locked", 4
    )
    assert 0 < len(rigs) < 64
    assert rigs.conditions[:, 0, 1].max() < 20.3


def test_banks_are_simulated_by_it() -> None:
    comparison = Comparison(sampling_rate=RATE, rig=OWN, defect_counts=(0, 5))
    bank = comparison.bank(4)
    np.testing.assert_allclose(bank.X.mean(axis=1), [20.0, 20.5, 20.0, 20.5], rtol=0.01)
