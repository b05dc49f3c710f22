"""``cyclofeat plan``: the answers of the table that ships, and which depth of wear shows."""

import json

import numpy as np
import pytest
from command import call
from scipy.stats import betabinom

from cyclofeat.counting import MeasurementPlan, plan_measurement
from cyclofeat.counting.model.radial_wear import lobe_lines_nm
from cyclofeat.counting.planning import (
    _NOISE_IN_LINE,
    Trial,
    detection_table,
    lines_of_twins,
    plan_turns,
    right_decisions,
)
from cyclofeat.recordings.windower import SAMPLES_PER_TURN
from cyclofeat.simulators import Rig


@pytest.fixture
def made_up():
    """A table small enough to answer by hand: 20 assemblies per trial."""
    right = {  # (depth, noise, turns): told right
        (1.0, 0.5, 1): 20, (1.0, 0.5, 2): 20,
        (1.0, 2.0, 1): 16, (1.0, 2.0, 2): 20,
        (0.3, 0.5, 1): 14, (0.3, 0.5, 2): 18,
        (0.3, 2.0, 1): 10, (0.3, 2.0, 2): 12,
    }  # fmt: skip
    return [Trial("R1", *key, worn, 20, n) for key, n in right.items() for worn in (0, 1)]


@pytest.mark.parametrize(
    ("question", "turns"),
    [
        ({"noise_nm": 0.5}, 1),
        ({"noise_nm": 2.0}, 2),  # 17/22 with one turn, 21/22 with two
        ({"noise_nm": 0.6}, 2),  # between two noises the larger answers
        ({"noise_nm": 0.5, "depth": 0.9, "confidence": 0.8}, 2),  # between two depths the shallower does
        ({"noise_nm": 0.5, "depth": 0.3}, None),
        ({"noise_nm": 0.5, "confidence": 0.99}, None),  # 20 of 20 do not show it
    ],
)
def test_answers_are_those_of_the_table_by_hand(made_up, question, turns):
    plan = plan_turns(made_up, 1, **({"confidence": 0.95, "depth": 1.0} | question), speed_rpm=600.0)
    assert plan.turns == turns
    assert plan.seconds == (None if turns is None else pytest.approx(1.5 * turns))
    assert (plan.probability >= plan.confidence) == (turns is not None)


def test_what_helps_where_no_recording_is_long_enough(made_up):
    plan = plan_turns(made_up, 0, 2.0, 0.8, 0.3, 500.0)
    assert (plan.turns, plan.largest_noise_nm) == (None, 0.5)  # 19/22 there
    plan = plan_turns(made_up, 0, 2.0, 0.9, 0.3, 500.0)
    assert plan.largest_noise_nm is None


def test_the_longest_recording_is_named_by_its_length(capsys):
    question = ["plan", "--worn-count", "4", "--noise", "8", "--depth", "0.1", "--confidence", "0.9"]
    first, second, *_ = call(capsys, *question, "--speed", "250")[0].splitlines()
    assert first.endswith("the table's longest recording, 4 output turns (14.4 s), is not enough for 0.9")
    most = plan_measurement(4, noise_nm=8.0, depth=0.1, confidence=0.9).largest_noise_nm
    assert second == f"  it is enough at {most:g} Nm noise or less"
    plan = json.loads(call(capsys, *question, "--json")[0])
    assert (plan["longest_turns"], plan["longest_seconds"]) == (4, 7.2)


@pytest.mark.parametrize(("right", "n"), [(0, 5), (7, 20), (20, 20)])
def test_probability_is_the_chance_of_the_next_assembly(right, n):
    # with all shares of successes equally probable beforehand: Laplace
    trial = Trial("R1", 1.0, 0.5, 1, 0, n, right)
    assert trial.probability == pytest.approx(betabinom(1, right + 1, n - right + 1).mean())


def test_the_table_that_ships_is_whole():
    table = detection_table()
    keys = {(t.depth, t.noise_nm, t.turns, t.worn) for t in table}
    axes = [sorted({key[k] for key in keys}) for k in range(4)]
    assert len(keys) == len(table) == len(axes[0]) * len(axes[1]) * len(axes[2]) * len(axes[3])
    assert axes[0][-1] == 1
    assert axes[3] == list(range(7))
    assert all(0 <= t.right <= t.assemblies for t in table)


def test_command_says_how_long(capsys):
    question = ["plan", "--worn-count", "3", "--noise", "0.2", "--confidence", "0.9"]
    text, plan = call(capsys, *question)[0], json.loads(call(capsys, *question, "--json")[0])
    shortest = "record 1 output turn (1.8 s)"
    assert text.startswith(f"to tell 3 from 4 worn lobes at 0.2 Nm noise, depth 1: {shortest}")
    assert "simulated" in text
    assert plan == plan_measurement(3, noise_nm=0.2, confidence=0.9).to_dict()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("7 --noise 1", "--worn-count must lie between 0 and 6, the table's largest n, got 7"),
        ("3 --noise 99", "--noise must be at most"),
        ("3 --noise -1", "--noise: must be a positive, finite number, got '-1'"),
        ("3 --noise 1 --depth 0.01", "depth must lie between 0.1"),
        ("3 --noise 1 --confidence 1", "confidence must lie above 0.5 (guessing)"),
        ("3 --noise 1 --speed 0", "--speed: must be a positive, finite number, got '0'"),
    ],
)
def test_bad_questions_get_one_line(capsys, arguments, message):
    assert message in call(capsys, "plan", "--worn-count", *arguments.split(), code=2)[1]


