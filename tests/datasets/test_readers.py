"""What is written is read back, what a file leaves open is stated, each bad file gives its one error."""

from __future__ import annotations

import gzip
import json
import pickle

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from memory import peak_bytes
from refusals import check_error
from small_model import recording as burst_recording
from small_model import shaft_model

from cyclofeat._base.quantities import QUANTITIES
from cyclofeat.cli import main
from cyclofeat.datasets import describe, read_folder, read_recording, write_recording
from cyclofeat.datasets.readers import _columns, one_line
from cyclofeat.recordings import Recording

STEADY = settings(derandomize=True, deadline=None, max_examples=20)
RATE = 25_600.0

finite = st.floats(allow_nan=False, allow_infinity=False)
name = st.text(st.characters(codec="utf-8"), min_size=1).filter(str.isprintable)
label = st.none() | name | st.integers(-(2**63), 2**63 - 1)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | finite | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)


@st.composite
def recordings(draw):
    torque = draw(arrays(np.float64, st.integers(2, 30), elements=st.floats(-1e100, 1e100)))
    angle = None
    if draw(st.booleans()):
        angle = draw(st.floats(-1e3, 1e3)) + np.cumsum(
            draw(arrays(np.float64, torque.size, elements=st.floats(1e-3, 10)))
        )
    lobes = draw(st.none() | st.sets(st.integers(0, 14)))
    return Recording(
        torque,
        draw(st.floats(1e-3, 1e7)),
        angle=angle,
        angle_of=draw(st.sampled_from(["input", "disc"])) if angle is not None else "input",
        angle_is_absolute=draw(st.booleans()) if angle is not None else False,
        assembly=draw(label),
        run=draw(label),
        defect_count=draw(st.none() | st.integers(0, 15)) if lobes is None else None,
        worn_lobes=lobes,
        load_nm=draw(st.none() | finite),
        speed_rpm=draw(st.none() | st.floats(1e-3, 1e6)) if angle is None else None,
        source=draw(st.none() | name),
        meta=draw(st.dictionaries(st.text(), json_values, max_size=3)),
    )


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def rows(values, *, head="", separator="\n"):
    return head + separator.join(str(value) for value in values) + "\n"


# -- round trips


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".csv", ".npz"])
@settings(STEADY, max_examples=10)
@given(recording=recordings())
def test_reading_gives_back_what_was_written(tmp_path_factory, suffix, recording):
    path = tmp_path_factory.mktemp("round") / f"record{suffix}"
    write_recording(path, recording)
    read = read_recording(path)
    assert read == recording
    np.testing.assert_array_equal(np.signbit(read.torque), np.signbit(recording.torque))


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_labels_that_are_given_precede_those_of_the_file(tmp_path, suffix):
    path = tmp_path / f"record{suffix}"
    write_recording(
        path, Recording([1, 2], RATE, angle=[0, 1], angle_is_absolute=True, worn_lobes=(0, 4), meta={"a": 1})
    )
    assert read_recording(path, assembly="B").assembly == "B"
    assert read_recording(path, worn_lobes=(1,)).defect_count == 1
    assert read_recording(path, defect_count=7).worn_lobes is None
    assert read_recording(path, meta={"b": 2}).meta == {"a": 1, "b": 2}
    bare = read_recording(path, angle_channel=False)
    assert bare.angle is None
    assert not bare.angle_is_absolute


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_files_of_the_first_format_keep_their_lobes(tmp_path, suffix):
    path = tmp_path / f"record{suffix}"
    np.savez(
        tmp_path / "record.npz", torque=[1, 2], sampling_rate=9, worn_lobes=[0, 4], cyclofeat_recording=1
    )
    write(
        tmp_path / "record.csv",
        "# cyclofeat recording: 1\n# sampling_rate: 9\n# worn_lobes: [0, 4]\nM\n1\n2\n",
    )
    assert read_recording(path).worn_lobes == (0, 4)


def test_written_files_are_legible(tmp_path):
    recording = Recording([21.5, 22], RATE, angle=[0, 0.5], assembly="A1", worn_lobes=(0, 4))
    for name in ("record.csv", "record.npz"):
        write_recording(tmp_path / name, recording)
    lines = (tmp_path / "record.csv").read_text(encoding="utf-8").splitlines()
    assert '# assembly: "A1"' in lines
    assert "# worn_lobes_from_1: [1, 5]" in lines
    assert lines[-3:] == ["torque [Nm],angle [rad]", "21.5,0", "22,0.5"]
    write_recording(tmp_path / "healthy.npz", Recording([21.5, 22], RATE, worn_lobes=()))
    with np.load(tmp_path / "record.npz") as archive, np.load(tmp_path / "healthy.npz") as healthy:
        assert archive["torque"].tolist() == [21.5, 22]
        assert (archive["sampling_rate"], archive["assembly"]) == (RATE, "A1")
        assert healthy["worn_lobes_from_1"].dtype == np.int64
        assert "angle" not in healthy.files


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_writing_replaces_and_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path, suffix, monkeypatch
):
    path = tmp_path / f"record{suffix}"
    old = Recording([1, 2], RATE)
    for recording in (Recording([3, 4, 5], RATE), old):
        write_recording(path, recording)
        assert read_recording(path) == recording

    def full_disk(*args, **kwargs):
        args[0].write(b"half a file")
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savetxt", full_disk)
    monkeypatch.setattr(np, "savez", full_disk)
    with pytest.raises(OSError, match=r"no space left"):
        write_recording(path, Recording([3, 4], RATE))
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    assert read_recording(path) == old


