"""What spoils a count is measured against records spoilt by a known share."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from memory import peak_bytes

from cyclofeat.datasets import describe
from cyclofeat.recordings import Recording
from cyclofeat.signal.faults import mark_dropouts

RATE = 25_600.0
N = 102_400  # 4 s


def geared(speed_hz=500 / 60, noise=0.05, n=N, seed=3):
    """Torque with lobe lines: a narrow bump per lobe, each lobe with its own height."""
    random = np.random.default_rng(seed)
    phase = np.arange(n) / RATE * speed_hz * 16 / 15  # turns of the lobe pattern
    slots = np.floor(phase * 15).astype(int) % 15
    bump = np.exp(-(((phase * 15) % 1 - 0.5) ** 2) / 0.01)
    return 22 + random.normal(1, 0.3, size=15)[slots] * bump + noise * random.normal(size=n)


def warned(found, words):
    return any(words in warning for warning in found["warnings"])


def test_a_good_record_has_nothing_to_warn_of_but_the_missing_angle():
    found = describe(Recording(geared(), RATE, speed_rpm=500, assembly="A"))
    json.dumps(found, allow_nan=False)
    assert found["clipped_share"] == found["dropout_share"] == 0
    assert found["warnings"] == ["no angle: positions of lobes will be relative"]


@pytest.mark.parametrize("level", [0.5, 0.9, 0.99])
@pytest.mark.parametrize("bits", [None, 0.01])
def test_the_clipped_share_is_the_share_that_was_clipped(level, bits):
    torque = geared(noise=0.2)
    if bits:
        torque = np.round(torque / bits) * bits
    limit = np.quantile(torque, level)
    found = describe(Recording(np.minimum(torque, limit), RATE, speed_rpm=500))
    assert found["clipped_share"] == pytest.approx(np.mean(torque >= limit), rel=1e-12)
    assert warned(found, "clipped")


@pytest.mark.parametrize("step", [1e-6, 0.01, 0.1])
def test_quantised_records_are_neither_clipped_nor_dropped(step):
    for torque in (geared(), 22 + np.sin(2 * np.pi * 133 * np.arange(N) / RATE)):
        found = describe(Recording(np.round(torque / step) * step, RATE, speed_rpm=500))
        assert found["clipped_share"] == 0
        assert found["dropout_share"] == 0


@pytest.mark.parametrize("kind", ["zero", "held"])
@pytest.mark.parametrize("length", [20, 300])
def test_the_dropout_share_is_the_share_that_was_dropped(kind, length):
    torque = geared(noise=0.2)
    dropped = np.zeros(N, dtype=bool)
    for start in np.random.default_rng(4).choice(N // 1_000 - 1, size=15, replace=False) * 1_000 + 500:
        dropped[start : start + length] = True
        torque[start : start + length] = 0 if kind == "zero" else torque[start - 1]
    found = describe(Recording(torque, RATE, speed_rpm=500))
    assert found["dropout_share"] == pytest.approx(dropped.mean(), rel=0.06)  # a held run holds one more
    assert found["clipped_share"] == 0
    assert warned(found, "dropouts")
    spans = np.flatnonzero(np.diff(dropped.astype(int))).reshape(-1, 2) / RATE  # from one sample before
    found = describe(Recording(torque, RATE, speed_rpm=500).with_bad_spans(spans + np.array([0, 2 / RATE])))
    assert found["dropout_share"] == 0


@pytest.mark.parametrize("share", [0.96, 0.99, 1.0, 1.013, 1.04])
def test_the_speed_by_lobe_lines(share):
    found = describe(Recording(geared(share * 500 / 60), RATE, speed_rpm=500))
    assert found["speed_from"] == "lobe lines"
    assert found["speed_measured_rpm"] == pytest.approx(share * 500, rel=1e-3)
    assert found["speed_deviation"] == pytest.approx(share - 1, abs=1e-3)
    assert warned(found, "off the nominal") == (abs(share - 1) > 0.015)
    assert found["output_turns"] == pytest.approx(4 * share * 500 / 60 / 15, rel=1e-3)


@pytest.mark.parametrize("by", ["torque", "angle"])
def test_a_run_up_is_named_with_the_time_to_leave_out(by):
    course = np.minimum(1.0, np.arange(N) / (0.5 * RATE))
    torque = geared() * (course if by == "torque" else 1)
    angle = None if by == "torque" else 2 * np.pi * 500 / 60 * np.cumsum(course + 1e-6) / RATE
    recording = Recording(torque, RATE, angle=angle, speed_rpm=500)
    found = describe(recording)
    assert 0.5 <= found["run_up_s"] <= 0.7
    assert warned(found, f"run-up at the start: leave it out with --skip {found['run_up_s']:g}")
    assert describe(recording.crop(found["run_up_s"]))["run_up_s"] is None


def test_other_changes_of_the_torque_are_no_run_up():
    shares = np.arange(N) / N
    levels = [1 + 0.15 * shares, 1 + 0.5 * (shares > 0.6), 1 + 0.5 * np.sin(20 * shares), 0 * shares]
    for level in levels:
        recording = Recording(geared() - 22 + 22 * level, RATE, speed_rpm=500)
        assert describe(recording)["run_up_s"] is None


@pytest.mark.slow
def test_records_without_lobe_lines_have_no_speed():
    """No warning either: a healthy disc has none."""
    for seed in range(40):
        noise = 22 + np.random.default_rng(seed).normal(size=N // 2)
        found = describe(Recording(noise, RATE, speed_rpm=500))
        assert found["speed_measured_rpm"] is None
        assert found["speed_from"] is None
        assert not warned(found, "no lobe lines")


def test_the_angle_tells_the_speed_without_a_nominal_one():
    angle = 2 * np.pi * 7.5 * np.arange(N) / RATE
    found = describe(Recording(geared(7.5), RATE, angle=angle))
    assert found["speed_from"] == "angle"
    assert found["speed_measured_rpm"] == pytest.approx(450)
    assert found["output_turns"] == pytest.approx(2)
    disc = Recording(geared(7.5), RATE, angle=angle / 15, angle_of="disc")
    assert describe(disc)["speed_measured_rpm"] == pytest.approx(450)


@pytest.mark.slow
def test_what_else_would_spoil_a_count():
    assert describe(Recording(np.full(9, 3.5), RATE))["warnings"] == [
        "the record is constant (3.5 Nm): sensor dead, not connected, or at the end of its range?"
    ]
    short = describe(Recording(geared(n=30_000), RATE, speed_rpm=500))
    assert warned(short, "0.651 output turns, a count needs 0.98")
    unknown = describe(Recording(np.random.default_rng(0).normal(22, 1, N), RATE))
    assert warned(unknown, "no speed is stated")
    searched = describe(Recording(geared(), RATE))
    assert searched["speed_measured_rpm"] == pytest.approx(500, 1e-3)
    assert searched["speed_from"] == "lobe lines"
    slow = describe(Recording(geared()[::40], RATE / 40, speed_rpm=500))
    assert warned(slow, "640 Hz are too few for all lobe lines of a count, which need 1067 Hz")
    meta = {"unit_assumed": True, "angle_unit_assumed": True, "time_jitter": 0.2}
    assumed = describe(Recording(geared(), RATE, speed_rpm=500, meta=meta))
    for words in ("Nm assumed", "rad assumed", "jitter by up to 0.2 samples"):
        assert warned(assumed, words)


def runs(values):
    """Slices of equal values."""
    edges = [0, *(np.flatnonzero(np.diff(values)) + 1), values.size]
    return [slice(*ends) for ends in itertools.pairwise(edges)]


@pytest.mark.parametrize("seed", range(12))
def test_held_lost_and_bridged_samples_against_brute_force(seed):
    random = np.random.default_rng(seed)
    torque = random.normal(size=400)
    if seed % 3 == 0:
        torque = torque.round(1)
    torque[40:75] = torque[40]
    torque[120 : 121 + seed] = 0
    torque[200:240] = np.linspace(torque[200], 9, 40)
    torque[-1], torque[300:303] = 0, (50, 0, 50)
    expected = np.zeros(torque.size, dtype=bool)
    step = np.median(np.abs(np.diff(torque)))
    bend = np.r_[1, np.abs(np.diff(torque, 2)), 1] <= 1e-9 * torque.std()
    bend &= np.r_[np.diff(torque), 0] != 0
    for found, straight in ((runs(torque), False), (runs(np.where(bend, 0, np.arange(1, 401))), True)):
        limit = max(10, 5 * np.quantile([one.stop - one.start for one in found], 0.99))
        for one in found:
            value, long = torque[one.start], one.stop - one.start >= limit
            if straight:
                expected[one] |= long and bend[one.start]
                continue
            beside = [abs(torque[at]) for at in (one.start - 1, one.stop) if 0 <= at < torque.size]
            expected[one] |= long and torque.min() < value < torque.max()
            expected[one] |= value == 0 and min(beside) > 10 * step
    assert expected[301]
    np.testing.assert_array_equal(mark_dropouts(torque), expected)


@pytest.mark.slow
@pytest.mark.parametrize("speed_rpm", [None, 500])
def test_a_long_recording_is_described_with_little_memory(speed_rpm):
    torque = np.random.default_rng(0).normal(size=4_000_000)
    torque.flags.writeable = False
    recording = Recording(torque, 25_600, speed_rpm=speed_rpm)
    describe(recording)  # its imports
    with peak_bytes() as peak:
        describe(recording)
    assert peak[0] < 2.8 * torque.nbytes
