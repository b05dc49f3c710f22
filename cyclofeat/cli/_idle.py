"""Options that have no effect beside others."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from cyclofeat.cli._reading import option_of

__all__ = ["refuse_idle"]


def refuse_idle(arguments: argparse.Namespace, names: Iterable[str], reason: str) -> None:
    """Raise ValueError if one of the named arguments was given, as it has no effect for the stated reason."""
    for name in names:
        if getattr(arguments, name) != arguments.default_of(name):
            option = option_of(name, "")
            option = option if option != name else f"--{name.replace('_', '-')}"
            raise ValueError(f"{option} has no effect {reason}: leave it out")
