"""Commands that the tests stop as the keyboard does."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Sequence
from typing import Any


def start(command: Sequence[Any], **options: Any) -> subprocess.Popen[str]:
    """Start a command that Ctrl-C stops: a shell's background job ignores the keyboard, and its children too.

    A ``preexec_fn`` could undo that only in a fork, which threads of the tests' process may deadlock.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return subprocess.Popen(command, text=True, **options)
    finally:
        signal.signal(signal.SIGINT, before)
