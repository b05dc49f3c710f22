"""Errors about arguments, in words that each caller can translate into its own."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple


class ArgumentError(ValueError):
    """An argument is missing or has a wrong value.

    The message names arguments as Python does (``give sampling_rate= (Hz)``). A caller that offers the same
    arguments under other names, such as the command line with its options, translates them with
    :meth:`format_message`.

    Parameters
    ----------
    template : str
        Message as for :meth:`str.format`. A field that is a key of ``details`` stands for its value. Any
        other field is the name of an argument; its format specification is what follows the name in Python:
        ``{channel}``, ``{sampling_rate:=}``, ``{angle_channel:=False}``, ``{channel: = {value!r}}``.
    **details
        Values of fields. ``argument`` is the name of an argument; a detail that is itself an ArgumentError is
        translated too.

    Examples
    --------
    >>> error = ArgumentError("{file}: give {sampling_rate:=} (Hz)", file="a.csv")
    >>> str(error)
    'a.csv: give sampling_rate= (Hz)'
    >>> error.format_message(lambda name, rest: "--" + name.replace("_", "-"))
    'a.csv: give --sampling-rate (Hz)'
    >>> str(ArgumentError("{argument} must be positive, got {value!r}", argument="speed_rpm", value=-1))
    'speed_rpm must be positive, got -1'
    """

    def __init__(self, template: str, **details: object) -> None:
        self.template, self.details = template, details
        super().__init__(self.format_message(str.__add__))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle template and details, from which the message follows."""
        return partial(type(self), self.template, **self.details), ()

    def format_message(self, spell: Callable[[str, str], str]) -> str:
        """Return the message with every argument named by ``spell(name, what follows it in Python)``."""
        return self.template.format_map(_Fields(self.details, spell))


class _Name(NamedTuple):
    """Name of an argument, formatted by ``spell``."""

    name: str
    spell: Callable[[str, str], str]

    def __format__(self, rest: str) -> str:
        return self.spell(self.name, rest)


class _Fields(dict[str, object]):
    """Fields of a template: details, else names of arguments."""

    def __init__(self, details: dict[str, object], spell: Callable[[str, str], str]) -> None:
        super().__init__(details)
        self.spell = spell

    def __getitem__(self, field: str) -> object:
        value = self.get(field, _Name(field, self.spell))
        if isinstance(value, ArgumentError):
            return value.format_message(self.spell)
        return _Name(str(value), self.spell) if field == "argument" else value


def different_names(given: Iterable[str], known: Iterable[str], argument: str) -> tuple[str, ...]:
    """Return the given names; raise ArgumentError unless they are different ones of the known names.

    Examples
    --------
    >>> different_names(["hum"], ["gain", "hum"], "library")
    ('hum',)
    """
    names, existing = tuple(given), tuple(known)
    if not names or not set(names) <= set(existing) or len(set(names)) < len(names):
        raise ArgumentError(
            "{argument} must name different effects of {known}, got {got}",
            argument=argument,
            known=", ".join(existing),
            got=", ".join(map(str, names)) or "none",
        )
    return names
