"""Reader and writer of CSV files, of text in any encoding, packed with gzip or not."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import json
import math
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.quantities import number_of
from cyclofeat.datasets.readers._columns import (
    FILE_LABELS,
    FORMAT,
    LABELS,
    UNITS,
    VERSION,
    Source,
    check_rate,
    clean_unit,
    explain_damage,
    labels_of_file,
    largest_unpacked,
    samples_name,
)
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

# No torque record has more; a file that has is something else, and splitting it would take long.
_MOST_COLUMNS = 4096
_NUMBER = r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?(?<!,)"


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
        limit, size = largest_unpacked(path) if self.packed else math.inf, 0
        with self._open_bytes() as file:
            while block := file.read(_BLOCK):
                size += len(block)
                if size > limit:
                    limit_gb = f"{limit / 1e9:.3g} GB"
                    raise ValueError(
                        f"{path.name} takes more than {limit_gb} when unpacked: unpack it, or split it"
                    )
                if marked is None and b"\0" in block:
                    raise ValueError(
                        f"{path.name} holds binary data, or UTF-16 without a byte-order mark; {_REMEDY}"
                    )
        for encoding in _UNMARKED if marked is None else (marked,):
            self.encoding, before, block = encoding, 0, b" "
            decoder, wrong = codecs.getincrementaldecoder(encoding)(), None
            with self._open_bytes() as file:
                while block and wrong is None:
                    block, pending = file.read(_BLOCK), len(decoder.getstate()[0])
                    try:
                        decoder.decode(block, final=not block)
                    except UnicodeDecodeError as error:
                        wrong = before - pending + error.start
                    before += len(block)
            if wrong is None:
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


def cells_of(line: str, delimiter: str, file: str) -> list[str]:
    """Return the cells of a row of a CSV file."""
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error as error:
        raise ValueError(f"{file} cannot be read as CSV ({error})") from None


class CsvSource(Source):
    """Columns of a CSV file, or of lines that can be read several times.

    Default delimiter: the first of tab, semicolon, comma in the first row; spaces where there are none and
    the first samples are several numbers.
    """

    noun, a_noun, plural = "column", "a column", "columns"
    has_text_numbers = True  # a point in them may separate thousands

    def __init__(self, path: Path, delimiter: str | None, lines: Iterable[str] | None = None) -> None:
        self.file = path.name
        self.lines = TextLines(path) if lines is None else lines
        comments, start = list[str](), list[str]()
        for line in self.lines:
            if not start and (line.startswith("#") or not line.strip()):
                comments.append(line)
            else:
                start.append(line)
            if len(start) == 3:  # names, units, first samples
                break
        if not start:
            raise ValueError(f"{self.file} holds no row of data")
        self.labels = labels_from_comments(self.file, comments)
        spaced = start[-1] if delimiter == " " else ""
        if delimiter is None and (_holds_numbers(start[0]) or not any(mark in start[0] for mark in "\t;,")):
            spaced = next(filter(_holds_numbers, start), "")
        if spaced:
            self.lines = _WithTabs(self.lines, len(comments), len(spaced.split()))
            start = list(islice(self.lines, len(comments), len(comments) + len(start)))
            delimiter = "\t"
        # Comma last: with the others it is a decimal comma.
        self.delimiter = delimiter or next((d for d in "\t;," if d in start[0]), ",")
        self.decimal_comma = self.delimiter != "," and any(
            "," in line for line in islice(self.lines, len(comments), None)
        )
        n_columns = start[0].count(self.delimiter) + 1
        if n_columns > _MOST_COLUMNS:
            raise ValueError(
                f"{self.file}: line {len(comments) + 1} has {n_columns} columns, at most {_MOST_COLUMNS} can "
                "be read; one row per sample and one column per channel are right"
            )
        first = self._split_cells(start[0])
        self.named = all(self._parse_number(cell) is None for cell in first)
        units: list[str | None] | None = None
        if self.named:
            # The row below the names may hold units.
            cells = self._split_cells(start[1]) if len(start) > 1 else []
            if len(cells) == len(first) and all(self._parse_number(cell) is None for cell in cells):
                stated = [clean_unit(cell) for cell in cells]
                units = stated if any(unit in UNITS for unit in stated) else None
            if len(start) <= 1 + (units is not None):
                raise ValueError(f"{self.file} holds column names, but no row of data")
        n_before = len(comments) + self.named + (units is not None)
        self.first_line = n_before + 1  # as editors count
        names = [cell.strip() if self.named else str(index) for index, cell in enumerate(first)]
        super().__init__(path, names, units)
        self._checked_rows(islice(self._sample_rows(), 1))  # of the others once they are read

    def _sample_rows(self) -> Iterator[str]:
        """Yield the rows of samples, read anew."""
        return islice(self.lines, self.first_line - 1, None)

    def _split_cells(self, line: str) -> list[str]:
        return cells_of(line, self.delimiter, self.file)

    def _parse_number(self, cell: str) -> float | None:
        try:
            return float(cell.replace(",", ".") if self.decimal_comma else cell)
        except ValueError:
            return None

    @cached_property
    def n_rows(self) -> int:
        """Number of rows of samples."""
        return self._checked_rows(self._sample_rows())

    def _checked_rows(self, rows: Iterable[str]) -> int:
        """Return the number of rows, which must have as many columns as the file's first one."""
        width, count = len(self.names), 0
        for count, row in enumerate(rows, 1):
            cells = row.count(self.delimiter) + 1 if '"' not in row else len(self._split_cells(row))
            if cells != width or not row.strip():
                doubled = self.delimiter == "," and cells == 2 * width
                came = number_of(cells, "column") if row.strip() else "an empty line"
                raise ValueError(
                    f"{self.file}: {self.sample_place(count - 1)} must have {width} columns as the first row "
                    f"has, got {came}" + "; are these decimal commas? give delimiter=';'" * doubled
                )
        return count

    def sample_place(self, sample: int) -> str:
        return f"line {self.first_line + sample}"

    def channel_meta(self, torque: int) -> dict[str, Any]:
        return {"decimal_comma": True} if self.decimal_comma else {}

    def raw_values(self, index: int) -> NDArray[Any]:
        rows: Iterable[str] | str = self._sample_rows()
        options: dict[str, Any] = {"delimiter": self.delimiter, "usecols": index, "max_rows": self.n_rows}
        if self.decimal_comma:
            if self.has_text_numbers:
                self._check_points(index)
            rows = (row.replace(",", ".") for row in rows)
        elif isinstance(self.lines, TextLines) and not self.lines.packed:
            # Read by NumPy itself, in half the time.
            rows, options["encoding"] = os.fspath(self.path), self.lines.encoding
            options["skiprows"] = self.first_line - 1
        try:
            return np.loadtxt(rows, comments=None, quotechar='"', ndmin=1, **options)
        except ValueError as error:
            # Name the first cell that is no number.
            column = f"column {self.names[index]!r}"
            for row, line in enumerate(self._sample_rows()):
                cell = self._split_cells(line)[index]
                if self._parse_number(cell) is None:
                    shown = cell if len(cell) <= 60 else f"{cell[:60]}..."
                    problem = f"{shown!r}, which is not a number"
                    problem = problem if cell.strip() else "nothing; it must hold a number"
                    place = f"{self.file}: {self.sample_place(row)}"
                    raise ValueError(f"{place}, {column} holds {problem}") from None
            raise ValueError(f"{self.file}: {column} cannot be read as numbers ({error})") from None

    def _check_points(self, index: int) -> None:
        """Raise where a column holds a number with a point, and the file one with a decimal comma."""

        def is_number_with(mark: str, cell: str) -> bool:
            return mark in cell and self._parse_number(cell) is not None

        pointed, has_comma = "", False
        for number, row in enumerate(self._sample_rows()):
            cells = self._split_cells(row) if "." in row or "," in row else []
            if not pointed and cells and is_number_with(".", cells[index]):
                cell = cells[index].strip()
                pointed = f"{self.sample_place(number)}, column {self.names[index]!r} holds {cell!r}"
            has_comma = has_comma or any(is_number_with(",", cell) for cell in cells)
            if pointed and has_comma:
                raise ValueError(
                    f"{self.file}: {pointed}, but other numbers have a decimal comma: does the point "
                    "separate thousands, or decimals? Write all numbers with a decimal comma, without points"
                )

    def time_values(self, index: int) -> NDArray[Any]:
        try:
            return self.column_values(index)
        except ValueError:
            if self.begins_with_number(index):
                raise
            cells = [self._split_cells(row)[index].strip() for row in self._sample_rows()]
            if any(re.match(r"\d{4}-\d\d-\d\d", cell) is None for cell in cells):
                raise
            bare = [re.sub(r"(?<=.{10})(Z|[+-]\d\d:?\d\d)$", "", cell).replace(",", ".") for cell in cells]
            with suppress(ValueError):
                return np.array(bare, dtype="datetime64[ns]")
            raise

    def begins_with_number(self, index: int) -> bool:
        """Return True if the first cell of a column below its name is a number."""
        return self._parse_number(self._split_cells(next(self._sample_rows()))[index]) is not None


def _holds_numbers(line: str) -> bool:
    """Return True for a row of several numbers between spaces."""
    cells = line.split()
    return len(cells) > 1 and all(re.fullmatch(_NUMBER, cell) for cell in cells)


class _WithTabs:
    """Lines with tabs between columns that spaces separate; a name keeps its unit in brackets."""

    def __init__(self, lines: Iterable[str], n_comments: int, width: int) -> None:
        self.lines, self.n_comments, self.width = lines, n_comments, width

    def __iter__(self) -> Iterator[str]:
        for index, line in enumerate(self.lines, -self.n_comments):
            yield line if index < 0 else "\t".join(self._split_cells(line, is_head=index < 2))

    def _split_cells(self, line: str, *, is_head: bool) -> list[str]:
        cells = line.split()
        if not is_head or len(cells) == self.width:
            return cells
        wide = re.split(r"\s{2,}", line.strip())
        return wide if len(wide) == self.width else re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", line)


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
