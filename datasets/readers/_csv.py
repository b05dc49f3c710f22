"""Readers of text in any encoding, packed with gzip or not, and of Excel workbooks; writer of CSV files."""

from __future__ import annotations

import codecs
import datetime
import gzip
import io
import json
import re
import warnings
import zipfile
from array import array
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from importlib import import_module
from itertools import islice, takewhile
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.quantities import number_of
from cyclofeat.datasets.readers._columns import (
    FILE_LABELS,
    FORMAT,
    LABELS,
    VERSION,
    Channel,
    ReadingOptions,
    Source,
    check_rate,
    check_unpacked,
    explain_damage,
    import_library,
    labels_of_file,
    samples_name,
)
from cyclofeat.datasets.readers._table import HEAD_LINES, Table, find_table, parse_clock, split_row
from cyclofeat.datasets.readers._times import named_rate
from cyclofeat.recordings import Recording

_LONGEST_LINE = 2**20  # a longer one is no row of samples, and splitting it would take long
_BLOCK = 2**20
# Those of UTF-32 first: that of UTF-16 begins one of them.
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
)  # fmt: skip
# Without a mark; the second is Latin-1 as Windows writes it, with five bytes undefined.
_UNMARKED = ("utf-8", "cp1252")
_REMEDY = "save it as text in UTF-8"

_PART = 2048  # rows that are split at a time
_LONG_FILE = 2**20
_THOUSANDS = (
    "does the mark separate thousands, or decimals? Give decimal=',' or decimal='.', the mark of the decimals"
)


