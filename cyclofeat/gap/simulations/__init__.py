"""Recordings that the model alone would have given.

A :class:`Population` is a rig with all that may differ between its recordings. :func:`simulate_bank`
simulates recordings of it, :class:`Memory` keeps them.
"""

from cyclofeat.gap.simulations._memory import Memory, versions
from cyclofeat.gap.simulations._population import (
    MAY_DIFFER,
    NO_SUCH_RIG,
    SPARE,
    Bank,
    Population,
    Record,
    as_rig,
    record,
    simulate_bank,
    with_may_differ,
)

__all__ = [
    "MAY_DIFFER",
    "NO_SUCH_RIG",
    "SPARE",
    "Bank",
    "Memory",
    "Population",
    "Record",
    "as_rig",
    "record",
    "simulate_bank",
    "versions",
    "with_may_differ",
]
