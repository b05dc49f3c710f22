"""Clipped samples, dropouts and the speed of a torque record."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cyclofeat.datasets.readers._columns import Float
from cyclofeat.signal.orders import estimate_input_speed

_SHORTEST_CLIP, _PILE = 3, 4.0
# Ten samples, and five times as long as nearly all others: slow or coarse records repeat values too.
_SHORTEST_HOLD, _HOLD_RATIO, _JUMP = 10, 5.0, 10.0
_LEAST_TURNS, _MOST_TURNS = 1.0, 8.0
_FIRST_LINE, _LAST_LINE, _PROMINENCE_DB = 5, 44, 3.0
_TOLERANCE = 0.05


def _runs(values: Float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First samples and lengths of the runs of equal values."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0) + 1])
    return starts, np.diff(np.concatenate([starts, [values.size]]))


def clipped(torque: Float) -> float:
    """Share of samples at the largest or smallest value, where samples pile up there.

    A converter or amplifier at its end repeats one value, far more often than the next one; the crest of a
    quantised wave does not.
    """
    if torque.size < _SHORTEST_CLIP:
        return 0.0
    starts, lengths = _runs(torque)
    share = 0.0
    values, counts = np.unique(torque, return_counts=True)
    for extreme, next_to in ((0, 1), (-1, -2)):
        if values.size < 2 or counts[extreme] < _PILE * counts[next_to]:
            continue
        if lengths[torque[starts] == values[extreme]].max() >= _SHORTEST_CLIP:
            share += float(counts[extreme]) / torque.size
    return share


def dropped(torque: Float) -> NDArray[np.bool_]:
    """Mark samples that repeat one value for long, or are exactly 0 between values far from it."""
    starts, lengths = _runs(torque)
    usual = float(np.quantile(lengths, 0.99))
    # At the ends of the range a held value is a clipped one.
    inner = (torque[starts] > torque.min()) & (torque[starts] < torque.max())
    stuck = inner & (lengths >= max(_SHORTEST_HOLD, _HOLD_RATIO * usual))
    step = float(np.median(np.abs(np.diff(torque))))
    if step == 0:  # coarse steps: their mean, since most samples repeat
        step = float(np.mean(np.abs(np.diff(torque))))
    ends = starts + lengths
    before = np.abs(torque[np.maximum(starts - 1, 0)])
    after = np.abs(torque[np.minimum(ends, torque.size - 1)])
    # At either end of the record one neighbour is all there is.
    before[starts == 0] = np.inf
    after[ends == torque.size] = np.inf
    zero = (torque[starts] == 0) & (np.minimum(before, after) > _JUMP * step) & (lengths < torque.size)
    return np.repeat(stuck | zero, lengths)


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
