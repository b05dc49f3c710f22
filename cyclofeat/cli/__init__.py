"""The ``cyclofeat`` command.

================  ====================================================================================
module            job
================  ====================================================================================
``_options``      the parser; options that read recordings or name models and files to write; printing
``_rigs``         options of commands that simulate
each other one    one command
================  ====================================================================================

The module of a command has two functions: ``add_arguments(parser)``, and ``run(arguments)``, which returns
its result as it is printed (``Printed``: text, JSON, error), or generates one result after the other.

A module is imported when its command is called, and imports what computes when it runs: ``--help`` answers
at once.
"""

from __future__ import annotations

import argparse
import importlib
import io
import json
import os
import sys
import warnings
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Literal

from cyclofeat import __version__
from cyclofeat._base.progress import erase_progress, progress_hidden
from cyclofeat.cli._options import (
    CommandParser,
    Printed,
    RaisingParser,
    check_targets,
    error_text,
    print_message,
    warn,
)

__all__ = ["main", "make_parser"]


@dataclass(frozen=True)
class Command:
    """One command: its help, its module, and its JSON: one document, a list, or a line for each result."""

    text: str
    module_name: str
    output: Literal["one", "list", "lines"] = "one"

    def module(self) -> ModuleType:
        """Import the command's module."""
        return importlib.import_module(f"cyclofeat.cli.{self.module_name}")


COMMANDS = {
    "simulate": Command("simulate one recording and write it to a file", "simulate"),
    "animate": Command(
        "simulate the gearbox and write a page that animates it with its forces and its torque",
        "animate",
    ),
    "inspect": Command("show what recordings contain and what would spoil a count", "inspect", "list"),
    "train": Command("train a model and write it to a file", "train"),
    "count": Command("count the worn lobes of recordings", "count", "list"),
    "watch": Command("count recordings as they arrive in a folder", "watch", "lines"),
    "history": Command("show the counts of each gearbox over time, and alarms", "history", "list"),
    "evaluate": Command("cross-validate counters, with whole assemblies held out", "evaluate"),
    "plan": Command("state how long to record, at what noise, to tell N worn lobes from N + 1", "plan"),
    "campaign": Command(
        "simulate thousands of assemblies to files, or complete an interrupted run", "campaign"
    ),
    "gap": Command(
        "find where model and measurement disagree, name all missing effects, correct the model", "gap"
    ),
    "serve": Command("open a page in the browser that inspects, counts and compares", "serve", "lines"),
    "demo": Command("train a model, write surrogate recordings, count them, and write the pages", "demo"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; default ``sys.argv[1:]``.

    Returns
    -------
    int
        0 on success; 2 for bad input, with one line on standard error that says what is wrong; 3 if a
        recording was refused and ``--strict`` asks for it; 130 after Ctrl-C; 141 if standard output was
        closed.
    """
    words = sys.argv[1:] if argv is None else list(argv)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="backslashreplace")  # a file's name may not suit the terminal
    # No option before the command takes a value, so the first other word is the command.
    called = next((word for word in words if not word.startswith("-")), "")
    try:
        try:
            arguments = make_parser([called]).parse_args(words)
        except ValueError as error:
            warn(str(error))
            if not {"--json", "--jsonl"}.isdisjoint(words):
                print(json.dumps({"error": str(error)}), flush=True)
            return 2
        finally:
            sys.stdout and sys.stdout.flush()  # help and version
        with warnings.catch_warnings(), progress_hidden(arguments.quiet):
            warnings.showwarning = _show_warning
            return _run_and_print(COMMANDS[arguments.command], arguments)
    except BrokenPipeError:
        # The reader (head, less) has closed the pipe.
        _close_output()
        return 141
    except OSError as error:  # of printing: those of the work are results
        _close_output()
        warn(f"standard output cannot be written: {error}")
        return 2
    except KeyboardInterrupt:
        print("cyclofeat: interrupted", file=sys.stderr)
        return 130


def _run_and_print(command: Command, arguments: argparse.Namespace) -> int:
    """Run a command, print each result as soon as it is known, and return the exit code.

    Errors of input and surroundings are results too; any other error is a defect of the toolkit and keeps its
    traceback.
    """
    failed = refused = False
    # Results of "lines" are lines of JSON anyway, a list on request.
    in_lines = arguments.json if command.output == "lines" else getattr(arguments, "jsonl", False)
    documents = []
    try:
        for printed in _printed_results(command, arguments):
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


def _printed_results(command: Command, arguments: argparse.Namespace) -> Iterator[Printed]:
    """Run a command and yield what is printed of each result, and of the error that ends it."""
    try:
        if sys.stdout is None:
            raise OSError("standard output is closed: direct it to a file, or to the null device")
        check_targets(arguments)
        for path in getattr(arguments, "effects_from", ()):
            from cyclofeat.simulators import load_effects

            load_effects(path)
        result = command.module().run(arguments)
        yield from result if isinstance(result, Iterator) else (result,)
    except _expected_errors() as error:
        cause: BaseException | None = error
        while cause is not None:
            if isinstance(cause, KeyboardInterrupt):  # as in the import of a compiled module
                raise KeyboardInterrupt from error
            cause = cause.__cause__ or cause.__context__
        text = error_text(error, arguments)
        yield Printed("", {"error": text}, text, failed=True)


def _expected_errors() -> tuple[type[Exception], ...]:
    """Return the errors of input and surroundings, without importing the simulators for one of theirs."""
    simulators = sys.modules.get("cyclofeat.simulators")
    failed = () if simulators is None else (simulators.SimulationFailed,)
    return ValueError, TypeError, OSError, ImportError, MemoryError, *failed


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning as one line, without the place in the code."""
    print_message(f"cyclofeat: warning: {' '.join(str(message).split())}")


def _close_output() -> None:
    """Write nothing more to standard output, not even at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def make_parser(complete: Collection[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """Return the parser of the command line, with the arguments of the commands in ``complete``."""
    parser = RaisingParser(
        prog="cyclofeat",
        description="Count and locate the worn lobes of a cycloidal disc from windows of output torque.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    parsers = parser.add_subparsers(
        required=True, metavar="COMMAND", dest="command", parser_class=CommandParser
    )
    for name, command in COMMANDS.items():
        subparser = parsers.add_parser(name, help=command.text, description=command.text)
        printing = subparser.add_mutually_exclusive_group()
        printing.add_argument("--json", action="store_true", help="print JSON for programs")
        if command.output == "list":
            printing.add_argument(
                "--jsonl", action="store_true", help="print one line of JSON per result, at once"
            )
        subparser.add_argument(
            "--quiet",
            action="store_true",
            help="print results, warnings and errors, but no progress or notes",
        )
        if name in complete:
            command.module().add_arguments(subparser)
    return parser
