"""Reader of NI TDMS files."""

from __future__ import annotations

import io
import logging
import re
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.datasets.readers._columns import (
    CURRENT_UNITS,
    TORQUE_UNITS,
    Source,
    clean_unit,
    explain_damage,
    import_library,
)
from cyclofeat.datasets.readers._times import named_rate

_LEAD_IN = 28
_BIG_ENDIAN, _INTERLEAVED, _DAQMX = 1 << 6, 1 << 5, 1 << 7
# A channel's path in the description of a segment, or the increment of the channel last named (a double).
_INCREMENT = re.compile(rb"(/'(?:[^']|'')*'/'(?:[^']|'')*')|wf_increment(?s:[\x0a\x00]{4})(.{8})", re.DOTALL)
_UNKNOWN_LENGTH = 2**64 - 1  # of the last segment, where the recording program died
_VERSIONS = (4712, 4713)
# npTDMS reads interleaved data whole segments at a time unless asked for parts: this many bytes each.
_BLOCK = 2**23
# Scales that npTDMS computes. For any other it logs a line and hands over raw counts.
_SCALES = {
    "Linear", "Polynomial", "RTD", "Strain", "Table", "Thermistor", "Thermocouple", "Add", "Subtract",
    "AdvancedAPI",
}  # fmt: skip
_UNIT_PROPERTIES = ("unit_string", "NI_UnitDescription", "unit", "Unit")


