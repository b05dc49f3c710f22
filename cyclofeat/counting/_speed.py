"""Whether recordings turn at the speed that a model was trained for, by their torque alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cyclofeat.lobes import comb_prominence, highest_frequency

Float = NDArray[np.float64]

# Speeds looked at, as multiples of the nominal one; in windows of an output turn lines of neighbours overlap.
_LOWEST, _HIGHEST, _STEP = 0.75, 1.25, 0.0008
_LINES, _FEWEST_LINES = 35, 15
# No line counts for more than this ratio of power: seven harmonics of the mains are no comb of 31 lines.
_MOST = 4.0
# The mean ratio from which a comb stands out at all (noise has up to 1.8 at the best of 625 speeds), and how
# much more than the nominal one it has to.
_STANDING_OUT, _CLEARLY = 1.85, 1.4
_MOST_WINDOWS = 8


def other_speed(
    X: Float, sampling_rate: float, input_speed_hz: float, tolerance: float, n_lobes: int = 15
) -> float | None:
    """Input speed of a recording, where its lobe lines say clearly that it is not the nominal one.

    The lines of the input shaft at the nominal speed are the lobe lines of a speed z_s/(z_s + 1) as high, and
    taken for the former: a disc whose lobes hardly differ shows hardly anything else. A recording at that
    very speed is not found out.

    Parameters
    ----------
    X : ndarray, shape (n_windows, n_samples)
        Windows of torque in Nm, of one recording.
    sampling_rate : float
    input_speed_hz : float
        Nominal input speed in turns per second.
    tolerance : float
        Relative deviation from it that is none.
    n_lobes : int, default=15

    Returns
    -------
    float or None
        In turns per second; None where nothing speaks against the nominal speed.
    """
    fitting = int(sampling_rate / 2 / highest_frequency(input_speed_hz, n_lobes, 1, _HIGHEST - 1))
    if fitting < _FEWEST_LINES:
        return None
    factors = np.arange(_LOWEST, _HIGHEST, _STEP)
    ratios = comb_prominence(
        X[:_MOST_WINDOWS],
        sampling_rate,
        input_speed_hz,
        factors,
        n_lobes=n_lobes,
        n_lines=min(_LINES, fitting),
    )
    found = np.minimum(ratios, _MOST).mean(axis=(0, 2))
    of_shaft = n_lobes / (n_lobes + 1)
    expected = np.minimum(np.abs(factors - 1), np.abs(factors / of_shaft - 1)) <= tolerance + _STEP
    elsewhere = int(np.argmax(np.where(expected, 0.0, found)))
    if found[elsewhere] < max(_STANDING_OUT, _CLEARLY * found[expected].max()):
        return None
    return float(factors[elsewhere] * input_speed_hz)
