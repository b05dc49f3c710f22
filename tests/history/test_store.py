"""The file of a history: whole rows, whatever happens to its writers."""

import dataclasses
import os
import signal
import sqlite3
import subprocess
import sys

import pytest

from cyclofeat import Recording
from cyclofeat.counting import LobeCount
from cyclofeat.counting.model.radial_wear import WearDepth
from cyclofeat.history import History
from cyclofeat.report import write_history_report
from cyclofeat.report._page import Section

HOUR = 3600.0
SCORES = {"classes": [0, 1], "confusion": [[60, 0], [1, 59]], "n_windows": 120, "n_assemblies": 120}
CARD = {"description": "made up", "cross_validation": SCORES}
RECORDING = Recording([21.0, 23.0], 2.0)


def count(n, refused=False):
    proba = {0: 0.1, 1: 0.9} if n else {0: 0.9, 1: 0.1}
    return LobeCount(n, proba, (), (), False, 1, refused=refused, reason="too noisy" if refused else "")


def filled(path, counts, card=CARD, gearbox="press", start=0.0):
    """A history of counts, one an hour; None is a refused recording."""
    history = History(path)
    for k, n in enumerate(counts):
        answer = count(n or 0, refused=n is None)
        history.add(gearbox, f"{k}.csv", start + HOUR * k, answer, RECORDING, card)
    history.write()
    return history


def shown_gearboxes(history):
    page = Section()
    write_history_report(history, page)
    return page.summary["gearboxes"]


def test_rows_come_back(tmp_path):
    with filled(tmp_path / "a.sqlite", [0, None]) as history:
        history.add("lathe", "b.csv", 5.0, count(1), RECORDING, CARD)
        assert history.gearboxes() == ["press"]
        history.write()
    with History(tmp_path / "a.sqlite", create=False) as history:
        assert history.gearboxes() == ["lathe", "press"]
        sound, refused = history.rows("press")
        assert history.rows("press", last=1) == [refused]
    assert (sound.time, sound.file, sound.defect_count, sound.reason) == (0.0, "0.csv", 0, "")
    assert (sound.mean, sound.deviation, sound.unit) == (22.0, 1.0, "Nm")
    assert sound.answer == count(0).to_dict() | {"source": None}
    assert (refused.defect_count, refused.reason) == (None, "too noisy")


@pytest.mark.slow
def test_the_depth_of_the_wear_is_kept_and_drawn_over_time(tmp_path):
    pytest.importorskip("matplotlib")
    depths = [None, 20.0, 31.0, 45.0]
    with History(tmp_path / "a.sqlite") as history:
        for k, depth in enumerate(depths):
            seen = WearDepth(depth, 0.0 if depth is None else depth - 5, 15.0 + (depth or 0), 0.9, 10.0)
            one = dataclasses.replace(count(int(depth is not None)), wear_um=seen)
            history.add("press", f"{k}.csv", HOUR * k, one, RECORDING, CARD)
        history.add("press", "4.csv", HOUR * 4, count(0, refused=True), RECORDING, CARD)
        history.write()
        state = history.state("press")
        (shown,) = shown_gearboxes(history)
        table = history.to_frame("press")
    assert state.wear_um == state.to_dict()["wear_um"] == 45.0  # the last one that was counted
    assert table["time"].iloc[1].timestamp() == HOUR
    assert table["wear_um"].tolist()[1:4] == depths[1:]
    assert table["wear_um"].isna().tolist() == [True, False, False, False, True]
    assert table["defect_count"].isna().tolist() == [False] * 4 + [True]
    assert [row["wear"] for row in shown["last"]] == ["-", "45", "31", "20", "-"]
    assert [picture["alt"] for picture in shown["pictures"]][1] == "Depth of wear of press over time"
    with filled(tmp_path / "b.sqlite", [0, 0]) as history:
        (shown,) = shown_gearboxes(history)
        assert history.state("press").wear_um is None
    assert (shown["states_wear"], len(shown["pictures"])) == (False, 2)


