"""Samples of a batch's runs, taken while the runs go on."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators import simulation
from cyclofeat.simulators._lines import on_grid
from cyclofeat.simulators.batch._prepare import zeros
from cyclofeat.simulators.batch._streams import decimate
from cyclofeat.simulators.batch._vectors import Lanes
from cyclofeat.simulators.courses import DriveAndLoad
from cyclofeat.simulators.simulation import Sampling

Float = NDArray[np.float64]


class SampledCourse:
    """Input and load of a run at ``stages`` evaluations in a step, and the input at its samples.

    Attributes
    ----------
    n : int
        Number of evaluations.
    angle, speed : ndarray, shape (n_samples,)
        Of the input, in rad and rad/s, once all pieces were asked for. The speed is picked, like any motion.
    """

    def __init__(self, whole: DriveAndLoad, sampling: Sampling, stages: int, dt: float) -> None:
        self.n = whole.n
        self._whole, self._time, self._step = whole, sampling.time, dt / stages
        self._evaluations = stages * sampling.steps
        self.angle, self.speed = np.empty(self._time.size), np.empty(self._time.size)

    def piece(self, first: int, last: int, out: Float) -> Float:
        """Return what :class:`DriveAndLoad` does."""
        piece = self._whole.piece(first, last, out)
        inside = slice(*np.searchsorted(self._time, [first * self._step, last * self._step]))
        self.angle[inside] = on_grid(self._time[inside], self._step, piece[0], first)
        inside = slice(*np.searchsorted(self._evaluations, [first, last]))
        self.speed[inside] = piece[1, self._evaluations[inside] - first]
        return piece


class Samples:
    """Rows of the results at the samples of the longest run, for all lanes.

    ``filtered`` rows pass the anti-alias filter; of ``picked`` ones single steps are taken.
    """

    def __init__(
        self, sampling: Sampling, lanes: int, filtered: tuple[int, ...], picked: tuple[int, ...]
    ) -> None:
        self._lanes, self._steps, n = Lanes(lanes), sampling.steps, sampling.time.size
        self._up, self._down = sampling.ratio.numerator, sampling.ratio.denominator
        if sampling.picks:
            filtered, picked = (), filtered + picked
        self._rows = {row: zeros((n, lanes), np.float64) for row in (*filtered, *picked)}
        self._filtered, self._picked, self._phases = filtered, picked, _phases(self._up, self._down)
        self._done = 0
        # Steps before a piece on which its first samples depend.
        self.again = self._phases.shape[1] if filtered else 0

    def take(self, begin: int, results: NDArray[Any]) -> None:
        """Take the samples of a piece from its results, which begin ``again`` steps before step ``begin``."""
        first, end = begin - self.again, begin + len(results) - self.again
        if self._filtered:
            # The middle of the low-pass of sample k lies at step (k down) / up, its last weight later.
            middle = self._phases.size // 2
            n_done = -(-(end * self._up - middle) // self._down)
            n_done = max(min(n_done, self._steps.size), self._done)
            for row in self._filtered:
                samples = self._rows[row][self._done : n_done]
                decimate(self._lanes, results, first, row, self._phases, self._down, self._done, samples)
            self._done = n_done
        inside = slice(*np.searchsorted(self._steps, [begin, end]))
        for row in self._picked:
            self._rows[row][inside] = results[self._steps[inside] - first, row]

    def of_lanes(self, row: int) -> Float | None:
        """Return the samples of a row, (lanes, n_samples); None for one that was not taken."""
        return np.ascontiguousarray(self._rows[row].T) if row in self._rows else None


@functools.cache
def _phases(up: int, down: int) -> Float:
    """Return the low-pass by phases, (up, n_taps), in the order of time."""
    low_pass = up * simulation.anti_alias_filter(up, down)
    half = low_pass.size // 2
    n_taps = 2 * (half // up + 1)
    padded = np.zeros(n_taps * up)
    first = n_taps * up // 2 - half
    padded[first : first + low_pass.size] = low_pass
    return np.ascontiguousarray(padded.reshape(n_taps, up).T[:, ::-1])
