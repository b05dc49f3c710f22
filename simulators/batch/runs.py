"""Runs of many gearboxes, one in each lane of the processor's vectors."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.checks import number
from cyclofeat.simulators import simulation
from cyclofeat.simulators.batch import _tables as rows
from cyclofeat.simulators.batch._kernel import decimate_lanes, fill_drive, integrate_batch
from cyclofeat.simulators.batch._tables import aligned_zeros, batch_tables, read_states
from cyclofeat.simulators.batch._vectors import lane_tuple
from cyclofeat.simulators.courses import Courses, DriveAndLoad
from cyclofeat.simulators.defects import LobeDefects, check_machine
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.simulation import STAGES, Sampling, SimulationRun, Solver
from cyclofeat.simulators.tables import KernelInput, kernel_input

Float = NDArray[np.float64]

_PINS = 16  # pins of one wheel that are described at once
_CHUNK = 1024  # steps; the drive is written for so many at once, which stay in the cache
_PIECE = 16 * _CHUNK  # steps; the courses of all lanes are evaluated for so many at once
_FEWEST_PINS = 10  # with fewer, a lobe is too wide for the short polynomials


@functools.cache
def n_lanes() -> int:
    """Return the number of gearboxes in one batch: the lanes of the processor's vectors."""
    return 16 if llvm.get_host_cpu_features().get("avx512f") else 8


@dataclass(frozen=True)
class Request:
    """Arguments of :func:`cyclofeat.simulators.simulate` for one run in a batch."""

    gearbox: CycloidalGearbox
    defects: LobeDefects
    constants: KernelInput
    sampling: Sampling
    courses: Courses | None = None
    start_angle: float = 0.0
    sampling_rate: float = 25_600.0
    solver: Solver = field(default_factory=Solver)
    torque_in: bool = True
    motion: bool = True

    @classmethod
    def from_arguments(cls, arguments: Mapping[str, Any]) -> Request:
        """Return the request of one run's arguments; raise as ``simulate`` does."""
        gearbox, defects = check_machine(arguments.get("gearbox"), arguments.get("defects"))
        given = {name: value for name, value in arguments.items() if name in _OPTIONS}
        given["solver"] = solver = given.get("solver") or Solver()
        given["start_angle"] = number("start_angle", given.get("start_angle", 0.0))
        sampling = Sampling.plan(
            arguments.get("duration", 0.6), given.get("sampling_rate", cls.sampling_rate), solver
        )
        return cls(gearbox, defects, kernel_input(gearbox, defects), sampling, **given)

    @property
    def form(self) -> tuple[Any, ...]:
        """Properties that all runs of a batch share."""
        gearbox, pitched = self.gearbox, self.constants.wheel.has_pitch_errors
        of_machine = (gearbox.n_lobes, gearbox.n_internal_sleeves, gearbox.has_friction, pitched)
        return (*of_machine, self.sampling_rate, self.solver, self.torque_in, self.motion)

    @property
    def cost(self) -> tuple[bool, int, int]:
        """True with defects, number of pieces, and defects of both wheels, by which runs are grouped."""
        n_defects = self.defects.defect_count * len(self.defects.wheels)
        return n_defects > 0, self.sampling.n_steps // _PIECE, n_defects


_OPTIONS = {field.name for field in fields(Request)} - {"gearbox", "defects", "constants", "sampling"}


@functools.cache
def compile_error() -> str | None:
    """Return in one line why batches cannot be compiled here, or None."""
    gearbox = CycloidalGearbox.steel()
    course = DriveAndLoad(gearbox, 3, 5e-6)
    constants = kernel_input(gearbox, LobeDefects.healthy())
    try:
        list(BatchIntegration([constants], [course], Solver()).pieces())
    except Exception as error:  # of numba or LLVM, whose classes are many
        lines = str(error).strip().splitlines() or [type(error).__name__]
        return lines[0]
    return None


def obstacle(request: Request, arguments: Mapping[str, Any]) -> str | None:
    """Return what only the exact kernel can do for a run, or None."""
    unknown = set(arguments) - _OPTIONS - {"gearbox", "defects", "duration", "forces", "points"}
    if unknown:
        return f"the option {min(unknown)!r}"
    if arguments.get("forces") or arguments.get("points"):
        return "forces and points of contacts"
    if request.gearbox.profile_points > 0:
        return "a polyline as profile"
    if request.gearbox.n_pins < _FEWEST_PINS:
        return f"fewer than {_FEWEST_PINS} pins"
    return None


