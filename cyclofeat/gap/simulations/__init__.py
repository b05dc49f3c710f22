"""Simulated recordings of the model.

A :class:`Population` describes recordings of a rig and how they may differ. :func:`simulate_bank` simulates
them, and :class:`Memory` stores them.
"""

from cyclofeat.gap.simulations._memory import Memory, versions
from cyclofeat.gap.simulations._population import (
    KERNEL,
    MAY_DIFFER,
    NO_SUCH_RIG,
    SOLVER,
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
    "KERNEL",
    "MAY_DIFFER",
    "NO_SUCH_RIG",
    "SOLVER",
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
