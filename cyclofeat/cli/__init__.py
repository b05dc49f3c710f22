"""The ``cyclofeat`` command.

``_options`` holds the parser, options of several commands, and printing; ``_rigs`` the options of commands
that simulate. Each other module holds one command in two functions: ``add_arguments(parser)``, and
``run(arguments)``, which returns its result as it is printed (``Printed``: text, JSON, error), or generates
one result after the other. What is computed is yielded before a page is drawn.

A module is imported when its command is called, and imports what computes when it runs: ``--help`` answers
at once.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import io
import json
import operator
import os
import sys
import warnings
from collections.abc import Collection, Iterator, Sequence
from types import ModuleType
from typing import Any, Literal

from cyclofeat import __version__
from cyclofeat._base.progress import erase_progress, progress_hidden
from cyclofeat.cli._options import (
    Arguments,
    Parser,
    Printed,
    RaisingParser,
    expected_errors,
    print_message,
    warn,
)

__all__ = ["main", "make_parser"]

# Help of each command, and its JSON: one document, a list, or a line for each result.
COMMANDS: dict[str, tuple[str, Literal["one", "list", "lines"]]] = {
    "simulate": ("simulate a recording to a file, or many to a folder with their manifest", "one"),
    "animate": (
        "simulate the gearbox and write a page that animates it with its forces and its torque", "one",
    ),
    "inspect": ("show what recordings contain and what would spoil a count", "list"),
    "train": ("train a model and write it to a file", "one"),
    "count": ("count the worn lobes of recordings", "list"),
    "watch": ("count recordings as they arrive in a folder", "lines"),
    "history": ("show the counts of each gearbox over time, and alarms", "list"),
    "evaluate": ("cross-validate counters, with whole assemblies held out", "one"),
    "features": ("rank features by how they depend on the number of worn lobes", "one"),
    "plan": ("state how long to record, at what noise, to tell N worn lobes from N + 1", "one"),
    "campaign": ("simulate thousands of assemblies to files, or complete an interrupted run", "one"),
    "gap": ("find where model and measurement disagree, name all missing effects, correct the model", "one"),
    "serve": ("open a page in the browser that inspects, counts and compares", "lines"),
    "demo": ("train a model, simulate recordings, count them, and write the pages", "list"),
}  # fmt: skip

# One or two calls of each command, as its help shows them.
EXAMPLES = {
    "simulate": (
        "--worn-count 3 --rig r2 --duration 9 --out disc.csv",
        "--out measured/ --count 24 --worn-counts 0,1,3 --speeds 500 --loads 11,22",
    ),
    "animate": ("--worn-lobes 4,5,6 --out gearbox.html",),
    "inspect": ("disc.csv", "log.csv --channel Torque --sampling-rate 25600 --speed 500"),
    "train": ("--rig mine.json --out model.skops", "measured/ --out model.skops"),
    "count": ("disc.csv", "measured/ --model model.skops --report count.html"),
    "watch": ("arriving/ --once", "arriving/ --model model.skops --history gearboxes.sqlite"),
    "history": ("gearboxes.sqlite --report history.html",),
    "evaluate": ("measured/", "measured/ --model output_torque --report evaluation.html"),
    "features": ("measured/ --report features.html",),
    "plan": ("--worn-count 3 --noise 0.2", "--worn-count 1 --noise 0.2 --wear"),
    "campaign": ("--example design.json", "design.json --out campaign/"),
    "gap": (
        "measured/ --out gap.html",
        "measured/ --hold-out 0.4 --out gap.html --save-simulator corrected.json",
    ),
    "serve": ("",),
    "demo": ("--out demo",),
}


def command_module(name: str) -> ModuleType:
    return importlib.import_module(f"cyclofeat.cli.{name}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line, by default with ``sys.argv[1:]``, and return the exit code.

    It is 0 on success; 2 for bad input, with one line on standard error that says what is wrong; 3 if a
    recording was refused and ``--strict`` asks for it; 130 after Ctrl-C; 141 if standard output was closed.
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
            # One line, without the place in the code.
            warnings.showwarning = lambda message, *_, **__: print_message(
                f"cyclofeat: warning: {' '.join(str(message).split())}"
            )
            return _run_and_print(arguments)
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


def _run_and_print(arguments: Arguments) -> int:
    """Run a command, print each result as soon as it is known, and return the exit code.

    Errors of input and surroundings, and any of one file, are results too; other errors are defects of the
    toolkit and keep their traceback.
    """
    failed = refused = False
    # Results of "lines" are lines of JSON anyway, a list on request.
    _, output = COMMANDS[arguments.command]
    in_lines = arguments.json if output == "lines" else getattr(arguments, "jsonl", False)
    documents = []
    try:
        for printed in _printed_results(arguments):
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
            document = documents if output == "list" else functools.reduce(operator.or_, documents)
            print(json.dumps(document, indent=2), flush=True)
    return 2 if failed else 3 * refused


def _printed_results(arguments: Arguments) -> Iterator[Printed]:
    """Run a command and yield what is printed of each result, and of the error that ends it."""
    try:
        if sys.stdout is None:
            raise OSError("standard output is closed: direct it to a file, or to the null device")
        arguments.check_targets()
        for path in getattr(arguments, "effects_from", ()):
            from cyclofeat.simulators import load_effects

            load_effects(path)
        result = command_module(arguments.command).run(arguments)
        yield from result if isinstance(result, Iterator) else (result,)
    except expected_errors() as error:
        cause: BaseException | None = error
        while cause is not None:
            if isinstance(cause, KeyboardInterrupt):  # as in the import of a compiled module
                raise KeyboardInterrupt from error
            cause = cause.__cause__ or cause.__context__
        text = arguments.error_text(error)
        yield Printed("", {"error": text}, text, failed=True)


def _close_output() -> None:
    """Write nothing more to standard output, not even at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def make_parser(complete: Collection[str] = tuple(COMMANDS)) -> RaisingParser:
    """Return the parser of the command line, with the arguments of some commands, by default of all."""
    parser = RaisingParser(
        prog="cyclofeat",
        description="Count and locate the worn lobes of a cycloidal disc from windows of output torque.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    parsers = parser.add_subparsers(required=True, metavar="COMMAND", dest="command", parser_class=Parser)
    for name, (text, output) in COMMANDS.items():
        lines = [f"  cyclofeat {name} {example}".rstrip() for example in EXAMPLES[name]]
        subparser = parsers.add_parser(
            name, help=text, description=text, epilog="\n".join(["examples:", *lines]),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        printing = subparser.add_mutually_exclusive_group()
        printing.add_argument("--json", action="store_true", help="print JSON for programs")
        if output == "list":
            printing.add_argument(
                "--jsonl", action="store_true", help="print one line of JSON per result, at once"
            )
        subparser.add_argument(
            "--quiet",
            action="store_true",
            help="print results, with their notes, warnings and errors, but no progress",
        )
        if name in complete:
            command_module(name).add_arguments(subparser)
    return parser
