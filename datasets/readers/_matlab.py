"""Reader of MATLAB files: v4 to v7 with scipy, v7.3 (which is HDF5) with h5py."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.datasets.readers._columns import (
    Source,
    check_claim,
    check_rate,
    explain_damage,
    missing_library,
    whole_rate,
)

_RATE_NAMES = {
    "fs", "fs_hz", "samplerate", "sample_rate", "samplingrate", "sampling_rate", "sampling_rate_hz",
    "abtastrate",
}  # fmt: skip
_STEP_NAMES = {"dt", "ts", "timestep", "time_step", "sampletime", "sample_time"}
_DEEPEST, _MOST_VARIABLES, _MOST_COLUMNS = 8, 10_000, 64
_HDF5 = b"\x89HDF\r\n\x1a\n"
_CELLS = "is a cell array; save it as a vector"
_NO_NUMBERS = "must hold one number in each element of its struct array"
_OBJECT = (
    "is a MATLAB object (table, timetable, timeseries, duration), which only MATLAB can read; save its "
    "values as vectors or as a struct of vectors, times with seconds(...)"
)


class MatSource(Source):
    """Vectors of a MATLAB file, those in structs as ``struct.field``, of matrices as ``matrix(:,1)``.

    A timetable is read from a struct of its variables: ``Time`` in s, the others beside it, and optionally
    ``Properties`` with ``VariableNames``, ``VariableUnits`` and ``SampleRate``.
    """

    noun, plural = "variable", "variables"
    by_index = False

    def __init__(self, path: Path) -> None:
        self.vectors: dict[str, Callable[[], NDArray[Any]]] = {}
        self.unreadable: dict[str, str] = {}
        self.scalars: dict[str, float] = {}
        self.texts: dict[str, str] = {}
        self.lists: dict[str, list[str]] = {}
        with path.open("rb") as file:
            start = file.read(1024)
        self.is_hdf5 = start.startswith(_HDF5) or start[512:520] == _HDF5
        self.path, self.file = path, path.name
        if self.is_hdf5:
            with self._open_hdf5() as file:
                self._visit_group("", file, 0)
        else:
            self._walk_mat(start)
        names = [*self.vectors, *self.unreadable]
        super().__init__(
            path,
            names,
            [self._stated_unit(name) for name in names],
            [name.rpartition(".")[2].partition("(")[0] for name in names],
        )

    def is_usable(self, index: int) -> bool:
        return self.names[index] in self.vectors

    def raw_values(self, index: int) -> NDArray[Any]:
        name = self.names[index]
        if name in self.unreadable:
            raise ValueError(f"{self.file}: variable {name!r} {self.unreadable[name]}")
        return self.vectors[name]()

    def stated_rate(self, torque: int) -> tuple[float, str] | None:
        # By a number called fs and the like, or a step called dt, in the same struct or one above.
        parent = self.names[torque].rpartition(".")[0]
        while True:
            for place in (parent, f"{parent}.Properties".lstrip(".")):
                for name, value in self.scalars.items():
                    before, _, last = name.rpartition(".")
                    if before != place or not math.isfinite(value):
                        continue
                    if last.lower() in _RATE_NAMES | _STEP_NAMES:
                        check_rate(value, f"{self.file}: variable {name!r}")
                        rate = value if last.lower() in _RATE_NAMES else whole_rate(value)
                        return rate, f"variable {name!r}"
            if not parent:
                return None
            parent = parent.rpartition(".")[0]

    def _stated_unit(self, name: str) -> str | None:
        """Unit by ``Properties.VariableUnits`` of a timetable, or by a text called ``<name>_unit``."""
        parent, _, last = name.rpartition(".")
        place = f"{parent}.Properties".lstrip(".")
        names = self.lists.get(f"{place}.VariableNames", [])
        units = self.lists.get(f"{place}.VariableUnits", [])
        if last in names and len(units) == len(names) and units[names.index(last)]:
            return units[names.index(last)]
        return self.texts.get(f"{name}_unit")

    def _add_variable(self, name: str, shape: tuple[int, ...], read: Callable[[Any], NDArray[Any]]) -> None:
        """Add a numeric variable of a MATLAB shape; ``read`` takes an index of the MATLAB array."""
        if len(self.vectors) > _MOST_VARIABLES:
            raise ValueError(f"{self.file} holds more than {_MOST_VARIABLES} variables")
        size = math.prod(shape)
        if size == 1:
            value = read(...).ravel()[0]
            if not np.iscomplexobj(value):
                self.scalars[name] = float(value)
        elif size == max(shape, default=0):
            self.vectors[name] = lambda: read(...).ravel()
        elif len(shape) == 2 and 1 < min(shape) <= _MOST_COLUMNS:
            by_column = shape[0] >= shape[1]
            for k in range(min(shape)):
                part = f"(:,{k + 1})" if by_column else f"({k + 1},:)"
                at = (slice(None), k) if by_column else (k, slice(None))
                self.vectors[name + part] = partial(read, at)
        else:
            self.unreadable[name] = f"must be a vector, got shape {'x'.join(str(n) for n in shape)}"

    # v4 to v7

    def _walk_mat(self, start: bytes) -> None:
        from scipy.io import loadmat

        with explain_damage(self.path, "MATLAB"):
            if start[:6] == b"MATLAB":
                _check_elements(self.path, start)
            variables = loadmat(self.path)
        for name, value in variables.items():
            if not name.startswith("__"):
                self._visit_variable(name, value, 0)

    def _visit_variable(self, name: str, value: Any, depth: int) -> None:
        if depth > _DEEPEST:
            self.unreadable[name] = f"lies deeper than {_DEEPEST} structs"
        elif not isinstance(value, np.ndarray):
            self.unreadable[name] = "must be a full vector of numbers, got a sparse one or another kind"
        elif type(value).__name__ in ("MatlabOpaque", "MatlabFunction"):
            self.unreadable[name] = _OBJECT
        elif value.dtype.names is not None:
            for field in value.dtype.names:
                if value.size == 1:
                    self._visit_variable(f"{name}.{field}", value[field].flat[0], depth + 1)
                else:
                    self._add_elements(f"{name}.{field}", value[field].ravel(order="F"))
        elif value.dtype.kind in "US":
            if value.size == 1:
                self.texts[name] = str(value.flat[0])
        elif value.dtype.kind == "O":
            cells = [np.asarray(cell) for cell in value.flat]
            if all(cell.dtype.kind in "US" for cell in cells):
                self.lists[name] = [str(cell.flat[0]) if cell.size else "" for cell in cells]
            elif any(type(cell).__name__ == "MatlabOpaque" for cell in value.flat):
                self.unreadable[name] = _OBJECT
            else:
                self.unreadable[name] = _CELLS
        elif value.size == 0:
            self.unreadable[name] = "is empty"
        else:
            self._add_variable(name, value.shape, lambda at: np.asarray(value[at]))

    def _add_elements(self, name: str, elements: NDArray[Any]) -> None:
        """Add a field of a struct array: one number in each element."""
        fits = all(
            isinstance(element, np.ndarray) and element.size == 1 and element.dtype.kind in "iufb"
            for element in elements
        )
        if not fits or elements.size == 0:
            self.unreadable[name] = _NO_NUMBERS
            return
        self.vectors[name] = lambda: np.array([float(element.flat[0]) for element in elements])

    # v7.3

    @contextmanager
    def _open_hdf5(self) -> Iterator[Any]:
        try:
            import h5py
        except ImportError:
            raise missing_library("MATLAB v7.3 (.mat)", "h5py") from None
        with explain_damage(self.path, "MATLAB v7.3"), h5py.File(self.path, "r") as file:
            yield file

    def _visit_group(self, name: str, group: Any, depth: int) -> None:
        import h5py

        if depth > _DEEPEST:
            self.unreadable[name] = f"lies deeper than {_DEEPEST} structs"
            return
        for key in group:
            if key.startswith("#"):
                continue  # MATLAB's store of cells and objects
            called = f"{name}.{key}" if name else key
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                self.unreadable[called] = "is a link, which is not followed"
                continue
            value = group[key]
            if isinstance(value, h5py.Group):
                if "MATLAB_object_decode" in value.attrs:
                    self.unreadable[called] = _OBJECT
                else:
                    self._visit_group(called, value, depth + 1)
            elif isinstance(value, h5py.Dataset):
                self._visit_dataset(called, value)

    def _visit_dataset(self, name: str, data: Any) -> None:
        import h5py

        kind = data.attrs.get("MATLAB_class", b"")
        kind = kind.decode() if isinstance(kind, bytes) else str(kind)
        check_claim(self.path, data.size * data.dtype.itemsize if data.shape is not None else 0)
        if "MATLAB_object_decode" in data.attrs:
            self.unreadable[name] = _OBJECT
        elif data.shape is None or data.size == 0 or data.attrs.get("MATLAB_empty", 0):
            self.unreadable[name] = "is empty"
        elif kind == "char":
            if data.size < 1000:
                self.texts[name] = _decode_text(data[()])
        elif h5py.check_ref_dtype(data.dtype) is not None:
            self._visit_references(name, kind, data)
        elif data.dtype.kind in "iufb":
            # The axes are reversed: a column vector of n is stored as (1, n).
            self._add_variable(name, tuple(data.shape[::-1]), partial(self._read_hdf5, data.name))
        else:
            self.unreadable[name] = f"must hold real numbers, got {data.dtype}"

    def _read_hdf5(self, name: str, at: Any) -> NDArray[Any]:
        with self._open_hdf5() as file:
            data = file[name]
            return np.asarray(data[()] if at is ... else data[at[::-1]])

    def _visit_references(self, name: str, kind: str, data: Any) -> None:
        """Add a cell array, or a field of a struct array."""
        if kind != "cell":
            self.vectors[name] = partial(self._struct_elements, name, data.name)
            return
        cells = [data.file[reference] for reference in data[()].ravel()] if data.size <= 1000 else []
        if cells and all(cell.attrs.get("MATLAB_class") == b"char" for cell in cells):
            self.lists[name] = [
                "" if cell.attrs.get("MATLAB_empty", 0) else _decode_text(cell[()]) for cell in cells
            ]
        else:
            self.unreadable[name] = _CELLS

    def _struct_elements(self, name: str, place: str) -> NDArray[Any]:
        with self._open_hdf5() as file:
            elements = [file[reference] for reference in file[place][()].ravel()]
            if any(element.size != 1 or element.dtype.kind not in "iufb" for element in elements):
                raise ValueError(f"{self.file}: variable {name!r} {_NO_NUMBERS}")
            return np.array([float(element[()].ravel()[0]) for element in elements])


def _decode_text(codes: NDArray[Any]) -> str:
    """MATLAB's text: UTF-16 codes."""
    return np.asarray(codes, dtype="<u2").ravel(order="F").tobytes().decode("utf-16-le", "replace")


