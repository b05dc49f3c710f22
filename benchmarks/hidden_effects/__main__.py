"""``python -m benchmarks.hidden_effects generate | visible | score | equivalence``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.hidden_effects._sets import KINDS, set_names


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hidden_effects", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("generate", help="write the sets' recordings, one folder per set")
    make.add_argument("--out", type=Path, required=True, help="folder for the sets; finished ones are kept")
    make.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS), help="default: all")
    make.add_argument("--sets", type=int, help="only so many of them, the first by name")
    make.add_argument("--jobs", type=int, default=2, help="worker processes (2)")
    seen = commands.add_parser("visible", help="which effects an oracle sees; writes visible.csv")
    seen.add_argument("--jobs", type=int, default=2, help="worker processes (2)")
    score = commands.add_parser("score", help="compare results with the truth")
    score.add_argument("results", type=Path, help="folder with one <set>.json per set; gets score.md")
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
        from benchmarks.hidden_effects._folders import generate

        generate(set_names(given.kinds)[: given.sets], given.out, given.jobs)
    elif given.command == "visible":
        from benchmarks.hidden_effects._visible import write_visible

        write_visible(given.jobs)
    elif given.command == "score":
        from benchmarks.hidden_effects._answers import read_answers
        from benchmarks.hidden_effects._table import markdown

        text = markdown(read_answers(given.results))
        (given.results / "score.md").write_text(f"# Hidden effects: score\n\n{text}", encoding="utf-8")
        print(text)
    else:
        from benchmarks.hidden_effects._equivalence import report

        text = report(given.recordings, given.nulls)
        print(text)
        if given.out is not None:
            given.out.write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
