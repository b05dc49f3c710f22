"""The check of recordings: sizes of known detectors, and a small world from end to end."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from command import call
from scipy.special import expit, logit

import cyclofeat.gap
from cyclofeat.cli import main
from cyclofeat.gap import Condition, GapCheck, World, check_recordings
from cyclofeat.gap.check import CheckedEffect, PosteriorScore
from cyclofeat.gap.posterior.answers import detection_limit
from cyclofeat.gap.result import NextMeasurement
from cyclofeat.gap.world.world import Session
from cyclofeat.recordings import Recording
from cyclofeat.simulators import Gain, Noise, Offset
from cyclofeat.simulators.effects import TorqueMeterLowPass


def test_sizes_of_a_detector_of_known_threshold_and_slope_are_recovered():
    random = np.random.default_rng(0)
    strengths = random.uniform(-4, 2, 4000)
    found = random.random(4000) < expit(3 * (strengths + 1.5))
    assert detection_limit(strengths, found, 0.5) == pytest.approx(-1.5, abs=0.08)
    assert detection_limit(strengths, found, 0.9) == pytest.approx(-1.5 + logit(0.9) / 3, abs=0.1)


def test_some_twenty_cases_give_the_threshold_without_bias():
    random = np.random.default_rng(1)
    errors = []
    for _ in range(60):
        strengths = random.uniform(-4, 2, 22)
        errors.append(detection_limit(strengths, random.random(22) < expit(3 * (strengths + 1)), 0.5) + 1)
    assert abs(np.mean(errors)) < 0.1
    assert np.std(errors) < 0.5


def test_no_size_is_stated_beyond_those_that_were_tried():
    strengths = np.linspace(0, 1, 20)
    assert detection_limit(strengths, np.ones(20, bool), 0.9) == 0
    assert np.isnan(detection_limit(strengths, np.zeros(20, bool), 0.5))
    assert np.isnan(detection_limit(strengths, strengths > 0.97, 0.9))
    assert detection_limit(strengths, strengths > 0.02, 0.5) >= 0
    # The weaker, the better found: as if the size made no difference.
    assert np.isnan(detection_limit(strengths, strengths < 0.3, 0.5))
    assert detection_limit(strengths, strengths < 0.7, 0.5) == 0
    assert np.isnan(detection_limit(strengths[:4], np.ones(4, bool), 0.5))


def test_scores_count_sets_and_ties():
    """A gain that is named for an offset is wrong, but a look-alike; the last effect was not learned."""
    present = np.array([[1, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1], [0, 0, 0, 0]], dtype=bool)
    p = np.array([[0.9, 0.1, 0.9, 0], [0.9, 0.1, 0.1, 0], [0.1, 0.1, 0.1, 0], [0.4, 0.1, 0.1, 0]])
    p[:, 3] = np.nan
    names = ("gain", "offset", "hum", "noise")
    assert PosteriorScore.of(p, present, names) == PosteriorScore(4, 2 / 3, 2 / 4, 2 / 4, 3 / 4)
    none = PosteriorScore.of(0 * p[:, :3], present[:, :3] & False, names[:3])
    assert np.isnan([none.precision, none.recall]).all()


WORLD = World(
    effects=(Noise(), Gain(), Offset(), TorqueMeterLowPass()), most=2, sampling_rate=6400.0,
    speeds_rpm=(850.0, 950.0), wheels=((0,),), defect_counts=(0, 2), n_recordings=4,
)  # fmt: skip
AT = Condition(900.0, 22.0)


class Detector:
    """Names a gain where the mean torque is off by 4 %, and noise where it is by 1.5 %."""

    world = WORLD
    asked: list[Session]

    def __init__(self):
        self.asked = []
        self._mean = WORLD.cells.index("amplitudes: mean")

    def predict_proba(self, sessions):
        self.asked += sessions
        off = [one.values[:, self._mean].mean() / one.conditions[:, 1].mean() - 1 for one in sessions]
        gain, noise = np.abs(off) > 0.04, (np.abs(off) > 0.015) & (np.abs(off) <= 0.04)
        never = np.full(gain.size, 0.1)
        return np.column_stack([never + 0.8 * noise, never + 0.8 * gain, never, never * np.nan])


@pytest.fixture(scope="module")
def checked():
    told = []
    options = {"posterior": Detector(), "n_rigs": 40, "random_state": 0}
    return check_recordings([AT] * 4, progress=lambda *numbers: told.append(numbers), **options), told


@pytest.mark.slow
def test_a_known_threshold_is_found_through_simulated_rigs(checked):
    result, told = checked
    assert told[-1] == (40, 40)
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    gain = result.effect("gain")
    assert (gain.parameter, gain.unit) == ("factor", "1")
    assert gain.n > 5
    # 4 %, give or take what recordings differ by; below 1 as far as above, in the logarithm.
    assert gain.half_above == pytest.approx(1.04, abs=0.01)
    assert gain.half_below == pytest.approx(1 / gain.half_above)
    assert gain.half_above <= gain.most_above < 1.1
    assert gain.confused_with == ("noise",)
    offset = result.effect("offset")
    assert offset.recall == 0
    assert np.isnan([offset.half_below, offset.half_above]).all()
    named = result.wrong["noise"] + sum(round(one.n * one.recall) for one in result.effects)
    # What the posterior has not learned is not asked about.
    assert [one.effect for one in result.effects] == ["noise", "gain", "offset"]
    assert set(result.wrong) == {"noise"}
    assert result.score.precision == pytest.approx(1 - result.wrong["noise"] / named)
    with pytest.raises(KeyError, match="torque_meter_low_pass is not among the effects"):
        result.effect("torque_meter_low_pass")


@pytest.mark.slow
def test_a_check_is_of_its_seed_and_in_plain_values():
    once, again = (
        check_recordings([AT] * 2, posterior=Detector(), n_rigs=6, random_state=7) for _ in range(2)
    )
    plain = once.to_dict()
    assert plain | {"seconds": 0} == again.to_dict() | {"seconds": 0}
    assert plain["conditions"] == [{"speed_rpm": 900.0, "load_nm": 22.0, "direction": 1}]
    assert (plain["recordings"], plain["rigs"]) == (2, 6)
    assert plain["effects"][2]["half_above"] is None
    card = once._repr_html_()
    for part in ("Check: ", "simulated rigs", "found in less than half"):
        assert part in card
    frame = once.to_frame()
    assert list(frame["effect"]) == ["noise", "gain", "offset"]


@pytest.mark.slow
def test_as_much_is_known_as_of_the_recordings():
    torque = np.random.default_rng(0).normal(22, 0.1, 7_000)
    made = [Recording(torque, 6400, speed_rpm=900, load_nm=22) for _ in range(4)]
    for recordings, counts in ((made, False), ([AT] * 4, True)):
        posterior = Detector()
        check_recordings(recordings, posterior=posterior, n_rigs=2, random_state=0)
        assert all((one.counts is not None) == counts for one in posterior.asked)
        assert all(one.speeds_rpm is None for one in posterior.asked)
    # Before anything is simulated: conditions that it does not know fail at once.
    assert not posterior.asked[0].values.any()
    np.testing.assert_array_equal(posterior.asked[0].counts, [0, 2, 0, 2])


def test_what_cannot_be_checked():
    for recordings, n_rigs, error, message in (
        ([], 2, ValueError, "recordings must hold at least one"),
        ([AT, 3], 2, TypeError, "recordings"),
        ([AT], 0, ValueError, "n_rigs"),
    ):
        with pytest.raises(error, match=message):
            check_recordings(recordings, posterior=Detector(), n_rigs=n_rigs, random_state=0)


# The command

ROWS = (
    CheckedEffect("clipping", 9, 0.0, "limit_nm", "Nm", *[np.nan] * 4, ("load_drift",)),
    CheckedEffect("gain", 20, 0.5, "factor", "1", 0.96, 1.04, 0.92, 1.08),
    CheckedEffect("torque_meter_low_pass", 20, 0.6, "cutoff_hz", "Hz", 300.0, np.nan, np.nan, np.nan),
)


@pytest.fixture
def asked(monkeypatch):
    """What the command hands over, without any simulation."""
    given = {}
    score = PosteriorScore(40, 0.9, 0.5, 0.625, 0.75)
    nexts = (NextMeasurement("recordings at 10 Nm"),)

    def check(recordings, **others):
        given.update(recordings=recordings, **others)
        return GapCheck(
            conditions=(AT,) * 12, effects=ROWS, score=score, wrong={"hum": 3}, next_measurements=nexts,
            seconds=1.0,
        )  # fmt: skip

    posterior = SimpleNamespace(world=World(), names_=("hum",))
    monkeypatch.setattr(cyclofeat.gap, "check_recordings", check)
    monkeypatch.setattr(cyclofeat.gap, "load_posterior", lambda *_: posterior)
    return given


def test_planned_recordings_are_checked_and_the_answer_is_readable(asked, capsys):
    assert main(["gap", "--check", "--recordings", "6", "--rigs", "40", "--seed", "3", "--jobs", "1"]) == 0
    assert asked["recordings"] == [Condition(525.0, 20.0)] * 6
    assert (asked["n_rigs"], asked["random_state"], asked["n_jobs"]) == (40, 3, 1)
    assert capsys.readouterr().out.splitlines() == [
        "Check: 50% of the effects found",
        "  recordings: 12 at 900 RPM, 22 Nm",
        "  simulated rigs: 40",
        "  sets named exactly: 62%",
        "  the same but for look-alikes: 75%",
        "  names that are right: 90%",
        "  found in less than half: clipping",
        "  would help: recordings at 10 Nm",
        "  torque_meter_low_pass: found in 60% of 20; in half with cutoff_hz below 300 Hz",
        "  gain: found in 50% of 20; in half with factor below 0.96 or above 1.04, in 9 of 10 below 0.92 or "
        "above 1.08",
        "  clipping: found in 0% of 9; no limit_nm is found in half; taken for load_drift",
        "  named although absent: hum (3)",
    ]
    assert json.loads(call(capsys, "gap", "--check", "--json")[0])["format"] == "cyclofeat gap check 1"


def test_options_without_effect_on_a_check_are_refused(asked, tmp_path, capsys):
    for arguments, message in (
        (["--check", "--hold-out", "0.4"], "--hold-out has no effect with --check"),
        (["--check", "--cache", str(tmp_path)], "--cache has no effect with --check"),
        (["--check", "--speed", "500"], "--speed has no effect without MEASURED"),
        (["--check", str(tmp_path), "--recordings", "6"], "--recordings has no effect with MEASURED"),
        (["--check", "--recordings", "0"], "--recordings: must be a whole number of at least 1, got '0'"),
        (["--rigs", "9", str(tmp_path)], "--rigs has no effect without --check"),
        (["--check", "--prepare", str(tmp_path / "p.npz")], "--check has no effect with --prepare"),
    ):
        assert message in call(capsys, "gap", *arguments, code=2)[1]
    assert not asked
