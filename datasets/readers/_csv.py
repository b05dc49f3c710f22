"""Readers of text in any encoding, packed with gzip or not, and of Excel workbooks; writer of CSV files."""

from __future__ import annotations

import codecs
import datetime
import io
import json
import re
import warnings
import zipfile
from array import array
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, closing
from dataclasses import replace
from functools import partial
from importlib import import_module
from itertools import islice, takewhile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.quantities import number_of
from cyclofeat.datasets.readers import _words as words
from cyclofeat.datasets.readers._columns import Channel, ReadingOptions, Source
from cyclofeat.datasets.readers._damage import check_unpacked, open_with
from cyclofeat.datasets.readers._table import HEAD_LINES, find_table, parse_clock, split_row
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
        for self.encoding in _UNMARKED if marked is None else (marked,):
            wrong = self._first_wrong_byte(marked is not None)
            if wrong is None:
                return
        known = marked or "UTF-8, Latin-1, or UTF-16 with a byte-order mark"
        raise ValueError(f"{path.name} is not text in {known} (byte {wrong}); {_REMEDY}")

    def _first_wrong_byte(self, marked: bool) -> int | None:
        """Return the place of the first byte that is not text in the encoding, or None."""
        decoder, size, block = codecs.getincrementaldecoder(self.encoding)(), 0, b" "
        with self._open_bytes() as file:
            while block:
                block = file.read(_BLOCK)
                size += len(block)
                if self.packed:
                    check_unpacked(self.path, size)
                if not marked and b"\0" in block:
                    raise ValueError(
                        f"{self.path.name} holds binary data, or UTF-16 without a byte-order mark; {_REMEDY}"
                    )
                if not marked and block.isascii() and not decoder.getstate()[0]:  # three times as fast
                    continue
                try:
                    decoder.decode(block, final=not block)
                except UnicodeDecodeError as error:
                    return size - len(error.object) + error.start
        return None

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

    def _open_bytes(self) -> AbstractContextManager[IO[bytes]]:
        if self.packed:
            return open_with(self.path, "gzip", "gzip", lambda gzip: gzip.open(self.path))
        return self.path.open("rb")


def open_text(path: Path, reading: ReadingOptions) -> Source:
    """Return the columns of a text file."""
    lines = TextLines(path)
    if not any(re.match(r"Multi_Headings\s+Yes", line) for line in islice(lines, HEAD_LINES)):
        return _Columns(path, reading, lines, "line {}").source()
    rows, segments = _join_segments(lines)
    if len(segments) > 1 and reading.gaps != "cut" and reading.sampling_rate is None:
        raise ValueError(
            f"{path.name} holds {len(segments)} segments, each with a head: give gaps='cut' to read each by "
            "itself, or sampling_rate= to read them as one"
        )
    source = _Columns(path, reading, rows, "line {} (heads of later segments not counted)").source()
    for channel in source.channels if len(segments) > 1 else ():
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
            rates[-1] = words.named_rate("dt", float(line.split("\t")[1].replace(",", "."))) or 0.0
        if not (head and begins) and (line.strip() or not begins):
            rows.append(line)
        if head and line.startswith("X_Value"):
            head = False
            begins.append(len(rows))
    return rows, [(begin - begins[0], rate) for begin, rate in zip(begins, rates, strict=False)]


