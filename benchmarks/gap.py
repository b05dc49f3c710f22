"""The gap workflow on the hidden effects: every goal beside its figure.

    python -m benchmarks.gap                    # 400 nulls and the stratified subset of 40
    python -m benchmarks.gap --full             # 400 nulls and all 240 cases with something hidden
    python -m benchmarks.gap --full --names-only   # where and what, without fits

Results are kept case by case in ``--out``: an interrupted run goes on. The score is written to
``benchmarks/gap.md`` (``gap_names.md`` without fits). The workflow is given recordings and counts; the truth
goes to the oracle alone, which it compares in its last stage.
"""

from __future__ import annotations

import argparse
import functools
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import joblib
from sklearn.base import BaseEstimator

from benchmarks._versions import made_with
from benchmarks.hidden_effects._cases import FIT_COUNTS, N_SAMPLES, case_names, make_case, truth
from benchmarks.hidden_effects._score import score_folder
from cyclofeat._files import write_whole
from cyclofeat.gap import DiscrepancyWorkflow, EffectRanker, GapLocator
from cyclofeat.simulators import CompositeSimulator, effect_library

SAMPLING_RATE = 25_600.0
SUBSET = 40


def main() -> None:
    """Run the cases that are missing, and score all."""
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
    _workflow(cache, arguments.jobs).prepare(FIT_COUNTS, N_SAMPLES)
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
    """A job of each case in processes, each told of as it ends."""
    work = joblib.Parallel(n_jobs=n_jobs, return_as="generator_unordered")
    began = time.monotonic()
    for k, name in enumerate(work(joblib.delayed(job)(name, *arguments) for name in names), start=1):
        print(f"{k} of {len(names)}: {name}, {_minutes(began)}", flush=True)


def run(name: str, results: Path, cache: Path, quick: bool) -> str:
    """One case, from recordings to a file of results."""
    case = make_case(name)
    known = truth()[name]["effects"]
    oracle = None
    if known and all(effect["id"] in effect_library() for effect in known):
        effects = [effect_library()[effect["id"]](**effect["theta"]) for effect in known]
        oracle = CompositeSimulator(effects=effects)
    # No goal asks for the model with stiffness and damping retuned, which takes a fit of its own.
    workflow = _workflow(
        cache, 1, oracle=oracle, ranker=_ranker(cache), with_placebo=not quick,
        baselines=("nothing", "equaliser", "gaussian_process"),
    )  # fmt: skip
    hold = case.X_hold if len(case.X_hold) else None
    workflow.fit(case.X_fit, hold, y_fit=case.y_fit, y_hold=case.y_hold if hold is not None else None)
    write_result(results, name, workflow.result_ | {"made_with": made_with(**design_of(workflow))})
    return name


def named(name: str, results: Path, cache: Path) -> str:
    """The first two stages of a case alone: the verdict, and the ranker's names."""
    case, ranker = make_case(name), _ranker(cache)
    locator = GapLocator(SAMPLING_RATE, alpha=_workflow(cache, 1).alpha, cache=cache)
    locator.fit(case.X_fit, y=case.y_fit)
    result: dict[str, Any] = {
        "format": "cyclofeat gap 1", "verdict": locator.verdict_, "p": min(locator.family_p_.values()),
        "effects": [], "ranking": [], "tie_group": [], "unknown": False,
    }  # fmt: skip
    if locator.verdict_ == "disagree":
        ranking = ranker.rank(locator)
        result["ranking"] = [{"id": row.effect_id, "probability": row.probability} for row in ranking]
        alike = ranking[0].look_alikes
        result["tie_group"] = [ranking[0].effect_id, *alike] if alike else []
        result["unknown"] = ranker.unknown_
        result["unknown_score"] = 1 - max(ranker.conformal_p_.values())
    result["made_with"] = made_with(names_only=True, **design_of(_workflow(cache, 1)))
    write_result(results, name, result)
    return name


def design_of(estimator: BaseEstimator) -> dict[str, Any]:
    """Settings that decide about a result: not the case's truth, nor where and how fast it is computed."""
    left_out = ("oracle", "ranker", "n_jobs", "cache", "progress", "effect", "starts")
    return {name: value for name, value in estimator.get_params(deep=False).items() if name not in left_out}


def write_result(results: Path, name: str, result: dict[str, Any]) -> None:
    content = json.dumps(result, indent=1).encode()
    write_whole(results / f"{name}.json", lambda stream: stream.write(content))


@functools.cache
def _ranker(cache: Path) -> EffectRanker:
    """One per process: learning from the table takes as long as a fit."""
    return _workflow(cache, 1).prepare(FIT_COUNTS, N_SAMPLES)


def _workflow(cache: Path, n_jobs: int, **options: Any) -> DiscrepancyWorkflow:
    return DiscrepancyWorkflow(
        SAMPLING_RATE, n_draws=48, n_after=64, n_report=32, n_sims=120, n_jobs=n_jobs, cache=cache, **options
    )


def _minutes(began: float) -> str:
    return f"{(time.monotonic() - began) / 60:.1f} min"


if __name__ == "__main__":
    # Under its own name, so that worker processes find what they are given.
    from benchmarks import gap

    gap.main()
