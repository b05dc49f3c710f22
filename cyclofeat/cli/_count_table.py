"""Table of counts as CSV: one row per recording, written as soon as it is counted."""

from __future__ import annotations

import csv
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

from cyclofeat._base.files import naming
from cyclofeat.cli._reading import FileResult

if TYPE_CHECKING:
    from cyclofeat.counting import LobeCount

COLUMNS = (
    "file", "defect_count", "probability", "worn_lobes_from_1", "lobes_absolute", "refused",
    "refused_defect_count", "reason", "n_windows", "distance", "warnings", "error",
    "wear_um", "wear_um_low", "wear_um_high",
)  # fmt: skip


# Adds the row of one file.
AddRow: TypeAlias = Callable[[FileResult[Any], "LobeCount | None"], None]


def count_table(path: str | None) -> AddRow:
    """Begin the table of counts, and return the function that adds a row; without a path it does nothing."""
    if path is None:
        return lambda result, count: None

    def write(mode: str, row: dict[str, Any]) -> None:
        # Opened for each row: what is counted stays, whatever comes. The mark at the beginning tells
        # spreadsheets that the file is UTF-8.
        with naming(path), open(path, mode, encoding="utf-8-sig", newline="") as stream:
            csv.DictWriter(stream, COLUMNS, extrasaction="ignore").writerow(row)

    def add(result: FileResult[Any], count: LobeCount | None) -> None:
        row: dict[str, Any] = {"file": str(result.path), "error": result.error}
        if count is not None:
            row |= count.to_dict()
            row["probability"] = f"{count.probability[count.defect_count]:.6g}"
            row["worn_lobes_from_1"] = " ".join(map(str, row["worn_lobes_from_1"]))
            row["warnings"] = "; ".join(count.warnings)
        write("a", row)

    write("w", {column: column for column in COLUMNS})
    return add
