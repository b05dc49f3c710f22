"""Numbers of the gap's report as text."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from cyclofeat.report._page import keep_together


def percent_text(share: float) -> str:
    return keep_together(f"{100 * float(share):.0f} %") if math.isfinite(share) else "not defined"


def range_text(low: float, high: float) -> str:
    if not (math.isfinite(low) and math.isfinite(high)) or low == high:
        return ""
    return f"{100 * float(low):.0f} to {percent_text(high)}"


def quantity_text(values: Sequence[float], unit: str) -> str:
    """One value, or a range, with its unit."""
    if unit == "m" and all(abs(value) < 1e-3 for value in values):
        values, unit = [1e6 * value for value in values], "\N{MICRO SIGN}m"
    unit = re.sub(r"(?<=[a-z])2", "\N{SUPERSCRIPT TWO}", unit)
    texts = []
    for value in values:  # three significant digits; large numbers without powers of ten
        digits = f"{value:.3g}"
        texts.append("infinite" if math.isinf(value) else digits)
        if 1e3 <= abs(value) < 1e7:
            texts[-1] = f"{float(digits):.0f}"
    text = " to ".join(texts)
    return text if unit == "1" else f"{text}\N{NO-BREAK SPACE}{unit}"


def signed_text(value: float) -> str:
    return f"{value:+.2g}" if abs(value) < 10 else f"{value:+.0f}"


def rounded_text(value: float) -> str:
    """Two significant digits, without powers of ten."""
    if value < 10:
        return f"{value:.2g}"
    digits = 1 - math.floor(math.log10(value))
    return f"{round(value, digits):.0f}"
