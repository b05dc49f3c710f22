"""What becomes of spoiled recordings of each quantity: counted right, refused, or counted wrong.

    python -m benchmarks.spoiled                 # writes benchmarks/spoiled.md
    python -m benchmarks.spoiled --model mine.skops --out mine.md    # of the model's quantity

The recordings are made once and stored in ``--folder``.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from benchmarks._markdown import table
from benchmarks.spoiled._kind import KINDS, LOAD_NM, NOISE_NM
from benchmarks.spoiled._run import (
    MISTAKEN,
    OUTCOMES,
    REFUSED,
    SPEEDS_RPM,
    SURE,
    UNSPOILED,
    WRONG,
    Found,
    all_outcomes,
    bases,
)
from cyclofeat.models import load_default_model, load_model

_GOALS = {"spoiled": {WRONG: 0.01, SURE: 6 / 2304}, "unspoiled": {REFUSED: 0.03}}


def page(found: Mapping[str, Found]) -> str:
    """Return the page on what was found of each quantity."""
    speeds = " and ".join(f"{speed:g}" for speed in SPEEDS_RPM)
    totals = []
    for quantity, cells in found.items():
        clean = cells[UNSPOILED.name, 0.0]
        spoiled = sum(cells.values(), Counter()) - clean
        totals += [_totals(quantity, "spoiled", spoiled), _totals(quantity, "unspoiled", clean)]
    n_bases = _total(spoiled) // sum(len(kind.strengths) for kind in KINDS.values())
    words = [quantity.replace("_", " ") for quantity in found]
    lines = [
        "# Spoiled recordings",
        "",
        "Made by `python -m benchmarks.spoiled`: **simulated** recordings of rig R2 with 0 to 7 worn lobes,",
        f"of three output turns at {speeds} RPM and {LOAD_NM:g} Nm with {NOISE_NM:g} Nm of noise, every",
        f"second one without a tachometer, spoiled in {len(KINDS)} ways in three strengths each, and counted",
        "by the packaged model of their quantity. Each kind spoils",
        f"{n_bases} of the {_total(clean)} recordings of a quantity.",
        "",
        f"Strengths in Nm, and the noise, are those of an output torque with a mean of {LOAD_NM:g} Nm. Every",
        "recording has them as the same share of its own mean: 1 Nm is about 1/15 Nm at the input, and that",
        "divided by the motor's torque constant in its current.",
        "",
        table(["", *OUTCOMES, "goals"], totals),
        f"Below, each cell holds for the {len(OUTCOMES) - 1} strengths the numbers of recordings that were",
        "counted right / refused / counted wrong and not refused / of the latter those with a probability",
        "above 0.9.",
        "",
    ]  # fmt: skip
    rows = []
    for kind in KINDS.values():
        strengths = ", ".join(f"{strength:.4g}" for strength in kind.strengths)
        of_quantities = [
            ", ".join(_cell(cells[kind.name, strength]) for strength in kind.strengths)
            for cells in found.values()
        ]
        rows.append([f"{kind.name}: {kind.text}", strengths, *of_quantities])
    return "\n".join(lines) + "\n" + table(["kind", "strengths", *words], rows)


def _cell(found: Counter[str]) -> str:
    return "/".join(str(found[name]) for name in OUTCOMES)


def _total(found: Counter[str]) -> int:
    # A surely wrong one counts as wrong too.
    return found.total() - found[SURE]


def _totals(quantity: str, name: str, found: Counter[str]) -> list[str]:
    total = _total(found)
    cells = [f"{found[outcome] / total:.1%}" for outcome in OUTCOMES]
    goals = [
        f"{outcome} <= {goal:.1%}{'' if found[outcome] <= goal * total else ' (missed)'}"
        for outcome, goal in _GOALS[name].items()
    ]
    return [f"{quantity.replace('_', ' ')}, {name} ({total})", *cells, "; ".join(goals)]


def main() -> None:
    """Count all, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/spoiled.md"), help="file to write")
    parser.add_argument("--folder", type=Path, default=Path("build/spoiled"), help="recordings")
    parser.add_argument("--model", type=Path, help="model file (default: the packaged ones)")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    arguments = parser.parse_args()
    mine = load_model(arguments.model) if arguments.model else None
    found = {}
    for quantity in MISTAKEN if mine is None else (mine.card["quantity"],):
        recordings = bases(arguments.folder, quantity, arguments.jobs)
        found[quantity] = all_outcomes(mine or load_default_model(quantity), recordings, arguments.jobs)
    text = page(found)
    arguments.out.write_text(text, encoding="utf-8")
    print("\n".join(line for line in text.splitlines() if "spoiled (" in line))
    print(f"written: {arguments.out}")


if __name__ == "__main__":
    main()
