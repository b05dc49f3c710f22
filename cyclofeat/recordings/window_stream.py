"""Windows of samples that arrive in pieces."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from cyclofeat.recordings.recording import Recording
from cyclofeat.recordings.windower import (
    ROUNDING,
    AngleGrid,
    Windower,
    WindowSet,
    reject_constant_windows,
    window_set,
)
from cyclofeat.signal.orders import samples_at
from cyclofeat.signal.windows import Float

# Grid points beside a window that decide about it: more than the filters reach.
_BESIDE = 64
# Pieces of samples from which they are joined.
_MOST_PIECES = 1024


class StreamWindow(NamedTuple):
    """One window of a stream; its ``start_s`` counts from the first sample of ``recording``.

    The recording holds the window's samples, and 64 samples of the grid beside it where there are as many;
    ``first_sample`` is the number of samples of the stream before these.
    """

    windows: WindowSet
    recording: Recording
    first_sample: int


class WindowStream:
    """Cut samples that arrive in pieces into the windows of a :class:`~cyclofeat.Windower`.

    A window is cut when the samples beside it (:class:`StreamWindow`) have arrived. Its samples do not depend
    on the sizes of the pieces. They are those of :meth:`Windower.windows` up to rounding while the speed is
    steady; where the speed varies, that method may choose another rate of its filters by the whole record
    (errors of 0.1 %). Samples of at most one window, those beside it and the last piece are kept.

    The windower needs ``samples_per_turn`` and ``reduction``; windows follow one another from the first
    sample on. ``labels`` are other parameters of the :class:`~cyclofeat.Recording` of each window.
    """

    def __init__(self, windower: Windower, sampling_rate: float, **labels: Any) -> None:
        if windower.reduction is None or windower.samples_per_turn is None:
            raise ValueError(
                f"windower must have reduction and samples_per_turn to cut a stream, got {windower}"
            )
        if windower.skip_s or windower.overlap:
            raise ValueError(f"windower must have no skip_s or overlap for a stream, got {windower}")
        self._windower = windower
        self._rate = sampling_rate
        self._labels = labels
        self._per_turn = float(windower.samples_per_turn)
        self._length = windower._angle_length()
        self._grid = AngleGrid(windower.samples_per_turn, 0)  # filters follow from the first window
        self._pieces: list[tuple[Float, Float]] = []
        self._first_sample = 0  # of those kept
        self._first_point: int | None = None  # of the next window

    def push(self, torque: Float, angle: Float) -> Iterator[StreamWindow]:
        """Take the next samples and input angles (rad), and yield the windows that they complete.

        A window that is constant, or of too few samples, raises ``ValueError`` and is left out.
        """
        if angle.size:
            if self._first_point is None:
                self._first_point = self._grid.first_point(angle[0])
            self._pieces.append((torque, angle))
            if len(self._pieces) > _MOST_PIECES:
                self._join_pieces()
        beside = _BESIDE * self._grid.step
        while self._pieces and self._last_angle() >= (last := self._end_of_window() + beside):
            angles = self._join_pieces()[1]
            yield self._next_window(int(np.searchsorted(angles, last)) + 1)

    def finish(self) -> Iterator[StreamWindow]:
        """Yield the windows that are whole without what may have come behind them."""
        while self._pieces and self._last_angle() + ROUNDING >= self._end_of_window():
            yield self._next_window(self._join_pieces()[1].size)

    def _last_angle(self) -> float:
        return float(self._pieces[-1][1][-1])

    def _end_of_window(self) -> float:
        assert self._first_point is not None
        return (self._first_point + self._length - 1) * self._grid.step

    def _join_pieces(self) -> tuple[Float, Float]:
        if len(self._pieces) > 1:
            torque, angle = (np.concatenate(parts) for parts in zip(*self._pieces, strict=True))
            self._pieces = [(torque, angle)]
        return self._pieces[0]

    def _next_window(self, stop: int) -> StreamWindow:
        """Cut the next window from the samples before ``stop``."""
        torque, angle = (values[:stop].copy() for values in self._join_pieces())
        if not self._grid.decimation:
            self._grid = self._windower._grid_of(torque, angle, self._rate)
        first, first_sample = self._first_point, self._first_sample
        assert first is not None
        self._first_point = first + self._length
        # Forget what no later window needs; the filter takes every so many samples from the first on.
        kept_torque, kept_angle = self._join_pieces()
        needed = (self._first_point - _BESIDE) * self._grid.step
        before = max(0, int(np.searchsorted(kept_angle, needed)) - 1)
        before -= (first_sample + before) % self._grid.decimation
        if before > 0:
            self._pieces = [(kept_torque[before:].copy(), kept_angle[before:].copy())]
            self._first_sample += before
        recording = Recording(torque, self._rate, angle=angle, **self._labels)
        values, grid = self._grid.resample(torque, angle, self._rate)
        begin = first - round(grid[0] / self._grid.step)
        start = grid[begin : begin + 1]
        cut = values[np.newaxis, begin : begin + self._length], samples_at(start, angle) / self._rate, start
        reject_constant_windows(recording, cut, first_sample / self._rate)
        return StreamWindow(window_set([recording], [cut], self._per_turn), recording, first_sample)
