"""Files of other programs, rebuilt from public descriptions, are read right or refused for the reason."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.datasets import read_recording
from cyclofeat.datasets.readers._read import read_stretches

RATE, N, START = 2000, 300, 133 * 10**15  # the last in 100 ns
TORQUE = np.round(20 + np.sin(np.arange(N) / 7), 4)


def rows(line, comma=False):
    values = zip(range(N), np.arange(N) / RATE, TORQUE, strict=True)
    text = "".join(line.format(i=i, t=t, ms=1e3 * t, ticks=START + 5000 * i, y=y) for i, t, y in values)
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