def test_pictures_have_dates_steps_and_refused_recordings(tmp_path):
    with History(tmp_path / "a.sqlite") as history:
        for k, one in enumerate([count(0), count(1, refused=True), count(1)]):
            history.add("press", f"{k}.csv", HOUR * (100 + k), one, RECORDING, CARD)
        history.add("lathe", "single.csv", HOUR, count(1), RECORDING, CARD)
        history.write()
        lathe, press = shown_gearboxes(history)
        first, *boxes = str(history).splitlines()
    assert (first, len(boxes)) == (f"History {tmp_path / 'a.sqlite'}", 2)
    assert boxes[1].startswith("  press: 3 recordings; ")
    plot = press["pictures"][0]["plot"]
    assert (plot["axes"][0]["start"], plot["view"]) == (HOUR * 100, [0.0, 2 * HOUR])
    styles = {line["name"]: line["style"] for line in plot["lines"]}
    assert styles["count"] == "steps"
    assert styles["refused, would be"] == "points"
    low, high = lathe["pictures"][0]["plot"]["view"]
    assert low < 0 < high


def worn(depth):
    """A count of 0 with the depth of wear that may be there, or surely is."""
    return dataclasses.replace(count(0), wear_um=WearDepth(depth, depth - 10.0, depth + 10.0, 0.9, 10.0))


def test_the_alarm_follows_the_depth_of_wear_too(tmp_path):
    """The same count throughout: only the whole interval above the usual upper end, 60 um, exceeds."""
    depths = [50.0] * 10 + [55.0, 60.0, 65.0, 69.0] + [90.0] * 10
    with History(tmp_path / "a.sqlite") as history:
        for k, depth in enumerate(depths):
            history.add("press", f"{k}.csv", HOUR * k, worn(depth), RECORDING, CARD)
        history.write()
        state = history.state("press", recordings_per_month=60)
        assert state.rule.baseline_um == 60.0
        assert str(state.rule).endswith("counts above 0, or wear surely deeper than 60 um")
        ((begin, end),) = state.alarms
        assert (begin, end) == (HOUR * (14 + state.rule.k - 1), None)
        # Intervals of 90 % lie above the truth in one of twenty cases, besides wrong counts.
        of_counts = filled(tmp_path / "b.sqlite", [0] * 24).state("press", recordings_per_month=60).rule
        assert state.rule.error_rate == pytest.approx(of_counts.error_rate + 0.05)
        assert of_counts.baseline_um is None


def test_a_file_that_is_counted_again_keeps_its_row(tmp_path):
    filled(tmp_path / "a.sqlite", [0, 1]).close()
    with filled(tmp_path / "a.sqlite", [0, 1, 1]) as history:
        assert [row.file for row in history.rows("press")] == ["0.csv", "1.csv", "2.csv"]
    # Read otherwise, without its start for example, a refused recording may have a count.
    with filled(tmp_path / "a.sqlite", [None, 1, 0]) as history:
        assert [row.defect_count for row in history.rows("press")] == [None, 1, 0]
        assert [row.reason for row in history.rows("press")] == ["too noisy", "", ""]
        assert history.rows("press")[2].answer["defect_count"] == 0


def test_a_file_name_in_another_encoding_is_kept_escaped(tmp_path):
    with History(tmp_path / "a.sqlite") as history:
        history.add("press", os.fsdecode(b"Pr\xfcf.csv"), 0.0, count(1), RECORDING, CARD)
        history.write()
        assert [row.file for row in history.rows("press")] == [r"Pr\udcfcf.csv"]


