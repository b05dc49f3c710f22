"""Files of independent writers give back what was written, in Nm; bad ones give one clear error each.

Files made to break a reader do so too, in a few times the memory of the file.
"""

from __future__ import annotations

import csv
import gzip
import struct
import sys
import time
import warnings
import zipfile

import h5py
import numpy as np
import openpyxl
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from memory import peak_bytes
from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter
from refusals import check_error
from scipy.io import savemat, wavfile

from cyclofeat.datasets import describe, read_recording, write_recording
from cyclofeat.datasets.readers import _columns
from cyclofeat.recordings import Recording

RATE = 25_600.0
TORQUE = 22 + np.random.default_rng(5).normal(size=500)
ANGLE = 0.002 * np.arange(1, 501)


def wave(unit="Nm", rate=RATE, **more):
    """Properties of an NI waveform."""
    found = {"wf_increment": 1 / rate, "wf_start_time": np.datetime64("2024-05-01T12:00:00.25", "us")}
    return found | ({"unit_string": unit} if unit else {}) | more


def write_tdms(path, *segments):
    with TdmsWriter(path) as writer:
        for segment in segments:
            writer.write_segment(segment)
    return path


# -- TDMS


def test_tdms_gives_values_rate_unit_and_start(tmp_path):
    path = write_tdms(
        tmp_path / "rig.tdms",
        [
            ChannelObject("Messung", "Drehmoment", TORQUE * 1000, wave("mNm")),
            ChannelObject("Messung", "Beschleunigung", TORQUE[:7], wave("g")),
            ChannelObject("Messung", "Winkel", np.rad2deg(ANGLE), wave("deg")),
        ],
    )
    recording = read_recording(path, assembly="A1")
    np.testing.assert_allclose(recording.torque, TORQUE, rtol=1e-14)
    np.testing.assert_allclose(recording.angle, ANGLE, rtol=1e-14)
    assert recording.sampling_rate == RATE
    assert recording.meta == {
        "file": "rig.tdms", "channel": "Messung/Drehmoment", "unit_assumed": False,
        "rate_from": "property 'wf_increment'", "start_time": "2024-05-01T12:00:00.250000", "scale": 1e-3,
    }  # fmt: skip


def test_tdms_of_many_segments_and_groups(tmp_path):
    parts = np.array_split(TORQUE, 7)
    path = write_tdms(
        tmp_path / "rig.tdms",
        *(
            [ChannelObject("a", "torque", part, wave()), ChannelObject("b", "torque", -part, wave())]
            for part in parts
        ),
    )
    np.testing.assert_array_equal(read_recording(path, channel="a/torque").torque, TORQUE)
    np.testing.assert_array_equal(read_recording(path, channel="b/torque").torque, -TORQUE)
    np.testing.assert_array_equal(read_recording(path, channel=1).torque, -TORQUE)
    for arguments in ({}, {"channel": "torque"}):
        with pytest.raises(ValueError, match=r"channel ?= ?.*(a/torque.*b/torque|\[0, 1\])"):
            read_recording(path, **arguments)


def test_the_index_file_of_another_recording_is_not_believed(tmp_path):
    with TdmsWriter(str(tmp_path / "rig.tdms"), index_file=True) as writer:
        writer.write_segment([ChannelObject("g", "torque", TORQUE[:9], wave())])
    assert (tmp_path / "rig.tdms_index").exists()
    write_tdms(tmp_path / "rig.tdms", [ChannelObject("g", "torque", TORQUE, wave())])
    np.testing.assert_array_equal(read_recording(tmp_path / "rig.tdms").torque, TORQUE)


LINEAR = {
    "NI_Scaling_Status": "unscaled", "NI_Number_Of_Scales": 1, "NI_Scale[0]_Scale_Type": "Linear",
    "NI_Scale[0]_Linear_Slope": 0.25, "NI_Scale[0]_Linear_Y_Intercept": -3.0,
    "NI_Scale[0]_Linear_Input_Source": 0xFFFFFFFF,
}  # fmt: skip
COUNTS = np.arange(100, 160, dtype=np.int16)


def scaled_tdms(path, place, scale):
    """Counts with a scale of the channel, its group or its file."""
    scales = {name: scale if name == place else {} for name in ("channel", "group", "file")}
    channel = ChannelObject("g", "torque", COUNTS, wave() | scales["channel"])
    return write_tdms(path, [RootObject(scales["file"]), GroupObject("g", scales["group"]), channel])