def group_requests(requests: Mapping[int, Request]) -> Iterator[dict[int, Request]]:
    """Yield groups of requests that can run together, at most one per lane, by their keys.

    A batch takes as long as its longest run, and each step as long as the lane with most contacts: the first
    defect adds a third, each further one little. So runs of similar length are grouped.
    """
    by_form: dict[tuple[Any, ...], list[int]] = {}
    for key in sorted(requests, key=lambda key: requests[key].cost):
        by_form.setdefault(requests[key].form, []).append(key)
    for keys in by_form.values():
        while keys:
            yield {key: requests[key] for key in keys[-n_lanes() :]}
            del keys[-n_lanes() :]


class SampledCourse:
    """Input and load of a run at every one of ``n`` evaluations, and the input at its samples.

    Once all pieces were asked for, ``angle`` and ``speed``, shape (n_samples,), are those of the input in rad
    and rad/s. The speed is picked, like any motion, and empty without.
    """

    def __init__(self, request: Request) -> None:
        solver, sampling, stages = request.solver, request.sampling, STAGES[request.solver.integrator]
        self.n, self._step, self._time = stages * sampling.n_steps + 1, solver.dt / stages, sampling.time
        self._whole = DriveAndLoad(request.gearbox, self.n, self._step, request.start_angle, request.courses)
        self._evaluations = stages * sampling.steps if request.motion else sampling.steps[:0]
        self.angle, self.speed = np.empty(self._time.size), np.empty(self._evaluations.size)

    def piece(self, first: int, last: int, out: Float) -> Float:
        """Return what :class:`DriveAndLoad` does."""
        piece = self._whole.piece(first, last, out)
        inside = slice(*np.searchsorted(self._time, [first * self._step, last * self._step]))
        self.angle[inside] = np.interp(self._time[inside], np.arange(first, last + 1) * self._step, piece[0])
        inside = slice(*np.searchsorted(self._evaluations, [first, last]))
        self.speed[inside] = piece[1, self._evaluations[inside] - first]
        return piece


