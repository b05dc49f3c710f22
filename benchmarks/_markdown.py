"""Tables in Markdown, and shares with their intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from scipy.stats import binomtest


def table(head: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """Return a table; it ends with a line break."""
    ruled = f"{line(head)}|{'---|' * len(head)}\n"
    return ruled + "".join(line(row) for row in rows)


def line(cells: Iterable[object]) -> str:
    """Return a row of a table, with its line break."""
    return f"| {' | '.join(str(cell) for cell in cells)} |\n"


def wilson(k: int, n: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share k/n.

    Examples
    --------
    >>> [round(end, 4) for end in wilson(8, 10)]
    [0.4902, 0.9433]
    """
    low, high = binomtest(k, n).proportion_ci(method="wilson")
    return float(low), float(high)


def share(k: int, n: int) -> str:
    """Return a share with its interval.

    Examples
    --------
    >>> share(8, 10)
    '0.800 [0.490, 0.943]'
    """
    low, high = wilson(k, n)
    return f"{k / n:.3f} [{low:.3f}, {high:.3f}]"
