"""Sizes of hidden effects of known name, with intervals: ``python -m benchmarks.gap_fits``.

This runs the third stage of the gap workflow alone, on cases of one hidden effect
(``benchmarks/hidden_effects``): those of the stratified subset and one more of each effect. A fit starts from
three places about 30 % from the truth, as near as the ranker's table comes. Results are stored case by case
in ``--out``; the score is written to ``benchmarks/gap_fits.md``.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._versions import made_with, version_note
from benchmarks.gap import SAMPLING_RATE, SUBSET, each_told, write_result
from benchmarks.hidden_effects._cases import case_names, make_case, truth
from cyclofeat.gap import Comparison, fit_effects
from cyclofeat.simulators import Effect, SimulationFailed, effect_library

PAGE = Path(__file__).with_name("gap_fits.md")
MORE = 1  # cases of each effect, beyond the subset
OFF = 0.3  # standard deviation of the starts, as a share or in logarithms
N_SIMS = 120


def chosen() -> list[str]:
    """The subset's single effects, and ``MORE`` of each effect."""
    subset = case_names("single", subset=SUBSET)
    others: dict[str, list[str]] = {}
    for name in case_names("single"):
        if name not in subset:
            others.setdefault(truth()[name]["effects"][0]["id"], []).append(name)
    return [*subset, *(name for names in others.values() for name in names[:MORE])]


def starts(true: Effect, seed: int) -> list[Effect]:
    """Three starts around the truth."""
    random = np.random.default_rng(seed)
    vector, (low, high) = true.to_vector(), true.vector_bounds()
    logarithmic = np.array([true.parameters[name].log for name in true.vector_names()])
    scale = np.where(logarithmic, 1.0, np.abs(vector))
    around = vector + OFF * scale * random.normal(size=(3, vector.size))
    return [type(true)().from_vector(np.clip(place, low, high)) for place in around]


def fit(name: str, results: Path, cache: Path) -> str:
    """Fit one case and write the result."""
    known = truth()[name]["effects"][0]
    first, *others = starts(effect_library()[known["id"]](**known["theta"]), int(name.rpartition("_")[2], 16))
    case, began = make_case(name), time.process_time()
    comparison = Comparison(sampling_rate=SAMPLING_RATE, cache=cache)
    measured = comparison.measured(case.X_fit, y=case.y_fit)
    result: dict[str, Any] = {}
    try:
        fitted = fit_effects(comparison, measured, first, starts=others, n_sims=N_SIMS)
        rows = {f"{row.effect}.{row.name}": row for row in fitted.parameters}
        result = {
            "theta": {name: row.value for name, row in rows.items()},
            "interval": {name: (row.low, row.high) for name, row in rows.items()},
            "told": {name: row.identifiable for name, row in rows.items()},
            "loss": fitted.loss, "seconds": time.process_time() - began,
        }  # fmt: skip
    except SimulationFailed as failure:
        result = {"failed": str(failure)}
    write_result(results, name, result | {"made_with": made_with(n_sims=N_SIMS)})
    return name


def parameters(results: Path) -> Iterator[dict[str, Any]]:
    """Result of each parameter beside the truth."""
    for path in sorted(results.glob("case_*.json")):
        found, case = json.loads(path.read_text(encoding="utf-8")), truth()[path.stem]
        known = case["effects"][0]
        for name, true in known["theta"].items():
            key = f"{known['id']}.{name}"
            if key not in found.get("theta", {}):
                continue
            low, high = found["interval"][key]
            yield {
                "case": path.stem, "subset": case["subset"], "parameter": key, "strength": known["strength"],
                "true": true, "found": found["theta"][key], "low": low, "high": high,
                "covers": low <= true <= high, "told": found["told"][key], "loss": found["loss"],
                "seconds": found["seconds"],
            }  # fmt: skip


def score(results: Path) -> str:
    """Return the table, goal beside figure."""
    rows = list(parameters(results))
    told, cases = [row for row in rows if row["told"]], {row["case"] for row in rows}
    versions = version_note(
        json.loads(path.read_text(encoding="utf-8")) for path in results.glob("case_*.json")
    )
    lines = [
        "# Hidden effects: sizes and intervals",
        "",
        "Made by `python -m benchmarks.gap_fits`: fits of effects whose name is given, started about",
        "30 % from the true parameters. "
        f"{len(cases)} of {len(chosen())} cases of one hidden effect, 8 simulated recordings each.",
        *([versions] if versions else []),
        "",
        "|  | goal | figure | parameters |",
        "|---|---|---|---|",
    ]
    for what, of in (
        ("all", rows),
        ("subset used to develop the intervals", [row for row in rows if row["subset"]]),
        ("other cases, not used for any choice", [row for row in rows if not row["subset"]]),
    ):
        share = np.mean([row["covers"] for row in of])
        lines.append(
            f"| 90 % intervals that contain the true value, {what} | 85 to 95 % | {share:.1%} | {len(of)} |"
        )
    error = np.median([abs(row["found"] / row["true"] - 1) for row in rows])
    of_told = np.median([abs(row["found"] / row["true"] - 1) for row in told])
    seconds = np.median([row["seconds"] for row in rows])
    lines += [
        f"| median error, all | 10 % | {error:.1%} | {len(rows)} |",
        f"| median error of identifiable parameters | stated | {of_told:.1%} | {len(told)} |",
        f"| processor time of a fit, median | stated | {seconds:.0f} s | |",
        "",
        "| case | parameter | strength | true | found | 90 % interval | |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        remarks = (("**missed**", not row["covers"]), ("poorly identified", not row["told"]))
        remark = ", ".join(word for word, yes in remarks if yes)
        lines.append(
            f"| {row['case']} | {row['parameter']} | {row['strength']} | {row['true']:.4g} "
            f"| {row['found']:.4g} | {row['low']:.4g} to {row['high']:.4g} | {remark} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Fit the missing cases and score all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", default="build/gap", help="folder of results and simulations")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    results, cache = Path(arguments.out) / "fits", Path(arguments.out) / "simulations"
    results.mkdir(parents=True, exist_ok=True)
    missing = [name for name in chosen() if not (results / f"{name}.json").exists()]
    each_told(fit, missing, arguments.jobs, results, cache)
    text = score(results)
    PAGE.write_text(text, encoding="utf-8")
    print(text, end="")


if __name__ == "__main__":
    # Import by name, so that worker processes can unpickle their arguments.
    from benchmarks.gap_fits import main as run

    run()
