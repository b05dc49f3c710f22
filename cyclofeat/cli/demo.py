"""``cyclofeat demo``: the way from nothing to counts, by commands that are printed before they run."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path

from cyclofeat.cli import command_module, make_parser
from cyclofeat.cli._options import Arguments, Parser, Printed


def add_arguments(parser: Parser) -> None:
    parser.add_target("--out", "folder", default="demo", help="folder to write (default: demo)")
    parser.add_jobs()


def run(arguments: Arguments, *, assemblies: int = 24, recordings: int = 16) -> Iterator[Printed]:
    """Train on simulated assemblies of rig R1, simulate other recordings, count them, compare with the truth.

    The folder then holds ``recordings/``, ``model.skops``, ``count.html`` and ``evaluation.html``.
    ``assemblies`` are those of each defect count to train on.
    """
    folder = Path(arguments.out)
    folder.mkdir(parents=True, exist_ok=True)
    measured, model = folder / "recordings", folder / "model.skops"
    pages = folder / "count.html", folder / "evaluation.html"
    calls = [
        ["train", "--rig", "r1", "--assemblies", assemblies, "--jobs", arguments.n_jobs, "--out", model],
        ["simulate", "--rig", "r1", "--count", recordings, "--out", measured],
        ["count", measured, "--model", model, "--report", pages[0]],
        ["evaluate", measured, "--model", model, "--report", pages[1]],
    ]
    lines = [[*map(str, call), *["--force"] * arguments.force] for call in calls]
    parsed = [make_parser([command]).parse_args([command, *words]) for command, *words in lines]
    for call in parsed:
        call.check_targets()  # errors now rather than after the simulation
    for line, call in zip(lines, parsed, strict=True):
        command = shlex.join(["cyclofeat", *line])
        yield Printed(f"\n$ {command}", {"command": command})
        result = command_module(call.command).run(call)
        yield from result if isinstance(result, Iterator) else (result,)
    yield Printed(f"\nAll recordings are SIMULATED. Pages: {', '.join(map(str, pages))}", {})
