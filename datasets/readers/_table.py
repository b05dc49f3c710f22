"""Where the table of a text or a sheet begins, how its cells are separated, and what stands above it."""

from __future__ import annotations

import csv
import re
from array import array
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.datasets.readers import _words as words
from cyclofeat.datasets.readers._columns import ReadingOptions

HEAD_LINES = 1000  # from which all is concluded
# No torque record has more; a file that has is something else, and splitting it would take long.
_MOST_COLUMNS = 4096
_LONGEST_CELL = 300  # of a number or a setting
_MOST_HEADS = 20  # rows above the samples among which the names are
_BESIDE_NAMES = {"comment", "start", "increment"}
_HALF_DAY = 43_200 * 10**9  # ns
_NUMBER = re.compile(
    r"\s*[+-]?(\d[\d_]*[.,]?\d*([.,]\d+)*|[.,]\d+|nan|inf(inity)?)([eE][+-]?\d+)?\s*", re.IGNORECASE
)
_CLOCK = re.compile(
    r"\s*(?P<date>\d{1,4}[-./]\d{1,2}[-./]\d{1,4}|\d{1,2}[-. ]\w{3}[-. ]\d{2,4})?[T ]*"
    r"(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d)(?:[.,:](?P<f>\d+))?\s*(?P<half>[AP]M)?\s*(?P<zone>Z|[+-]\d\d:?\d\d)?\s*",
    re.IGNORECASE,
)
_DATE = re.compile(r"\s*\d{1,4}([-./])\d{1,2}\1\d{1,4}\s*")
_SETTING = re.compile(r"\W*(\w.*?)\s*[:=]\s*([+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*([A-Za-z/]*)\s*")


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


def split_row(line: str, delimiter: str, file: str = "") -> list[str]:
    if delimiter == " ":
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error as error:
        raise ValueError(f"{file} cannot be read as CSV ({error})") from None


def find_table(lines: list[str], file: str, reading: ReadingOptions) -> Table:
    """Find the table in the first lines of a file."""
    hint = re.fullmatch(r'\s*"?sep=(.)"?\s*', lines[0]) if lines else None
    # LabVIEW ends the head of the file and that of the first segment so.
    ends = [i for i, line in enumerate(lines) if line.startswith("***End_of_Header***")][:2]
    begin = max((reading.table_line or 1) - 1, 1 if hint else 0, ends[-1] + 1 if ends else 0)
    delimiter = reading.delimiter or (hint[1] if hint else None)
    filled = [i for i in range(begin, len(lines)) if lines[i].strip() and not lines[i].startswith("#")]
    if not filled:
        raise ValueError(f"{file} holds no row of data" + f" from line {begin + 1}" * bool(begin))
    best, best_score = None, 0.0
    # Comma after the others, with which it is a decimal comma; one column if nothing separates several.
    marks = [delimiter] if delimiter else [m for m in "\t;, " if any(m in line for line in lines)] + [""]
    for mark in marks:
        rows = [split_row(line, mark or ";", file)[: _MOST_COLUMNS + 1] for line in lines]
        score, table = _table_of(rows, lines, filled, mark or ";", reading)
        several = table is not None and (delimiter is not None or table.width > 1)
        if table is not None and ((several and score > best_score + 1e-9) or (best is None and not mark)):
            best, best_score = table, score
    if best is None:
        raise ValueError(
            f"{file}: no table of numbers in its first {len(lines)} lines; if there is one, give table_line= "
            "(the line of the column names, from 1) and delimiter="
        )
    if best.width > _MOST_COLUMNS:
        raise ValueError(
            f"{file}: line {best.first + 1} has more than {_MOST_COLUMNS} columns, which cannot be read; "
            "one row per sample and one column per channel are right"
        )
    return best


def _table_of(
    rows: list[list[str]], lines: list[str], filled: list[int], delimiter: str, reading: ReadingOptions
) -> tuple[float, Table | None]:
    """Return the table of rows that one delimiter separates, with the share of numbers in its cells."""
    kinds = {i: [_kind_of(cell) for cell in rows[i]] for i in filled}
    later = filled[len(filled) // 2 :] if len(filled) > 50 else filled
    weights: Counter[int] = Counter()
    for i in later:
        weights[len(rows[i])] += 2 * (kinds[i].count("n") + kinds[i].count("t")) + 1
    width = weights.most_common(1)[0][0]
    samples = [i for i in later if len(rows[i]) == width]
    samples = samples[next((k for k, i in enumerate(samples) if set("nt") & set(kinds[i])), 0) :]
    kinds_of = list(zip(*(kinds[i] for i in samples), strict=True))
    filled_cells = [len(column) - column.count("b") for column in kinds_of]
    numbers = [column.count("n") + column.count("t") for column in kinds_of]
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
    if not (heads or blank or reading.delimiter) and delimiter == "," and filled[0] < first:
        return 0.0, None  # the names above have fewer commas: these are decimal commas
    names, units, at = _names_of(heads, numeric, reading)
    # A number between names and samples is a wrong sample.
    wrong = [i for i, _ in heads if at < i and any(kinds[i][j] in "nt" for j in numeric)]
    first = min([first, *wrong])
    label = next((rows[i] for i in range(at) if rows[i][:1] == ["Y_Unit_Label"]), None)
    if units is None and label is not None:  # LabVIEW, of the values after the times
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
