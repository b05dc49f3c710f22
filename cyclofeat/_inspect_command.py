"""``cyclofeat inspect``: what a recording holds, and what in it would spoil a count."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from cyclofeat._reading import FILES, add_reading_options, entries, in_options, reading_arguments, titled

TEXT = "show what recordings hold, and what in them would spoil a count"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``inspect``."""
    parser.add_argument("files", nargs="+", metavar="FILE", help=FILES)
    add_reading_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Describe each file; 2 if one of them cannot be read."""
    from cyclofeat.datasets import describe

    results: list[dict[str, Any]] = []
    failed = False
    options = reading_arguments(arguments)
    for entry in entries(arguments.files):
        path = str(entry.path)
        try:
            recording = entry.read(**options)
            results.append(describe(recording) | {"file": path})
        except (ValueError, TypeError, OSError, ImportError) as error:
            failed = True
            message = in_options(" ".join(str(error).split()))
            results.append({"file": path, "error": message})
            print(f"cyclofeat: error: {message}", file=sys.stderr)
            continue
        if not arguments.json:
            print(titled(path, recording))
            print(described(results[-1]))
    if arguments.json:
        print(json.dumps(results, indent=2))
    return 2 if failed else 0


def described(found: dict[str, Any]) -> str:
    """A description for people, one fact per line."""
    lines = []
    if found["start_time"]:
        lines.append(f"started:   {found['start_time']} (UTC)")
    nominal, measured = found["speed_rpm"], found["speed_measured_rpm"]
    if measured is not None:
        text = f"{measured:.5g} RPM by its {found['speed_from']}"
        if nominal is not None:
            text += f", {100 * found['speed_deviation']:+.2f} % against the nominal {nominal:g} RPM"
    else:
        text = "unknown" if nominal is None else f"nominal {nominal:g} RPM, not to be seen in the record"
    lines.append(f"speed:     {text}")
    if found["output_turns"] is not None:
        whole = found["whole_output_turns"]
        turns = f"{whole} whole output turn{'' if whole == 1 else 's'}"
        lines.append(f"length:    {turns}, {found['unused_s']:.3g} s left over")
    lines.append(f"clipped:   {100 * found['clipped_share']:.3g} %")
    lines.append(f"dropouts:  {100 * found['dropout_share']:.3g} %")
    lines += [f"warning:   {warning}" for warning in found["warnings"]]
    return "\n".join(f"  {line}" for line in lines)
