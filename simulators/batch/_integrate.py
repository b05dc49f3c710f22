"""Machines in the lanes of vectors, integrated piece by piece."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cyclofeat.simulators import simulation
from cyclofeat.simulators.batch import _rows as rows
from cyclofeat.simulators.batch._kernel import integrate
from cyclofeat.simulators.batch._prepare import batch_tables, set_states, states, zeros
from cyclofeat.simulators.batch._streams import fill
from cyclofeat.simulators.batch._vectors import Lanes
from cyclofeat.simulators.simulation import STAGES, Solver
from cyclofeat.simulators.tables import KernelInput

Float = NDArray[np.float64]

# Pins of one wheel that are described at once.
_PINS = 16
_CHUNK = 1024  # steps of which the drive is written at once: it stays in the cache
_PIECE = 16 * _CHUNK  # steps of which the courses of all lanes are evaluated at once


class Course(Protocol):
    """Input and load of one run at its ``n`` evaluations, as :class:`DriveAndLoad` has them."""

    n: int

    def piece(self, first: int, last: int, out: Float) -> Float:
        """Write the rows from one evaluation to another, at which the next piece begins, to ``out``."""


class Integrating:
    """Machines of one form, one in each lane: constants, courses to the end of its run, and first states."""

    def __init__(
        self,
        machines: Sequence[KernelInput],
        courses: Sequence[Course],
        starts: Sequence[Float],
        solver: Solver,
        *,
        lanes: int,
        dtype: type = np.float32,
    ) -> None:
        self._courses, self._solver, self._lanes, self._dtype = courses, solver, lanes, dtype
        self._stages = STAGES[solver.integrator]
        self._own_steps = [(course.n - 1) // self._stages for course in courses]
        limits = (simulation.LOCKING_FORCE, simulation.LOCKING_TIME)
        self._tables = batch_tables(machines, solver.dt, limits, (lanes, _PINS), dtype)
        set_states(self._tables, starts)
        self._seen: list[tuple[int, Float, Float]] = []

    @property
    def reached(self) -> NDArray[np.bool_]:
        """True for the lanes that reached the end of their runs, shape (lanes,)."""
        step, reason = self._tables.ended
        reached: NDArray[np.bool_] = reason == rows.RUNNING
        reached[: len(self._own_steps)] |= step[: len(self._own_steps)] >= self._own_steps
        return reached

    def watched(self, lane: int) -> list[tuple[Float, Float]]:
        """Return input and load (4,), and state (n_state,), at some steps of a machine with friction."""
        return [(rows[lane], states[lane]) for at, rows, states in self._seen if at <= self._own_steps[lane]]

    def pieces(self, again: int = 0) -> Iterator[tuple[int, NDArray[Any]]]:
        """Integrate; yield the number of steps before each piece, and its results.

        The results, (again + steps, N_RESULTS, lanes), begin with the last steps of the piece before: zeros
        at first. They are valid until the next piece. What stands behind a run's own end means nothing.
        """
        stages, tables, n_steps = self._stages, self._tables, max(self._own_steps)
        faulty = bool(tables.geometry[:, rows.HAS_FAULTS : rows.HAS_FAULTS + 2].any())
        results = zeros((again + min(_PIECE, n_steps), rows.N_RESULTS, self._lanes), self._dtype)
        angle = zeros((stages * _CHUNK, self._lanes), np.float64)
        drive = zeros((stages * _CHUNK, rows.N_DRIVE_ROWS, self._lanes), self._dtype)
        inputs = np.empty((len(self._courses), 4, stages * _PIECE + 1))
        sizes = np.zeros(len(self._courses), dtype=np.int64)
        for begin in range(0, n_steps, _PIECE):
            size = min(_PIECE, n_steps - begin)
            for lane, course in enumerate(self._courses):
                sizes[lane] = self._read(course, stages * begin, inputs[lane], sizes[lane])
            for first in range(0, size, _CHUNK):
                n = min(_CHUNK, size - first)
                fill(inputs, sizes, stages * first, stages * n, stages, tables.n_lobes, angle, drive)
                done = integrate(
                    Lanes(self._lanes), Lanes(_PINS), stages, begin + first, n, self._solver.dt,
                    simulation.ABSURD_TORQUE, faulty, angle, drive, tables,
                    results[again + first : again + first + n],
                )  # fmt: skip
                if done < n:  # all lanes have ended
                    return
                if tables.spins is not None and self._solver.check_friction:
                    rows_then = inputs[:, :, stages * (first + n)].copy()
                    self._seen.append((begin + first + n, rows_then, states(tables)))
            yield begin, results[: again + size]
            results[:again] = results[size : again + size]

    def _read(self, course: Course, first: int, out: Float, before: np.int64) -> int:
        """Read a piece of a course; return its size, which is 0 for the last evaluation after the end.

        ``before`` is the size of the piece that ``out`` holds.
        """
        if first < course.n - 1:
            last = min(first + self._stages * _PIECE, course.n - 1)
            course.piece(first, last, out)
            return last - first
        out[:, 0] = out[:, before]
        return 0
