"""A folder and its manifest: every label arrives, every wrong line is named."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from cyclofeat.datasets import read_folder, write_recording
from cyclofeat.datasets.readers import folder_entries
from cyclofeat.recordings import Recording

TORQUE = 22 + np.random.default_rng(1).normal(size=50)


@pytest.fixture
def folder(tmp_path):
    for name in ("a", "b", "c"):
        (tmp_path / f"{name}.csv").write_text(
            "torque [Nm],x\n" + "".join(f"{t},1\n" for t in TORQUE), encoding="utf-8"
        )
    return tmp_path


def manifest(folder, text, encoding="utf-8"):
    (folder / "recordings.csv").write_text(text, encoding=encoding)
    return folder


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_every_label_of_a_manifest_arrives(folder, separator, encoding):
    rows = [
        "file,channel,sampling_rate,defect_count,worn_lobes_from_1,run,speed,load,source,assembly,n_lobes",
        "b.csv,torque,25600,,1 5,r1,500,22.5,measured,Getriebe ä,11",
        "",
        "a.csv,0,12800.5,3,,r2,,,,7,",
        "c.csv,,1000,,,,,,,,",
    ]
    text = "\n".join(rows).replace(",", separator)
    if separator != ",":
        text = text.replace("22.5", "22,5")
    first, second, third = read_folder(manifest(folder, text + "\n", encoding), channel="torque")
    assert (first.meta["file"], first.sampling_rate, first.worn_lobes) == ("b.csv", 25_600, (0, 4))
    assert (first.n_lobes, second.n_lobes) == (11, 15)
    assert (first.run, first.speed_rpm, first.load_nm) == ("r1", 500, 22.5)
    assert (first.source, first.assembly) == ("measured", "Getriebe ä")
    assert (second.sampling_rate, second.defect_count, second.assembly) == (12_800.5, 3, "7")
    assert (third.defect_count, third.assembly, third.run) == (None, None, None)
    np.testing.assert_array_equal(first.torque, TORQUE)


def test_wrong_and_missing_entries_are_all_named_by_line(folder):
    rows = ("a.csv,two,,1", "missing.csv,1,,1", ",1,,1", "b.csv,1,1;x,1", "b.csv,3,1 5,1", "c.csv,1,,fast")
    text = "\n".join(["file,defect_count,worn_lobes_from_1,sampling_rate", *rows, "c.csv,1", ""])
    with pytest.raises(ValueError) as caught:
        read_folder(manifest(folder, text))
    message = str(caught.value)
    for words in (
        "line 2: defect_count must be a whole number from 0, got 'two'",
        "line 3: no such file: missing.csv",
        "line 4: file is missing",
        "line 5: worn_lobes_from_1 must be lobes counted from 1 and separated by spaces, like 1 5, got '1;x'",
        "line 6: defect_count must be the number of worn_lobes_from_1, got 3 and '1 5'",
        "line 7: sampling_rate must be a positive number, got 'fast'",
        "line 8: 4 columns are right, got 2",
    ):
        assert words in message
    assert message.startswith("recordings.csv: ")
    assert "\n" not in message


@pytest.mark.parametrize(
    ("column", "cells", "right"),
    [
        ("sampling_rate", ["0", "-1", "nan", "inf", "1e999", "1_000", "1.000.000"], "a positive number"),
        ("speed", ["0", "-500", "NaN", "500 RPM"], "a positive number"),
        ("scale", ["0", "-inf", "0x10"], "a number other than 0"),
        ("load", ["nan", "-1e999", "22_5"], "a number"),
        ("defect_count", ["-1", "2.0", "1_0"], "a whole number from 0"),
        ("n_lobes", ["1", "15.5"], "a whole number from 2"),
        (
            "worn_lobes_from_1",
            ["-1", "0 4", "1 1_0", "nan"],
            "lobes counted from 1 and separated by spaces, like 1 5",
        ),
    ],
)
def test_a_bad_number_is_blamed_on_its_line_and_column(folder, column, cells, right):
    text = f"file,{column}\nb.csv,\n" + "".join(f"a.csv,{cell}\n" for cell in cells)
    with pytest.raises(ValueError) as caught:
        folder_entries(manifest(folder, text))
    lines = [f"line {3 + index}: {column} must be {right}, got {cell!r}" for index, cell in enumerate(cells)]
    assert str(caught.value) == "recordings.csv: " + "; ".join(lines)


def test_a_manifest_that_does_not_say_from_where_lobes_count_is_refused(folder):
    message = "recordings.csv: line 1: worn_lobes does not say .* name it worn_lobes_from_1 and count from 1"
    with pytest.raises(ValueError, match=message):
        folder_entries(manifest(folder, "file,worn_lobes\na.csv,0 4\n"))


def test_recordings_that_cannot_be_read_are_named_by_line_too(folder):
    (folder / "b.csv").write_text("torque,x\n1,nan\nnan,1\n", encoding="utf-8")
    text = "file,sampling_rate,defect_count\na.csv,,0\nb.csv,1,0\nc.csv,1,40\n"
    with pytest.raises(ValueError) as caught:
        read_folder(manifest(folder, text))
    for words in (
        "line 2: a.csv: no sampling rate",
        "line 3: b.csv: column 'torque' must be finite, got nan at line 3",
        "line 4: c.csv: defect_count must be at most n_lobes = 15",
    ):
        assert words in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("file,colour\na.csv,red\n", "line 1: unknown column 'colour'; known are file, channel"),
        ("run,run,file\n1,2,a.csv\n", "column 'run' is there 2 times"),
        ("run\n1\n", "no column 'file'; columns are run"),
        ("file\n", "names no recording"),
        ("file\na.csv\na.csv\n", "line 3: a.csv is there already, in line 2"),
    ],
)
def test_manifests_that_are_none(folder, text, words):
    with pytest.raises(ValueError, match=f"recordings.csv.*{words}"):
        read_folder(manifest(folder, text), sampling_rate=1)


def test_recordings_left_out_are_told(folder):
    manifest(folder, "file,sampling_rate\na.csv,1\n")
    with pytest.warns(UserWarning, match="recordings.csv does not name b.csv, c.csv: not read"):
        assert len(read_folder(folder)) == 1


def test_two_channels_of_one_file_are_two_recordings(folder):
    manifest(folder, "file,channel,sampling_rate\na.csv,torque,1\na.csv,x,1\nb.csv,x,1\nc.csv,x,1\n")
    assert [r.meta["channel"] for r in read_folder(folder)] == ["torque [Nm]", "x", "x", "x"]


def test_without_a_manifest_all_files_are_read_by_name(tmp_path):
    for name in ("b.npz", "a.csv"):
        write_recording(tmp_path / name, Recording(TORQUE, 100, run=name))
    (tmp_path / "notes.txt").write_text("hello", encoding="utf-8")
    assert [recording.run for recording in read_folder(tmp_path)] == ["a.csv", "b.npz"]
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress((tmp_path / "a.csv").read_bytes()))
    assert [entry.path.name for entry in folder_entries(tmp_path)] == ["a.csv", "a.csv.gz", "b.npz"]
    manifest(tmp_path, "file\na.csv.gz\nb.npz\na.csv\n")
    assert [recording.run for recording in read_folder(tmp_path)] == ["a.csv", "b.npz", "a.csv"]
    with pytest.raises(FileNotFoundError, match="no such folder"):
        read_folder(tmp_path / "missing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"holds no .csv, .csv.gz, .npz, .* .wav or .xlsx recordings"):
        read_folder(tmp_path / "empty")
    with pytest.raises(ValueError, match="is no folder; use read_recording"):
        read_folder(tmp_path / "a.csv")
    for name in ("run.lvm", "notes.log"):  # one is data by its name, the other may be anything
        (tmp_path / "empty" / name).write_bytes((tmp_path / "a.csv").read_bytes())
    assert [entry.path.name for entry in folder_entries(tmp_path / "empty")] == ["run.lvm"]
