"""Runs of a campaign on this machine or a Dask cluster: torque, and rows of labels and true values."""

from __future__ import annotations

import concurrent.futures
import contextlib
import functools
import itertools
import math
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import joblib
import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.files import code_sha256, package_versions
from cyclofeat._base.progress import stopped_quietly
from cyclofeat._base.quantities import from_1
from cyclofeat.simulators.campaign._design import DEPTH, OF_DEFECTS, WEAR, Campaign, RunPlan
from cyclofeat.simulators.effects.library import label_effects
from cyclofeat.simulators.machine import MachineRun, PlannedRun
from cyclofeat.simulators.sampling import sample_runs
from cyclofeat.simulators.simulation import GearboxLocked, SimulationFailed, settling_time

# Columns of every campaign and their kinds; those of its effects follow.
INTEGER, NUMBER, TEXT, INTEGERS = "integer", "number", "text", "integers"
_COLUMNS = {
    "run": INTEGER,
    "assembly": TEXT,
    "defect_count": INTEGER,
    "worn_lobes_from_1": INTEGERS,
    "wheels_from_1": INTEGERS,
    DEPTH: NUMBER,
    "status": TEXT,
    "reason": TEXT,
    "kernel": TEXT,
    "start_angle_rad": NUMBER,
    "settling_s": NUMBER,
    "true_speed_rpm": NUMBER,
    "true_load_nm": NUMBER,
    "brake_inertia_kg_m2": NUMBER,
    "meter_stiffness_nm_per_rad": NUMBER,
    "meter_damping_nms_per_rad": NUMBER,
    "stiffness_scale": NUMBER,
    "contact_damping": NUMBER,
    "clearance_m": NUMBER,
}
OK = "ok"  # other values of "status": "diverged", "locked", "invalid" (parameters contradict each other)


class RunResult(NamedTuple):
    """Result of a worker: torque of shape (n_samples,), or None for a failed run, and the table's row."""

    torque: NDArray[np.float32] | None
    row: dict[str, Any]


def table_columns(campaign: Campaign) -> dict[str, str]:
    """Return the columns of a campaign's table and their kinds."""
    effects = {
        f"effects.{label}.{name}": NUMBER
        for effects in campaign.the_rig.effect_sets()
        for label, effect in label_effects(effects).items()
        for name in effect.parameters
    }
    radial = {} if campaign.wear_um is None else {WEAR: NUMBER}
    return {**_COLUMNS, **radial, **effects}


# Tasks that are submitted per thread of the workers, so that no thread waits.
_AHEAD = 4
CONNECT_S = 10.0
# Time without any worker after which a cluster counts as lost.
NO_WORKER_S = 60.0
LOOK_S = 5.0
_KEPT = "all finished shards are kept: run the same campaign again to go on"


class WorkerLost(ConnectionError):
    """Error of workers or a scheduler that died or cannot be reached; finished shards are on disk."""


class UnlikeWorker(RuntimeError):
    """Error of a worker that would not make the same bytes as the process that writes."""


@functools.lru_cache(maxsize=1)
def made_with() -> dict[str, str]:
    """Return the versions and the digest of the sources on which the bytes of a result depend."""
    room = Path(__file__).parents[1]
    packages = package_versions("cyclofeat", "numpy", "scipy", "numba")
    return packages | {"simulators_sha256": code_sha256(room, sorted(room.rglob("*.py")))}


def check_kernel(campaign: Campaign) -> None:
    """Raise RuntimeError if the campaign needs batches and they cannot be compiled here."""
    if campaign.kernel == "exact":
        return
    from cyclofeat.simulators.batch import runs

    if error := runs.compile_error():
        raise RuntimeError(
            f"runs in batches cannot be compiled: {error}; a campaign of kernel='exact' needs none"
        )


