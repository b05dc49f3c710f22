"""``cyclofeat gap --check``: which effects recordings could reveal, and how often the posterior is right."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cyclofeat._base.checks import whole
from cyclofeat._base.progress import Progress
from cyclofeat._base.words import beyond, number, unit_text
from cyclofeat.cli._idle import add_idle
from cyclofeat.cli._reading import read_all
from cyclofeat.cli._table import Printed

if TYPE_CHECKING:
    from cyclofeat.gap import CheckedEffect, Condition, GapCheck
    from cyclofeat.gap.posterior import EffectPosterior
    from cyclofeat.recordings import Recording

_RECORDINGS, _RIGS = 12, 240


def add_check(parser: argparse.ArgumentParser) -> None:
    """Add the options of a check."""
    parser.add_argument(
        "--check",
        action="store_true",
        help="state which effects recordings like MEASURED could reveal, from which size on, and how often "
        "the posterior is right; without MEASURED, the same for planned recordings (one or two minutes on "
        "two cores)",
    )
    parser.add_argument(
        "--recordings",
        type=int,
        default=_RECORDINGS,
        metavar="N",
        help="planned recordings, at the middle speed and load that the posterior knows "
        f"(default {_RECORDINGS})",
    )
    parser.add_argument(
        "--rigs",
        type=int,
        default=_RIGS,
        metavar="N",
        help=f"simulated rigs with known effects that --check uses (default {_RIGS}); more rigs give "
        "more precise sizes",
    )
    add_idle(parser, "--recordings", beside=["MEASURED"])
    add_idle(parser, "--recordings", "--rigs", without=["--check"])
    add_idle(
        parser, "--hold-out", "--out", "--save-simulator", "--simulated", "--alpha", "--one-assembly",
        "--cache", beside=["--check"],
    )  # fmt: skip


def check(arguments: argparse.Namespace, posterior: EffectPosterior) -> GapCheck:
    """Check the recordings named, or as many planned ones."""
    from cyclofeat.gap import check_recordings

    recordings: list[Recording] | list[Condition]
    if arguments.measured:
        recordings = read_all(arguments.measured, arguments)
    else:
        recordings = _planned(whole("--recordings", arguments.recordings, 1), posterior)
    with Progress("cyclofeat gap: simulating rigs") as progress:
        return check_recordings(
            recordings,
            posterior=posterior,
            n_rigs=whole("--rigs", arguments.rigs, 1),
            random_state=arguments.seed,
            n_jobs=arguments.jobs,
            progress=progress,
        )


def _planned(n: int, posterior: EffectPosterior) -> list[Condition]:
    from cyclofeat.gap import Condition

    world = posterior.world
    return [Condition(sum(world.speeds_rpm) / 2, sum(world.loads_nm) / 2)] * n


def printed_check(result: GapCheck) -> Printed:
    """Return what is printed of a check."""
    score, at = result.score, dict.fromkeys(one.text for one in result.conditions)
    recordings = number(len(result.conditions), "recording")
    lines = [
        f"{score.n_rigs} simulated rigs with known effects, {recordings} of each at {'; '.join(at)}",
        f"sets of effects named exactly: {result.sets_right:.0%}, and but for look-alikes "
        f"{result.sets_right_with_ties:.0%}",
        f"effects found: {score.recall:.0%}; names that are right: {score.precision:.0%}",
        *(_line(one) for one in sorted(result.effects, key=lambda one: -one.recall) if one.n),
    ]
    if result.wrong:
        wrong = ", ".join(f"{name} ({n})" for name, n in result.wrong.items())
        lines.append(f"named although absent: {wrong}")
    lines += [f"would help: {one.what} ({one.gain:.2g} bits)" for one in result.next_measurements]
    return Printed("\n".join(lines), result.to_dict())


def _line(one: CheckedEffect) -> str:
    half, most = beyond(one.half_below, one.half_above), beyond(one.most_below, one.most_above)
    unit = unit_text(one.unit)
    text = f"{one.effect}: found in {one.recall:.0%} of {one.n}"
    if half:
        text += f"; in half with {one.parameter} {half}{unit}" + (
            f", in 9 of 10 {most}{unit}" if most else ""
        )
    elif one.recall < 1:
        text += f"; no {one.parameter} is found in half"
    return text + (f"; taken for {', '.join(one.confused_with)}" if one.confused_with else "")