_COMPRESSED, _MATRIX = 15, 14
_CELL, _STRUCT, _SPARSE, _LAST_CLASS = 1, 2, 5, 18


def _check_elements(path: Path, start: bytes) -> None:
    """Check that no element of a v5 to v7 file claims more bytes than the file has.

    scipy makes an array of the claimed shape before it reads its content.
    """
    size = path.stat().st_size
    order = {b"IM": "<", b"MI": ">"}.get(start[126:128])
    if order is None or size < 128:
        raise ValueError(f"{path.name} is damaged: its header does not end with IM or MI")
    position = 128
    with path.open("rb") as file:
        while position < size:
            file.seek(position)
            tag = file.read(8)
            if len(tag) < 8:
                raise ValueError(f"{path.name} is not whole: it ends within a tag")
            kind, n_bytes = struct.unpack(f"{order}II", tag)
            if position + 8 + n_bytes > size:
                raise ValueError(
                    f"{path.name} is not whole: the element at byte {position} has {n_bytes} bytes, "
                    f"{size - position - 8} are left"
                )
            content = file.read(n_bytes)
            if kind == _COMPRESSED:
                content = _inflate_element(path, order, content)
            elif kind == _MATRIX:
                content = tag + content
            if kind in (_COMPRESSED, _MATRIX):
                _check_matrix(path, order, memoryview(content)[8:], 0)
            position += 8 + n_bytes
            if kind != _COMPRESSED:
                position += -position % 8