def test_what_cannot_be_written_and_where(tmp_path):
    (tmp_path / "folder.csv").mkdir()
    bare = Recording([1, 2], RATE)
    for target, kind, words in (
        ("record.txt", ValueError, "record.txt: unknown kind of file '.txt'; .csv and .npz"),
        ("record", ValueError, "unknown kind of file ''"),
        ("nowhere/record.csv", FileNotFoundError, "folder .*nowhere does not exist"),
        ("folder.csv", ValueError, "folder.csv is a directory"),
    ):
        with pytest.raises(kind, match=words):
            write_recording(tmp_path / target, bare)
    for value in (object(), (1, 2), np.nan, {1: 2}):
        with pytest.raises(TypeError, match=r"meta must hold only text"):
            write_recording(tmp_path / "record.csv", bare.replace(meta={"key": value}))
    with pytest.raises(TypeError, match=r"recording must be of type Recording, got array"):
        write_recording(tmp_path / "record.csv", np.zeros(3))
    with pytest.raises(TypeError, match=r"path must be a file name, got 3"):
        write_recording(3, bare)
    assert [file.name for file in tmp_path.iterdir()] == ["folder.csv"]


# -- CSV of others


TORQUE = [21.5, -3.25, 22.125]


@pytest.mark.parametrize(
    "text",
    [
        "torque\n21.5\n-3.25\n22.125\n",
        "21.5\n-3.25\n22.125",
        "\n\n21.5\n-3.25\n22.125\n\n  \n",
        '"torque"\n"21.5"\n"-3.25"\n"22.125"\n',
        "# rig 3, second day\n# torque cell 7\ntorque\n2.15e1\n-3.25\n 22.125 \n",
        "torque;note\n21,5;a\n-3,25;b\n22,125;c, d\n",
        "Torque (Nm)\n21.5\n-3.25\n22.125\n",
        "Torque / mNm\n21500\n-3250\n22125\n",
        "torque_knm\n0.0215\n-0.00325\n0.022125\n",
        "M [N·m]\n21.5\n-3.25\n22.125\n",
        "torque in Ncm\n2150\n-325\n2212.5\n",
        "a1,torque_out,a2\n1,21.5,x\n2,-3.25,y\n3,22.125,z\n",
    ],
)
def test_layouts_that_are_understood(tmp_path, text):
    recording = read_recording(write(tmp_path / "rig.csv", text), sampling_rate=RATE)
    np.testing.assert_allclose(recording.torque, TORQUE, rtol=1e-15)
    assert recording.sampling_rate == RATE


@pytest.mark.parametrize("channel", ["force sum", "Force Sum", 1, np.int64(1)])
def test_a_channel_is_named_or_counted(tmp_path, channel):
    path = write(tmp_path / "rig.csv", "speed,force sum [Nm]\n1,21.5\n2,-3.25\n3,22.125\n")
    assert read_recording(path, channel=channel, sampling_rate=RATE).torque.tolist() == TORQUE


@STEADY
@example(rate=1234.5, digits=9, start=0.0)  # no whole number
@given(rate=st.integers(100, 200_000), digits=st.integers(7, 12), start=st.floats(0, 1e3))
def test_rounded_times_give_the_rate(tmp_path_factory, rate, digits, start):
    times = np.round(start + np.arange(2_000) / rate, digits)
    if 10.0**-digits * rate > 0.2:
        return  # times so coarse that samples could be missing
    text = rows((f"{time:.{digits}f},{i % 7}" for i, time in enumerate(times)), head="t [s],torque\n")
    path = write(tmp_path_factory.mktemp("times") / "rig.csv", text)
    assert read_recording(path).sampling_rate == pytest.approx(
        rate, rel=2.0 * 10**-digits * rate / 2_000 + 1e-9
    )


@pytest.mark.parametrize("missing", [1, 50, 500, 998])
def test_one_missing_sample_is_noticed(tmp_path, missing):
    times = [f"{i / 1000:.6f},{i % 7}" for i in range(1_000) if i != missing]
    path = write(tmp_path / "rig.csv", rows(times, head="time,torque\n"))
    # line 1 holds the names, line i + 2 sample i; the sample after the gap moved up by one line
    with pytest.raises(
        ValueError,
        match=rf"rig.csv: time column 'time' is not evenly spaced: 1 gap at a usual 1000 Hz, the longest of "
        rf"1 sample before line {missing + 2}; .*sampling_rate = 1000",
    ):
        read_recording(path)
    recording = read_recording(path, sampling_rate=1_000)  # on the caller's word
    assert (recording.sampling_rate, recording.meta["gaps"]) == (1_000, [[missing, 1]])


def test_the_angle_is_read_in_its_own_unit(tmp_path):
    path = write(tmp_path / "rig.csv", "torque,angle [deg]\n1,0\n2,90\n3,180\n")
    np.testing.assert_allclose(read_recording(path, sampling_rate=1).angle, [0, np.pi / 2, np.pi])
    words = "column 'angle [deg]': angle_unit = 'rad' contradicts its unit, deg"
    check_error(path, words, sampling_rate=1, angle_unit="rad")
    bare = write(tmp_path / "bare.csv", "torque,disc_angle\n1,0\n2,90\n3,180\n")
    recording = read_recording(bare, sampling_rate=1, angle_unit="deg")
    np.testing.assert_allclose(recording.angle, [0, np.pi / 2, np.pi])
    assert recording.angle_of == "disc"
    assert read_recording(bare, sampling_rate=1, angle_channel=False).angle is None


