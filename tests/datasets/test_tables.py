"""Tables as programs export them, and what files say of their rate, are read or refused for the reason."""

from __future__ import annotations

import ast
import re

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter
from refusals import check_error
from scipy.io import savemat

from cyclofeat.datasets import describe, read_recording
from cyclofeat.datasets.readers._read import read_stretches

RATE, N, START = 2000, 600, 133 * 10**15  # the last in 100 ns
TORQUE, TIMES = np.round(20 + np.sin(np.arange(N) / 7), 4), np.arange(N) / RATE


def rows(line, comma=False):
    values = zip(range(N), TIMES, TORQUE, strict=True)
    text = "".join(
        line.format(i=i, t=t, s=31 + t, ms=1e3 * t, ticks=START + 5000 * i, y=y) for i, t, y in values
    )
    return text.replace(".", ",") if comma else text


LVM = "LabVIEW Measurement\t\nWriter_Version\t2\t\nMulti_Headings\t{}\t\nX_Columns\t{}\t\n"
LVM += "Time\t10:22:31,938\t\n***End_of_Header***\t\n\t\n"
SEGMENT = "Channels\t2\t\t\nSamples\t300\t300\t\nTime\t10:22:31,9\t10:22:31,9\t\n"
SEGMENT += "Y_Unit_Label\tNewton-Meters\tVolts\t\nX0\t0,0E+0\t0,0E+0\t\nDelta_X\t5,0E-4\t5,0E-4\t\n"
SEGMENT += "***End_of_Header***\t\t\t\nX_Value\tTorque\tAccel\tComment\n"
SCOPE = "Name\tYT Scope Project\nStarttime of export\t132959625843760000\t2. Mai 2022\t13:56:24\n\n"
PROPERTIES = "Name\tTorque\tName\tSpeed\nData-Type\tREAL64\tData-Type\tINT16\n"
PROPERTIES += "SampleTime[ms]\t0,5\tSampleTime[ms]\t0,5\nPort\t851\tPort\t851\nUnit\tNm\tUnit\t(None)\n\n"
TEKTRONIX = ["Record Length,300,", "Sample Interval,5.0e-04,", "Source,CH1,", *[",,"] * (N - 3)]
SIGLENT = "Record Length,Analog:300\nSample Rate,2000.0\nVertical Scale,CH1: 5.00\nHorizontal Scale, 0.0001\n"
HIOKI = '"NUM_SIGS",\n3\n"INTERVAL",\n5.000E-04\n"HORZ_UNITS", "S"\n"SIGNAL",\n"TIME", "ACH1"\n'
YOKOGAWA = '"Model Name","DL850"\n"TraceName","CH1","CH2"\n"VUnit","V","V"\n"SampleRate",2.0E+03,2.0E+03\n'
YOKOGAWA += '"HResolution",5.0E-04,5.0E-04\n"Date","2024/03/05","2024/03/05"\n\n'
VOLTS = {"channel": 1, "scale": 1}
# Text, options, and the words of the error; none if the text is read.
TEXTS = {
    "LabVIEW, no times": (LVM.format("No", "No") + SEGMENT + rows("\t{y:.4f}\t0.1\n", True), {}, ""),
    "LabVIEW, several heads": (
        LVM.format("Yes", "One") + 2 * (SEGMENT + rows("{t:.6f}\t{y:.4f}\t0.1\n", True) + "\t\n"), {},
        "2 segments, each with a head: give gaps='cut'",
    ),
    "DIAdem": ('"Time"\t"Torque"\n"s"\t"Nm"\n' + rows("{t:.4f}\t{y:.4f}\n", True), {}, ""),
    "catman": (
        "HBM_CATMAN_DATAFILE_40\tVersion 5\nT0 = 05.03.2024 10:22:31\nSample rate=2000 Hz\t\nCH=0\tCH=1\n"
        "Time  1 - default sample rate [s]\tMX840_CH 1 [Nm]\n" + rows("{t:.6f}\t{y:.4f}\n", True), {}, "",
    ),
    "TwinCAT": (SCOPE + PROPERTIES + rows("{ms:.1f}\t{y:.4f}\t{ms:.1f}\t{i}\n", True) + "EOF\n", {}, ""),
    "TwinCAT, full times": (SCOPE + "Name\tTorque\n\n" + rows("{ticks}\t{y:.4f}\n", True), {}, ""),
    "TwinCAT, names only": (
        SCOPE + "Name\tTorque\n\n" + rows("{ms:.1f}\t{y:.4f}\n", True), {}, r"time_unit='ms' \(2000 Hz\)"
    ),
    "Tektronix TDS": (
        "".join(map("{},{}\n".format, TEKTRONIX, rows("{t:.6f},{y}, ").split())), {"channel": 4, "scale": 1},
        "",
    ),
    "Tektronix MSO": (
        "Model,MSO4034B\nSample Interval,0.0005\n,\nLabel,\nTIME,CH1\n" + rows("{t:.6e},{y:.4f}\n"), {}, ""
    ),
    "Rigol": (
        "X,CH1,Start,Increment\nSequence,Volt,-5.88E-02,5.00E-04\n" + rows("{i},{y:.4f}\n"), VOLTS, ""
    ),
    "Siglent": (SIGLENT + "Second,Volt\n" + rows("{t:.11f},{y:.4f}\n"), {}, ""),
    "Keysight": ("x-axis,1,2\nsecond,Volt,Volt\n" + rows("{t:+.8E},{y:+.6E},+1E-1\n"), VOLTS, ""),
    "PicoScope": ("Zeit;Kanal A\n(ms);(V)\n\n" + rows("{ms:.8f};{y:.8f}\n", True), VOLTS, ""),
    "Hioki": (HIOKI + '"DATA"\n' + rows("{t:.4E}, {y:+.6E}\n"), VOLTS, ""),
    "Yokogawa": (YOKOGAWA + rows(",{y:.6E},1.0E-1,\n"), VOLTS, ""),
    "CODESYS": (
        "Trace\nRIG.PRO\nCycle PLC.Torque\n" + rows("{i} {y:.4f}\n"), {"channel": 1}, "no sampling rate"
    ),
    "TIA": (
        "Trace;Messung_1\n\nSample number;Time [ms];DB_Rig.Torque\n" + rows("{i};{ms:.3f};{y:.4f}\n", True),
        {"channel": 2}, "",
    ),
    "CiA 402": (
        "Time [ms];Torque actual value (0x6077) [0.1%]\n" + rows("{ms};{y}\n"), {},
        "'0.1%'.*quantity='motor_current'",
    ),
    "a separator stated": ("sep=;\nTime [s];Torque [Nm]\n" + rows("{t:.4f};{y:.4f}\n", True), {}, ""),
    "settings above": (
        "Instrument;MX\nSample rate [Hz];2000\n\nTime;Torque\ns;Nm\n" + rows("{t:.4f};{y:.4f}\n", True), {},
        "",
    ),
    "settings without a gap": ("Job;7\nTime [s];Torque [Nm]\n" + rows("{t:.4f};{y:.4f}\n"), {}, ""),
    "a rate above": ("# Sample rate: 2 kHz\nTorque [Nm]\n" + rows("{y:.4f}\n"), {}, ""),
    "clock": ("Time,Torque [Nm]\n" + rows("10:22:{s:.4f},{y:.4f}\n"), {}, ""),
    "US dates": ("Timestamp,Torque [Nm]\n" + rows("3/5/2024 11:22:{s:.4f} PM,{y:.4f}\n"), {}, ""),
    "German dates": (
        "Zeit;Drehmoment [Nm]\n" + rows("D 10:22:{s:.4f};{y:.4f}\n", True).replace("D", "05.03.2024"), {}, "",
    ),
    "date and time": ("Date,Time,Torque [Nm]\n" + rows("2024-03-05,10:22:{s:.4f},{y:.4f}\n"), {}, ""),
    "offset": ("time,torque\n" + rows("2024-03-05T10:22:{s:.4f}+01:00,{y:.4f}\n"), {}, ""),
    "one column of commas": ("torque\n" + rows("{y:.4f}\n", True), {"sampling_rate": 2000}, ""),
    "commas below a name with one": (
        "Torque, bearing side\n" + rows("{y:.4f}\n", True), {"sampling_rate": 2000, "channel": 0}, ""
    ),
    "bars": ("Time [s]|Torque [Nm]|Status\n" + rows("{t:.4f}|{y:.4f}|OK\n"), {}, ""),
    "Tektronix MSO, volts": (
        "Sample Interval,5.0E-4\nVertical Units,V\n\nTIME,CH1\n" + rows("{t:.6e},{y:.4f}\n"), {},
        "'CH1' is in 'V'.*give scale=",
    ),
    "stated": (
        "a b\n1;2\nt;M\n" + rows("{t:.4f};{y:.4f}\n", True),
        {"table_line": 3, "decimal": ",", "channel": 1}, "",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TEXTS)
def test_texts_are_read_right_or_refused(tmp_path, name):
    text, options, words = TEXTS[name]
    path = tmp_path / "rig.txt"
    path.write_text(text, encoding="utf-8")
    if words:
        with pytest.raises(ValueError, match=words):
            read_recording(path, **options)
        return
    recording = read_recording(path, **options)
    np.testing.assert_allclose(recording.torque, TORQUE, atol=1e-4)
    assert (recording.sampling_rate, recording.unit) == (RATE, "Nm")


def test_segments_of_labview_are_cut(tmp_path):
    path = tmp_path / "rig.lvm"
    path.write_text(TEXTS["LabVIEW, several heads"][0].replace("5,0E-4", "1,0E-3", 1))
    parts = read_stretches(path, gaps="cut", time_channel=False)
    assert [part.sampling_rate for part in parts] == [1000, 2000]
    for part in parts:
        np.testing.assert_array_equal(part.torque, TORQUE)


@pytest.mark.parametrize(("comma", "factor"), [(True, 1), (False, 1000)])
@pytest.mark.parametrize("long", [False, True])
def test_marks_of_thousands_are_asked_for(tmp_path, comma, factor, long):
    path = tmp_path / "a.txt"
    path.write_text("i\tTorque [mNm]\n" + "0\t2,329\n0\t990\n0\t1,016\n" * (50_000 if long else 1))
    check_error(path, "line 2, ... '2,329', but others are whole: ... decimal=','", sampling_rate=2000)
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
            check_error(path, "line 150002", sampling_rate=2000)


def test_counts_of_an_encoder_are_an_angle(tmp_path):
    path = tmp_path / "a.csv"
    head = "Time [ms];Position actual value [inc];Torque actual value [0.1%]\n"
    path.write_text(head + rows("{ms:.1f};{i};{y:.0f}\n"))
    recording = read_recording(path, channel=2, quantity="motor_current", counts_per_turn=60)
    np.testing.assert_allclose(recording.angle, np.arange(N) * 2 * np.pi / 60)
    assert (recording.unit, recording.torque[0]) == ("%", 2)


def test_variables_of_controldesk_are_found_by_their_names(tmp_path):
    kind = [("Name", object), ("Data", object), ("Unit", object)]
    y = np.array([("Torque", TORQUE, "Nm"), ("Speed", TIMES, "1/s")], dtype=kind)
    savemat(tmp_path / "a.mat", {"rec": {"X": np.array([("time", TIMES, "s")], dtype=kind), "Y": y}})
    recording = read_recording(tmp_path / "a.mat", channel="Torque")
    np.testing.assert_array_equal(recording.torque, TORQUE)
    assert recording.sampling_rate == 2000


# -- all that a file says of its sampling rate is compared; what an error advises is then accepted


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
