"""``cyclofeat count``: the worn lobes of recordings."""

from __future__ import annotations

import csv
import itertools
import operator
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat._base.files import name_in_errors
from cyclofeat._base.quantities import QUANTITIES, lobes_text, number_of, probability_text
from cyclofeat.cli._options import FILES, Arguments, FileResult, Parser, Printed, note

if TYPE_CHECKING:
    from cyclofeat.counting import LobeCount, LobeModel
    from cyclofeat.history import History
    from cyclofeat.recordings import Recording

COLUMNS = (
    "file", "defect_count", "probability", "worn_lobes_from_1", "lobes_absolute", "refused",
    "refused_defect_count", "reason", "n_windows", "distance", "warnings", "error",
    "wear_um", "wear_um_low", "wear_um_high",
)  # fmt: skip


@dataclass
class Counted:
    """Answer for a recording of a quantity: in lines, with what supports it, and as values for JSON."""

    count: LobeCount
    quantity: str
    lines: list[str]
    facts: dict[str, Any]
    stated: int | None  # count that the file states
    gearbox: str = ""  # of which there is a history


class RecordingCounter(ExitStack):
    """Counts recordings as the options of ``count`` and ``watch`` state, and keeps the counts in a history.

    The gearbox is that of the options, else the assembly that a file states, else the one of this name.
    """

    def __init__(self, arguments: Arguments, default_gearbox: str = "") -> None:
        if arguments.gearbox == "":
            raise ValueError("--gearbox must be a name, got an empty one")
        super().__init__()
        self.arguments, self.default_gearbox = arguments, default_gearbox
        self._models: dict[str, LobeModel] = {}
        if arguments.model is not None:
            self.model_of("")  # or its error now
        self.history: History | None = None
        if arguments.history:
            from cyclofeat.history import History

            self.history = self.enter_context(History(arguments.history))

    def model_of(self, quantity: str) -> LobeModel:
        """Return the model that the options name, or the packaged one of a quantity."""
        name = quantity if self.arguments.model is None else ""
        if name not in self._models:
            self._models[name] = self.arguments.read_model(name)
        return self._models[name]

    def without_start(self, recording: Recording) -> Recording:
        skip = self.arguments.skip
        if not 0 <= skip < recording.duration:
            raise ValueError(f"--skip must lie within the {recording.duration:g} s recorded, got {skip:g} s")
        return recording.crop(skip) if skip else recording

    def count(self, path: Path, recording: Recording) -> Counted:
        """Count a recording of a file; warnings about the record itself follow those of the count."""
        from cyclofeat.datasets.readers import record_warnings

        recording = self.without_start(recording)
        model = self.model_of(recording.quantity)
        count = model.count(recording)
        of_record = record_warnings(recording.replace(n_lobes=model.n_lobes_))
        count = replace(count, warnings=(*count.warnings, *of_record))
        first, last = count.windows[0], count.windows[-1]
        window = round(first.stop_s - first.start_s, 9)
        # Rounding of a window to whole samples leaves a residue that is no time.
        unused = max(0.0, round(recording.duration - last.stop_s, 6))
        probability = probability_text(count.probability[count.defect_count])
        lines = [f"{number_of(count.defect_count, 'worn lobe')} (probability {probability})"]
        if count.refused:
            lines = [f"refused: {count.reason}", f"it would be {lines[0]}"]
        elif count.lobes:
            lobes = lobes_text(count.lobes, len(count.lobe_probability))
            lines.append(f"positions: {lobes} (counted from 1)")
        if count.wear_um is not None:
            lines.append(f"wear: {count.wear_um}")
        turns = number_of(model.windower_.output_turns, "output turn")
        windows = f"{number_of(count.n_windows, 'window')} of {turns}"
        lines.append(f"from {windows} ({window:.3g} s), {unused:.3g} s unused")
        lines += [f"note: {warning}" for warning in count.warnings]
        facts = count.to_dict() | {
            "model": self.arguments.model_name(recording.quantity),
            "window_s": window,
            "unused_s": unused,
            "windows": [window.to_dict() for window in count.windows],
        }
        counted = Counted(count, recording.quantity, lines, facts, recording.defect_count)
        if self.history is not None:
            assembly = self.default_gearbox if recording.assembly is None else str(recording.assembly)
            counted.gearbox = self.arguments.gearbox or assembly
            if not counted.gearbox:
                raise ValueError("the file states no assembly: give --gearbox NAME with --history")
            time = _start_time(path, recording)
            self.history.add(counted.gearbox, str(path.resolve()), time, count, recording, model.card_)
        return counted

    def write(self, counted: Counted | None = None) -> None:
        """Write the history, and state the gearbox of a count by it."""
        if self.history is not None:
            self.history.write()
            if counted is not None:
                state = self.history.state(counted.gearbox, **self.arguments.alarm_rates())
                counted.lines.append(f"{counted.gearbox}: {state}")
                kept = {"gearbox": counted.gearbox, "alarm": state.alarm, "history": state.to_dict()}
                counted.facts |= kept