def test_what_was_assumed_is_stated(tmp_path):
    path = write(tmp_path / "rig.csv", "time [s];torque\n0,0;21,5\n0,5;22,5\n1,0;23,0\n")
    recording = read_recording(path)
    assert recording.meta == {
        "file": "rig.csv", "channel": "torque", "unit_assumed": True, "rate_from": "time column 'time [s]'",
        "decimal_comma": True, "table": "samples from line 2: 2 columns, ';', decimal comma",
    }  # fmt: skip
    assert one_line(recording) == (
        "rig.csv: torque 21.5 to 23 Nm (unit assumed) (mean 22.33), 2 Hz from time column 'time [s]', "
        "3 samples = 1.5 s, no angle"
    )
    stated = read_recording(write(tmp_path / "b.csv", "torque [Nm]\n1\n2\n"), sampling_rate=1)
    assert not describe(stated)["unit_assumed"]
    assert recording.source is None  # nobody said that it was measured


BAD_CSV = {
    "wrong column": ("torque,a\n1,2\n3,4\n", "channel = 'tork' ... 'torque', 'a'", {"channel": "tork"}),
    "wrong index": ("torque,a\n1,2\n3,4\n", "channel = 2 ... 'torque', 'a'", {"channel": 2}),
    "index without names": ("1,2\n3,4\n", "channel = 2 ... 0, 1 (no names in the file)", {"channel": 2}),
    "no column chosen, no names": ("1,2\n3,4\n", "channel= must be given ... 0, 1 (no names"),
    "wrong time column": ("torque\n1\n2\n", "time_channel = 'when' ... 'torque'", {"time_channel": "when"}),
    "wrong angle column": ("torque\n1\n2\n", "angle_channel = 'phi' ... 'torque'", {"angle_channel": "phi"}),
    "infinity": ("# a\n# b\ntorque\n1\n-inf\n3\n", "finite ... -inf ... line 5"),
    "text in a cell": (
        "a,torque\n1,2\n1,two\n1,2\n", "line 3 ... column 'torque' ... 'two', which is not a number"
    ),
    "an empty cell": ("a,torque\n1,2\n1,\n1,2\n", "line 3 ... column 'torque' ... nothing"),
    "text without names": ("1.5\n2.5\nthree\n", "line 3 ... column '0' ... 'three'"),
    "thousands": ("torque;a\n1,234.5;1\n2;1\n", "line 2 ... '1,234.5', which is not a number"),
    "a point beside decimal commas": (
        "angle;torque [Nmm]\n0,1;2\n0,2;24.768\n",
        "line 3 ... column 'torque [Nmm]' holds '24.768' ... thousands, or decimals?",
    ),
    "a point below decimal commas": (
        "angle;torque\n0;24,5\n1;1.024\n2;24,7\n",
        "line 3 ... column 'torque' holds '1.024' ... thousands, or decimals?",
    ),
    "a date beside decimal commas": ("torque;angle\n01.02.2026;1,5\n01.02.2026;1,6\n", "'01.02.2026'"),
    "a short row with decimal commas": ("angle;torque\n0,1;2\n0,2.5\n0,3;4\n", "line 3 ... 2 columns"),
    "an underscore": ("torque\n1_000\n2\n", "column 'torque'"),
    "a short row": ("a,torque\n1,2\n1\n1,2\n", "line 3 ... 2 columns ... got 1 column"),
    "a long row": ("a,torque\n1,2\n1,2,3\n1,2\n", "line 3 ... 2 columns ... got 3 columns"),
    "an empty line": ("torque\n1\n\n2\n", "line 3 ... 1 columns ... an empty line"),
    "one sample": ("torque\n1\n", "at least 2 samples ... got 1"),
    "names only": ("torque,a\n", "no table of numbers in the first 1 lines ... table_line="),
    "blank": ("\n \n", "no row of data"),
    "an angle that leaps": (
        "torque,angle_deg\n1,200\n2,300\n3,40\n",
        "'angle_deg': angle must rise or fall, ... angle_channel=False",
    ),
    "a word between spaces": (
        "time torque\n0 1\n1 x\n2 3\n", "line 3, column 'torque' holds 'x', which is not a number"
    ),
    "times that stand": (
        "time,torque\n1,1\n1,2\n", "time column 'time' must rise ... by 0 s", {"sampling_rate": None}
    ),
    "a damaged header": (
        "# cyclofeat recording: 1\n# run: x\ntorque\n1\n2\n", "label 'run' ... not JSON ... 'x'"
    ),
    "a header without rate": (
        "# cyclofeat recording: 1\ntorque\n1\n2\n", "sampling_rate ... header ... None"
    ),
    "a later format": ("# cyclofeat recording: 3\ntorque\n1\n2\n", "format 3 ... update"),
    "a huge number": ("torque\n1\n-1e300\n", "torque must lie within +-1e+100 ... -1e+300 at sample 1"),
    "lobes from nowhere": (
        "# cyclofeat recording: 2\n# sampling_rate: 9\n# worn_lobes: [0, 4]\ntorque\n1\n2\n",
        "worn_lobes does not say whether lobes count from 0 or from 1 ... worn_lobes_from_1",
    ),
    "lobes from 0": (
        "# cyclofeat recording: 2\n# sampling_rate: 9\n# worn_lobes_from_1: [0, 4]\ntorque\n1\n2\n",
        "worn_lobes_from_1 must be lobes counted from 1, like [1, 5], got [0, 4]",
    ),
    "a strange label": ("# cyclofeat recording: 1\n# hue: 1\ntorque\n1\n2\n", "unknown label 'hue'"),
    "a bad label": ("torque\n1\n2\n", "speed_rpm must be positive", {"speed_rpm": -1}),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_CSV)
