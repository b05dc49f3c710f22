"""Speed of the simulator. ``make bench-simulator`` writes the table next to it.

All rows except those on two cores use one core, one BLAS thread and processor time. Each figure is the median
of several repeats; compared variants run alternately.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import joblib
import numpy as np
from _markdown import table
from _timing import Work, in_turn, on_free_cores, ratio
from _versions import vector_width
from batches import DURATION_S, INTEGRATORS, Machines, accuracy_table
from reference_gearbox import ReferenceGearbox
from threadpoolctl import threadpool_limits

from cyclofeat.gap.simulations import Population, record
from cyclofeat.gap.summaries.summarise import Kinematics
from cyclofeat.gap.world.cells import recording_cells, turn_samples
from cyclofeat.gap.world.world import World, with_noise_and_drift
from cyclofeat.simulators import CycloidalGearbox, LobeDefects, Rig, Solver, simulate, simulate_many
from cyclofeat.simulators.batch.runs import n_lanes
from cyclofeat.simulators.courses import DriveAndLoad
from cyclofeat.simulators.machine import MachineRun
from cyclofeat.simulators.sampling import Sample, sample_runs
from cyclofeat.simulators.simulation import Integration
from cyclofeat.simulators.tables import kernel_input, rest_state

DT = 1e-5
REPEATS = 15
REFERENCE_STEPS = 50
MANY, RECORDINGS = 16, 64
SHORT_RUNS, SHORT_S = 64, 0.1

STEEL = CycloidalGearbox.steel()
BRAKED = STEEL.with_brake(0.02, 1e4, 0.02)
HEALTHY, WORN = LobeDefects.healthy(), LobeDefects.worn(7)
Row = tuple[str, str, str]

NOTES = """\
Where a goal is missed:

- Real time: the loops over contacts limit the speed, not the latency between evaluations (independent
  evaluations of one state take nearly as long). Shares of the time, healthy, measured in C by leaving parts
  out: flanks 40 %, internal sleeves 30 %, sines and sums 20 %, new descriptions 10 %. Vectors of eight would
  shorten the first two. The rest of a run, drive and anti-alias filter, takes about 5 ms for 0.6 s.
- `simulate_many` with the exact kernel makes one run after the other; batches put one gearbox into each lane
  of the processor's vectors. Whole runs gain less than the time loop: drive, load and tables of a run are
  still computed one by one.
- The goal for batches was set against the exact kernel before its tables were handed on as addresses; the
  figures are against today's, which is 1.2 to 1.3 times as fast.
- Two cores of a virtual machine may be two threads of one core, which share its arithmetic units.
"""


def real_time() -> list[Row]:
    """Simulated over processor time, one run at a time, with the kernel's share."""
    cases = (
        ("healthy", STEEL, HEALTHY),
        ("7 worn lobes on both wheels", STEEL, WORN),
        ("7 worn lobes, brake behind torque meter", BRAKED, WORN),
    )
    runs: list[Work] = [partial(simulate, *case, duration=DURATION_S) for _, *case in cases]
    kernels = [kernel(gearbox, defects) for _, gearbox, defects in cases]
    medians = [*map(statistics.median, in_turn(runs + kernels, REPEATS))]
    rows = []
    for (name, _, _), whole, inside in zip(cases, medians[:3], medians[3:], strict=True):
        text = f"{DURATION_S / whole:.1f} x real time (kernel alone {DURATION_S / inside:.1f} x, "
        evaluation = inside / (2 * DURATION_S / DT)
        rows.append((name, f"{text}{evaluation * 1e9:.0f} ns per evaluation)", ">= 20 x"))
    return rows


def kernel(gearbox: CycloidalGearbox, defects: LobeDefects) -> Work:
    """Return a run of the kernel alone, with tables, drive and load computed in advance."""
    n = round(DURATION_S / DT)
    course = DriveAndLoad(gearbox, 2 * n + 1, DT / 2).piece()
    integration = Integration(gearbox, kernel_input(gearbox, defects), course, DT)
    return partial(integration.run, rest_state(gearbox), 0, n, np.zeros(0, dtype=int))


