"""Faults of a torque record: samples that are clipped, lost or off, filtered torque, noise that changes.

What is measured is compared with the record itself, so that it holds for any rig.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal.windows import hann

from cyclofeat.signal.lobes import LobeComb, lobe_frequency, lobe_lines
from cyclofeat.signal.windows import Float, ratio

__all__ = [
    "clipped",
    "dropped",
    "fresh_rate",
    "jumps",
    "local_speeds",
    "noise_change",
    "noise_level",
    "smoothness",
    "step_size",
    "weakest_part",
]

_SHORTEST_CLIP, _PILE = 3, 4.0
# Ten samples, and five times as long as nearly all others: slow or coarse records repeat values too.
_SHORTEST_HOLD, _HOLD_RATIO, _JUMP = 10, 5.0, 10.0
# Second differences below this share of the standard deviation belong to a straight line.
_STRAIGHT = 1e-9
# The standard deviation of normal noise, in median absolute deviations.
_OF_MEDIAN = 1.4826
_LOW_LINES, _HIGH_LINES = (3, 9), (44, 88)
# Parts of a window whose speed is searched up to this share beside the nominal one, by these lobe lines.
# Their power over the surroundings is limited, so that a few strong ones do not look like a comb.
_QUARTERS, _SEARCHED, _FIRST_LINE, _LAST_LINE, _STRONGEST = 4, 0.1, 3, 30, 6.0


def clipped(torque: Float) -> float:
    """Share of samples at the largest or smallest value, where samples pile up there.

    A converter or amplifier at its end repeats one value, far more often than the next one; the crest of a
    quantised wave does not.
    """
    at_ends = max(np.sum(torque == torque.min()), np.sum(torque == torque.max())) if torque.size else 0
    if at_ends < _SHORTEST_CLIP:
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
    """Mark samples that repeat one value or follow a straight line for long, or are 0 far from others."""
    starts, lengths = _runs(torque)
    # At the ends of the range a held value is a clipped one.
    inner = (torque[starts] > torque.min()) & (torque[starts] < torque.max())
    stuck = inner & _unusually_long(lengths)
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
    return np.repeat(stuck | zero, lengths) | _bridged(torque)


def _bridged(torque: Float) -> NDArray[np.bool_]:
    """Mark samples on long straight lines that rise or fall."""
    bend = np.abs(np.diff(torque, 2))
    straight = np.r_[False, (bend <= _STRAIGHT * torque.std()) & (np.diff(torque)[1:] != 0), False]
    # Each sample that is on no line is a run of its own.
    starts, lengths = _runs(np.where(straight, 0, np.arange(1, torque.size + 1)))
    return np.repeat(straight[starts] & _unusually_long(lengths), lengths)


def _runs(values: NDArray[np.generic]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First samples and lengths of the runs of equal values."""
    starts = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
    return starts, np.diff(np.concatenate([starts, [values.size]]))


