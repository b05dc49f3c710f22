"""Readers of NPZ, Parquet, WAV, MDF and universal files, and the writer of NPZ files."""

from __future__ import annotations

import json
import math
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base import checks
from cyclofeat._base.quantities import QUANTITY_UNITS
from cyclofeat.datasets.readers import _words as words
from cyclofeat.datasets.readers._columns import (
    Channel,
    Source,
    check_claim,
    check_unpacked,
    explain_damage,
    open_with,
)
from cyclofeat.recordings import Recording

_Header: TypeAlias = tuple[str, tuple[int, ...], np.dtype[Any]]  # name in the archive, shape and dtype
# Of an NPZ file: no channels.
_RESERVED = {*words.LABELS, words.WORN, words.FORMAT_KEY, "sampling_rate", "angle_unit"}


def open_npz(path: Path) -> Source:
    """Return the arrays of an NPZ file, read from disk when they are asked for.

    By the layout, an array ``torque`` or ``input_torque`` is in Nm, ``motor_current`` in A, ``angle`` in rad
    and ``sampling_rate`` in Hz; a name may state another unit (``angle_deg``), and so may a text array
    ``angle_unit``.
    """
    with _open_archive(path) as archive:
        headers = _check_sizes(path, archive)
    small = {name: _read_array(path, headers[name]) for name in _RESERVED & headers.keys()}
    rates, where = [], "array 'sampling_rate'"
    if (rate := small.get("sampling_rate")) is not None:
        number = rate.item() if rate.size == 1 else rate
        rates.append((checks.positive(where, number, "a number of Hz"), where))
    labels = {key: small[key].tolist() for key in (*words.LABELS, words.WORN) if key in small}
    if "meta" in labels:
        text, labels["meta"] = labels["meta"], None
        with suppress(TypeError, ValueError):
            labels["meta"] = json.loads(text)
        if not isinstance(labels["meta"], dict):
            raise ValueError(f"array 'meta' must be a JSON object as text, got {text!r}")
    version = small[words.FORMAT_KEY].tolist() if words.FORMAT_KEY in small else None
    labels = words.labels_of_file(labels, version)
    angle_unit = str(small.get("angle_unit", "" if version is None else "rad"))
    channels = []
    for name, header in headers.items():
        _, shape, dtype = header
        if name in _RESERVED:
            continue
        usable = len(shape) == 1 and dtype.kind in "iuf"
        read = partial(_read_array, path, header)
        channel = Channel(name, read, length=math.prod(shape), usable=usable, rates=rates)
        if name == "torque":
            channel.unit = "Nm"
        elif name in QUANTITY_UNITS:
            channel.unit = channel.unit or labels.get("meta", {}).get("unit", QUANTITY_UNITS[name])
        elif channel.base.endswith("angle"):
            channel.unit = channel.unit or words.clean_unit(angle_unit)
        channels.append(channel)
    own = version is not None
    return Source(path.name, channels, "array", by_index=False, labels=labels, is_own=own, angle_unit="rad")


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an NPZ file. Pickled ones are refused: they are code."""
    with _open_archive(path) as archive:
        headers = _check_sizes(path, archive)
    return {name: _read_array(path, header) for name, header in headers.items()}


@contextmanager
def _open_archive(path: Path) -> Iterator[zipfile.ZipFile]:
    with explain_damage(path, "NPZ"), path.open("rb") as file:
        if file.read(6) == b"\x93NUMPY":
            raise ValueError(f"{path.name} is a single array, not an NPZ archive; save it with numpy.savez")
        with zipfile.ZipFile(file) as archive:
            yield archive


def _check_sizes(path: Path, archive: zipfile.ZipFile) -> dict[str, _Header]:
    """Return the headers; raise ``ValueError`` for arrays too large to unpack, or pickled."""
    headers = {}
    unpacked = {info.filename: info.file_size for info in archive.infolist()}

    def check_sum() -> None:
        name, size = max(unpacked.items(), key=lambda item: item[1], default=("", 0))
        of_it = f", {size / 1e9:.3g} GB of it array {name.removesuffix('.npy')!r}"
        check_unpacked(path, sum(unpacked.values()), of_it)

    check_sum()  # before any header: that may be as long
    for member in unpacked:
        name = member.removesuffix(".npy")
        with archive.open(member) as file:
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
        headers[name] = member, shape, dtype
        check_claim(path, dtype.itemsize * math.prod(shape))
        unpacked[member] = np.dtype(np.float64).itemsize * math.prod(shape)  # as channels are read
    check_sum()
    return headers


def _read_array(path: Path, header: _Header) -> NDArray[Any]:
    with _open_archive(path) as archive, archive.open(header[0]) as file:
        array = np.lib.format.read_array(file, allow_pickle=False)
        file.read(1)  # to the end, where the checksum is compared
        return np.asarray(array)


def write_npz(file: IO[bytes], recording: Recording, labels: dict[str, Any]) -> None:
    """Write a recording and its labels as plain arrays."""
    arrays: dict[str, NDArray[Any]] = {words.samples_name(recording): recording.torque}
    if recording.angle is not None:
        arrays["angle"] = recording.angle
    for key, value in labels.items():
        # An empty list of lobes would become float.
        arrays[key] = np.asarray(
            json.dumps(value) if key == "meta" else value, np.int64 if key == words.WORN else None
        )
    arrays[words.FORMAT_KEY] = np.asarray(words.VERSION)
    np.savez(file, **arrays)  # type: ignore[arg-type]


def open_parquet(path: Path) -> Source:
    """Return the columns of a Parquet file; units from the columns' metadata (``unit``) or names."""
    open_file = partial(
        open_with, path, "Parquet", "pyarrow.parquet",
        lambda parquet: parquet.ParquetFile(path, memory_map=True),
    )  # fmt: skip
    with open_file() as file:
        schema, n_rows = file.schema_arrow, int(file.metadata.num_rows)
    rates, where = [], "metadata 'sampling_rate'"
    if (rate := (schema.metadata or {}).get(b"sampling_rate")) is not None:
        with suppress(ValueError):
            rate = float(rate)
        rates.append((checks.positive(where, rate, "a number of Hz"), where))

    def read_column(name: str, kind: str, usable: bool) -> NDArray[Any]:
        called = f"{path.name}: column {name!r}"
        is_time = kind.startswith(("timestamp", "duration"))
        if not (usable or is_time):
            raise ValueError(f"{called} must hold real numbers, got {kind}")
        if (times := schema.names.count(name)) > 1:
            raise ValueError(f"{called} is there {times} times; names must be distinct")
        check_claim(path, 8 * n_rows)
        with open_file() as file:
            column = file.read(columns=[name]).column(0)
            if column.null_count:
                row = column.is_null().index(True).as_py() + 1
                raise ValueError(f"{called} holds nothing in row {row}; it must hold a number")
            return column.to_numpy() if is_time else np.asarray(column.to_numpy(), np.float64)

    channels = []
    for field in schema:
        kind, unit = str(field.type), (field.metadata or {}).get(b"unit")
        usable = kind.startswith(("int", "uint", "float", "double", "halffloat", "decimal"))
        read = partial(read_column, field.name, kind, usable)
        unit = unit and unit.decode()
        channels.append(
            Channel(
                field.name, read, unit, usable=usable, rates=rates, place=lambda sample: f"row {sample + 1}"
            )
        )
    return Source(path.name, channels, "column")