def _start_time(path: Path, recording: Recording) -> float:
    """Return when a recording began in s since 1970: as stated, else the time of the file's last change."""
    stated = (recording.meta or {}).get("start_time")
    if stated is None:
        return path.stat().st_mtime
    try:
        start = datetime.fromisoformat(stated)
    except (TypeError, ValueError):
        raise ValueError(
            "meta's start_time must be a time as 2026-03-01T14:30:00 (UTC, unless it states an offset), got "
            f"{stated!r}"
        ) from None
    return (start if start.tzinfo else start.replace(tzinfo=UTC)).timestamp()


def add_arguments(parser: Parser) -> None:
    parser.add_argument("files", nargs="+", metavar="FILE", help=FILES)
    parser.add_model_options()
    parser.add_target(
        "--report", "page", metavar="FILE.html", help="page to write: the counts and their evidence"
    )
    parser.add_target("--csv", metavar="FILE.csv", help="table to write: one row per recording")
    parser.add_argument("--strict", action="store_true", help="exit with code 3 if a recording is refused")
    parser.add_history_options("")
    parser.add_reading_options()


def run(arguments: Arguments) -> Iterator[Printed]:
    """Count file by file, with a row of the table each, then write the report."""
    results: list[FileResult[Counted]] = []
    if arguments.csv:
        _write_row(arguments.csv, "w", {column: column for column in COLUMNS})
    with RecordingCounter(arguments) as counter:

        def count_file(path: Path, recording: Recording) -> Counted:
            counted = counter.count(path, recording)
            counter.write(counted)
            return counted

        for result in arguments.process_files("counting", arguments.files, count_file):
            results.append(result)
            if arguments.csv:
                row: dict[str, Any] = {"file": str(result.entry.path), "error": result.error}
                if result.value is not None:
                    count = result.value.count
                    row |= count.to_dict()
                    row["probability"] = f"{count.probability[count.defect_count]:.6g}"
                    row["worn_lobes_from_1"] = " ".join(map(str, row["worn_lobes_from_1"]))
                    row["warnings"] = "; ".join(count.warnings)
                _write_row(arguments.csv, "a", row)
            if result.value is None:
                yield result.format_result()
                continue
            answer, *lines = result.value.lines
            name, _, description = result.title.partition(": ")
            yield replace(result, title=f"{name}: {answer}").format_result(
                [*lines, f"recording: {description}"], result.value.facts,
                refused=result.value.count.refused and arguments.strict,
            )  # fmt: skip
    if len(results) > 1:
        note(_summarise(results))
    if arguments.csv:
        note(f"table: {arguments.csv}")
    if arguments.report:
        _write_report(results, counter)


def _summarise(results: Sequence[FileResult[Counted]]) -> str:
    """Return how many recordings were counted, how many of them as stated, and what became of the others."""
    done = [result.value for result in results if result.value is not None]
    counted = [one for one in done if not one.count.refused]
    labelled = [one for one in counted if one.stated is not None]
    right = sum(one.stated == one.count.defect_count for one in labelled)
    parts = {
        "counted": len(counted),
        f"of {len(labelled)} as stated": right if labelled else None,
        "refused": len(done) - len(counted) or None,
        "with an error": len(results) - len(done) or None,
    }
    texts = [f"{n} {what}" for what, n in parts.items() if n is not None]
    return f"{number_of(len(results), 'recording')}: {', '.join(texts)}"


def _write_report(results: list[FileResult[Counted]], counter: RecordingCounter) -> None:
    from cyclofeat.report import CountedRecording, write_count_report

    arguments = counter.arguments
    done = [(one.entry, one.number, one.value) for one in results if one.value is not None]
    quantities = [one.quantity for _, _, one in done] or [arguments.quantity or QUANTITIES[0]]
    settings = {"model": ", ".join(dict.fromkeys(arguments.model_name(each) for each in quantities))}
    if arguments.skip:
        settings["left out at the start"] = f"{arguments.skip:g} s"
    # Read again, one at a time: all recordings together may be larger than memory.
    options = arguments.reading_arguments()
    counted = (
        CountedRecording(
            str(entry.path), counter.without_start(recordings[number]), one.count,
            counter.model_of(one.quantity),
        )
        for entry, of_file in itertools.groupby(done, operator.itemgetter(0))
        for recordings in [entry.read(**options)]
        for _, number, one in of_file
    )  # fmt: skip
    failures = {str(result.entry.path): result.error for result in results if result.error}
    counted_by = counter.model_of(quantities[0])
    arguments.write_report(write_count_report, counted_by, counted, failures=failures, settings=settings)


def _write_row(path: str, mode: str, row: dict[str, Any]) -> None:
    # Opened for each row: what is counted stays, whatever comes. The mark at the beginning tells spreadsheets
    # that the file is UTF-8.
    with name_in_errors(path), open(path, mode, encoding="utf-8-sig", newline="") as stream:
        csv.DictWriter(stream, COLUMNS, extrasaction="ignore").writerow(row)
