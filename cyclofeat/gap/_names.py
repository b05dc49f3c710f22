"""Names of effects that are given, checked against those there are."""

from __future__ import annotations

from collections.abc import Iterable


def different_names(given: Iterable[str], known: Iterable[str], argument: str) -> tuple[str, ...]:
    """The names as they were given.

    Parameters
    ----------
    given : iterable of str
    known : iterable of str
        Names that there are.
    argument : str
        What the names were given as, for the error.

    Raises
    ------
    ValueError
        If there is none, one is unknown, or one stands twice.

    Examples
    --------
    >>> different_names(["hum"], ["gain", "hum"], "library")
    ('hum',)
    """
    names, there = tuple(given), tuple(known)
    if not names or not set(names) <= set(there) or len(set(names)) < len(names):
        got = ", ".join(map(str, names)) or "none"
        raise ValueError(f"{argument} must name different effects of {', '.join(there)}, got {got}")
    return names
