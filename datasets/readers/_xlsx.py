"""Reader of Excel workbooks."""

from __future__ import annotations

import datetime
import re
import warnings
import zipfile
from contextlib import closing
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from cyclofeat.datasets.readers._columns import (
    Float,
    Source,
    explain_damage,
    import_library,
    largest_unpacked,
)
from cyclofeat.datasets.readers._csv import CsvSource


class XlsxSource(Source):
    """Columns of a workbook, named ``sheet/column`` where several sheets hold something.

    A sheet is read as a CSV file is: names, units below them, one row per sample. Formulas have the values
    that were stored with them.
    """

    noun, a_noun, plural = "column", "a column", "columns"

    def __init__(self, path: Path, stated: dict[str, Any]) -> None:
        sheets: list[tuple[str, list[list[str]]]] = []
        openpyxl = import_library("openpyxl", ".xlsx", "openpyxl")
        with explain_damage(path, "an Excel workbook"), warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of styles and extensions that are not kept
            limit = largest_unpacked(path)
            with zipfile.ZipFile(path) as archive:
                total = sum(info.file_size for info in archive.infolist())
            if total > limit:
                raise ValueError(
                    f"{path.name} takes {total / 1e9:.3g} GB when unpacked, at most {limit / 1e9:.3g} GB are "
                    "read: save it as .csv"
                )
            with closing(openpyxl.load_workbook(path, read_only=True, data_only=True)) as book:
                for sheet in book.worksheets:
                    sheet.reset_dimensions()  # some programs state wrong ones
                    rows = [[_cell_text(cell) for cell in row] for row in sheet.iter_rows(values_only=True)]
                    for row in rows:
                        while row and not row[-1].strip():
                            row.pop()
                    while rows and not rows[-1]:
                        rows.pop()
                    if len(rows) > 1:  # names or notes, and something below them
                        sheets.append((str(sheet.title), rows))
        if not sheets:
            raise ValueError(f"{path.name} holds no sheet with data")
        several = len(sheets) > 1
        tables, errors = [], []
        for title, rows in sheets:
            try:
                tables.append(_Sheet(path, title if several else "", rows, stated))
            except ValueError as error:  # a sheet of notes
                errors.append(error)
        if not tables:
            raise errors[0]
        self.columns = [(table, index) for table in tables for index in range(len(table.names))]
        plain = [table.names[index] for table, index in self.columns]
        names = [f"{table.title}/{table.names[index]}" for table, index in self.columns] if several else plain
        super().__init__(path, names, [table.units[index] for table, index in self.columns], plain)
        self.named = several or tables[0].named
        self.labels = None if several else tables[0].labels

    def is_usable(self, index: int) -> bool:
        table, column = self.columns[index]
        return table.is_usable(column)

    def length(self, index: int) -> int | None:
        return self.columns[index][0].n_rows

    def stated_rates(self, torque: int) -> list[tuple[float, str]]:
        return self.columns[torque][0].table.rates

    def column_values(self, index: int) -> Float:
        table, column = self.columns[index]
        return table.column_values(column)

    def time_values(self, index: int) -> NDArray[Any]:
        table, column = self.columns[index]
        return table.time_values(column)

    def sample_place(self, sample: int) -> str:
        table, _ = self.columns[0]
        return super().sample_place(sample) if table.title else table.sample_place(sample)


class _Sheet(CsvSource):
    """One sheet, whose rows are lines with tabs; its numbers have a point, whatever its texts hold."""

    has_text_numbers = False

    def __init__(self, path: Path, title: str, rows: list[list[str]], stated: dict[str, Any]) -> None:
        self.title = title
        width, lines = max(map(len, rows)), []
        for cells in rows:
            is_label = cells and cells[0].startswith("#")  # whose commas became borders of cells
            # Quotation marks at the start of a cell would join it with the next.
            row = cells if is_label else [cell.strip('"') for cell in cells] + [""] * (width - len(cells))
            lines.append(("," if is_label else "\t").join(row))
        super().__init__(path, stated | {"delimiter": "\t"}, lines)
        self.n_rows = len(lines) - self.table.first

    def sample_place(self, sample: int) -> str:
        row = f"row {self.table.first + 1 + sample}"
        return f"{row} of sheet {self.title!r}" if self.title else row


def _cell_text(cell: Any) -> str:
    if isinstance(cell, (datetime.datetime, datetime.date)):
        return cell.isoformat()
    return "" if cell is None else re.sub(r"\s", " ", str(cell))  # line ends and tabs would separate cells