class TdmsSource(Source):
    """Channels of a TDMS file, named ``group/channel``; read in parts, so that one may lie in a huge file.

    The index file that may lie beside it is not used: it may be of another recording.
    """

    def __init__(self, path: Path) -> None:
        self.interleaved, self.steps = _check_segments(path)
        with _open_tdms(path) as file:
            channels = [channel for group in file.groups() for channel in group.channels()]
            self.keys = [(channel.group_name, channel.name) for channel in channels]
            self.paths = [channel.path for channel in channels]
            self.lengths = [len(channel) for channel in channels]
            self.kinds: list[np.dtype[Any] | None] = []
            for channel in channels:
                try:
                    self.kinds.append(np.dtype(channel.dtype))
                except Exception:  # it has no type, or a scale that cannot be computed: reading it says why
                    self.kinds.append(None)
            self.scopes = [
                (dict(channel.properties), dict(file[channel.group_name].properties), dict(file.properties))
                for channel in channels
            ]
            self.daqmx = [bool(channel.scaler_data_types) for channel in channels]
        units = [
            next((str(properties[key]) for key in _UNIT_PROPERTIES if properties.get(key)), None)
            for properties, *_ in self.scopes
        ]
        super().__init__(
            path, [f"{group}/{name}" for group, name in self.keys], units, [name for _, name in self.keys]
        )

    def is_usable(self, index: int) -> bool:
        kind = self.kinds[index]
        return self.lengths[index] > 0 and kind is not None and kind.kind in "iuf"

    def length(self, index: int) -> int | None:
        return self.lengths[index]

    def stated_rates(self, torque: int) -> list[tuple[float, str]]:
        unit = clean_unit(str(self.scopes[torque][0].get("wf_xunit_string", ""))) or "s"
        steps = self.steps.get(self.paths[torque], {})
        stated = {}
        for step, segment in steps.items():
            of_segment = f" of segment {segment}" if len(steps) > 1 else ""
            stated[f"property 'wf_increment'{of_segment}"] = named_rate("dt", step, unit)
        for scope, where in zip(self.scopes[torque], ("", " of the group", " of the file"), strict=True):
            for name, value in scope.items():
                if isinstance(value, (int, float, np.number)) and name != "wf_increment":
                    stated[f"property {name!r}{where}"] = named_rate(name, float(value))
        return [(rate, where) for where, rate in stated.items() if rate is not None]

    def channel_meta(self, torque: int) -> dict[str, Any]:
        start = self.scopes[torque][0].get("wf_start_time")
        return {} if start is None else {"start_time": str(start)}

    def check_torque(self, torque: int, scale: float | None) -> None:
        self._check_scales(torque)
        kind = self.kinds[torque]
        scaled = self.units[torque] in TORQUE_UNITS | CURRENT_UNITS
        counts = kind is not None and kind.kind in "iu" and not scaled
        properties = self.scopes[torque][0]
        unscaled = properties.get("NI_Scaling_Status") == "unscaled" and not _n_scales(properties)
        if (counts or unscaled) and scale is None:
            raise ValueError(
                f"{self.file}: channel {self.names[torque]!r} holds raw counts ({kind}), and the file states "
                "no scale; give scale= (Nm per count)"
            )

    def _check_scales(self, index: int) -> None:
        unscaled = (scope for scope in self.scopes[index] if scope.get("NI_Scaling_Status") != "scaled")
        scope = next(filter(_n_scales, unscaled), {})  # the innermost one with scales applies
        for number in range(_n_scales(scope)):
            kind = scope.get(f"NI_Scale[{number}]_Scale_Type")
            if not (kind in _SCALES or (kind is None and self.daqmx[index])):
                raise ValueError(
                    f"{self.file}: channel {self.names[index]!r} has a scale that cannot be computed "
                    f"(NI_Scale[{number}]: {kind!r}); known are {', '.join(sorted(_SCALES))}. Save it "
                    "scaled: raw counts are not read in its place"
                )

    def raw_values(self, index: int) -> NDArray[Any]:
        self._check_scales(index)
        group, name = self.keys[index]
        n_values, dtype = self.lengths[index], self.kinds[index]
        called = f"{self.file}: channel {self.names[index]!r}"
        if n_values and (dtype is None or dtype.kind not in "iufM"):
            raise ValueError(f"{called} must hold real numbers, got {dtype or 'another type'}")
        size = self.path.stat().st_size
        if n_values > size:  # no sample takes less than a byte
            raise ValueError(f"{self.file} is damaged: it claims {n_values} samples in {size} bytes")
        with _open_tdms(self.path) as file:
            channel = file[group][name]
            values: NDArray[Any] = np.empty(
                n_values, dtype if dtype is not None and dtype.kind == "M" else np.float64
            )
            if self.interleaved:
                rows = max(1, _BLOCK * n_values // max(size, 1))
                starts = range(0, n_values, rows)
                parts = (channel.read_data(start, min(rows, n_values - start)) for start in starts)
            else:
                parts = (chunk[:] for chunk in channel.data_chunks())
            done = 0
            for part in parts:
                if done + len(part) > n_values:
                    break
                values[done : done + len(part)] = part
                done += len(part)
        if done != n_values:
            raise ValueError(f"{called} is not whole: {done} of {n_values} samples are there")
        return values


class _Bounded(io.BufferedReader):
    """File that never reads more bytes than it has: a damaged length must not fill the memory."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self.size = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        rest = max(0, self.size - self.tell())
        return super().read(rest if size is None or size < 0 else min(size, rest))


@contextmanager
def _open_tdms(path: Path) -> Iterator[Any]:
    """Open the file with npTDMS; its log messages about lost data become errors."""
    nptdms = import_library("nptdms", ".tdms", "npTDMS")
    loggers = list(import_module("nptdms.log").log_manager.loggers.values())
    lost: list[str] = []

    def keep_losses(record: logging.LogRecord) -> bool:
        text = record.getMessage()
        if text.startswith(("Data size", "Cropping", "Last segment")):
            lost.append(text.partition(". ")[0])
        return False

    for logger in loggers:
        logger.addFilter(keep_losses)
    try:
        with _Bounded(path) as stream, explain_damage(path, "TDMS"), nptdms.TdmsFile.open(stream) as file:
            yield file
    finally:
        for logger in loggers:
            logger.removeFilter(keep_losses)
    if lost:
        raise ValueError(f"{path.name} is damaged: {lost[0]}")


def _check_segments(path: Path) -> tuple[bool, dict[str, dict[float, int]]]:
    """Check the lead-ins of all segments, and read the increments of waveforms from them.

    Return True if any segment holds interleaved data, and for each channel's path its increments with the
    first segment (from 1) that has samples at each; npTDMS keeps only the last increment. It
    reads what it can of a damaged file; a record that lost its end must not pass for a whole one.
    """
    size = path.stat().st_size
    position, interleaved, number = 0, False, 0
    current: dict[str, float] = {}
    steps: dict[str, dict[float, int]] = {}
    with path.open("rb") as file:
        while position < size:
            file.seek(position)
            lead_in = file.read(_LEAD_IN)
            where = f"the segment at byte {position}"
            if lead_in[:4] != b"TDSm":
                problem = f"is damaged: {where}" if position else "is no TDMS file: it"
                raise ValueError(f"{path.name} {problem} does not begin with 'TDSm'")
            if len(lead_in) < _LEAD_IN:
                raise ValueError(f"{path.name} is not whole: {where} ends within its lead-in")
            (mask,) = struct.unpack("<l", lead_in[4:8])
            order = ">" if mask & _BIG_ENDIAN else "<"
            version, following, data = struct.unpack(f"{order}lQQ", lead_in[8:])
            if version not in _VERSIONS:
                raise ValueError(
                    f"{path.name}: {where} is of TDMS version {version}, known are {_VERSIONS[0]} and "
                    f"{_VERSIONS[1]}"
                )
            end = position + _LEAD_IN + following
            if following == _UNKNOWN_LENGTH or end > size:
                raise ValueError(
                    f"{path.name} is not whole: {where} has no end (was the recording broken off?)"
                )
            if data > following:
                raise ValueError(f"{path.name} is damaged: {where} has its data after its end")
            interleaved |= bool(mask & (_INTERLEAVED | _DAQMX))
            owner, number = "", number + 1
            for match in _INCREMENT.finditer(file.read(data)):
                owner = match[1].decode("utf-8", "replace") if match[1] else owner
                if match[2]:
                    current[owner] = struct.unpack(f"{order}d", match[2])[0]
            if following > data:
                for owner, step in current.items():
                    steps.setdefault(owner, {}).setdefault(step, number)
            position = end
    return interleaved, steps


def _n_scales(properties: Mapping[str, Any]) -> int:
    """Number of scales that a channel, group or file states."""
    if "NI_Number_Of_Scales" in properties:
        return int(properties["NI_Number_Of_Scales"])
    matches = [re.match(r"NI_Scale\[(\d+)\]_Scale_Type", key) for key in properties]
    return max((int(match[1]) + 1 for match in matches if match), default=0)
