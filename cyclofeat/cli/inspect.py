"""``cyclofeat inspect``: the content of recordings, and what in it would spoil a count."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from typing import Any

from cyclofeat._base.quantities import number_of
from cyclofeat.cli._options import (
    FILES,
    Printed,
    add_reading_options,
    list_entries,
    process_files,
    reading_arguments,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", metavar="FILE", help=FILES)
    add_reading_options(parser)


def run(arguments: argparse.Namespace) -> Iterator[Printed]:
    from cyclofeat.datasets import describe
    from cyclofeat.datasets.readers import list_channels

    files = list_entries(arguments.files)
    options = reading_arguments(arguments)
    for result in process_files("inspecting", files, arguments, lambda _, recording: describe(recording)):
        facts = result.value
        channels: dict[str, str | None] = {}  # none where the file cannot be opened
        with contextlib.suppress(Exception):
            channels = list_channels(result.path, **options)
        if facts is None:
            yield result.format_result(facts={"channels": channels})
            continue
        lines = [f"started:   {facts['start_time']} (UTC)"] if facts["start_time"] else []
        lines += [f"table:     {facts['table']}"] if facts["table"] else []
        others = [name if unit is None else f"{name} ({unit})" for name, unit in channels.items()]
        if len(others) > 1:
            lines.append(f"channels:  {', '.join(others)}")
        lines.append(f"speed:     {_speed_text(facts)}")
        if facts["output_turns"] is not None:
            turns = number_of(facts["whole_output_turns"], "whole output turn")
            lines.append(f"length:    {turns}, {facts['unused_s']:.3g} s left over")
        lines.append(f"clipped:   {100 * facts['clipped_share']:.3g} %")
        lines.append(f"dropouts:  {100 * facts['dropout_share']:.3g} %")
        lines += [f"warning:   {warning}" for warning in facts["warnings"]]
        yield result.format_result(lines, {**facts, "channels": channels})


def _speed_text(facts: dict[str, Any]) -> str:
    nominal, measured = facts["speed_rpm"], facts["speed_measured_rpm"]
    if measured is None:
        if nominal is None:
            return "unknown"
        return (
            f"nominal {nominal:g} RPM; no lobe lines near it: a healthy disc, another speed or no gear signal"
        )
    by = f"{measured:.5g} RPM by its {facts['speed_from']}"
    if nominal is None:
        return by
    return f"{by}, {100 * facts['speed_deviation']:+.2f} % against the nominal {nominal:g} RPM"
