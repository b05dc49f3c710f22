"""All that a file says of its sampling rate is compared; what an error advises is then accepted."""

from __future__ import annotations

import ast
import re

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from cyclofeat.datasets import describe, read_recording

TORQUE = 22 + np.sin(np.arange(600))
TIMES = np.arange(600) / 2000


def write_tdms(path, *segments):
    with TdmsWriter(path) as writer:
        for segment in segments:
            writer.write_segment([ChannelObject(*name.split("/"), *content) for name, *content in segment])


def write_csv(path, times, head="time"):
    rows = "".join(f"{time:.10g},{torque:.5f}\n" for time, torque in zip(times, TORQUE, strict=True))
    path.write_text(f"{head},torque [Nm]\n{rows}")


# Each writes a file and returns the words of its error, and what follows from each advice in it, in Hz.
STEP = {"wf_increment": 1e-3}
REFUSED = {
    "full_scale.mat": (
        lambda path: savemat(path, {"torque": TORQUE, "time": TIMES, "FS": 1000.0}),
        "variable 'FS' says 1000 Hz, time variable 'time' says 2000 Hz", [1000, 2000, 2000],
    ),
    "half.tdms": (
        lambda path: write_tdms(path, [("g/Torque", TORQUE, STEP), ("g/Time", TIMES, {"unit_string": "s"})]),
        "'wf_increment' says 1000 Hz, time channel 'g/Time' says 2000 Hz", [1000, 2000, 2000],
    ),
    "appended.tdms": (
        lambda path: write_tdms(
            path, [("g/Torque", TORQUE, STEP)], [("g/Torque", TORQUE, {"wf_increment": 5e-4})]
        ),
        "'wf_increment' of segment 1 says 1000 Hz, .* segment 2 says 2000 Hz", [1000, 2000, 1000],
    ),
    "slow.tdms": (
        lambda path: write_tdms(path, [("fast/Torque", TORQUE), ("slow/Time", TIMES[:300])]),
        "time channel 'slow/Time' has 300 times, channel 'fast/Torque' 600 samples", [25_600],
    ),
    "slow.mat": (
        lambda path: savemat(path, {"torque": TORQUE, "time": TIMES[:300]}),
        "time variable 'time' has 300 times, variable 'torque' 600 samples", [25_600],
    ),
    "ms.csv": (lambda path: write_csv(path, 1e3 * TIMES), "in s .* 2 Hz", [2000, 2e6, 25_600, 2]),
    "number.csv": (lambda path: write_csv(path, 2e3 * TIMES), "in s .* 1 Hz", [1000, 1e6, 25_600, 1]),
    "gap.csv": (
        lambda path: write_csv(path, TIMES + 0.06 * (TIMES > 0.2)), "120 samples before line 403", 2 * [2000]
    ),
    "back.csv": (lambda path: write_csv(path, np.abs(TIMES - 0.1)), "it falls by", [25_600]),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_rate_that_is_not_certain_is_refused(tmp_path, name):
    write, words, rates = REFUSED[name]
    write(tmp_path / name)
    with pytest.raises(ValueError, match=words) as caught:
        read_recording(tmp_path / name)
    chosen = [read_recording(tmp_path / name, **given).sampling_rate for given in advice(caught.value)]
    assert chosen == pytest.approx(rates)
    recording = read_recording(tmp_path / name, sampling_rate=700)
    assert recording.sampling_rate == 700
    overrides = re.search("700 Hz, overrides|in s the sampling", " ".join(describe(recording)["warnings"]))
    assert bool(overrides) == any(rate != 25_600 for rate in rates)


# Values for options that a message leaves open.
OPEN = {
    "sampling_rate": 25_600, "scale": 2, "time_unit": "ms", "channel": 1, "angle_channel": "p",
}  # fmt: skip


def advice(error):
    """Yield the options of each alternative that a message offers."""
    words = str(error).replace("(angle_channel=False leaves", "give (angle_channel=False leaves")
    words = words.replace("= must be given", "=").replace(" give one index", " give channel=")
    for alternative in re.split(
        r",? or |, |; ", re.split("[Gg]ive |: (?=channel=|angle_channel=)", words, maxsplit=1)[-1]
    ):
        given = re.findall(r"\b([a-z_]+) ?=(?: ?('[^']*'|False|[\d.e+]+))?", alternative)
        if given and all(value or name in OPEN for name, value in given):
            yield {name: ast.literal_eval(value) if value else OPEN[name] for name, value in given}


HEAD = "time [s],"
MESSAGES = {
    "rates": ("torque [Nm]", "22", {}, "no sampling rate"),
    "unit of times": ("time [years],torque", "{i},22", {}, "must be in s"),
    "two torques": (HEAD + "a [Nm],b [Nm]", "{t},22,23", {}, "several columns fit"),
    "no torque": (HEAD + "a,b", "{t},22,23", {}, "which column is the torque"),
    "a name twice": (HEAD + "a,a", "{t},22,23", {"channel": "a"}, "fits several"),
    "a current": (HEAD + "Motorstrom [A]", "{t},22", {}, "holds motor current"),
    "an input torque": (HEAD + "motor torque", "{t},22", {}, "holds input torque"),
    "volts": (HEAD + "torque [V]", "{t},22", {}, "is in 'V'"),
    "amperes": (HEAD + "torque [A]", "{t},22", {"channel": 1, "quantity": "output_torque"}, "is in 'A'"),
    "an angle": (HEAD + "torque,angle", "{t},22,{t}", {}, "does not state its unit"),
    "no angle": (HEAD + "torque,angle [rad]", "{t},22,{wild}", {}, "angle must rise"),
    "pulses": (HEAD + "torque,p", "{t},22,{pulse}", {"pulses_per_turn": 1}, "which column holds the pulses"),
    "counts": (HEAD + "torque,p", "{t},22,{i}", {"counts_per_turn": 600}, "which column holds the counts"),
    "jitter": (HEAD + "torque", "{jitter},22", {}, "not evenly spaced"),
}  # fmt: skip


@pytest.mark.parametrize("name", MESSAGES)
def test_options_that_a_message_offers_are_accepted(tmp_path, name):
    head, row, options, words = MESSAGES[name]
    wild = np.random.default_rng(0).normal(size=600)
    rows = [
        row.format(i=i, t=i / 2000, wild=wild[i], pulse=i % 50 < 9, jitter=(i + wild[i] / 10) / 2000)
        for i in range(600)
    ]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([head, *rows]).replace("True", "1").replace("False", "0"))
    with pytest.raises((ValueError, TypeError), match=words) as caught:
        read_recording(path, **options)
    offered = list(advice(caught.value))
    assert offered
    for given in offered:
        read_recording(path, **(options | given))


def test_statements_that_agree_are_all_named_and_an_assumed_unit_is_said(tmp_path):
    savemat(tmp_path / "a.mat", {"torque": TORQUE, "time": 1e3 * TIMES, "dt": 5e-4})
    recording = read_recording(tmp_path / "a.mat")
    assert recording.sampling_rate == 2000
    assert recording.meta["rate_from"] == "variable 'dt' and time variable 'time' (in ms)"
    write_csv(tmp_path / "a.csv", TIMES)
    assert "'time': s assumed" in read_recording(tmp_path / "a.csv").meta["time_notes"][0]
    for times in (45_356.4 + TIMES / 86_400, 1.7e12 + 1e3 * TIMES):  # days since 1900, ms since 1970
        np.savez(tmp_path / "a.npz", torque=TORQUE, time=times)
        assert read_recording(tmp_path / "a.npz").sampling_rate == pytest.approx(2000, rel=1e-3)