class TextLines:
    r"""Lines of a file without their ends, read anew by each iteration and never all at once.

    In UTF-8, UTF-16 or UTF-32 with a byte-order mark, or Latin-1; lines end with ``\n``, ``\r\n`` or ``\r``.
    Empty lines at the end are left out. ``ValueError`` if the file is in none of these encodings, unpacks to
    too much, or begins with an endless line.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.packed = path.suffix.lower() == ".gz"
        with self._open_bytes() as file:
            start = file.read(_LONGEST_LINE + 1)
        if len(start) > _LONGEST_LINE and b"\n" not in start and b"\r" not in start:
            raise ValueError(
                f"{path.name} is no CSV file of samples: its first line is longer than {_LONGEST_LINE} "
                "characters; one row per sample is right"
            )
        marked = next((encoding for mark, encoding in _MARKS if start.startswith(mark)), None)
        wrong = 0
        for self.encoding in _UNMARKED if marked is None else (marked,):
            decoder, size, block = codecs.getincrementaldecoder(self.encoding)(), 0, b" "
            with self._open_bytes() as file:
                while block:
                    block = file.read(_BLOCK)
                    size += len(block)
                    if self.packed:
                        check_unpacked(path, size)
                    if marked is None and b"\0" in block:
                        raise ValueError(
                            f"{path.name} holds binary data, or UTF-16 without a byte-order mark; {_REMEDY}"
                        )
                    if marked is None and block.isascii() and not decoder.getstate()[0]:
                        continue
                    try:
                        decoder.decode(block, final=not block)
                    except UnicodeDecodeError as error:
                        wrong = size - len(error.object) + error.start
                        break
                else:
                    return
        known = marked or "UTF-8, Latin-1, or UTF-16 with a byte-order mark"
        raise ValueError(f"{path.name} is not text in {known} (byte {wrong}); {_REMEDY}")

    def __iter__(self) -> Iterator[str]:
        empty = 0
        with self._open_bytes() as file, io.TextIOWrapper(file, self.encoding) as lines:
            for line in lines:
                if line.isspace() or line.rstrip() == "EOF":  # as TwinCAT Scope ends a file
                    empty += 1
                    continue
                if empty:
                    yield from [""] * empty
                    empty = 0
                yield line.removesuffix("\n")

    @contextmanager
    def _open_bytes(self) -> Iterator[IO[bytes]]:
        if not self.packed:
            with self.path.open("rb") as file:
                yield file
            return
        with explain_damage(self.path, "gzip"), gzip.open(self.path) as packed:
            yield cast("IO[bytes]", packed)


def open_text(path: Path, reading: ReadingOptions) -> Source:
    """Return the columns of a text file."""
    lines = TextLines(path)
    if not any(re.match(r"Multi_Headings\s+Yes", line) for line in islice(lines, HEAD_LINES)):
        return open_lines(path, reading, lines, "line {}")
    rows, segments = _join_segments(lines)
    if len(segments) > 1 and reading.gaps != "cut" and reading.sampling_rate is None:
        raise ValueError(
            f"{path.name} holds {len(segments)} segments, each with a head: give gaps='cut' to read each by "
            "itself, or sampling_rate= to read them as one"
        )
    source = open_lines(path, reading, rows, "line {} (heads of later segments not counted)")
    if len(segments) > 1:
        for channel in source.channels:
            channel.segments = lambda: segments
    return source


def _join_segments(lines: Iterable[str]) -> tuple[list[str], list[tuple[int, float]]]:
    """Return a LabVIEW file's lines without the heads of later segments, and where segments begin.

    With the first sample of each segment stands its rate, 0 where the head states none.
    """
    rows, begins, rates = list[str](), list[int](), list[float]()
    head = False
    for line in lines:
        if line.startswith("Channels\t"):
            head = True
            rates.append(0.0)
        if line.startswith("Delta_X\t"):
            rates[-1] = named_rate("dt", float(line.split("\t")[1].replace(",", "."))) or 0.0
        if not (head and begins) and (line.strip() or not begins):
            rows.append(line)
        if head and line.startswith("X_Value"):
            head = False
            begins.append(len(rows))
    return rows, [(begin - begins[0], rate) for begin, rate in zip(begins, rates, strict=False)]


def open_lines(path: Path, reading: ReadingOptions, lines: Iterable[str], place: str) -> Source:
    """Return the columns of lines that can be read several times; ``place`` is what messages call a line."""
    head = list(islice(lines, HEAD_LINES))
    labels = labels_from_comments(path.name, takewhile(lambda line: line.startswith("#"), head))
    table = find_table(head, path.name, reading)
    is_text = isinstance(lines, TextLines)  # in which a point may separate thousands
    certain = labels is not None or reading.decimal is not None or not is_text
    columns = _Columns(path, lines, table, place, certain, reading.decimal is not None)
    length = None if is_text else len(list(lines)) - table.first
    channels = [
        Channel(
            name, partial(columns.read, index), unit, usable=index in table.numeric, rates=table.rates,
            length=length, meta=columns.meta, place=columns.place,
        )
        for index, (name, unit) in enumerate(zip(columns.names, table.units, strict=True))
    ]  # fmt: skip
    return Source(path.name, channels, "column", named=table.names is not None, labels=labels)


class _Columns:
    """Columns of a table in lines; ``certain`` says that points and commas need no second thought."""

    def __init__(
        self, path: Path, lines: Iterable[str], table: Table, place: str, certain: bool, grouped: bool
    ) -> None:
        self.path, self.file, self.lines, self.table, self.row = path, path.name, lines, table, place
        self.certain, self.grouped = certain, grouped
        self.names = table.names or [str(index) for index in range(table.width)]
        self.decimal = table.decimal
        self.meta: dict[str, Any] = {"table": table.describe()}
        if self.decimal == ",":
            self.meta |= {"decimal_comma": True}
        self.arrays: dict[int, NDArray[Any]] = {}  # columns that pyarrow has read

    def place(self, sample: int) -> str:
        return self.row.format(self.table.first + 1 + sample)

    def read(self, index: int) -> NDArray[Any]:
        """Return the numbers of a column, or its times of day."""
        if index not in self.table.numeric:
            times = parse_clock(cell for _, cells in self._parts(index) for cell in cells)
            if times is not None:
                return times
        return self._read_numbers(index)

    def _parts(self, index: int) -> Iterator[tuple[int, list[str]]]:
        """Yield the cells of a column in parts, with the number of the first sample of each."""
        table, rows, start = self.table, islice(self.lines, self.table.first, None), 0
        while part := list(islice(rows, _PART)):
            cells = []
            for number, row in enumerate(part, start):
                parts = split_row(row, table.delimiter, self.file)
                if not table.width <= len(parts) <= table.widest or not row.strip():
                    came = number_of(len(parts), "column") if row.strip() else "an empty line"
                    raise ValueError(
                        f"{self.file}: {self.place(number)} must have {table.width} columns as the first row "
                        f"has, got {came}"
                    )
                cells.append(parts[index])
            yield start, cells
            start += len(part)

    def _read_numbers(self, index: int) -> NDArray[Any]:
        parts, marks, column = [], dict[str, str](), f"column {self.names[index]!r}"
        for start, cells in self._parts(index):
            numbers = []
            for number, cell in enumerate(cells, start):
                place = f"{self.file}: {self.place(number)}, {column} holds"
                if (kind := _mark_of(cell, self.decimal)) not in marks:
                    marks[kind] = f"{place} {cell.strip()!r}"
                try:
                    numbers.append(self._parse_number(cell))
                except ValueError:
                    if (
                        self.decimal == "."
                        and "other" in marks
                        and self.table.delimiter != ","
                        and not self.certain
                    ):
                        self.decimal = ","  # in none of the first lines
                        self.meta |= {"decimal_comma": True}
                        return self._read_numbers(index)
                    if not cell.strip():
                        raise ValueError(f"{place} nothing; it must hold a number") from None
                    shown = cell if len(cell) <= 60 else f"{cell[:60]}..."
                    raise ValueError(f"{place} {shown!r}, which is not a number") from None
            parts.append(np.array(numbers, dtype=np.float64))
            if start == 0 and (self.certain or "decimal" in marks):
                values = self._read_at_once(index)
                if values is not None:
                    return values
        if not self.certain and self.decimal == "," and "other" in marks:
            raise ValueError(f"{marks['other']}, but other numbers have a decimal comma: {_THOUSANDS}")
        if not self.certain and "decimal" not in marks and {"grouped", "bare"} <= marks.keys():
            raise ValueError(f"{marks['grouped']}, but others are whole: {_THOUSANDS}")
        return np.concatenate(parts) if parts else np.empty(0)

    def _read_at_once(self, index: int) -> NDArray[Any] | None:
        """Return a column of a long file as pyarrow reads it, ten times as fast; None where it cannot."""
        table, lines, size = self.table, self.lines, self.path.stat().st_size
        if index in self.arrays:
            return self.arrays.pop(index)
        if not isinstance(lines, TextLines) or table.delimiter == " " or size < _LONG_FILE:
            return None
        columns = [str(column) for column in range(table.width)]
        # All numbers in one go if they are few.
        wanted = [columns[k] for k in sorted(table.numeric) if len(table.numeric) <= 4 or k == index]
        numbers = {name: array("d") for name in wanted}
        try:
            arrow, arrow_csv = import_module("pyarrow"), import_module("pyarrow.csv")
            batches = arrow_csv.open_csv(  # read_csv would hold each column twice
                self.path,
                arrow_csv.ReadOptions(skip_rows=table.first, column_names=columns, encoding=lines.encoding),
                arrow_csv.ParseOptions(delimiter=table.delimiter, ignore_empty_lines=False),
                arrow_csv.ConvertOptions(
                    column_types=dict.fromkeys(wanted, arrow.float64()), include_columns=wanted,
                    decimal_point=self.decimal, null_values=[],
                ),
            )  # fmt: skip
            for batch in batches:
                for name, column in numbers.items():
                    column.frombytes(batch.column(name).to_numpy().view(np.uint8))
        except (ImportError, ValueError, NotImplementedError, OSError):  # what is wrong is named below
            return None
        self.arrays = {int(name): np.frombuffer(column) for name, column in numbers.items()}
        return self.arrays.pop(index, None)

    def _parse_number(self, cell: str) -> float:
        if "_" in cell:  # 1_000 is a number in Python only
            raise ValueError(cell)
        if self.grouped:
            cell = cell.replace("." if self.decimal == "," else ",", "")
        return float(cell.replace(",", ".") if self.decimal == "," else cell)


def _mark_of(cell: str, decimal: str) -> str:
    """Return what a number says of its marks: decimal, grouped (thousands, or three decimals), bare, ..."""
    if decimal not in cell:
        if "," in cell or "." in cell:
            return "other"
        return "bare" if len(cell.strip().lstrip("+-")) <= 3 else "decimal"  # 1234 has no mark
    return "grouped" if re.fullmatch(r"[+-]?[1-9]\d{0,2}([.,]\d{3})+", cell.strip()) else "decimal"


def open_xlsx(path: Path, reading: ReadingOptions) -> Source:
    """Return the columns of a workbook, named ``sheet/column`` where several sheets hold something.

    A sheet is read as a CSV file is: names, units below them, one row per sample. Formulas have the values
    that were stored with them.
    """
    sheets: list[tuple[str, list[list[str]]]] = []
    openpyxl = import_library("openpyxl", ".xlsx", "openpyxl")
    with explain_damage(path, "an Excel workbook"), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of styles and extensions that are not kept
        with zipfile.ZipFile(path) as archive:
            check_unpacked(path, sum(info.file_size for info in archive.infolist()))
        with closing(openpyxl.load_workbook(path, read_only=True, data_only=True)) as book:
            for sheet in book.worksheets:
                sheet.reset_dimensions()  # some programs state wrong ones
                rows, blank = [], list[str]()  # one for all rows: there may be a million
                for row in sheet.iter_rows(values_only=True):
                    cells = [_cell_text(cell) for cell in row]
                    while cells and not cells[-1].strip():
                        cells.pop()
                    rows.append(cells or blank)
                while rows and not rows[-1]:
                    rows.pop()
                if len(rows) > 1:  # names or notes, and something below them
                    sheets.append((str(sheet.title), rows))
    if not sheets:
        raise ValueError(f"{path.name} holds no sheet with data")
    tables, errors = [], []
    for title, rows in sheets:
        width, lines = max(map(len, rows)), []
        for cells in rows:
            is_label = cells and cells[0].startswith("#")  # whose commas became borders of cells
            # Quotation marks at the start of a cell would join it with the next.
            padded = cells if is_label else [cell.strip('"') for cell in cells] + [""] * (width - len(cells))
            lines.append(("," if is_label else "\t").join(padded))
        of_sheet = f" of sheet {title!r}" if len(sheets) > 1 else ""
        try:
            table = open_lines(path, replace(reading, delimiter="\t"), lines, f"row {{}}{of_sheet}")
        except ValueError as error:  # a sheet of notes
            errors.append(error)
            continue
        for channel in table.channels if of_sheet else ():
            channel.group = f"{title}/"
            channel.name = channel.group + channel.name
        tables.append(table)
    if not tables:
        raise errors[0]
    if len(sheets) == 1:
        return tables[0]
    return Source(path.name, [channel for table in tables for channel in table.channels], "column")


def _cell_text(cell: Any) -> str:
    if isinstance(cell, (datetime.datetime, datetime.date)):
        return cell.isoformat()
    return "" if cell is None else re.sub(r"\s", " ", str(cell))  # line ends and tabs would separate cells


def write_csv(file: IO[bytes], recording: Recording, labels: dict[str, Any]) -> None:
    """Write a recording as columns, with labels as comments at the head."""
    head = [f"# {FORMAT}: {VERSION}"]
    head += [f"# {key}: {json.dumps(value)}" for key, value in labels.items()]
    columns, names = [recording.torque], [f"{samples_name(recording)} [{recording.unit}]"]
    if recording.angle is not None:
        columns.append(recording.angle)
        names.append("angle [rad]")
    file.write("\n".join([*head, ",".join(names), ""]).encode("ascii"))
    np.savetxt(file, np.column_stack(columns), fmt="%.17g", delimiter=",")  # 17 digits give back every bit


def labels_from_comments(file: str, comments: Iterable[str]) -> dict[str, Any] | None:
    """Labels at the head of a file that :func:`write_csv` wrote; None for any other file."""
    pairs = [comment[1:].strip().partition(": ") for comment in comments if comment.startswith("#")]
    if not pairs or pairs[0][0] != FORMAT:
        return None
    labels = {}
    for key, _, value in pairs:
        try:
            labels[key] = json.loads(value)
        except ValueError:
            raise ValueError(f"{file}: label {key!r} in its header is not JSON, got {value!r}") from None
    labels = labels_of_file(file, labels, labels.pop(FORMAT))
    unknown = labels.keys() - {*LABELS, "sampling_rate"}
    if unknown:
        raise ValueError(
            f"{file}: unknown label {min(unknown)!r} in its header; known are {', '.join(FILE_LABELS)}"
        )
    check_rate(labels.get("sampling_rate"), f"{file}: sampling_rate in its header")
    return labels
