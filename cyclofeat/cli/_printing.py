"""Printing of results, for people or for programs, and of messages."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Iterator

from cyclofeat.cli._reading import error_text
from cyclofeat.cli._rigs import load_own_effects
from cyclofeat.cli._table import Command


def run_and_print(command: Command, arguments: Namespace) -> bool:
    """Run a command, print each result as soon as it is known, and return True if one failed."""
    module = command.module()
    load_own_effects(arguments)
    outcome = module.run(arguments)
    failed = False
    documents = []
    for result in outcome if isinstance(outcome, Iterator) else (outcome,):
        printed = module.printed(arguments, result)
        failed = failed or printed.failed
        if printed.error:
            warn(printed.error)
        if not arguments.json:
            if printed.text:
                print(printed.text, flush=True)
        elif command.output == "lines":
            print(json.dumps(printed.json), flush=True)
        else:
            documents.append(printed.json)
    if arguments.json and command.output != "lines":
        print(json.dumps(documents if command.output == "list" else documents[0], indent=2))
    return failed


def note(message: str) -> None:
    """Print a line on standard error."""
    print(message, file=sys.stderr, flush=True)


def warn(error: Exception | str) -> None:
    """Print an error as one line on standard error."""
    note(f"cyclofeat: error: {error if isinstance(error, str) else error_text(error)}")
