"""Windows of one output turn on equal steps of the input shaft's angle, at any speed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import resample_poly

from cyclofeat.recordings._recording import Recording
from cyclofeat.recordings._windower import Cut, WindowSet, window_set
from cyclofeat.signal.lobes import anti_alias
from cyclofeat.signal.orders import resample_by_angle, samples_at
from cyclofeat.signal.windows import Float

#: Samples per input turn of windows that hold all 44 lobe lines of a count.
SAMPLES_PER_TURN = 128
#: Share of an output turn that a window covers: a recording of whole turns at the nominal speed holds as many
#: windows although its true speed is a per cent lower.
WINDOW_TURNS = 0.98

# Samples per turn that are left to the interpolation, in multiples of the result's.
_DENSE = 2.5
# Samples of the result by which a recording is continued at either end, where the filters settle.
_MARGIN = 44.8
# Samples of the result beside a window that decide about it: more than the filters reach.
_BESIDE = 64
# Rounding must not cost the point of the grid at which a record begins or ends.
_ROUNDING = 1e-9
# Pieces of samples from which they are joined.
_MOST_PIECES = 1024


def shaft_windows(
    recordings: Sequence[Recording],
    angles: Sequence[Float],
    n_lobes: int,
    samples_per_turn: int = SAMPLES_PER_TURN,
) -> WindowSet:
    """Cut recordings into windows on equal steps of the input shaft's angle.

    Parameters
    ----------
    recordings : sequence of Recording
    angles : sequence of ndarray
        Angle of the input shaft in rad at the samples of each recording, strictly increasing.
    n_lobes : int
        Input turns per output turn.
    samples_per_turn : int
        Samples per input turn of the windows.

    Returns
    -------
    WindowSet
        Of :data:`WINDOW_TURNS` of an output turn each, one after the other from the first sample of a
        recording on. The ``sampling_rate`` is in samples per input turn. Where the mean torque is negative,
        its sign is changed: conventions differ between rigs.

    Raises
    ------
    ValueError
        If a recording is shorter than a window or holds fewer samples per turn.
    """
    cuts = [
        _cut(recording, angle, n_lobes, samples_per_turn)
        for recording, angle in zip(recordings, angles, strict=True)
    ]
    return window_set(recordings, cuts, float(samples_per_turn))


def at_lowest_rate(recording: Recording, n_lobes: int, samples_per_turn: int = SAMPLES_PER_TURN) -> Recording:
    """Return a recording with a tachometer at the lowest sampling rate that its windows need.

    Many recordings then fit into memory. Their windows are those of the whole ones, up to rounding.

    Parameters
    ----------
    recording : Recording
    n_lobes, samples_per_turn
        As of :func:`shaft_windows`.
    """
    angle = recording.input_angle(n_lobes)
    assert angle is not None
    assert recording.angle is not None
    per_turn = angle.size / float(np.ptp(angle)) * 2 * np.pi
    thinning = _thinning(per_turn, samples_per_turn)
    if thinning < 2:
        return recording
    margin = _margin(angle.size, per_turn, samples_per_turn, thinning)
    level = float(recording.torque.mean())
    longer = _thinned(_continued(recording.torque - level, margin), thinning)
    kept = slice(0, None, thinning)
    torque = longer[margin // thinning :][: recording.torque[kept].size] + level
    return recording.replace(
        torque=torque, angle=recording.angle[kept], sampling_rate=recording.sampling_rate / thinning
    )


@dataclass(frozen=True, eq=False)
class ShaftWindow:
    """One window of a stream, with the samples from which it was made.

    Attributes
    ----------
    torque, angle : ndarray, shape (n,)
        Samples of the window, and beside it half an input turn at 128 samples per turn (more turns at fewer),
        where there are any.
    first_sample : int
        Number of samples before these.
    cut : tuple of ndarray
        The window, shape (1, n_samples), its start in s from the first of these samples, and in rad.
    """

    torque: Float
    angle: Float
    first_sample: int
    cut: Cut


class ShaftCutter:
    """Cut samples that arrive in pieces into the windows of :func:`shaft_windows`.

    A window is cut when the samples beside it (:class:`ShaftWindow`) have arrived. Its samples do not depend
    on the sizes of the pieces. They are those of :func:`shaft_windows` up to rounding while the speed is
    steady; where the speed varies, that function may choose another rate of its filters by the whole record
    (errors of 0.1 %). Samples of at most one window, those beside it and the last piece are kept.

    Parameters
    ----------
    sampling_rate : float
        In Hz.
    n_lobes : int
        Input turns per output turn.
    samples_per_turn : int
        Samples per input turn of the windows.
    """

    def __init__(self, sampling_rate: float, n_lobes: int, samples_per_turn: int = SAMPLES_PER_TURN) -> None:
        self._rate = sampling_rate
        self._per_turn = samples_per_turn
        self._step = 2 * math.pi / samples_per_turn
        self._length = _window_length(n_lobes, samples_per_turn)
        self._pieces: list[tuple[Float, Float]] = []
        self._first_sample = 0  # of those kept
        self._first_point: int | None = None  # of the next window, in steps of the grid
        self._thinning = 0  # until the first window, which also gives level and sign
        self._level, self._sign = 0.0, 1.0

    def push(self, torque: Float, angle: Float) -> Iterator[ShaftWindow]:
        """Take the next samples and yield the windows that they complete.

        Parameters
        ----------
        torque, angle : ndarray, shape (n,)
            Angle of the input shaft in rad, strictly increasing.

        Raises
        ------
        ValueError
            If a window is constant, or its samples are too few. It is left out then.
        """
        self._take(torque, angle)
        beside = _BESIDE * self._step
        while self._pieces and self._last_angle() >= (last := self._end_of_window() + beside):
            angles = self._joined()[1]
            yield self._window(int(np.searchsorted(angles, last)) + 1)

    def finish(self) -> Iterator[ShaftWindow]:
        """Yield the windows that are whole without what may have come behind them."""
        while self._pieces and self._last_angle() + _ROUNDING >= self._end_of_window():
            yield self._window(self._joined()[1].size)

    def _take(self, torque: Float, angle: Float) -> None:
        if not angle.size:
            return
        if self._first_point is None:
            self._first_point = math.ceil((angle[0] - _ROUNDING) / self._step)
        self._pieces.append((torque, angle))
        if len(self._pieces) > _MOST_PIECES:
            self._joined()

    def _last_angle(self) -> float:
        return float(self._pieces[-1][1][-1])

    def _end_of_window(self) -> float:
        assert self._first_point is not None
        return (self._first_point + self._length - 1) * self._step

    def _joined(self) -> tuple[Float, Float]:
        if len(self._pieces) > 1:
            torque, angle = (np.concatenate(parts) for parts in zip(*self._pieces, strict=True))
            self._pieces = [(torque, angle)]
        return self._pieces[0]

    def _window(self, stop: int) -> ShaftWindow:
        """Cut the next window from the samples before ``stop``, and forget what no later one needs."""
        torque, angle = (values[:stop].copy() for values in self._joined())
        per_turn = angle.size * 2 * math.pi / float(np.ptp(angle))
        if not self._thinning:
            _check_density(per_turn, self._rate, self._per_turn)
            self._thinning = _thinning(per_turn, self._per_turn)
            self._level, self._sign = _level_and_sign(torque)
        first, first_sample = self._first_point, self._first_sample
        assert first is not None
        self._first_point = first + self._length
        self._forget()
        level_sign = self._level, self._sign
        values, grid = _on_grid(
            torque, level_sign, angle, self._rate, per_turn, self._per_turn, self._thinning
        )
        begin = first - round(grid[0] / self._step)
        window, start = values[np.newaxis, begin : begin + self._length], grid[begin : begin + 1]
        _check_constant(window, torque)
        at = samples_at(start, angle)
        return ShaftWindow(torque, angle, first_sample, (window, at / self._rate, start))

    def _forget(self) -> None:
        assert self._first_point is not None
        torque, angle = self._joined()
        needed = (self._first_point - _BESIDE) * self._step
        before = max(0, int(np.searchsorted(angle, needed)) - 1)
        # The filter takes every so many samples from the first on.
        before -= (self._first_sample + before) % self._thinning
        if before > 0:
            self._pieces = [(torque[before:].copy(), angle[before:].copy())]
            self._first_sample += before


def _window_length(n_lobes: int, samples_per_turn: int) -> int:
    return round(WINDOW_TURNS * n_lobes * samples_per_turn)


def _cut(recording: Recording, angle: Float, n_lobes: int, samples_per_turn: int) -> Cut:
    rate = recording.sampling_rate
    turns = float(np.ptp(angle)) / (2 * np.pi)
    length = _window_length(n_lobes, samples_per_turn)
    if turns * samples_per_turn < length:
        raise ValueError(
            f"the recording is too short: it lasts {recording.duration:.4g} s and holds {turns:.4g} input "
            f"turns, a window of one output turn needs {WINDOW_TURNS * n_lobes:g}"
        )
    per_turn = angle.size / turns
    _check_density(per_turn, rate, samples_per_turn)
    level_sign = _level_and_sign(recording.torque)
    thinning = _thinning(per_turn, samples_per_turn)
    torque, grid = _on_grid(recording.torque, level_sign, angle, rate, per_turn, samples_per_turn, thinning)
    starts = np.arange(torque.size // length) * length
    windows = np.lib.stride_tricks.sliding_window_view(torque, length)[starts]
    _check_constant(windows, recording.torque)
    at = samples_at(grid[starts], angle)
    return windows, at / rate, grid[starts]


def _check_density(per_turn: float, rate: float, needed: int) -> None:
    if per_turn < needed:
        raise ValueError(
            f"sampling_rate must be at least {needed * rate / per_turn:.5g} Hz at {60 * rate / per_turn:.5g} "
            f"RPM ({needed} samples per input turn hold the lobe lines that are counted), got {rate:g} Hz: "
            f"train a model at {rate:g} Hz (cyclofeat train --sampling-rate {rate:g})"
        )


def _check_constant(windows: Float, torque: Float) -> None:
    if np.any(np.ptp(windows, axis=1) == 0):
        raise ValueError(
            f"the recording is constant ({torque[0]:g} Nm) over a whole window: nothing can be diagnosed "
            "from it (sensor dead or not connected?)"
        )


def _thinning(per_turn: float, samples_per_turn: int) -> int:
    return max(1, int(per_turn / (samples_per_turn * _DENSE)))


def _margin(n_samples: int, per_turn: float, samples_per_turn: int, thinning: int) -> int:
    """Return the samples by which a recording is continued, a multiple of the thinning."""
    longest = (n_samples - 1) // thinning
    return min(math.ceil(_MARGIN / samples_per_turn * per_turn / thinning), longest) * thinning


def _thinned(values: Float, thinning: int) -> Float:
    if thinning == 1:
        return values
    return np.asarray(resample_poly(values, 1, thinning, window=anti_alias(thinning)))


def _level_and_sign(torque: Float) -> tuple[float, float]:
    """Return the mean, and the sign that makes it positive: a load that brakes, whatever the convention."""
    mean = float(torque.mean())
    return mean, -1.0 if mean < 0 else 1.0


def _on_grid(
    torque: Float,
    level_sign: tuple[float, float],
    angle: Float,
    rate: float,
    per_turn: float,
    samples_per_turn: int,
    thinning: int,
) -> tuple[Float, Float]:
    """Return torque on the grid of the angle, without its level and of the sign given."""
    margin = _margin(torque.size, per_turn, samples_per_turn, thinning)
    # One long array after the other: a record may fill a good part of the memory.
    longer = torque - level_sign[0]
    longer *= level_sign[1]
    longer = _thinned(_continued(longer, margin), thinning)
    turning = _continued(angle, margin)[::thinning].copy()
    even, grid = resample_by_angle(longer, turning, samples_per_turn, rate / thinning)
    inside = (grid >= angle[0] - _ROUNDING) & (grid <= angle[-1] + _ROUNDING)
    return even[inside], grid[inside]


def _continued(values: Float, margin: int) -> Float:
    """Continue a curve by its point reflection at either end: neither value nor slope has a step there."""
    before = 2 * values[0] - values[margin:0:-1]
    return np.concatenate([before, values, 2 * values[-1] - values[-2 : -margin - 2 : -1]])