class BatchIntegration:
    """Machines of one form at rest, one in each lane: constants, and courses to the end of its run."""

    def __init__(
        self, machines: Sequence[KernelInput], courses: Sequence[DriveAndLoad | SampledCourse],
        solver: Solver, *, lanes: int | None = None, dtype: type = np.float32,
    ) -> None:  # fmt: skip
        self._courses, self._solver, self._dtype = courses, solver, dtype
        self._lanes, self._stages = lanes or n_lanes(), STAGES[solver.integrator]
        self._own_steps = [(course.n - 1) // self._stages for course in courses]
        limits = (simulation.LOCKING_FORCE, simulation.LOCKING_TIME)
        self._tables = batch_tables(machines, solver.dt, limits, (self._lanes, _PINS), dtype)
        self._seen: list[tuple[int, Float, Float]] = []

    @property
    def has_reached_end(self) -> NDArray[np.bool_]:
        """True for the lanes that reached the end of their runs, shape (lanes,)."""
        step, reason = self._tables.ended
        reached: NDArray[np.bool_] = reason == rows.RUNNING
        reached[: len(self._own_steps)] |= step[: len(self._own_steps)] >= self._own_steps
        return reached

    def instants(self, lane: int) -> list[tuple[Float, Float]]:
        """Return input and load (4,), and state (n_state,), at some steps of a machine with friction."""
        return [(rows[lane], states[lane]) for at, rows, states in self._seen if at <= self._own_steps[lane]]

    def pieces(self, again: int = 0) -> Iterator[tuple[int, NDArray[Any]]]:
        """Integrate; yield the number of steps before each piece, and its results.

        The results, (again + steps, N_RESULTS, lanes), begin with the last steps of the piece before: zeros
        at first. They are valid until the next piece. Results after a run's own end mean nothing.
        """
        stages, tables, n_steps = self._stages, self._tables, max(self._own_steps)
        lanes, pins = lane_tuple(self._lanes), lane_tuple(_PINS)
        faulty = bool(tables.geometry[:, rows.HAS_FAULTS : rows.HAS_FAULTS + 2].any())
        results = aligned_zeros((again + min(_PIECE, n_steps), rows.N_RESULTS, self._lanes), self._dtype)
        angle = aligned_zeros((stages * _CHUNK, self._lanes), np.float64)
        drive = aligned_zeros((stages * _CHUNK, rows.N_DRIVE_ROWS, self._lanes), self._dtype)
        inputs = np.empty((len(self._courses), 4, stages * _PIECE + 1))
        sizes = np.zeros(len(self._courses), dtype=np.int64)
        for begin in range(0, n_steps, _PIECE):
            size = min(_PIECE, n_steps - begin)
            for lane, course in enumerate(self._courses):
                first, last = stages * begin, min(stages * (begin + _PIECE), course.n - 1)
                if first < last:
                    course.piece(first, last, inputs[lane])
                else:  # the last evaluation, after the end
                    inputs[lane, :, 0] = inputs[lane, :, sizes[lane]]
                sizes[lane] = max(last - first, 0)
            for first in range(0, size, _CHUNK):
                n = min(_CHUNK, size - first)
                fill_drive(inputs, sizes, stages * first, stages * n, stages, tables.n_lobes, angle, drive)
                done = integrate_batch(
                    lanes, pins, stages, self._solver.integrator == "leapfrog", begin + first, n,
                    self._solver.dt, simulation.ABSURD_TORQUE, faulty, angle, drive, tables,
                    results[again + first : again + first + n],
                )  # fmt: skip
                if done < n:  # all lanes have ended
                    return
                if tables.spins is not None and self._solver.check_friction:
                    rows_then = inputs[:, :, stages * (first + n)].copy()
                    self._seen.append((begin + first + n, rows_then, read_states(tables)))
            yield begin, results[: again + size]
            results[:again] = results[size : again + size]


class Samples:
    """Rows of the results at the samples of the longest run, for all lanes.

    ``filtered`` rows pass the anti-alias filter; of ``picked`` ones single steps are taken.
    """

    def __init__(
        self, sampling: Sampling, lanes: int, filtered: tuple[int, ...], picked: tuple[int, ...]
    ) -> None:
        self._lanes, self._steps, n = lane_tuple(lanes), sampling.steps, sampling.time.size
        self._up, self._down = sampling.ratio.numerator, sampling.ratio.denominator
        if sampling.picks:
            filtered, picked = (), filtered + picked
        self._rows = {row: aligned_zeros((n, lanes), np.float64) for row in (*filtered, *picked)}
        self._filtered, self._picked = filtered, picked
        # The low-pass by phases, (up, n_taps), in the order of time.
        low_pass = np.ones(1)
        if not sampling.picks:
            low_pass = self._up * simulation.anti_alias_filter(self._up, self._down)
        half = low_pass.size // 2
        phases = np.zeros((2 * (half // self._up + 1), self._up))
        phases.ravel()[phases.size // 2 - half :][: low_pass.size] = low_pass
        self._phases = np.ascontiguousarray(phases.T[:, ::-1])
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
                decimate_lanes(
                    self._lanes, results, first, row, self._phases, self._down, self._done, samples
                )
            self._done = n_done
        inside = slice(*np.searchsorted(self._steps, [begin, end]))
        for row in self._picked:
            self._rows[row][inside] = results[self._steps[inside] - first, row]

    def by_lane(self, row: int) -> Float | None:
        """Return the samples of a row, (lanes, n_samples); None for a row that was not recorded."""
        return np.ascontiguousarray(self._rows[row].T) if row in self._rows else None


def run_batch(requests: Sequence[Request]) -> list[SimulationRun | None]:
    """Simulate requests of one form, at most one per lane; None for a run that did not reach its end.

    The bits of a run depend on its own request only.
    """
    first = requests[0]
    courses = [SampledCourse(request) for request in requests]
    batch = BatchIntegration([request.constants for request in requests], courses, first.solver)
    torques = (rows.TORQUE_OUT, rows.TORQUE_IN) if first.torque_in else (rows.TORQUE_OUT,)
    motion = (rows.OUTPUT, rows.OUTPUT_RATE) if first.motion else ()
    longest = max((request.sampling for request in requests), key=lambda sampling: sampling.n_steps)
    samples = Samples(longest, n_lanes(), torques, motion)
    for n_done, results in batch.pieces(samples.again):
        samples.take(n_done, results)
    by_lane = [samples.by_lane(row) for row in range(rows.N_RESULTS)]
    runs: list[SimulationRun | None] = []
    for lane, (request, course) in enumerate(zip(requests, courses, strict=True)):
        if not batch.has_reached_end[lane]:
            runs.append(None)
            continue
        # Warn of chatter as ``simulate`` does; a run that ends early may have no instants.
        if request.gearbox.has_friction and (instants := batch.instants(lane)):
            solver = request.solver
            inputs, at_instants = (np.stack(parts) for parts in zip(*instants, strict=True))
            nearby = np.repeat(inputs[:, :, np.newaxis], 3, axis=2)
            nearby[:, 0] += nearby[:, 1] * [0.0, solver.dt / 2, solver.dt]
            simulation.check_friction(request.gearbox, request.constants, solver, nearby, at_instants)
        own, z = slice(request.sampling.time.size), request.gearbox.n_lobes
        torque_out, torque_in, angle, rate = (
            None if row is None else row[lane][own].copy() for row in by_lane
        )
        assert torque_out is not None
        runs.append(
            SimulationRun(
                gearbox=request.gearbox, defects=request.defects, sampling_rate=float(request.sampling_rate),
                torque_out=torque_out, torque_in=torque_in, input_angle=course.angle,
                output_angle=None if angle is None else angle - course.angle / z,
                output_speed=None if rate is None else rate - course.speed / z,
                dt=request.solver.dt, kernel="batch",
            )
        )  # fmt: skip
    return runs
