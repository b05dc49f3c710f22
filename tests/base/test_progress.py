"""The line of progress, with a clock that the tests move."""

import contextlib
import re
import time
from types import SimpleNamespace

import numpy as np
import pytest
from command import call

from cyclofeat._base import progress as progress_module
from cyclofeat._base.progress import Progress, Steps, erase_progress, progress_hidden
from cyclofeat.cli import main
from cyclofeat.cli._options import note, warn

ERASE = "\r\x1b[K"


@pytest.fixture
def clock(monkeypatch):
    """Time that passes when it is told to."""
    clock = SimpleNamespace(now=0.0)
    clock.monotonic = lambda: clock.now
    monkeypatch.setattr(progress_module, "time", clock)
    return clock


class Stream(list):
    """A stream that remembers, and says what it is."""

    def __init__(self, is_terminal=True):
        super().__init__()
        self.is_terminal = is_terminal
        self.isatty, self.write, self.flush = lambda: is_terminal, self.append, lambda: None


def report(progress, clock, total, *reports):
    """Report at each time how much of the work is done."""
    for clock.now, done in reports:
        progress(done, total)


@pytest.mark.parametrize("is_terminal", [True, False])
def test_silent_for_two_seconds_then_says_what_is_left(clock, is_terminal):
    stream = Stream(is_terminal)
    progress = Progress("working", stream)
    report(progress, clock, 40, (1.0, 1))
    assert stream == []
    report(progress, clock, 40, (4.0, 10))
    assert "working: 10 of 40, 4 s, about 10 s left" in stream[-1]
    report(progress, clock, 40, (4.1, 11))
    assert len(stream) == 1
    report(progress, clock, 40, (30.0, 39), (40.0, 40))
    assert stream[-1] == (ERASE if is_terminal else "") + "working: 40 of 40, 40 s\n"
    assert ("\n" in stream[0]) == (not is_terminal)


def test_what_is_soon_done_shows_nothing(clock):
    stream = Stream()
    with Progress("working", stream) as progress:
        report(progress, clock, 2, (0.0, 1), (1.9, 2))
    assert stream == []


def test_the_time_left_waits_for_a_pace_to_be_trusted(clock):
    stream = Stream()
    progress = Progress("working", stream)
    report(progress, clock, 1000, (2.0, 0), (3.0, 1), (4.0, 2), (4.9, 3))
    assert ["left" in line for line in stream] == [False] * 4
    report(progress, clock, 1000, (6.0, 4))
    assert "about 17 min left" in stream[-1]  # 996 s


def test_the_time_left_is_neither_that_of_a_slow_first_step_nor_of_finished_work(clock):
    # Compilation takes nine seconds, then sixteen come at a time, every second; 100 were there before.
    times = [9.0, 9.01, *np.arange(10.0, 62.0)]
    stream = Stream()
    progress = Progress("working", stream)
    report(progress, clock, 1000, *((now, min(101 + 16 * step, 999)) for step, now in enumerate(times)))
    assert "left" not in "".join(stream[:3])
    shown = [re.search(r"(\d+) of 1000, .* about (\d+) s left", line) for line in stream[4:-1]]
    assert len(shown) > 40
    done, left = np.array([[int(number) for number in match.groups()] for match in shown]).T
    np.testing.assert_allclose(left, (1000 - done) / 16, rtol=0.4)


def test_the_time_left_hardly_jumps_with_the_pace(clock):
    """Files of one and of nine seconds in turn: the predicted end moves less than the mean pace says."""
    stream = Stream()
    progress = Progress("working", stream)
    ends = []
    for done in range(40):
        clock.now += 9.0 if done % 2 else 1.0
        progress(done + 1, 200)
        found = re.search(r"about (\d+) (s|min) left", stream[-1]) if stream else None
        if found:
            ends.append(clock.now + int(found[1]) * (60 if found[2] == "min" else 1))
    assert len(ends) > 30
    np.testing.assert_allclose(ends[10:], 5 * 200, rtol=0.1)


