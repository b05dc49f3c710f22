"""Size of the recordings of the gap workflow's tests."""

from __future__ import annotations

from collections.abc import Callable

from cyclofeat.gap import Bank

# One turn of the output at a quarter of the usual rate: as long to simulate, four times quicker to summarise.
RATE, N_SAMPLES = 6400.0, 11_520

# What the fixture ``recorded`` is.
Recorder = Callable[..., Bank]
