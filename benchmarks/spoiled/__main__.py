"""What becomes of spoiled recordings: counted right, refused, or counted wrong.

    python -m benchmarks.spoiled                 # some minutes on two cores; writes benchmarks/spoiled.md
    python -m benchmarks.spoiled --model mine.skops --out mine.md

The default model and the recordings are made once and stored in ``--folder``.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from benchmarks._markdown import table
from benchmarks.spoiled._kind import KINDS, NOISE_NM, Base
from benchmarks.spoiled._run import (
    OUTCOMES,
    REFUSED,
    SPEEDS_RPM,
    SURE,
    UNSPOILED,
    WRONG,
    all_outcomes,
    bases,
    model,
)

_GOALS = {"spoiled": {WRONG: 0.02, SURE: 0.003}, "unspoiled": {REFUSED: 0.03}}


def page(found: Mapping[tuple[str, float], Counter[str]]) -> str:
    """Return the page."""
    clean = found[UNSPOILED.name, 0.0]
    spoiled = sum(found.values(), Counter()) - clean
    n_bases = (spoiled.total() - spoiled[SURE]) // sum(len(kind.strengths) for kind in KINDS.values())
    speeds = ", ".join(f"{speed:g}" for speed in SPEEDS_RPM)
    lines = [
        "# Spoiled recordings",
        "",
        f"Made by `python -m benchmarks.spoiled`: {n_bases} **simulated** recordings of rig R2 with 0 to 7",
        f"worn lobes, of three output turns at {speeds} RPM with {NOISE_NM:g} Nm of noise, every second",
        f"one without a tachometer, spoiled in {len(KINDS)} ways in three strengths each, and counted by the",
        "default model.",
        "",
        table(["", *OUTCOMES, "goals"], [_totals("spoiled", spoiled), _totals("unspoiled", clean)]),
        "Below, each cell holds the numbers of recordings that were counted right, refused, counted wrong",
        "and not refused, and of the latter those with a probability above 0.9.",
        "",
    ]
    rows = []
    for kind in KINDS.values():
        cells = [_cell(found[kind.name, strength]) for strength in kind.strengths]
        strengths = ", ".join(f"{strength:.4g}" for strength in kind.strengths)
        rows.append([f"{kind.name}: {kind.text}", strengths, *cells])
    return "\n".join(lines) + "\n" + table(["kind", "strengths", "weak", "medium", "strong"], rows)


def _cell(found: Counter[str]) -> str:
    return " / ".join(str(found[name]) for name in OUTCOMES)


def _totals(name: str, found: Counter[str]) -> list[str]:
    total = sum(found.values()) - found[SURE]
    cells = [f"{found[outcome] / total:.1%}" for outcome in OUTCOMES]
    goals = [
        f"{outcome} <= {goal:.1%}{'' if found[outcome] <= goal * total else ' (missed)'}"
        for outcome, goal in _GOALS[name].items()
    ]
    return [f"{name} ({total})", *cells, "; ".join(goals)]


def main() -> None:
    """Count all, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/spoiled.md"), help="file to write")
    parser.add_argument("--folder", type=Path, default=Path("build/spoiled"), help="model and recordings")
    parser.add_argument("--model", type=Path, help="model file (default: that of cyclofeat train)")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    counter = model(arguments.folder, arguments.model)
    starts: list[Base] = bases(arguments.folder, arguments.jobs)
    found = all_outcomes(counter, starts, arguments.jobs)
    text = page(found)
    arguments.out.write_text(text, encoding="utf-8")
    print("\n".join(line for line in text.splitlines() if "spoiled (" in line))
    print(f"written: {arguments.out}")


if __name__ == "__main__":
    main()
