"""Times of variants that are compared, on a machine that may be shared."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

import psutil

Work = Callable[[], object]
PATIENCE_S = 60.0  # to find both cores free


def processor_seconds(work: Work) -> float:
    """Return the processor time of one call."""
    began = time.process_time()
    work()
    return time.process_time() - began


def in_turn(works: Sequence[Work], repeats: int) -> list[list[float]]:
    """Processor seconds of each work, run alternately: shape (n_works, repeats)."""
    for work in works:
        work()
    rounds = [[processor_seconds(work) for work in works] for _ in range(repeats)]
    return [list(times) for times in zip(*rounds, strict=True)]


def ratio(slow: Sequence[float], fast: Sequence[float]) -> float:
    """Median of the ratios of pairs."""
    return statistics.median(a / b for a, b in zip(slow, fast, strict=True))


def each_of_family(read: Callable[[psutil.Process], float]) -> dict[int, float]:
    """A figure of this process and of each living descendant."""
    here, found = psutil.Process(), {}
    for process in (here, *here.children(recursive=True)):
        with suppress(psutil.Error):  # the process has ended
            found[process.pid] = read(process)
    return found


def family_seconds() -> dict[int, float]:
    """Processor time of this process and of each living descendant so far."""
    return each_of_family(lambda process: float(sum(process.cpu_times()[:2])))


def others_seconds() -> float:
    """Processor time that processes outside this family have taken so far."""
    machine = psutil.cpu_times()
    busy = machine.user + machine.nice + machine.system + machine.irq + machine.softirq + machine.steal
    return busy - sum(family_seconds().values())


def on_free_cores(alone: Work, shared: Work) -> str:
    """How many times faster ``shared`` is than ``alone``, in wall time, while both cores are free.

    Runs in which other processes used more than a tenth of a core are discarded: two workers are no faster
    than one if the second core is in use.
    """
    walls: tuple[list[float], list[float]] = ([], [])
    given_up = time.perf_counter() + PATIENCE_S
    alone(), shared()  # the first starts the workers
    while min(map(len, walls)) < 9 and time.perf_counter() < given_up:
        for work, undisturbed in zip((alone, shared), walls, strict=True):
            others, began = others_seconds(), time.perf_counter()
            work()
            wall = time.perf_counter() - began
            if others_seconds() - others < 0.1 * wall:
                undisturbed.append(wall)
    if min(map(len, walls)) < 3:
        return "not measured: the machine was busy"
    return f"{statistics.median(walls[0]) / statistics.median(walls[1]):.2f} x faster"
