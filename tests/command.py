"""The command line, called in the process of the tests, and as one that Ctrl-C stops."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Sequence
from typing import Any

import pytest

from cyclofeat.cli import main


def run(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of one call."""
    code = main([str(argument) for argument in arguments])
    return code, *capsys.readouterr()


def call(capsys: pytest.CaptureFixture[str], *arguments: Any, code: int = 0) -> tuple[str, str]:
    """Standard output and standard error of one call that must end with this exit code."""
    ended, out, err = run(capsys, *arguments)
    assert ended == code, err
    return out, err


def start(command: Sequence[Any], **options: Any) -> subprocess.Popen[str]:
    """Start a command that Ctrl-C stops: a shell's background job ignores the keyboard, and its children too.

    A ``preexec_fn`` could undo that only in a fork, which threads of the tests' process may deadlock.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return subprocess.Popen(command, text=True, **options)
    finally:
        signal.signal(signal.SIGINT, before)
