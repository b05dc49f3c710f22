"""``python -m benchmarks.hidden_effects generate | score | equivalence``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.hidden_effects._cases import KINDS, case_names


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hidden_effects", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("generate", help="write the cases' recordings, one folder per case")
    make.add_argument("--out", type=Path, required=True, help="folder for the cases; finished ones are kept")
    make.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS), help="default: all")
    some = make.add_mutually_exclusive_group()
    some.add_argument("--cases", type=int, help="only so many of them, the first by name")
    some.add_argument(
        "--subset", type=int, choices=[40], help="the stratified subset (singles, pairs, outside)"
    )
    make.add_argument("--jobs", type=int, default=2, help="worker processes (2)")
    score = commands.add_parser("score", help="compare results with the truth")
    score.add_argument("results", type=Path, help="folder with one <case>.json per case")
    score.add_argument("--out", type=Path, help="folder for score.md and score.json; default: the results'")
    same = commands.add_parser(
        "equivalence", help="this generator beside cyclofeat.simulators, no effect hidden"
    )
    same.add_argument("--recordings", type=int, default=80, help="recordings of each (80)")
    same.add_argument("--nulls", type=int, default=30, help="sets of 8 for the locator's test (30)")
    same.add_argument("--out", type=Path, help="file for what is printed")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return the exit code."""
    given = _parser().parse_args(arguments)
    if given.command == "generate":
        from benchmarks.hidden_effects._generate import generate

        names = case_names(given.kinds, given.subset)
        if given.cases is not None:
            names = names[: max(given.cases, 0)]
        generate(names, given.out, given.jobs)
    elif given.command == "score":
        from benchmarks.hidden_effects._score import score_folder

        print(score_folder(given.results, given.out))
    else:
        from benchmarks.hidden_effects._equivalence import report

        text = report(given.recordings, given.nulls)
        print(text)
        if given.out is not None:
            given.out.write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