class _Columns:
    """Columns of lines that can be read several times; ``row`` is what messages call a line."""

    def __init__(self, path: Path, reading: ReadingOptions, lines: Iterable[str], row: str) -> None:
        self.path, self.file, self.lines, self.row = path, path.name, lines, row
        head = list(islice(lines, HEAD_LINES))
        self.labels = labels_from_comments(self.file, takewhile(lambda line: line.startswith("#"), head))
        self.table = find_table(head, self.file, reading)
        self.names = self.table.names or [str(index) for index in range(self.table.width)]
        self.decimal, self.decimal_given = self.table.decimal, reading.decimal is not None
        # In other texts, points may separate thousands.
        self.certain = self.labels is not None or self.decimal_given or not isinstance(lines, TextLines)
        self.meta: dict[str, Any] = {"table": self.table.describe()}
        if self.decimal == ",":
            self.meta |= {"decimal_comma": True}
        self.arrays: dict[int, NDArray[Any]] = {}  # columns that pyarrow has read

    def source(self) -> Source:
        """Return the columns as channels."""
        table, is_text = self.table, isinstance(self.lines, TextLines)
        length = None if is_text else len(list(self.lines)) - table.first
        channels = [
            Channel(
                name, partial(self.read, index), unit, usable=index in table.numeric, rates=table.rates,
                length=length, meta=self.meta, place=self.place,
            )
            for index, (name, unit) in enumerate(zip(self.names, table.units, strict=True))
        ]  # fmt: skip
        return Source(self.file, channels, "column", named=table.names is not None, labels=self.labels)

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
        parts, marks = [], dict[str, str]()
        may_be_commas = not self.certain and self.decimal == "." and self.table.delimiter != ","

        def shown(number: int, text: str) -> str:
            return f"{self.file}: {self.place(number)}, column {self.names[index]!r} holds {text}"

        for start, cells in self._parts(index):
            numbers = []
            for number, cell in enumerate(cells, start):
                if (kind := _mark_of(cell, self.decimal)) not in marks:
                    marks[kind] = shown(number, repr(cell.strip()))
                try:
                    numbers.append(self._parse_number(cell))
                except ValueError:
                    if may_be_commas and "other" in marks:
                        self.decimal = ","  # in none of the first lines
                        self.meta |= {"decimal_comma": True}
                        return self._read_numbers(index)
                    text = repr(cell if len(cell) <= 60 else f"{cell[:60]}...") + ", which is not a number"
                    raise ValueError(
                        shown(number, text if cell.strip() else "nothing; it must hold a number")
                    ) from None
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
        if self.decimal_given:
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

    def open_book(openpyxl: Any) -> Any:
        with zipfile.ZipFile(path) as archive:
            check_unpacked(path, sum(info.file_size for info in archive.infolist()))
        return closing(openpyxl.load_workbook(path, read_only=True, data_only=True))

    sheets: list[tuple[str, list[list[str]]]] = []
    with warnings.catch_warnings(), open_with(path, "an Excel workbook", "openpyxl", open_book) as book:
        warnings.simplefilter("ignore", UserWarning)  # of styles and extensions that are not kept
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
    channels, errors = list[Channel](), list[ValueError]()
    for title, rows in sheets:
        width, lines = max(map(len, rows)), []
        for cells in rows:
            if cells and cells[0].startswith("#"):  # a label, whose commas became borders of cells
                lines.append(",".join(cells))
            else:  # quotation marks at the start of a cell would join it with the next
                lines.append("\t".join(cell.strip('"') for cell in cells) + "\t" * (width - len(cells)))
        of_sheet = f" of sheet {title!r}" if len(sheets) > 1 else ""
        try:
            columns = _Columns(path, replace(reading, delimiter="\t"), lines, f"row {{}}{of_sheet}")
        except ValueError as error:  # a sheet of notes
            errors.append(error)
            continue
        source = columns.source()
        if len(sheets) == 1:
            return source
        for channel in source.channels:
            channel.group = f"{title}/"
            channel.name = channel.group + channel.name
        channels += source.channels
    if not channels:
        raise errors[0]
    return Source(path.name, channels, "column")


def _cell_text(cell: Any) -> str:
    if isinstance(cell, (datetime.datetime, datetime.date)):
        return cell.isoformat()
    return "" if cell is None else re.sub(r"\s", " ", str(cell))  # line ends and tabs would separate cells


def write_csv(file: IO[bytes], recording: Recording, labels: dict[str, Any]) -> None:
    """Write a recording as columns, with labels as comments at the head."""
    head = [f"# {words.FORMAT}: {words.VERSION}"]
    head += [f"# {key}: {json.dumps(value)}" for key, value in labels.items()]
    columns, names = [recording.torque], [f"{words.samples_name(recording)} [{recording.unit}]"]
    if recording.angle is not None:
        columns.append(recording.angle)
        names.append("angle [rad]")
    file.write("\n".join([*head, ",".join(names), ""]).encode("ascii"))
    np.savetxt(file, np.column_stack(columns), fmt="%.17g", delimiter=",")  # 17 digits give back every bit


def labels_from_comments(file: str, comments: Iterable[str]) -> dict[str, Any] | None:
    """Labels at the head of a file that :func:`write_csv` wrote; None for any other file."""
    pairs = [comment[1:].strip().partition(": ") for comment in comments if comment.startswith("#")]
    if not pairs or pairs[0][0] != words.FORMAT:
        return None
    labels = {}
    for key, _, value in pairs:
        try:
            labels[key] = json.loads(value)
        except ValueError:
            raise ValueError(f"{file}: label {key!r} in its header is not JSON, got {value!r}") from None
    labels = words.labels_of_file(file, labels, labels.pop(words.FORMAT))
    unknown = labels.keys() - {*words.LABELS, "sampling_rate"}
    if unknown:
        raise ValueError(
            f"{file}: unknown label {min(unknown)!r} in its header; known are {', '.join(words.FILE_LABELS)}"
        )
    words.check_rate(labels.get("sampling_rate"), f"{file}: sampling_rate in its header")
    return labels
