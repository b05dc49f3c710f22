"""``cyclofeat history``: the counts of each gearbox over time, and what other commands need to keep them."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat._base.quantities import number_of
from cyclofeat.cli._options import add_idle, add_target
from cyclofeat.cli._printing import Printed, note

if TYPE_CHECKING:
    from cyclofeat.counting import LobeCount, LobeModel
    from cyclofeat.history import GearboxState, History
    from cyclofeat.recordings import Recording


def add_history_options(parser: argparse.ArgumentParser, default_name: str) -> None:
    """Add the options that name a history and the gearbox whose recordings are counted."""
    parser.add_argument(
        "--history", metavar="FILE.sqlite", help="file to which each count is added; created if missing"
    )
    parser.add_argument(
        "--gearbox",
        metavar="NAME",
        help=f"name of the gearbox in the history (default the assembly that a file states{default_name})",
    )
    add_alarm_options(parser)
    add_idle(
        parser,
        "--gearbox",
        "--false-alarms-per-month",
        "--recordings-per-month",
        without=["--history"],
    )


def add_alarm_options(parser: argparse.ArgumentParser) -> None:
    """Add the options from which the rule of the alarm follows."""
    parser.add_argument(
        "--false-alarms-per-month", type=float, default=0.1, metavar="N",
        help="accepted false alarms per gearbox and month (default 0.1)",
    )  # fmt: skip
    parser.add_argument(
        "--recordings-per-month", type=float, metavar="N",
        help="recordings of a gearbox per month (default: the rate so far, over at least an hour)",
    )  # fmt: skip


def alarm_rates(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of ``History.state`` that the options state."""
    names = ("false_alarms_per_month", "recordings_per_month")
    rates = {name: getattr(arguments, name) for name in names}
    for name, rate in rates.items():
        if rate is not None and not (math.isfinite(rate) and rate > 0):
            raise ValueError(f"--{name.replace('_', '-')} must be positive and finite, got {rate:g}")
    return rates


class HistoryWriter:
    """Adds counts to a history."""

    def __init__(
        self, arguments: argparse.Namespace, model: LobeModel, history: History, default_name: str
    ) -> None:
        self.gearbox, self.rates = arguments.gearbox, alarm_rates(arguments)
        self.model, self.history, self.default_name = model, history, default_name

    def add(self, path: Path, recording: Recording, count: LobeCount) -> str:
        """Add a count, which the history's ``write`` writes, and return the name of the gearbox."""
        name: str | None = self.gearbox
        if name is None:
            name = self.default_name if recording.assembly is None else str(recording.assembly)
        if not name:
            raise ValueError("the file states no assembly: give --gearbox NAME with --history")
        self.history.add(
            name, str(path.resolve()), _recording_time(path, recording), count, recording, self.model.card_
        )
        return name

    def state(self, name: str) -> GearboxState:
        """Return the state of a gearbox."""
        return self.history.state(name, **self.rates)


def _recording_time(path: Path, recording: Recording) -> float:
    """Return when a file was recorded, in s since 1970: as it states, else when it was changed."""
    stated = (recording.meta or {}).get("start_time")
    if stated is None:
        return path.stat().st_mtime
    try:
        start = datetime.fromisoformat(stated)
    except (TypeError, ValueError):
        raise ValueError(
            f"meta's start_time must be a time as 2026-03-01T14:30:00 (UTC, unless it states an offset), got "
            f"{stated!r}"
        ) from None
    return (start if start.tzinfo else start.replace(tzinfo=UTC)).timestamp()


@contextmanager
def history_writer(
    arguments: argparse.Namespace, model: LobeModel, default_name: str = ""
) -> Iterator[HistoryWriter | None]:
    """Open the history that the options name; None without one."""
    if arguments.history is None:
        yield None
        return
    if arguments.gearbox == "":
        raise ValueError("--gearbox must be a name, got an empty one")
    alarm_rates(arguments)  # an error before the file is made
    from cyclofeat.history import History

    with History(arguments.history) as history:
        yield HistoryWriter(arguments, model, history, default_name)


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


def format_result(arguments: argparse.Namespace, state: GearboxState) -> Printed:
    from cyclofeat.history.alarm import time_text

    count = "never counted" if state.defect_count is None else number_of(state.defect_count, "worn lobe")
    if state.wear_um is not None:
        count += f", {state.wear_um:.3g} um deep"
    refused = f", {state.n_refused} refused" if state.n_refused else ""
    recordings = number_of(state.n_recordings, "recording")
    lines = [
        f"{state.gearbox}: {count}",
        f"  {recordings} from {time_text(state.first)} to {time_text(state.last)}{refused}",
        f"  {state}",
    ]
    if state.rates:
        lines.append(f"  {state.rates}")
    return Printed("\n".join(lines), state.to_dict(), refused=state.alarm and arguments.strict)
