"""Counts of gearboxes with other numbers of lobes, by a model trained on simulated discs of that size.

    python -m benchmarks.disc_sizes     # writes benchmarks/disc_sizes.md

Rigs R1 and R2 with another number of pins, and so of lobes; the other dimensions are the papers'. Trees know
R1 from few assemblies; on R2, whose brake is not known, a counter of rows learns more from many.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks._markdown import line, table
from benchmarks.operating_points import Data, counted
from benchmarks.sampling_rates import right
from cyclofeat.counting import LobeModel
from cyclofeat.datasets import make_rig_recordings, rig_preset
from cyclofeat.simulators import Noise, Solver

LOBES = (11, 15, 21)
# Counter of each rig, and assemblies of each count, of which a quarter is judged.
RIGS = {"R1": ("trees", 32), "R2": ("rows", 256)}
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


def row(rig: str, n_lobes: int, n_jobs: int) -> list[str]:
    counter, n = RIGS[rig]
    data = simulated(n, rig, n_lobes, n_jobs)
    model = LobeModel(n_splits=0, counter=counter, random_state=0).fit(data.training)
    answers = counted(model, data.judged)
    pairs = list(zip(data.judged, answers, strict=True))
    located = sum(a is not None and a.lobes == r.worn_lobes for r, a in pairs) / len(pairs)
    learned = f"{counter}, {n * 3 // 4}"
    return [rig, str(n_lobes), learned, right(data.judged, answers), f"{located:.3f}", str(len(pairs))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    head = [
        "rig", "lobes", "counter, assemblies of each count", f"right (goal {GOAL:g}), refused",
        "exactly the right lobes", "n",
    ]  # fmt: skip
    made: list[list[str]] = []
    for rig in RIGS:
        for n_lobes in LOBES:
            made.append(row(rig, n_lobes, arguments.jobs))
            print(line(made[-1]), end="", flush=True)
    text = """# Other numbers of lobes

Made by `python -m benchmarks.disc_sizes`. Simulated output torque at 500 RPM and 22 Nm with 0.2 Nm of noise,
counts of 0 to 7, chance 0.125; the rigs' gearboxes with other numbers of lobes on their discs. One model for
each row, which counts one window of one output turn of each of n other assemblies. "Right" is the share of
all recordings whose count is right, refused ones too (95 % interval by Wilson), then the share refused.

"""
    Path(__file__).with_suffix(".md").write_text(text + table(head, made), encoding="utf-8")


if __name__ == "__main__":
    main()