def _unusually_long(lengths: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.asarray(lengths >= max(_SHORTEST_HOLD, _HOLD_RATIO * float(np.quantile(lengths, 0.99))))


def fresh_rate(torque: Float, sampling_rate: float) -> float:
    """Return how often per second the torque leaves a straight line: the rate that its samples carry."""
    return float(np.mean(np.abs(np.diff(torque, 2)) > _STRAIGHT * torque.std()) * sampling_rate)


def step_size(torque: Float) -> float:
    """Return the smallest change from one sample to the next: the step of a converter; 0 for a constant."""
    changes = np.abs(np.diff(torque))
    return float(changes[changes > 0].min(initial=np.inf)) if changes.any() else 0.0


def jumps(torque: Float) -> NDArray[np.float64]:
    """Return what each sample is off the mean of its neighbours, in multiples of the usual noise."""
    off = np.abs(torque[1:-1] - (torque[:-2] + torque[2:]) / 2)
    return np.asarray(np.pad(ratio(off, _OF_MEDIAN * np.median(off)), 1))


def noise_level(torque: Float) -> float:
    """Return the standard deviation of the noise by adjacent samples, in the torque's unit."""
    return float(_OF_MEDIAN * np.median(np.abs(np.diff(torque, 2))) / np.sqrt(6))


def noise_change(torque: Float, n_parts: int) -> float:
    """Return the largest ratio of the noise in parts of a record, measured between adjacent samples."""
    off = np.abs(np.diff(torque, 2))
    levels = [float(np.median(part)) for part in np.array_split(off, n_parts)]
    return max(levels) / min(levels) if min(levels) > 0 else np.inf


def smoothness(
    torque: Float, sampling_rate: float, input_speed_hz: float, n_lobes: int = 15
) -> tuple[float, float]:
    """Return how far the spectrum falls above the lobe lines of a count, in dB.

    First from lobe lines 3 to 9 to lines 44 to 88, then from the lines just below the latter. White noise of
    the sensor bounds the first and flattens the second; a low-pass filter behind the sensor lowers both. NaN
    where the sampling rate does not reach that far.
    """
    lobe = lobe_frequency(input_speed_hz, n_lobes)
    power = np.abs(np.fft.rfft((torque - torque.mean()) * hann(torque.size, sym=False))) ** 2
    frequencies = np.fft.rfftfreq(torque.size, 1 / sampling_rate)

    def level(lowest: float, highest: float) -> float:
        band = (frequencies >= lowest * lobe) & (frequencies < highest * lobe)
        return float(10 * np.log10(power[band].mean() + np.finfo(float).tiny))

    if _HIGH_LINES[1] * lobe > 0.4 * sampling_rate:
        return np.nan, np.nan
    high = level(*_HIGH_LINES)
    return high - level(*_LOW_LINES), high - level(_HIGH_LINES[0] / 1.5, _HIGH_LINES[0])


def weakest_part(
    torque: Float, sampling_rate: float, input_speed_hz: float, n_parts: int, n_lobes: int = 15
) -> float:
    """Return the power within the lobe lines 5 to 44 in the weakest of the parts, over the median, in dB."""
    spectrum = np.fft.rfft(torque - torque.mean())
    lobe = lobe_frequency(input_speed_hz, n_lobes)
    frequencies = np.fft.rfftfreq(torque.size, 1 / sampling_rate)
    spectrum[(frequencies < 5 * lobe) | (frequencies > 44 * lobe)] = 0
    parts = np.array_split(np.fft.irfft(spectrum, torque.size) ** 2, n_parts)
    power = np.array([part.mean() for part in parts])
    return float(10 * np.log10(power.min() / np.median(power))) if power.min() > 0 else -np.inf


def local_speeds(
    X: Float, sampling_rate: float, input_speed_hz: float, n_lobes: int = 15
) -> tuple[Float, Float]:
    """Return the input speed in each quarter of windows, and the evidence for it.

    Parameters
    ----------
    X : ndarray, shape (n_windows, n_samples)
        Torque.
    sampling_rate, input_speed_hz, n_lobes
        As for :func:`cyclofeat.signal.lobes.lobe_lines`; speeds up to 10 % beside are found.

    Returns
    -------
    speeds : ndarray, shape (n_windows, 4)
        As multiples of ``input_speed_hz``.
    evidence : ndarray, shape (n_windows, 4)
        Mean power of lobe lines 3 to 30 over the spectrum around them, less 1. Above 0.6 the speed is right
        within 1 % in 98 of 100 clean windows.
    """
    length = X.shape[1] // _QUARTERS
    quarters = X[:, : _QUARTERS * length].reshape(-1, length)
    comb = LobeComb(
        n_lobes, _LAST_LINE, speed_tolerance=_SEARCHED, searched=range(_FIRST_LINE, _LAST_LINE + 1)
    )
    lines = lobe_lines(quarters, sampling_rate, input_speed_hz, comb)
    power = np.minimum(ratio(np.abs(lines.lines) ** 2, lines.floor), _STRONGEST)[:, _FIRST_LINE - 1 :]
    speeds = lines.input_speed_hz / input_speed_hz
    return speeds.reshape(len(X), -1), power.mean(axis=1).reshape(len(X), -1) - 1
