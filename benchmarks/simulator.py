"""Speed of the simulator, as ratios within one run. ``make bench-simulator`` writes the table next to it.

Everything runs on one core with one BLAS thread; each figure is the median of several repeats, the pair
compared taken in turn.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from cyclofeat.simulators import CycloidalGearbox, LobeDefects, simulate
from cyclofeat.simulators.reference import ReferenceGearbox, ramped_driver, ramped_load

SIMULATED_S = 0.6
DT = 1e-5
REPEATS = 9
REFERENCE_STEPS = 50


def seconds(work: Callable[[], object]) -> float:
    """Processor time of one call: the machine may be shared."""
    began = time.process_time()
    work()
    return time.process_time() - began


def real_time_factor(
    gearbox: CycloidalGearbox, defects: LobeDefects, simulated_s: float = SIMULATED_S
) -> float:
    """Simulated over processor time."""
    simulate(gearbox, defects, duration=0.01, dt=DT)
    taken = [seconds(lambda: simulate(gearbox, defects, duration=simulated_s, dt=DT)) for _ in range(REPEATS)]
    return simulated_s / statistics.median(taken)


def times_faster_than_the_papers(defects: LobeDefects) -> float:
    """Per step, against the papers' formulation: a dense 141 x 141 solve per stage."""
    reference = ReferenceGearbox(worn_lobes=(defects.worn_lobes, defects.worn_lobes))
    start = np.concatenate([reference.rest_angles(0.0), np.zeros(3)])
    driver, load = ramped_driver(), ramped_load()
    ratios = []
    for _ in range(3):
        slow = seconds(lambda: reference.integrate(0.0, REFERENCE_STEPS * DT, DT, start, driver, load))
        fast = seconds(lambda: simulate(None, defects, duration=SIMULATED_S, dt=DT))
        ratios.append(slow / REFERENCE_STEPS / (fast / (SIMULATED_S / DT)))
    return statistics.median(ratios)


def table() -> str:
    """The results as a Markdown table."""
    steel = CycloidalGearbox.steel()
    braked = steel.with_brake(0.02, 1e4, 0.02)
    worn = LobeDefects.worn(7)
    rows = [
        ("healthy", f"{real_time_factor(steel, LobeDefects.healthy()):.1f} x real time"),
        ("7 worn lobes on both wheels", f"{real_time_factor(steel, worn):.1f} x real time"),
        ("7 worn lobes, brake behind torque meter", f"{real_time_factor(braked, worn):.1f} x real time"),
        ("7 worn lobes, 2.4 s simulated", f"{real_time_factor(steel, worn, 2.4):.1f} x real time"),
        (
            "7 worn lobes, against the papers' dense solve",
            f"{times_faster_than_the_papers(worn):.0f} x faster",
        ),
    ]
    lines = ["| run (dt = 1e-5 s, 48 contacts, one core) | result |", "|---|---|"]
    return "\n".join(lines + [f"| {name} | {value} |" for name, value in rows]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="also write the table to this file")
    arguments = parser.parse_args()
    with threadpool_limits(1):
        result = table()
    print(result, end="")
    if arguments.out is not None:
        arguments.out.write_text(f"Made by `make bench-simulator`.\n\n{result}")


if __name__ == "__main__":
    main()
