"""Cost of a campaign: speed, memory, time outside the kernel. ``make bench-campaign`` writes the table.

The machine may be shared, so costs are given in processor time; runs per second use wall time.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import joblib
import psutil
from threadpoolctl import threadpool_limits

from cyclofeat.simulators import (
    Campaign,
    GearboxParameter,
    Hum,
    Machine,
    Noise,
    Quantisation,
    Rig,
    _kernels,
    courses,
    run_campaign,
    simulation,
)

N_JOBS = 2
PROFILED_RUNS = 32
COMPARED_RUNS = 32
ROUNDS = 3
HEADING = "## Outside the kernel"
RIG = Rig.r1().with_effects(
    GearboxParameter("load_torque", (15.0, 25.0)), Noise((0.05, 0.5)), Hum((0.05, 0.3)), Quantisation(0.05)
)
DESIGN = Campaign(
    name="bench",
    rig=RIG,
    repeats=125,
    depth=(0.3, 1.0),
    duration=2.0,
)


def family() -> list[psutil.Process]:
    """This process and its child processes."""
    here = psutil.Process()
    return [here, *here.children(recursive=True)]


def each(read: Callable[[psutil.Process], float]) -> dict[int, float]:
    """A figure of every running process of the family."""
    found = {}
    for process in family():
        try:
            found[process.pid] = read(process)
        except psutil.Error:
            continue
    return found


class Watch(threading.Thread):
    """Peak memory (shared pages counted once) and processor time of the whole family of processes."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.peak = 0.0
        self.cpu: dict[int, float] = {}
        self._before = each(_cpu)
        self._end = threading.Event()

    def run(self) -> None:
        while not self._end.wait(0.5):
            self.look()

    def look(self) -> None:
        self.peak = max(self.peak, sum(each(lambda process: process.memory_full_info().pss).values()))
        self.cpu |= each(_cpu)

    def stop(self) -> float:
        """Processor time in s since the start."""
        self.look()
        self._end.set()
        self.join()
        return sum(self.cpu.values()) - sum(self._before.values())


