"""The counter on simulated rigs, beside its goals and beside other methods.

    python -m benchmarks.counting            # writes benchmarks/counting.md, the plan's table and a figure
    python -m benchmarks.counting --quick    # 6 assemblies of each count, into build/counting

Results are stored in ``build/counting`` by the version of code and settings, so that an interrupted run
continues; results of another version are made again.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import joblib

from benchmarks._markdown import share, table, wilson
from benchmarks._versions import made_with
from benchmarks.counting import _cells as cells
from benchmarks.counting import _pod as pod
from benchmarks.counting._data import N_COUNTS
from benchmarks.counting._peers import PEERS
from cyclofeat._base.files import code_sha256, write_whole
from cyclofeat.gap.simulations import versions

# The simulators are in every version. Read at import, because files may change while a process works.
_FOLDER = Path(__file__).parent
CODE = versions("counting", "features", "signal", "recordings", "../datasets")
OWN = code_sha256(_FOLDER, sorted(_FOLDER.glob("_[!_]*.py")))  # all but what makes the page
GOALS = {
    "R1": {0.05: 0.99, 0.2: 0.98, 0.5: 0.96, 1.0: 0.92, 2.0: 0.85},
    "R2": {0.05: 0.92, 0.2: 0.88},
    "R0": {0.05: 0.995, 0.2: 0.97, 0.5: 0.75},
}
# Assemblies of each count: for the accuracy; for each cell of the methods; that train only; of each depth.
SIZES = (64, 32, 128, 20)
# Folders of page, table and figure.
WRITTEN = ("benchmarks", "cyclofeat/counting/tables", "docs/figures")
UNITS = {"output_torque": "Nm", "input_torque": "Nm", "motor_current": "A"}
HEAD = """# Counts of one window, beside other methods

Made by `make bench-counting` (`python -m benchmarks.counting`) in {minutes:.0f} minutes of one core. All
torque and current is **simulated** on assumed rigs: {n} assemblies of each rig, {each} of each
count from 0 to 7 (adjacent worn lobes, on one wheel or both), one window of one output turn each
(1.8 s at 500 RPM, 22 Nm); torque at 25.6 kHz, motor current at 8 kHz; 3 Nm rms drift of the load below
1.5 Hz, and white noise as stated. Chance is 0.125. Folds hold whole assemblies out; brackets are 95 %
intervals (Wilson). Counters are those of `make_lobe_counter`: lobe map and 300 trees, its default, and
`LobeCounter(kind="network")` ("rows"), which learns which lobes are worn too. They are trained at the
noise of the test, and count without a tachometer.

## Accuracy on output torque

"""
ORACLE = """
The oracle (`benchmarks/counting/_oracle.py`) knows rig, tolerances and noise: normal distributions of 42
complex lobe lines, one for each count on one or both wheels, estimated from the same other assemblies
that train the counters, with 15 poses marginalised. It uses means and covariances only, so it is no strict
bound. Goal on R0: never below the oracle. With the same assemblies the rows are below it at **{below}**.

## Other figures

"""
METHODS = """
## Other methods on the same windows and folds

{n} of such assemblies for each column, in three folds that all methods share: {trained} train. The
papers' methods ("A", "B") are followed by 100 trees of the same kind. pycatch22, tsfel and MiniRocket
receive the signal at about 2.56 kHz, to which the lobe map reduces it itself. Noise of a motor current
comes on top of its sensor's own.

