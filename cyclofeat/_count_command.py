"""``cyclofeat count``: the worn lobes of recordings, for people, for programs, and as a report."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from cyclofeat import _watch_command
from cyclofeat._reading import FILES, add_reading_options, entries, in_options, reading_arguments, titled

if TYPE_CHECKING:
    from cyclofeat.counting import LobeCount, LobeModel
    from cyclofeat.recording import Recording
    from cyclofeat.report import CountedRecording

TEXT = "count the worn lobes of recordings"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``count``."""
    parser.add_argument("files", nargs="+", metavar="FILE", help=FILES)
    _watch_command.add_model_options(parser)
    parser.add_argument("--report", metavar="FILE.html", help="write what was counted, and on what grounds")
    add_reading_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Count each file; 2 if one of them could not be."""
    model = _watch_command.read_model(arguments)
    target = None
    if arguments.report:
        from cyclofeat.report._page import target_of

        target = target_of(arguments.report)  # found out now rather than after the counts
    results: list[dict[str, Any]] = []
    counted = _counted(arguments, model, results)
    if target is None:
        for _ in counted:
            pass
    else:
        _write_report(arguments, model, counted, results)
    if arguments.json:
        print(json.dumps(results, indent=2))
    return 2 if any("error" in result for result in results) else 0


def _counted(
    arguments: argparse.Namespace, model: LobeModel, results: list[dict[str, Any]]
) -> Iterator[tuple[str, Recording, LobeCount]]:
    """Count file by file, print and enter the results; what was counted, one at a time."""
    options = reading_arguments(arguments)
    for entry in entries(arguments.files):
        path = str(entry.path)
        # One bad file must not cost the others their result.
        try:
            recording = entry.read(**options)
            if not arguments.json:
                print(titled(path, recording))
            recording = _watch_command.without_start(recording, arguments.skip)
            result = model.count(recording)
        except (ValueError, TypeError, OSError, ImportError) as error:
            message = in_options(" ".join(str(error).split()))
            results.append({"file": path, "error": message})
            shown = message if message.startswith(path) else f"{path}: {message}"
            print(f"cyclofeat: error: {shown}", file=sys.stderr)
            continue
        # Rounded: the speed in turns per second is no round number.
        turn = round(model.n_lobes / model.input_speed_hz, 9)
        # Rounding of a window to whole samples leaves a residue that is no time.
        unused = max(0.0, round(recording.duration - result.n_windows * turn, 6))
        results.append({"file": path, **result.to_dict(), "window_s": turn, "unused_s": unused})
        if not arguments.json:
            print(text_of(results[-1]))
        yield path, recording, result


def _write_report(
    arguments: argparse.Namespace,
    model: LobeModel,
    counted: Iterable[tuple[str, Recording, LobeCount]],
    results: list[dict[str, Any]],
) -> None:
    from cyclofeat.report import CountedRecording, write_count_report

    settings = {"model file": arguments.model}
    if arguments.skip:
        settings["left out at the start"] = f"{arguments.skip:g} s"
    failures: dict[str, str] = {}

    def shown() -> Iterator[CountedRecording]:
        for path, recording, result in counted:
            yield CountedRecording(path, recording, result)
        failures.update((result["file"], result["error"]) for result in results if "error" in result)

    path = write_count_report(arguments.report, model, shown(), failures=failures, settings=settings)
    print(f"report: {path}", file=sys.stderr)


def text_of(result: dict[str, Any]) -> str:
    """A result for people, one fact per line."""
    count = result["defect_count"]
    refused = f", refused: {result['reason']}" if result["refused"] else ""
    lines = [f"worn lobes: {count} (probability {result['probability'][str(count)]:.2f}){refused}"]
    if result["lobes"]:
        # People count from 1.
        lines.append(f"positions:  {', '.join(str(lobe + 1) for lobe in result['lobes'])} (counted from 1)")
    windows = f"{result['n_windows']} window{'' if result['n_windows'] == 1 else 's'}"
    length = f"one output turn ({result['window_s']:.4g} s)"
    lines.append(f"from {windows} of {length}, {result['unused_s']:.3g} s unused")
    lines += [f"note: {warning}" for warning in result["warnings"]]
    return "\n".join(f"  {line}" for line in lines)
