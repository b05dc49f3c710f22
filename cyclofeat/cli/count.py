"""``cyclofeat count``: the worn lobes of recordings."""

from __future__ import annotations

import argparse
import contextlib
import csv
import itertools
import operator
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from cyclofeat._base.files import name_in_errors
from cyclofeat._base.progress import Progress
from cyclofeat._base.quantities import QUANTITIES, lobes_text, number_of, probability_text
from cyclofeat.cli._options import (
    FILES,
    FileResult,
    Printed,
    add_history_options,
    add_model_options,
    add_reading_options,
    add_target,
    count_with_warnings,
    list_entries,
    model_chooser,
    model_name,
    note,
    process_files,
    reading_arguments,
    without_start,
)
from cyclofeat.cli.history import history_writer

if TYPE_CHECKING:
    from cyclofeat.counting import LobeCount, LobeModel
    from cyclofeat.history import GearboxState
    from cyclofeat.recordings import Recording

# Answer for a recording, length in s, state of its gearbox where there is a history, and quantity.
Counted: TypeAlias = "tuple[LobeCount, float, GearboxState | None, str]"
COLUMNS = (
    "file", "defect_count", "probability", "worn_lobes_from_1", "lobes_absolute", "refused",
    "refused_defect_count", "reason", "n_windows", "distance", "warnings", "error",
    "wear_um", "wear_um_low", "wear_um_high",
)  # fmt: skip


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


def run(arguments: argparse.Namespace) -> Iterator[Printed]:
    """Count file by file, with a row of the table each, then write the report."""
    model_of = model_chooser(arguments)
    entries = list_entries(arguments.files)
    results: list[FileResult[Counted]] = []
    if arguments.csv:
        _write_row(arguments.csv, "w", {column: column for column in COLUMNS})
    with history_writer(arguments) if arguments.history else contextlib.nullcontext() as writer:

        def count_file(path: Path, recording: Recording) -> Counted:
            recording = without_start(recording, arguments.skip)
            model, state = model_of(recording.quantity), None
            count = count_with_warnings(model, recording)
            if writer is not None:
                name = writer.add(path, recording, count, model)
                writer.history.write()
                state = writer.state(name)
            return count, recording.duration, state, recording.quantity

        for result in process_files("counting", entries, arguments, count_file):
            results.append(result)
            if arguments.csv:
                row: dict[str, Any] = {"file": str(result.path), "error": result.error}
                if result.value is not None:
                    count = result.value[0]
                    row |= count.to_dict()
                    row["probability"] = f"{count.probability[count.defect_count]:.6g}"
                    row["worn_lobes_from_1"] = " ".join(map(str, row["worn_lobes_from_1"]))
                    row["warnings"] = "; ".join(count.warnings)
                _write_row(arguments.csv, "a", row)
            yield _print_count(arguments, result, model_of)
    if arguments.csv:
        note(f"table: {arguments.csv}")
    if not arguments.report:
        return
    from cyclofeat.report import CountedRecording, write_count_report

    quantities = dict.fromkeys(one.value[3] for one in results if one.value is not None)
    quantities = quantities or {arguments.quantity or QUANTITIES[0]: None}
    settings = {"model": ", ".join(dict.fromkeys(model_name(arguments, each) for each in quantities))}
    if arguments.skip:
        settings["left out at the start"] = f"{arguments.skip:g} s"
    # Read again, one at a time: all recordings together may be larger than memory.
    options = reading_arguments(arguments)
    done = [(one.entry, one.number, one.value) for one in results if one.value is not None]
    counted = (
        CountedRecording(
            str(entry.path), without_start(recordings[number], arguments.skip), count, model_of(quantity)
        )
        for entry, of_file in itertools.groupby(done, operator.itemgetter(0))
        for recordings in [entry.read(**options)]
        for _, number, (count, _, _, quantity) in of_file
    )
    failures = {str(result.path): result.error for result in results if result.error}
    with Progress("writing the report"):
        model = model_of(next(iter(quantities)))
        path = write_count_report(model, counted, arguments.report, failures=failures, settings=settings)
    note(f"report: {path}")


def _write_row(path: str, mode: str, row: dict[str, Any]) -> None:
    # Opened for each row: what is counted stays, whatever comes. The mark at the beginning tells spreadsheets
    # that the file is UTF-8.
    with name_in_errors(path), open(path, mode, encoding="utf-8-sig", newline="") as stream:
        csv.DictWriter(stream, COLUMNS, extrasaction="ignore").writerow(row)


def _print_count(
    arguments: argparse.Namespace, result: FileResult[Counted], model_of: Callable[[str], LobeModel]
) -> Printed:
    if result.value is None:
        return result.format_result()
    count, duration, state, quantity = result.value
    first, last = count.windows[0], count.windows[-1]
    window = round(first.stop_s - first.start_s, 9)
    # Rounding of a window to whole samples leaves a residue that is no time.
    unused = max(0.0, round(duration - last.stop_s, 6))
    name, _, description = result.title.partition(": ")
    probability = probability_text(count.probability[count.defect_count])
    answer = f"{number_of(count.defect_count, 'worn lobe')} (probability {probability})"
    lines = []
    if count.refused:
        lines = [f"it would be {answer}"]
        answer = f"refused: {count.reason}"
    elif count.lobes:
        lines = [f"positions: {lobes_text(count.lobes, len(count.lobe_probability))} (counted from 1)"]
    if count.wear_um is not None:
        lines.append(f"wear: {count.wear_um}")
    length = number_of(model_of(quantity).windower_.output_turns, "output turn")
    windows = f"{number_of(count.n_windows, 'window')} of {length} ({window:.3g} s)"
    lines.append(f"from {windows}, {unused:.3g} s unused")
    lines += [f"note: {warning}" for warning in count.warnings]
    facts = {
        **count.to_dict(),
        "model": model_name(arguments, quantity),
        "window_s": window,
        "unused_s": unused,
    }
    facts["windows"] = [window.to_dict() for window in count.windows]
    if state is not None:
        lines.append(f"{state.gearbox}: {state}")
        facts |= {"gearbox": state.gearbox, "alarm": state.alarm, "history": state.to_dict()}
    lines.append(f"recording: {description}")
    answered = replace(result, title=f"{name}: {answer}")
    return answered.format_result(lines, facts, refused=count.refused and arguments.strict)
