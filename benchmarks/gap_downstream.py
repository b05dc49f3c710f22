"""Gain of a counter from the corrected simulators: ``python -m benchmarks.gap_downstream``.

For each case of the subset whose effects ``python -m benchmarks.gap`` found, the toolkit's counter is trained
on the original, the corrected and the true model, and counts new recordings from the generator of the hidden
effects. If the counter trained on the original model is already nearly perfect, no gain is defined. Results
are added to those of ``benchmarks.gap``; the score is written to ``benchmarks/gap_downstream.md``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._versions import made_with, version_note
from benchmarks.gap import SAMPLING_RATE, SUBSET, each_told, write_result
from benchmarks.hidden_effects._cases import case_names, make_recordings, truth
from cyclofeat.gap import Comparison, downstream_gain
from cyclofeat.simulators import Rig, effect_library

PAGE = Path(__file__).with_name("gap_downstream.md")
COUNTS = tuple(range(8)) * 6
PART = 2  # of a case's random numbers: 0 and 1 are the recordings that the workflow uses
N_PER_CLASS = 24
ALL_BUT = 0.95  # accuracy above which a gain over the original model would be chance


def composite(effects: list[dict[str, Any]]) -> Rig:
    """Return the model with the effects that results or truth state."""
    library = effect_library()
    return Rig(effects=[library[one["id"]](**one["theta"]) for one in effects])


def gain(name: str, results: Path, cache: Path) -> str:
    """Add the gain from the corrected model to the result of a case."""
    result = json.loads((results / f"{name}.json").read_text(encoding="utf-8"))
    X, y = make_recordings(name, PART, COUNTS), np.array(COUNTS)
    comparison = Comparison(sampling_rate=SAMPLING_RATE, cache=cache)
    measured = comparison.measured(X, y=y)
    plain = downstream_gain(comparison, Rig(), measured, n_per_class=N_PER_CLASS).accuracy
    found: dict[str, Any] = {"before": plain["before"], "after": None, "oracle": None, "share": None}
    found["made_with"] = made_with(counts=COUNTS, n_per_class=N_PER_CLASS)
    if plain["before"] < ALL_BUT:
        true = composite(truth()[name]["effects"])
        whole = downstream_gain(
            comparison, composite(result["effects"]), measured, oracle=true, n_per_class=N_PER_CLASS
        )
        found |= whole.accuracy
        found["share"] = None if np.isnan(whole.share) else whole.share
    write_result(results, name, result | {"downstream": found, "downstream_share": found["share"]})
    return name


def done(results: Path) -> dict[str, dict[str, Any]]:
    """Results of the subset's cases whose effects are from the library and were found."""
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
    """Return the table, case by case."""
    rows = {name: one["downstream"] for name, one in done(results).items() if "downstream" in one}
    shares = [row["share"] for row in rows.values() if row["share"] is not None]
    versions = version_note(rows.values())
    error = 0.5 / np.sqrt(len(COUNTS))
    lines = [
        "# Hidden effects: gain of a counter from the corrected model",
        "",
        "Made by `python -m benchmarks.gap_downstream`. All recordings are simulated.",
        f"`make_lobe_counter`'s default, trained on {N_PER_CLASS} simulated recordings of each of 8 counts,",
        f"counts {len(COUNTS)} recordings with the hidden effect; standard error up to {error:.2f}.",
        f"If training on the original model already gives {ALL_BUT:.0%} accuracy, no gain is defined and",
        "the other two are not run.",
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
        f"| cases without a defined gain | stated | {len(rows) - len(shares)} | {len(rows)} |",
        "",
        "| case | hidden | original | corrected | true | share |",
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
    """Run the missing cases and score all."""
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
    # Import by name, so that worker processes can unpickle their arguments.
    from benchmarks.gap_downstream import main as run

    run()
