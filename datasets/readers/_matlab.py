"""Reader of MATLAB files: v4 to v7 with scipy, v7.3 (which is HDF5) with h5py."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat

from cyclofeat.datasets.readers._columns import (
    Source,
    check_claim,
    explain_damage,
    import_library,
)
from cyclofeat.datasets.readers._times import named_rate

_DEEPEST, _MOST_VARIABLES, _MOST_COLUMNS = 8, 10_000, 64
_COMPRESSED, _MATRIX = 15, 14  # types of elements
_SPARSE, _LAST_CLASS = 5, 18  # classes of variables
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

    noun, a_noun, plural = "variable", "a variable", "variables"
    by_index = False

    def __init__(self, path: Path) -> None:
        self.vectors: dict[str, Callable[[], NDArray[Any]]] = {}
        self.unreadable: dict[str, str] = {}
        self.lengths: dict[str, int] = {}
        self.titles: dict[str, str] = {}  # of ControlDesk's variables, in place of their names
        self.scalars: dict[str, float] = {}
        self.texts: dict[str, str] = {}
        self.lists: dict[str, list[str]] = {}
        with path.open("rb") as file:
            start = file.read(1024)
        self.is_hdf5 = start.startswith(_HDF5) or start[512:520] == _HDF5
        self.path, self.file = path, path.name
        if self.is_hdf5:
            with self._open_hdf5() as file:
                self._visit_node("", file, 0)
        else:
            with explain_damage(path, "MATLAB"):
                if start[:6] == b"MATLAB":
                    _check_elements(path)
                variables = loadmat(path)
            for name, value in variables.items():
                if not name.startswith("__"):
                    self._visit_variable(name, value, 0)
        names = [*self.vectors, *self.unreadable]
        units, plain = [], []
        for name in names:
            place, _, last = name.rpartition(".")
            properties = f"{place}.Properties".lstrip(".")
            columns = self.lists.get(f"{properties}.VariableNames", [])
            stated = self.lists.get(f"{properties}.VariableUnits", [])
            unit = stated[columns.index(last)] if last in columns and len(stated) == len(columns) else ""
            units.append(unit or self.texts.get(f"{name}_unit"))
            plain.append(self.titles.get(name) or last.partition("(")[0])
        super().__init__(path, names, units, plain)

    def is_usable(self, index: int) -> bool:
        return self.names[index] in self.vectors

    def raw_values(self, index: int) -> NDArray[Any]:
        name = self.names[index]
        if name in self.unreadable:
            raise ValueError(f"{self.file}: variable {name!r} {self.unreadable[name]}")
        return self.vectors[name]()

    def group_of(self, index: int) -> str:
        name = self.names[index]
        return name.partition(".")[0] if name in self.titles else name.rpartition(".")[0]

    def length(self, index: int) -> int | None:
        return self.lengths.get(self.names[index])

    def stated_rates(self, torque: int) -> list[tuple[float, str]]:
        # By a number called fs and the like, or a step called dt, in the same struct or the next one above.
        parent = self.names[torque].rpartition(".")[0]
        while True:
            stated = []
            for place in (parent, f"{parent}.Properties".lstrip(".")):
                for name, value in self.scalars.items():
                    before, _, last = name.rpartition(".")
                    rate = named_rate(last, value) if before == place else None
                    stated += [] if rate is None else [(rate, f"variable {name!r}")]
            if stated or not parent:
                return stated
            parent = parent.rpartition(".")[0]

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
            self.vectors[name], self.lengths[name] = lambda: read(...).ravel(), size
        elif len(shape) == 2 and 1 < min(shape) <= _MOST_COLUMNS:
            by_column = shape[0] >= shape[1]
            for k in range(min(shape)):
                part = f"(:,{k + 1})" if by_column else f"({k + 1},:)"
                at = (slice(None), k) if by_column else (k, slice(None))
                self.vectors[name + part], self.lengths[name + part] = partial(read, at), max(shape)
        else:
            self.unreadable[name] = f"must be a vector, got shape {'x'.join(str(n) for n in shape)}"

    # v4 to v7

    def _visit_variable(self, name: str, value: Any, depth: int) -> None:
        if depth > _DEEPEST:
            self.unreadable[name] = f"lies deeper than {_DEEPEST} structs"
        elif not isinstance(value, np.ndarray):
            self.unreadable[name] = "must be a full vector of numbers, got a sparse one or another kind"
        elif type(value).__name__ in ("MatlabOpaque", "MatlabFunction"):
            self.unreadable[name] = _OBJECT
        elif {"Name", "Data"} <= set(value.dtype.names or ()):  # ControlDesk
            for number, element in enumerate(value.ravel(order="F"), 1):
                called = f"{name}({number}).Data" if value.size > 1 else f"{name}.Data"
                self.titles[called] = "".join(map(str, np.ravel(element["Name"])))
                if "Unit" in value.dtype.names:
                    self.texts[f"{called}_unit"] = "".join(map(str, np.ravel(element["Unit"])))
                self._visit_variable(called, element["Data"], depth + 1)
        elif value.dtype.names is not None:
            for field in value.dtype.names:
                called = f"{name}.{field}"
                elements = value[field].ravel(order="F")
                if value.size == 1:
                    self._visit_variable(called, elements[0], depth + 1)
                elif value.size and all(isinstance(x, np.ndarray) and _is_number(x) for x in elements):
                    self.vectors[called], self.lengths[called] = partial(_join_numbers, elements), value.size
                else:
                    self.unreadable[called] = _NO_NUMBERS
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

    # v7.3

    @contextmanager
    def _open_hdf5(self) -> Iterator[Any]:
        h5py = import_library("h5py", "MATLAB v7.3 (.mat)", "h5py")
        with explain_damage(self.path, "MATLAB v7.3"), h5py.File(self.path, "r") as file:
            yield file

    def _visit_node(self, name: str, node: Any, depth: int) -> None:
        import h5py

        if "MATLAB_object_decode" in node.attrs:
            self.unreadable[name] = _OBJECT
        elif isinstance(node, h5py.Dataset):
            self._visit_dataset(name, node)
        elif isinstance(node, h5py.Group) and depth > _DEEPEST:
            self.unreadable[name] = f"lies deeper than {_DEEPEST} structs"
        elif isinstance(node, h5py.Group):
            for key in node:
                called = f"{name}.{key}" if name else key
                if key.startswith("#"):
                    continue  # MATLAB's store of cells and objects
                if isinstance(node.get(key, getlink=True), h5py.HardLink):
                    self._visit_node(called, node[key], depth + 1)
                else:
                    self.unreadable[called] = "is a link, which is not followed"

    def _visit_dataset(self, name: str, data: Any) -> None:
        import h5py

        def read_part(at: Any) -> NDArray[Any]:
            with self._open_hdf5() as file:
                return np.asarray(file[place][() if at is ... else at[::-1]])

        def join_elements() -> NDArray[Any]:
            with self._open_hdf5() as file:
                elements = [file[reference] for reference in file[place][()].ravel()]
                if not all(map(_is_number, elements)):
                    raise ValueError(f"{self.file}: variable {name!r} {_NO_NUMBERS}")
                return _join_numbers(elements)

        place, kind = data.name, data.attrs.get("MATLAB_class", b"")
        kind = kind.decode() if isinstance(kind, bytes) else str(kind)
        is_reference = h5py.check_ref_dtype(data.dtype) is not None
        check_claim(self.path, data.size * data.dtype.itemsize if data.shape is not None else 0)
        if data.shape is None or data.size == 0 or data.attrs.get("MATLAB_empty", 0):
            self.unreadable[name] = "is empty"
        elif kind == "char":
            if data.size < 1000:
                self.texts[name] = _decode_text(data)
        elif is_reference and kind == "cell":
            cells = [data.file[reference] for reference in data[()].ravel()] if data.size <= 1000 else []
            if cells and all(cell.attrs.get("MATLAB_class") == b"char" for cell in cells):
                self.lists[name] = [_decode_text(cell) for cell in cells]
            else:
                self.unreadable[name] = _CELLS
        elif is_reference:
            self.vectors[name], self.lengths[name] = join_elements, data.size
        elif data.dtype.kind in "iufb":
            # The axes are reversed: a column vector of n is stored as (1, n).
            self._add_variable(name, tuple(data.shape[::-1]), read_part)
        else:
            self.unreadable[name] = f"must hold real numbers, got {data.dtype}"


def _is_number(element: Any) -> bool:
    """Return True for an array or data set of one real number."""
    return bool(element.size == 1 and element.dtype.kind in "iufb")


def _join_numbers(elements: Iterable[Any]) -> NDArray[Any]:
    return np.array([float(np.ravel(element[()])[0]) for element in elements])


def _decode_text(data: Any) -> str:
    """Return MATLAB's text, which is UTF-16 codes."""
    if data.attrs.get("MATLAB_empty", 0):
        return ""
    return np.asarray(data[()], dtype="<u2").ravel(order="F").tobytes().decode("utf-16-le", "replace")


