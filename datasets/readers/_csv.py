"""Reader and writer of CSV files, of text in any encoding, packed with gzip or not."""

from __future__ import annotations

import codecs
import gzip
import io
import json
import math
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
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
    Source,
    check_rate,
    explain_damage,
    labels_of_file,
    largest_unpacked,
    samples_name,
)
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
        limit, wrong = largest_unpacked(path) if self.packed else math.inf, 0
        for self.encoding in _UNMARKED if marked is None else (marked,):
            decoder, size, block, failed = codecs.getincrementaldecoder(self.encoding)(), 0, b" ", False
            with self._open_bytes() as file:
                while block and not failed:
                    block, before = file.read(_BLOCK), size - len(decoder.getstate()[0])
                    size += len(block)
                    if size > limit:
                        too_large = f"takes more than {limit / 1e9:.3g} GB when unpacked"
                        raise ValueError(f"{path.name} {too_large}: unpack it, or split it")
                    if marked is None and b"\0" in block:
                        raise ValueError(
                            f"{path.name} holds binary data, or UTF-16 without a byte-order mark; {_REMEDY}"
                        )
                    try:
                        decoder.decode(block, final=not block)
                    except UnicodeDecodeError as error:
                        wrong, failed = before + error.start, True
            if not failed:
                return
        known = marked or "UTF-8, Latin-1, or UTF-16 with a byte-order mark"
        raise ValueError(f"{path.name} is not text in {known} (byte {wrong}); {_REMEDY}")

    def __iter__(self) -> Iterator[str]:
        empty = 0
        with self._open_bytes() as file, io.TextIOWrapper(file, self.encoding) as lines:
            for line in lines:
                if line.isspace():
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