def test_the_alarm_follows_the_counts(tmp_path):
    options = {"false_alarms_per_month": 0.5}
    series = [0] * 9 + [1, 0, 0, None, 1, 0, 0, 1, 1, 1, 1, 0, 1]
    with filled(tmp_path / "a.sqlite", series) as history:
        state = history.state("press", **options)
        assert (state.n_recordings, state.n_refused, state.baseline, state.defect_count) == (22, 1, 0, 1)
        assert state.recordings_per_month == pytest.approx(730.5)
        assert state.rule.error_rate == 0.1  # one of the ten of the baseline, more than on the card
        assert state.rule.recordings_to_false_alarm >= 730.5 / 0.5
        assert state.alarm
        ((begin, end),) = state.alarms
        assert (begin, end) == (19 * HOUR, None)
        assert str(state).startswith("ALARM since 1970-01-01 19:00 UTC: 4 of the last 5 counts above 0")
        facts = state.to_dict()
        assert (facts["alarm"], facts["alarm_since"]) == (True, "1970-01-01T19:00:00Z")
        # More is put up with where recordings are rare.
        rare = history.state("press", recordings_per_month=4.0, **options)
        assert rare.rule.k < state.rule.k
        with pytest.raises(ValueError, match="gearbox must be one of the history, press, got 'lathe'"):
            history.state("lathe")
        with pytest.raises(ValueError, match="false_alarms_per_month must be positive"):
            history.state("press", false_alarms_per_month=0)
    with filled(tmp_path / "a.sqlite", [0] * 8, start=30 * HOUR) as history:
        state = history.state("press", **options)
        assert str(state) == f"no alarm (it takes {state.rule}, after the first ten)"
        assert history.state("press", **options).alarms[0][1] is not None
    # Another model may count otherwise: its counts make a baseline of their own.
    with filled(tmp_path / "a.sqlite", [1] * 3, CARD | {"description": "new"}, start=90 * HOUR) as history:
        state = history.state("press", **options)
        assert (state.n_recordings, state.baseline, state.alarm) == (3, None, False)
        assert str(state) == "no alarm possible: 3 of the 10 counts that make a baseline"


@pytest.mark.parametrize(
    ("counts", "card", "text"),
    [
        ([0] * 12, {"description": "x"}, "the model's card states no cross-validation"),
        ([1] * 12, CARD, "the model knows no count above 1"),
        ([None] * 12, CARD, "0 of the 10 counts that make a baseline"),
    ],
)
def test_where_no_alarm_is_possible_it_is_said(tmp_path, counts, card, text):
    with filled(tmp_path / "a.sqlite", counts, card) as history:
        assert text in history.state("press").no_rule


def test_what_is_no_history_is_left_alone(tmp_path):
    letter = tmp_path / "letter.sqlite"
    letter.write_text("to a friend, of many words " * 50, encoding="utf-8")
    other, newer = tmp_path / "other.sqlite", tmp_path / "newer.sqlite"
    filled(newer, [0]).close()
    for file, statement in ((other, "CREATE TABLE mine (a)"), (newer, "PRAGMA user_version = 99")):
        connection = sqlite3.connect(file)
        connection.execute(statement)
        connection.close()
    for file, text in (
        (letter, "is no history"),
        (other, "is a database of something else"),
        (newer, "is a history of version 99, but 1 can be read"),
    ):
        before = file.read_bytes()
        with pytest.raises(ValueError, match=text):
            History(file)
        assert file.read_bytes() == before
    empty = tmp_path / "empty.sqlite"
    empty.touch()
    with pytest.raises(ValueError, match="is no history: it is empty"):
        History(empty, create=False)
    assert not empty.stat().st_size
    with pytest.raises(FileNotFoundError, match="no such history"):
        History(tmp_path / "absent.sqlite", create=False)
    with pytest.raises(FileNotFoundError, match="folder .* does not exist"):
        History(tmp_path / "absent" / "a.sqlite")
    with pytest.raises(OSError, match="is a folder: a history is a file"):
        History(tmp_path)


def test_a_damaged_history_is_said_to_be_one(tmp_path):
    file = tmp_path / "a.sqlite"
    filled(file, list(range(8)) * 20).close()
    content = file.read_bytes()
    file.write_bytes(content[:4096] + b"\xff" * (len(content) - 4096))
    with pytest.raises(ValueError, match="is damaged .* restore a copy"), History(file) as history:
        history.rows("press")