def test_each_bad_csv_gives_its_one_clear_line(tmp_path, case):
    text, words, *arguments = BAD_CSV[case]
    check_error(write(tmp_path / "rig.csv", text), words, **({"sampling_rate": 1_000} | dict(*arguments)))


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_files_that_are_no_text(tmp_path, pack):
    text = "Drehmoment [Nm]; Prüfung\n1;2\n"
    for content, words in (
        (
            text.encode("cp437"),
            "not text in UTF-8, Latin-1, or UTF-16 with a byte-order mark (byte 19); save it ... UTF-8",
        ),
        (b"\xff\xfe" + text.encode("utf-16-le")[:-1], "not text in utf-16 (byte 58)"),
        (text.encode("utf-16-le"), "holds binary data, or UTF-16 without a byte-order mark"),
        (b"1\n\x002\n", "holds binary data"),
    ):
        path = tmp_path / ("rig.csv" if pack is bytes else "rig.csv.gz")
        path.write_bytes(pack(content))
        check_error(path, words, sampling_rate=1)


@pytest.mark.parametrize(
    "head",
    [
        "",
        "time [ms]  torque [Nm]\n",
        "time [ms] torque [Nm]\n",
        "time in ms   torque in Nm\n",
        "time torque\nms Nm\n",
    ],
)
@pytest.mark.parametrize("comma", [False, True])
def test_spaces_separate_columns(tmp_path, head, comma):
    text = head + "  0.0e+00   2.19e+01\n  5.0e-01   2.21e+01\n\n"
    (tmp_path / "run.txt").write_text(text.replace(".", ",") if comma else text)
    bare = {"channel": 1, "time_channel": 0, "scale": 1, "time_unit": "ms"}
    recording = read_recording(tmp_path / "run.txt", **({} if head else bare))
    assert recording.torque.tolist() == [21.9, 22.1]
    assert recording.sampling_rate == 2000


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32", "latin-1", "cp1252"])
@pytest.mark.parametrize(
    ("ending", "line_end"), [(".csv", "\r"), (".txt", "\n"), (".csv.gz", "\r\n"), (".TXT.gz", "\r\n")]
)
@pytest.mark.parametrize("separator", [";", "\t", ","])
def test_text_is_read_as_people_save_it(tmp_path, encoding, ending, line_end, separator):
    rows = ["Zeit;Drehmoment;Prüfung 45°", "ms;N·m;°C", "0;21,5;1,0", "0,5;-3,25;1,0", "1;22,125;1,0"]
    text = line_end.join(rows)
    text = text.replace(",", ".") if separator == "," else text
    content = text.replace(";", separator).encode(encoding)
    path = tmp_path / f"rig{ending}"
    path.write_bytes(gzip.compress(content) if ending.endswith("gz") else content)
    recording = read_recording(path)
    assert (recording.torque.tolist(), recording.sampling_rate) == (TORQUE, 2_000)
    assert read_recording(path, channel="Prüfung 45°", scale=1).torque.tolist() == [1, 1, 1]


def test_packed_text_is_bounded_and_whole(tmp_path, monkeypatch):
    content, path = b"torque\n" + b"21.5\n" * 300_000, tmp_path / "rig.csv.gz"
    path.write_bytes(gzip.compress(content))
    assert read_recording(path, sampling_rate=1).n_samples == 300_000
    for damaged in (path.read_bytes()[:-9], content):
        (tmp_path / "bad.csv.gz").write_bytes(damaged)
        check_error(tmp_path / "bad.csv.gz", "is damaged, it cannot be read as gzip", sampling_rate=1)
    (tmp_path / "rig.csv").write_bytes(path.read_bytes())
    check_error(tmp_path / "rig.csv", "begins like a .csv.gz file; rename it to end in .csv.gz")
    monkeypatch.setattr(_columns, "LARGEST_UNPACKED", 1_400_000)
    check_error(path, "takes ... GB when unpacked", sampling_rate=1)


# -- any file


