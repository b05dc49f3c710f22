"""The table of commands, what is printed of their results, and messages on standard error."""

from __future__ import annotations

import importlib
import sys
from argparse import ArgumentParser, Namespace
from dataclasses import dataclass
from typing import Any, Literal, Protocol, cast

from cyclofeat._base.progress import erase_progress, is_hidden


@dataclass(frozen=True)
class Printed:
    """Printed form of a result: text for people, plain values for JSON, and an error.

    ``failed`` makes the exit code 2, ``refused`` makes it 3 if nothing failed.
    """

    text: str
    json: Any
    error: str = ""
    failed: bool = False
    refused: bool = False


class CommandModule(Protocol):
    """Parts of a command's module."""

    def add_arguments(self, parser: ArgumentParser) -> None:
        """Add the arguments of the command."""

    def run(self, arguments: Namespace) -> Any:
        """Return the result, or generate one result after the other."""

    def format_result(self, arguments: Namespace, result: Any) -> Printed:
        """Return what is printed of a result."""


@dataclass(frozen=True)
class Command:
    """One command: its help, its module, and its JSON: one document, a list, or a line for each result."""

    text: str
    module_name: str
    output: Literal["one", "list", "lines"] = "one"

    def module(self) -> CommandModule:
        """Import the command's module."""
        return cast("CommandModule", importlib.import_module(f"cyclofeat.cli.{self.module_name}"))


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


def show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning as one line, without the place in the code."""
    print_message(f"cyclofeat: warning: {' '.join(str(message).split())}")


def note(message: str) -> None:
    """Print a line on standard error, unless ``--quiet`` was given."""
    if not is_hidden():
        print_message(message)


def warn(error: str) -> None:
    """Print an error as one line on standard error."""
    print_message(f"cyclofeat: error: {error}")


def print_message(message: str) -> None:
    """Print a line on standard error, below no line of progress."""
    erase_progress()
    print(message, file=sys.stderr, flush=True)
