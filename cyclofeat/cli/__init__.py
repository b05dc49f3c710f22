"""The ``cyclofeat`` command.

==================  =====================================================================
module              job
==================  =====================================================================
``_table``          all commands: name, one line of text, module
``_printing``       printing of results, for people or as JSON, and the exit code
``_reading``        options of commands that read recordings, and their work file by file
``_rigs``           options of commands that simulate
``_history``        options of commands that keep a history
``_models``         options of commands that count with a stored model
``_targets``        options that name files to write, checked before any work
``_idle``           errors for options that have no effect
``_gap_check``      what ``gap --check`` does
``_gap_prepare``    what ``gap --prepare`` does
``_gap_printing``   text of what ``gap`` finds
``folder_watch``    files that arrive in a folder
each other module   one command
==================  =====================================================================

The module of a command has three parts:

- ``add_arguments(parser)``;
- ``run(arguments)``, which returns the result, or generates one result after the other;
- ``printed(arguments, result)``, which returns a result's ``Printed``: its text, its JSON, and its error.

A module is imported when its command is called, and imports what computes when it runs: ``--help`` answers
at once.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import sys
import warnings
from collections.abc import Collection, Sequence

from cyclofeat import __version__
from cyclofeat._base.progress import progress_hidden
from cyclofeat.cli._idle import CommandParser
from cyclofeat.cli._printing import run_and_print, show_warning, warn
from cyclofeat.cli._table import COMMANDS

__all__ = ["main", "make_parser"]


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
        said = io.StringIO()
        try:
            with contextlib.redirect_stderr(said):
                arguments = make_parser([called]).parse_args(words)
        finally:
            print(said.getvalue(), end="", file=sys.stderr)
            if said.getvalue() and not {"--json", "--jsonl"}.isdisjoint(words):
                print(json.dumps({"error": said.getvalue().rstrip().rpartition("error: ")[2]}))
            sys.stdout and sys.stdout.flush()  # help and version
        with warnings.catch_warnings(), progress_hidden(arguments.quiet):
            warnings.showwarning = show_warning
            return run_and_print(COMMANDS[arguments.command], arguments)
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


def _close_output() -> None:
    """Write nothing more to standard output, not even at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def make_parser(complete: Collection[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """Return the parser of the command line, with the arguments of the commands in ``complete``."""
    parser = argparse.ArgumentParser(
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
