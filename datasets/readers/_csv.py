"""Readers of text in any encoding, packed with gzip or not, and of Excel workbooks; writer of CSV files."""

from __future__ import annotations

import codecs
import csv
import datetime
import io
import json
import re
import warnings
import zipfile
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from itertools import islice, takewhile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base import checks
from cyclofeat._base.quantities import number_of
from cyclofeat.datasets.readers import _words as words
from cyclofeat.datasets.readers._columns import Channel, ReadingOptions, Source, check_unpacked, open_with
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

# Of tables.
HEAD_LINES = 1000  # from which all is concluded
# No torque record has more; a file that has is something else, and splitting it would take long.
_MOST_COLUMNS = 4096
_LONGEST_CELL = 300  # of a number or a setting
_MOST_HEADS = 20  # rows above the samples among which the names are
_BESIDE_NAMES = {"comment", "start", "increment"}
_UNIT_LABELS = {"y_unit_label", "vertical units"}  # of LabVIEW, of Tektronix
_HALF_DAY = 43_200 * 10**9  # ns
_NUMBER = re.compile(
    r"\s*[+-]?(\d[\d_]*[.,]?\d*([.,]\d+)*|[.,]\d+|nan|inf(inity)?)([eE][+-]?\d+)?\s*", re.IGNORECASE
)
_DECIMALS = re.compile(r"\s*0\d+\s*")  # no number begins so
_CLOCK = re.compile(
    r"\s*(?P<date>\d{1,4}[-./]\d{1,2}[-./]\d{1,4}|\d{1,2}[-. ]\w{3}[-. ]\d{2,4})?[T ]*"
    r"(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d)(?:[.,:](?P<f>\d+))?\s*(?P<half>[AP]M)?\s*(?P<zone>Z|[+-]\d\d:?\d\d)?\s*",
    re.IGNORECASE,
)
_DATE = re.compile(r"\s*\d{1,4}([-./])\d{1,2}\1\d{1,4}\s*")
_SETTING = re.compile(r"\W*(\w.*?)\s*[:=]\s*([+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*([A-Za-z/]*)\s*")

_NO_SAMPLE = "remove what is no row of samples"
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
                f"no CSV file of samples: its first line is longer than {_LONGEST_LINE} characters; one row "
                "per sample is right"
            )
        marked = next((encoding for mark, encoding in _MARKS if start.startswith(mark)), None)
        for self.encoding in _UNMARKED if marked is None else (marked,):
            wrong = self._first_wrong_byte(marked is not None)
            if wrong is None:
                return
        known = marked or "UTF-8, Latin-1, or UTF-16 with a byte-order mark"
        raise ValueError(f"not text in {known} (byte {wrong}); {_REMEDY}")

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


@dataclass(frozen=True)
class Table:
    """Table of a text; ``first`` is the index of its first line of samples, ``rates`` stand in its head."""

    delimiter: str
    first: int
    names: list[str] | None
    units: list[str | None]
    width: int
    widest: int  # that a row may be: comments may follow
    numeric: frozenset[int]
    decimal: str
    rates: list[tuple[float, str]]

    def describe(self) -> str:
        mark = {"\t": "tab", " ": "spaces"}.get(self.delimiter, f"{self.delimiter!r}")
        decimal = "decimal comma" if self.decimal == "," else "decimal point"
        separated = f"{self.width} columns, {mark}, " if self.width > 1 else "1 column, "
        return f"samples from line {self.first + 1}: {separated}{decimal}"


