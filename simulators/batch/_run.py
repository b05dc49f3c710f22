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
from cyclofeat.simulators._chatter import warn_of_chatter
from cyclofeat.simulators.batch import _rows as rows
from cyclofeat.simulators.batch._integrate import Course, Integrating
from cyclofeat.simulators.batch._prepare import unsuited
from cyclofeat.simulators.batch._samples import SampledCourse, Samples
from cyclofeat.simulators.courses import Courses, DriveAndLoad, drive_and_load
from cyclofeat.simulators.defects import LobeDefects, machine
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.simulation import STAGES, Integration, Sampling, SimulationRun, Solver
from cyclofeat.simulators.tables import KernelInput, kernel_input, rest_state

Float = NDArray[np.float64]


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
    def form(self) -> tuple[int, int, bool, bool, Settings]:
        """Properties that all runs of a batch share."""
        one = self.gearbox
        pitched = self.constants.wheel.has_pitch_errors
        return one.n_lobes, one.n_internal_sleeves, one.has_friction, pitched, self.settings

    @property
    def cost(self) -> tuple[int, int]:
        """Defects of both wheels and steps, by which runs of similar cost are found."""
        return self.defects.defect_count * len(self.defects.wheels), self.sampling.n_steps


@functools.cache
def compile_error() -> str | None:
    """Return in one line why batches cannot be compiled here, or None."""
    gearbox = CycloidalGearbox.steel()
    course = DriveAndLoad(gearbox, 3, 5e-6, 1e5)
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
    """Yield requests that can run together, as many as there are lanes, by their keys.

    A batch takes as long as the longest run, and at each step as the lane with most contacts: runs with as
    many defects and of similar length stand together.
    """
    by_form: dict[tuple[int, int, bool, bool, Settings], list[int]] = {}
    for key in sorted(requests, key=lambda key: requests[key].cost):
        by_form.setdefault(requests[key].form, []).append(key)
    for keys in by_form.values():
        while keys:
            yield {key: requests[key] for key in keys[-n_lanes() :]}
            del keys[-n_lanes() :]


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
    settings, stages, dt = requests[0].settings, requests[0].settings.stages, requests[0].settings.solver.dt
    courses = [
        SampledCourse(
            DriveAndLoad(
                one.gearbox, stages * one.sampling.n_steps + 1, dt / stages, settings.sampling_rate,
                one.start_angle, one.courses,
            ),
            one.sampling, stages, dt,
        )
        for one in requests
    ]  # fmt: skip
    states = [_start(one) for one in requests]
    batch = Integrating(
        [one.constants for one in requests], courses, states, settings.solver, lanes=n_lanes()
    )
    torques = (rows.TORQUE_OUT, rows.TORQUE_IN) if settings.torque_in else (rows.TORQUE_OUT,)
    motion = (rows.OUTPUT, rows.OUTPUT_RATE) if settings.motion else ()
    longest = max((one.sampling for one in requests), key=lambda sampling: sampling.n_steps)
    samples = Samples(longest, n_lanes(), torques, motion)
    for begin, results in batch.pieces(samples.again):
        samples.take(begin, results)
    for lane, one in enumerate(requests):
        if batch.reached[lane] and one.gearbox.has_friction:
            _warn_of_chatter(one, batch.watched(lane))
    taken = {row: samples.of_lanes(row) for row in range(rows.N_RESULTS)}
    return [
        _result(one, course, {row: None if of is None else of[lane] for row, of in taken.items()})
        if batch.reached[lane]
        else None
        for lane, (one, course) in enumerate(zip(requests, courses, strict=True))
    ]


def _warn_of_chatter(request: Request, watched: Sequence[tuple[Float, Float]]) -> None:
    """Warn as ``simulate`` does, by input and load, and state, at some steps."""
    if not watched:  # unchecked, or the run ends before the first of them
        return
    solver = request.settings.solver
    inputs, states = (np.stack(parts) for parts in zip(*watched, strict=True))
    nearby = np.repeat(inputs[:, :, np.newaxis], 3, axis=2)
    nearby[:, 0] += nearby[:, 1] * [0.0, solver.dt / 2, solver.dt]
    rates = simulation.damping_by_friction(request.gearbox, request.constants, solver.dt, nearby, states)
    warn_of_chatter(rates, solver.dt, solver.integrator)


def _start(request: Request) -> Float:
    """Return the state at the start."""
    gearbox, settings, solver = request.gearbox, request.settings, request.settings.solver
    state = rest_state(gearbox)
    if settings.start == "rest":
        return state
    course = drive_and_load(
        gearbox, 3, solver.dt / 2, settings.sampling_rate, request.start_angle, request.courses
    )
    return simulation.relaxed(
        Integration(gearbox, request.constants, course, solver.dt, solver.integrator), state
    )


def integrated(
    machines: Sequence[KernelInput],
    courses: Sequence[Course],
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
        Of all steps; what stands behind a run's own end means nothing.
    reached : ndarray of bool, shape (lanes,)
        True for the lanes that reached the end of their runs.
    """
    lanes = n_lanes() if lanes is None else lanes
    batch = Integrating(machines, courses, states, solver, lanes=lanes, dtype=dtype)
    pieces = [results.copy() for _, results in batch.pieces()]
    return np.concatenate(pieces), batch.reached


def _result(request: Request, course: SampledCourse, samples: Mapping[int, Float | None]) -> SimulationRun:
    """Return one lane's run as ``simulate`` does; ``samples`` are the rows of the results."""
    own, z = slice(request.sampling.time.size), request.gearbox.n_lobes
    out, into, angle, rate = (None if row is None else row[own].copy() for row in samples.values())
    assert out is not None
    return SimulationRun(
        gearbox=request.gearbox,
        defects=request.defects,
        sampling_rate=float(request.settings.sampling_rate),
        torque_out=out,
        torque_in=into,
        input_angle=course.angle,
        output_angle=None if angle is None else angle - course.angle / z,
        output_speed=None if rate is None else rate - course.speed / z,
        dt=request.settings.solver.dt,
        kernel="batch",
    )
