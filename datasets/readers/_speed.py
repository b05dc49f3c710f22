"""Speed of a torque record by its lobe lines."""

from __future__ import annotations

import numpy as np

from cyclofeat.datasets.readers._columns import Float
from cyclofeat.signal.orders import estimate_input_speed

_LEAST_TURNS, _MOST_TURNS = 1.0, 8.0
_FIRST_LINE, _LAST_LINE, _PROMINENCE_DB = 5, 44, 3.0
_TOLERANCE = 0.05


def speed_by_lines(torque: Float, sampling_rate: float, nominal_hz: float, reduction: int) -> float | None:
    """Input speed in turns per second by the lobe lines; None where they do not stand out.

    :func:`cyclofeat.signal.orders.estimate_input_speed` returns some speed for any record: the multiples of
    (z_s + 1)/z_s of the input speed have to stand 3 dB above the median of the spectrum between them, in the
    mean over lines.
    """
    turn = reduction / nominal_hz * sampling_rate
    if torque.size < _LEAST_TURNS * turn * (1 - _TOLERANCE):
        return None
    window = torque[: int(min(torque.size, _MOST_TURNS * turn))]
    lobe = (reduction + 1) / reduction * nominal_hz
    last = min(_LAST_LINE, int(0.5 * sampling_rate / (lobe * (1 + _TOLERANCE))) - 1)
    if last < reduction + 1:
        return None
    try:
        speeds = estimate_input_speed(
            window[np.newaxis], sampling_rate, nominal_hz, _TOLERANCE, n_lobes=reduction
        )
    except ValueError:  # the comb lies beyond half of the sampling rate
        return None
    speed = float(speeds[0])
    n_points = 1 << (4 * window.size - 1).bit_length()
    power = np.abs(np.fft.rfft((window - window.mean()) * np.hanning(window.size), n_points)) ** 2
    spacing = (reduction + 1) / reduction * speed * n_points / sampling_rate  # in bins
    half, near = 0.45 * spacing, 2.0 * n_points / window.size
    decibels = []
    for line in range(_FIRST_LINE, last + 1):
        at = line * spacing
        low, high = int(at - half), int(at + half) + 1
        around = power[low:high]
        offset = np.abs(np.arange(low, low + around.size) - at)
        floor = float(np.median(around[offset > near])) if np.any(offset > near) else 0.0
        peak = float(power[round(at)])
        if floor > 0 and peak > 0:
            decibels.append(10 * np.log10(peak / floor))
    return speed if decibels and float(np.mean(decibels)) >= _PROMINENCE_DB else None
