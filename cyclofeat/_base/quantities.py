"""Quantities that are recorded at a gearbox, and their units."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

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


def in_words(quantity: str) -> str:
    """Return a quantity as sentences name it: ``motor current``."""
    return quantity.replace("_", " ")
