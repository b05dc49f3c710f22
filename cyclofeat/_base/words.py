"""Numbers in the sentences that people read."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable


def number_of(n: int, thing: str) -> str:
    """Return ``1 lobe``, ``2 lobes``."""
    return f"{n} {thing}" if n == 1 else f"{n} {thing}s"


def from_1(lobes: Iterable[int]) -> list[int]:
    """Return lobes or wheels, which Python counts from 0, as files, JSON and people count them: from 1."""
    return [int(lobe) + 1 for lobe in lobes]


def lobes_text(lobes: Iterable[int] | None) -> str:
    """Return lobes as people count them, from 1, separated by commas."""
    return ", ".join(map(str, from_1(sorted(lobes or ()))))


def beyond_text(below: float, above: float, text: Callable[[float], str] = "{:.3g}".format) -> str:
    """Return ``below 0.1 or above 2``; a NaN is no end, and two of them give an empty text."""
    ends = (("below", below), ("above", above))
    return " or ".join(f"{word} {text(end)}" for word, end in ends if not math.isnan(end))


def unit_text(unit: str) -> str:
    """Return the unit behind a space; nothing for the unit of a pure number, ``"1"``."""
    return "" if unit == "1" else f" {unit}"
