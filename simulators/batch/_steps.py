"""Steps of the states in time.

A table begins with four rows for each of its n states: the state, the same at this evaluation, its rate at
the last one, and what rounding cut off.
"""

from __future__ import annotations

from cyclofeat.simulators._jit import inner_njit
from cyclofeat.simulators.batch._vectors import FASTMATH, load, store


@inner_njit(fastmath=FASTMATH, forceinline=True)
def _grow(k, n, increment, table, lanes):
    """Add to a state, and keep what rounding cuts off for the next time."""
    old = load(table, k, lanes)
    whole = increment - load(table, 3 * n + k, lanes)
    new = old + whole
    store(table, 3 * n + k, (new - old) - whole)
    store(table, k, new)
    store(table, n + k, new)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def midpoint(k, n, odd, dt, rate, table, lanes):
    """Half a step of a state, or the whole step with the rate at its middle."""
    if odd:
        _grow(k, n, dt * rate, table, lanes)
    else:
        store(table, n + k, load(table, k, lanes) + (0.5 * dt) * rate)


@inner_njit(fastmath=FASTMATH, forceinline=True)
def adams_bashforth(k, n, dt, is_first, rate, push, table, lanes):
    """A step of a state from its rates now and at the last step; ``push`` is added as it is."""
    # The first step has no earlier rates: Euler's rule, of second order in one step.
    before = 0.0 if is_first else 0.5 * dt
    _grow(k, n, push + ((dt + before) * rate - before * load(table, 2 * n + k, lanes)), table, lanes)
    store(table, 2 * n + k, rate)