def test_files_that_are_not_there_or_not_files(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such file: .*missing\.csv"):
        read_recording(tmp_path / "missing.csv")
    check_error(tmp_path, "is a directory")
    words = "unknown kind of file '.xls'; .csv, .csv.gz, .npz, .tdms, ... .wav and .xlsx can be"
    check_error(write(tmp_path / "rig.xls", "x"), words)
    for empty in ("empty.csv", "empty.npz"):
        check_error(write(tmp_path / empty, ""), f"{empty} is empty")
    with pytest.raises(TypeError, match=r"path must be a file name"):
        read_recording(None)


@pytest.mark.parametrize(
    ("arguments", "kind", "words"),
    [
        ({"sampling_rate": "fast"}, TypeError, "sampling_rate must be a number of Hz, got 'fast'"),
        ({"scale": 0}, ValueError, "scale must be a finite number other than 0"),
        ({"pulses_per_turn": 0}, ValueError, "pulses_per_turn must be at least 1, got 0"),
        ({"pulses_per_turn": 2, "angle_unit": "deg"}, ValueError, "turn= has no effect with angle_unit="),
        ({"angle_unit": "turns"}, ValueError, "angle_unit must be one of 'rad', 'deg', 'rev', got 'turns'"),
        ({"delimiter": "&"}, ValueError, "delimiter must be one of ',', ';', .* got '&'"),
        ({"channel": True}, TypeError, "channel must be the column's name or index"),
        ({"colour": "red"}, TypeError, "unknown option or label 'colour'; known are angle_channel"),
        ({"torque": [1]}, TypeError, "unknown option or label 'torque'"),
        ({"assembly": 1.5}, TypeError, "rig.csv: assembly must be text"),
    ],
)
def test_arguments_are_checked(tmp_path, arguments, kind, words):
    path = write(tmp_path / "rig.csv", "torque\n1\n2\n")
    with pytest.raises(kind, match=words):
        read_recording(path, **{"sampling_rate": 1, **arguments})


# -- NPZ of others


def test_npz_of_others_needs_torque_and_rate_only(tmp_path):
    path = tmp_path / "rig.npz"
    np.savez(path, torque=np.float32(TORQUE), sampling_rate=[25_600], note="second day")
    recording = read_recording(path, run="r7")
    assert recording.torque.tolist() == TORQUE
    assert recording.sampling_rate == RATE
    assert recording.run == "r7"
    assert recording.meta["rate_from"] == "array 'sampling_rate'"
    np.savez(path, torque=[1, 2, 3], sampling_rate=100, angle=[0.1, 0.2, 0.3], assembly="A1", defect_count=2)
    recording = read_recording(path)
    assert recording.angle.tolist() == [0.1, 0.2, 0.3]
    assert (recording.assembly, recording.defect_count) == ("A1", 2)
    np.savez(path, torque=TORQUE, angle=[0, 90, 180], sampling_rate=RATE, angle_unit="deg")
    np.testing.assert_allclose(read_recording(path).angle, [0, np.pi / 2, np.pi])
    np.savez(path, a1=[1, 2, 3], phi=[0.1, 0.2, 0.3])
    recording = read_recording(path, channel="a1", angle_channel="phi", sampling_rate=5, scale=10)
    assert recording.torque.tolist() == [10, 20, 30]
    assert recording.angle.tolist() == [0.1, 0.2, 0.3]


BAD_NPZ = {
    "own format without rate": ({"torque": [1, 2], "cyclofeat_recording": 2}, "no sampling rate"),
    "unit of the angle": (
        {"torque": [1, 2], "sampling_rate": 3, "angle": [1, 2], "angle_unit": "gon"},
        "'angle' ... does not state its unit (rad, deg or rev)",
    ),
    "many rates": ({"torque": [1, 2], "sampling_rate": [3, 4]}, "'sampling_rate' ... a number"),
    "negative rate": ({"torque": [1, 2], "sampling_rate": -3}, "'sampling_rate' ... positive ... -3"),
    "a matrix": ({"torque": [[1], [2]], "sampling_rate": 3}, "'torque' ... 1-D ... (2, 1)"),
    "text": ({"torque": ["a", "b"], "sampling_rate": 3}, "'torque' ... real numbers ... <U1"),
    "one sample": ({"torque": [1], "sampling_rate": 3}, "at least 2 samples ... got 1"),
    "short angle": ({"torque": [1, 2], "sampling_rate": 3, "angle": [1]}, "angle ... at least 2"),
    "bad meta": ({"torque": [1, 2], "sampling_rate": 3, "meta": "[1]"}, "'meta' ... JSON object ... [1]"),
    "a CSV's argument": ({"torque": [1, 2], "sampling_rate": 3}, "delimiter ... CSV", {"delimiter": ";"}),
    "lobes from nowhere": ({"torque": [1, 2], "sampling_rate": 3, "worn_lobes": [0, 4]}, "from 0 or from 1"),
    "a later format": ({"torque": [1, 2], "sampling_rate": 3, "cyclofeat_recording": 3}, "format 3"),
    "an index": (
        {"torque": [1, 2], "sampling_rate": 3}, "channel must be the array's name, got 0; arrays are 'torq",
        {"channel": 0},
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_NPZ)
def test_each_bad_npz_gives_its_one_clear_line(tmp_path, case):
    content, words, *arguments = BAD_NPZ[case]
    np.savez(tmp_path / "rig.npz", **content)
    check_error(tmp_path / "rig.npz", words, **dict(*arguments))


class Trap:
    """Runs code when it is unpickled."""

    def __reduce__(self):
        return (pytest.fail, ("a pickle was loaded",))


@pytest.mark.parametrize("key", ["torque", "sampling_rate", "meta", "note"])
def test_pickles_are_never_loaded(tmp_path, key):
    content = {"torque": [1, 2], "sampling_rate": 3} | {key: np.array([Trap()], dtype=object)}
    np.savez(tmp_path / "rig.npz", **content)
    check_error(tmp_path / "rig.npz", "rig.npz holds pickled objects, which are never loaded")
    (tmp_path / "bare.npz").write_bytes(pickle.dumps(Trap()))
    check_error(tmp_path / "bare.npz", "bare.npz is damaged, it cannot be read as NPZ")


def test_a_bare_array_and_a_flipped_bit_are_noticed(tmp_path):
    path = tmp_path / "rig.npz"
    with path.open("wb") as file:
        np.save(file, np.zeros(5))
    check_error(path, "rig.npz is a single array")
    np.savez(path, torque=np.random.default_rng(0).normal(size=1_000), sampling_rate=3)
    damaged = bytearray(path.read_bytes())
    damaged[2_000] ^= 1
    path.write_bytes(damaged)
    check_error(path, "rig.npz is damaged")


# -- descriptions


def test_a_description_is_fit_for_json():
    recording = Recording([21, 23], RATE, angle=[0, 0.1], angle_of="disc", angle_is_absolute=True)
    facts = describe(recording.replace(assembly=np.int64(3), worn_lobes=(0, 4), load_nm=22))
    expected = {"angle": "disc, absolute", "worn_lobes_from_1": [1, 5], "duration_s": 2 / RATE, "mean": 22}
    assert json.loads(json.dumps(facts)).items() >= expected.items()


def test_one_line_is_for_people():
    text = one_line(
        Recording([21, 23], 1_000, assembly="A1", worn_lobes=(0, 4), speed_rpm=500, source="surrogate")
    )
    assert text == (
        "assembly 'A1': torque 21 to 23 Nm (mean 22), 1000 Hz, 2 samples = 0.002 s, 500 RPM, no angle, "
        "2 worn lobes (1, 5), simulated"
    )
    assert "1 worn lobe," in one_line(Recording([21, 23], 1_000, defect_count=1, source="simulated"))
    assert "0 worn lobes" in one_line(Recording([21, 23], 1_000, worn_lobes=()))
    assert "CONSTANT" in one_line(Recording([3.5, 3.5], RATE))
    assert one_line(Recording([1, 2], RATE, meta={"channel": "a1", "unit": "g"})).startswith("a1 1 to 2 g")


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
def test_a_text_file_is_read_in_pieces(suffix, tmp_path):
    rows = 60_000
    path = tmp_path / f"long{suffix}"
    text = "torque [Nm],note,spare\n" + "".join(
        f"{n % 97}.25,{'0' * 150}1,{'9' * 150}\n" for n in range(rows)
    )
    path.write_bytes(gzip.compress(text.encode(), 1) if suffix == ".csv.gz" else text.encode())
    n_bytes = len(text)
    del text
    with peak_bytes() as peak:
        recording = read_recording(path, sampling_rate=1000)
    np.testing.assert_array_equal(recording.torque, np.arange(rows) % 97 + 0.25)
    blocks = 2**22  # of text, whatever its length
    assert n_bytes > 18e6
    assert peak[0] <= 3 * recording.torque.nbytes + blocks


def test_the_times_of_a_long_record_take_little_memory(tmp_path):
    times = np.arange(500_000) / 25_600 + 3
    np.savez(tmp_path / "long.npz", torque=22 + np.sin(times), time=times)
    with peak_bytes() as peak:
        recording = read_recording(tmp_path / "long.npz")
    assert recording.sampling_rate == 25_600
    assert peak[0] <= 2.5 * recording.torque.nbytes


# The shaft's angle by a tachometer


def turned(n=25_600):
    """Angle in rad, one sample every 1/12,800 s, at a speed that rises from 400 to 500 RPM."""
    time = np.arange(n) / 12_800
    return 2 * np.pi * (400 * time + 25 * time**2) / 60 + 0.1


def tacho_file(path, channel, name):
    np.savez(path, **{"torque": 20 + np.sin(turned()), name: channel, "sampling_rate": 12_800.0})
    return path


@pytest.mark.parametrize(
    ("name", "of_turn", "options", "error"),
    [
        ("angle [deg]", lambda turn: 360 * (turn % 1), {}, 1e-9),
        ("angle", lambda turn: turn % 1, {"angle_unit": "rev"}, 1e-9),
        ("angle [deg]", lambda turn: np.floor(1024 * turn) % 1024 * 360 / 1024, {}, 0.01),
        ("tacho", lambda turn: 5.0 * (60 * turn % 1 < 0.5), {"pulses_per_turn": 60}, 0.01),
        ("Index", lambda turn: 1.0 * (turn % 1 < 0.02), {"pulses_per_turn": 1}, 0.02),
    ],
    ids=["starts again", "in turns", "encoder", "pulses", "index"],
)
def test_the_angle_follows_the_shaft(tmp_path, name, of_turn, options, error):
    angle = turned()
    path = tacho_file(tmp_path / "rig.npz", of_turn(angle / (2 * np.pi)), name)
    recording = read_recording(path, **options)
    off = (recording.angle - angle)[2000:-2000]
    assert np.ptp(off) < error
    assert any("the angle of the shaft" in note for note in describe(recording)["warnings"])


def test_what_is_no_angle_is_named_with_its_channel(tmp_path):
    noise = np.random.default_rng(0).normal(size=25_600)
    path = tacho_file(tmp_path / "rig.npz", noise, "angle")
    check_error(path, "rig.npz: array 'angle': angle must rise ... angle_channel=False")
    lost = 1.0 * (60 * turned() / (2 * np.pi) % 1 < 0.5)
    lost[9000:9100] = 0
    path = tacho_file(tmp_path / "lost.npz", lost, "tacho")
    check_error(path, "'tacho': signal must hold each pulse once", pulses_per_turn=60)


@pytest.mark.slow
@pytest.mark.parametrize("wrapped", [False, True])
def test_a_machine_in_reverse_has_the_same_count(tmp_path, wrapped):
    forward = burst_recording((4, 5, 6), seed=100, turns=2)
    angle = -forward.angle % (2 * np.pi) if wrapped else -forward.angle
    np.savetxt(
        tmp_path / "reverse.csv", np.c_[forward.torque, angle], delimiter=",", comments="",
        header="torque [Nm],angle [rad]",
    )  # fmt: skip
    options = {"sampling_rate": forward.sampling_rate, "speed_rpm": 500, "angle_is_absolute": True}
    reverse = read_recording(tmp_path / "reverse.csv", **options)
    (warning,) = describe(reverse)["warnings"]
    made = "was made continuous and " if wrapped else ""
    assert warning == (
        f"the angle of the shaft {made}was turned round, since it fell: positions of lobes are relative, and "
        "may count the other way"
    )
    np.testing.assert_allclose(np.diff(reverse.angle), np.diff(forward.angle), atol=1e-9)
    count = shaft_model().count(reverse)
    assert (count.defect_count, count.refused, count.absolute) == (3, False, False)
    assert count.probability == pytest.approx(shaft_model().count(forward).probability, abs=1e-6)
    write_recording(tmp_path / "again.npz", reverse)
    assert read_recording(tmp_path / "again.npz") == reverse


# The quantity asked for selects the channel by name and unit; where two fit, none is taken

OUT, IN, CURRENT = QUANTITIES
GERMAN = "Abtriebsdrehmoment [Nm];Antriebsmoment [Nm];Motorstrom [A]"
ENGLISH = "Torque out (Nm),Torque in (Nm),Motor current (mA)"


def file_with(tmp_path, names):
    mark = ";" if ";" in names else ","
    rows = [mark.join(str(100 * row + column) for column in range(names.count(mark) + 1)) for row in (1, 2)]
    path = tmp_path / "rig.csv"
    path.write_text("\n".join([names, *rows, ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("names", "quantity", "column", "factor"),
    [
        (ENGLISH, None, 0, 1),
        (ENGLISH, OUT, 0, 1),
        (ENGLISH, IN, 1, 1),
        (ENGLISH, CURRENT, 2, 1e-3),
        (GERMAN, None, 0, 1),
        (GERMAN, IN, 1, 1),
        (GERMAN, CURRENT, 2, 1),
        ("Torque in (Nm),Torque out (Nm)", None, 1, 1),  # the order does not matter
        ("torque_in_ncm,torque", None, 1, 1),  # a torque that names no side is the output's
        ("torque_in_ncm,torque", IN, 0, 1e-2),
        ("torque,torque_in", IN, 1, 1),
        ("M1 [Nm],n [1/min],i1 [mA]", None, 0, 1),  # by the unit
        ("M1 [Nm],n [1/min],i1 [mA]", IN, 0, 1),
        ("M1 [Nm],n [1/min],i1 [mA]", CURRENT, 2, 1e-3),
        ("Torque in Nm,n", None, 0, 1),  # "in" is a word of the unit here
        ("Torque (lbf-ft),n", None, 0, 9.80665 * 0.45359237 * 0.3048),
        ("Torque [in.lb],n", None, 0, 9.80665 * 0.45359237 * 0.0254),
        ("n,i_q", CURRENT, 1, 1),
    ],
)
def test_names_and_units_select_the_channel(tmp_path, names, quantity, column, factor):
    recording = read_recording(file_with(tmp_path, names), sampling_rate=9, quantity=quantity)
    np.testing.assert_allclose(recording.torque, factor * (np.array([100, 200]) + column))
    assert recording.quantity == (quantity or OUT)
    assert recording.unit == ("A" if quantity == CURRENT else "Nm")


def test_the_only_channel_of_input_speeds_states_the_speed_unless_an_angle_or_a_label_does(tmp_path):
    stated = "M1 [Nm],n [1/min]", "torque,speed_rpm", "Drehmoment;Motordrehzahl [min-1]", "torque,RPM"
    unknown = "torque,output speed [rpm]", "torque,speed [rpm],n [rpm]", "torque,n", "torque,rpm,angle [deg]"
    for names in (*stated, *unknown):
        path = file_with(tmp_path, names)
        assert read_recording(path, sampling_rate=9).speed_rpm == (151 if names in stated else None)
        assert " 150 RPM, " in one_line(read_recording(path, sampling_rate=9, speed_rpm=150))
    path = write(tmp_path / "rig.csv", "torque,n [rpm]\n1,33\n2,34\n")  # as slow as an output
    assert read_recording(path, sampling_rate=9).speed_rpm is None


@pytest.mark.parametrize(
    ("names", "quantity", "words"),
    [
        ("torque in,motor torque,n", IN, "channel= must be given, ... fit: 'torque in', 'motor torque'"),
        ("current,motor current", CURRENT, "channel= must be given, ... fit: 'current', 'motor current'"),
        ("a,b", CURRENT, "channel= must be given, to say which column is the motor current: 'a', 'b'"),
        ("Torque in (Nm),n", None, "holds input torque by its name or unit, not output torque: give q"),
        ("motor torque", OUT, "'motor torque' holds input torque by its name or unit, not output"),
        ("x [A],n", None, "'x [A]' holds motor current"),
        ("torque out,n", IN, "'torque out' holds output torque by its name or unit, not input torque"),
        ("torque [A],n", None, "is in 'A', known are Nm ... or quantity='motor_current'"),
    ],
)
def test_what_does_not_hold_the_quantity_is_not_read_as_it(tmp_path, names, quantity, words):
    check_error(file_with(tmp_path, names), words, sampling_rate=9, quantity=quantity)


def test_a_channel_named_alone_must_not_hold_another_quantity_by_its_name(tmp_path):
    path = file_with(tmp_path, ENGLISH)
    check_error(path, "holds input torque ... if the name is wrong", sampling_rate=9, channel=1)
    # both stated: the names are wrong
    assert read_recording(path, sampling_rate=9, channel=1, quantity=OUT).torque[0] == 101


def test_a_torque_constant_turns_a_current_into_torque(tmp_path):
    recording = read_recording(file_with(tmp_path, GERMAN), sampling_rate=9, quantity=CURRENT, scale=0.05)
    np.testing.assert_allclose(recording.torque, [0.05 * 102, 0.05 * 202])
    assert (recording.quantity, recording.unit) == (CURRENT, "Nm")
    assert one_line(recording).startswith("rig.csv: motor current (Motorstrom [A]) 5.1 to 10.1 Nm")
    volts = file_with(tmp_path, "i_q [V],n")
    assert read_recording(volts, sampling_rate=9, quantity=CURRENT, scale=2).unit == "A"  # A per V


@pytest.mark.parametrize(("stated", "unit"), [("%", "%"), ("p.u.", "p.u."), ("pu", "p.u.")])
def test_a_current_may_be_a_share_of_the_rated_one(tmp_path, stated, unit):
    path = file_with(tmp_path, f"Motorstrom [{stated}];n")
    recording = read_recording(path, sampling_rate=9, quantity=CURRENT)
    np.testing.assert_array_equal(recording.torque, [100, 200])
    assert recording.unit == unit
    write_recording(tmp_path / "run.npz", recording)
    assert read_recording(tmp_path / "run.npz") == recording
    assert describe(recording)["warnings"][-1] == "no angle: positions of lobes will be relative"
    amperes = read_recording(path, sampling_rate=9, quantity=CURRENT, scale=0.1)
    assert (amperes.unit, amperes.torque[0]) == ("A", 10)
    path.write_text(f"Motorstrom;n\n{stated};\n1;2\n3;4\n", encoding="utf-8")  # a row of units
    assert read_recording(path, sampling_rate=9, quantity=CURRENT).unit == unit
    with pytest.raises(ValueError, match=r"known are Nm"):  # not of a torque
        read_recording(file_with(tmp_path, f"torque [{stated}],n"), sampling_rate=9)
    with pytest.raises(ValueError, match="channel= must be given"):  # nor does it tell a current
        read_recording(file_with(tmp_path, f"load [{stated}],n"), sampling_rate=9, quantity=CURRENT)


@pytest.mark.parametrize("ending", ["csv", "npz"])
@pytest.mark.parametrize("meta", [{}, {"unit": "Nm"}], ids=["stated unit", "scaled"])
@pytest.mark.parametrize("quantity", [IN, CURRENT])
def test_written_files_keep_the_quantity(tmp_path, ending, meta, quantity):
    recording = Recording([1.5, 2.5, 2.0], 9, quantity=quantity, meta=meta)
    path = tmp_path / f"run.{ending}"
    write_recording(path, recording)
    assert read_recording(path) == recording
    assert read_recording(path, quantity=quantity) == recording
    with pytest.raises(
        ValueError, match=rf"quantity = '{OUT}' contradicts the file, which says '{quantity}'"
    ):
        read_recording(path, quantity=OUT)


def test_an_array_of_another_program_is_in_the_unit_of_its_quantity(tmp_path):
    np.savez(tmp_path / "run.npz", motor_current=[0.5, 0.7], torque=[1.0, 2.0], sampling_rate=9.0)
    assert read_recording(tmp_path / "run.npz", quantity=CURRENT).torque.tolist() == [0.5, 0.7]
    np.savez(tmp_path / "run.npz", torque=[1.0, 2.0], sampling_rate=9.0, quantity="power")
    check_error(tmp_path / "run.npz", "run.npz: quantity must be one of 'output_torque', ... got 'power'")


def test_a_manifest_states_the_quantity_of_each_line(tmp_path):
    file_with(tmp_path, ENGLISH)
    manifest = tmp_path / "recordings.csv"
    manifest.write_text(f"file,sampling_rate,quantity\nrig.csv,9,{CURRENT}\nrig.csv,9,{IN}\nrig.csv,9,\n")
    assert [one.quantity for one in read_folder(tmp_path)] == [CURRENT, IN, OUT]
    assert {one.quantity for one in read_folder(tmp_path, quantity=IN)} == {IN}
    manifest.write_text("file,quantity\nrig.csv,torque\n")
    with pytest.raises(ValueError, match=r"line 2: quantity must be one of output_torque, .* got 'torque'"):
        read_folder(tmp_path)


def test_the_option_reads_another_quantity_and_errors_name_it(tmp_path, capsys):
    path = str(file_with(tmp_path, "Torque in (Nm),n"))
    assert main(["inspect", path, "--sampling-rate", "9"]) == 2
    assert "give --quantity 'input_torque', or --channel and --quantity" in capsys.readouterr().err
    assert main(["inspect", path, "--sampling-rate", "9", "--quantity", "input_torque"]) == 0
    assert "input torque (Torque in (Nm)) 100 to 200 Nm" in capsys.readouterr().out
