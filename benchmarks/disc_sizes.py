"""Counts of gearboxes with other numbers of lobes, by a model trained on simulated discs of that size.

    python -m benchmarks.disc_sizes     # writes benchmarks/disc_sizes.md

Rigs R1 and R2 with another number of pins, and so of lobes; the other dimensions are the papers'. Whole
assemblies are held out as in ``benchmarks.operating_points``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks._markdown import line, table
from benchmarks.operating_points import Data, counted, trained
from benchmarks.sampling_rates import right
from cyclofeat.datasets import make_rig_recordings, rig_preset
from cyclofeat.simulators import Noise, Solver

LOBES = (11, 15, 21)
RIGS = ("R1", "R2")
GOAL = 0.93


def simulated(n: int, rig: str, n_lobes: int, n_jobs: int) -> Data:
    """Simulate assemblies of a rig whose discs have so many lobes, at 500 RPM and 22 Nm."""
    preset = rig_preset(rig).with_effects(Noise(0.2))
    resized = preset.replace(gearbox=preset.gearbox.replace(n_pins=n_lobes + 1))
    made = make_rig_recordings(
        n, rig=resized, speed_rpm=500.0, load_nm=22.0, output_turns=1.05, random_state=3, n_jobs=n_jobs,
        with_angle=True, kernel="auto", solver=Solver(integrator="adams_bashforth"),
    )  # fmt: skip
    return Data(made)


def row(rig: str, n_lobes: int, data: Data) -> list[str]:
    answers = counted(trained(data.training), data.judged)
    pairs = list(zip(data.judged, answers, strict=True))
    located = sum(a is not None and a.lobes == r.worn_lobes for r, a in pairs) / len(pairs)
    return [rig, str(n_lobes), right(data.judged, answers), f"{located:.3f}", str(len(pairs))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--assemblies", type=int, default=32, help="per count (default 32)")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    head = ["rig", "lobes", f"right (goal {GOAL:g}), refused", "exactly the right lobes", "n"]
    made: list[list[str]] = []
    for rig in RIGS:
        for n_lobes in LOBES:
            data = simulated(arguments.assemblies, rig, n_lobes, arguments.jobs)
            made.append(row(rig, n_lobes, data))
            print(line(made[-1]), end="", flush=True)
    text = f"""# Other numbers of lobes

Made by `python -m benchmarks.disc_sizes --assemblies {arguments.assemblies}`. Simulated
output torque at 500 RPM and 22 Nm with 0.2 Nm of noise, counts of 0 to 7, chance 0.125; the rigs' gearboxes
with other numbers of lobes on their discs. One model for each row, trained on three quarters of the
assemblies, which counts one window of one output turn of each of the others. "Right" is the share of all
recordings whose count is right, refused ones too (95 % interval by Wilson), then the share refused.

"""
    Path(__file__).with_suffix(".md").write_text(text + table(head, made), encoding="utf-8")


if __name__ == "__main__":
    main()
