"""Depth and count of early radial wear.

    python -m benchmarks.wear              # rig R1, writes benchmarks/wear.md
    python -m benchmarks.wear --rig R2     # writes benchmarks/wear_r2.md; some hours of one core, 14 GB

Simulated assemblies with radial wear on both wheels, five output turns at 500 RPM and 22 Nm, with a
tachometer. One model for each noise, trained on depths that are log-uniform, counts other assemblies.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from benchmarks._markdown import line, share, table
from benchmarks._versions import kept_in
from cyclofeat.counting import LobeCount, LobeModel
from cyclofeat.counting.model.radial_wear import lobe_lines_nm, runs_of
from cyclofeat.datasets import make_rig_recordings, rig_preset
from cyclofeat.recordings import Recording
from cyclofeat.recordings.windower import lobe_windower
from cyclofeat.simulators import Noise, Solver

RANGE_UM = (5.0, 200.0)
DEPTHS_UM = (20.0, 50.0, 100.0)
COUNTS = (2, 4)
# Noise in Nm is stated for 25.6 kHz; the simulation takes a quarter of that.
NOISES_NM = {"R1": (0.2, 0.02), "R2": (0.2,)}
STATED_HZ, RATE_HZ = 25_600.0, 6_400.0
TURNS = 5
N_TREES = 150
# Step of the depth for the derivative of the lobe lines.
STEP = 1.1
# Assemblies of each count in training.
PER_COUNT = {"R1": 48, "R2": 2000}
# Trees need few assemblies; the network learns more from many, and in more epochs.
COUNTERS: dict[str, dict[str, Any]] = {
    "R1": {"counter": "trees"}, "R2": {"counter": "rows", "epochs": 80}
}  # fmt: skip


@kept_in(Path("build/wear"))
def simulated(
    rig: str, n: int, counts: Sequence[int], wear_um: float | tuple[float, float], seed: int, n_jobs: int
) -> list[Recording]:
    """Return recordings without noise, at the lowest rate that their windows need."""
    return make_rig_recordings(
        n, counts, rig=rig_preset(rig).with_effects(Noise(0.0)), wheels=(0, 1), wear_um=wear_um,
        output_turns=1.01 * TURNS, sampling_rate=RATE_HZ, random_state=seed, n_jobs=n_jobs, with_angle=True,
        kernel="auto", solver=Solver(integrator="adams_bashforth"), keep=lobe_windower(15).at_lowest_rate,
    )  # fmt: skip


def noisy(recordings: Sequence[Recording], noise_nm: float, seed: int) -> list[Recording]:
    """Add noise of the same density as that of a torque meter at 25.6 kHz."""
    random = np.random.default_rng(seed)

    def with_noise(one: Recording) -> Recording:
        rms = noise_nm * np.sqrt(one.sampling_rate / STATED_HZ)
        return one.replace(torque=one.torque + random.normal(0, rms, one.n_samples))

    return [with_noise(one) for one in recordings]


@dataclass(frozen=True)
class Bound:
    """What a filter reaches that knows an assembly's torque for every count and depth: no method is better.

    Medians over assemblies: probability of telling n lobes from n + 1, and median error of the depth by the
    Cramer-Rao bound.
    """

    count: float
    depth: float


class Oracle:
    """Lobe lines of the same assemblies with different wear, without noise."""

    def __init__(self, rig: str, n: int, n_jobs: int) -> None:
        def lines(count: int, depth: float) -> NDArray[np.complex128]:
            twins = simulated(rig, n, [count], depth, 2, n_jobs)
            return np.concatenate([_lines(one) for one in twins])

        count = COUNTS[0]
        self.at = {depth: lines(count, depth) for depth in DEPTHS_UM}
        self.deeper = {depth: lines(count, STEP * depth) for depth in DEPTHS_UM}
        self.more = {depth: lines(count + 1, depth) for depth in DEPTHS_UM}

    def bound(self, depth: float, noise_nm: float) -> Bound:
        # Real and imaginary part of a line in n samples of white noise err by sqrt(2 / n) of it each.
        n = TURNS * 15 / (500 / 60) * STATED_HZ
        scatter = noise_nm * np.sqrt(2 / n)
        slope = np.linalg.norm(self.deeper[depth] - self.at[depth], axis=1) / np.log(STEP)
        apart = np.linalg.norm(self.more[depth] - self.at[depth], axis=1)
        return Bound(
            float(np.median(norm.cdf(apart / scatter / 2))),
            float(np.median(np.expm1(norm.ppf(0.75) * scatter / slope))),
        )


def _lines(recording: Recording) -> NDArray[np.complex128]:
    """Return the lobe lines of a recording in Nm, without those below the brake's drift."""
    windows = lobe_windower(15).windows([recording])
    return lobe_lines_nm(runs_of(windows.X, TURNS), 15).lines[:, 2:]


