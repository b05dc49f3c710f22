"""Readers of MATLAB files (v4 to v7 with scipy, v7.3 with h5py) and of other HDF5 files."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.datasets.readers import _words as words
from cyclofeat.datasets.readers._columns import Channel, Source, check_claim, explain_damage, open_with

_DEEPEST, _MOST_VARIABLES, _MOST_COLUMNS, _LONGEST = 8, 10_000, 64, 1000
_COMPRESSED, _MATRIX = 15, 14  # types of elements
_SPARSE, _OPAQUE, _LAST_CLASS = 5, 17, 18  # classes of variables; opaque ones have no shape
_HDF5 = b"\x89HDF\r\n\x1a\n"
_CELLS = "is a cell array; save it as a vector"
_NO_NUMBERS = "must hold one number in each element of its struct array"
_OBJECT = (
    "is a MATLAB object (table, timetable, timeseries, duration), which only MATLAB can read; save its "
    "values as vectors or as a struct of vectors, times with seconds(...)"
)


def open_matlab(path: Path) -> Source:
    """Return the vectors of a MATLAB file, those in structs as ``struct.field``, columns as ``matrix(:,1)``.

    A timetable is read from a struct of its variables: ``Time`` in s, the others beside it, and optionally
    ``Properties`` with ``VariableNames``, ``VariableUnits`` and ``SampleRate``.
    """
    from scipy.io import loadmat

    with path.open("rb") as file:
        start = file.read(1024)
    if start.startswith(_HDF5) or start[512:520] == _HDF5:
        return _Hdf5(path, "MATLAB v7.3", ".").read_file()
    variables = _Variables(path, ".")
    with explain_damage(path, "MATLAB"):
        if start[:6] == b"MATLAB":
            order = {b"IM": "<", b"MI": ">"}[start[126:128]]
            _check_elements(path, order, memoryview(path.read_bytes())[128:])
        for name, value in loadmat(path).items():
            if not name.startswith("__"):
                variables.visit(name, value, 0)
    return variables.source("variable")


def open_hdf5(path: Path) -> Source:
    """Return the vectors of an HDF5 file as ``group/name``; attributes state units and rates."""
    return _Hdf5(path, "HDF5", "/").read_file()


class _Variables:
    """Variables of a file by their names, whose parts a ``dot`` separates."""

    def __init__(self, path: Path, dot: str) -> None:
        self.path, self.dot = path, dot
        self.vectors: dict[str, tuple[Callable[[], NDArray[Any]], int | None]] = {}  # None: cannot be read
        self.titles: dict[str, str] = {}  # of ControlDesk's variables, in place of their names
        self.scalars: dict[str, dict[str, float]] = {}  # by struct or group
        self.texts: dict[str, str] = {}
        self.lists: dict[str, list[str]] = {}

    def source(self, noun: str) -> Source:
        channels = []
        for name, (read, length) in self.vectors.items():
            place, _, last = name.rpartition(self.dot)
            title, of_table = self.titles.get(name), f"{place}.Properties.Variable".lstrip(".")
            columns, units = (self.lists.get(of_table + key, []) for key in ("Names", "Units"))
            unit = dict(zip(columns, units, strict=False)).get(last)
            channels.append(
                Channel(
                    name, read, unit or self.texts.get(f"{name}_unit"), title or last.partition("(")[0],
                    group=name.partition(".")[0] if title else place, length=length,
                    usable=length is not None, rates=self._stated_rates(name),
                )
            )  # fmt: skip
        return Source(self.path.name, channels, noun, by_index=False)

    def _stated_rates(self, scope: str) -> list[tuple[float, str]]:
        """Return rates by a number called fs and the like, or dt, of the same struct or the next above."""
        rates = words.list_rates(
            (last, value, None, f"variable {f'{place}{self.dot}{last}'.lstrip(self.dot)!r}")
            for place in (scope, f"{scope}.Properties".lstrip("."))
            for last, value in self.scalars.get(place, {}).items()
        )
        return rates if rates or not scope else self._stated_rates(scope.rpartition(self.dot)[0])

    def refuse(self, name: str, reason: str) -> None:
        """State why a variable cannot be read."""

        def read() -> NDArray[Any]:
            raise ValueError(f"variable {name!r} {reason}")

        self.vectors[name] = read, None

    def add(self, name: str, shape: tuple[int, ...], read: Callable[[Any], NDArray[Any]]) -> None:
        """Add a numeric variable of a MATLAB shape; ``read`` takes an index of the MATLAB array."""
        if len(self.vectors) > _MOST_VARIABLES:
            raise ValueError(f"{self.path.name} holds more than {_MOST_VARIABLES} variables")
        size = math.prod(shape)
        if size == 1:
            value = read(...).ravel()[0]
            if not np.iscomplexobj(value):
                place, _, last = name.rpartition(self.dot)
                self.scalars.setdefault(place, {})[last] = float(value)
        elif size == max(shape, default=0):
            self.vectors[name] = lambda: read(...).ravel(), size
        elif len(shape) == 2 and 1 < min(shape) <= _MOST_COLUMNS:
            tall = shape[0] >= shape[1]
            for k in range(min(shape)):
                part, at = (f"(:,{k + 1})", np.s_[:, k]) if tall else (f"({k + 1},:)", np.s_[k, :])
                self.vectors[name + part] = partial(read, at), max(shape)
        else:
            self.refuse(name, f"must be a vector, got shape {'x'.join(str(n) for n in shape)}")

    def visit(self, name: str, value: Any, depth: int) -> None:
        """Add a variable that scipy has read, and those in it."""
        if depth > _DEEPEST:
            self.refuse(name, f"lies deeper than {_DEEPEST} structs")
        elif not isinstance(value, np.ndarray):
            self.refuse(name, "must be a full vector of numbers, got a sparse one or another kind")
        elif type(value).__name__ in ("MatlabOpaque", "MatlabFunction"):
            self.refuse(name, _OBJECT)
        elif {"Name", "Data"} <= set(value.dtype.names or ()):  # ControlDesk
            for number, element in enumerate(value.ravel(order="F"), 1):
                called = f"{name}({number}).Data" if value.size > 1 else f"{name}.Data"
                self.titles[called] = "".join(map(str, np.ravel(element["Name"])))
                if "Unit" in value.dtype.names:
                    self.texts[f"{called}_unit"] = "".join(map(str, np.ravel(element["Unit"])))
                self.visit(called, element["Data"], depth + 1)
        elif value.dtype.names is not None:
            for field in value.dtype.names:
                called = f"{name}.{field}"
                elements = value[field].ravel(order="F")
                if value.size == 1:
                    self.visit(called, elements[0], depth + 1)
                elif value.size and all(isinstance(x, np.ndarray) and _is_number(x) for x in elements):
                    self.vectors[called] = partial(_join_numbers, elements), value.size
                else:
                    self.refuse(called, _NO_NUMBERS)
        elif value.dtype.kind in "US":
            if value.size == 1:
                self.texts[name] = str(value.flat[0])
        elif value.dtype.kind == "O":
            cells = [np.asarray(cell) for cell in value.flat]
            if all(cell.dtype.kind in "US" for cell in cells):
                self.lists[name] = [str(cell.flat[0]) if cell.size else "" for cell in cells]
            else:
                is_object = any(type(cell).__name__ == "MatlabOpaque" for cell in value.flat)
                self.refuse(name, _OBJECT if is_object else _CELLS)
        elif value.size == 0:
            self.refuse(name, "is empty")
        else:
            self.add(name, value.shape, lambda at: np.asarray(value[at]))


class _Hdf5(_Variables):
    """Variables of an HDF5 file; of MATLAB's if a point separates the parts of their names."""

    def __init__(self, path: Path, kind: str, dot: str) -> None:
        super().__init__(path, dot)
        self.is_matlab = dot == "."
        self.seen: set[Any] = set()
        self._open = partial(open_with, path, kind, "h5py", lambda h5py: h5py.File(path, "r"))

    def read_file(self) -> Source:
        with self._open() as file:
            self._visit_group("", file, 0)
        return self.source("variable" if self.is_matlab else "data set")

    def _visit_group(self, name: str, group: Any, depth: int) -> None:
        import h5py

        if depth > _DEEPEST:
            self.refuse(name, f"lies deeper than {_DEEPEST} structs")
        elif group.id not in self.seen:  # a group that holds itself
            self.seen.add(group.id)
            self._add_attributes(name, group)
            for key in group:
                called, link = f"{name}{self.dot}{key}" if name else key, group.get(key, getlink=True)
                if key.startswith("#") and self.is_matlab:
                    continue  # MATLAB's store of cells and objects
                if not isinstance(link, h5py.HardLink):
                    self.refuse(called, "is a link, which is not followed")
                elif "MATLAB_object_decode" in (node := group[key]).attrs:
                    self.refuse(called, _OBJECT)
                elif isinstance(node, h5py.Group):
                    self._visit_group(called, node, depth + 1)
                elif isinstance(node, h5py.Dataset):
                    self._visit_dataset(called, node)

    def _add_attributes(self, name: str, node: Any) -> None:
        """Add what attributes state: numbers, and the unit."""
        for key in () if self.is_matlab else node.attrs:
            value = np.asarray(node.attrs[key])
            if value.size == 1 and value.dtype.kind in "iuf":
                self.scalars.setdefault(name, {})[key] = float(value.item())
            elif key.lower() in ("unit", "units") and value.size == 1:
                self.texts[f"{name}_unit"] = _decode(value.item())

    def _visit_dataset(self, name: str, data: Any) -> None:
        import h5py

        def read_part(at: Any, field: str | None = None) -> NDArray[Any]:
            with self._open() as file:
                node = file[place] if field is None else file[place].fields(field)
                return np.asarray(node[() if at is ... else at[::-1] if self.is_matlab else at])

        def join_elements() -> NDArray[Any]:
            with self._open() as file:
                elements = [file[reference] for reference in file[place][()].ravel()]
                if not all(map(_is_number, elements)):
                    raise ValueError(f"{self.path.name}: variable {name!r} {_NO_NUMBERS}")
                return _join_numbers(elements)

        place, kind = data.name, _decode(data.attrs.get("MATLAB_class", b""))
        is_reference = h5py.check_ref_dtype(data.dtype) is not None
        check_claim(self.path, data.size * data.dtype.itemsize if data.shape is not None else 0)
        self._add_attributes(name, data)
        if data.shape is None or data.size == 0 or data.attrs.get("MATLAB_empty", 0):
            self.refuse(name, "is empty")
        elif kind == "char":
            self.texts[name] = _decode_text(data) if data.size < _LONGEST else ""
        elif is_reference and kind == "cell":
            cells = [data.file[reference] for reference in data[()].ravel()] if data.size < _LONGEST else []
            if cells and all(cell.attrs.get("MATLAB_class") == b"char" for cell in cells):
                self.lists[name] = [_decode_text(cell) for cell in cells]
            else:
                self.refuse(name, _CELLS)
        elif is_reference:
            self.vectors[name] = join_elements, data.size
        elif data.dtype.names is not None:  # a table
            for field in data.dtype.names:
                self.add(f"{name}{self.dot}{field}", data.shape, partial(read_part, field=field))
        elif data.dtype.kind in "iufb":
            # MATLAB's axes are reversed: a column vector of n is stored as (1, n).
            self.add(name, tuple(data.shape[::-1] if self.is_matlab else data.shape), read_part)
        else:
            self.refuse(name, f"must hold real numbers, got {data.dtype}")