@pytest.mark.parametrize("place", ["channel", "group", "file"])
def test_a_tdms_scale_is_applied_wherever_it_stands(tmp_path, place):
    path = scaled_tdms(tmp_path / "rig.tdms", place, LINEAR)
    np.testing.assert_array_equal(read_recording(path).torque, 0.25 * COUNTS - 3)


@pytest.mark.parametrize("place", ["channel", "group", "file"])
@pytest.mark.parametrize(
    "change",
    [
        {"NI_Scale[0]_Scale_Type": "Fancy"},
        {"NI_Number_Of_Scales": 2},  # the second is not described
        {"NI_Number_Of_Scales": 2, "NI_Scale[1]_Scale_Type": "Strange"},
    ],
)
def test_a_tdms_scale_that_is_not_known_is_an_error_never_raw_counts(tmp_path, place, change):
    path = scaled_tdms(tmp_path / "rig.tdms", place, LINEAR | change)
    for arguments in ({}, {"scale": 2.0}):
        check_error(path, "rig.tdms: channel 'g/torque' has a scale that cannot be comp", **arguments)


def test_tdms_counts_without_a_scale_need_one(tmp_path):
    path = write_tdms(tmp_path / "a.tdms", [ChannelObject("g", "torque", COUNTS, wave(None))])
    check_error(path, "holds raw counts (int16) ... scale= (Nm per count)")
    np.testing.assert_array_equal(read_recording(path, scale=0.5).torque, 0.5 * COUNTS)
    path = write_tdms(
        tmp_path / "b.tdms", [ChannelObject("g", "torque", TORQUE, wave(NI_Scaling_Status="unscaled"))]
    )
    check_error(path, "holds raw counts (float64)")


def test_a_tdms_time_channel_gives_the_rate_where_no_property_does(tmp_path):
    start = np.datetime64("2024-05-01T12:00:00", "us")
    times = start + np.arange(500) * np.timedelta64(1_000, "us")
    path = write_tdms(
        tmp_path / "rig.tdms",
        [
            ChannelObject("g", "torque", TORQUE, {"unit_string": "Nm"}),
            ChannelObject("g", "timestamp", times),
            ChannelObject("g", "note", ["a", "b"]),
        ],
    )
    recording = read_recording(path)
    assert recording.sampling_rate == 1_000
    np.testing.assert_array_equal(recording.torque, TORQUE)
    check_error(path, "'g/note' must hold real numbers", channel="note", sampling_rate=1)


def test_one_channel_of_a_large_tdms_file_takes_the_memory_of_one(tmp_path):
    n, n_channels = 1_000_000, 16  # 8 MB each
    part = np.arange(n // 4, dtype=np.float64)
    path = write_tdms(
        tmp_path / "large.tdms",
        *(
            [ChannelObject("g", "torque" if c == 9 else f"c{c}", part + s, wave()) for c in range(n_channels)]
            for s in range(4)
        ),
    )
    assert path.stat().st_size > 120e6
    with peak_bytes() as peak:
        recording = read_recording(path)
    assert recording.n_samples == n
    assert recording.torque[-1] == part[-1] + 3
    assert peak[0] < 40e6


def interleaved(path, columns):
    """A TDMS file of interleaved float64 channels, byte by byte after NI's description of the format."""

    def text(value):
        return struct.pack("<I", len(value)) + value.encode()

    rows = len(columns[0][1])
    meta = struct.pack("<I", len(columns))
    for name, _ in columns:
        meta += text(f"/'g'/'{name}'") + struct.pack("<IIIQ", 20, 10, 1, rows)
        meta += struct.pack("<I", 1) + text("wf_increment") + struct.pack("<Id", 10, 1 / RATE)
    data = np.column_stack([values for _, values in columns]).astype("<f8").tobytes()
    toc = (1 << 1) | (1 << 2) | (1 << 3) | (1 << 5)
    path.write_bytes(
        b"TDSm" + struct.pack("<IIQQ", toc, 4713, len(meta) + len(data), len(meta)) + meta + data
    )


@pytest.mark.parametrize("n_samples", [500, 700_000])  # one part, and two parts of 8 MiB
def test_interleaved_tdms_is_read_in_parts(tmp_path, n_samples):
    torque, angle = np.resize(TORQUE, n_samples), 0.002 * np.arange(1, n_samples + 1)
    interleaved(tmp_path / "rig.tdms", [("torque", torque), ("angle", np.rad2deg(angle))])
    recording = read_recording(tmp_path / "rig.tdms", angle_unit="deg")
    np.testing.assert_array_equal(recording.torque, torque)
    np.testing.assert_allclose(recording.angle, angle, rtol=1e-14)
    assert recording.sampling_rate == RATE


# -- MATLAB


def hdf5_matlab(path, variables):
    """A file in MATLAB's v7.3 layout: 512 bytes of its own, arrays transposed, classes as attributes."""
    with h5py.File(path, "w", userblock_size=512) as file:
        _fill(file, file, variables)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(124) + b"\0\2IM")
    return path


