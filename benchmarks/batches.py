"""Batches of gearboxes beside the exact kernel: speed, and errors beside those of the time step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from _markdown import table

from cyclofeat.simulators import CycloidalGearbox, LobeDefects, Rig, Solver, simulate_many
from cyclofeat.simulators.batch.runs import BatchIntegration
from cyclofeat.simulators.courses import DriveAndLoad
from cyclofeat.simulators.simulation import STAGES, Integration
from cyclofeat.simulators.tables import kernel_input, rest_state

DURATION_S = 0.6
INTEGRATORS = ("midpoint", "adams_bashforth")
FINER = 8
FRICTION = {"sleeve_friction": 0.05, "journal_friction": 0.02, "output_bearing_torque": 0.3}
RIGS = (
    Rig.r0(),
    Rig.r1(),
    Rig.r2(),
    Rig.r1().replace(name="R1 with friction", gearbox=Rig.r1().gearbox.replace(**FRICTION)),
)
COUNTS = range(8)


class Prepared:
    """A course at half steps, in the pieces that batches take."""

    def __init__(self, course: np.ndarray, stride: int) -> None:
        self._course = np.ascontiguousarray(course[:, ::stride])
        self.n = self._course.shape[1]

    def piece(self, first: int, last: int, out: np.ndarray) -> np.ndarray:
        """Write the rows from evaluation ``first`` to ``last``."""
        out[:, : last + 1 - first] = self._course[:, first : last + 1]
        return out


@dataclass(frozen=True)
class Machines:
    """Machines with their defects, run from different angles of the input."""

    gearboxes: list[CycloidalGearbox]
    defects: list[LobeDefects]

    @classmethod
    def of(cls, rig: Rig, counts: Sequence[int]) -> Machines:
        """Draw a machine for each number of worn lobes."""
        drawn = [rig.draw(k).gearbox for k in range(len(counts))]
        return cls(drawn, [LobeDefects.worn(count) for count in counts])

    def runs(self, integrator: str, kernel: str) -> None:
        """Make whole runs: course, kernel, anti-alias filter."""
        simulate_many(
            self.gearboxes, self.defects, duration=DURATION_S, solver=Solver(integrator=integrator),
            motion=False, kernel=kernel,
        )  # fmt: skip

    def courses(self, n_steps: int, dt: float) -> list[np.ndarray]:
        """Drive and load of each machine at half steps."""
        return [
            DriveAndLoad(gearbox, 2 * n_steps + 1, dt / 2, 1.0 + 7.0 * k).piece()
            for k, gearbox in enumerate(self.gearboxes)
        ]

    def exactly(self, courses: list[np.ndarray], solver: Solver, n_steps: int) -> np.ndarray:
        """Torques of the exact kernel, (n_steps, 2, n_machines)."""
        none = np.zeros(0, dtype=int)
        torques = [
            Integration(gearbox, kernel_input(gearbox, defects), course, solver.dt, solver.integrator)
            .run(rest_state(gearbox), 0, n_steps, none)
            .torques
            for gearbox, defects, course in zip(self.gearboxes, self.defects, courses, strict=True)
        ]
        return np.stack(torques, axis=2)

    def in_lanes(self, courses: list[np.ndarray], solver: Solver, n_steps: int) -> np.ndarray:
        """Torques of a batch, (n_steps, 2, n_machines)."""
        constants = [kernel_input(*one) for one in zip(self.gearboxes, self.defects, strict=True)]
        pieces = [Prepared(course, 2 // STAGES[solver.integrator]) for course in courses]
        batch = BatchIntegration(constants, pieces, solver)
        results = np.concatenate([results.copy() for _, results in batch.pieces()])
        if not batch.has_reached_end.all():
            raise RuntimeError("a lane did not reach its end")
        return results[:, :2, : len(constants)]


def accuracy_table() -> str:
    """Return errors over 0.6 s of batches, and of the time step, the largest of 8 machines of each rig."""
    head = (
        "rms error in mNm over 0.6 s, largest of 0 to 7 worn lobes", "torque_out: batch", "time step",
        "torque_in: batch", "time step", "machines where the batch errs less",
    )  # fmt: skip
    rows = []
    for rig in RIGS:
        machines = Machines.of(rig, COUNTS)
        for integrator in INTEGRATORS:
            solver = Solver(integrator=integrator)
            fine = Solver(dt=solver.dt / FINER)
            n = round(DURATION_S / solver.dt)
            courses = machines.courses(n, solver.dt)
            exact = machines.exactly(courses, solver, n)
            finely = machines.exactly(machines.courses(FINER * n, fine.dt), fine, FINER * n)[::FINER]
            of_batch = rms(machines.in_lanes(courses, solver, n) - exact)
            of_step = rms(exact - finely)
            worst, worst_step = 1e3 * of_batch.max(axis=1), 1e3 * of_step.max(axis=1)
            better = int((of_batch < of_step).all(axis=0).sum())
            rows.append([
                f"{rig.name}, {integrator}", f"{worst[0]:.3g}", f"{worst_step[0]:.3g}", f"{worst[1]:.2g}",
                f"{worst_step[1]:.3g}", f"{better} of {len(machines.defects)}",
            ])  # fmt: skip
    return table(head, rows)


def rms(values: np.ndarray) -> np.ndarray:
    """Root mean square over time."""
    return np.sqrt(np.mean(values**2, axis=0))