def _inflate_element(path: Path, order: str, content: bytes) -> bytes:
    inflate = zlib.decompressobj()
    head = inflate.decompress(content, 8)
    if len(head) < 8:
        raise ValueError(f"{path.name} is damaged: a compressed element holds nothing")
    (claimed,) = struct.unpack(f"{order}I", head[4:])
    check_claim(path, claimed)
    content = head + inflate.decompress(inflate.unconsumed_tail, claimed + 8)
    if len(content) < claimed + 8:
        raise ValueError(f"{path.name} is damaged: a compressed element is shorter than it claims")
    return content


def _check_matrix(path: Path, order: str, content: memoryview, depth: int) -> None:
    """Check the shapes of a matrix element and of those that it holds."""
    if depth > 2 * _DEEPEST:
        raise ValueError(f"{path.name} nests its variables too deeply")
    kind = 0
    for number, (element, part) in enumerate(_iterate_elements(path, order, content)):
        if number == 0:
            kind = part[0 if order == "<" else 3] if len(part) >= 4 else 0
            if kind > _LAST_CLASS:
                raise ValueError(f"{path.name} is damaged: a variable is of class {kind}")
        elif number == 1 and kind != 17:  # objects have no shape here
            shape = struct.unpack(f"{order}{len(part) // 4}i", part[: len(part) // 4 * 4])
            if any(length < 0 for length in shape) or (
                kind != _SPARSE and math.prod(shape) > max(len(content), 8)
            ):
                raise ValueError(
                    f"{path.name} is damaged: a variable claims the shape {shape} in {len(content)} bytes"
                )
        elif element == _MATRIX:
            _check_matrix(path, order, part, depth + 1)


def _iterate_elements(path: Path, order: str, content: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield type and content of each element."""
    position = 0
    while position + 8 <= len(content):
        first, n_bytes = struct.unpack_from(f"{order}II", content, position)
        if first >> 16:  # a small element: length and type in one word, up to four bytes in the next
            yield first & 0xFFFF, content[position + 4 : position + 4 + min(first >> 16, 4)]
            position += 8
            continue
        if position + 8 + n_bytes > len(content):
            raise ValueError(f"{path.name} is damaged: an element within a variable is longer than it")
        yield first, content[position + 8 : position + 8 + n_bytes]
        position += 8 + n_bytes + (-n_bytes % 8)
