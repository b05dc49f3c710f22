"""Numbers in the sentences that people read."""

from __future__ import annotations

from collections.abc import Iterable


def number(n: int, thing: str) -> str:
    """Return ``1 lobe``, ``2 lobes``."""
    return f"{n} {thing}" if n == 1 else f"{n} {thing}s"


def lobes_text(lobes: Iterable[int] | None) -> str:
    """Return lobes, which Python counts from 0, as people count them: from 1, separated by commas."""
    return ", ".join(str(int(lobe) + 1) for lobe in sorted(lobes or ()))
