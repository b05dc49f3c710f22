"""``cyclofeat inspect``: the content of recordings, and what in it would spoil a count."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from cyclofeat.cli._options import FILES, Arguments, Parser, Printed, note

_MOST_DRAWN, _SIZE = 12, (9.0, 3.6)  # inches


def add_arguments(parser: Parser) -> None:
    parser.add_argument("files", nargs="+", metavar="FILE", help=FILES)
    what = f"page to write, on which one can zoom the recordings (the first {_MOST_DRAWN})"
    parser.add_target("--report", "page", metavar="FILE.html", help=what)
    parser.add_reading_options()


def run(arguments: Arguments) -> Iterator[Printed]:
    from cyclofeat.datasets import describe
    from cyclofeat.datasets.readers import list_channels

    report = None
    if arguments.report:
        from cyclofeat.report import Report

        report = Report("Recordings")
    options, drawn, files = arguments.reading_arguments(), 0, arguments.files
    for result in arguments.process_files("inspecting", files, lambda _, one: (describe(one), one)):
        channels: dict[str, str | None] = {}  # none where the file cannot be opened
        with contextlib.suppress(Exception):
            channels = list_channels(result.entry.path, **options)
        if result.value is None:
            yield result.format_result(facts={"channels": channels})
            if report is not None:
                report.add_heading(str(result.entry.path)).add_text(result.error)
            continue
        facts, recording = result.value
        lines = [f"started:   {facts['start_time']} (UTC)"] if facts["start_time"] else []
        lines += [f"table:     {facts['table']}"] if facts["table"] else []
        others = [
            f"{name} ({unit})" if unit and f"({unit})" not in name else name
            for name, unit in channels.items()
        ]
        if len(others) > 1:
            lines.append(f"channels:  {', '.join(others)}")
        lines.append(f"speed:     {_speed_text(facts)}")
        if facts["output_turns"] is not None:
            lines.append(f"length:    {facts['output_turns']:.3g} output turns")
        lines.append(f"clipped:   {100 * facts['clipped_share']:.3g} %")
        lines.append(f"dropouts:  {100 * facts['dropout_share']:.3g} %")
        lines += [f"warning:   {warning}" for warning in facts["warnings"]]
        yield result.format_result(lines, {**facts, "channels": channels})
        drawn += 1
        if report is not None and drawn <= _MOST_DRAWN:
            report.add_heading(str(result.entry.path)).add_text("\n\n".join(lines))
            report.add_figure(recording, size=_SIZE).add(recording)
    if report is not None:
        note(f"report: {report.write(arguments.report)}")


def _speed_text(facts: dict[str, Any]) -> str:
    nominal, measured = facts["speed_rpm"], facts["speed_measured_rpm"]
    if measured is None and nominal is None:
        return "unknown"
    if measured is None:
        return f"nominal {nominal:g} RPM; no lobe lines near it: sound, another speed or no gear signal"
    by = f"{measured:.5g} RPM by its {facts['speed_from']}"
    if nominal is None:
        return by
    return f"{by}, {100 * facts['speed_deviation']:+z.2f} % against the nominal {nominal:g} RPM"
