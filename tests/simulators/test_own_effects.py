"""Effects of users: what a class must state, files of them, and that every tool then knows them."""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import joblib
import numpy as np
import pytest
from scipy.stats import loguniform, norm

from cyclofeat.datasets import make_rig_recordings
from cyclofeat.simulators import (
    Campaign,
    Drift,
    Effect,
    EffectParameter,
    Hum,
    LobeDefects,
    Rig,
    known_effects,
    load_effects,
    register_effect,
    unregister_effect,
)

SHORT = {"duration": 0.05, "sampling_rate": 12_800.0}
TEXT = '''
from scipy.stats import loguniform

from cyclofeat.simulators import Effect, EffectParameter

LARGEST = 2.0


class GearLash(Effect):
    """Clicks of a loose coupling, at random times."""

    parameters = {
        "height_nm": EffectParameter("Nm", 0.0, 50.0, neutral=0.0, prior=loguniform(0.1, LARGEST), log=True),
        "rate_hz": EffectParameter("Hz", 1.0, 1e3, prior=loguniform(5.0, 200.0), log=True),
    }

    def change_torque(self, torque, sampling_rate, random, context=None):
        return torque + self.height_nm * (random.random(torque.size) < self.rate_hz / sampling_rate)
'''
AMOUNT = EffectParameter("Nm", 0.0, 10.0, neutral=0.0, prior=loguniform(0.1, 1.0), log=True)


@pytest.fixture
def lash(tmp_path: Path) -> Iterator[Any]:
    """The effect of a user's file, loaded; forgotten afterwards."""
    path = tmp_path / "mine.py"
    path.write_text(TEXT, encoding="utf-8")
    (kind,) = load_effects(path).values()
    yield kind
    unregister_effect("gear_lash")


# What a class must state


def test_parameters_and_one_method_are_all_that_it_takes() -> None:
    class SlowClicks(Effect):
        parameters: ClassVar = {
            "size_nm": AMOUNT,
            "offset": EffectParameter("1", -1, 1, prior=norm(0, 0.1), default=0.5),
        }

        def change_torque(self, torque, sampling_rate, random, context=None):  # type: ignore[no-untyped-def]
            return torque + self.size_nm

    assert (SlowClicks.effect_id, SlowClicks.place) == ("slow_clicks", "sensor")
    made = SlowClicks()
    assert made.get_params() == {"size_nm": pytest.approx(0.1**0.5), "offset": 0.5}
    assert repr(SlowClicks(2.0)) == "SlowClicks(size_nm=2.0)"
    assert SlowClicks(size_nm=2.0) == SlowClicks(2.0) != made
    assert made.vector_names() == ["size_nm", "offset"]
    with pytest.raises(TypeError, match="multiple values|unexpected|too many"):
        SlowClicks(1.0, 2.0, 3.0)
    plain, clicks = (Rig(effects=some).simulate(random_state=0, **SHORT) for some in ([], [SlowClicks(2.0)]))
    np.testing.assert_allclose(clicks.torque_out, plain.torque_out + 2.0)


def test_the_place_follows_from_the_hook_where_it_can() -> None:
    of_gearbox = type("OfGearbox", (Effect,), {"change_gearbox": print})
    of_load = type("OfLoad", (Effect,), {"load_fluctuation": print})
    of_both = type("OfBoth", (of_gearbox,), {"change_torque": print})  # as its parent's
    kinds = (of_gearbox, of_load, of_both)
    assert [kind.place for kind in kinds] == ["geometry", "load_and_speed", "geometry"]
    assert of_gearbox().needs_simulation()
    everything = type("Everything", (Effect,), {"change_gearbox": print, "change_torque": print})
    with pytest.raises(ValueError, match="place of Everything must be stated, one of nominal, geometry"):
        register_effect(everything)


def effect(name: str = "Mine", **members: Any) -> Any:
    hook = {"change_torque": lambda self, torque, sampling_rate, random, context=None: torque}
    return type(name, (Effect,), hook | members)


def forgetful(self: Any, size: float = 1.0) -> None:
    pass


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (3, "needs a subclass of Effect, got 3"),
        (Hum(), "needs a subclass of Effect, got Hum()"),
        (Effect, "needs a subclass of Effect"),
        (type("Idle", (Effect,), {"place": "sensor"}), "Idle must override one of change_gearbox, "),
        (effect(effect_id="My Effect"), "effect_id of Mine must be a name in snake_case, got 'My Effect'"),
        (effect(effect_id="hum"), "effect_id of Mine must be a name of its own, got 'hum', .* of cyclofeat"),
        (effect(parameters=[AMOUNT], __init__=forgetful), "parameters of Mine must be a mapping from names"),
        (effect(parameters={"size": 1.0}, __init__=forgetful), "parameters of Mine .* got {'size': 1.0}"),
        (effect(parameters={"size": EffectParameter("1", 1, 0)}, __init__=forgetful), "size of Mine must "),
        (effect(parameters={"x": AMOUNT}, __init__=forgetful), "Mine.__init__ must take the param"),
        (
            effect(parameters={"size": EffectParameter("1", 0, 1, prior=norm(9, 1))}),
            "prior of size of Mine must lie between 0 and 1, where norm",
        ),
        (effect(__init__=lambda self, size: None), r"Mine.__init__ must have a default for 'size': Mine"),
        (effect(__init__=forgetful), "Mine.__init__ must store size under the same name"),
        (effect(__init__=lambda self, **sizes: None), r"Mine.__init__ must name its arguments, got \*sizes"),
    ],
    ids=str,
)  # fmt: skip
def test_classes_that_are_no_effects_are_refused(kind: Any, message: str) -> None:
    before = list(known_effects())
    with pytest.raises((TypeError, ValueError), match=message):
        register_effect(kind)
    assert list(known_effects()) == before


