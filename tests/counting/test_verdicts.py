"""Verdicts: each fault injected into torque that has none, and clean recordings without one."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from cyclofeat import Recording
from cyclofeat.counting.model._verdicts import (
    disagreement_reason,
    most_frequent,
    outvoted_reason,
    window_faults,
)
from cyclofeat.recordings.windower import ends_by_angle, lobe_windower

RATE, SPEED, TURN = 25_600.0, 500 / 60, 46_080


def geared(seed=0, noise=0.1, turns=1, ratio=None, n_lobes=15):
    """A pulse of its own height for each lobe, drift, noise; ``ratio`` is the course of the speed."""
    random = np.random.default_rng(seed)
    speed = np.ones(turns * TURN) if ratio is None else ratio
    lobes = (n_lobes + 1) * SPEED * np.cumsum(speed) / RATE + n_lobes * random.random()
    heights = random.normal(size=n_lobes)
    pulses = heights[np.floor(lobes).astype(int) % n_lobes] * np.exp(-(((lobes % 1 - 0.5) / 0.15) ** 2))
    drift = 2 * np.sin(2 * np.pi * 0.4 * np.arange(lobes.size) / RATE)
    return 22 + pulses + drift + random.normal(0, noise, lobes.size)


def faults(torque, angle=None, speed_rpm=None, n_lobes=15):
    """What spoils windows over the angle of a tachometer, or of a shaft that turns steadily."""
    recording = Recording(torque, RATE, angle=angle, speed_rpm=speed_rpm, n_lobes=n_lobes)
    turned = 2 * np.pi * SPEED * np.arange(torque.size) / RATE if angle is None else angle
    windows = lobe_windower(n_lobes).windows([recording], [turned])
    ends = ends_by_angle(windows.start_angle, windows.X.shape[1], windows.sampling_rate, turned, RATE)
    return window_faults(recording, windows, ends, n_lobes)


@pytest.mark.parametrize("noise", [0.05, 0.5])
def test_clean_windows_have_no_fault(noise):
    assert faults(geared(1, noise, turns=3)) == ("", "", "")


def test_an_angle_that_turns_otherwise_than_stated():
    angle = 2 * np.pi * SPEED * np.arange(TURN) / RATE
    assert faults(geared(), angle) == faults(geared(), angle, speed_rpm=520) == ("",)
    (reason,) = faults(geared(), angle * 16 / 15, speed_rpm=500)
    assert reason == "its angle turns at 533.3 RPM, but 500 RPM are stated"


def put(torque, rows, values):
    """The torque with other values in some rows."""
    changed = torque.copy()
    changed[rows] = values
    return changed


def noise(deviation, n=TURN - 30_000):
    return np.random.default_rng(1).normal(0, deviation, n)


AT, LOST, LATE = np.arange(TURN), slice(10_000, 12_000), slice(30_000, None)
INJECTED = {
    "held": (
        lambda t: put(t, LOST, t[10_000]),
        "4% of the samples are lost: they repeat a value or lie on straight lines",
    ),
    "bridged": (
        lambda t: put(t, LOST, np.linspace(t[10_000], t[12_000], 2000)),
        "4% of the samples are lost",
    ),
    "lost in blocks": (lambda t: np.where(AT % 5000 < 1000, 0, t), "2[012]% of the samples are lost"),
    "dead": (lambda t: put(t, LATE, t[30_000] + noise(0.1)), "the lobes pause within the window"),
    "clipped": (
        lambda t: np.minimum(t, np.quantile(t, 0.56)),
        r"45% of the samples are clipped at \d+.* or \d+",
    ),
    "coarse": (lambda t: np.round(t / 2) * 2, "steps of 2 are too coarse for a torque that deviates by"),
    "interpolated": (
        lambda t: np.interp(AT, AT[::40], t[::40]),
        r"the torque changes only 6\d\d times a second, too coarse for lobe lines up to 399 Hz",
    ),
    "filtered": (
        lambda t: 22 + sosfilt(butter(4, 50, fs=RATE, output="sos"), t - 22),
        "a low-pass filter has removed what lobe lines up to 399 Hz need",
    ),
    "stepping": (
        lambda t: put(t, LATE, t[LATE] + 4),
        r"the torque jumps, first 1\.17 s after the window's start",
    ),
    "spiky": (lambda t: put(t, slice(500, None, 2000), t[500::2000] + 5), "the torque has 23 spikes"),
    "louder": (lambda t: put(t, LATE, t[LATE] + noise(0.3)), r"the noise changes by a factor of \d"),
    "noisy": (lambda t: t + noise(4, TURN), r"noise of 4 hides worn lobes: it is 18% of the mean"),
}


@pytest.mark.parametrize(("inject", "expected"), INJECTED.values(), ids=[*INJECTED])
def test_each_fault_of_the_samples_has_its_reason(inject, expected):
    (reason,) = faults(inject(geared()))
    assert re.match(expected, reason), reason


def test_the_fault_is_that_of_its_window():
    torque = geared(turns=3)
    first, second, third = faults(put(torque, slice(TURN + 5000, TURN + 9000), torque[TURN + 5000]))
    assert (first, third) == ("", "")
    assert "9% of the samples are lost" in second


@pytest.mark.parametrize(("share", "unsteady"), [(0.005, False), (0.05, True)])
def test_a_wandering_speed(share, unsteady):
    ratio = 1 + share * np.sin(np.linspace(0, 2 * np.pi, TURN))
    (reason,) = faults(geared(2, 0.05, ratio=ratio))
    assert bool(re.fullmatch(r"the speed changes by \d.\d% within the window", reason)) == unsteady


@pytest.mark.parametrize("start", [0.2, 0.6])
@pytest.mark.parametrize("speed_rpm", [None, 500])
def test_a_run_up_is_no_fault_of_the_angle(start, speed_rpm):
    """Over 1.5 s, at most a half of the record."""
    ratio = np.minimum(1.0, start + (1 - start) * np.arange(4 * TURN) / (1.5 * RATE))
    angle = 2 * np.pi * SPEED * np.cumsum(ratio) / RATE
    torque = geared(2, 0.05, turns=4, ratio=ratio)
    assert set(faults(torque, angle, speed_rpm)) == {""}
    angle[TURN // 2 :] += 2 * np.pi
    first, *_ = faults(torque, angle, speed_rpm)
    assert first == "the angle jumps or stands still within the window"


@pytest.mark.parametrize("braking_s", [0.0, 0.3])
def test_an_angle_that_stands_still(braking_s):
    """At once or after braking: the angle still rises by what a recording needs."""
    ratio = np.interp(
        np.arange(2 * TURN), RATE * (0.5 + np.r_[0, braking_s, [braking_s + 0.1] * 2]), [1, 0, 0, 1]
    )
    angle = 2 * np.pi * SPEED * np.cumsum(ratio + 1e-9) / RATE
    (reason,) = faults(geared(turns=2), angle, speed_rpm=500)
    assert reason == "the angle jumps or stands still within the window"


def test_the_angle_says_how_the_speed_changes_unless_it_jumps():
    ratio = 1 + 0.05 * np.sin(np.linspace(0, 2 * np.pi, TURN))
    angle, torque = 2 * np.pi * SPEED * np.cumsum(ratio) / RATE, geared(2, 0.05, ratio=ratio)
    assert faults(torque, angle) == ("",)
    angle[20_000:] += 2 * np.pi
    assert faults(torque, angle) == ("the angle jumps or stands still within the window",)


@pytest.mark.parametrize(("jitter_deg", "is_fault"), [(2, False), (20, True)])
def test_pulses_of_a_tachometer_that_jitter(jitter_deg, is_fault):
    """One pulse a turn, between which the angle is interpolated."""
    random = np.random.default_rng(3)
    turns, pulses = SPEED * np.arange(3 * TURN) / RATE, np.arange(-2, 50)
    angle = 2 * np.pi * np.interp(turns, pulses + jitter_deg / 360 * random.normal(size=pulses.size), pulses)
    for reason in faults(geared(2, 0.05, turns=3), angle):
        assert reason.startswith("the angle jitters by") == is_fault, reason


@pytest.mark.parametrize("n_lobes", [11, 15, 21])
@pytest.mark.parametrize("scale", [0.99, 0.997, 1.0, 1.003, 1.01, "shaft"])
def test_an_angle_whose_scale_is_wrong(scale, n_lobes):
    """A tachometer with a wrong number of pulses per turn; lines at 15/16 may be those of the shaft."""
    scale = (n_lobes + 1) / n_lobes if scale == "shaft" else scale
    angle = 2 * np.pi * SPEED * scale * np.arange(3 * TURN) / RATE
    for reason in faults(geared(2, 0.05, turns=3, n_lobes=n_lobes), angle, n_lobes=n_lobes):
        turn = "slower" if scale > 1 else "faster"
        wrong = f"the lobes pass 1.0% {turn} than the angle says: is its scale right?"
        assert reason == (wrong if scale in (0.99, 1.01) else "")


SURE = {count: np.eye(4)[count] * 0.9 + 0.025 for count in range(4)}


@pytest.mark.parametrize(
    ("counts", "reasons", "said"),
    [
        ([1, 1, 1], ["", "", ""], ""),
        ([1], [""], ""),
        ([0, 0, 3, 3], ["", "", "", ""], "two discs in one recording?"),
        ([0, 3, 0, 3], ["", "", "", ""], "its windows disagree about the count"),
        # A jump may part two discs; a window whose samples are lost says nothing.
        ([0, 3], ["", "the torque jumps, first 1 s after the window's start"], "two discs in one recording?"),
        ([0, 3], ["", "20% of the samples are lost"], ""),
        # A run-up that is too slow to be seen in the first windows, but is in the last.
        ([0, 0, 3], ["", "", "the speed changes by 3% within the window"], "disagree about the count"),
        ([3, 0, 0], ["the speed changes by 30% within the window", "", ""], "disagree about the count"),
        ([0, 0, 0], ["", "", "the speed changes by 3% within the window"], ""),
    ],
)
def test_windows_that_disagree(counts, reasons, said):
    reason = disagreement_reason(np.stack([SURE[count] for count in counts]), reasons)
    assert reason.endswith(said)
    assert bool(reason) == bool(said)


@pytest.mark.parametrize(
    ("counts", "left_out", "said"),
    [
        ([1, 1, 2], [], ""),  # without a doubt about any window, their probabilities decide
        ([1, 0, 1], [1], ""),
        ([1, 0, 0], [1], "only 1 of its 3 windows have its count, 1 left out: spikes"),
        ([1, 1, 1], [1, 2], "only 1 of its 3 windows have its count, 2 left out: spikes"),
        ([1, 1], [0], "only 1 of its 2 windows have its count, 1 left out: spikes"),  # no majority
    ],
)
def test_windows_left_out_must_not_outvote_the_count(counts, left_out, said):
    """The count is 1; windows left out do not vote, but are of the number that a majority is of."""
    reasons = ["spikes" if window in left_out else "" for window in range(len(counts))]
    assert outvoted_reason(np.eye(3)[counts], reasons, reasons, 1) == said


def test_a_window_unlike_the_training_votes():
    """With the count it does not outvote the others; with another one it does."""
    reasons = ["", "outside the training data"]
    assert outvoted_reason(np.eye(3)[[1, 1]], ["", ""], reasons, 1) == ""
    said = "only 1 of its 2 windows have its count, 1 left out: outside the training data"
    assert outvoted_reason(np.eye(3)[[1, 2]], ["", ""], reasons, 1) == said


@pytest.mark.parametrize(
    ("jumps", "n", "is_refused"),
    [([2], 3, True), ([0], 3, True), ([1], 3, False), ([0, 1], 21, False), ([11], 12, False),
     ([8, 9], 10, True)],
)  # fmt: skip
def test_a_jump_with_nothing_counted_on_one_side_asks_for_nearly_all_windows(jumps, n, is_refused):
    reasons = ["the torque jumps, first 1 s after the window's start" if k in jumps else "" for k in range(n)]
    reason = outvoted_reason(np.eye(3)[[1] * n], reasons, reasons, 1)
    assert bool(reason) == is_refused
    assert not reason or "left out: the torque jumps" in reason


def test_the_most_frequent_reason_leaves_numbers_aside():
    assert most_frequent(["", "", ""]) == ""
    assert most_frequent(["spikes", "2% lost", "", "3% lost"]) == "2% lost"


def test_every_reason_is_explained_on_its_page():
    """The fixed words of each reason stand on the page that says what to do."""
    root = Path(__file__).parents[2]
    page = " ".join((root / "docs" / "howto" / "refused.rst").read_text(encoding="utf-8").split())
    model = root / "cyclofeat" / "counting" / "model"
    files = "_verdicts.py", "turning.py", "lobe_count.py"
    text = "".join((model / name).read_text(encoding="utf-8") for name in files)
    for words in (
        "of the samples are lost", "of the samples are clipped", "the torque changes only", "are too coarse",
        "a low-pass filter has removed what lobe lines", "the torque jumps", "the noise changes by a factor",
        "hides worn lobes", "the lobes pause within the window", "the speed changes",
        "the angle jumps or stands still within the window", "the angle jitters by", "its angle turns at",
        "than the angle says", "its windows have another count from some time on",
        "its windows disagree about the count", "but no worn lobe is counted",
        "windows have its count", "no lobe, mesh or shaft lines stand out within",
        "its lines could as well be those of a disc at another speed than the stated",
    ):  # fmt: skip
        assert words in text, words
        assert words in page, words
