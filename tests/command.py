"""The command line, called in the process of the tests."""

from __future__ import annotations

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