def _cpu(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


@contextmanager
def timed(owner: Any, name: str) -> Iterator[list[float]]:
    """Measure the processor time of a function's calls within the block."""
    real, spent = getattr(owner, name), [0.0]

    def timing(*args: Any, **kwargs: Any) -> Any:
        began = time.thread_time()
        try:
            return real(*args, **kwargs)
        finally:
            spent[0] += time.thread_time() - began

    setattr(owner, name, timing)
    try:
        yield spent
    finally:
        setattr(owner, name, real)


# Parts of a run outside the kernel, with the functions that do them.
OUTSIDE: dict[str, tuple[Any, str]] = {
    "anti-alias filter of the torque, from 100 kHz": (simulation, "resample_poly"),
    "speed and angle of the drive on half steps (200 kHz)": (courses, "_drive"),
    "load with its drift on half steps": (courses, "_load"),
    "drawing the drift": (Machine, "fluctuations"),
    "effects, noise and copies of the channels": (Machine, "measured"),
}


def shares() -> dict[str, float]:
    """Shares of the processor time outside the kernel, in one process; the first is their total."""
    campaign = DESIGN.replace(repeats=PROFILED_RUNS // 8, runs_per_shard=PROFILED_RUNS)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        run_campaign(campaign.replace(repeats=1, duration=0.05), Path(folder) / "compiled")
        kernel = stack.enter_context(timed(_kernels, "integrate"))
        simulator = stack.enter_context(timed(Rig, "simulate"))
        parts = {what: stack.enter_context(timed(*where)) for what, where in OUTSIDE.items()}
        began = time.process_time()
        run_campaign(campaign, Path(folder) / "profiled")
        total = time.process_time() - began
    found = {what: spent[0] / total for what, spent in parts.items()}
    found["the campaign itself: designs, rows, digests, files"] = 1 - simulator[0] / total
    outside = 1 - kernel[0] / total
    return {"outside the kernel": outside, **found, "the rest": outside - sum(found.values())}


def runs_per_second(backend: str) -> float:
    """Measure runs on two workers of a kind that have already started."""
    campaign = DESIGN.replace(repeats=COMPARED_RUNS // 8)
    with tempfile.TemporaryDirectory() as folder, joblib.parallel_config(backend=backend):
        run_campaign(campaign.replace(repeats=1, duration=0.05), Path(folder) / "started", n_jobs=N_JOBS)
        began = time.perf_counter()
        run_campaign(campaign, Path(folder) / "out", n_jobs=N_JOBS)
        return campaign.n_runs / (time.perf_counter() - began)


def shares_text() -> str:
    """Return the shares of the processor time outside the kernel as Markdown."""
    found = shares()
    rows = [f"| {what} | {100 * share:.1f} % |" for what, share in found.items()]
    return (
        "\n".join(
            [
                f"{HEADING}\n",
                f"Shares of the processor time of {PROFILED_RUNS} runs in one process; goal: 10 % outside",
                "the kernel (`python benchmarks/campaign.py --shares`):\n",
                "| what | share |",
                "|---|---|",
                *rows,
            ]
        )
        + "\n"
    )


def table(n_runs: int) -> str:
    """Return the results as a Markdown table."""
    rates: dict[str, list[float]] = {"loky": [], "threading": []}
    for _ in range(ROUNDS):
        for backend, found in rates.items():
            found.append(runs_per_second(backend))
    campaign = DESIGN.replace(repeats=n_runs // 8)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        watch = Watch()
        watch.start()
        began = time.perf_counter()
        run_campaign(campaign, out, n_jobs=N_JOBS)
        wall = time.perf_counter() - began
        cpu = watch.stop()
        n_bytes = sum(path.stat().st_size for path in out.iterdir())
    per_run, bytes_per_run = cpu / campaign.n_runs, n_bytes / campaign.n_runs
    processes, threads = (statistics.median(rates[backend]) for backend in ("loky", "threading"))
    rows = [
        (f"{N_JOBS} processes, started before", f"{campaign.n_runs / wall:.2f} runs/s"),
        ("processor time per run, all processes", f"{per_run:.3f} s"),
        (f"so, with {N_JOBS} cores to itself", f"{N_JOBS / per_run:.2f} runs/s"),
        ("peak memory, all processes", f"{watch.peak / 2**30:.2f} GiB"),
        ("size on disk per run", f"{bytes_per_run / 1e3:.1f} kB"),
        (f"{N_JOBS} processes, started before ({COMPARED_RUNS} runs)", f"{processes:.2f} runs/s"),
        (f"{N_JOBS} threads ({COMPARED_RUNS} runs, in turn with those)", f"{threads:.2f} runs/s"),
        ("1,000,000 such runs: core hours", f"{per_run * 1e6 / 3600:.0f}"),
        ("1,000,000 such runs: on disk", f"{bytes_per_run * 1e6 / 1e9:.0f} GB"),
    ]
    head = (
        f"{campaign.n_runs} runs of rig {RIG.name} with hum and quantisation, records of "
        f"{DESIGN.duration:g} s at {DESIGN.sampling_rate:g} Hz, 0 to 7 worn lobes. The machine has "
        f"{os.cpu_count()} cores and a load of {os.getloadavg()[0]:.1f} at the end, {N_JOBS} of it the "
        "benchmark's own. If other programs run too, compare processor time, not runs per second.\n"
    )
    lines = [head, "| what | result |", "|---|---|"]
    return "\n".join(lines + [f"| {name} | {value} |" for name, value in rows]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000, help="a multiple of 8 (default 1000)")
    parser.add_argument("--shares", action="store_true", help="print only the time outside the kernel")
    parser.add_argument("--out", type=Path, help="also write the table to this file")
    arguments = parser.parse_args()
    with threadpool_limits(1):
        outside = shares_text()
        result = "" if arguments.shares else table(arguments.runs)
    print(result + outside, end="")
    if arguments.out is None:
        return
    if arguments.shares:
        result = arguments.out.read_text().partition(HEADING)[0]
    else:
        result = f"Made by `make bench-campaign RUNS={arguments.runs}`.\n\n{result}\n"
    arguments.out.write_text(result + outside)


if __name__ == "__main__":
    main()
