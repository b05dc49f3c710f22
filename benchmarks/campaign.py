"""Cost of a campaign: speed, memory, time outside the kernel. ``make bench-campaign`` writes the table.

The machine may be shared, so costs are given in processor time; runs per second use wall time.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
from _markdown import table
from _timing import each_of_family, family_seconds
from threadpoolctl import threadpool_limits

from cyclofeat.simulators import (
    Campaign,
    GearboxParameter,
    Hum,
    Noise,
    Quantisation,
    Rig,
    _kernels,
    run_campaign,
    simulation,
)
from cyclofeat.simulators.batch import runs as batch_runs
from cyclofeat.simulators.batch.runs import n_lanes
from cyclofeat.simulators.campaign import _folder
from cyclofeat.simulators.courses import DriveAndLoad
from cyclofeat.simulators.machine import Machine, MachineRun

N_JOBS = 2
PROFILED_RUNS = 64
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
FAST = "batch, Adams-Bashforth"
DESIGNS = {
    "exact": DESIGN.replace(kernel="exact"),
    "batch": DESIGN.replace(kernel="batch"),
    FAST: DESIGN.replace(kernel="batch", integrator="adams_bashforth"),
}


class Watch(threading.Thread):
    """Peak memory (shared pages counted once) and processor time of the whole family of processes."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.peak = 0.0
        self.cpu: dict[int, float] = {}
        self.before = family_seconds()
        self._end = threading.Event()

    def run(self) -> None:
        while not self._end.wait(0.5):
            self.look()

    def look(self) -> None:
        self.peak = max(
            self.peak, sum(each_of_family(lambda process: process.memory_full_info().pss).values())
        )
        self.cpu |= family_seconds()

    def stop(self) -> float:
        """Processor time in s since the start."""
        self.look()
        self._end.set()
        self.join()
        return sum(self.cpu.values()) - sum(self.before.values())


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


KERNEL: dict[str, tuple[Any, str]] = {
    "exact": (_kernels, "integrate"),
    "batch": (batch_runs, "integrate_batch"),
}
# Parts of a run outside the kernel, with the functions that do them.
OUTSIDE: dict[str, tuple[Any, str]] = {
    "speed and angle of the drive at every evaluation": (DriveAndLoad, "_drive"),
    "load with its drift at every evaluation": (DriveAndLoad, "_torque"),
    "drive and load into the lanes": (batch_runs, "fill_drive"),
    "anti-alias filter of the torque, from 100 kHz (exact)": (simulation, "resample_poly"),
    "the same for all lanes (batch)": (batch_runs.Samples, "take"),
    "drawing the machine": (Machine, "drawn"),
    "drawing the drift": (Machine, "fluctuations"),
    "effects, noise and copies of the channels": (MachineRun, "record"),
}


def warm_up(campaign: Campaign, folder: Path, n_jobs: int = 1) -> None:
    """Compile, and start the workers."""
    run_campaign(campaign.replace(repeats=4 * n_jobs, duration=0.05), folder, n_jobs=n_jobs)


