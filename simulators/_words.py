"""Values in the words of errors."""

from __future__ import annotations

from typing import Any

_LONGEST = 60


def short(value: Any) -> str:
    """What ``repr`` says of a value, cut off where it is long."""
    text = repr(value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
