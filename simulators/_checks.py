"""What arguments must be, said in one way."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def short(value: Any) -> str:
    """The value as an error names it: in one line of at most 60 characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."


def is_whole(value: Any) -> bool:
    """Whether it is a whole number and no truth value."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def check_number(name: str, value: Any, what: str = "a number") -> None:
    """Raise TypeError unless it is a real number, and ValueError where no float is as large."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise TypeError(f"{name} must be {what}, got {short(value)}")
    try:
        float(value)
    except OverflowError:
        raise ValueError(f"{name} must be {what} and finite, got {short(value)}") from None


def number(name: str, value: Any, what: str) -> float:
    """The value as a float, which must be finite."""
    check_number(name, value, what)
    if not math.isfinite(value):
        raise ValueError(f"{name} must be {what} and finite, got {short(value)}")
    return float(value)


def whole(name: str, value: Any, least: int | None, most: int | None) -> int:
    """The value as an int, from ``least`` to ``most`` where they are given."""
    if not is_whole(value):
        raise TypeError(f"{name} must be a whole number, got {short(value)}")
    if least is not None and value < least:
        raise ValueError(f"{name} must be at least {least}, got {value!r}")
    if most is not None and value > most:
        raise ValueError(f"{name} must be at most {most}, got {value!r}")
    return int(value)


def pair(name: str, value: Any) -> tuple[float, float]:
    """Two finite numbers."""
    what = "a pair of numbers (low, high)"
    if not isinstance(value, (tuple, list, np.ndarray)):
        raise TypeError(f"{name} must be {what}, got {short(value)}")
    if len(value) != 2:
        raise ValueError(f"{name} must be {what}, got {len(value)} values {short(value)}")
    return number(name, value[0], what), number(name, value[1], what)


def members(values: Any) -> tuple[Any, ...] | None:
    """What an iterable holds; None where it is none."""
    try:
        return tuple(values)
    except TypeError:
        return None


def check_type(name: str, value: Any, kind: type) -> None:
    """Raise TypeError unless the value is of this kind."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} must be of type {kind.__name__}, got {short(value)}")


def generator(seed: Any) -> np.random.Generator:
    """The generator of a seed; a Generator is one already."""
    if isinstance(seed, (np.random.SeedSequence, np.random.Generator)):
        return np.random.default_rng(seed)
    if not is_whole(seed):
        raise TypeError(f"seed must be a whole number, a SeedSequence or a Generator, got {seed!r}")
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed!r}")
    return np.random.default_rng(int(seed))