# Which wear shows.

DEPTHS, SEED = (12, 25), 3


def best_share(healthy, worn):
    """Share of right decisions at the best threshold between two samples of numbers."""
    thresholds = np.quantile(np.r_[healthy, worn], np.linspace(0, 1, 201))
    return max((np.mean(healthy <= t) + np.mean(worn > t)) / 2 for t in thresholds)


@pytest.mark.parametrize("noncentral", [0.0, 10.0, 60.0])
def test_right_decisions_are_those_of_drawn_numbers(noncentral):
    random = np.random.default_rng(0)
    healthy, worn = (random.noncentral_chisquare(100, shift, 20_000) for shift in (0.0, noncentral))
    (share,) = right_decisions(np.array([noncentral]), 100)
    assert share == pytest.approx(best_share(healthy, worn), abs=0.01)


def test_noise_in_a_line_has_the_power_of_the_formula():
    n = 15 * SAMPLES_PER_TURN
    noise = np.random.default_rng(1).normal(0, 0.3, (60, n))
    power = (np.abs(lobe_lines_nm(noise, 15).lines[:, 2:]) ** 2).mean()
    assert power == pytest.approx(_NOISE_IN_LINE * 0.3**2 / n, rel=0.1)


@pytest.fixture(scope="module")
def plan():
    return plan_measurement(
        2, noise_nm=0.2, confidence=0.75, output_turns=1, depths_um=DEPTHS, n_assemblies=6, random_state=SEED
    )


@pytest.fixture(scope="module")
def lines():
    """Lines of the plan's healthy assemblies, and of others: healthy, and with either wear."""
    options = {"speed_rpm": 500.0, "load_nm": 22.0, "n_assemblies": 6}
    wear = [(SEED, 0, 1), (SEED + 1, 0, 1), *((SEED + 1, 2, depth) for depth in DEPTHS)]
    return [lines_of_twins(Rig.r1(), 1, *worn, random_state=seed, **options) for seed, *worn in wear]


@pytest.mark.slow
@pytest.mark.parametrize("point", [0, 1])
def test_the_formula_agrees_with_decisions_about_other_assemblies(plan, lines, point):
    """Simulated assemblies of another seed, with noise, told by the power in their lobe lines."""
    known, healthy, *worn = lines
    noise_power = _NOISE_IN_LINE * 0.2**2 / (1.8 * 25_600)
    power = (np.abs(known) ** 2).mean(axis=0) + noise_power
    random = np.random.default_rng(point)

    def detected(lines):
        lines = np.repeat(lines, 200, axis=0)
        noise = random.normal(size=(2, *lines.shape)) * np.sqrt(noise_power / 2)
        return (np.abs(lines + noise[0] + 1j * noise[1]) ** 2 / power).sum(axis=1)

    share = best_share(detected(healthy), detected(worn[point]))
    assert plan.probability[point] == pytest.approx(share, abs=0.12)


@pytest.mark.slow
def test_deeper_wear_and_the_least_depth(plan):
    assert 0.5 < plan.probability[0] < plan.probability[1] <= 1
    assert plan.least_um is None or plan.depths_um[0] <= plan.least_um <= plan.depths_um[1]
    assert (plan.seconds, plan.speed_rpm, plan.load_nm) == (1.8, 500.0, 22.0)
    assert json.loads(json.dumps(plan.to_dict()))["depths_um"] == list(DEPTHS)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"worn": 0}, "worn must be at least 1"),
        ({"noise_nm": -1.0}, "noise_nm must be positive"),
        ({"confidence": 0.5}, "confidence must lie above 0.5"),
        ({"output_turns": 0}, "output_turns must be at least 1"),
        ({"n_assemblies": 1}, "n_assemblies must be at least 2"),
        ({"depths_um": (50, 20)}, "depths_um must be at least two increasing depths"),
        ({"speed_rpm": 0}, "speed_rpm must be positive"),
        ({"rig": "R9"}, "must be one of"),
    ],
)
def test_bad_simulations_are_refused_before_they_begin(changes, message):
    with pytest.raises(ValueError, match=message):
        plan_measurement(**{"worn": 2, "noise_nm": 0.2, "depths_um": DEPTHS} | changes)


def test_the_command_says_which_depth_shows(capsys, monkeypatch):
    asked = {}

    def answer(worn, **options):
        asked.update(options, worn=worn)
        return MeasurementPlan(
            worn=worn, confidence=0.95, noise_nm=0.2, rig="R2", speed_rpm=600.0, load_nm=10.0, turns=3,
            seconds=4.5, depths_um=(20.0, 50.0), probability=(0.7, 0.97), least_um=asked["least"],
            assemblies=8,
        )  # fmt: skip

    monkeypatch.setattr("cyclofeat.counting.plan_measurement", answer)
    question = ["plan", "--wear", "--worn-count", "2", "--noise", "0.2", "--speed", "600", "--load", "10"]
    asked["least"] = 45.2
    text = call(capsys, *question, "--turns", "3", "--rig", "r2")[0]
    assert text.startswith("radial wear shows from 45.2 um on with 0.95, 2 worn lobes or none: ")
    assert "20 um: 0.70, 50 um: 0.97" in text
    assert asked["rig"].name == "R2"
    assert (asked["speed_rpm"], asked["load_nm"], asked["output_turns"]) == (600.0, 10.0, 3)
    asked["least"] = None
    assert json.loads(call(capsys, *question, "--json")[0])["least_um"] is None
    assert call(capsys, *question)[0].startswith("no depth up to 50 um shows with 0.95")
