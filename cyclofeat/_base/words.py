"""Numbers in the sentences that people read."""

from __future__ import annotations

from collections.abc import Iterable


def number(n: int, thing: str) -> str:
    """Return ``1 lobe``, ``2 lobes``."""
    return f"{n} {thing}" if n == 1 else f"{n} {thing}s"


def from_1(lobes: Iterable[int]) -> list[int]:
    """Return lobes or wheels, which Python counts from 0, as files, JSON and people count them: from 1."""
    return [int(lobe) + 1 for lobe in lobes]


def lobes_text(lobes: Iterable[int] | None) -> str:
    """Return lobes as people count them, from 1, separated by commas."""
    return ", ".join(map(str, from_1(sorted(lobes or ()))))
