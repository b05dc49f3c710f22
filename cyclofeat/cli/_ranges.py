"""Options that take a range of numbers."""

from __future__ import annotations

import argparse
from collections.abc import Callable


def range_of(unit: str) -> Callable[[str], tuple[float, float]]:
    """Return the type of an option that takes ``LOW:HIGH`` or one number.

    Examples
    --------
    >>> range_of("RPM")("100:1500"), range_of("Nm")("22")
    ((100.0, 1500.0), (22.0, 22.0))
    """

    def parse(text: str) -> tuple[float, float]:
        low, _, high = text.partition(":")
        try:
            ends = float(low), float(high or low)
        except ValueError:
            ends = 0.0, 0.0
        if not 0 < ends[0] <= ends[1] < float("inf"):
            raise argparse.ArgumentTypeError(
                f"must be LOW:HIGH or one number, in {unit} and positive, got {text!r}"
            )
        return ends

    return parse
