"""Quantity of a channel, by its name and its unit."""

from __future__ import annotations

import re

TORQUE_UNITS = {"Nm": 1.0, "kNm": 1e3, "mNm": 1e-3, "Ncm": 1e-2, "Nmm": 1e-3}
CURRENT_UNITS = {"A": 1.0, "mA": 1e-3}
# Of the rated current: kept as they are, since a count does not depend on the scale.
RELATIVE_UNITS = {"%": 1.0, "p.u.": 1.0}
UNITS_OF = {"output_torque": TORQUE_UNITS, "input_torque": TORQUE_UNITS, "motor_current": CURRENT_UNITS}

_TORQUE, _CURRENT = "torque|(?:dreh)?moment", "current|strom"
_OUT, _IN = "out(?:put)?|abtriebs?|ausgangs?", "in(?:put)?|motor|drive|antriebs?|eingangs?"
# Names by which a channel is taken for a quantity; a torque that names no side is the output's.
_USUAL = {
    "output_torque": f"(?:{_OUT})? ?(?:{_TORQUE})|(?:{_TORQUE}) (?:{_OUT})",
    "input_torque": f"(?:{_IN}) ?(?:{_TORQUE})|(?:{_TORQUE}) (?:{_IN})",
    "motor_current": f"(?:motor)? ?(?:{_CURRENT})|(?:{_CURRENT}) motor|i ?q|i motor|motor i",
}
# Words that state the quantity in any other name.
_WORDS = {
    "motor_current": rf"{_CURRENT}|\bi ?q\b",
    "input_torque": rf"\b(?:{_IN})\b|motor|antrieb|eingang",
    "output_torque": rf"\b(?:{_OUT})\b|abtrieb|ausgang",
}


def is_usual(name: str, quantity: str) -> bool:
    """Return True for a usual name of a quantity, in lower case and without its unit.

    Examples
    --------
    >>> is_usual("drehmoment abtrieb", "output_torque"), is_usual("torque", "input_torque")
    (True, False)
    """
    return re.fullmatch(_USUAL[quantity], _spaced(name)) is not None


def named_quantity(name: str) -> str | None:
    """Return the quantity that words in a channel's name state, or None.

    Examples
    --------
    >>> named_quantity("motor phase current"), named_quantity("torque in"), named_quantity("torque")
    ('motor_current', 'input_torque', None)
    """
    return next((quantity for quantity, words in _WORDS.items() if re.search(words, _spaced(name))), None)


def _spaced(name: str) -> str:
    return re.sub(r"[\s_.\-]+", " ", name).strip()
