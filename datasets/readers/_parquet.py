"""Reader of Parquet files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.datasets.readers._columns import (
    Source,
    check_claim,
    check_rate,
    explain_damage,
    import_library,
)


class ParquetSource(Source):
    """Columns of a Parquet file; units from the columns' metadata (``unit``) or names."""

    noun, a_noun, plural = "column", "a column", "columns"

    def __init__(self, path: Path) -> None:
        with _open_parquet(path) as file:
            schema = file.schema_arrow
            metadata = schema.metadata or {}
            self.types = [field.type for field in schema]
            units = [(field.metadata or {}).get(b"unit") for field in schema]
            names = [str(field.name) for field in schema]
            self.n_rows = int(file.metadata.num_rows)
        super().__init__(path, names, [None if unit is None else unit.decode() for unit in units])
        self.rate = metadata.get(b"sampling_rate")
        if self.rate is not None:
            with suppress(ValueError):
                self.rate = float(self.rate)
            check_rate(self.rate, f"{path.name}: metadata 'sampling_rate'")

    def is_usable(self, index: int) -> bool:
        name = str(self.types[index])
        return name.startswith(("int", "uint", "float", "double", "halffloat", "decimal"))

    def stated_rates(self, torque: int) -> list[tuple[float, str]]:
        return [] if self.rate is None else [(self.rate, "metadata 'sampling_rate'")]

    def sample_place(self, sample: int) -> str:
        return f"row {sample + 1}"

    def raw_values(self, index: int) -> NDArray[Any]:
        name, kind = self.names[index], str(self.types[index])
        called = f"{self.file}: column {name!r}"
        is_time = kind.startswith(("timestamp", "duration"))
        if not (self.is_usable(index) or is_time):
            raise ValueError(f"{called} must hold real numbers, got {kind}")
        if self.names.count(name) > 1:
            raise ValueError(f"{called} is there {self.names.count(name)} times; names must be distinct")
        check_claim(self.path, 8 * self.n_rows)
        parts: list[NDArray[Any]] = []
        with _open_parquet(self.path) as file:
            for batch in file.iter_batches(batch_size=2**20, columns=[name]):
                column = batch.column(0)
                if column.null_count:
                    row = sum(part.size for part in parts) + int(column.is_null().to_numpy(False).argmax())
                    raise ValueError(
                        f"{called} holds nothing in {self.sample_place(int(row))}; it must hold a number"
                    )
                values = column.to_numpy(zero_copy_only=False)
                parts.append(values if is_time else values.astype(np.float64))
        return np.concatenate(parts) if parts else np.empty(0)


@contextmanager
def _open_parquet(path: Path) -> Iterator[Any]:
    parquet = import_library("pyarrow.parquet", ".parquet", "pyarrow")
    with explain_damage(path, "Parquet"), parquet.ParquetFile(path, memory_map=True) as file:
        yield file
