"""Checks of arguments: each names the argument, what it must be and the value.

They raise TypeError for a wrong type and ValueError for a value out of range. Truth values are not numbers.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray


def repr_of(value: Any) -> str:
    """Return ``repr(value)`` in one line of at most 60 characters, for error messages."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."


def is_whole(value: Any) -> bool:
    """Return True for an int or a NumPy integer."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def is_number(value: Any) -> bool:
    """Return True for an int, a float or a NumPy number, NaN and infinity included."""
    return is_whole(value) or isinstance(value, (float, np.floating))


def check_number(name: str, value: Any, what: str = "a number") -> None:
    """Raise TypeError unless ``value`` is ``what``, and ValueError if it is too large for a float."""
    if not is_number(value):
        raise TypeError(f"{name} must be {what}, got {repr_of(value)}")
    try:
        float(value)
    except OverflowError:
        raise ValueError(f"{name} must be finite, got {repr_of(value)}") from None


def number(name: str, value: Any, what: str = "a number") -> float:
    """Return a finite number as a float."""
    if type(value) is float and math.isfinite(value):  # by far the most often
        return value
    check_number(name, value, what)
    return _require_float(math.isfinite(value), name, value, "finite")


def positive(name: str, value: Any, what: str = "a number") -> float:
    """Return a finite number above 0 as a float."""
    check_number(name, value, what)
    return _require_float(math.isfinite(value) and value > 0, name, value, "positive and finite")


def not_negative(name: str, value: Any) -> float:
    """Return a finite number of at least 0 as a float."""
    check_number(name, value)
    return _require_float(math.isfinite(value) and value >= 0, name, value, "finite and not negative")


def _require_float(right: bool, name: str, value: Any, what: str) -> float:
    if not right:
        raise ValueError(f"{name} must be {what}, got {value!r}")
    return float(value)


def whole(name: str, value: Any, least: int | None = None, most: int | None = None) -> int:
    """Return a whole number from ``least`` to ``most`` (no limit where None) as an int."""
    if not is_whole(value):
        raise TypeError(f"{name} must be a whole number, got {repr_of(value)}")
    if least is not None and value < least:
        raise ValueError(f"{name} must be at least {least}, got {value!r}")
    if most is not None and value > most:
        raise ValueError(f"{name} must be at most {most}, got {value!r}")
    return int(value)


def seed_number(random_state: Any) -> int:
    """Return a seed, a whole number of at least 0; draw one for None."""
    if random_state is None:
        return int(np.random.SeedSequence().generate_state(1)[0])
    return whole("random_state", random_state, 0)


def n_jobs(value: Any) -> int:
    """Return a number of workers as joblib takes it: any whole number except 0."""
    if not is_whole(value) or value == 0:
        raise ValueError(f"n_jobs must be a whole number of workers, or -1 for all, got {repr_of(value)}")
    return int(value)


def number_pair(name: str, value: Any, what: str = "a pair of numbers (low, high)") -> tuple[float, float]:
    """Return two finite numbers as floats."""
    if not isinstance(value, (tuple, list, np.ndarray)):
        raise TypeError(f"{name} must be {what}, got {repr_of(value)}")
    if len(value) != 2:
        raise ValueError(f"{name} must be {what}, got {len(value)} values {repr_of(value)}")
    return number(name, value[0], what), number(name, value[1], what)


def range_ends(name: str, value: Any, what: str = "a number") -> tuple[float, float]:
    """Return the ends of a range of ``what``; a number is a range of its own."""
    return number_pair(name, (value, value) if is_number(value) else value, f"{what} or a range (low, high)")


def number_series(name: str, values: Any, least: int = 1, kinds: str = "iuf") -> NDArray[np.float64]:
    """Return at least ``least`` finite numbers, of dtypes of these kinds, as a 1-D array of floats."""
    array = np.asarray(values)
    if array.dtype.kind not in kinds:
        raise TypeError(f"{name} must be an array of real numbers, got dtype {array.dtype}")
    if array.ndim != 1:
        raise ValueError(f"{name} must be 1-D, got shape {array.shape}")
    if array.size < least:
        samples = "sample" if least == 1 else "samples"
        raise ValueError(f"{name} must hold at least {least} {samples}, got {array.size}")
    array = np.asarray(array, dtype=np.float64)
    finite = np.isfinite(array)
    if not finite.all():
        where = int(np.argmin(finite))
        raise ValueError(f"{name} must be finite, got {array[where]} at sample {where}")
    return array


def truth_value(name: str, value: Any) -> bool:
    """Return True or False, also from a NumPy truth value."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} must be True or False, got {repr_of(value)}")
    return bool(value)


def one_of(name: str, value: Any, options: Iterable[str]) -> str:
    """Return ``value`` if it is one of the options."""
    known = tuple(options)
    if not isinstance(value, str) or value not in known:
        text = " or ".join(map(repr, known)) if len(known) < 3 else f"one of {', '.join(map(repr, known))}"
        raise ValueError(f"{name} must be {text}, got {repr_of(value)}")
    return value


def different_names(given: Iterable[str], known: Iterable[str], argument: str) -> tuple[str, ...]:
    """Return the given names; raise ValueError unless they are different ones of the known names."""
    names, existing = tuple(given), tuple(known)
    if not names or not set(names) <= set(existing) or len(set(names)) < len(names):
        got = ", ".join(map(str, names)) or "none"
        raise ValueError(f"{argument} must name different effects of {', '.join(existing)}, got {got}")
    return names


def list_members(values: Any) -> tuple[Any, ...] | None:
    """Return the members of an iterable, or None if ``values`` is not iterable."""
    try:
        return tuple(values)
    except TypeError:
        return None


def check_type(name: str, value: Any, kind: type) -> None:
    """Raise TypeError unless ``value`` is an instance of ``kind``."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} must be of type {kind.__name__}, got {repr_of(value)}")


def defect_counts(values: Any, n_lobes: int) -> tuple[int, ...]:
    """Return distinct numbers of worn lobes, at least one of them."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise TypeError(f"defect_counts must be several whole numbers, e.g. range(8), got {values!r}")
    counts = tuple(whole("defect_counts", count, 0, n_lobes) for count in values)
    if not counts or len(set(counts)) < len(counts):
        raise ValueError(f"defect_counts must be distinct and from 0 to {n_lobes}, got {list(counts)}")
    return counts


def wheel_numbers(value: Any) -> tuple[int, ...] | None:
    """Return the wheels that carry the wear, in order, or None for "random"."""
    if isinstance(value, str) and value == "random":
        return None
    given = list_members(value)
    for known in ((0,), (1,), (0, 1)):
        if given is not None and sorted(given, key=str) == list(known):
            return known
    raise ValueError(f"wheels must be 'random', (0,), (1,) or (0, 1), got {value!r}")


class Replaceable:
    """Base of frozen dataclasses that check their fields."""

    def replace(self, **changes: Any) -> Self:
        """Return a checked copy with single fields changed."""
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]
