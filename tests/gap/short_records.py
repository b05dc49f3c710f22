"""Kinematics of the gap workflow's tests: short to simulate, short to summarise."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from cyclofeat.gap import Comparison
from cyclofeat.gap.simulations import Bank
from cyclofeat.simulators import BrakeRotor, CycloidalGearbox, Noise, Rig

# One turn of the output at three times the usual speed takes a third of the time to simulate.
SPEED = 1500 / 60
RATE, N_SAMPLES, DURATION = 6400.0, 3840, 0.6
GEARBOX = CycloidalGearbox.steel(input_speed=2 * math.pi * SPEED, ramp_time=0.05)
# A brake so light, and a meter damped so well, that it settles soon.
BASE = Rig(GEARBOX, [BrakeRotor(0.005, 1e4, 0.05), Noise(0.05)], name="R1")

# What the fixture ``recorded`` is.
Recorder = Callable[..., Bank]


def short(**options: Any) -> Comparison:
    """A comparison under these conditions, by default with the gearbox alone."""
    return Comparison(**{"sampling_rate": RATE, "duration": DURATION, "rig": Rig(GEARBOX)} | options)
