"""``cyclofeat history``: what was counted of each gearbox, and whether a count has risen."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from cyclofeat._base.words import number
from cyclofeat.cli._history import add_alarm_options, alarm_rates
from cyclofeat.cli._printing import note
from cyclofeat.cli._table import Printed
from cyclofeat.cli._targets import add_target

if TYPE_CHECKING:
    from cyclofeat.history import GearboxState

__all__ = ["add_arguments", "printed", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="history that count or watch has written")
    parser.add_argument(
        "--gearbox", action="append", metavar="NAME", help="gearbox to show; may be repeated (default all)"
    )
    add_alarm_options(parser)
    add_target(parser, "--report", "page", metavar="FILE.html", help="page to write: the counts over time")
    parser.add_argument("--strict", action="store_true", help="exit with code 3 if there is an alarm")


def run(arguments: argparse.Namespace) -> Iterator[GearboxState]:
    """Yield the state of each gearbox, then write the page."""
    from cyclofeat.history import History

    rates = alarm_rates(arguments)
    with History(arguments.file, create=False) as history:
        names = list(dict.fromkeys(arguments.gearbox or history.gearboxes()))
        if not names:
            raise ValueError(f"{arguments.file} holds no recording")
        states = []
        for name in names:
            states.append(history.state(name, **rates))
            yield states[-1]
        if arguments.report:
            from cyclofeat.report import write_history_report

            path = write_history_report(history, arguments.report, states=states)
            note(f"report: {path}")


def printed(arguments: argparse.Namespace, state: GearboxState) -> Printed:
    from cyclofeat.history import when

    count = "never counted" if state.defect_count is None else number(state.defect_count, "worn lobe")
    if state.wear_um is not None:
        count += f", {state.wear_um:.3g} um deep"
    refused = f", {state.n_refused} refused" if state.n_refused else ""
    recordings = number(state.n_recordings, "recording")
    lines = [
        f"{state.gearbox}: {count}",
        f"  {recordings} from {when(state.first)} to {when(state.last)}{refused}",
        f"  {state}",
    ]
    if state.rates:
        lines.append(f"  {state.rates}")
    return Printed("\n".join(lines), state.to_dict(), refused=state.alarm and arguments.strict)
