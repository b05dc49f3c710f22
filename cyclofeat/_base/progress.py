"""Progress of longer work, as one line on standard error."""

from __future__ import annotations

import shutil
import sys
import threading
import time
import warnings
from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from typing import Any, Self, TextIO

_QUIET_S = 2.0
_TERMINAL_PERIOD_S = 0.2
_LOG_PERIOD_S = 10.0
_TICK_S = 0.5
_TRUSTED_S = 3.0  # for which a pace must hold
_SMOOTHING = 0.3
_ERASE = "\r\x1b[K"

is_hidden: ContextVar[bool] = ContextVar("is_hidden", default=False)  # where no progress is shown
_open_line: Progress | None = None


@contextmanager
def progress_hidden(hidden: bool = True) -> Iterator[None]:
    """Show no progress of what begins inside the block, if ``hidden``."""
    token = is_hidden.set(hidden)
    try:
        yield
    finally:
        is_hidden.reset(token)


def erase_progress() -> None:
    """Take the line off the terminal, to print something else; the next report brings it back."""
    if _open_line is not None:
        _open_line.erase_line()


class Progress:
    """Callable ``progress(done, total)`` that stays silent for the first two seconds.

    On a terminal it rewrites one line; elsewhere it prints a line every ten seconds. As a context manager it
    also keeps the time of the line going between reports, and of work that reports nothing.

    The time left follows from the pace since the first report (compilation and earlier runs do not repeat),
    once that spans three seconds; the end that it predicts is smoothed.
    """

    def __init__(
        self, label: str, stream: TextIO | None = None, *, quiet_s: float = _QUIET_S, tick_s: float = _TICK_S
    ) -> None:
        self.label, self.quiet_s, self.tick_s = label, quiet_s, tick_s
        self.stream = sys.stderr if stream is None else stream
        self._terminal = self.stream.isatty()
        self._hidden = is_hidden.get()
        self._began = time.monotonic()
        self._done = self._total = 0
        self._first: tuple[float, int] | None = None
        self._end: float | None = None
        self._last_shown: float | None = None
        self._lock = threading.RLock()
        self._stop = threading.Event()

    def __call__(self, done: int, total: int) -> None:
        with self._lock:
            now = time.monotonic()
            self._done, self._total = done, total
            # Update the time at which the work ends; None while the pace is not to be trusted.
            began, before = self._first = self._first or (now, self._done)
            made = self._done - before
            if made > 0 and now - began >= _TRUSTED_S:
                end = now + (now - began) / made * (self._total - self._done)
                self._end = end if self._end is None else self._end + _SMOOTHING * (end - self._end)
            self._write_line(now, finished=done >= total)

    def __enter__(self) -> Self:
        if self._terminal and not self._hidden:
            threading.Thread(target=self.keep_time, daemon=True).start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._stop.set()
        with self._lock:
            if kind is not None:
                self.erase_line()
            elif not self._is_finished:
                self._done = self._total
                self._write_line(time.monotonic(), finished=True)

    def keep_time(self) -> None:
        """Show the time that has passed, again and again until the work ends."""
        while not self._stop.wait(self.tick_s):
            self.show_time()

    def show_time(self) -> None:
        """Show the time that has passed."""
        with self._lock:
            if not self._is_finished:
                self._write_line(time.monotonic())

    def erase_line(self) -> None:
        """Take the line off the terminal."""
        global _open_line
        with self._lock:
            if _open_line is self:
                self.stream.write(_ERASE)
                self.stream.flush()
                _open_line = None

    @property
    def _is_finished(self) -> bool:
        return 0 < self._total <= self._done

    def _write_line(self, now: float, *, finished: bool = False) -> None:
        global _open_line
        elapsed = now - self._began
        period = _TERMINAL_PERIOD_S if self._terminal else _LOG_PERIOD_S
        if self._last_shown is None:
            silent = finished or elapsed < self.quiet_s
        else:
            silent = not finished and now - self._last_shown < period
        if silent or self._hidden:
            return
        self._last_shown = now
        count = f"{self._done} of {self._total}, " if self._total > 1 else ""
        left = ""
        if self._end is not None and not finished:
            left = f", about {seconds_text(max(self._end - now, 0.0))} left"
        line = f"{self.label}: {count}{seconds_text(elapsed)}{left}"
        if self._terminal:
            # A longer line would wrap, and only its last part be rewritten.
            line = line[: shutil.get_terminal_size().columns - 1]
            self.stream.write(f"{_ERASE}{line}" + ("\n" if finished else ""))
            _open_line = None if finished else self
        else:
            self.stream.write(line + "\n")
        self.stream.flush()


class Steps(ExitStack):
    """Callable ``steps(text)`` that names the step that begins: a :class:`Progress` or, elsewhere, a line."""

    def __init__(self, stream: TextIO | None = None) -> None:
        super().__init__()
        self.stream = sys.stderr if stream is None else stream
        self._step: Progress | None = None

    def __call__(self, text: str) -> None:
        self.close()
        self._step = self.enter_context(Progress(text, self.stream))
        if not (self.stream.isatty() or is_hidden.get()):
            self.stream.write(f"{text}\n")
            self.stream.flush()

    def count(self, done: int, total: int) -> None:
        """Report how much of the step is done, from which the time left follows."""
        if self._step is not None:
            self._step(done, total)


def seconds_text(seconds: float) -> str:
    """Return a length of time in seconds, minutes or hours."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


@contextmanager
def stopped_quietly(results: Generator[Any, None, None]) -> Iterator[Generator[Any, None, None]]:
    """Yield joblib's generator of results and close it, without the warning of calls that still run."""
    try:
        yield results
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            results.close()
