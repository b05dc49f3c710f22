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


def factor_to_output(quantity: str, n_lobes: int) -> int:
    """Return the factor that refers a torque to the output: number of lobes at the input shaft, else 1."""
    return n_lobes if quantity == "input_torque" else 1


def in_words(quantity: str) -> str:
    """Return a quantity as sentences name it: ``motor current``."""
    return quantity.replace("_", " ")
