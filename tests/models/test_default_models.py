"""The packaged models: what they say of themselves, what they count, and that they are of this version."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cyclofeat import __version__, models
from cyclofeat._base.quantities import QUANTITIES
from cyclofeat.cli import main
from cyclofeat.datasets import make_rig_recordings, write_recording
from cyclofeat.models import load_default_model
from cyclofeat.models.card import card_path, feature_definitions, read_card
from cyclofeat.simulators import BrakeRotor, Noise, Rig

COUNTS = (0, 2, 4, 6)


def rig_recordings(quantity, seed, **options):
    return make_rig_recordings(
        1, COUNTS, rig="R2", quantity=quantity, random_state=seed, with_angle=True, kernel="auto", **options
    )


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_each_quantity_has_a_small_model_of_this_version(quantity):
    path = Path(models.__file__).with_name("default") / f"{quantity}.skops"
    card = read_card(path)
    assert path.stat().st_size + card_path(path).stat().st_size < 3_000_000
    # Models of another version are refused: make default-models.
    assert card["versions"]["cyclofeat"] == __version__
    model = load_default_model(quantity)
    assert model.card_["quantity"] == quantity
    assert feature_definitions(model) == card["features"]
    assert model.card_["classes"] == list(range(8))
    low, high = model.card_["speeds_rpm"]
    assert low < 110
    assert high > 1400
    assert "simulated assemblies of rig R2" in model.card_["description"]


def test_an_unknown_quantity_is_refused():
    with pytest.raises(ValueError, match="quantity must be one of 'output_torque', .*, got 'torque'"):
        load_default_model("torque")


@pytest.mark.slow
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_other_assemblies_are_counted_at_speeds_and_loads_far_apart(quantity):
    model, right, sure = load_default_model(quantity), [], []
    for seed, (speed, load) in enumerate([(300.0, 10.0), (500.0, 22.0), (900.0, 30.0)]):
        for one in rig_recordings(quantity, 900 + seed, speed_rpm=speed, load_nm=load, output_turns=1.1):
            counted = model.count(one)
            right.append(counted.defect_count == one.defect_count)
            if not right[-1] and not counted.refused:
                sure.append(counted.probability[counted.defect_count])
    assert np.mean(right) >= 0.75
    assert max(sure, default=0.0) < 0.99


@pytest.mark.slow
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_a_perfect_machine_with_next_to_no_noise_is_sound_with_and_without_a_tachometer(quantity):
    """Worn ones are not. No training machine had lines of the mesh and of the output's pins alone."""
    rig = Rig(effects=[BrakeRotor(0.02, 1e4, 0.02), Noise(0.02 if quantity == "output_torque" else 0.001)])
    made = make_rig_recordings(
        8, (0, 1), rig=rig, output_turns=2.05, random_state=3, with_angle=True, speed_rpm=(100, 1500),
        load_nm=(15, 40), quantity=quantity, kernel="auto",
    )  # fmt: skip
    model = load_default_model(quantity)
    by_lines = [one.replace(angle=None, angle_is_absolute=False) for one in made]
    for some in (made, by_lines) if quantity != "input_torque" else (made,):
        answers = model.count_all(some)
        is_worn = [one.defect_count > 0 for one in some]
        assert [answer.defect_count > 0 for answer in answers] == is_worn
        assert sum(answer.refused for answer, worn in zip(answers, is_worn, strict=True) if not worn) <= 1


@pytest.mark.slow
def test_a_torque_far_from_the_loads_of_the_training_is_told_and_counted_all_the_same():
    model, one = load_default_model("input_torque"), rig_recordings("input_torque", 7, output_turns=1.1)[2]
    right, wrong = model.count(one), model.count(one.replace(torque=1000 * one.torque))
    assert right.defect_count == wrong.defect_count
    assert not [text for text in right.warnings if "mean torque" in text]
    (told,) = [text for text in wrong.warnings if "mean torque" in text]
    assert told.endswith("is far from the 0.2 to 2.67 Nm of the training: are unit and scale right?")


@pytest.mark.slow
def test_count_needs_no_model_and_says_which_it_took(tmp_path, capsys):
    write_recording(tmp_path / "disc.npz", rig_recordings("motor_current", 7, output_turns=1.1)[2])
    assert main(["count", str(tmp_path / "disc.npz"), "--quantity", "motor_current", "--json"]) == 0
    out, err = capsys.readouterr()
    (answer,) = json.loads(out)
    assert (answer["model"], answer["defect_count"]) == ("packaged, motor current", 4)
    assert "model: packaged, motor current, trained on" in err
