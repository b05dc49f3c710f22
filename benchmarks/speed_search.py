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
LONG = 3.1  # output turns
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


def true_hz(recording: Recording) -> float:
    """Return the mean speed by the tachometer, which the search does not look at."""
    return float(recording.mean_input_speed() or 0)


def rows(n: int, n_jobs: int) -> list[list[str]]:
    """Return the rows of the table."""

    def all_of(quantity: str, turns: float = TURNS) -> list[Recording]:
        return simulated(n, quantity, n_jobs, seed=7, turns=turns)

    recordings, random = all_of("output_torque"), np.random.default_rng(5)
    true = [*map(true_hz, recordings)]
    wander = [wandering(one, random) for one in recordings]
    empty = [noise(one, random) for one in recordings[: len(recordings) // 4]]
    long, at_input = all_of("output_torque", LONG), all_of("input_torque")
    cases = {
        "all": zip(recordings, true, repeat(SAME)),
        f"all, {LONG:g} output turns": zip(long, map(true_hz, long), repeat(SAME)),
        "all, speed wandering by 5 %": zip(wander, true, repeat(SAME_IF_WANDERING)),
        "input torque": zip(at_input, map(true_hz, at_input), repeat(SAME)),
        "noise, drift and hum alone": zip(empty, repeat(None), repeat(SAME)),
    }
    found: dict[str, list[str]] = {}
    spent: list[float] = []
    for name, calls in cases.items():
        outcomes, seconds = zip(*Parallel(n_jobs)(delayed(searched)(*call) for call in calls), strict=True)
        found[name] = [*outcomes]
        spent += seconds
    worn = np.array([bool(one.defect_count) for one in recordings])
    rpm = 60 * np.array(true)
    parts = {"sound discs": ~worn} | {
        f"worn discs, {low} to {high:,} RPM": worn & (rpm >= low) & (rpm < high)
        for low, high in ((100, 250), (250, 600), (600, 1_500))
    }
    of_parts = {f"- {what}": [*compress(found["all"], part)] for what, part in parts.items()}
    every = {"all": found.pop("all")} | of_parts | found
    return [
        *(
            [what, *(share(some.count(name), len(some)) for name in OUTCOMES), str(len(some))]
            for what, some in every.items()
        ),
        ["processor time of a search, median in s", f"{np.median(spent):.2f}", "", "", str(len(spent))],
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--assemblies", type=int, default=24, help="per count (default 24)")
    parser.add_argument("--jobs", type=int, default=2)
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
    Path(__file__).with_suffix(".md").write_text(page, encoding="utf-8")
    print(page)


if __name__ == "__main__":
    main()