def test_a_registered_effect_is_in_the_library_in_its_place() -> None:
    mine = register_effect(effect("MyDrift", parameters={"size": AMOUNT}, place="load_and_speed"))
    assert register_effect(mine) is mine  # again
    names = list(known_effects(proposed=True))
    assert names.index("load_drift") < names.index("my_drift") < names.index("sleeve_friction")
    register_effect(effect("OnlyMine"))  # no fitted parameter: for rigs only
    assert "only_mine" not in known_effects(proposed=True)
    assert Rig.from_dict({"effects": [{"effect": "only_mine"}]}).effects[0].effect_id == "only_mine"
    unregister_effect("only_mine")
    # A cell of a notebook that is run again defines the class anew.
    again = register_effect(effect("MyDrift", parameters={"size": AMOUNT}, place="load_and_speed"))
    assert type(known_effects()["my_drift"]) is again is not mine
    unregister_effect("my_drift")
    assert "my_drift" not in known_effects()
    for name in ("my_drift", "hum"):
        with pytest.raises(ValueError, match=f"one of the effects registered, .* got '{name}'"):
            unregister_effect(name)


# Files


def test_a_file_s_effect_goes_everywhere(lash: Any, tmp_path: Path) -> None:
    """A rig's file, a simulation, recordings made by two processes, a campaign's parameters."""
    assert lash.summary == "Clicks of a loose coupling, at random times."
    assert type(known_effects()["gear_lash"]) is lash
    rig = Rig(effects=[lash((0.5, 1.5), 100.0), Drift(0.5)], name="mine")
    rig.to_json(tmp_path / "rig.json")
    assert Rig.from_json(tmp_path / "rig.json") == rig
    found = json.loads((tmp_path / "rig.json").read_text(encoding="utf-8"))["effects"][1]
    assert found == {"effect": "gear_lash", "height_nm": [0.5, 1.5], "rate_hz": 100.0}
    run, without = (
        one.simulate(LobeDefects.worn(2), random_state=0, **SHORT) for one in (rig, rig.without("gear_lash"))
    )
    height = rig.draw(0).effects[1].height_nm
    struck = run.torque_out - without.torque_out
    assert set(struck.round(9)) == {0.0, round(height, 9)}
    one, two = (
        make_rig_recordings(2, [0, 2], rig=rig, duration=0.05, n_jobs=n_jobs, random_state=0)
        for n_jobs in (1, 2)
    )
    assert one == two
    assert {each.meta["effects"][1]["effect"] for each in one} == {"gear_lash"}
    campaign = Campaign(rig=rig)
    assert Campaign.from_dict(campaign.to_dict()) == campaign


def test_effects_of_a_file_come_back_from_other_processes_as_they_went(lash: Any) -> None:
    sent = lash(1.0, (10.0, 20.0))
    assert pickle.loads(pickle.dumps(sent)) == sent
    (back,) = joblib.Parallel(n_jobs=2)(joblib.delayed(_widened)(one) for one in [sent])
    assert type(back) is lash
    assert back == lash(2.0, (10.0, 20.0))


def _widened(sent: Effect) -> Effect:
    assert type(known_effects()["gear_lash"]) is type(sent)  # the worker knows it too
    return sent.with_parameters(height_nm=2.0)


def test_a_file_is_run_once_and_anew_when_it_changed(lash: Any, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    assert load_effects(path)["gear_lash"] is lash
    path.write_text(TEXT.replace("LARGEST = 2.0", "LARGEST = 3.0"), encoding="utf-8")
    changed = load_effects(path)["gear_lash"]
    assert changed is not lash
    assert type(known_effects()["gear_lash"]) is changed
    assert changed.parameters["height_nm"].prior.support()[1] == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\ny = (\n", r"mine.py, line 2: SyntaxError: '\(' was never closed"),
        ("\n\nx = 1 / 0\n", "mine.py, line 3: ZeroDivisionError: division by zero"),
        ("import nothing_of_that_name\n", "mine.py, line 1: ModuleNotFoundError: No module named 'nothing"),
        ("x = 1\n", "mine.py: defines no subclass of Effect"),
        (
            "from cyclofeat.simulators import Effect\n\n\nclass Mine(Effect):\n    pass\n",
            "mine.py, line 4: Mine must override one of",
        ),
        (TEXT.replace("GearLash", "Hum"), "mine.py, line 9: effect_id of Hum must be a name of its own"),
    ],
    ids=range(6),
)
def test_files_that_cannot_be_are_named_with_their_line(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(text, encoding="utf-8")
    before = list(known_effects())
    with pytest.raises(ValueError, match=message):
        load_effects(path)
    assert list(known_effects()) == before


def test_files_that_are_none_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"gone.py: no such file; give one with subclasses"):
        load_effects(tmp_path / "gone.py")
    (tmp_path / "bytes.py").write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match=r"bytes.py: is not text in UTF-8 \(byte 0\)"):
        load_effects(tmp_path / "bytes.py")