def test_a_damaged_index_is_met_at_once(tmp_path):
    file = tmp_path / "a.sqlite"
    filled(file, [0] * 20).close()
    connection = sqlite3.connect(file)
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    query = "SELECT rootpage FROM sqlite_schema WHERE name = 'recording_by_gearbox'"
    (root,) = connection.execute(query).fetchone()
    (size,) = connection.execute("PRAGMA page_size").fetchone()
    connection.close()
    content = bytearray(file.read_bytes())
    end = root * size
    assert content[end - 200 : end].count(b"press")
    content[end - size : end] = content[end - size : end].replace(b"press", b"prese")
    file.write_bytes(content)
    with pytest.raises(ValueError, match="is damaged .*recording_by_gearbox.* restore a copy"):
        History(file, create=False)


def test_files_copied_at_once_do_not_show_how_many_there_are_in_a_month(tmp_path):
    with filled(tmp_path / "a.sqlite", [0] * 12, CARD) as history:
        connection = sqlite3.connect(history.path)
        connection.execute("UPDATE recording SET time = 1.7e9 + id * 0.1")
        connection.commit()
        connection.close()
        state = history.state("press")
        assert (state.recordings_per_month, state.rule) == (None, None)
        assert "span 0.018 minutes by their times" in state.no_rule
        assert history.state("press", recordings_per_month=60).rule is not None


@pytest.mark.skipif(sys.platform == "win32", reason="no such name there")
def test_a_history_is_a_file_whatever_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    History(":memory:").close()
    assert (tmp_path / ":memory:").is_file()


def test_what_cannot_be_written_is_written_later(tmp_path):
    file = tmp_path / "a.sqlite"
    with filled(file, [0]) as history:
        other = sqlite3.connect(file, isolation_level=None)
        other.execute("ALTER TABLE recording RENAME TO away")
        history.add("press", "1.csv", HOUR, count(1), RECORDING, CARD)
        with pytest.raises(OSError, match="no such table"):
            history.write()
        other.execute("ALTER TABLE away RENAME TO recording")
        other.close()
        history.write()
        assert [row.file for row in history.rows("press")] == ["0.csv", "1.csv"]


WRITER = """
import sys
sys.path.insert(0, sys.argv[3])
from test_store import CARD, RECORDING, count
from cyclofeat.history import History
sys.stdin.readline()
with History(sys.argv[1]) as history:
    for k in range(int(sys.argv[4])):
        history.add(sys.argv[2], f"{k}.csv", float(k), count(k % 2), RECORDING, CARD)
        history.write()
        print(k, flush=True)
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="processes are killed by signal")
def test_two_writers_and_a_kill_lose_no_row(tmp_path):
    file = tmp_path / "a.sqlite"
    run = [sys.executable, "-c", WRITER, str(file)]
    here = os.path.dirname(__file__)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with (
        subprocess.Popen([*run, "killed", here, "100000"], **pipes) as killed,
        subprocess.Popen([*run, "whole", here, "200"], **pipes) as whole,
    ):
        for process in (killed, whole):  # both make the file at once
            process.stdin.write("\n")
            process.stdin.flush()
        said = [killed.stdout.readline() for _ in range(50)]
        killed.send_signal(signal.SIGKILL)
        said += killed.stdout.readlines()
        assert len(whole.stdout.readlines()) == 200
    assert whole.returncode == 0
    with History(file, create=False) as history:
        assert len(history.rows("whole")) == 200
        rows = history.rows("killed")
        assert [row.time for row in rows] == [float(k) for k in range(len(rows))]
        whole_lines = [line for line in said if line.endswith("\n")]
        assert len(whole_lines) <= len(rows) <= len(whole_lines) + 1
    connection = sqlite3.connect(file)
    assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    connection.close()
