"""``cyclofeat plan``: the table that ships, and what is read from it."""

import json
from itertools import pairwise

import pytest
from scipy.stats import betabinom

from cyclofeat.cli import main
from cyclofeat.counting import Trial, detection_table, plan_recording


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
    plan = plan_recording(1, **({"confidence": 0.95} | question), input_speed_hz=10.0, trials=made_up)
    assert plan.turns == turns
    assert plan.seconds == (None if turns is None else pytest.approx(1.5 * turns))
    assert (plan.probability >= plan.confidence) == (turns is not None)


def test_what_helps_where_no_recording_is_long_enough(made_up):
    plan = plan_recording(0, noise_nm=2.0, depth=0.3, confidence=0.8, trials=made_up)
    assert (plan.turns, plan.largest_noise_nm) == (None, 0.5)  # 19/22 there
    plan = plan_recording(0, noise_nm=2.0, depth=0.3, confidence=0.9, trials=made_up)
    assert plan.largest_noise_nm is None


def test_the_longest_recording_is_named_by_its_length(capsys):
    question = ["plan", "--worn-count", "4", "--noise", "8", "--depth", "0.1", "--confidence", "0.9"]
    assert main([*question, "--speed", "250"]) == 0
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first.endswith("the table's longest recording, 4 output turns (14.4 s), is not enough for 0.9")
    most = plan_recording(4, noise_nm=8.0, depth=0.1, confidence=0.9).largest_noise_nm
    assert second == f"  it is enough at {most:g} Nm noise or less"
    assert main([*question, "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)
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


def told_right(**fixed):
    """Share of assemblies told right in all trials with these values."""
    chosen = [t for t in detection_table() if all(getattr(t, k) == v for k, v in fixed.items())]
    return sum(t.right for t in chosen) / sum(t.assemblies for t in chosen)


@pytest.mark.parametrize("depth", sorted({t.depth for t in detection_table()}))
def test_more_noise_is_worse_at_every_depth(depth):
    # Not so where the same assemblies, or the same noise, stand in training and test: noise then helps.
    noises = sorted({t.noise_nm for t in detection_table()})
    shares = [told_right(depth=depth, noise_nm=noise) for noise in noises]
    assert shares[-1] == min(shares) < shares[0]
    # neighbouring noises may change places by chance: 280 assemblies, three lengths
    assert all(worse < better + 0.05 for better, worse in pairwise(shares))


def test_deeper_wear_and_longer_recordings_are_better_on_the_whole():
    for name in ("depth", "turns"):
        values = sorted({getattr(t, name) for t in detection_table()})
        assert told_right(**{name: values[-1]}) > told_right(**{name: values[0]}), name


def test_command_says_how_long(capsys):
    assert main(["plan", "--worn-count", "3", "--noise", "0.2", "--confidence", "0.9"]) == 0
    text = capsys.readouterr().out
    assert text.startswith(
        "to tell 3 from 4 worn lobes at 0.2 Nm noise, depth 1: record 1 output turn (1.8 s)"
    )
    assert "simulated" in text
    assert main(["plan", "--worn-count", "3", "--noise", "0.2", "--confidence", "0.9", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == plan_recording(3, noise_nm=0.2, confidence=0.9).to_dict()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--worn-count", "7", "--noise", "1"],
            "--worn-count must lie between 0 and 6, the table's largest n, got 7",
        ),
        (["--worn-count", "3", "--noise", "99"], "--noise must be at most"),
        (["--worn-count", "3", "--noise", "-1"], "--noise must be positive and finite, got -1.0"),
        (["--worn-count", "3", "--noise", "1", "--depth", "0.01"], "depth must lie between 0.1"),
        (
            ["--worn-count", "3", "--noise", "1", "--confidence", "1"],
            "confidence must lie above 0.5 (guessing)",
        ),
        (
            ["--worn-count", "3", "--noise", "1", "--speed", "0"],
            "--speed must be positive (RPM of the input shaft), got 0",
        ),
    ],
)
def test_bad_questions_get_one_line(capsys, arguments, message):
    assert main(["plan", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_what_is_no_number_is_named():
    with pytest.raises(TypeError, match="worn must be a whole number, got 2.5"):
        plan_recording(2.5, noise_nm=1.0)
    with pytest.raises(TypeError, match="noise_nm must be a number, got '1'"):
        plan_recording(2, noise_nm="1")