def test_between_reports_the_time_goes_on(clock):
    stream = Stream()
    progress = Progress("counting", stream)
    report(progress, clock, 4, (1.0, 1), (11.0, 2))
    assert stream[-1].endswith("2 of 4, 11 s, about 20 s left")
    clock.now = 16.0
    progress.show_time()
    assert stream[-1].endswith("2 of 4, 16 s, about 15 s left")
    clock.now = 99.0
    progress.show_time()
    assert stream[-1].endswith("2 of 4, 99 s, about 0 s left")


def test_work_that_reports_nothing_has_a_line_that_ends_with_its_time(clock):
    stream = Stream()
    with Progress("training", stream) as progress:
        clock.now = 5.0
        progress.show_time()
        clock.now = 8.0
    assert stream == [f"{ERASE}training: 5 s", f"{ERASE}training: 8 s\n"]
    stream.clear()
    with contextlib.suppress(KeyboardInterrupt), Progress("training", stream) as progress:
        clock.now = 12.0
        progress.show_time()
        raise KeyboardInterrupt
    assert stream == [f"{ERASE}training: 4 s", ERASE]


def test_the_line_is_kept_going_without_being_asked():
    stream = Stream()
    with Progress("training", stream, quiet_s=0.0, tick_s=0.01):
        latest = time.monotonic() + 10
        while not stream and time.monotonic() < latest:
            time.sleep(0.01)
    assert stream[0] == f"{ERASE}training: 0 s"
    assert stream[-1].endswith("\n")


def test_messages_take_the_line_away(clock, capsys):
    stream = Stream()
    report(Progress("counting", stream), clock, 4, (5.0, 1))
    warn("bad")
    note("good")
    assert stream[1:] == [ERASE]
    assert capsys.readouterr().err == "cyclofeat: error: bad\ngood\n"
    erase_progress()
    assert stream[1:] == [ERASE]


def test_a_long_line_does_not_wrap(clock, monkeypatch):
    monkeypatch.setenv("COLUMNS", "20")
    stream = Stream()
    report(Progress("a label that is longer than the terminal", stream), clock, 4, (5.0, 1))
    assert stream == [f"{ERASE}a label that is lon"]


@pytest.mark.parametrize("is_terminal", [True, False])
def test_hidden_progress_writes_nothing(clock, capsys, is_terminal):
    stream = Stream(is_terminal)
    with progress_hidden():
        with Progress("working", stream) as progress, Steps(stream) as step:
            step("training")
            report(progress, clock, 4, (99.0, 1))
            step("counting")
        note("done")
        warn("bad")
    assert stream == []
    assert capsys.readouterr().err == "cyclofeat: error: bad\n"


def test_steps_are_lines_of_a_log_or_a_line_of_progress_each(clock):
    log, terminal = Stream(False), Stream()
    for stream in (log, terminal):
        with Steps(stream) as step:
            step("comparing")
            clock.now += 5.0
            if stream.is_terminal:
                step._step.show_time()
            step("confirming")
            clock.now += 1.0
    assert log == ["comparing\n", "confirming\n"]
    assert terminal == [f"{ERASE}comparing: 5 s", f"{ERASE}comparing: 5 s\n"]


def test_a_step_of_many_parts_says_what_is_left(clock):
    stream = Stream(False)
    with Steps(stream) as step:
        step("simulating")
        for done in (0, 10, 20):
            step.count(done, 40)
            clock.now += 20.0
    assert stream == [
        "simulating\n",
        "simulating: 10 of 40, 20 s, about 60 s left\n",
        "simulating: 20 of 40, 40 s, about 40 s left\n",
        "simulating: 40 of 40, 60 s\n",
    ]


def test_quiet_prints_results_and_errors_alone(capsys, tmp_path):
    quick = ["animate", "--duration", "0.01", "--frames", "2", "--out", str(tmp_path / "a.html")]
    assert "open the page" in call(capsys, *quick)[1]
    assert main([*quick, "--force", "--quiet"]) == 0
    out, err = capsys.readouterr()
    assert "0.01 s of the machine" in out
    assert err == ""
    assert "a.html exists" in call(capsys, *quick, "--quiet", code=2)[1]
