"""The gap workflow on the hidden effects: every goal beside its figure.

    python -m benchmarks.gap                    # 400 nulls and the stratified subset of 40
    python -m benchmarks.gap --full             # 400 nulls and all 240 cases with something hidden
    python -m benchmarks.gap --full --names-only   # where and what, without fits

Results are stored case by case in ``--out``, so an interrupted run can be continued. The score is written to
``benchmarks/gap.md`` (``gap_names.md`` without fits). The workflow receives recordings and counts; only the
oracle, which its last stage compares, knows the truth.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import joblib

from benchmarks._versions import made_with
from benchmarks.hidden_effects._cases import FIT_COUNTS, case_names, make_case, truth
from benchmarks.hidden_effects._score import score_folder
from cyclofeat._base.files import write_whole
from cyclofeat.gap import (
    Comparison,
    EffectRanker,
    GapSettings,
    Windows,
    find_gap,
    locate,
    prepare_ranker,
)
from cyclofeat.simulators import Rig, effect_library

SAMPLING_RATE = 25_600.0
SUBSET = 40
SETTINGS = GapSettings(n_draws=48, n_after=64, n_report=32, n_sims=120, pictures=False)


def main() -> None:
    """Run the missing cases and score all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--full", action="store_true", help="all cases instead of the stratified subset")
    parser.add_argument("--kinds", nargs="+", choices=("null", "single", "pair", "outside"))
    parser.add_argument("--nulls", type=int, default=400)
    parser.add_argument(
        "--quick", action="store_true", help="without the placebo, which needs a fit of its own"
    )
    parser.add_argument(
        "--names-only", action="store_true", help="where and what, without fits: minutes instead of hours"
    )
    parser.add_argument("--out", default="build/gap", help="folder of results and simulations")
    parser.add_argument("--score", help="file to write (default: benchmarks/gap.md or gap_names.md)")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    out = Path(arguments.out)
    results, cache = out / ("names" if arguments.names_only else "results"), out / "simulations"
    results.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    kinds = arguments.kinds or ["null", "single", "pair", "outside"]
    hidden = [kind for kind in ("single", "outside", "pair") if kind in kinds]
    names: list[str] = []
    if hidden:
        subset = None if arguments.full else SUBSET
        names += [name for kind in hidden for name in case_names(kind, subset=subset)]
    if "null" in kinds:
        names += case_names("null")[: arguments.nulls]
    missing = [name for name in names if not (results / f"{name}.json").exists()]
    # Banks and table first, once, on all cores.
    _prepared(cache, arguments.jobs)
    print(
        f"{len(missing)} of {len(names)} cases to do; simulations ready after {_minutes(began)}", flush=True
    )
    one = named if arguments.names_only else functools.partial(run, quick=arguments.quick)
    each_told(one, missing, arguments.jobs, results, cache)
    print(f"{len(missing)} cases in {_minutes(began)}")
    score = arguments.score or ("benchmarks/gap_names.md" if arguments.names_only else "benchmarks/gap.md")
    text = score_folder(results, results.with_name(f"{results.name} score"))
    heading, _, rest = text.rstrip().partition("\n\n")
    command = " ".join(["python -m benchmarks.gap", *sys.argv[1:]])
    Path(score).write_text(f"{heading}\n\nMade by `{command}`.\n\n{rest}\n", encoding="utf-8")
    print(text)


def each_told(job: Callable[..., str], names: Sequence[str], n_jobs: int, *arguments: Any) -> None:
    """Run one job per case in processes and report each as it ends."""
    work = joblib.Parallel(n_jobs=n_jobs, return_as="generator_unordered")
    began = time.monotonic()
    for k, name in enumerate(work(joblib.delayed(job)(name, *arguments) for name in names), start=1):
        print(f"{k} of {len(names)}: {name}, {_minutes(began)}", flush=True)


def run(name: str, results: Path, cache: Path, quick: bool) -> str:
    """Run one case, from recordings to a file of results."""
    case = make_case(name)
    known = truth()[name]["effects"]
    oracle = None
    if known and all(effect["id"] in effect_library() for effect in known):
        effects = [effect_library()[effect["id"]](**effect["theta"]) for effect in known]
        oracle = Rig(effects=effects)
    # No goal needs the model with retuned stiffness and damping, which requires a separate fit.
    settings = dataclasses.replace(
        SETTINGS,
        oracle=oracle,
        with_placebo=not quick,
        baselines=("nothing", "equaliser", "gaussian_process"),
    )
    result = find_gap(
        _comparison(cache, 1),
        Windows(case.X_fit, case.y_fit),
        Windows(case.X_hold, case.y_hold) if len(case.X_hold) else None,
        settings=settings,
        ranker=_ranker(cache),
    )
    write_result(results, name, result.to_dict() | {"made_with": made_with(**design_of(settings))})
    return name


def named(name: str, results: Path, cache: Path) -> str:
    """Run the first two stages of a case alone: the verdict and the ranker's names."""
    case, ranker = make_case(name), _ranker(cache)
    comparison = _comparison(cache, 1)
    measured = comparison.measured(case.X_fit, y=case.y_fit)
    located = locate(comparison, measured, alpha=SETTINGS.alpha)
    result: dict[str, Any] = {
        "format": "cyclofeat gap 1", "verdict": located.verdict, "p": min(located.family_p.values()),
        "effects": [], "ranking": [], "tie_group": [], "unknown": False,
    }  # fmt: skip
    if located.verdict == "disagree":
        ranking = ranker.rank(located)
        first = ranking.rows[0]
        result["ranking"] = [{"id": row.effect_id, "probability": row.probability} for row in ranking.rows]
        result["tie_group"] = [first.effect_id, *first.look_alikes] if first.look_alikes else []
        result["unknown"] = ranking.unknown
        result["unknown_score"] = 1 - max(ranking.conformal_p.values())
    result["made_with"] = made_with(names_only=True, **design_of(SETTINGS))
    write_result(results, name, result)
    return name


def design_of(settings: GapSettings) -> dict[str, Any]:
    """Settings that affect a result, without the case's truth."""
    return {name: value for name, value in vars(settings).items() if name not in ("oracle", "pictures")}


def write_result(results: Path, name: str, result: dict[str, Any]) -> None:
    content = json.dumps(result, indent=1).encode()
    write_whole(results / f"{name}.json", lambda stream: stream.write(content))


@functools.cache
def _ranker(cache: Path) -> EffectRanker:
    """Return the process's one ranker, because training it takes as long as a fit."""
    return _prepared(cache, 1)


def _prepared(cache: Path, n_jobs: int) -> EffectRanker:
    return prepare_ranker(_comparison(cache, n_jobs), FIT_COUNTS, SETTINGS)


def _comparison(cache: Path, n_jobs: int) -> Comparison:
    return Comparison(sampling_rate=SAMPLING_RATE, n_jobs=n_jobs, cache=cache)


def _minutes(began: float) -> str:
    return f"{(time.monotonic() - began) / 60:.1f} min"


if __name__ == "__main__":
    # Import by name, so that worker processes can unpickle their arguments.
    from benchmarks import gap

    gap.main()
