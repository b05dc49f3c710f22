"""Progress of longer work, on standard error."""

from __future__ import annotations

import sys
import time
from typing import TextIO

_QUIET_S = 2.0
_TERMINAL_PERIOD_S = 0.2
_LOG_PERIOD_S = 10.0


class Progress:
    """Callable ``progress(done, total)`` that stays silent for the first two seconds.

    On a terminal it rewrites one line; elsewhere it prints a line every ten seconds. The default stream is
    standard error. The time left follows from the pace since the first report: what comes before it, such as
    compilation or what an earlier run finished, does not repeat. It is stated once that
    pace spans two seconds.
    """

    def __init__(self, label: str, stream: TextIO | None = None) -> None:
        self.label = label
        self.stream = sys.stderr if stream is None else stream
        self._began = time.monotonic()
        self._first: tuple[float, int] | None = None
        self._last_shown: float | None = None
        self._terminal = self.stream.isatty()

    def __call__(self, done: int, total: int) -> None:
        now = time.monotonic()
        elapsed = now - self._began
        began, before = self._first = self._first or (now, done)
        period = _TERMINAL_PERIOD_S if self._terminal else _LOG_PERIOD_S
        finished = done >= total
        if self._last_shown is None:
            quiet = finished or elapsed < _QUIET_S
        else:
            quiet = not finished and now - self._last_shown < period
        if quiet:
            return
        self._last_shown = now
        left = ""
        if not finished and done > before and now - began >= _QUIET_S:
            left = f", about {(now - began) / (done - before) * (total - done):.0f} s left"
        line = f"{self.label}: {done} of {total}, {elapsed:.0f} s{left}"
        if self._terminal:
            self.stream.write(f"\r\x1b[K{line}" + ("\n" if finished else ""))
        else:
            self.stream.write(line + "\n")
        self.stream.flush()
