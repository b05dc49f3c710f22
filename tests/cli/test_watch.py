"""Watching a folder: what is whole, what is new, what is bad, and the process that does it."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from command import call
from small_model import recording

from cyclofeat.cli import main
from cyclofeat.cli.watch import DoneList, FolderWatch


def put(path, n, tachometer=True):
    """A recording that appears at once; the speed of a healthy disc is confirmed by a tachometer alone."""
    part, one = path.with_name(f".{path.name}.part.npz"), recording(range(2, 2 + n), seed=99)
    known = {"angle": one.angle} if tachometer else {}
    np.savez(part, torque=one.torque, sampling_rate=one.sampling_rate, **known)
    part.rename(path)


# What is whole and new, with a clock of our own


@pytest.fixture
def watch(tmp_path):
    return FolderWatch(tmp_path, (".csv", ".npz"), 1.0, DoneList(), ignored={"recordings.csv"})


def names(paths):
    return [path.name for path in paths]


def test_a_file_is_told_of_once_it_has_come_to_rest(watch, tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("1", encoding="utf-8")
    assert watch.poll(0.0) == []
    file.write_text("12", encoding="utf-8")  # still being written
    assert watch.poll(1.0) == []
    assert watch.unsettled_names == {"a.csv"}
    assert watch.poll(1.9) == []
    assert names(watch.poll(2.0)) == ["a.csv"]
    watch.mark_counted(file)
    assert watch.poll(9.0) == []
    file.write_text("123", encoding="utf-8")
    assert watch.poll(10.0) == []
    assert names(watch.poll(11.0)) == ["a.csv"]  # another recording under the same name


def test_same_size_and_time_in_another_file_is_another_file(watch, tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("1", encoding="utf-8")
    watch.poll(0.0)
    watch.mark_counted(watch.poll(1.0)[0])
    (tmp_path / "b.part").write_text("2", encoding="utf-8")
    os.utime(tmp_path / "b.part", ns=(file.stat().st_atime_ns, file.stat().st_mtime_ns))
    (tmp_path / "b.part").rename(file)
    watch.done = DoneList()
    assert watch.poll(2.0) == []
    assert names(watch.poll(3.0)) == ["a.csv"]


def test_what_is_no_recording_is_left_alone(watch, tmp_path):
    for name in (".a.csv", "a.csv.part", "a.txt", "recordings.csv"):
        (tmp_path / name).write_text("1", encoding="utf-8")
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "nowhere.csv").symlink_to(tmp_path / "absent")
    (tmp_path / "B.CSV").write_text("1", encoding="utf-8")
    watch.poll(0.0)
    assert names(watch.poll(5.0)) == ["B.CSV"]


def test_a_bad_file_is_told_of_once_and_late(watch, tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("1", encoding="utf-8")
    watch.poll(0.0)
    watch.mark_failed(watch.poll(1.0)[0], "half")
    assert watch.bad_files(1.0) == []  # its writer may only have paused
    file.write_text("12", encoding="utf-8")
    watch.poll(3.0)
    assert watch.bad_files(9.0) == []  # nothing is wrong with what has not been tried
    watch.mark_failed(watch.poll(9.0)[0], "still bad")
    assert watch.bad_files(9.0) == [(file, "still bad")]
    assert watch.bad_files(99.0) == []
    file.write_text("123", encoding="utf-8")
    watch.poll(100.0)
    watch.mark_failed(watch.poll(101.0)[0], "bad for ever")
    assert watch.bad_files(999.0) == []


def test_a_file_that_goes_away_is_forgotten(watch, tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("1", encoding="utf-8")
    watch.poll(0.0)
    file.unlink()
    assert watch.poll(1.0) == []
    file.write_text("1", encoding="utf-8")
    assert watch.poll(2.0) == []


def test_what_is_done_stays_done_after_a_cut_line(tmp_path):
    file = tmp_path / "done.jsonl"
    done = DoneList(file)
    done.add("ä.csv", (1, 2, 3))
    done.add("b.csv", (4, 5, 6))
    done.write()
    whole = file.read_bytes()
    file.write_bytes(whole[:-7])  # killed while it wrote
    again = DoneList(file)
    assert again.holds("ä.csv", (1, 2, 99))
    assert not again.holds("ä.csv", (1, 3, 3))
    assert not again.holds("b.csv", (4, 5, 6))
    assert file.read_bytes() == whole[:-7]  # nothing is changed before there is something to write
    again.add("b.csv", (4, 5, 6))
    again.write()
    written = file.read_bytes()
    again.write()
    assert file.read_bytes() == written
    assert DoneList(file).holds("b.csv", (4, 5, 6))
    for other in (whole[5:], b"a letter to a friend", b'{"my": "design"}'):
        file.write_bytes(other)
        with pytest.raises(ValueError, match="not a list that watch wrote"):
            DoneList(file)
        assert file.read_bytes() == other


def test_what_cannot_be_written_is_written_later(tmp_path):
    file = tmp_path / "done.jsonl"
    done = DoneList(file)
    done.add("a.csv", (1, 2, 3))
    done.write()
    whole = file.read_bytes()
    done.add("b.csv", (4, 5, 6))
    file.unlink()
    file.mkdir()  # in its place, as a share that is gone
    for _ in range(2):
        with pytest.raises(OSError, match="directory"):
            done.write()
        assert done.holds("b.csv", (4, 5, 99))
    file.rmdir()
    file.write_bytes(whole)
    done.write()
    assert DoneList(file).holds("b.csv", (4, 5, 6))
    assert file.read_bytes().startswith(whole)


# The command


def once(capsys, folder, shaft_options, *options):
    code = main(["watch", str(folder), *shaft_options, "--once", "--speed", "500",
                 "--settle", "0.1", *options])  # fmt: skip
    out, err = capsys.readouterr()
    return code, out, err


@pytest.mark.slow
def test_once_counts_what_is_there_and_remembers(capsys, tmp_path, shaft_options):
    put(tmp_path / "healthy.npz", 0)
    put(tmp_path / "worn.npz", 3)
    done = ("--done", str(tmp_path / "done.csv"))
    code, out, err = once(capsys, tmp_path, shaft_options, *done)
    assert code == 0
    healthy, worn = out.splitlines()
    assert "healthy.npz: 0 worn lobes (probability" in healthy
    assert "worn.npz: 3 worn lobes (probability" in worn
    assert "s unused; note: positions are relative" in worn
    assert worn.endswith("; note: the file states no unit of the angle: rad assumed")
    assert err == "cyclofeat: done: 2 counted, 0 could not be\n"
    (tmp_path / "garbage.npz").write_bytes(b"PK\3\4" + bytes(100))
    (tmp_path / "empty.csv").touch()
    code, out, err = once(capsys, tmp_path, shaft_options, "--json", *done)
    assert code == 2
    lines = [json.loads(line) for line in out.splitlines()]
    assert [os.path.basename(line["file"]) for line in lines] == ["empty.csv", "garbage.npz"]
    assert all(line["error"] for line in lines)
    assert err.count("cyclofeat: error: ") == 2
    # what was counted is done; what could not be may be another time
    code, out, err = once(capsys, tmp_path, shaft_options, *done)
    assert (code, out) == (2, "")
    assert err.count("cyclofeat: error: ") == 2


@pytest.mark.slow
def test_what_should_be_known_of_a_count_stands_in_its_line(capsys, tmp_path, shaft_options):
    put(tmp_path / "worn.npz", 3, tachometer=False)
    command = ["watch", str(tmp_path), *shaft_options, "--once", "--settle", "0.1"]
    (line,) = call(capsys, *command)[0].splitlines()
    assert "s unused; note: neither tachometer nor stated speed: 500.01 RPM found in the torque" in line


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("absent --model {m} --trust", "no such folder: absent"),
        ("{m} --model {m} --trust", "is a file: watch takes a folder"),
        ("{f} --model {m}", "can run any code"),
        ("{f} --model {m} --trust --settle 0", "--settle: must be a positive"),
        ("{f} --model {m} --trust --done {f}/no/d", "for --done does not exist"),
        ("{f} --model {m} --trust --allow all", "allow must name any of"),
    ],
)
def test_mistakes_are_told_at_the_start(capsys, tmp_path, shaft_options, options, message):
    before = signal.getsignal(signal.SIGTERM)
    assert main(["watch", *options.format(m=shaft_options[1], f=tmp_path).split()]) == 2
    assert message in capsys.readouterr().err
    assert signal.getsignal(signal.SIGTERM) is before


def lines_of(process, n):
    return [process.stdout.readline() for _ in range(n)]


@pytest.mark.skipif(os.name != "posix", reason="Windows sends Ctrl-C to all processes of a console")
@pytest.mark.slow
@pytest.mark.parametrize("ask", [signal.SIGTERM, signal.SIGINT])
def test_a_process_that_watches(capsys, tmp_path, shaft_options, ask):
    """Files in pieces, garbage, files renamed into place; a clean end, and nothing counted twice."""
    folder = tmp_path / "in"
    folder.mkdir()
    command = [
        sys.executable, "-m", "cyclofeat", "watch", str(folder), *shaft_options,
        "--json", "--speed", "500", "--interval", "0.1", "--settle", "0.4", "--done", str(tmp_path / "done"),
    ]  # fmt: skip
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert "watching" in process.stderr.readline()
        (folder / "garbage.npz").write_bytes(b"no zip")
        put(folder / "first.npz", 3)
        put(tmp_path / "whole.npz", 0)
        whole = (tmp_path / "whole.npz").read_bytes()
        with (folder / "slow.npz").open("wb", buffering=0) as file:
            for k in range(5):  # some pauses shorter, some longer than the time to settle
                file.write(whole[k * len(whole) // 5 : (k + 1) * len(whole) // 5])
                time.sleep(0.2 if k % 2 else 0.8)
        lines = [json.loads(line) for line in lines_of(process, 3)]
        process.send_signal(ask)
        rest, err = process.communicate(timeout=60)
    assert process.returncode == 0
    assert rest == ""
    said = {os.path.basename(line["file"]): line for line in lines}
    assert said["first.npz"]["defect_count"] == 3
    assert said["slow.npz"]["defect_count"] == 0
    assert "error" in said["garbage.npz"]
    assert err.count("error: ") == 1
    assert "Traceback" not in err
    assert err.endswith("stopped: 2 counted, 1 could not be\n")
    assert main([*command[3:], "--once"]) == 2  # what could not be counted is tried again
    (again,) = capsys.readouterr().out.splitlines()
    assert os.path.basename(json.loads(again)["file"]) == "garbage.npz"


@pytest.mark.slow
def test_killed_it_counts_nothing_twice(capsys, tmp_path, shaft_options):
    command = [
        sys.executable, "-m", "cyclofeat", "watch", str(tmp_path), *shaft_options,
        "--speed", "500", "--interval", "0.1", "--settle", "0.2", "--done", str(tmp_path / "done"),
    ]  # fmt: skip
    put(tmp_path / "a.npz", 0)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert "a.npz" in process.stdout.readline()
        deadline = time.monotonic() + 30
        while not (tmp_path / "done").read_bytes() and time.monotonic() < deadline:
            time.sleep(0.02)
        process.kill()
    put(tmp_path / "b.npz", 3)
    again = call(capsys, *command[3:], "--once")[0]
    assert "b.npz" in again
    assert "a.npz" not in again
