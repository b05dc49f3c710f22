"""Speeds that are found in the torque alone, with no tachometer and no stated speed.

    python -m benchmarks.speed_search     # writes benchmarks/speed_search.md

Simulated assemblies of rig R2 at speeds and loads of any kind, one output turn each.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from itertools import compress, repeat
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from benchmarks._markdown import share, table
from benchmarks.operating_points import LOADS, SPEEDS, TURNS, simulated, wandering
from cyclofeat.recordings import Recording
from cyclofeat.signal.speed import SEARCHED_HZ, FollowedSpeed, search_speed

SAME, SAME_IF_WANDERING = 0.02, 0.06  # of the true speed before it wanders
OUTCOMES = ("found", "asked", "wrong")


def outcome(found: Sequence[FollowedSpeed], true_hz: float | None, same: float) -> str:
    """Return whether the true speed was found, none or several were, or a wrong one."""
    if len(found) != 1:
        return "asked"
    right = true_hz is not None and abs(found[0].speed_hz / true_hz - 1) <= same
    return "found" if right else "wrong"


def noise(recording: Recording, random: np.random.Generator) -> Recording:
    """Return noise with a drift and hum in place of torque."""
    time_s = np.arange(recording.n_samples) / recording.sampling_rate
    torque = 22 + random.normal(0, 0.2, time_s.size) + 0.3 * np.sin(2 * np.pi * 50 * time_s)
    drift: NDArray[np.float64] = np.cumsum(random.normal(0, 0.01, time_s.size))
    return recording.replace(torque=torque + drift)


def searched(recording: Recording, true_hz: float | None, same: float) -> tuple[str, float]:
    """Return the outcome of a search, and its processor time in s."""
    began = time.process_time()
    found = search_speed(recording.torque, recording.sampling_rate)
    return outcome(found, true_hz, same), time.process_time() - began


def rows(n: int, n_jobs: int) -> list[list[str]]:
    """Return the rows of the table."""
    data = simulated(n, "output_torque", n_jobs, seed=7)
    recordings = [*data.training, *data.judged]
    true = [float(one.mean_input_speed() or 0) for one in recordings]
    random = np.random.default_rng(5)
    wander = [wandering(one, random) for one in recordings]
    empty = [noise(one, random) for one in recordings[: len(recordings) // 4]]
    calls = [delayed(searched)(*call) for call in zip(recordings, true, repeat(SAME))]
    calls += [delayed(searched)(*call) for call in zip(wander, true, repeat(SAME_IF_WANDERING))]
    calls += [delayed(searched)(one, None, SAME) for one in empty]
    found, spent = zip(*Parallel(n_jobs)(calls), strict=True)
    worn = np.array([bool(one.defect_count) for one in recordings])
    rpm = 60 * np.array(true)
    first, last = found[: len(recordings)], found[len(recordings) :]

    def row(what: str, some: Sequence[str]) -> list[str]:
        return [what, *(share(some.count(name), len(some)) for name in OUTCOMES), str(len(some))]

    parts = {"sound discs": ~worn} | {
        f"worn discs, {low} to {high:,} RPM": worn & (rpm >= low) & (rpm < high)
        for low, high in ((100, 250), (250, 600), (600, 1_500))
    }
    return [
        row("all", first),
        *(row(f"- {what}", [*compress(first, part)]) for what, part in parts.items()),
        row("all, speed wandering by 5 %", last[: len(recordings)]),
        row("noise, drift and hum alone", last[len(recordings) :]),
        ["processor time of a search, median in s", f"{np.median(spent):.2f}", "", "", str(len(spent))],
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--assemblies", type=int, default=24, help="per count (default 24)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/speed_search.md"))
    arguments = parser.parse_args()
    low, high = (60 * end for end in SEARCHED_HZ)
    text = f"""# Speeds found in the torque alone

Made by `python -m benchmarks.speed_search --assemblies {arguments.assemblies}`. Simulated
assemblies of rig R2 with counts of 0 to 7, speeds of {SPEEDS[0]:g} to {SPEEDS[1]:g} RPM and loads of
{LOADS[0]:g} to {LOADS[1]:g} Nm (log-uniform), 0.2 Nm of noise, {TURNS:g} output turns without a tachometer.
Speeds from {low:g} to {high:g} RPM are searched. "Found": one speed, within {100 * SAME:g} % of the true one
({100 * SAME_IF_WANDERING:g} % of its mean where it wanders); "asked": several speeds or none, so that a count
asks for it. 95 % intervals by Wilson.

"""
    made = rows(arguments.assemblies, arguments.jobs)
    page = text + table(["recordings", *OUTCOMES, "n"], made)
    arguments.out.write_text(page, encoding="utf-8")
    print(page)


if __name__ == "__main__":
    main()