def shares(campaign: Campaign) -> dict[str, float]:
    """Shares of the processor time outside the kernel, in one process; the first is their total."""
    campaign = campaign.replace(repeats=PROFILED_RUNS // 8)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        warm_up(campaign, Path(folder) / "compiled")
        inside = stack.enter_context(timed(*KERNEL[campaign.kernel]))
        runs = stack.enter_context(timed(_folder, "simulate_runs"))
        parts = {what: stack.enter_context(timed(*where)) for what, where in OUTSIDE.items()}
        began = time.process_time()
        run_campaign(campaign, Path(folder) / "profiled")
        total = time.process_time() - began
    found = {what: spent[0] / total for what, spent in parts.items()}
    found["the campaign itself: designs, digests, files"] = 1 - runs[0] / total
    outside = 1 - inside[0] / total
    return {"outside the kernel": outside, **found, "the rest": outside - sum(found.values())}


def shares_text() -> str:
    """Return the shares of the processor time outside the kernel as Markdown."""
    made = [shares(campaign) for campaign in DESIGNS.values()]
    rows = [[what, *(f"{100 * one[what]:.1f} %" for one in made)] for what in made[0]]
    text = (
        f"Shares of the processor time of {PROFILED_RUNS} runs in one process; goal: 25 % of a batch's time "
        "(`python benchmarks/campaign.py --shares`):"
    )
    return f"## Outside the kernel\n\n{text}\n\n{table(['what', *DESIGNS], rows)}"


@dataclass(frozen=True)
class Cost:
    """Cost of one campaign, per run by default."""

    rate: float  #: runs/s
    cpu: float  #: processor time of all processes in s
    writer: float  #: that of this process, which writes
    peak: float  #: memory of all processes together in GiB
    disk: float  #: bytes


def cost(campaign: Campaign, n_jobs: int, backend: str = "loky") -> Cost:
    """Measure a campaign on workers that have started before."""
    with tempfile.TemporaryDirectory() as folder, joblib.parallel_config(backend=backend):
        warm_up(campaign, Path(folder) / "started", n_jobs)
        watch = Watch()
        watch.start()
        began = time.perf_counter()
        run_campaign(campaign, Path(folder) / "out", n_jobs=n_jobs)
        wall = time.perf_counter() - began
        began_writer, cpu = watch.before[os.getpid()], watch.stop()
        writer = watch.cpu[os.getpid()] - began_writer
        n_bytes = sum(path.stat().st_size for path in (Path(folder) / "out").iterdir())
    n = campaign.n_runs
    return Cost(n / wall, cpu / n, writer / n, watch.peak / 2**30, n_bytes / n)


def costs(n_runs: int) -> str:
    """Return the results as a Markdown table."""
    # The exact kernel takes about as long for a quarter of the runs.
    n_repeats = {name: n_runs // (32 if name == "exact" else 8) for name in DESIGNS}
    designs = {name: campaign.replace(repeats=n_repeats[name]) for name, campaign in DESIGNS.items()}
    fast = f"{FAST}, "
    # Processes last: their workers stay, and their memory with them.
    alone = {fast + "1 process": cost(designs[FAST], 1)}
    threads = {fast + f"{N_JOBS} threads": cost(designs[FAST], N_JOBS, "threading")}
    processes = {f"{name}, {N_JOBS} processes": cost(one, N_JOBS) for name, one in designs.items()}
    measured = processes | threads | alone
    rows = [
        ["runs/s", *(f"{one.rate:.1f}" for one in measured.values())],
        ["processor time per run", *(f"{1e3 * one.cpu:.0f} ms" for one in measured.values())],
        ["of it in this process", *(f"{1e3 * one.writer:.1f} ms" for one in measured.values())],
        ["peak memory, all processes", *(f"{one.peak:.2f} GiB" for one in measured.values())],
        ["1,000,000 such runs: core hours", *(f"{one.cpu * 1e6 / 3600:.1f}" for one in measured.values())],
        ["1,000,000 such runs: on disk", *(f"{one.disk / 1e3:.0f} GB" for one in measured.values())],
    ]
    head = (
        f"{n_runs} runs (a quarter with the exact kernel) of {RIG.name} with hum and quantisation, "
        f"records of {DESIGN.duration:g} s at {DESIGN.sampling_rate:g} Hz, 0 to 7 worn lobes, {n_lanes()} in "
        "a batch. Workers have started before; everything else is counted, the disk too. The machine has "
        f"{os.cpu_count()} cores and a load of {os.getloadavg()[0]:.1f} at the end, {N_JOBS} of it the "
        "benchmark's own at most. If other programs run too, compare processor time, not runs per second.\n"
    )
    return f"{head}\n{table(['what', *measured], rows)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=512, help="a multiple of 32 (default 512)")
    parser.add_argument("--shares", action="store_true", help="print only the time outside the kernel")
    arguments = parser.parse_args()
    with threadpool_limits(1):
        outside = shares_text()
        if arguments.shares:
            print(outside, end="")
            return
        made = f"Made by `make bench-campaign RUNS={arguments.runs}`."
        text = f"{made}\n\n{costs(arguments.runs)}\n{outside}"
    print(text, end="")
    Path(__file__).with_suffix(".md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
