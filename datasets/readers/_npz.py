"""Reader and writer of NPZ files."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.quantities import QUANTITY_UNITS
from cyclofeat.datasets.readers._columns import (
    FORMAT_KEY,
    LABELS,
    VERSION,
    WORN,
    Source,
    check_claim,
    check_rate,
    explain_damage,
    labels_of_file,
    largest_unpacked,
    samples_name,
)
from cyclofeat.recordings import Recording

_Header: TypeAlias = tuple[tuple[int, ...], np.dtype[Any]]  # shape and dtype


class NpzSource(Source):
    """Arrays of an NPZ file, read from disk when they are asked for.

    By the layout, an array ``torque`` or ``input_torque`` is in Nm, ``motor_current`` in A, ``angle`` in rad
    and ``sampling_rate`` in Hz; a name may state another unit (``angle_deg``), and so may a text array
    ``angle_unit``.
    """

    noun, a_noun, plural = "array", "an array", "arrays"
    by_index = False
    angle_unit = "rad"

    def __init__(self, path: Path) -> None:
        with _open_archive(path) as archive:
            self.headers = _check_sizes(path, archive)
            self.members = {name.removesuffix(".npy"): name for name in archive.namelist()}
            reserved = {*LABELS, WORN, FORMAT_KEY, "sampling_rate", "angle_unit"}
            super().__init__(path, [name for name in self.members if name not in reserved])
            small = {
                name: _read_array(archive, self.members[name]) for name in reserved & self.members.keys()
            }
        self.rate = small.get("sampling_rate")
        stated_labels = {key: small[key].tolist() for key in (*LABELS, WORN) if key in small}
        if "meta" in stated_labels:
            meta: Any = None
            with suppress(TypeError, ValueError):
                meta = json.loads(stated_labels["meta"])
            if not isinstance(meta, dict):
                raise ValueError(
                    f"{path.name}: array 'meta' must be a JSON object as text, got {stated_labels['meta']!r}"
                )
            stated_labels["meta"] = meta
        version = small[FORMAT_KEY].tolist() if FORMAT_KEY in small else None
        labels = labels_of_file(path.name, stated_labels, version)
        if version is not None:
            stated = self.stated_rates(0)
            if not stated:
                raise ValueError(f"{path.name}: no sampling rate: add an array 'sampling_rate'")
            self.labels = labels | {"sampling_rate": stated[0][0]}
        else:
            self.other_labels = labels
        if "angle_unit" in small:
            unit = str(small["angle_unit"].tolist())
            if unit not in ("rad", "deg"):
                raise ValueError(f"{path.name}: array 'angle_unit' must be 'rad' or 'deg', got {unit!r}")
            for index, base in enumerate(self.bases):
                if base.endswith("angle") and self.units[index] is None:
                    self.units[index] = unit
        for index, name in enumerate(self.names):
            if name == "torque":
                self.units[index] = "Nm"
            elif name in QUANTITY_UNITS and self.units[index] is None:
                self.units[index] = labels.get("meta", {}).get("unit", QUANTITY_UNITS[name])

    def raw_values(self, index: int) -> NDArray[Any]:
        with _open_archive(self.path) as archive:
            return _read_array(archive, self.members[self.names[index]])

    def is_usable(self, index: int) -> bool:
        shape, dtype = self.headers[self.members[self.names[index]]]
        return len(shape) == 1 and dtype.kind in "iuf"

    def length(self, index: int) -> int | None:
        return math.prod(self.headers[self.members[self.names[index]]][0])

    def stated_rates(self, torque: int) -> list[tuple[float, str]]:
        if self.rate is None:
            return []
        if self.rate.size != 1 or self.rate.dtype.kind not in "iuf":
            raise ValueError(
                f"{self.file}: array 'sampling_rate' must be one number in Hz, got {self.rate!r}"
            )
        rate = float(self.rate.reshape(()))
        check_rate(rate, f"{self.file}: array 'sampling_rate'")
        return [(rate, "array 'sampling_rate'")]


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an NPZ file. Pickled ones are refused: they are code."""
    with _open_archive(path) as archive:
        _check_sizes(path, archive)
        return {name.removesuffix(".npy"): _read_array(archive, name) for name in archive.namelist()}


@contextmanager
def _open_archive(path: Path) -> Iterator[zipfile.ZipFile]:
    with explain_damage(path, "NPZ"), path.open("rb") as file:
        if file.read(6) == b"\x93NUMPY":
            raise ValueError(f"{path.name} is a single array, not an NPZ archive; save it with numpy.savez")
        file.seek(0)
        with zipfile.ZipFile(file) as archive:
            yield archive


def _check_sizes(path: Path, archive: zipfile.ZipFile) -> dict[str, _Header]:
    """Return the headers; raise ``ValueError`` for arrays too large to unpack, or pickled."""
    headers = {}
    unpacked = {info.filename: info.file_size for info in archive.infolist()}
    _check_sum(path, unpacked)  # before any header: that may be as long
    for name in unpacked:
        with archive.open(name) as file:
            version = np.lib.format.read_magic(file)
            if version not in ((1, 0), (2, 0)):
                raise ValueError(
                    f"{path.name}: array {name!r} is of format {version}, which holds no plain numbers"
                )
            read_header = getattr(np.lib.format, f"read_array_header_{version[0]}_0")
            shape, _, dtype = read_header(file)
        if dtype.hasobject:
            raise ValueError(
                f"{path.name} holds pickled objects, which are never loaded; save plain numeric arrays"
            )
        headers[name] = shape, dtype
        n_bytes = dtype.itemsize * math.prod(shape)
        check_claim(path, n_bytes)
        if n_bytes > unpacked[name]:
            name = name.removesuffix(".npy")
            raise ValueError(f"{path.name} is damaged: array {name!r} claims more bytes than there are")
        unpacked[name] = np.dtype(np.float64).itemsize * math.prod(shape)  # as channels are read
    _check_sum(path, unpacked)
    return headers


def _check_sum(path: Path, unpacked: dict[str, int]) -> None:
    total, limit = sum(unpacked.values()), largest_unpacked(path)
    if total > limit:
        largest = max(unpacked, key=lambda name: unpacked[name])
        raise ValueError(
            f"{path.name} takes {total / 1e9:.3g} GB when unpacked, {unpacked[largest] / 1e9:.3g} GB of it "
            f"array {largest.removesuffix('.npy')!r}; at most {limit / 1e9:.3g} GB are unpacked from "
            f"{path.stat().st_size / 1e6:.3g} MB: split it, or save it uncompressed (numpy.savez)"
        )


def _read_array(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    with archive.open(name) as file:
        array = np.lib.format.read_array(file, allow_pickle=False)
        file.read(1)  # to the end, where the checksum is compared
        return np.asarray(array)


def write_npz(file: IO[bytes], recording: Recording, labels: dict[str, Any]) -> None:
    """Write a recording and its labels as plain arrays."""
    arrays: dict[str, NDArray[Any]] = {samples_name(recording): recording.torque}
    if recording.angle is not None:
        arrays["angle"] = recording.angle
    for key, value in labels.items():
        if key == "meta":
            value = json.dumps(value)
        elif key == WORN:
            value = np.asarray(value, dtype=np.int64)  # an empty list would become float
        arrays[key] = np.asarray(value)
    arrays[FORMAT_KEY] = np.asarray(VERSION)
    np.savez(file, **arrays)  # type: ignore[arg-type]