def open_wav(path: Path) -> Source:
    """Return the channels of a WAV file, counted from 0.

    Whole numbers are shares of full scale (-1 to 1) and need a scale in Nm; floating-point samples are taken
    as they are.
    """
    from scipy.io import wavfile

    with explain_damage(path, "WAV"), warnings.catch_warnings():
        warnings.simplefilter("error", wavfile.WavFileWarning)
        # Chunks of other programs do not matter.
        warnings.filterwarnings("ignore", "Chunk .non-data. not understood", wavfile.WavFileWarning)
        try:
            rate, samples = wavfile.read(path, mmap=True)
        except ValueError:  # 24-bit samples cannot be mapped
            rate, samples = wavfile.read(path)
    if not rate > 0:
        raise ValueError(f"{path.name}: its header states a rate of {rate!r} Hz")
    raw, table = "", samples[:, None] if samples.ndim == 1 else samples
    if samples.dtype.kind != "f":
        raw = f"shares of full scale ({samples.dtype}); give scale= (Nm at full scale)"

    def read_samples(index: int) -> NDArray[Any]:
        values = table[:, index]
        if not raw:
            return np.array(values)
        zero = 128 if values.dtype == np.uint8 else 0
        return np.asarray((values - float(zero)) / (zero or -float(np.iinfo(values.dtype).min)))

    rates = [(float(rate), "header")]
    channels = [
        Channel(str(index), partial(read_samples, index), rates=rates, raw=raw)
        for index in range(table.shape[1])
    ]
    return Source(path.name, channels, named=False)


def open_mdf(path: Path) -> Source:
    """Return the channels of an ASAM MDF file, ``group/channel`` where it has several groups."""
    open_file = partial(open_with, path, "MDF", "asammdf", lambda asammdf: asammdf.MDF(path))

    def read_samples(group: int, index: int) -> NDArray[Any]:
        with open_file() as file:
            return np.asarray(file.get(group=group, index=index, samples_only=True)[0])

    channels = []
    with open_file() as file:
        for number, group in enumerate(file.groups):
            title = str(getattr(group.channel_group, "acq_name", "") or number)
            for index, channel in enumerate(group.channels):
                is_time = index == file.masters_db.get(number)
                name = "time" if is_time else str(channel.name)
                channels.append(Channel(
                    f"{title}/{name}" if len(file.groups) > 1 else name,
                    partial(read_samples, number, index), str(channel.unit or "s" * is_time), name,
                    str(number), int(group.channel_group.cycles_nr),
                    meta={"start_time": str(file.start_time)},
                ))  # fmt: skip
    return Source(path.name, channels)


def open_universal(path: Path) -> Source:
    """Return the records of a universal file: its data sets of type 58, by their first line."""
    channels: list[Channel] = []
    with open_with(
        path, "a universal file", "pyuff", lambda pyuff: nullcontext(pyuff.UFF(str(path)))
    ) as file:
        sets = [number for number, kind in enumerate(file.get_set_types()) if kind == 58]
        for count, number in enumerate(sets, 1):
            head = file.read_sets(number)
            name, unit = (
                "" if text.upper() == "NONE" else text
                for text in (str(head[key]).strip() for key in ("id1", "ordinate_axis_units_lab"))
            )
            values, even = np.asarray(head["data"]), head["abscissa_spacing"] == 1
            step = ("dt", float(head["abscissa_inc"]), "s", f"abscissa of record {count}")
            channels.append(Channel(
                name or f"record {count}", partial(np.asarray, values), unit, length=values.size,
                usable=values.dtype.kind == "f" and head["func_type"] == 1,
                rates=words.list_rates([step] if even else []),
            ))  # fmt: skip
    return Source(path.name, channels, "record")