def _check_elements(path: Path) -> None:
    """Check that no element of a v5 to v7 file claims more bytes than the file has.

    scipy makes an array of the claimed shape before it reads its content.
    """
    content = memoryview(path.read_bytes())
    order = {b"IM": "<", b"MI": ">"}.get(bytes(content[126:128]))
    if order is None:
        raise ValueError(f"{path.name} is damaged: its header does not end with IM or MI")
    for kind, element in _iterate_elements(path, order, content, start=128):
        if kind == _COMPRESSED:
            inflate = zlib.decompressobj()
            head = inflate.decompress(element, 8)
            (claimed,) = struct.unpack_from(f"{order}I", head, 4)
            check_claim(path, claimed)
            variable = inflate.decompress(inflate.unconsumed_tail, claimed + 8)
            if len(variable) < claimed:
                raise ValueError(f"{path.name} is damaged: a compressed element is shorter than it claims")
            _check_matrix(path, order, memoryview(variable), 0)
        elif kind == _MATRIX:
            _check_matrix(path, order, element, 0)


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


def _iterate_elements(
    path: Path, order: str, content: memoryview, start: int = 0
) -> Iterator[tuple[int, memoryview]]:
    position = start
    while position + 8 <= len(content):
        first, n_bytes = struct.unpack_from(f"{order}II", content, position)
        if first >> 16:  # a small element: length and type in one word, up to four bytes in the next
            yield first & 0xFFFF, content[position + 4 : position + 4 + min(first >> 16, 4)]
            position += 8
            continue
        position += 8
        if position + n_bytes > len(content):
            left = len(content) - position
            raise ValueError(
                f"{path.name} is not whole: the element at byte {position - 8} has {n_bytes} bytes, "
                f"{left} are left"
            )
        yield first, content[position : position + n_bytes]
        position += n_bytes + (0 if first == _COMPRESSED else -n_bytes % 8)
    if start and position < len(content):
        raise ValueError(f"{path.name} is not whole: it ends within a tag")
