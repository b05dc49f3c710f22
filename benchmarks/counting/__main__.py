"""The counters on simulated rigs, goal beside figure.

    python -m benchmarks.counting            # missing steps, then benchmarks/counting.md
    python -m benchmarks.counting --quick    # a fifth of the assemblies, to build/counting/quick.md
    python -m benchmarks.counting --only accuracy oracle     # some steps
    python -m benchmarks.counting --write    # the table from the stored results

Simulations, lobe maps and results are stored in ``build/counting``, so an interrupted run can be continued.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.counting import _designs as designs
from benchmarks.counting import _peers as peers
from benchmarks.counting import _pod as pod
from benchmarks.counting import _rows as rows
from benchmarks.counting._table import page
from benchmarks.counting._work import NOISES, Work

Step = tuple[str, Callable[[Work], Any]]


def steps() -> list[Step]:
    """Return all rows, the most important first."""
    judged = designs.JUDGED
    found: list[Step] = [
        (f"accuracy {rig}", lambda work, rig=rig, noise=noise: rows.accuracy(work, rig, noise, more=False))
        for rig in ("R1", "R0", "R2")
        for noise in NOISES
    ]  # type: ignore[misc]
    found += [
        ("control", lambda work: rows.shuffled(work, 0.2)),
        ("conformal", rows.conformal),
        ("transfer", lambda work: rows.transfer(work, "r0", [judged["R0"]], judged["R1"])),
        ("transfer", lambda work: rows.transfer(work, "braked", [designs.BRAKED], judged["R1"])),
        ("transfer", lambda work: rows.transfer(work, "finer", [judged["R1"]], designs.FINER)),
        ("transfer", lambda work: rows.transfer(work, "conservative", [judged["R1"]], designs.CONSERVATIVE)),
        ("transfer", lambda work: rows.conditions(work, "load", designs.LOADS)),
        ("transfer", lambda work: rows.conditions(work, "speed", designs.SPEEDS)),
        ("eight", rows.recordings),
        ("ninth", rows.ninth),
        ("lobes", rows.lobe_sets),
        ("lobes", rows.patterns),
        ("lobes", rows.neighbours),
        ("latency", rows.latency),
        *(("detection", lambda work, noise=noise: pod.detection(work, noise)) for noise in pod.NOISES),
    ]  # type: ignore[list-item]
    cells = [("R1", noise) for noise in NOISES] + [("R2", 0.2), ("R0", 0.2)]
    found += [
        ("peers", lambda work, key=key, rig=rig, noise=noise: peers.peer(work, key, rig, noise))
        for rig, noise in cells
        for key in peers.PEERS
    ]  # type: ignore[misc]
    found += [("oedi", lambda work, key=key: peers.load_levels(work, key)) for key in peers.LEVELS]  # type: ignore[misc]
    for rig in ("R2", "R0", "R1"):
        for noise in NOISES:
            found.append(("more", lambda work, r=rig, n=noise: rows.accuracy(work, r, n, more=True)))  # type: ignore[misc]
            found.append(("oracle", lambda work, r=rig, n=noise: rows.oracle(work, r, n)))  # type: ignore[misc]
    return found


def main() -> None:
    """Run the missing steps and write the table, the plan's table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", default="benchmarks/counting.md", help="file to write")
    parser.add_argument("--folder", default="build/counting", help="simulations and results")
    parser.add_argument("--jobs", type=int, default=2, help="processes that simulate")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--write", action="store_true", help="run nothing")
    parser.add_argument("--only", nargs="+", metavar="STEP", help="steps whose names begin so")
    arguments = parser.parse_args()
    work = Work(Path(arguments.folder), arguments.jobs, arguments.quick)
    failed = []
    for name, step in [] if arguments.write else steps():
        if arguments.only is None or name.startswith(tuple(arguments.only)):
            try:
                step(work)
            except FileNotFoundError as error:  # a peer's environment is missing
                failed.append(f"{name}: {error}")
    print("\n".join(failed))
    out = Path(arguments.folder) / "quick.md" if arguments.quick else Path(arguments.out)
    out.write_text(page(work), encoding="utf-8")
    if not arguments.quick and pod.done(work):
        pod.write_table(work, Path("cyclofeat/counting/tables/detection.csv"))
        pod.draw(work, Path("docs/figures/counting_detection.png"))
    print(f"written: {out}")


if __name__ == "__main__":
    main()