def adams_bashforth() -> list[Row]:
    """The same with one evaluation per step, with its loss of accuracy."""
    cases = (("healthy", HEALTHY), ("7 worn lobes on both wheels", WORN))

    def run(defects: LobeDefects, integrator: str, dt: float, duration: float = DURATION_S) -> np.ndarray:
        solver = Solver(dt, integrator, "pick")
        return simulate(STEEL, defects, duration=duration, sampling_rate=25_000.0, solver=solver).torque_out

    works: list[Work] = [partial(run, defects, "adams_bashforth", DT) for _, defects in cases]
    rows = []
    for (name, defects), times in zip(cases, in_turn(works, REPEATS), strict=True):
        # Rounding errors grow later, so later samples of two exact runs would differ, too.
        exact = run(defects, "midpoint", DT / 8, 0.1)
        errors = [np.std(run(defects, rule, DT, 0.1) - exact) for rule in ("adams_bashforth", "midpoint")]
        text = f"{DURATION_S / statistics.median(times):.1f} x real time (error over the first 0.1 s "
        text += f"{errors[0]:.1e} Nm rms, midpoint {errors[1]:.1e})"
        rows.append((f'`integrator="adams_bashforth"`, {name}', text, ">= 20 x"))
    return rows


def many() -> list[Row]:
    """Real time per core inside ``simulate_many``."""
    names = ("healthy", "7 worn lobes")
    works: list[Work] = [
        partial(simulate_many, STEEL, [defects] * MANY, duration=DURATION_S) for defects in (HEALTHY, WORN)
    ]
    speeds = [MANY * DURATION_S / statistics.median(times) for times in in_turn(works, 3)]
    return [
        (f"`simulate_many`, {MANY} runs, {name}", f"{speed:.1f} x real time per core", ">= 30 x")
        for name, speed in zip(names, speeds, strict=True)
    ]


def batches() -> list[Row]:
    """Real time per core of batches, and ratio to the exact kernel: of the time loop, and of whole runs."""
    rows = []
    for name, counts in (("0 to 7 worn lobes", [*range(8)] * 2), ("healthy", [0] * 16)):
        machines = Machines.of(Rig.r1(), counts[: n_lanes()])
        simulated = len(machines.defects) * DURATION_S
        for integrator, goal in zip(INTEGRATORS, ("", ">= 4.5 x with AVX2, 8 x with AVX-512"), strict=True):
            solver = Solver(DT, integrator)
            n = round(DURATION_S / DT)
            given = machines.courses(n, DT), solver, n
            alone = in_turn([partial(machines.exactly, *given), partial(machines.in_lanes, *given)], 5)
            whole = in_turn([partial(machines.runs, integrator, kernel) for kernel in ("exact", "batch")], 5)
            for part, (exact, batch), wanted in (("time loop", alone, goal), ("whole runs", whole, "")):
                speed = simulated / statistics.median(batch)
                text = f"{speed:.0f} x real time, {ratio(exact, batch):.2f} x faster"
                rows.append(
                    (f'batch of {len(machines.defects)}, `"{integrator}"`, {name}, {part}', text, wanted)
                )
    return rows


def recordings() -> list[Row]:
    """Recordings of one output turn with their summaries, as the gap's banks make them."""
    world, samples = World(), list[Sample]()
    kinematics = Kinematics(world.sampling_rate, 500 / 60, world.n_lobes)
    for number in range(RECORDINGS):
        random = np.random.default_rng(number)
        rig = with_noise_and_drift(world.rig, world.may_differ).with_added(*world.prior.in_machine(random))
        population = Population(
            rig.at(500.0, random.uniform(*world.loads_nm)), turn_samples(kinematics), world.sampling_rate,
            world.wheels,
        )  # fmt: skip
        samples.append(population.sample(number % 8, np.random.SeedSequence(number)))

    def summarise(samples: Sequence[Sample]) -> None:
        runs = [run for run in sample_runs(samples) if isinstance(run, MachineRun)]
        recording_cells(np.array([record(run).torque for run in runs]), kinematics)

    usual = Solver(DT, "adams_bashforth", check_friction=False)
    before = [replace(sample, error_nm=None, solver=usual) for sample in samples]
    slow, fast = in_turn([partial(summarise, before), partial(summarise, samples)], 5)
    text = f"{1e3 * statistics.median(fast) / RECORDINGS:.0f} ms, {ratio(slow, fast):.2f} x faster than "
    name = f"recording of 1.85 s with its summary ({RECORDINGS} drawn rigs)"
    return [(name, text + "by Adams-Bashforth at 1e-5 s", "<= 30 ms")]


