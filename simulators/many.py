"""Many runs at once, on several cores."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import joblib

from cyclofeat._base.checks import list_members, one_of, repr_of
from cyclofeat._base.checks import n_jobs as check_n_jobs
from cyclofeat._base.progress import stopped_quietly
from cyclofeat.simulators.defects import LobeDefects
from cyclofeat.simulators.gearbox import CycloidalGearbox
from cyclofeat.simulators.simulation import SimulationFailed, SimulationRun, simulate

if TYPE_CHECKING:  # compiled only where it is asked for
    from cyclofeat.simulators.batch.runs import Request

# Work of one worker: the arguments of its runs by number, and the batch that makes them, if one does.
_Task = tuple[dict[int, dict[str, Any]], "Sequence[Request] | None"]


def simulate_many(
    gearboxes: CycloidalGearbox | Iterable[CycloidalGearbox] | None = None,
    defects: LobeDefects | Iterable[LobeDefects] | None = None,
    *,
    n_jobs: int = 1,
    kernel: str = "exact",
    **options: Any,
) -> list[SimulationRun]:
    """Simulate many gearboxes, each as :func:`simulate` would.

    Parameters
    ----------
    gearboxes : CycloidalGearbox or iterable of CycloidalGearbox, default ``CycloidalGearbox.steel()``
    defects : LobeDefects or iterable of LobeDefects, default healthy
        One for all runs, or one for each.
    n_jobs : int
        Number of threads; -1 for all processors. ``joblib.parallel_config`` chooses other workers.
    kernel : {"exact", "batch", "auto"}
        "exact" makes each run as :func:`simulate` does, in double precision. "batch" puts one gearbox into
        each lane of the processor's vectors, in single precision: several times as fast, with errors below
        those of the time step. It refuses polylines as profile, fewer than 10 pins, and the options
        ``forces`` and ``points``. "auto" leaves what batches refuse to the exact
        kernel; the attribute ``kernel`` of a run says which made it. With both, a run depends on its own
        arguments only, and the exact kernel repeats a run that diverges or locks.
    **options
        Further arguments of :func:`simulate`, the same for all runs.

    Returns
    -------
    list of SimulationRun
        In the order of the arguments.

    Raises
    ------
    SimulationFailed
        The error of the first run that diverges or locks; a note names it.
    TypeError, ValueError
        If an argument is of the wrong type, or the arguments differ in length, or with ``kernel="batch"`` a
        run is not for batches.
    RuntimeError
        With ``kernel="batch"`` where it cannot be compiled; "auto" warns and takes the exact kernel.

    Examples
    --------
    >>> runs = simulate_many(defects=[LobeDefects.worn(n) for n in range(3)], duration=0.05, n_jobs=2)
    >>> [run.defects.defect_count for run in runs]
    [0, 1, 2]
    """
    one_of("kernel", kernel, ("exact", "batch", "auto"))
    check_n_jobs(n_jobs)
    lists: dict[str, tuple[Any, ...]] = {}
    for name, given, kind in (("gearbox", gearboxes, CycloidalGearbox), ("defects", defects, LobeDefects)):
        if given is not None and not isinstance(given, kind):
            members = list_members(given)
            if members is None:
                raise TypeError(f"{name} must be one {kind.__name__} or several, got {repr_of(given)}")
            lists[name] = members
    if len({len(members) for members in lists.values()}) > 1:
        lengths = " and ".join(f"{name} {len(members)}" for name, members in lists.items())
        raise ValueError(f"gearboxes and defects must agree in number, got {lengths}")
    same = {"gearbox": gearboxes, "defects": defects} | options
    each = zip(*lists.values(), strict=True) if lists else [()]
    runs = [same | dict(zip(lists, members, strict=True)) for members in each]
    results: dict[int, SimulationRun] = {}
    for index, result in simulate_each(runs, kernel, n_jobs):
        if isinstance(result, SimulationFailed):
            result.add_note(f"in run {index} of {len(runs)} (counted from 0)")
            raise result
        results[index] = result
    return [results[index] for index in range(len(runs))]


def simulate_each(
    runs: Sequence[dict[str, Any]],
    kernel: str,
    n_jobs: int = 1,
    then: Callable[[int, SimulationRun | SimulationFailed], Any] | None = None,
) -> Generator[tuple[int, Any], None, None]:
    """Yield the index of each set of arguments of :func:`simulate`, and its run or its failure.

    Those that share a batch come together. ``then`` makes something else of index and run, in the thread that
    made the run.
    """
    tasks = deque(_split_tasks(runs, kernel))
    numbers = [tuple(of_task) for of_task, _ in tasks]
    del runs  # the arguments of a run that is done, with their courses, go with their task
    workers = joblib.Parallel(n_jobs=n_jobs, prefer="threads", return_as="generator")
    made = workers(joblib.delayed(_simulate_task)(*tasks.popleft(), then) for _ in numbers)
    with stopped_quietly(made):
        for indices, results in zip(numbers, made, strict=True):
            yield from zip(indices, results, strict=True)


def _simulate_task(runs: dict[int, dict[str, Any]], batch: Sequence[Request] | None, then: Any) -> list[Any]:
    """Return the runs of a task, or their failures, or what ``then`` makes of them."""
    batched: Sequence[SimulationRun | None] = [None] * len(runs)
    if batch is not None:
        from cyclofeat.simulators.batch.runs import run_batch

        batched = run_batch(batch)
    # A run that diverges or locks in a batch has its reason from the exact kernel.
    results = [
        _simulate_or_fail(arguments) if run is None else run
        for arguments, run in zip(runs.values(), batched, strict=True)
    ]
    return results if then is None else list(map(then, runs, results))


def _split_tasks(runs: Sequence[dict[str, Any]], kernel: str) -> list[_Task]:
    """Return batches of runs, and runs alone; the task of the earliest run first."""
    alone: list[_Task] = [({index: run}, None) for index, run in enumerate(runs)]
    of_gearbox = {index: run for index, run in enumerate(runs) if run.get("simulator") is None}
    if kernel == "exact" or not of_gearbox:
        return alone
    from cyclofeat.simulators.batch import runs as batches

    if (error := batches.compile_error()) is not None:
        message = f"runs in batches cannot be compiled here: {error}"
        if kernel == "batch":
            raise RuntimeError(f"{message}; give kernel='exact'")
        warnings.warn(f"{message}; the exact kernel makes all runs", RuntimeWarning, stacklevel=3)
        return alone

    requests = {index: batches.Request.from_arguments(run) for index, run in of_gearbox.items()}
    obstacles = {index: batches.obstacle(request, runs[index]) for index, request in requests.items()}
    for index, what in obstacles.items():
        if what and kernel == "batch":
            raise ValueError(f"kernel 'batch' does not simulate {what} (run {index}): give kernel='auto'")
    suited = {index: request for index, request in requests.items() if not obstacles[index]}
    tasks = [task for index, task in enumerate(alone) if index not in suited]
    groups = batches.group_requests(suited)
    tasks += [({index: runs[index] for index in group}, list(group.values())) for group in groups]
    return sorted(tasks, key=lambda task: min(task[0]))


def _simulate_or_fail(arguments: dict[str, Any]) -> SimulationRun | SimulationFailed:
    try:
        return simulate(**arguments)
    except SimulationFailed as failure:
        return failure
