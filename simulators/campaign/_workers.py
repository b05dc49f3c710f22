"""Runs of a campaign on the cores of one machine or on a Dask cluster."""

from __future__ import annotations

import concurrent.futures
import contextlib
import itertools
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from typing import Any

import joblib

from cyclofeat._base.parallel import stopped_quietly
from cyclofeat.simulators.campaign._design import Campaign, RunPlan
from cyclofeat.simulators.campaign._run import RunResult, UnlikeWorker, made_with, simulate_runs

# Tasks that are submitted per thread of the workers, so that no thread waits.
_AHEAD = 4
CONNECT_S = 10.0
# Time without any worker after which a cluster counts as lost.
NO_WORKER_S = 60.0
LOOK_S = 5.0
_KEPT = "all finished shards are kept: run the same campaign again to go on"


class WorkerLost(ConnectionError):
    """Error of workers or a scheduler that died or cannot be reached; finished shards are on disk."""


def results(
    campaign: Campaign, plans: Iterable[RunPlan], n_jobs: int = 1, scheduler: Any = None
) -> Generator[RunResult, None, None]:
    """Yield results of runs in the order of their plans; simulate only a few more than are consumed."""
    if scheduler is None:
        return _on_this_machine(campaign, plans, n_jobs)
    return _on_cluster(campaign, plans, scheduler)


def _tasks(campaign: Campaign, plans: Iterable[RunPlan]) -> Iterator[list[RunPlan]]:
    """Yield the runs of each task: one batch, or one run of the exact kernel."""
    size = 1
    if campaign.kernel != "exact":
        from cyclofeat.simulators.batch.runs import n_lanes

        size = n_lanes()
    queue = iter(plans)
    while task := list(itertools.islice(queue, size)):
        yield task


def _on_this_machine(
    campaign: Campaign, plans: Iterable[RunPlan], n_jobs: int
) -> Generator[RunResult, None, None]:
    workers = joblib.Parallel(n_jobs=n_jobs, prefer="processes", return_as="generator")
    expected = made_with()
    made = workers(
        joblib.delayed(simulate_runs)(campaign, task, expected) for task in _tasks(campaign, plans)
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


def _on_cluster(
    campaign: Campaign, plans: Iterable[RunPlan], scheduler: Any
) -> Generator[RunResult, None, None]:
    try:
        from distributed import Client
    except ImportError:
        raise ImportError(
            "a scheduler needs dask.distributed: pip install distributed, there and here"
        ) from None
    if isinstance(scheduler, Client):
        yield from _from_client(campaign, plans, scheduler)
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
        yield from _from_client(campaign, plans, client)


def _from_client(
    campaign: Campaign, plans: Iterable[RunPlan], client: Any
) -> Generator[RunResult, None, None]:
    from distributed import CancelledError, KilledWorker
    from distributed.comm.core import CommClosedError

    expected = made_with()
    waiting: deque[Any] = deque()
    queue = _tasks(campaign, plans)
    try:
        ahead = _AHEAD * _n_threads(client)
        while True:
            while len(waiting) < ahead and (task := next(queue, None)):
                # Not pure: Dask must not reuse a result of an earlier campaign.
                waiting.append(client.submit(simulate_runs, campaign, task, expected, pure=False))
            if not waiting:
                return
            yield from _results(client, waiting[0])
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


def _results(client: Any, future: Any) -> list[RunResult]:
    """Wait for the results of one task; the scheduler repeats one whose worker died on another."""
    while True:
        try:
            results: list[RunResult] = future.result(timeout=LOOK_S)
            return results
        except TimeoutError:
            _n_threads(client)


def _n_threads(client: Any) -> int:
    """Count the threads of all workers; wait some time for the first of them."""
    if not client.nthreads():
        try:
            client.wait_for_workers(1, timeout=NO_WORKER_S)
        except TimeoutError:
            raise WorkerLost(f"the cluster has had no worker for {NO_WORKER_S:g} s; {_KEPT}") from None
    return sum(client.nthreads().values()) or 1
