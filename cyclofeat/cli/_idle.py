"""Options that have no effect beside others: stated with the options, and refused before any work."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple


class Idle(NamedTuple):
    """Arguments without effect where any of ``beside`` is given, or none of ``without``.

    Arguments are named as people read them: an option like ``--depth``, a positional argument by its metavar.
    The other side may state a value too, or a pattern for it: ``--quantity motor_current``, ``--model
    *.skops``.
    """

    names: tuple[str, ...]
    beside: Collection[str] = ()
    without: Collection[str] = ()


class CommandParser(argparse.ArgumentParser):
    """Parser of one command; its result also holds ``typed``, the values that were typed, by name."""

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse as usual, and a second time without defaults, for what was typed."""
        parsed, rest = super().parse_known_args(args, namespace)
        defaults = [(action, action.default) for action in self._actions]
        try:
            for action, _ in defaults:
                action.default = argparse.SUPPRESS
            typed = vars(super().parse_known_args(args)[0])
        finally:
            for action, default in defaults:
                action.default = default
        parsed.typed = {
            name_of(action): typed[action.dest] for action in self._actions if action.dest in typed
        }
        return parsed, rest


def name_of(action: argparse.Action) -> str:
    """Return an argument's name as people read it."""
    return action.option_strings[0] if action.option_strings else str(action.metavar or action.dest)


def add_idle(
    parser: argparse.ArgumentParser,
    *names: str,
    beside: Collection[str] = (),
    without: Collection[str] = (),
) -> None:
    """State that the arguments named have no effect beside any of some others, or without all of them."""
    parser.set_defaults(idle=(*(parser.get_default("idle") or ()), Idle(names, beside, without)))


def refuse_idle(arguments: argparse.Namespace) -> None:
    """Raise ValueError if an argument was typed that has no effect beside the others."""
    for names, beside, without in getattr(arguments, "idle", ()):
        present = next((text for one in beside if (text := _typed(arguments.typed, one))), "")
        reason = f"with {present}" if present else ""
        if without and not any(_typed(arguments.typed, one) for one in without):
            *others, last = without
            reason = f"without {', '.join(others)}{' or ' if others else ''}{last}"
        for name in names:
            if reason and name in arguments.typed:
                raise ValueError(f"{name} has no effect {reason}: leave it out")


def _typed(typed: dict[str, Any], wanted: str) -> str:
    """Return an argument as it was typed, empty where it was not, or with another value than is wanted."""
    name, _, pattern = wanted.partition(" ")
    if name not in typed:
        return ""
    if not pattern:
        return name
    value = str(typed[name])
    return f"{name} {value}" if fnmatchcase(value.lower(), pattern) else ""