def _fill(file, group, variables):
    for name, value in variables.items():
        if isinstance(value, dict):
            child = group.create_group(name)
            child.attrs["MATLAB_class"] = np.bytes_("struct")
            _fill(file, child, value)
        elif isinstance(value, str):
            data = group.create_dataset(name, data=np.frombuffer(value.encode("utf-16-le"), "<u2")[:, None])
            data.attrs["MATLAB_class"] = np.bytes_("char")
        elif isinstance(value, list):
            store = file.require_group("#refs#")
            cells = {f"{name}{i}": cell for i, cell in enumerate(value)}
            _fill(file, store, cells)
            references = np.array([[store[key].ref] for key in cells], dtype=h5py.ref_dtype)
            data = group.create_dataset(name, data=references)
            data.attrs["MATLAB_class"] = np.bytes_("cell")
        else:
            data = group.create_dataset(name, data=np.atleast_2d(value).T)
            data.attrs["MATLAB_class"] = np.bytes_("double")


def savemat_cells(path, variables, **options):
    """scipy's writer, with lists as cells."""

    def cells(value):
        if isinstance(value, dict):
            return {key: cells(inner) for key, inner in value.items()}
        return np.array(value, dtype=object) if isinstance(value, list) else value

    savemat(path, cells(variables), **options)
    return path


WRITERS = {
    "v5": savemat_cells,
    "v7": lambda path, variables: savemat_cells(path, variables, do_compression=True),
    "v7.3": hdf5_matlab,
}
writers = pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)


@writers
@pytest.mark.parametrize("column", [True, False])
def test_matlab_vectors(tmp_path, write, column):
    shaped = TORQUE[:, None] if column else TORQUE[None, :]
    path = write(tmp_path / "rig.mat", {"torque_nm": shaped, "fs": RATE, "angle_rad": ANGLE[:, None]})
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.torque, TORQUE)
    np.testing.assert_array_equal(recording.angle, ANGLE)
    assert recording.sampling_rate == RATE
    assert recording.meta["rate_from"] == "variable 'fs'"
    assert not recording.meta["unit_assumed"]


@writers
def test_matlab_structs_and_matrices(tmp_path, write):
    path = write(
        tmp_path / "rig.mat",
        {
            "rig": {"out": {"torque": TORQUE[:, None], "torque_unit": "kNm"}, "SampleRate": RATE},
            "other": {"torque": -TORQUE[:, None], "fs": 10.0},
            "data": np.column_stack([TORQUE, -TORQUE, 2 * TORQUE]),
            "flat": np.stack([TORQUE, 3 * TORQUE]),
        },
    )
    recording = read_recording(path, channel="rig.out.torque")
    np.testing.assert_allclose(recording.torque, 1000 * TORQUE, rtol=1e-14)
    assert recording.sampling_rate == RATE  # of its own struct
    assert read_recording(path, channel="other.torque").sampling_rate == 10
    for channel, right in (("data(:,2)", -TORQUE), ("flat(2,:)", 3 * TORQUE)):
        got = read_recording(path, channel=channel, sampling_rate=RATE)
        np.testing.assert_array_equal(got.torque, right)
    check_error(path, "channel = 'rig' does not exist; variables are ... 'rig.out.torque'", channel="rig")


@writers
def test_a_timetable_saved_as_a_struct(tmp_path, write):
    names = ["Drehmoment", "Winkel"]
    timetable = {
        "Time": (np.arange(500) / 1_000)[:, None],
        "Drehmoment": 1000 * TORQUE[:, None],
        "Winkel": np.rad2deg(ANGLE)[:, None],
        "Properties": {"VariableNames": names, "VariableUnits": ["mNm", "deg"], "SampleRate": np.nan},
    }
    recording = read_recording(write(tmp_path / "rig.mat", {"tt": timetable}))
    np.testing.assert_allclose(recording.torque, TORQUE, rtol=1e-14)
    np.testing.assert_allclose(recording.angle, ANGLE, rtol=1e-13)
    assert recording.sampling_rate == 1_000
    assert recording.meta["rate_from"] == "time variable 'tt.Time'"
    timetable["Properties"]["SampleRate"] = 1_000.0
    del timetable["Time"]
    assert read_recording(write(tmp_path / "b.mat", {"tt": timetable})).sampling_rate == 1_000