def row(
    head: list[str], recordings: Sequence[Recording], answers: Sequence[LobeCount], bound: Bound
) -> list[str]:
    n = len(recordings)
    right = sum(a.defect_count == r.defect_count for a, r in zip(answers, recordings, strict=True))
    seen = sum(a.defect_count > 0 for a in answers)
    refused = sum(a.refused for a in answers)
    pairs = [
        (r.meta["wear_um"], a.wear_um)
        for a, r in zip(answers, recordings, strict=True)
        if a.wear_um is not None and a.wear_um.depth_um is not None
    ]
    error = np.median([abs(depth.depth_um / true - 1) for true, depth in pairs]) if pairs else np.nan
    covered = np.mean([depth.low_um <= true <= depth.high_um for true, depth in pairs]) if pairs else np.nan
    width = np.median([depth.high_um / depth.low_um for _, depth in pairs]) if pairs else np.nan
    return [
        *head, share(right, n), f"{seen / n:.3f}", f"{refused / n:.3f}",
        f"{100 * error:.0f} %", f"{covered:.3f}", f"{width:.2f}", f"{bound.count:.3f}",
        f"{100 * bound.depth:.2g} %", str(n),
    ]  # fmt: skip


def rows(rig: str, n_judged: int, n_oracle: int, n_jobs: int) -> tuple[list[list[str]], list[str]]:
    """Return the rows of the table, and what each model says of itself."""
    made, said = [], []
    judged = {depth: simulated(rig, n_judged, COUNTS, depth, 1, n_jobs) for depth in DEPTHS_UM}
    healthy = simulated(rig, 2 * n_judged, [0], DEPTHS_UM[0], 3, n_jobs)
    oracle = Oracle(rig, n_oracle, n_jobs)
    for noise in NOISES_NM[rig]:
        training = noisy(simulated(rig, PER_COUNT[rig], range(8), RANGE_UM, 0, n_jobs), noise, 4)
        model = LobeModel(n_splits=0, n_trees=N_TREES, wear_um=RANGE_UM, random_state=0, **COUNTERS[rig]).fit(
            training
        )
        assert model.wear_ is not None
        answers = model.count_all(noisy(healthy, noise, 5))
        sound = np.mean([one.defect_count == 0 for one in answers])
        said.append(
            f"{rig}, {noise:g} Nm: {model.wear_.made_for()}; {sound:.3f} of {len(healthy)} healthy "
            "assemblies counted as healthy"
        )
        print(said[-1], flush=True)
        for k, depth in enumerate(DEPTHS_UM):
            answers = model.count_all(noisy(judged[depth], noise, 6 + k))
            head = [rig, f"{noise:g}", f"{depth:g}"]
            made.append(row(head, judged[depth], answers, oracle.bound(depth, noise)))
            print(line(made[-1]), end="", flush=True)
    return made, said


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rig", choices=list(PER_COUNT), default="R1", help="rig (default R1)")
    parser.add_argument("--judged", type=int, default=100, help="assemblies of each count and depth (100)")
    parser.add_argument("--twins", type=int, default=8, help="assemblies of the oracle (default 8)")
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    rig = arguments.rig
    options = ", ".join(f"{name}={value!r}" for name, value in COUNTERS[rig].items())
    made, said = rows(rig, arguments.judged, arguments.twins, arguments.jobs)
    head = [
        "rig", "noise (Nm)", "depth (um)", "count right", "seen", "refused", "median error of the depth",
        "90 % intervals that hold it", "their width (factor)", "bound: count", "bound: depth", "n",
    ]  # fmt: skip
    text = f"""# Depth and count of early radial wear, rig {rig}

Made by `python -m benchmarks.wear --rig {rig}`. Simulated assemblies at 500 RPM and 22 Nm with radial wear on
both wheels, {TURNS} output turns with a tachometer; white noise as of a torque meter at 25.6 kHz. Models are
trained on {PER_COUNT[rig]} assemblies of each count from 0 to 7 (`{options}`), with depths log-uniform from
{RANGE_UM[0]:g} to {RANGE_UM[1]:g} um; judged are others with {COUNTS[0]} and {COUNTS[1]} neighbouring
worn lobes. A model takes sound discs to be as frequent as it needs to count about 5 % of those in its
training as worn, by counters that have not seen them. "Count right" is of all, refused ones too (95 %
interval by Wilson; chance is 0.125). Depths and intervals are those of recordings that were neither refused
nor counted as healthy.

The bounds are those of a matched filter on the lobe lines that knows the torque of this very assembly for
every count and depth, so that noise is all that is unknown: the probability of telling {COUNTS[0]} worn
lobes from one more, and the median error of the depth by the Cramer-Rao bound (medians over
{arguments.twins} assemblies).

Goals: counts right 0.90 at 50 um and 0.97 at 100 um; a median error of 15 % at most; 85 to 95 % of the
intervals hold the depth.

"""
    models = "\n".join(f"- {one}" for one in said)
    ending = f"\nDepths that the models were trained for and see:\n\n{models}\n"
    path = Path(__file__).with_name("wear.md" if rig == "R1" else f"wear_{rig.lower()}.md")
    path.write_text(text + table(head, made) + ending, encoding="utf-8")


if __name__ == "__main__":
    main()