def papers_formulation() -> Row:
    """Per step, against the papers' formulation: a dense 141 x 141 solve per stage."""
    reference = ReferenceGearbox(STEEL, WORN)
    instant = 0.0, 0.0, 0.0, reference.rest_angles(0.0), np.zeros(3), 22.0
    slow, fast = in_turn(
        [
            lambda: [reference.accelerations(*instant) for _ in range(2 * REFERENCE_STEPS)],
            lambda: simulate(STEEL, WORN, duration=DURATION_S),
        ],
        5,
    )
    factor = ratio(slow, fast) / REFERENCE_STEPS * (DURATION_S / DT)
    name = "the papers' formulation (dense 141 x 141 per stage), 7 worn lobes"
    return name, f"{factor:.0f} x faster", ">= 600 x"


def short_runs(backend: str, kernel: str, duration: float, n_jobs: int) -> None:
    with joblib.parallel_config(backend=backend):
        simulate_many(STEEL, [WORN] * SHORT_RUNS, duration=duration, kernel=kernel, n_jobs=n_jobs)


def on_two_cores() -> list[Row]:
    """How many times faster two workers are than one."""
    rows = []
    kinds = (
        ("threads", "threading", "exact", SHORT_S, ">= 1.8 x"),
        ("processes", "loky", "exact", SHORT_S, ">= 1.8 x"),
        ("threads with batches", "threading", "batch", DURATION_S, ">= 1.9 x"),
    )
    for kind, backend, kernel, duration, goal in kinds:
        work = partial(short_runs, backend, kernel, duration)
        name = f"two cores against one, {SHORT_RUNS} runs of {duration:g} s, {kind}, wall time"
        rows.append((name, on_free_cores(partial(work, 1), partial(work, 2)), goal))
    return rows


def with_pins(n_pins: int) -> CycloidalGearbox:
    """Gearbox with ``n`` pins on the same circle, pin radius and eccentricity scaled in proportion."""
    share = STEEL.n_pins / n_pins
    return STEEL.replace(
        n_pins=n_pins, eccentricity=STEEL.eccentricity * share, pin_radius=STEEL.pin_radius * share
    )


def growth() -> str:
    """Return the table of cost against size; exponents are slopes of lines through the logarithms."""

    def run(gearbox: CycloidalGearbox, duration: float) -> Work:
        return partial(simulate, gearbox, HEALTHY, duration=duration)

    def runs(n: int) -> Work:
        return partial(simulate_many, STEEL, [HEALTHY] * n, duration=SHORT_S)

    swept: tuple[tuple[str, tuple[float, ...], list[Work]], ...] = (
        ("external sleeves", (8, 16, 32, 64), [run(with_pins(n), 0.3) for n in (8, 16, 32, 64)]),
        ("simulated time in s", (0.3, 0.6, 1.2, 2.4), [run(STEEL, s) for s in (0.3, 0.6, 1.2, 2.4)]),
        ("runs", (4, 16, 64), [runs(n) for n in (4, 16, 64)]),
    )
    rows = []
    for name, sizes, works in swept:
        medians = [statistics.median(times) for times in in_turn(works, 7)]
        exponent = np.polyfit(np.log(sizes), np.log(medians), 1)[0]
        pairs = zip(sizes, medians, strict=True)
        times = ", ".join(f"{size:g}: {seconds * 1e3:.0f}" for size, seconds in pairs)
        rows.append((name, times, f"{exponent:.2f}"))
    return table(("what grows", "processor time in ms", "exponent"), rows)


def results() -> str:
    """Return the results in Markdown."""
    rows = [
        *real_time(),
        *adams_bashforth(),
        *many(),
        *batches(),
        *recordings(),
        papers_formulation(),
        *on_two_cores(),
    ]
    what = f"dt = 1e-5 s, 48 contacts, two wheels, one core; vectors of {vector_width()}"
    return (
        table((what, "result", "goal"), rows)
        + "\nErrors of batches beside those of the time step (against an eighth of the step):\n\n"
        + accuracy_table()
        + "\nCost as the problem grows (goal: linear, exponent at most 1):\n\n"
        + growth()
    )


def main() -> None:
    with threadpool_limits(1):
        text = f"Made by `make bench-simulator`.\n\n{results()}\n{NOTES}"
    print(text, end="")
    Path(__file__).with_suffix(".md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
