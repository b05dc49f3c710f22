"""``cyclofeat history``: the counts of each gearbox over time, and what other commands need to keep them."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from cyclofeat._base.quantities import number_of
from cyclofeat.cli._options import Printed, add_alarm_options, add_target, alarm_rates, note

if TYPE_CHECKING:
    from cyclofeat.counting import LobeCount, LobeModel
    from cyclofeat.history import GearboxState, History
    from cyclofeat.recordings import Recording


@dataclass
class HistoryWriter:
    """Adds counts to a history."""

    arguments: argparse.Namespace
    history: History
    default_name: str

    def add(self, path: Path, recording: Recording, count: LobeCount, model: LobeModel) -> str:
        """Add a count, which the history's ``write`` writes, and return the name of the gearbox."""
        assembly = self.default_name if recording.assembly is None else str(recording.assembly)
        name: str = self.arguments.gearbox or assembly
        if not name:
            raise ValueError("the file states no assembly: give --gearbox NAME with --history")
        time = path.stat().st_mtime
        stated = (recording.meta or {}).get("start_time")
        if stated is not None:
            try:
                start = datetime.fromisoformat(stated)
            except (TypeError, ValueError):
                raise ValueError(
                    "meta's start_time must be a time as 2026-03-01T14:30:00 (UTC, unless it states an "
                    f"offset), got {stated!r}"
                ) from None
            time = (start if start.tzinfo else start.replace(tzinfo=UTC)).timestamp()
        self.history.add(name, str(path.resolve()), time, count, recording, model.card_)
        return name

    def state(self, name: str) -> GearboxState:
        return self.history.state(name, **alarm_rates(self.arguments))


@contextmanager
def history_writer(arguments: argparse.Namespace, default_name: str = "") -> Iterator[HistoryWriter]:
    """Open the history that the options name."""
    if arguments.gearbox == "":
        raise ValueError("--gearbox must be a name, got an empty one")
    from cyclofeat.history import History

    with History(arguments.history) as history:
        yield HistoryWriter(arguments, history, default_name)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="history that count or watch has written")
    parser.add_argument(
        "--gearbox", action="append", metavar="NAME", help="gearbox to show; may be repeated (default all)"
    )
    add_alarm_options(parser)
    add_target(parser, "--report", "page", metavar="FILE.html", help="page to write: the counts over time")
    parser.add_argument("--strict", action="store_true", help="exit with code 3 if there is an alarm")


def run(arguments: argparse.Namespace) -> Iterator[Printed]:
    """Yield the state of each gearbox, then write the page."""
    from cyclofeat.history import History
    from cyclofeat.history.alarm import time_text

    with History(arguments.file, create=False) as history:
        names = list(dict.fromkeys(arguments.gearbox or history.gearboxes()))
        if not names:
            raise ValueError(f"{arguments.file} holds no recording")
        states = []
        for name in names:
            state = history.state(name, **alarm_rates(arguments))
            states.append(state)
            n = state.defect_count
            count = "never counted" if n is None else number_of(n, "worn lobe")
            if state.wear_um is not None:
                count += f", {state.wear_um:.3g} um deep"
            lines = [
                f"{state.gearbox}: {count}",
                f"  {number_of(state.n_recordings, 'recording')} from {time_text(state.first)} to "
                f"{time_text(state.last)}{f', {state.n_refused} refused' if state.n_refused else ''}",
                f"  {state}",
            ]
            if state.rates:
                lines.append(f"  {state.rates}")
            yield Printed("\n".join(lines), state.to_dict(), refused=state.alarm and arguments.strict)
        if arguments.report:
            from cyclofeat.report import write_history_report

            path = write_history_report(history, arguments.report, states=states)
            note(f"report: {path}")
