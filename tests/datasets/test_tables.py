"""Tables as programs export them are found and read by themselves; counts of an encoder are an angle."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.io import savemat

from cyclofeat.datasets import read_recording

SAMPLES = [(index / 2000, 20 + (index % 7) / 8) for index in range(60)]


def rows(line, comma=False):
    text = "".join(line.format(i=i, t=t, ms=1e3 * t, y=y, s=31 + t) for i, (t, y) in enumerate(SAMPLES))
    return re.sub(r"(?<!\.\d\d)\.(?=\d{3})", ",", text) if comma else text


TABLES = {
    "a separator stated": ("sep=;\nTime [s];Torque [Nm]\n" + rows("{t:.4f};{y:.3f}\n", True), {}),
    "settings above": (
        "Instrument;MX\nSample rate [Hz];2000\n\nTime;Torque\ns;Nm\n" + rows("{t:.4f};{y:.3f}\n", True), {}
    ),
    "settings without a gap": ("Job;7\nTime [s];Torque [Nm]\n" + rows("{t:.4f};{y:.3f}\n"), {}),
    "a rate above": ("# Sample rate: 2 kHz\nTorque [Nm]\n" + rows("{y:.3f}\n"), {}),
    "clock": ("Time,Torque [Nm]\n" + rows("10:22:{s:.4f},{y:.3f}\n"), {}),
    "US dates": ("Timestamp,Torque [Nm]\n" + rows("3/5/2024 11:22:{s:.4f} PM,{y:.3f}\n"), {}),
    "German dates": ("Zeit;Drehmoment [Nm]\n" + rows("05.03.2024 10:22:{s:.4f};{y:.3f}\n", True), {}),
    "date and time": ("Date,Time,Torque [Nm]\n" + rows("2024-03-05,10:22:{s:.4f},{y:.3f}\n"), {}),
    "offset": ("time,torque\n" + rows("2024-03-05T10:22:{s:.4f}+01:00,{y:.3f}\n"), {}),
    "one column of commas": ("torque\n" + rows("{y:.3f}\n", True), {"sampling_rate": 2000}),
    "stated": (
        "a b\n1;2\nt;M\n" + rows("{t:.4f};{y:.3f}\n", True), {"table_line": 3, "decimal": ",", "channel": 1}
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_tables_are_found(tmp_path, name):
    text, options = TABLES[name]
    path = tmp_path / "a.txt"
    path.write_text(text)
    recording = read_recording(path, **options)
    np.testing.assert_allclose(recording.torque, [y for _, y in SAMPLES], atol=6e-4)
    assert recording.sampling_rate == 2000


@pytest.mark.parametrize(("comma", "factor"), [(True, 1), (False, 1000)])
@pytest.mark.parametrize("long", [False, True])
def test_marks_of_thousands_are_asked_for(tmp_path, comma, factor, long):
    path = tmp_path / "a.txt"
    path.write_text("i\tTorque [mNm]\n" + "0\t2,329\n0\t990\n0\t1,016\n" * (50_000 if long else 1))
    with pytest.raises(ValueError, match=r"line 2, .* '2,329', but others are whole: .*decimal=','"):
        read_recording(path, sampling_rate=2000)
    recording = read_recording(path, sampling_rate=2000, decimal="," if comma else ".")
    np.testing.assert_allclose(1e3 * recording.torque[:3], [2.329 * factor, 990, 1.016 * factor])


@pytest.mark.slow
def test_a_long_file_is_read_at_once_and_a_wrong_row_in_it_is_named(tmp_path):
    path = tmp_path / "a.csv"
    for mark, point in ((",", "."), (";", ",")):
        lines = [f"{i % 9}{point}25{mark}{i}" for i in range(150_000)]
        path.write_text(f"torque{mark}n\n" + "\n".join(lines))
        recording = read_recording(path, sampling_rate=2000)
        np.testing.assert_array_equal(recording.torque, np.arange(150_000) % 9 + 0.25)
        for wrong in ("", "1", f"x{mark}2", f"1{mark}2{mark}3"):
            path.write_text(f"torque{mark}n\n" + "\n".join([*lines, wrong, *lines[:2]]))
            with pytest.raises(ValueError, match="line 150002"):
                read_recording(path, sampling_rate=2000)


def test_counts_of_an_encoder_are_an_angle(tmp_path):
    path = tmp_path / "a.csv"
    head = "Time [ms];Position actual value [inc];Torque actual value [0.1%]\n"
    path.write_text(head + rows("{ms:.1f};{i};{y:.0f}\n"))
    recording = read_recording(path, channel=2, quantity="motor_current", counts_per_turn=60)
    np.testing.assert_allclose(recording.angle, np.arange(60) * 2 * np.pi / 60)
    assert (recording.unit, recording.torque[0]) == ("%", 2)


def test_variables_of_controldesk_are_found_by_their_names(tmp_path):
    kind = [("Name", object), ("Data", object), ("Unit", object)]
    times, torques = np.array(SAMPLES).T
    y = np.array([("Torque", torques, "Nm"), ("Speed", times, "1/s")], dtype=kind)
    savemat(tmp_path / "a.mat", {"rec": {"X": np.array([("time", times, "s")], dtype=kind), "Y": y}})
    recording = read_recording(tmp_path / "a.mat", channel="Torque")
    np.testing.assert_array_equal(recording.torque, torques)
    assert recording.sampling_rate == 2000
