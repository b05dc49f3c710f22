"""Counts of gearboxes over time, by the command line."""

import json
import os
import sqlite3

import pytest
from command import call
from pages import parse, without_pictures, words
from small_model import recording, unlike_training

from cyclofeat.cli import main
from cyclofeat.datasets import write_recording
from cyclofeat.history import History

COUNTS = [0] * 8 + [None] + [0] * 2 + [3] * 7
WATCH = ["--once", "--no-strict", "--settle", "0.01"]
START, HOUR = 1_790_000_000, 3600
RATES = ["--false-alarms-per-month", "5", "--recordings-per-month", "730"]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Eleven sound discs, one an hour, of which one is refused, then seven with three worn lobes."""
    folder = tmp_path_factory.mktemp("press-4")
    paths = []
    for k in range(18):
        worn = (2, 3, 4) if k >= 11 else ()
        path = folder / f"{k:02}.npz"
        one = recording(worn, seed=250 + k, assembly=None)
        if k == 8:
            one = one.replace(torque=unlike_training().torque)
        write_recording(path, one)
        os.utime(path, (START + k * HOUR,) * 2)
        paths.append(str(path))
    return paths


@pytest.fixture(scope="module")
def history(tmp_path_factory, shaft_options, files):
    """What count has kept of all of them."""
    file = tmp_path_factory.mktemp("history") / "a.sqlite"
    words = [*shaft_options, "--history", str(file), "--gearbox", "press 4"]
    assert main(["count", *files, *words, *RATES, "--jsonl"]) == 0
    return file


def lines_of(capsys, *arguments):
    """Lines of JSON that a command prints."""
    return [json.loads(line) for line in call(capsys, *arguments)[0].splitlines()]


@pytest.mark.slow
def test_count_keeps_each_recording_and_prints_a_line(history, shaft_options, files, capsys):
    again = [*shaft_options, "--history", str(history), "--gearbox", "press 4"]
    lines = lines_of(capsys, "count", *files[-2:], *again, *RATES, "--jsonl")
    assert [line["file"] for line in lines] == files[-2:]
    assert [line["defect_count"] for line in lines] == [3, 3]
    assert [line["alarm"] for line in lines] == [True, True]
    with History(history) as read:
        rows = read.rows("press 4")
    assert [row.defect_count for row in rows] == COUNTS
    assert [row.time for row in rows] == [START + k * HOUR for k in range(18)]
    assert "press 4: ALARM since 2026-" in call(capsys, "count", files[-1], *again, *RATES)[0]


def test_the_gearbox_has_a_name(shaft_options, files, tmp_path, capsys):
    to = [*shaft_options, "--history", str(tmp_path / "a.sqlite")]
    _, err = call(capsys, "count", files[0], *to, code=2)
    assert "00.npz: the file states no assembly: give --gearbox NAME" in err
    write_recording(tmp_path / "b.npz", recording((), seed=300, assembly="lathe"))
    call(capsys, "count", tmp_path / "b.npz", *to)
    with History(tmp_path / "a.sqlite") as read:
        assert read.gearboxes() == ["lathe"]


def test_a_recording_has_the_time_that_its_file_states(shaft_options, tmp_path, capsys):
    to = [*shaft_options, "--history", str(tmp_path / "a.sqlite"), "--gearbox", "x"]
    disc = recording((), seed=300)
    times = ["2026-03-01T12:30:00", "2026-03-01T14:30:00+01:00", "2026-03-01T14:30:00.000000"]
    for k, time in enumerate([*times, "yesterday"]):
        write_recording(tmp_path / f"{k}.npz", disc.replace(meta={"start_time": time}))
        _, err = call(capsys, "count", tmp_path / f"{k}.npz", *to, code=2 if k == 3 else 0)
    assert "start_time must be a time as 2026-03-01T14:30:00 (UTC, unless" in err
    with History(tmp_path / "a.sqlite") as read:
        assert [(row.time - 1_772_368_200) / HOUR for row in read.rows("x")] == [0, 1, 2]


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--false-alarms-per-month", "0", "-month: must be a positive, finite number, got '0'"),
        ("--recordings-per-month", "nan", "-month: must be a positive, finite number, got 'nan'"),
        ("--gearbox", "", "--gearbox must be a name, got an empty one"),
    ],
)
@pytest.mark.parametrize("command", ["count", "watch"])
def test_a_wrong_option_is_an_error_before_anything_is_counted(
    command, option, value, message, shaft_options, files, tmp_path, capsys
):
    file = tmp_path / "a.sqlite"
    what = [files[0]] if command == "count" else [os.path.dirname(files[0]), "--once"]
    words = [*shaft_options, "--history", str(file), option, value]
    out, err = call(capsys, command, *what, *words, code=2)
    assert (out, message in err, option in err, file.exists()) == ("", True, True, False)


@pytest.mark.slow
def test_watch_keeps_what_arrives(shaft_options, files, tmp_path, capsys):
    file = tmp_path / "a.sqlite"
    folder = os.path.dirname(files[0])
    to = [*WATCH, *shaft_options, "--history", str(file)]
    lines = lines_of(capsys, "watch", folder, *to, *RATES, "--json")
    assert [line["defect_count"] for line in lines] == COUNTS
    name = os.path.basename(folder)
    assert {line["gearbox"] for line in lines} == {name}
    alarms = [line["alarm"] for line in lines]
    assert alarms == sorted(alarms)
    assert alarms[-1]
    assert not alarms[11]
    # Without --done all are counted again.
    assert f"; {name}: ALARM since " in call(capsys, "watch", folder, *to, *RATES)[0]
    with History(file) as read:
        assert len(read.rows(name)) == 18


def test_watch_goes_on_where_the_history_cannot_be_written(shaft_options, files, tmp_path, capsys):
    file, done = tmp_path / "a.sqlite", tmp_path / "done.txt"
    History(file).close()
    connection = sqlite3.connect(file)
    connection.execute("ALTER TABLE recording RENAME TO away")
    connection.close()
    to = [*WATCH, *shaft_options, "--history", str(file)]
    out, err = call(capsys, "watch", os.path.dirname(files[0]), *to, "--done", done)
    assert (len(out.splitlines()), err.count("cannot be written, retrying")) == (18, 1)
    # What is not in the history is not done.
    assert done.read_text(encoding="utf-8") == ""


@pytest.mark.slow
def test_history_states_the_alarm_and_writes_the_page(history, tmp_path, capsys):
    page = tmp_path / "h.html"
    text = call(capsys, "history", history, *RATES, "--report", page, "--strict", code=3)[0]
    assert text.startswith("press 4: 3 worn lobes\n  18 recordings from 2026-")
    assert "  ALARM since 2026-" in text
    assert "false alarms per month at 730 recordings; a rise is noticed after" in text
    (facts,) = json.loads(call(capsys, "history", history, *RATES, "--json")[0])
    stated = {"gearbox": "press 4", "defect_count": 3, "baseline": 0, "alarm": True, "n_refused": 1}
    assert facts | stated == facts
    assert facts["rule"]["recordings_to_false_alarm"] >= 730 / 5
    said = words(parse(without_pictures(page.read_text(encoding="utf-8"))))
    for part in (
        "press 4: 3 worn lobes", "Alarm 1 of 1", "All recordings are SIMULATED", "refused", "17.npz 3",
    ):  # fmt: skip
        assert part in said
    _, err = call(capsys, "history", history, *RATES, "--gearbox", "lathe", code=2)
    assert "gearbox must be one of the history, press 4, got 'lathe'" in err
    assert "no such history" in call(capsys, "history", tmp_path / "no.sqlite", code=2)[1]