def simulate_runs(
    campaign: Campaign, plans: Sequence[RunPlan], expected: dict[str, str] | None = None
) -> list[RunResult]:
    """Simulate runs, each of which depends on its own plan only.

    Raises UnlikeWorker unless this process has the ``expected`` versions and the campaign's kernel.
    """
    if expected is not None:
        if expected != (here := made_with()):
            other = next(name for name in expected if expected[name] != here.get(name))
            raise UnlikeWorker(
                f"a worker has {other} {here.get(other)}, the campaign {expected[other]}: install the same"
            )
        try:
            check_kernel(campaign)
        except RuntimeError as error:
            raise UnlikeWorker(f"on a worker {error}") from None
    rows, planned = zip(*(_draw_run(campaign, plan) for plan in plans), strict=True)
    runs = sample_runs(planned, kernel=campaign.kernel)
    return [_run_result(row, run) for row, run in zip(rows, runs, strict=True)]


def check_middle(campaign: Campaign) -> None:
    """Raise an error unless the kernel works here and the medians of the design can be simulated."""
    check_kernel(campaign)
    duration = max(2 / campaign.sampling_rate, min(campaign.duration, 0.01))
    try:
        rig = campaign.rig_at(campaign.medians())
        planned = rig.plan_run(
            duration=duration, sampling_rate=campaign.sampling_rate, random_state=0, settled=rig.has_motor,
            torque_in=False, motion=False,
        )  # fmt: skip
        (run,) = sample_runs([planned], kernel=campaign.kernel)
        if isinstance(run, ValueError):
            raise run
        if isinstance(run, MachineRun):  # a failure is a result, and other runs may succeed
            run.record()
    except ValueError as error:
        raise ValueError(
            f"the design cannot be simulated, not even in the middle of its ranges: {error}"
        ) from None


def _draw_run(campaign: Campaign, plan: RunPlan) -> tuple[dict[str, Any], PlannedRun | ValueError]:
    """Return the row of a run, with all that is known before it, and what is to be simulated."""
    defects = campaign.defects_of(plan)
    row: dict[str, Any] = {name: math.nan for name, kind in table_columns(campaign).items() if kind == NUMBER}
    row |= {f"effects.{name}": value for name, value in plan.values.items() if name not in OF_DEFECTS}
    row |= {
        "run": plan.run,
        "assembly": campaign.assembly_of(plan.run),
        "defect_count": plan.defect_count,
        "worn_lobes_from_1": from_1(defects.worn_lobes),
        "wheels_from_1": from_1(defects.wheels) if defects.worn_lobes else [],
        DEPTH: defects.depth if defects.worn_lobes else 0.0,
    }
    if campaign.wear_um is not None:
        row[WEAR] = defects.wear_um if defects.worn_lobes else 0.0
    planned: PlannedRun | ValueError
    try:
        sample = campaign.sample(plan)
        try:
            planned = sample.plan()
        except ValueError as error:
            machine, planned = sample.rig.draw(sample.random_state), error
            settling = settling_time(machine.gearbox)
        else:
            machine, settling = planned.machine, planned.n_settling / campaign.sampling_rate
    except ValueError as error:  # there is no such machine
        return row, error
    row |= {"settling_s": settling, **machine.true_values()}
    for label, drawn in label_effects(machine.effects).items():
        row |= {f"effects.{label}.{name}": float(getattr(drawn, name)) for name in drawn.parameters}
    return row, planned


def _run_result(row: dict[str, Any], run: MachineRun | SimulationFailed | ValueError) -> RunResult:
    """Complete the row of a run, and return its torque."""
    row |= {"status": OK, "reason": "", "kernel": ""}
    try:
        if isinstance(run, Exception):
            raise run
        record = run.record()
    except SimulationFailed as error:
        status = "locked" if isinstance(error, GearboxLocked) else "diverged"
        row |= {"status": status, "reason": str(error), "kernel": "exact"}
    except ValueError as error:
        # An impossible combination of values is a result, like a run that diverges.
        row |= {"status": "invalid", "reason": str(error)}
    else:
        # Angle of the input, modulo one turn of the output.
        angle = float(record.input_angle[0] % (2 * np.pi * record.gearbox.n_lobes))
        row |= {"kernel": record.kernel, "start_angle_rad": angle}
        return RunResult(record.torque_out.astype(np.float32), row)
    return RunResult(None, row)


def simulate_anywhere(
    campaign: Campaign, plans: Iterable[RunPlan], n_jobs: int = 1, scheduler: Any = None
) -> Generator[RunResult, None, None]:
    """Yield results of runs in the order of their plans; simulate only a few more than are consumed."""
    if scheduler is None:
        return _simulate_here(campaign, plans, n_jobs)
    return _simulate_on_cluster(campaign, plans, scheduler)


