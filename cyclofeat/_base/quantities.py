"""Quantities that are recorded at a gearbox, their units, and numbers in the sentences that people read."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

#: Unit of each quantity that a recording may hold.
QUANTITY_UNITS: Mapping[str, str] = MappingProxyType(
    {"output_torque": "Nm", "input_torque": "Nm", "motor_current": "A"}
)
#: Quantities that a recording may hold; the first is the default.
QUANTITIES = tuple(QUANTITY_UNITS)
#: Those of a torque meter.
TORQUES = QUANTITIES[:2]
#: Channel of a simulated run that holds each quantity.
CHANNELS: Mapping[str, str] = MappingProxyType(
    {"output_torque": "torque_out", "input_torque": "torque_in", "motor_current": "motor_current"}
)


def factor_to_output(quantity: str, n_lobes: int) -> int:
    """Return the factor that refers a torque to the output: number of lobes at the input shaft, else 1."""
    return n_lobes if quantity == "input_torque" else 1


def in_words(quantity: str) -> str:
    """Return a quantity as sentences name it: ``motor current``."""
    return quantity.replace("_", " ")


def rig_in_words(name: str) -> str:
    """Return ``rig R2``; without a name of its own a rig is called "rig"."""
    return "an unnamed rig" if name == "rig" else f"rig {name}"


def source_in_words(source: str | None) -> str:
    """Return the source of a recording in words; files say ``surrogate`` of the torque of a simulated rig."""
    return "simulated" if source == "surrogate" else source or ""


def number_of(n: float, thing: str) -> str:
    """Return ``1 lobe``, ``2 lobes``, ``0.98 output turns``, ``3 assemblies``."""
    things = f"{thing[:-1]}ies" if thing.endswith("y") else f"{thing}s"
    return f"{n} {thing if n == 1 else things}"


def some_of(
    things: Iterable[object], most: int = 4, text: Callable[[Any], str] = str, separator: str = ", "
) -> str:
    """Return ``a, b, c, d and 3 more``, by the text of each."""
    listed = list(things)
    more = f" and {len(listed) - most} more" if len(listed) > most else ""
    return separator.join(map(text, listed[:most])) + more


def from_1(lobes: Iterable[int]) -> list[int]:
    """Return lobes or wheels, which Python counts from 0, as files, JSON and people count them: from 1."""
    return [int(lobe) + 1 for lobe in lobes]


def lobes_text(lobes: Iterable[int] | None, n_lobes: int | None = None) -> str:
    """Return lobes as people count them, from 1, separated by commas.

    Of a disc of ``n_lobes``, neighbours across its last lobe stay together: ``14, 15, 1, 2``.
    """
    ordered = sorted(lobes or ())
    if ordered and ordered[0] == 0 and ordered[-1] + 1 == n_lobes:
        start = len(ordered) - 1
        while start and ordered[start] == ordered[start - 1] + 1:
            start -= 1
        ordered = ordered[start:] + ordered[:start]
    return ", ".join(map(str, from_1(ordered)))


def beyond_text(below: float, above: float, text: Callable[[float], str] = "{:.3g}".format) -> str:
    """Return ``below 0.1 or above 2``; a NaN is no end, and two of them give an empty text."""
    ends = (("below", below), ("above", above))
    return " or ".join(f"{word} {text(end)}" for word, end in ends if not math.isnan(end))


def unit_text(unit: str) -> str:
    """Return the unit behind a space; nothing for the unit of a pure number, ``"1"``."""
    return "" if unit == "1" else f" {unit}"


def probability_text(probability: float) -> str:
    """Return a probability as text; "> 0.99" if it rounds to 1, "< 0.01" if it rounds to 0."""
    if probability >= 0.995:
        return "> 0.99"
    return f"{probability:.2f}" if probability >= 0.005 else "< 0.01"


def quantity_parts(values: Sequence[float], unit: str) -> tuple[list[str], str]:
    """Return values of one unit as texts, in millionths if all are small, and the unit as people write it."""
    for plain, largest, millionth in (("m", 1e-3, "\N{MICRO SIGN}m"), ("1", 2e-3, "ppm")):
        if unit == plain and all(not abs(value) >= largest for value in values):
            values, unit = [1e6 * value for value in values], millionth
    texts = []
    for value in values:  # three significant digits; large numbers without powers of ten
        digits = f"{value:.3g}"
        texts.append("infinite" if math.isinf(value) else digits)
        if 1e3 <= abs(value) < 1e7:
            texts[-1] = f"{float(digits):.0f}"
    return texts, re.sub(r"(?<=[a-z])2", "\N{SUPERSCRIPT TWO}", unit)


def quantity_text(values: Sequence[float], unit: str) -> str:
    """Return one value, or a range, with its unit."""
    texts, shown = quantity_parts(values, unit)
    return " to ".join(texts) + unit_text(shown)