def test_a_struct_array_of_numbers_is_a_vector(tmp_path):
    rows = np.zeros((500, 1), dtype=[("torque", object), ("note", object)])
    rows["torque"][:, 0] = list(TORQUE)
    rows["note"][:, 0] = ["a"] * 500
    savemat(tmp_path / "rig.mat", {"rows": rows, "fs": RATE})
    np.testing.assert_array_equal(read_recording(tmp_path / "rig.mat").torque, TORQUE)
    check_error(tmp_path / "rig.mat", "'rows.note' must hold one number in each element", channel="rows.note")


@writers
def test_what_matlab_files_hold_besides_vectors_is_told(tmp_path, write):
    path = write(
        tmp_path / "rig.mat",
        {"c": ["a", 1.0], "cube": np.zeros((2, 3, 4)), "z": np.array([1j, 2]), "nothing": np.zeros((0, 0))},
    )
    check_error(path, "'c' is a cell array", channel="c", sampling_rate=1)
    check_error(path, "'cube' must be a vector", channel="cube", sampling_rate=1)
    check_error(path, "'z' must ... real numbers", channel="z", sampling_rate=1)


# -- Parquet


def test_parquet_of_pandas_and_of_pyarrow(tmp_path):
    frame = pd.DataFrame(
        {
            "Drehmoment [Nm]": TORQUE.astype(np.float32),
            "timestamp": pd.Timestamp("2024-05-01") + pd.to_timedelta(np.arange(500) * 500, unit="us"),
            "note": ["ä"] * 500,
        }
    )
    frame.to_parquet(tmp_path / "pandas.parquet", row_group_size=77)
    recording = read_recording(tmp_path / "pandas.parquet")
    np.testing.assert_array_equal(recording.torque, TORQUE.astype(np.float32))
    assert recording.sampling_rate == 2_000
    schema = pa.schema(
        [pa.field("M", pa.float64(), metadata={"unit": "mNm"}), pa.field("phi", pa.float64())],
        metadata={"sampling_rate": "25600"},
    )
    table = pa.table([1000 * TORQUE, np.rad2deg(ANGLE)], schema=schema)
    pq.write_table(table, tmp_path / "arrow.parquet")
    recording = read_recording(tmp_path / "arrow.parquet", channel="M", angle_channel="phi", angle_unit="deg")
    np.testing.assert_allclose(recording.torque, TORQUE, rtol=1e-14)
    np.testing.assert_allclose(recording.angle, ANGLE, rtol=1e-13)
    assert recording.sampling_rate == RATE


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([1.0, 2.0, None, 4.0], "holds nothing in row 3; it must hold a number"),
        (["a", "b"], "must hold real numbers, got string"),
    ],
)
def test_parquet_with_holes_or_words_is_refused(tmp_path, values, words):
    pq.write_table(pa.table({"torque": pa.array(values)}), tmp_path / "rig.parquet")
    check_error(tmp_path / "rig.parquet", f"column 'torque' {words}", sampling_rate=1)


# -- WAV


@pytest.mark.parametrize(("kind", "top"), [(np.int16, 2**15), (np.int32, 2**31), (np.uint8, 2**7)])
def test_wav_of_whole_numbers_needs_a_scale(tmp_path, kind, top):
    path, share = tmp_path / "rig.wav", np.linspace(-1, 0.99, 400)
    wavfile.write(path, 8_000, np.round(share * top + (top if kind is np.uint8 else 0)).astype(kind))
    with pytest.raises(ValueError, match=r"holds shares of full scale \(u?int.*scale= \(Nm at full"):
        read_recording(path)
    recording = read_recording(path, scale=50)
    np.testing.assert_allclose(recording.torque, 50 * share, atol=50 / top)
    assert recording.sampling_rate == 8_000


def test_wav_of_floats_is_taken_as_it_is(tmp_path):
    stereo = np.column_stack([TORQUE, -TORQUE]).astype(np.float32)
    wavfile.write(tmp_path / "rig.wav", 8_000, stereo)
    check_error(tmp_path / "rig.wav", "channel= must be given, ... : 0, 1 (no names in the file)")
    recording = read_recording(tmp_path / "rig.wav", channel=1)
    np.testing.assert_array_equal(recording.torque, stereo[:, 1])
    assert describe(recording)["unit_assumed"]


