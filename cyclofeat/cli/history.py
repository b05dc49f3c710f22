"""``cyclofeat history``: the counts of each gearbox over time."""

from __future__ import annotations

from collections.abc import Iterator

from cyclofeat._base.quantities import number_of
from cyclofeat.cli._options import Arguments, Parser, Printed


def add_arguments(parser: Parser) -> None:
    parser.add_argument("file", metavar="FILE", help="history that count or watch has written")
    parser.add_argument(
        "--gearbox", action="append", metavar="NAME", help="gearbox to show; may be repeated (default all)"
    )
    parser.add_alarm_options()
    parser.add_target("--report", "page", metavar="FILE.html", help="page to write: the counts over time")
    parser.add_argument("--strict", action="store_true", help="exit with code 3 if there is an alarm")


def run(arguments: Arguments) -> Iterator[Printed]:
    """Yield the state of each gearbox, then write the page."""
    from cyclofeat.history import History
    from cyclofeat.history.alarm import time_text

    with History(arguments.file, create=False) as history:
        names = list(dict.fromkeys(arguments.gearbox or history.gearboxes()))
        if not names:
            raise ValueError(f"{arguments.file} holds no recording")
        states = []
        for name in names:
            state = history.state(name, **arguments.alarm_rates())
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

            arguments.write_report(write_history_report, history, states=states)
