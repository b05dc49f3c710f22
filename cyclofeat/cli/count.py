"""``cyclofeat count``: the worn lobes of recordings."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cyclofeat._base.files import name_in_errors
from cyclofeat._base.progress import Progress
from cyclofeat._base.quantities import lobes_text, number_of
from cyclofeat.cli._options import (
    FILES,
    FileResult,
    add_model_options,
    add_reading_options,
    add_target,
    count_with_warnings,
    each_recording,
    list_entries,
    model_name,
    read_model,
    reading_arguments,
    without_start,
)
from cyclofeat.cli._printing import Printed, note
from cyclofeat.cli.history import add_history_options, history_writer

if TYPE_CHECKING:
    from cyclofeat.counting import LobeCount
    from cyclofeat.history import GearboxState
    from cyclofeat.recordings import Recording

COLUMNS = (
    "file", "defect_count", "probability", "worn_lobes_from_1", "lobes_absolute", "refused",
    "refused_defect_count", "reason", "n_windows", "distance", "warnings", "error",
    "wear_um", "wear_um_low", "wear_um_high",
)  # fmt: skip


class Counted(NamedTuple):
    """Answer for one recording, length of a window, and time at the end that fills no window (both in s).

    With a history, also the state of its gearbox.
    """

    answer: LobeCount
    window: float
    unused: float
    state: GearboxState | None = None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", metavar="FILE", help=FILES)
    add_model_options(parser)
    add_target(
        parser, "--report", "page", metavar="FILE.html", help="page to write: the counts and their evidence"
    )
    add_target(parser, "--csv", metavar="FILE.csv", help="table to write: one row per recording")
    parser.add_argument("--strict", action="store_true", help="exit with code 3 if a recording is refused")
    add_history_options(parser, "")
    add_reading_options(parser)


def run(arguments: argparse.Namespace) -> Iterator[FileResult[Counted]]:
    """Count file by file, with a row of the table each, then write the report."""
    model = read_model(arguments)
    files, options = list_entries(arguments.files), reading_arguments(arguments)

    results = []
    add_row = count_table(arguments.csv)
    with history_writer(arguments, model) as writer:

        def counted_of(path: Path, recording: Recording) -> Counted:
            recording = without_start(recording, arguments.skip)
            count = count_with_warnings(model, recording)
            first, last = count.windows[0], count.windows[-1]
            # Rounding of a window to whole samples leaves a residue that is no time.
            unused = max(0.0, round(recording.duration - last.stop_s, 6))
            counted = Counted(count, round(first.stop_s - first.start_s, 9), unused)
            if writer is None:
                return counted
            name = writer.add(path, recording, count)
            writer.history.write()
            return counted._replace(state=writer.state(name))

        for result in each_recording("counting", files, options, counted_of):
            results.append(result)
            add_row(result, result.value and result.value.answer)
            yield result
    if arguments.csv:
        note(f"table: {arguments.csv}")
    if not arguments.report:
        return
    from cyclofeat.report import CountedRecording, write_count_report

    settings = {"model": model_name(arguments)}
    if arguments.skip:
        settings["left out at the start"] = f"{arguments.skip:g} s"
    # Read again, one at a time: all recordings together may be larger than memory.
    counted = (
        CountedRecording(
            str(file.path), without_start(file.read(**options), arguments.skip), result.value.answer
        )
        for file, result in zip(files, results, strict=True)
        if result.value is not None
    )
    failures = {str(result.path): result.error for result in results if result.error}
    with Progress("writing the report"):
        path = write_count_report(model, counted, arguments.report, failures=failures, settings=settings)
    note(f"report: {path}")


def count_table(path: str | None) -> Callable[[FileResult[Any], LobeCount | None], None]:
    """Begin the table of counts, and return the function that adds a row; without a path it does nothing."""
    if path is None:
        return lambda result, count: None

    def write_row(mode: str, row: dict[str, Any]) -> None:
        # Opened for each row: what is counted stays, whatever comes. The mark at the beginning tells
        # spreadsheets that the file is UTF-8.
        with name_in_errors(path), open(path, mode, encoding="utf-8-sig", newline="") as stream:
            csv.DictWriter(stream, COLUMNS, extrasaction="ignore").writerow(row)

    def add_count(result: FileResult[Any], count: LobeCount | None) -> None:
        row: dict[str, Any] = {"file": str(result.path), "error": result.error}
        if count is not None:
            row |= count.to_dict()
            row["probability"] = f"{count.probability[count.defect_count]:.6g}"
            row["worn_lobes_from_1"] = " ".join(map(str, row["worn_lobes_from_1"]))
            row["warnings"] = "; ".join(count.warnings)
        write_row("a", row)

    write_row("w", {column: column for column in COLUMNS})
    return add_count


def format_result(arguments: argparse.Namespace, result: FileResult[Counted]) -> Printed:
    if result.value is None:
        return result.format_result()
    count, window, unused, state = result.value
    answer = f"{count.defect_count} (probability {count.probability[count.defect_count]:.2f})"
    lines = [f"worn lobes: {answer}"]
    if count.refused:
        lines = [f"refused:    {count.reason}", f"would be:   {answer}"]
    elif count.lobes:
        lines.append(f"positions:  {lobes_text(count.lobes)} (counted from 1)")
    if count.wear_um is not None:
        lines.append(f"wear:       {count.wear_um}")
    length = f"one output turn ({window:.4g} s)"
    lines.append(f"from {number_of(count.n_windows, 'window')} of {length}, {unused:.3g} s unused")
    lines += [f"note: {warning}" for warning in count.warnings]
    facts = {**count.to_dict(), "model": model_name(arguments), "window_s": window, "unused_s": unused}
    facts["windows"] = [one.to_dict() for one in count.windows]
    if state is not None:
        lines.append(f"{state.gearbox}: {state}")
        facts |= {"gearbox": state.gearbox, "alarm": state.alarm, "history": state.to_dict()}
    return result.format_result(lines, facts, refused=count.refused and arguments.strict)