def test_wav_of_24_bits(tmp_path):
    values = np.round(np.linspace(-1, 0.999, 400) * 2**23).astype("<i4")
    data = values[:, None].view(np.uint8)[:, :3].tobytes()
    head = b"WAVEfmt " + struct.pack("<IHHIIHH", 16, 1, 1, 8_000, 24_000, 3, 24)
    body = head + b"data" + struct.pack("<I", len(data)) + data
    (tmp_path / "rig.wav").write_bytes(b"RIFF" + struct.pack("<I", len(body)) + body)
    np.testing.assert_allclose(
        read_recording(tmp_path / "rig.wav", scale=1).torque, values / 2**23, atol=1e-9
    )


# -- Excel


def write_xlsx(path, **sheets):
    """Write a workbook; each sheet is a list of rows."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets.items():
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


EXCEL = [["Zeit", "Drehmoment"], ["ms", "mNm"], [0, 21_900], [0.5, "22100,5"], [1, 22_000]]


def test_excel_sheets_are_read_as_csv_files_are(tmp_path):
    one = read_recording(write_xlsx(tmp_path / "one.xlsx", Messung=EXCEL, leer=[]))
    np.testing.assert_allclose(one.torque, [21.9, 22.1005, 22.0], rtol=1e-15)
    assert (one.sampling_rate, one.meta["channel"]) == (2000.0, "Drehmoment")
    notes = [["Rig", "R2"], [], ["by", "me, you"]]
    two = read_recording(write_xlsx(tmp_path / "two.xlsx", Info=notes, Messung=EXCEL))
    assert two.meta["channel"] == "Messung/Drehmoment"
    assert two.torque.tolist() == one.torque.tolist()


def test_a_recording_that_went_through_excel_keeps_its_labels(tmp_path):
    recording = Recording(TORQUE, RATE, angle=ANGLE, worn_lobes=(0, 4), assembly="A, 1", meta={"a": [1, 2]})
    write_recording(tmp_path / "run.csv", recording)
    with (tmp_path / "run.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    rows = [[float(c) if c.lstrip("-")[:1].isdigit() and "]" not in c else c for c in row] for row in rows]
    found = read_recording(write_xlsx(tmp_path / "run.xlsx", S=rows))
    np.testing.assert_allclose(found.torque, TORQUE, rtol=1e-14)  # openpyxl writes 16 digits
    np.testing.assert_allclose(found.angle, ANGLE, rtol=1e-14)
    assert found.replace(torque=recording.torque, angle=recording.angle) == recording


@pytest.mark.parametrize(
    ("sheets", "message"),
    [
        ({"S": [*EXCEL, [1.5, None]]}, "row 6, column 'Drehmoment' holds nothing; it must hold a number"),
        ({"S": [*EXCEL, [1.5, "=1+2"]]}, "row 6, column 'Drehmoment' holds nothing"),
        ({"S": [*EXCEL, [1.5, "#DIV/0!"]]}, "row 6, column 'Drehmoment' holds '#DIV/0!', which is not"),
        ({"A": EXCEL, "B": [*EXCEL, ["x"]]}, "channel= must be ... fit: 'A/Drehmoment', 'B/Drehmoment'"),
        (
            {"I": [["note"], ["more"]], "B": [*EXCEL, [1.5, "x"]]},
            "row 6 of sheet 'B', column 'Drehmoment' holds 'x'",
        ),
        ({"S": []}, "wrong.xlsx holds no sheet with data"),
    ],
)
def test_wrong_cells_of_excel_are_named(tmp_path, sheets, message):
    check_error(write_xlsx(tmp_path / "wrong.xlsx", **sheets), message)


# -- files of other programs whose libraries may be missing


def write_hdf5(path):
    with h5py.File(path, "w") as file:
        run = file.create_group("run")
        run.attrs["fs"] = RATE
        run.create_dataset("torque", data=1000 * TORQUE).attrs["unit"] = "mNm"
        file["run/table"] = np.array(list(zip(ANGLE, TORQUE, strict=True)), [("angle", float), ("M", float)])


def write_mdf(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF() as file:
        for name, step in (("run", 1 / RATE), ("slow", 1.0)):
            times = step * np.arange(500)
            signals = [asammdf.Signal(TORQUE / step / RATE, times, "Nm", name="torque")]
            file.append(signals, acq_name=name)
        file.save(path)


def write_universal(path):
    pyuff = pytest.importorskip("pyuff")
    pyuff.UFF(str(path)).write_sets(
        pyuff.prepare_58(
            id1="run/torque", func_type=1, rsp_node=1, rsp_dir=1, ref_node=1, ref_dir=1, data=TORQUE,
            binary=0, x=np.arange(500) / RATE, abscissa_inc=1 / RATE, abscissa_spacing=1, abscissa_min=0.0,
            abscissa_spec_data_type=17, ordinate_spec_data_type=9, orddenom_spec_data_type=0,
            ordinate_axis_units_lab="Nm",
        )
    )  # fmt: skip


@pytest.mark.parametrize(
    ("suffix", "write"), [(".h5", write_hdf5), (".mf4", write_mdf), (".uff", write_universal)]
)
def test_channels_of_measurement_files_have_units_and_rates(tmp_path, suffix, write):
    write(tmp_path / f"rig{suffix}")
    recording = read_recording(tmp_path / f"rig{suffix}", channel="run/torque", angle_channel=False)
    np.testing.assert_allclose(recording.torque, TORQUE, rtol=1e-9)
    assert recording.sampling_rate == pytest.approx(RATE)
    assert not recording.meta["unit_assumed"]


# -- damaged files


def as_rows(columns):
    """The names of columns, then their rows."""
    return [list(columns), *zip(*(values.tolist() for values in columns.values()), strict=True)]


def write_parts(path, columns):
    """Write a TDMS file of a group "Größe" in three segments."""
    parts = ([np.array_split(values, 3)[k] for values in columns.values()] for k in range(3))
    channels = (
        [ChannelObject("Größe", *it, wave()) for it in zip(columns, part, strict=True)] for part in parts
    )
    write_tdms(path, [RootObject({"a": 1})], *filter(None, channels))


def write_lines(path, columns):
    lines = (";".join(map(str, row)) for row in as_rows(columns))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


# Writers of columns in files of each kind.
KINDS = {
    "npz.npz": lambda path, columns: np.savez_compressed(path, **columns, sampling_rate=RATE),
    "tdms.tdms": write_parts,
    "v4.mat": lambda path, columns: savemat(path, columns | {"fs": RATE}, format="4"),
    "v5.mat": lambda path, columns: savemat_cells(path, {"rig": columns | {"fs": RATE, "n": ["a", "b"]}}),
    "v7.mat": lambda path, columns: savemat(path, columns | {"fs": RATE}, do_compression=True),
    "v73.mat": lambda path, columns: hdf5_matlab(path, columns | {"fs": RATE}),
    "parquet.parquet": lambda path, columns: pq.write_table(pa.table(columns), path),
    "wav.wav": lambda path, columns: wavfile.write(path, 25_600, columns["torque"]),
    "xlsx.xlsx": lambda path, columns: write_xlsx(path, S=as_rows(columns)),
    "csv.csv": write_lines,
}


def attempt(path, limit_s=1.0):
    """What reading gives: the recording, or the message of its one clear error."""
    rate = None if path.suffix in (".npz", ".tdms", ".wav", ".mat") else RATE
    begin = time.process_time()
    try:
        return read_recording(path, sampling_rate=rate)
    except ValueError as error:
        message = str(error)
        assert path.name in message
        assert "\n" not in message
        assert len(message) < 1_000
        return message
    finally:
        assert time.process_time() - begin < limit_s


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """The bytes of a good file of each kind."""
    files = {}
    for kind, write in KINDS.items():
        path = tmp_path_factory.mktemp("good") / kind
        write(path, {"torque": TORQUE})
        recording = attempt(path, limit_s=60)  # imports the libraries too
        # openpyxl writes 16 digits, one too few to give back every bit.
        np.testing.assert_allclose(recording.torque, TORQUE, rtol=5e-16 if path.suffix == ".xlsx" else 0)
        files[kind] = path.read_bytes()
    return files


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "csv.csv"])
def test_a_truncated_file_is_an_error(good, tmp_path, kind):
    # Not CSV: a text file that ends early at a line's end is a shorter text file.
    whole = good[kind]
    path = tmp_path / kind
    for length in sorted({1, 3, 4, 5, 27, 28, 29, 127, 129, *np.linspace(1, len(whole) - 2, 60).astype(int)}):
        path.write_bytes(whole[:length])
        assert isinstance(attempt(path), str), f"{length} of {len(whole)} bytes"


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_flipped_and_random_bytes_give_a_recording_or_one_clear_error(good, tmp_path, kind):
    random = np.random.default_rng(7)
    whole = good[kind]
    path = tmp_path / kind
    with peak_bytes() as peak:
        for trial in range(30):
            damaged = bytearray(whole)
            # most of them in the first kilobyte, where the structure lies
            end = 1_000 if trial % 3 else len(whole)
            for position in random.integers(0, min(end, len(whole)), size=1 + trial % 4):
                damaged[position] = random.integers(256)
            path.write_bytes(damaged)
            attempt(path)
    assert peak[0] < 500e6


@pytest.mark.parametrize("kind", KINDS)
def test_noise_is_no_recording(tmp_path, kind):
    random = np.random.default_rng(8)
    path = tmp_path / kind
    for size in (1, 16, 100, 5_000):
        path.write_bytes(random.bytes(size))
        assert isinstance(attempt(path), str)


def test_every_kind_under_every_other_name_is_told(good, tmp_path):
    for kind, content in good.items():
        for suffix in {f".{name.rpartition('.')[2]}" for name in good} - {f".{kind.rpartition('.')[2]}"}:
            path = tmp_path / f"wrong{suffix}"
            path.write_bytes(content)
            message = attempt(path)
            assert isinstance(message, str), (kind, suffix)
            if kind in ("npz.npz", "xlsx.xlsx"):  # both are ZIP archives
                assert suffix in (".npz", ".xlsx") or "it begins like a .npz or .xlsx file" in message
            elif kind not in ("csv.csv", "v4.mat"):  # these have no mark of their own
                assert f"it begins like a .{kind.rpartition('.')[2]} file" in message


@pytest.mark.parametrize("kind", KINDS)
def test_no_channels_and_too_few_samples_are_errors_in_every_kind(tmp_path, kind):
    path, cases = tmp_path / kind, [{}, {"torque": TORQUE[:0]}, {"torque": TORQUE[:1]}]
    for columns in cases[2 * (kind == "wav.wav") :]:  # scipy writes no empty sound
        KINDS[kind](path, columns)
        message = attempt(path, 5)
        assert isinstance(message, str)
        assert columns or "holds no" in message or "no table" in message, message


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("kind", sorted(KINDS.keys() - {"xlsx.xlsx"}))
def test_what_is_not_finite_is_named_with_its_place(tmp_path, kind, value):
    KINDS[kind](tmp_path / kind, {"torque": np.where(np.arange(500) == 137, value, TORQUE)})
    message = attempt(tmp_path / kind, 5)
    assert "finite" in message
    assert {"csv.csv": "line 139", "parquet.parquet": "row 138"}.get(kind, "sample 137") in message


@pytest.mark.parametrize("kind", ["npz.npz", "tdms.tdms", "parquet.parquet", "csv.csv"])
def test_names_beyond_ascii(tmp_path, kind):
    name, folder = "Drehmoment_Prüfstand 3 – 摆线 [Nm]", tmp_path / "Messung – Ü"
    folder.mkdir()
    KINDS[kind](folder / kind, {name: TORQUE, "b": -TORQUE})
    channel = f"Größe/{name}" if kind == "tdms.tdms" else name
    recording = read_recording(folder / kind, channel=channel, sampling_rate=RATE)
    np.testing.assert_array_equal(recording.torque, TORQUE)
    assert not recording.meta["unit_assumed"]


@pytest.mark.parametrize(
    ("offset", "value", "words"),
    [
        (0, b"TDSx", "no TDMS file"),
        (8, struct.pack("<I", 9999), "TDMS version 9999"),
        (12, struct.pack("<Q", 2**64 - 1), "not whole.*no end"),
        (12, struct.pack("<Q", 2**40), "not whole.*no end"),
        (12, struct.pack("<Q", 3), "data after its end|does not begin"),
        (20, struct.pack("<Q", 2**50), "data after its end"),
    ],
)
def test_a_broken_tdms_lead_in(good, tmp_path, offset, value, words):
    damaged = bytearray(good["tdms.tdms"])
    damaged[offset : offset + len(value)] = value
    path = tmp_path / "rig.tdms"
    path.write_bytes(damaged)
    with pytest.raises(ValueError, match=f"rig.tdms.*({words})"):
        read_recording(path)


@pytest.mark.parametrize(
    ("name", "library"),
    [
        ("tdms.tdms", "nptdms"), ("parquet.parquet", "pyarrow.parquet"), ("v73.mat", "h5py"),
        ("xlsx.xlsx", "openpyxl"),
    ],
)  # fmt: skip
def test_a_missing_library_is_named(good, tmp_path, monkeypatch, name, library):
    (tmp_path / name).write_bytes(good[name])
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=r"needs (npTDMS|pyarrow|h5py|openpyxl): pip install \1"):
        read_recording(tmp_path / name, sampling_rate=RATE)


# -- files made to break a reader

MANY = 500_000


def write_zip(path, name, content):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)


def write_h5(path, fill):
    with h5py.File(path, "w") as file:
        fill(file)


def add_links(file):
    for k in range(10):
        file[f"loop{k}"], file[f"soft{k}"] = file["/"], h5py.SoftLink(f"/soft{9 - k}")
    file["torque"] = h5py.ExternalLink("secret.h5", "torque")


def write_sheet(path, place):
    book = openpyxl.Workbook()
    book.active[place] = 1
    book.create_sheet("empty")
    book.save(path)


def write_flat(path, **properties):
    write_tdms(path, [ChannelObject("g", "torque", np.ones(9), properties)])


def nest(depth):
    return {"a": nest(depth - 1)} if depth else {"torque": np.ones(9)}


CLAIM = b"\x93NUMPY\x01\0\x76\0" + b"{'descr': '<f8', 'fortran_order': False, 'shape': (%d,), }" % 10**12
HOSTILE = {
    "row.csv": b"1," * MANY,
    "names.csv": b",".join([b"a"] * MANY) + b"\n1\n",
    "quote.csv": b"torque\n1\n" + b'"' + b"2" * 3_000_000 + b"\n",
    "digits.csv": b"torque\n1\n" + b"2" * 3_000_000 + b"\n",
    "empty lines.csv": b"\n" * MANY,
    "comment.csv": b"#" * 3_000_000 + b"\n1\n2\n",
    "numbers.csv": b"9" * MANY + b"\n" + b"9" * MANY + b"\n",
    "head.csv": b"rig;7\n" * 200_000 + b"time,torque\n" + b"1,2\n" * 99,
    "nan times.csv": b"time,torque\n" + b"0.1,1\nnan,2\n" * 99,
    "backwards.csv": b"time,torque\n" + b"".join(b"%d,1\n" % -i for i in range(999)),
    "wrong clock.csv": b"time,torque\n" + b"".join(b"25:61:%02d,1\n" % (i % 100) for i in range(999)),
    "no clock.csv": b"time,torque\n" + b"10:00:00.1,1\nnoon,2\n" * 99,
    "bomb.csv.gz": gzip.compress(b"torque\n" + b"1\n" * 10_000_000, 1),
    "bomb.npz": lambda path: np.savez_compressed(path, torque=np.zeros(2_000_000)),
    "small.npz": lambda path: np.savez_compressed(path, torque=np.zeros(4_000_000, "i1")),
    "claim.npz": lambda path: write_zip(path, "torque.npy", CLAIM.ljust(127) + b"\n"),
    "bomb.xlsx": lambda path: write_zip(path, "xl/worksheets/sheet1.xml", b"<row>" * 9_000_000),
    "far row.xlsx": lambda path: write_sheet(path, "A200000"),
    "far column.xlsx": lambda path: write_sheet(path, "XFD1"),
    "links.h5": lambda path: write_h5(path, add_links),
    "links.mat": lambda path: write_h5(path, add_links),
    "claim.h5": lambda path: write_h5(path, lambda f: f.create_dataset("a", (10**12,), "f8", chunks=(9,))),
    "deep.h5": lambda path: write_h5(path, lambda file: file.create_group("/a" * 400)),
    "types.h5": lambda path: write_h5(path, lambda file: file.update(a=[b"x"], b=1j, c=h5py.Empty("f"))),
    "deep.mat": lambda path: savemat(path, nest(25)),
    "wide.mat": lambda path: savemat(path, {"torque": np.ones((300, 300))}),
    "many.mat": lambda path: savemat(path, {f"a{k}": [1, 2] for k in range(11_000)}),
    "negative.tdms": lambda path: write_flat(path, wf_increment=-1.0),
    "nan.tdms": lambda path: write_flat(path, wf_increment=float("nan")),
    "scales.tdms": lambda path: write_flat(path, wf_increment=1.0, NI_Number_Of_Scales=2**31 - 1),
    "lists.parquet": lambda path: pq.write_table(pa.table({"torque": [[1.0], [2.0]]}), path),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_give_one_clear_error_in_little_memory(tmp_path, monkeypatch, name):
    monkeypatch.setattr(_columns, "LARGEST_UNPACKED", 10**7)  # in place of 2 GB: the test stays cheap
    path, content = tmp_path / name, HOSTILE[name]
    path.write_bytes(content) if isinstance(content, bytes) else content(path)
    with peak_bytes() as peak, pytest.raises(ValueError, match=name) as caught:
        read_recording(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1_000
    assert peak[0] <= 3 * path.stat().st_size + 40e6
