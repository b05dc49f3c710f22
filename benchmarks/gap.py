"""The gap workflow on the hidden effects: ``python -m benchmarks.gap``; every goal beside its figure.

Makes ``--count`` of the sets, asks the posterior for names and sizes in them, runs the whole workflow with
proof on them, and writes ``benchmarks/gap.md``. Recordings, summaries and results are stored, so an
interrupted run continues; results of another version of the code are made again.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import joblib

from benchmarks._markdown import table
from benchmarks._versions import made_with, stored_answers, vector_width
from benchmarks.hidden_effects import set_names
from benchmarks.hidden_effects._answers import Answer, answers
from benchmarks.hidden_effects._ask import names_of, session_of, sessions_of, shown, whole_answer
from benchmarks.hidden_effects._folders import generate, read_set
from benchmarks.hidden_effects._sets import FIT
from benchmarks.hidden_effects._table import (
    at_most,
    beside_goals,
    counted,
    details,
    figures,
    figures_of_names,
    figures_of_sizes,
    number,
    share_right,
)
from cyclofeat.gap import EffectPosterior, GapSettings, find_gap, load_posterior
from cyclofeat.gap.world.world import Session

PAGE = Path(__file__).with_name("gap.md")
# Kinds of sets, each with its share.
SHARES = {"several": 1 / 2, "single": 1 / 6, "outside": 1 / 6, "null": 1 / 6}
# What is shown of each set's recordings, besides all with their counts.
SHOWN: dict[str, dict[str, Any]] = {
    "all recordings, counts known": {},
    "all recordings, counts unknown": {"counts": False},
    "4 recordings, counts known": {"n": 4},
}
TIMED = 3  # sets whose answers are timed


def main() -> None:
    """Run what is missing and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--sets", type=Path, default=Path("build/hidden_effects"), help="folder of the sets")
    parser.add_argument("--out", type=Path, default=Path("build/gap"), help="folder of the results")
    parser.add_argument("--posterior", type=Path, help="file (default: the packaged one)")
    parser.add_argument("--count", type=int, default=100, help="number of sets (100)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--times", action="store_true", help="also time single answers, on idle cores")
    given = parser.parse_args()
    began = time.monotonic()
    names = chosen_sets(given.count)
    generate(names, given.sets, given.jobs)
    posterior = load_posterior(*([given.posterior] if given.posterior else []))
    sessions = sessions_of(names, given.sets, given.jobs)
    print(f"{len(sessions)} sets summarised after {time.monotonic() - began:.0f} s", flush=True)
    found = whole(names, posterior, given)
    learned = f"It has learned from {posterior.n_rigs_:,} simulated rigs."
    goals = beside_goals(figures(found))
    head = HEAD.format(" --times" if given.times else "")
    parts = [head, counted(found), "## The whole workflow", "", WHOLE, goals, details(found)]
    parts += ["## The posterior's networks alone", "", learned, "", *by_posterior(posterior, sessions)]
    if given.times:
        on = f"On {given.jobs} processor cores with vectors of {vector_width()}."
        parts += ["## What it costs", "", on, "", costs(names, posterior, given)]
    text = "\n".join(parts)
    given.page.write_text(text.rstrip() + "\n", encoding="utf-8")
    print(text)


def by_posterior(posterior: EffectPosterior, sessions: Mapping[str, Session]) -> list[str]:
    """Return the lines of what the posterior says of all sets, also where less is known of them."""
    rows, every = [], []
    for text, what in SHOWN.items():
        said = names_of(posterior, [shown(one, **what) for one in sessions.values()])
        every.append(answers(dict(zip(sessions, said, strict=True))))
        rows.append([text, *share_right(every[-1])])
    head = (
        "session",
        "sets with visible effects",
        "right up to ties",
        "precision",
        "recall of visible effects",
    )
    return [
        beside_goals(figures_of_names(every[0])),
        "### Less known", "", table(head, rows),
        "### Sizes before confirmation", "", beside_goals(figures_of_sizes(every[0], confirmed=False)),
    ]  # fmt: skip


def chosen_sets(n: int) -> list[str]:
    """Names of ``n`` of the sets, of each kind its share."""
    return [name for kind, part in SHARES.items() for name in set_names([kind])[: round(part * n)]]


def whole(names: Sequence[str], posterior: EffectPosterior, given: argparse.Namespace) -> list[Answer]:
    """Return the whole workflow's answers; those that are stored for this version are read."""
    settings = GapSettings(pictures=False, random_state=0, n_jobs=1)
    folder = given.out / made_with(settings=settings, posterior=joblib.hash(vars(posterior)))
    sets = given.sets
    return answers(
        stored_answers(folder, names, lambda name: whole_answer(name, sets, posterior, settings), given.jobs)
    )


def costs(names: Sequence[str], posterior: EffectPosterior, given: argparse.Namespace) -> str:
    """Return the table of what answers cost."""
    some = [name for name in names if name in set_names(["several"])][:TIMED]

    def named(name: str) -> None:
        names_of(posterior, [session_of(name, given.sets)])

    def result(name: str) -> None:
        command = [sys.executable, "-m", "cyclofeat", "gap", "--quiet", "--jobs", str(given.jobs)]
        with tempfile.TemporaryDirectory() as nothing_compiled:
            compiled = {"NUMBA_CACHE_DIR": nothing_compiled}
            subprocess.run(
                [*command, str(given.sets / name / FIT)],
                check=True,
                capture_output=True,
                env=os.environ | compiled,
            )

    def case(name: str) -> None:
        settings = GapSettings(pictures=False, random_state=0, n_jobs=given.jobs)
        find_gap(*read_set(name, given.sets), posterior=posterior, settings=settings)

    return beside_goals([
        number("names after reading the files, median s", at_most(5),
               [seconds(named, name) for name in some], median),
        number("first result for a new user, `cyclofeat gap FOLDER`, nothing compiled, median s", at_most(60),
               [seconds(result, name) for name in some], median),
        number("whole case with proof, median s", at_most(45),
               [seconds(case, name) for name in some], median),
    ])  # fmt: skip


def seconds(work: Callable[[Any], object], of: Any) -> float:
    """Return the time by the clock of a call."""
    began = time.monotonic()
    work(of)
    return time.monotonic() - began


HEAD = """# Hidden effects: names, sizes and proof

Made by `python -m benchmarks.gap{}`. All recordings are simulated, by the generator of
[the hidden effects](hidden_effects/README.md), which shares no code with the simulator. "Visible" are effects
that an oracle detects at 3 sigma which knows all others and their sizes; "ties" are the groups of `ties.csv`.
"""

WHOLE = """Names and sizes are those after simulation of the session. The oracle knows all effects and sizes.
Recordings held out are of "counts or conditions not fitted" if no fitted recording has their count, or their
speed and load. "Flagged": the page says that what is left is unexplained.
"""


if __name__ == "__main__":
    # Import by name, so that worker processes can unpickle their arguments.
    from benchmarks import gap

    gap.main()