class CsvSource(Source):
    """Columns of a text file, or of lines that can be read several times; ``stated`` is for `find_table`."""

    noun, a_noun, plural = "column", "a column", "columns"
    has_text_numbers = True  # a point in them may separate thousands

    def __init__(self, path: Path, stated: dict[str, Any], lines: Iterable[str] | None = None) -> None:
        self.file = path.name
        self.lines = TextLines(path) if lines is None else lines
        head = list(islice(self.lines, HEAD_LINES))
        self.labels = labels_from_comments(self.file, takewhile(lambda line: line.startswith("#"), head))
        self.table = find_table(head, self.file, stated)
        self.decimal, self.decimal_stated = self.table.decimal, stated.get("decimal") is not None
        self.named = self.table.names is not None
        self.arrays: dict[int, NDArray[Any]] = {}  # columns that pyarrow has read
        super().__init__(
            path, self.table.names or [str(j) for j in range(self.table.width)], self.table.units
        )

    def is_usable(self, index: int) -> bool:
        return index in self.table.numeric

    def stated_rates(self, torque: int) -> list[tuple[float, str]]:
        return self.table.rates

    def sample_place(self, sample: int) -> str:
        return f"line {self.table.first + 1 + sample}"

    def channel_meta(self, torque: int) -> dict[str, Any]:
        return ({"decimal_comma": True} if self.decimal == "," else {}) | {"table": self.table.describe()}

    def _column_parts(self, index: int) -> Iterator[tuple[int, list[str]]]:
        """Yield the cells of a column in parts, with the number of the first sample of each."""
        table, rows, start = self.table, islice(self.lines, self.table.first, None), 0
        while part := list(islice(rows, _PART)):
            cells = []
            for number, row in enumerate(part, start):
                parts = split_row(row, table.delimiter, self.file)
                if not table.width <= len(parts) <= table.widest or not row.strip():
                    came = number_of(len(parts), "column") if row.strip() else "an empty line"
                    raise ValueError(
                        f"{self.file}: {self.sample_place(number)} must have {table.width} columns as the "
                        f"first row has, got {came}"
                    )
                cells.append(parts[index])
            yield start, cells
            start += len(part)

    def raw_values(self, index: int) -> NDArray[Any]:
        parts, marks, column = [], dict[str, str](), f"column {self.names[index]!r}"
        certain = self.labels is not None or self.decimal_stated or not self.has_text_numbers
        may_switch = self.decimal == "." and self.table.delimiter != "," and not certain
        for start, cells in self._column_parts(index):
            numbers = []
            for number, cell in enumerate(cells, start):
                if (kind := _mark_of(cell, self.decimal)) not in marks:
                    marks[kind] = f"{self.file}: {self.sample_place(number)}, {column} holds {cell.strip()!r}"
                try:
                    numbers.append(self._parse_number(cell))
                except ValueError:
                    if may_switch and "other" in marks:
                        self.decimal = ","  # in none of the first lines
                        return self.raw_values(index)
                    shown = cell if len(cell) <= 60 else f"{cell[:60]}..."
                    holds = f"{shown!r}, which is not a number"
                    raise ValueError(
                        f"{self.file}: {self.sample_place(number)}, {column} holds "
                        + (holds if cell.strip() else "nothing; it must hold a number")
                    ) from None
            parts.append(np.array(numbers, dtype=np.float64))
            values = self._read_at_once(index) if start == 0 and (certain or "decimal" in marks) else None
            if values is not None:
                return values
        if not certain and self.decimal == "," and "other" in marks:
            raise ValueError(f"{marks['other']}, but other numbers have a decimal comma: {_THOUSANDS}")
        if not certain and "decimal" not in marks and {"grouped", "bare"} <= marks.keys():
            raise ValueError(f"{marks['grouped']}, but others are whole: {_THOUSANDS}")
        return np.concatenate(parts) if parts else np.empty(0)

    def _read_at_once(self, index: int) -> NDArray[Any] | None:
        """Return a column of a long file as pyarrow reads it, ten times as fast; None where it cannot."""
        table, lines, size = self.table, self.lines, self.path.stat().st_size
        if index in self.arrays:
            return self.arrays.pop(index)
        if not isinstance(lines, TextLines) or table.delimiter == " " or size < _LONG_FILE:
            return None
        try:
            arrow, arrow_csv = import_module("pyarrow"), import_module("pyarrow.csv")
            columns = [str(column) for column in range(table.width)]
            # All numbers in one go if they are few.
            wanted = [columns[k] for k in sorted(table.numeric) if len(table.numeric) <= 4 or k == index]
            read = arrow_csv.read_csv(
                self.path,
                arrow_csv.ReadOptions(skip_rows=table.first, column_names=columns, encoding=lines.encoding),
                arrow_csv.ParseOptions(delimiter=table.delimiter, ignore_empty_lines=False),
                arrow_csv.ConvertOptions(
                    column_types=dict.fromkeys(wanted, arrow.float64()), include_columns=wanted,
                    decimal_point=self.decimal, null_values=[],
                ),
            )  # fmt: skip
        except (ImportError, ValueError, NotImplementedError, OSError):  # what is wrong is named below
            return None
        self.arrays = {int(name): read.column(name).to_numpy() for name in wanted}
        return self.arrays.pop(index, None)

    def _parse_number(self, cell: str) -> float:
        if "_" in cell:  # 1_000 is a number in Python only
            raise ValueError(cell)
        if self.decimal == ",":
            return float((cell.replace(".", "") if self.decimal_stated else cell).replace(",", "."))
        return float(cell.replace(",", "") if self.decimal_stated else cell)

    def time_values(self, index: int) -> NDArray[Any]:
        if index in self.table.numeric:
            return self.column_values(index)
        times = parse_clock([cell for _, cells in self._column_parts(index) for cell in cells])
        return self.column_values(index) if times is None else times


def _mark_of(cell: str, decimal: str) -> str:
    """Return what a number says of its marks: decimal, grouped (thousands, or three decimals), bare, ..."""
    if decimal not in cell:
        if "," in cell or "." in cell:
            return "other"
        return "bare" if len(cell.strip().lstrip("+-")) <= 3 else "decimal"  # 1234 has no mark
    return "grouped" if re.fullmatch(r"[+-]?[1-9]\d{0,2}([.,]\d{3})+", cell.strip()) else "decimal"


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
