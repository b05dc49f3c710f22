"""Options of commands that keep a history of the counts, and the rows that they add."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat.cli._idle import add_idle

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
        self.history.add(name, str(path.resolve()), _time(path, recording), count, recording, self.model.card)
        return name

    def state(self, name: str) -> GearboxState:
        """Return the state of a gearbox."""
        return self.history.state(name, **self.rates)


def _time(path: Path, recording: Recording) -> float:
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
