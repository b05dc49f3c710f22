"""Check of the speed of recordings by their torque alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cyclofeat.signal.lobes import comb_prominence, highest_frequency, lobe_frequency
from cyclofeat.signal.windows import Float

# Speeds of the search, as multiples of the nominal one; lines of adjacent speeds overlap.
_LOWEST, _HIGHEST, _STEP = 0.75, 1.25, 0.0008
_FIRST_LINE, _LINES, _FEWEST_LINES = 5, 35, 15
# The power ratio of a line is limited to this, so that a few strong lines do not look like a comb. Lines
# within the resolution of a mains harmonic are ignored; at least 12 others are needed.
_MOST, _MAINS_HZ, _WIDTH, _FEWEST_COUNTED = 4.0, (50.0, 60.0), 2.0, 12
# The mean ratio of 31 lines must exceed 1 by this (noise alone reaches 0.93 at the best of 625 speeds), and
# must exceed that of the nominal speed by this factor.
_STANDING_OUT, _CLEARLY = 0.95, 1.4
_MOST_WINDOWS = 8


def other_speed(
    X: Float, sampling_rate: float, input_speed_hz: float, tolerance: float, n_lobes: int = 15
) -> float | None:
    """Return the input speed of a recording if its lobe lines clearly contradict the nominal one.

    ``X`` holds windows of one recording, shape (n_windows, n_samples), in Nm; the result is in turns per
    second. Deviations up to the relative ``tolerance`` are none.

    The lines of the input shaft at the nominal speed coincide with the lobe lines at z_s/(z_s + 1) times that
    speed. They count as lines of the shaft, so that a recording at exactly that speed is not detected.
    Anything else that repeats 0.8 to 1.3 times per turn of the input looks like lobes at another speed.
    """
    fitting = int(sampling_rate / 2 / highest_frequency(input_speed_hz, n_lobes, 1, _HIGHEST - 1))
    if fitting < _FEWEST_LINES:
        return None
    numbers = np.arange(_FIRST_LINE, min(_LINES, fitting) + 1)
    factors = np.arange(_LOWEST, _HIGHEST, _STEP)
    first = max(0, (len(X) - _MOST_WINDOWS) // 2)
    middle = X[first : first + _MOST_WINDOWS]
    ratios = comb_prominence(middle, sampling_rate, input_speed_hz, factors, numbers, n_lobes)
    lines = np.outer(factors, numbers * lobe_frequency(input_speed_hz, n_lobes))
    counted = _apart_from_mains(lines, _WIDTH * sampling_rate / X.shape[1])
    n_counted = counted.sum(axis=1)
    above = ((np.minimum(ratios, _MOST).mean(axis=0) - 1) * counted).sum(axis=1) / np.maximum(n_counted, 1)
    # The mean of fewer lines scatters more.
    standing_out = above * np.sqrt(n_counted / (_LINES - _FIRST_LINE + 1))
    known = n_counted >= _FEWEST_COUNTED
    of_shaft = n_lobes / (n_lobes + 1)
    expected = np.minimum(np.abs(factors - 1), np.abs(factors / of_shaft - 1)) <= tolerance + _STEP
    if not np.any(known & expected):
        return None
    elsewhere = int(np.argmax(np.where(known & ~expected, above, -1.0)))
    nominal = above[known & expected].max()
    if standing_out[elsewhere] < _STANDING_OUT or 1 + above[elsewhere] < _CLEARLY * (1 + nominal):
        return None
    return float(factors[elsewhere] * input_speed_hz)


def _apart_from_mains(frequencies: Float, width: float) -> NDArray[np.bool_]:
    """Frequencies that lie farther than the width from all harmonics of the mains."""
    apart = np.ones(frequencies.shape, dtype=bool)
    for mains in _MAINS_HZ:
        harmonic = mains * np.maximum(1, np.round(frequencies / mains))
        apart &= np.abs(frequencies - harmonic) > width
    return apart
