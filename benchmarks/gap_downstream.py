"""What the corrected simulators are worth to a counter: ``python -m benchmarks.gap_downstream``.

For each case of the subset of which ``python -m benchmarks.gap`` has found the effects: the toolkit's counter
is trained on the model as it was, on the corrected one and on the true one, and counts recordings that the
generator of the hidden effects makes anew. Where the model as it was teaches nearly all there is to gain, no
gain is left to share. Results are added to those of ``benchmarks.gap``; the score is written to
``benchmarks/gap_downstream.md``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._versions import made_with, told_of_versions
from benchmarks.gap import SAMPLING_RATE, SUBSET, each_told, write_result
from benchmarks.hidden_effects._cases import case_names, make_recordings, truth
from cyclofeat.gap import downstream_gain
from cyclofeat.simulators import CompositeSimulator, effect_library

PAGE = Path(__file__).with_name("gap_downstream.md")
COUNTS = tuple(range(8)) * 6
PART = 2  # of a case's random numbers: 0 and 1 are the recordings that the workflow was given
N_PER_CLASS = 24
ALL_BUT = 0.95  # accuracy from which a gain over the model as it was would be chance


def composite(effects: list[dict[str, Any]]) -> CompositeSimulator:
    """The model with effects as results and truth state them."""
    library = effect_library()
    return CompositeSimulator(effects=[library[one["id"]](**one["theta"]) for one in effects])


def gain(name: str, results: Path, cache: Path) -> str:
    """Add what the corrected model is worth to the result of a case."""
    result = json.loads((results / f"{name}.json").read_text(encoding="utf-8"))
    X, y = make_recordings(name, PART, COUNTS), np.array(COUNTS)
    common: dict[str, Any] = {"n_per_class": N_PER_CLASS, "cache": cache}
    plain = downstream_gain(None, None, X, y, SAMPLING_RATE, **common).accuracy
    found: dict[str, Any] = {"before": plain["before"], "after": None, "oracle": None, "share": None}
    found["made_with"] = made_with(counts=COUNTS, n_per_class=N_PER_CLASS)
    if plain["before"] < ALL_BUT:
        true = composite(truth()[name]["effects"])
        whole = downstream_gain(
            None, composite(result["effects"]), X, y, SAMPLING_RATE, oracle=true, **common
        )
        found |= whole.accuracy
        found["share"] = None if np.isnan(whole.share) else whole.share
    write_result(results, name, result | {"downstream": found, "downstream_share": found["share"]})
    return name


def done(results: Path) -> dict[str, dict[str, Any]]:
    """Results of the subset's cases of effects from the library that were found."""
    names = [name for kind in ("single", "pair") for name in case_names(kind, subset=SUBSET)]
    found = {}
    for name in names:
        path = results / f"{name}.json"
        if path.exists():
            result = json.loads(path.read_text(encoding="utf-8"))
            if result["effects"] and not result["unknown"]:
                found[name] = result
    return found


def score(results: Path) -> str:
    """The table, case by case."""
    rows = {name: one["downstream"] for name, one in done(results).items() if "downstream" in one}
    shares = [row["share"] for row in rows.values() if row["share"] is not None]
    versions = told_of_versions(rows.values())
    error = 0.5 / np.sqrt(len(COUNTS))
    lines = [
        "# Hidden effects: what the corrected model is worth to a counter",
        "",
        "Made by `python -m benchmarks.gap_downstream`. All recordings are simulated.",
        f"`make_lobe_counter`'s default, trained on {N_PER_CLASS} simulated recordings of each of 8 counts,",
        f"counts {len(COUNTS)} recordings with the hidden effect; standard error up to {error:.2f}.",
        f"Where the model as it was already teaches to count {ALL_BUT:.0%} there is no gain to share, and",
        "the others are not run.",
        *([versions] if versions else []),
        "",
        "|  | goal | figure | cases |",
        "|---|---|---|---|",
    ]
    if shares:
        lines.append(
            f"| median share of the true model's gain | >= 0.70 | {np.median(shares):.2f} | {len(shares)} |"
        )
    lines += [
        f"| cases without a gain to share | stated | {len(rows) - len(shares)} | {len(rows)} |",
        "",
        "| case | hidden | as it was | corrected | true | share |",
        "|---|---|---|---|---|---|",
    ]
    for name, row in rows.items():
        hidden = " + ".join(f"{one['id']} ({one['strength']})" for one in truth()[name]["effects"])
        figures = [
            "" if row[key] is None else f"{row[key]:.2f}" for key in ("before", "after", "oracle", "share")
        ]
        lines.append(f"| {name} | {hidden} | {' | '.join(figures)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the cases that are missing, and score all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", default="build/gap", help="folder of results and simulations")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    results, cache = Path(arguments.out) / "results", Path(arguments.out) / "simulations"
    missing = [name for name, result in done(results).items() if "downstream" not in result]
    each_told(gain, missing, arguments.jobs, results, cache)
    text = score(results)
    PAGE.write_text(text, encoding="utf-8")
    print(text, end="")


if __name__ == "__main__":
    # Under its own name, so that worker processes find what they are given.
    from benchmarks.gap_downstream import main as run

    run()