def split_row(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error as error:
        raise ValueError(f"the text cannot be read as CSV ({error})") from None


def find_table(lines: list[str], reading: ReadingOptions) -> Table:
    """Find the table in the first lines of a file."""
    hint = re.fullmatch(r'\s*"?sep=(.)"?\s*', lines[0]) if lines else None
    # LabVIEW ends the head of the file and that of the first segment so.
    ends = [i for i, line in enumerate(lines) if line.startswith("***End_of_Header***")][:2]
    begin = max((reading.table_line or 1) - 1, 1 if hint else 0, ends[-1] + 1 if ends else 0)
    delimiter = reading.delimiter or (hint[1] if hint else None)
    filled = [i for i in range(begin, len(lines)) if lines[i].strip() and not lines[i].startswith("#")]
    if not filled:
        raise ValueError("the file holds no row of data" + f" from line {begin + 1}" * bool(begin))
    best, best_score = None, 0.0
    # Comma after the others, with which it is a decimal comma; one column if nothing separates several.
    likely = "\t;| " if reading.decimal == "," else "\t;|, "
    marks = [delimiter] if delimiter else [m for m in likely if any(m in line for line in lines)] + [""]
    for mark in marks:
        rows = [split_row(line, mark or ";")[: _MOST_COLUMNS + 1] for line in lines]
        score, table = _table_of(rows, lines, filled, mark or ";", reading)
        several = table is not None and (delimiter is not None or table.width > 1)
        if table is not None and ((several and score > best_score + 1e-9) or (best is None and not mark)):
            best, best_score = table, score
    if best is None:
        raise ValueError(
            f"no table of numbers in the first {len(lines)} lines; if there is one, give table_line= "
            "(the line of the column names, from 1) and delimiter="
        )
    if best.width > _MOST_COLUMNS:
        raise ValueError(
            f"line {best.first + 1} has more than {_MOST_COLUMNS} columns, which cannot be read; "
            "one row per sample and one column per channel are right"
        )
    return best


def _table_of(
    rows: list[list[str]], lines: list[str], filled: list[int], delimiter: str, reading: ReadingOptions
) -> tuple[float, Table | None]:
    """Return the table of rows that one delimiter separates, with the share of numbers in its cells."""
    kinds = {i: "".join(map(_kind_of, rows[i])) for i in filled}
    later = filled[len(filled) // 2 :] if len(filled) > 50 else filled
    weights: Counter[int] = Counter()
    for i in later:
        weights[len(rows[i])] += 2 * sum(map("nt".count, kinds[i])) + 1
    width = weights.most_common(1)[0][0]
    samples = [i for i in later if len(rows[i]) == width]
    samples = samples[next((k for k, i in enumerate(samples) if {*"nt"} & {*kinds[i]}), 0) :]
    kinds_of = list(zip(*(kinds[i] for i in samples), strict=True))
    filled_cells = [len(column) - column.count("b") for column in kinds_of]
    numbers = [sum(map("nt".count, column)) for column in kinds_of]
    numeric = {j for j in range(width) if 2 * numbers[j] >= filled_cells[j] > 0}
    fit = [
        len(rows[i]) == width and {*"nt"} >= {kinds[i][j] for j in numeric} - {"b"} > set() for i in filled
    ]
    # A setting above the table may look like a sample; what follows it does not.
    likely = (k for k in range(len(fit)) if fit[k] and 2 * sum(fit[k : k + 4]) >= len(fit[k : k + 4]))
    first = next((filled[k] for k in likely), None)
    if first is None:
        return 0.0, None
    score = sum(numbers) / max(1, sum(filled_cells))
    heads = _head_rows(rows, lines, [i for i in filled if i < first], width, delimiter)
    blank = any("b" in column for column in kinds_of)
    fewer = not (heads or blank) and filled[0] < first  # the names above have fewer commas
    pointed = any("." in cell for i in samples for cell in rows[i])
    decimals = not pointed and any(_DECIMALS.fullmatch(cell) for i in samples for cell in rows[i][1:])
    if delimiter == "," and not reading.delimiter and (fewer or decimals):
        return 0.0, None  # these are decimal commas
    names, units, at = _names_of(heads, numeric, reading)
    # A number between names and samples is a wrong sample.
    wrong = [i for i, _ in heads if at < i and any(kinds[i][j] in "nt" for j in numeric)]
    first = min([first, *wrong])
    label = next((rows[i] for i in range(at) if {*map(str.lower, rows[i][:1])} & _UNIT_LABELS), None)
    if units is None and label is not None:  # of the values after the times
        units = [None, *map(words.clean_unit, label[1:width]), *[None] * width][:width]
    widest = max(width, len(rows[at])) if heads and delimiter != " " else width
    comma = any("," in rows[i][j] and kinds[i][j] == "n" for i in samples if i >= first for j in numeric)
    table = Table(
        delimiter=delimiter, first=first, names=names, units=units or [None] * width,
        width=width, widest=widest,
        numeric=frozenset(j for j in numeric if "n" in kinds_of[j]),
        decimal=reading.decimal or ("," if comma else "."),
        rates=_head_rates(rows, lines, first, 0 in numeric),
    )  # fmt: skip
    return score, table


def _names_of(
    heads: list[tuple[int, list[str]]], numeric: set[int], reading: ReadingOptions
) -> tuple[list[str] | None, list[str | None] | None, int]:
    """Return the names and units of the columns from the rows above them, and the line of the names."""
    if not heads:
        return None, None, -1
    is_units = len(heads) > 1 and any(words.clean_unit(cell) in words.UNITS for cell in heads[0][1])
    likely = [k for k, (_, cells) in enumerate(heads) if any(map(_is_known_name, cells))]
    likely = [k for k in likely if k >= is_units] or likely
    listed = [k for k, (_, cells) in enumerate(heads) if cells[0].lower() == "name" and 0 in numeric]
    chosen = len(heads) - 1 if reading.table_line else [*listed, *likely, int(is_units)][0]
    at, names = heads[chosen]
    units = [words.clean_unit(cell) for cell in heads[0][1]] if is_units and chosen else None
    if listed:  # TwinCAT: pairs of times and values, with lines of properties below the names
        stated = next((cells for _, cells in heads[:chosen] if cells[0].lower() == "unit"), names)
        units = [
            None if unit in (stated[0], "(None)", name) else words.clean_unit(unit)
            for unit, name in zip(stated, names, strict=True)
        ]
        names = ["time" if name.lower() == "name" else name for name in names]
        del heads[:chosen]
    return names, units, at


def _head_rows(
    rows: list[list[str]], lines: list[str], above: list[int], width: int, delimiter: str
) -> list[tuple[int, list[str]]]:
    """Return the rows above the samples that may name their columns, the lowest first."""
    heads: list[tuple[int, list[str]]] = []
    for i in reversed(above):
        cells = rows[i]
        if re.fullmatch(r"\W*data\W*", lines[i], re.IGNORECASE) and len(cells) < width:
            continue  # the word alone, between names and samples
        if delimiter == " " and len(cells) != width:
            wide = re.split(r"\s{2,}", lines[i].strip())
            # A name keeps its unit in brackets.
            cells = (
                wide if len(wide) == width else re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", lines[i])
            )
        # LabVIEW adds comments, Rigol start and increment of the times.
        extra = {cell.strip().lower() for cell in cells[width:] if _kind_of(cell) == "x"} - _BESIDE_NAMES
        if len(cells) < width or extra or len(heads) == _MOST_HEADS:
            break
        heads.append((i, [cell.strip() for cell in cells[:width]]))
    return heads


def _kind_of(cell: str) -> str:
    """Return n for a number, t for a date or a time of day, b for blank, x for another text."""
    if not cell.strip():
        return "b"
    if len(cell) > _LONGEST_CELL:
        return "x"
    return "n" if _NUMBER.fullmatch(cell) else "t" if _CLOCK.fullmatch(cell) or _DATE.fullmatch(cell) else "x"


def _is_known_name(cell: str) -> bool:
    base = words.name_and_unit(cell)[0] if cell else ""
    known = words.is_time_name(base) or base in words.ANGLE_NAMES | words.PULSE_NAMES
    return known or any(words.is_usual(base, quantity) for quantity in words.UNITS_OF)


def _head_rates(
    rows: list[list[str]], lines: list[str], first: int, begins_with_number: bool
) -> list[tuple[float, str]]:
    """Return the sampling rates that lines above the samples state, or cells of text before them."""
    rates: dict[str, float] = {}
    for i, row in enumerate(rows):
        if i >= first and (begins_with_number or not row):
            break
        triples = list(zip(row, row[1:], [*row[2:], ""], strict=False)) if i < first else [(*row[:2], "")]
        if i + 1 < first:  # a name above its value
            triples += [(name, value, "") for name, value in zip(row, rows[i + 1], strict=False)]
        match = _SETTING.fullmatch(lines[i][:_LONGEST_CELL])
        triples += [match.groups()] if match else []
        for name, value, unit in (triple for triple in triples if len(triple) == 3):
            number = re.fullmatch(r"\s*([+-]?\d*[.,]?\d+(?:[eE][+-]?\d+)?)\s*", value)
            known = words.clean_unit(unit) if words.clean_unit(unit) in words.UNITS else None
            amount = float(number[1].replace(",", ".")) if number and name.strip() else 0.0
            if (rate := words.named_rate(name, amount, known)) is not None:
                rates.setdefault(f"line {i + 1} ({name.strip()!r})", rate)
    return [(rate, where) for where, rate in rates.items()]


def parse_clock(cells: Iterable[str]) -> NDArray[Any] | None:
    """Return the times since the first of cells that hold times of day, with or without dates; None if not.

    A date that changes, or a time that falls by hours, is the next day.
    """
    seconds, day, date, before = array("q"), 0, None, None
    for cell in cells:
        match = _CLOCK.fullmatch(cell)
        if match is None:
            return None
        hours, half = int(match["h"]), (match["half"] or "").lower()
        hours = hours % 12 + 12 * (half == "pm") if half else hours
        time = 10**9 * (3600 * hours + 60 * int(match["m"]) + int(match["s"]))
        time += int((match["f"] or "0")[:9].ljust(9, "0"))
        if match["zone"] and match["zone"] not in "Zz":
            minutes = 60 * int(match["zone"][1:3]) + int(match["zone"][-2:])
            time -= int(f"{match['zone'][0]}1") * minutes * 60 * 10**9
        if before is not None and (match["date"] != date if match["date"] else before - time > _HALF_DAY):
            day += 86_400 * 10**9
        date, before = match["date"], time
        seconds.append(day + time)
    return np.frombuffer(seconds, "m8[ns]")


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
        self.path, self.lines, self.row = path, lines, row
        head = list(islice(lines, HEAD_LINES))
        self.labels = labels_from_comments(takewhile(lambda line: line.startswith("#"), head))
        self.table = find_table(head, reading)
        self.names = self.table.names or [str(index) for index in range(self.table.width)]
        self.decimal, self.decimal_given = self.table.decimal, reading.decimal is not None
        # In other texts, points may separate thousands.
        self.certain = self.labels is not None or self.decimal_given or not isinstance(lines, TextLines)
        rate = (self.labels or {}).pop("sampling_rate", None)
        self.rates = self.table.rates if self.labels is None else [(rate, "header")]
        self.meta: dict[str, Any] = {"table": self.table.describe()}
        self.meta |= {"decimal_comma": True} if self.decimal == "," else {}
        self.arrays: dict[int, NDArray[Any]] = {}  # columns that pyarrow has read

    def source(self) -> Source:
        """Return the columns as channels."""
        table, is_text = self.table, isinstance(self.lines, TextLines)
        length = None if is_text else len(list(self.lines)) - table.first
        channels = [
            Channel(
                name, partial(self.read, index), unit, usable=index in table.numeric, rates=self.rates,
                length=length, meta=self.meta, place=self.place,
            )
            for index, (name, unit) in enumerate(zip(self.names, table.units, strict=True))
        ]  # fmt: skip
        return Source(
            self.path.name, channels, "column", named=table.names is not None, labels=self.labels or {},
            is_own=self.labels is not None,
        )  # fmt: skip

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
                parts = split_row(row, table.delimiter)
                if not table.width <= len(parts) <= table.widest or not row.strip():
                    came = number_of(len(parts), "column") if row.strip() else "an empty line"
                    raise ValueError(
                        f"{self.place(number)} must have {table.width} columns as the first row "
                        f"has, got {came}; {_NO_SAMPLE}"
                    )
                cells.append(parts[index])
            yield start, cells
            start += len(part)

    def _read_numbers(self, index: int) -> NDArray[Any]:
        parts, marks = [], dict[str, str]()
        may_be_commas = not self.certain and self.decimal == "." and self.table.delimiter != ","

        def shown(number: int, text: str) -> str:
            return f"{self.place(number)}, column {self.names[index]!r} holds {text}"

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
                    text = (
                        repr(cell if len(cell) <= 60 else f"{cell[:60]}...")
                        + f", which is not a number; {_NO_SAMPLE}"
                    )
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


def labels_from_comments(comments: Iterable[str]) -> dict[str, Any] | None:
    """Labels at the head of a file that :func:`write_csv` wrote; None for any other file."""
    pairs = [comment[1:].strip().partition(": ") for comment in comments if comment.startswith("#")]
    if not pairs or pairs[0][0] != words.FORMAT:
        return None
    labels = {}
    for key, _, value in pairs:
        try:
            labels[key] = json.loads(value)
        except ValueError:
            raise ValueError(f"label {key!r} in the header is not JSON, got {value!r}") from None
    labels = words.labels_of_file(labels, labels.pop(words.FORMAT))
    if unknown := labels.keys() - {*words.LABELS, "sampling_rate"}:
        known = ", ".join(words.FILE_LABELS)
        raise ValueError(f"unknown label {min(unknown)!r} in the header; known are {known}")
    checks.positive("sampling_rate in the header", labels.get("sampling_rate"), "a number of Hz")
    return labels