"""


def tasks(n: int, n_each: int, n_twins: int, n_depth: int, aeon: Path) -> dict[str, Callable[[], Any]]:
    """Return what makes each result, from numbers of assemblies of each count."""
    made: dict[str, Callable[[], Any]] = {
        f"{rig} {quantity}, {n_each}": partial(cells.cells, rig, quantity, n_each, aeon)
        for quantity in UNITS
        for rig in GOALS
    }
    made |= {f"{rig}, {n}": partial(cells.accuracy, rig, n) for rig in GOALS}
    made |= {f"{rig} twins, {n}, {n_twins}": partial(cells.twins, rig, n, n_twins) for rig in ("R0", "R2")}
    made[f"detection, {n_depth}"] = partial(pod.detection, n_depth)
    return made | {f"checks, {n}": partial(cells.checks, n)}


def store(task: Callable[[], Any], path: Path) -> None:
    """Store the result of a task, with its processor time in s."""
    began = sum(os.times()[:4])
    result = {"found": task(), "seconds": sum(os.times()[:4]) - began}
    write_whole(path, lambda stream: stream.write(json.dumps(result, indent=1).encode()))
    print(f"{path.stem}: {result['seconds']:.0f} s", flush=True)


def judged(right: int, n: int, goal: float = 0.0) -> str:
    """Return the share of right ones with its interval, marked where it misses a goal."""
    return share(right, n) + (" **missed**" if right / n < goal else "")


def accuracy(found: Mapping[str, Any], n: int, n_twins: int) -> str:
    """Return the table of output torque, what is said of the oracle, and the table of other figures."""
    rows, below = [], []
    for rig, goals in GOALS.items():
        for noise in cells.NOISES["output_torque"]:
            key, goal = f"{noise:g}", goals.get(noise, 0.0)
            shown = [judged(found[rig][key], n, goal)]
            more = found.get(f"{rig} twins", {}).get(key, {})
            shown += [judged(more[one], n, goal) if more else "-" for one in (cells.TREES, cells.ROWS)]
            shown.append(share(more["oracle"], n) if more else "-")
            rows.append([f"{rig}, {key} Nm", f">= {goal:g}" if goal else "stated", *shown])
            if more and more[cells.ROWS] < more["oracle"]:
                certain = more[cells.ROWS] / n < wilson(more["oracle"], n)[0]
                below.append(f"{rig}, {key} Nm" + (" (beyond the oracle's interval)" if certain else ""))
    trained = [f"trees, of {n * 4 // 5} assemblies", f"trees, of {n_twins:,} others", "rows, of these"]
    text = table(["rig, noise", "goal", *trained, "oracle"], rows)
    of = found["checks"]
    others = [
        ["counts permuted among the assemblies (must be chance)", share(of["permuted"], n)],
        ["exactly the right lobes, by `LobeCounter` with a tachometer (goal >= 0.95)",
         judged(of["exact lobes"], n, 0.95)],
        [f"trained on {n} assemblies of R0, which has no brake", share(of["from R0"], n)],
    ]  # fmt: skip
    others = table(["rig R1, output torque, 0.2 Nm", "accuracy"], others)
    return text + ORACLE.format(below="; ".join(below) or "no noise") + others


def methods(found: Mapping[str, Any], n: int) -> str:
    """Return a table for each quantity, and in how many columns the counter is ahead."""
    parts, behind, n_columns = [METHODS.format(n=n, trained=n * 2 // 3)], [], 0
    for quantity, unit in UNITS.items():
        title = quantity.replace("_", " ").capitalize()
        columns = {
            f"{rig} {noise:g}": found[f"{rig} {quantity}"][f"{noise:g}"]
            for rig in GOALS
            for noise in cells.NOISES[quantity]
        }
        rows = [
            [name, *(f"{one[name] / n:.3f}" for one in columns.values())]
            for name in (cells.ROWS, cells.TREES, *PEERS)
        ]
        parts.append(f"### {title}\n\n{table([f'rig, noise in {unit}', *columns], rows)}\n")
        n_columns += len(columns)
        for name, one in columns.items():
            best = max(PEERS, key=one.__getitem__)
            if one[best] >= one[cells.ROWS]:
                behind.append(
                    f"\n- {title}, {name} {unit}: {best} {one[best] / n:.3f}, ours {one[cells.ROWS] / n:.3f}"
                )
    parts.append(
        "Goal: ahead of every other method in every column. The rows are ahead of all in "
        f"**{n_columns - len(behind)} of {n_columns}**{', but not in:' if behind else '.'}\n{''.join(behind)}"
    )
    return "".join(parts).rstrip() + "\n"


def main() -> None:
    """Make the missing results and write page, table and figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("build/counting"), help="results")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    sizes = (6, 6, 16, 6) if given.quick else SIZES
    aeon = given.folder.absolute() / "venv/bin/python"
    if not aeon.exists():
        parser.error(f"{aeon} is missing: MiniRocket needs an environment of its own (make bench-counting)")
    every = tasks(*sizes, aeon)
    home = given.folder / made_with(code=CODE, own=OWN)
    home.mkdir(parents=True, exist_ok=True)
    paths = {name: home / f"{name}.json" for name in every}
    missing = [name for name, path in paths.items() if not path.exists()]
    joblib.Parallel(given.jobs)(joblib.delayed(store)(every[name], paths[name]) for name in missing)
    kept = {name: json.loads(path.read_text(encoding="utf-8")) for name, path in paths.items()}
    found = {name.partition(",")[0]: one["found"] for name, one in kept.items()}
    n, n_each, n_twins = (N_COUNTS * size for size in sizes[:3])
    text = HEAD.format(minutes=sum(one["seconds"] for one in kept.values()) / 60, n=n, each=sizes[0])
    text += accuracy(found, n, n_twins) + methods(found, n_each)
    folders = [given.folder] * 3 if given.quick else [Path(one) for one in WRITTEN]
    (folders[0] / "counting.md").write_text(text, encoding="utf-8")
    pod.write_table(found["detection"], folders[1] / "detection.csv")
    pod.draw(found["detection"], folders[2] / "counting_detection.png")


if __name__ == "__main__":
    # Import by name, so that worker processes can unpickle their tasks.
    from benchmarks.counting import __main__ as by_name

    by_name.main()
