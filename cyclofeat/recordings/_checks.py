"""Checks of the arguments of recordings and windowers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from cyclofeat._base.checks import flag, is_whole, number, one_of, positive, series, whole
from cyclofeat.signal.windows import LARGEST, Float

__all__ = ["defects", "flag", "label", "meta", "number", "one_of", "positive", "samples", "text", "whole"]

Label = str | int


def samples(name: str, values: Any) -> Float:
    given = np.asarray(values)
    array = series(name, given, least=2)
    # What was checked must not change afterwards: a copy, except of what nobody writes to.
    if array is given and (array.flags.writeable or not array.flags.owndata):
        array = array.copy()
    if not max(-array.min(), array.max()) <= LARGEST:
        where = int(np.argmax(np.abs(array)))
        raise ValueError(f"{name} must lie within +-{LARGEST:g}, got {array[where]} at sample {where}")
    array.flags.writeable = False
    return array


def text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{name} must be text, got {value!r}")
    # Line ends would break files and tables, and NumPy drops trailing NULs, so that two names became one.
    if not value or not value.isprintable():
        raise ValueError(f"{name} must be a line of printable text, got {value!r}")
    return str(value)


def label(name: str, value: Any) -> Label | None:
    if value is None or isinstance(value, str):
        return None if value is None else text(name, value)
    if not is_whole(value):
        raise TypeError(f"{name} must be text or a whole number, got {value!r}")
    if not -(2**63) <= value < 2**63:
        raise ValueError(f"{name} must fit into 64 bits, got {value!r}")
    return int(value)


def meta(value: Any) -> dict[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise TypeError(f"meta must be a mapping from text to values, got {value!r}")
    for key in value:
        if not isinstance(key, str):
            raise TypeError(f"meta must have text as keys, got {key!r}")
    return dict(value)


def defects(worn_lobes: Any, defect_count: Any, n_lobes: int) -> tuple[tuple[int, ...] | None, int | None]:
    count = None if defect_count is None else whole("defect_count", defect_count, 0)
    if count is not None and count > n_lobes:
        raise ValueError(f"defect_count must be at most n_lobes = {n_lobes}, got {count}")
    if worn_lobes is None:
        return () if count == 0 else None, count
    if isinstance(worn_lobes, str) or not isinstance(worn_lobes, Iterable):
        raise TypeError(f"worn_lobes must be a sequence of lobe indices from 0, got {worn_lobes!r}")
    lobes = tuple(sorted(whole("worn_lobes", lobe, 0) for lobe in worn_lobes))
    if len(set(lobes)) != len(lobes):
        raise ValueError(f"worn_lobes must be distinct, got {lobes}")
    if lobes and lobes[-1] >= n_lobes:
        raise ValueError(
            f"worn_lobes must lie between 0 and {n_lobes - 1} (n_lobes = {n_lobes}, counted from 0; "
            f"files count from 1), got {lobes}"
        )
    if count is not None and count != len(lobes):
        raise ValueError(
            f"defect_count must be the number of worn_lobes, got {count} and {len(lobes)} lobes {lobes}"
        )
    return lobes, len(lobes)
