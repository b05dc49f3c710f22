"""Runs of many gearboxes, one in each lane of the processor's vectors."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.checks import number, one_of
from cyclofeat.simulators import simulation
from cyclofeat.simulators._lines import on_grid
from cyclofeat.simulators.batch import _rows as rows
from cyclofeat.simulators.batch._kernel import integrate
from cyclofeat.simulators.batch._prepare import batch_tables, set_states, unsuited, zeros
from cyclofeat.simulators.batch._streams import decimate, fill
from cyclofeat.simulators.batch._vectors import Lanes
from cyclofeat.simulators.courses import Courses, drive_and_load
from cyclofeat.simulators.gearbox import CycloidalGearbox, LobeDefects, machine
from cyclofeat.simulators.simulation import STAGES, Integration, Sampling, SimulationRun, Solver
from cyclofeat.simulators.tables import KernelInput, kernel_input, rest_state

Float = NDArray[np.float64]

# Pins of one wheel that are described at once.
_PINS = 16
_CHUNK = 1024  # steps of which the drive is written at once: it stays in the cache
# Bytes of the courses of one batch, beyond which it takes fewer runs.
_BUDGET = 512 * 2**20
_BYTES_PER_STEP = 2 * 4 * 8 + rows.N_RESULTS * 4


@functools.cache
def n_lanes() -> int:
    """Number of gearboxes in one batch: as many as suit the processor's vectors."""
    return 16 if llvm.get_host_cpu_features().get("avx512f") else 8


@dataclass(frozen=True)
class Settings:
    """Arguments of :func:`cyclofeat.simulators.simulate` that all runs of a batch share."""

    sampling_rate: float = 25_600.0
    start: str = "rest"
    solver: Solver = field(default_factory=Solver)
    torque_in: bool = True
    motion: bool = True

    @property
    def stages(self) -> int:
        """Evaluations in one step."""
        return STAGES[self.solver.integrator]

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> Settings:
        """Return the settings among one run's arguments."""
        names = {one.name for one in fields(cls)}
        given = {name: value for name, value in arguments.items() if name in names}
        settings = cls(**given | {"solver": given.get("solver") or Solver()})
        one_of("start", settings.start, ("rest", "relaxed"))
        return settings


@dataclass(frozen=True)
class Request:
    """Arguments of :func:`cyclofeat.simulators.simulate` for one run in a batch."""

    gearbox: CycloidalGearbox
    defects: LobeDefects
    constants: KernelInput
    courses: Courses | None
    start_angle: float
    sampling: Sampling
    settings: Settings

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> Request:
        """Return the request of one run's arguments; raise as ``simulate`` does."""
        gearbox, defects = machine(arguments.get("gearbox"), arguments.get("defects"))
        settings = Settings.of(arguments)
        return cls(
            gearbox,
            defects,
            kernel_input(gearbox, defects),
            arguments.get("courses"),
            number("start_angle", arguments.get("start_angle", 0.0)),
            Sampling.of(arguments.get("duration", 0.6), settings.sampling_rate, settings.solver),
            settings,
        )

    @property
    def form(self) -> tuple[int, int, bool, Settings]:
        """What all runs of a batch share."""
        gearbox = self.gearbox
        return gearbox.n_lobes, gearbox.n_internal_sleeves, gearbox.has_friction, self.settings

    @property
    def cost(self) -> tuple[int, int]:
        """Defects of both wheels and steps, by which runs of similar cost are found."""
        return self.defects.defect_count * len(self.defects.wheels), self.sampling.n_steps


@functools.cache
def compile_error() -> str | None:
    """Return in one line why batches cannot be compiled here, or None."""
    gearbox = CycloidalGearbox.steel()
    course = drive_and_load(gearbox, 3, 5e-6, 1e5)
    constants = kernel_input(gearbox, LobeDefects.healthy())
    try:
        integrated([constants], [course], [rest_state(gearbox)], Solver())
    except Exception as error:  # of numba or LLVM, whose classes are many
        lines = str(error).strip().splitlines() or [type(error).__name__]
        return lines[0]
    return None


_KNOWN = {"gearbox", "defects", "start_angle", "courses", "duration", "forces", "points"} | {
    one.name for one in fields(Settings)
}


def obstacle(request: Request, arguments: Mapping[str, Any]) -> str | None:
    """Return what only the exact kernel can do for a run, or None."""
    unknown = set(arguments) - _KNOWN
    if unknown:
        return f"the option {min(unknown)!r}"
    if arguments.get("forces") or arguments.get("points"):
        return "forces and points of contacts"
    return unsuited(request.constants)


