"""Which depth of wear shows: the formula beside simulated decisions, and the command."""

import json

import numpy as np
import pytest

from cyclofeat.cli import main
from cyclofeat.counting import WearPlan, lobe_lines_nm, plan_wear
from cyclofeat.counting.planning.plan_wear import _NOISE_IN_LINE, _Twins, right_decisions
from cyclofeat.recordings.windower import SAMPLES_PER_TURN


def best_share(healthy, worn):
    """Share of right decisions at the best threshold between two samples of numbers."""
    thresholds = np.quantile(np.r_[healthy, worn], np.linspace(0, 1, 201))
    return max((np.mean(healthy <= t) + np.mean(worn > t)) / 2 for t in thresholds)


@pytest.mark.parametrize("noncentral", [0.0, 10.0, 60.0])
def test_right_decisions_are_those_of_drawn_numbers(noncentral):
    random = np.random.default_rng(0)
    healthy = random.chisquare(100, 20_000)
    worn = (
        random.noncentral_chisquare(100, noncentral, 20_000) if noncentral else random.chisquare(100, 20_000)
    )
    assert right_decisions(np.array([noncentral]), 100)[0] == pytest.approx(
        best_share(healthy, worn), abs=0.01
    )


def test_noise_in_a_line_has_the_power_of_the_formula():
    n = 15 * SAMPLES_PER_TURN
    noise = np.random.default_rng(1).normal(0, 0.3, (60, n))
    power = (np.abs(lobe_lines_nm(noise, 15).lines[:, 2:]) ** 2).mean()
    assert power == pytest.approx(_NOISE_IN_LINE * 0.3**2 / n, rel=0.1)


DEPTHS, SEED = (12, 25), 3


@pytest.fixture(scope="module")
def plan():
    return plan_wear(
        2, noise_nm=0.2, confidence=0.75, output_turns=1, depths_um=DEPTHS, n_assemblies=6, random_state=SEED
    )


@pytest.fixture(scope="module")
def lines():
    """Lines of the plan's healthy assemblies, and of others: healthy, and with either wear."""
    known, others = (_Twins("R1", None, None, 1, 6, seed, 1) for seed in (SEED, SEED + 1))
    return known.lines(0, 1), others.lines(0, 1), *(others.lines(2, depth) for depth in DEPTHS)


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


def test_deeper_wear_and_the_least_depth(plan):
    assert 0.5 < plan.probability[0] < plan.probability[1] <= 1
    assert plan.least_um is None or plan.depths_um[0] <= plan.least_um <= plan.depths_um[1]
    assert (plan.seconds, plan.speed_rpm, plan.load_nm) == (1.8, 500.0, 22.0)
    assert json.loads(json.dumps(plan.to_dict()))["depths_um"] == list(DEPTHS)
    assert plan.to_frame().to_dict("list") == {
        "depth_um": list(plan.depths_um), "probability": list(plan.probability),
    }  # fmt: skip


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
def test_bad_questions_are_refused_before_any_simulation(changes, message):
    with pytest.raises(ValueError, match=message):
        plan_wear(**{"worn": 2, "noise_nm": 0.2} | changes)


def test_the_command_says_which_depth_shows(capsys, monkeypatch):
    asked = {}

    def answer(worn, **options):
        asked.update(options, worn=worn)
        return WearPlan(
            worn, 0.95, 0.2, "R2", 600.0, 10.0, 3, 4.5, (20.0, 50.0), (0.7, 0.97), asked["least"], 8
        )

    monkeypatch.setattr("cyclofeat.counting.plan_wear", answer)
    question = ["plan", "--wear", "--worn-count", "2", "--noise", "0.2", "--speed", "600", "--load", "10"]
    asked["least"] = 45.2
    assert main([*question, "--turns", "3", "--rig", "r2"]) == 0
    text = capsys.readouterr().out
    assert text.startswith(
        "radial wear shows from 45.2 um on with 0.95, 2 worn lobes or none: 0.2 Nm noise, 600 RPM, 10 Nm, "
        "3 output turns (4.5 s)\n"
    )
    assert "20 um: 0.70, 50 um: 0.97" in text
    assert asked["rig"].name == "R2"
    assert (asked["speed_rpm"], asked["load_nm"], asked["output_turns"]) == (600.0, 10.0, 3)
    asked["least"] = None
    assert main([*question, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["least_um"] is None
    assert main(question) == 0
    assert capsys.readouterr().out.startswith("no depth up to 50 um shows with 0.95")
