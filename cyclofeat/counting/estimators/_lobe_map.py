"""The lobe map that counters and locators of lobes stand on."""

from __future__ import annotations

from cyclofeat.features import LobeMap
from cyclofeat.signal.lobes import N_LINES, lines_held


def held_lobe_map(
    sampling_rate: float, input_speed_hz: float, n_lobes: int, speed_tolerance: float, most: int = N_LINES
) -> LobeMap:
    """Return a lobe map of the lobe lines that windows of the sampling rate hold, and at most so many."""
    n_lines = lines_held(sampling_rate, input_speed_hz, n_lobes, speed_tolerance, most)
    return LobeMap(
        sampling_rate, input_speed_hz=input_speed_hz, n_lobes=n_lobes, n_lines=n_lines,
        speed_tolerance=speed_tolerance,
    )  # fmt: skip
