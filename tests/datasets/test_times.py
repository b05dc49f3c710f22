"""All that a file says of its sampling rate is compared; what an error advises is then accepted."""

from __future__ import annotations

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
        "'wf_increment' of segment 1 says 1000 Hz, .* segment 2 says 2000 Hz", [1000, 2000],
    ),
    "slow.tdms": (
        lambda path: write_tdms(path, [("fast/Torque", TORQUE), ("slow/Time", TIMES[:300])]),
        "time channel 'slow/Time' has 300 times, channel 'fast/Torque' 600 samples", [],
    ),
    "slow.mat": (
        lambda path: savemat(path, {"torque": TORQUE, "time": TIMES[:300]}),
        "time variable 'time' has 300 times, variable 'torque' 600 samples", [],
    ),
    "ms.csv": (lambda path: write_csv(path, 1e3 * TIMES), "in s .* 2 Hz", [2000, 2e6, None, 2]),
    "number.csv": (lambda path: write_csv(path, 2e3 * TIMES), "in s .* 1 Hz", [1000, 1e6, None, 1]),
    "gap.csv": (
        lambda path: write_csv(path, TIMES + 0.06 * (TIMES > 0.2)), "120 samples before line 403", [2000]
    ),
    "back.csv": (lambda path: write_csv(path, np.abs(TIMES - 0.1)), "it falls by", []),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_rate_that_is_not_certain_is_refused_with_advice_that_works(tmp_path, name):
    write, words, rates = REFUSED[name]
    write(tmp_path / name)
    with pytest.raises(ValueError, match=words) as caught:
        read_recording(tmp_path / name)
    advice = str(caught.value).partition("give ")[2]
    given = re.findall(r"(\w+) ?= ?('[^']*'|[\d.]+)", advice)
    for (argument, value), rate in zip(given, rates, strict=True):
        options = {argument: value.strip("'") if "'" in value else float(value)}
        right = 25_600 if rate is None else rate
        options |= {"sampling_rate": right} if rate is None else {}
        assert read_recording(tmp_path / name, **options).sampling_rate == pytest.approx(right)
    recording = read_recording(tmp_path / name, sampling_rate=700)
    assert recording.sampling_rate == 700
    overrides = re.search("700 Hz, overrides|in s the sampling", " ".join(describe(recording)["warnings"]))
    assert bool(overrides) == bool(rates)


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