def batches(requests: Mapping[int, Request]) -> Iterator[dict[int, Request]]:
    """Yield requests that can run together, as many as fit the lanes and the memory, by their keys.

    A batch takes as long as the longest run, and at each step as the lane with most contacts: runs with as
    many defects and of similar length stand together.
    """
    by_form: dict[tuple[int, int, bool, Settings], list[int]] = {}
    for key in sorted(requests, key=lambda key: requests[key].cost):
        by_form.setdefault(requests[key].form, []).append(key)
    for keys in by_form.values():
        while keys:
            longest = max(requests[key].sampling.n_steps for key in keys[-n_lanes() :])
            size = max(1, min(n_lanes(), _BUDGET // (_BYTES_PER_STEP * longest)))
            yield {key: requests[key] for key in keys[-size:]}
            del keys[-size:]


def run_batch(requests: Sequence[Request]) -> list[SimulationRun | None]:
    """Simulate requests of one form; None for a run that did not reach its end.

    Parameters
    ----------
    requests : sequence of Request
        At most as many as there are lanes.

    Returns
    -------
    list of SimulationRun or None
        The bits of a run depend on its own request only.
    """
    settings = requests[0].settings
    solver, stages = settings.solver, settings.stages
    courses = [
        drive_and_load(
            one.gearbox, stages * one.sampling.n_steps + 1, solver.dt / stages, settings.sampling_rate,
            one.start_angle, one.courses,
        )
        for one in requests
    ]  # fmt: skip
    states = [_start(one, course) for one, course in zip(requests, courses, strict=True)]
    results, reached = integrated([one.constants for one in requests], courses, states, solver)
    longest = max((one.sampling for one in requests), key=lambda sampling: sampling.n_steps)
    torque_out = _decimated(results, rows.TORQUE_OUT, longest)
    torque_in = _decimated(results, rows.TORQUE_IN, longest) if settings.torque_in else None
    runs: list[SimulationRun | None] = []
    for lane, (one, course) in enumerate(zip(requests, courses, strict=True)):
        if not reached[lane]:
            runs.append(None)
            continue
        own = slice(one.sampling.time.size)
        torques = torque_out[lane, own].copy(), None if torque_in is None else torque_in[lane, own].copy()
        runs.append(_result(one, course, torques, results[:, rows.OUTPUT :, lane]))
    return runs


def _decimated(results: NDArray[Any], row: int, sampling: Sampling) -> Float:
    """Return the samples of one row of the results: (lanes, n_samples)."""
    if sampling.picks:
        return np.ascontiguousarray(results[sampling.steps, row].T, dtype=float)
    up, down = sampling.ratio.numerator, sampling.ratio.denominator
    lanes = results.shape[2]
    samples = zeros((sampling.time.size, lanes), np.float64)
    decimate(Lanes(lanes), results, row, _phases(up, down), down, samples)
    return np.ascontiguousarray(samples.T)


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


def _start(request: Request, course: Float) -> Float:
    """Return the state at the start."""
    state, solver = rest_state(request.gearbox), request.settings.solver
    if request.settings.start == "rest":
        return state
    return simulation.relaxed(
        Integration(request.gearbox, request.constants, course, solver.dt, solver.integrator), state
    )


def integrated(
    machines: Sequence[KernelInput],
    courses: Sequence[Float],
    states: Sequence[Float],
    solver: Solver,
    *,
    lanes: int | None = None,
    dtype: type = np.float32,
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Integrate machines of one form, one in each lane.

    Parameters
    ----------
    machines, courses, states : sequence
        Constants, course at every evaluation to the end of its run, and state at the start of each.
    solver : Solver
    lanes : int, optional
        Default: those that suit the processor.
    dtype : numpy.float32 or numpy.float64

    Returns
    -------
    results : ndarray, shape (n_steps, N_RESULTS, lanes)
        To the end of the longest run; what stands behind a run's own end means nothing.
    reached : ndarray of bool, shape (lanes,)
        True for the lanes that reached the end of their runs.
    """
    lanes = n_lanes() if lanes is None else lanes
    stages = STAGES[solver.integrator]
    own_steps = [(course.shape[1] - 1) // stages for course in courses]
    n_steps = max(own_steps)
    limits = (simulation.LOCKING_FORCE, simulation.LOCKING_TIME)
    tables = batch_tables(machines, solver.dt, limits, (lanes, _PINS), dtype)
    set_states(tables, states)
    faulty = bool(tables.geometry[:, rows.HAS_FAULTS : rows.HAS_FAULTS + 2].any())
    results = zeros((n_steps, rows.N_RESULTS, lanes), dtype)
    angle = zeros((stages * _CHUNK, lanes), np.float64)
    drive = zeros((stages * _CHUNK, rows.N_DRIVE_ROWS, lanes), dtype)
    for first in range(0, n_steps, _CHUNK):
        n = min(_CHUNK, n_steps - first)
        fill(tuple(courses), first, n, stages, tables.n_lobes, angle, drive)
        done = integrate(
            Lanes(lanes), Lanes(_PINS), stages, first, n, solver.dt, simulation.ABSURD_TORQUE, faulty,
            angle, drive, tables, results[first : first + n],
        )  # fmt: skip
        if done < n:
            break
    reached = tables.ended[1] == rows.RUNNING
    reached[: len(own_steps)] |= tables.ended[0, : len(own_steps)] >= own_steps
    return results, reached


def _result(
    request: Request, course: Float, torques: tuple[Float, Float | None], motion: NDArray[Any]
) -> SimulationRun:
    """Return one lane's run as ``simulate`` does; ``motion`` is that of the output at each step."""
    settings, steps, z = request.settings, request.sampling.steps, request.gearbox.n_lobes
    dt, stages = settings.solver.dt, settings.stages
    input_angle = on_grid(request.sampling.time, dt / stages, course[0])
    output_angle = output_speed = None
    if settings.motion:
        output_angle = motion[steps, 0] - input_angle / z
        output_speed = motion[steps, 1] - course[1, stages * steps] / z
    return SimulationRun(
        gearbox=request.gearbox,
        defects=request.defects,
        sampling_rate=float(settings.sampling_rate),
        torque_out=torques[0],
        torque_in=torques[1],
        input_angle=input_angle,
        output_angle=output_angle,
        output_speed=output_speed,
        dt=dt,
        kernel="batch",
    )