def _is_number(element: Any) -> bool:
    """Return True for an array or data set of one real number."""
    return bool(element.size == 1 and element.dtype.kind in "iufb")


def _join_numbers(elements: Iterable[Any]) -> NDArray[Any]:
    return np.array([float(np.ravel(element[()])[0]) for element in elements])


def _decode(text: Any) -> str:
    return text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)


def _decode_text(data: Any) -> str:
    """Return MATLAB's text, which is UTF-16 codes."""
    if data.attrs.get("MATLAB_empty", 0):
        return ""
    return np.asarray(data[()], dtype="<u2").ravel(order="F").tobytes().decode("utf-16-le", "replace")


def _check_elements(path: Path, order: str, content: memoryview, depth: int = 0) -> None:
    """Check that no element of a v5 to v7 file, and none in those, claims more bytes than there are.

    scipy makes an array of the claimed shape before it reads its content.
    """
    if depth > 2 * _DEEPEST:
        raise ValueError("variables are nested too deeply")
    kind = 0
    for number, (element, part) in enumerate(_iterate_elements(order, content)):
        if depth and number == 0:
            kind = part[0 if order == "<" else 3] if len(part) >= 4 else 0
            if kind > _LAST_CLASS:
                raise ValueError(f"a variable is of class {kind}")
        elif depth and number == 1 and kind != _OPAQUE:
            shape = struct.unpack(f"{order}{len(part) // 4}i", part[: len(part) // 4 * 4])
            too_large = kind != _SPARSE and math.prod(shape) > max(len(content), 8)
            if too_large or any(length < 0 for length in shape):
                raise ValueError(f"a variable claims the shape {shape} in {len(content)} bytes")
        elif element == _MATRIX:
            _check_elements(path, order, part, depth + 1)
        elif element == _COMPRESSED and not depth:
            inflate = zlib.decompressobj()
            (claimed,) = struct.unpack_from(f"{order}I", inflate.decompress(part, 8), 4)
            check_claim(path, claimed)
            variable = inflate.decompress(inflate.unconsumed_tail, claimed + 8)
            if len(variable) < claimed:
                raise ValueError("a compressed element is shorter than it claims")
            _check_elements(path, order, memoryview(variable), 1)


def _iterate_elements(order: str, content: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the type and the content of each element; what follows the last whole tag is left out."""
    position = 0
    while position + 8 <= len(content):
        kind, n_bytes = struct.unpack_from(f"{order}II", content, position)
        position += 8
        if kind >> 16:  # a small element: length and type in one word, up to four bytes in the next
            yield kind & 0xFFFF, content[position - 4 : position - 4 + min(kind >> 16, 4)]
            continue
        if position + n_bytes > len(content):
            raise ValueError(f"an element of {n_bytes} bytes is not whole")
        yield kind, content[position : position + n_bytes]
        position += n_bytes + (0 if kind == _COMPRESSED else -n_bytes % 8)
