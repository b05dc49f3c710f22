"""Printing of results, for people or for programs, and of messages."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Iterator
from typing import Any

from cyclofeat._base.progress import erase_progress, is_hidden
from cyclofeat.cli._idle import refuse_idle
from cyclofeat.cli._reading import error_text
from cyclofeat.cli._rigs import load_own_effects
from cyclofeat.cli._table import Command, Printed
from cyclofeat.cli._targets import check_targets


def run_and_print(command: Command, arguments: Namespace) -> int:
    """Run a command, print each result as soon as it is known, and return the exit code.

    Errors of input and surroundings are results too; any other error is a defect of the toolkit and keeps its
    traceback.
    """
    failed = refused = False
    # Results of "lines" are lines of JSON anyway, a list on request.
    in_lines = arguments.json if command.output == "lines" else getattr(arguments, "jsonl", False)
    documents = []
    try:
        for printed in _results(command, arguments):
            failed = failed or printed.failed
            refused = refused or printed.refused
            erase_progress()
            if printed.error:
                warn(printed.error)
            if not (arguments.json or in_lines):
                if printed.text:
                    print(printed.text, flush=True)
            elif in_lines:
                print(json.dumps(printed.json), flush=True)
            else:
                documents.append(printed.json)
    finally:
        # What is finished is printed although the work was interrupted.
        if documents:
            print(json.dumps(documents if command.output == "list" else documents[0], indent=2), flush=True)
    return 2 if failed else 3 * refused


def _results(command: Command, arguments: Namespace) -> Iterator[Printed]:
    """Run a command and yield what is printed of each result, and of the error that ends it."""
    try:
        if sys.stdout is None:
            raise OSError("standard output is closed: direct it to a file, or to the null device")
        refuse_idle(arguments)
        check_targets(arguments)
        load_own_effects(arguments)
        module = command.module()
        outcome = module.run(arguments)
        for result in outcome if isinstance(outcome, Iterator) else (outcome,):
            yield module.printed(arguments, result)
    except _expected_errors() as error:
        if _of_ctrl_c(error):
            raise KeyboardInterrupt from error
        text = error_text(error, arguments.typed)
        yield Printed("", {"error": text}, text, failed=True)


def _of_ctrl_c(error: BaseException | None) -> bool:
    """Return True for an error that Ctrl-C caused, as in the import of a compiled module."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _expected_errors() -> tuple[type[Exception], ...]:
    """Return the errors of input and surroundings, without importing the simulators for one of theirs."""
    simulators = sys.modules.get("cyclofeat.simulators")
    failed = () if simulators is None else (simulators.SimulationFailed,)
    return ValueError, TypeError, OSError, ImportError, MemoryError, *failed


def show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning as one line, without the place in the code."""
    _say(f"cyclofeat: warning: {' '.join(str(message).split())}")


def note(message: str) -> None:
    """Print a line on standard error, unless ``--quiet`` was given."""
    if not is_hidden():
        _say(message)


def warn(error: str) -> None:
    """Print an error as one line on standard error."""
    _say(f"cyclofeat: error: {error}")


def _say(message: str) -> None:
    erase_progress()
    print(message, file=sys.stderr, flush=True)