def _split_tasks(campaign: Campaign, plans: Iterable[RunPlan]) -> Iterator[list[RunPlan]]:
    """Yield the runs of each task: one batch, or one run of the exact kernel."""
    size = 1
    if campaign.kernel != "exact":
        from cyclofeat.simulators.batch.runs import n_lanes

        size = n_lanes()
    queue = iter(plans)
    while task := list(itertools.islice(queue, size)):
        yield task


def _simulate_here(
    campaign: Campaign, plans: Iterable[RunPlan], n_jobs: int
) -> Generator[RunResult, None, None]:
    workers = joblib.Parallel(n_jobs=n_jobs, prefer="processes", return_as="generator")
    expected = made_with()
    made = workers(
        joblib.delayed(simulate_runs)(campaign, task, expected) for task in _split_tasks(campaign, plans)
    )
    try:
        with stopped_quietly(made):
            yield from itertools.chain.from_iterable(made)
    except concurrent.futures.BrokenExecutor as error:
        raise WorkerLost(
            f"a worker process died ({type(error).__name__}; killed, or out of memory?); {_KEPT}"
        ) from error
    except UnlikeWorker as error:
        raise ValueError(str(error)) from None


def _simulate_on_cluster(
    campaign: Campaign, plans: Iterable[RunPlan], scheduler: Any
) -> Generator[RunResult, None, None]:
    try:
        from distributed import Client
    except ImportError:
        raise ImportError(
            "a scheduler needs dask.distributed: pip install distributed, there and here"
        ) from None
    if isinstance(scheduler, Client):
        yield from _simulate_by_client(campaign, plans, scheduler)
        return
    if not isinstance(scheduler, str):
        raise TypeError(f"scheduler must be an address like 'tcp://host:8786' or a Client, got {scheduler!r}")
    try:
        client: Any = Client(scheduler, timeout=CONNECT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise WorkerLost(
            f"no Dask scheduler answers at {scheduler!r} ({' '.join(str(error).split())}): give the address "
            "that 'dask scheduler' prints, like tcp://host:8786"
        ) from None
    with client:
        yield from _simulate_by_client(campaign, plans, client)


def _simulate_by_client(
    campaign: Campaign, plans: Iterable[RunPlan], client: Any
) -> Generator[RunResult, None, None]:
    from distributed import CancelledError, KilledWorker
    from distributed.comm.core import CommClosedError

    expected = made_with()
    waiting: deque[Any] = deque()
    queue = _split_tasks(campaign, plans)
    try:
        ahead = _AHEAD * _count_threads(client)
        while True:
            while len(waiting) < ahead and (task := next(queue, None)):
                # Not pure: Dask must not reuse a result of an earlier campaign.
                waiting.append(client.submit(simulate_runs, campaign, task, expected, pure=False))
            if not waiting:
                return
            yield from _wait_for_results(client, waiting[0])
            waiting.popleft()
    except UnlikeWorker as error:
        raise ValueError(str(error)) from None
    except (KilledWorker, CancelledError, CommClosedError) as error:
        raise WorkerLost(
            f"the cluster lost workers or scheduler ({type(error).__name__}); {_KEPT}"
        ) from error
    finally:
        with contextlib.suppress(Exception):  # the scheduler may be gone
            client.cancel(list(waiting), force=True)


def _wait_for_results(client: Any, future: Any) -> list[RunResult]:
    """Wait for the results of one task; the scheduler repeats one whose worker died on another."""
    while True:
        try:
            results: list[RunResult] = future.result(timeout=LOOK_S)
            return results
        except TimeoutError:
            _count_threads(client)


def _count_threads(client: Any) -> int:
    """Count the threads of all workers; wait some time for the first of them."""
    if not client.nthreads():
        try:
            client.wait_for_workers(1, timeout=NO_WORKER_S)
        except TimeoutError:
            raise WorkerLost(f"the cluster has had no worker for {NO_WORKER_S:g} s; {_KEPT}") from None
    return sum(client.nthreads().values()) or 1
