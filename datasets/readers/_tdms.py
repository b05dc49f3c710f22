"""Reader of NI TDMS files."""

from __future__ import annotations

import io
import logging
import re
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.datasets.readers import _words as words
from cyclofeat.datasets.readers._columns import Channel, Source, open_with

_LEAD_IN = 28
_BIG_ENDIAN = 1 << 6
# A channel's path in the description of a segment, or the increment of the channel last named (a double).
_INCREMENT = re.compile(rb"(/'(?:[^']|'')*'/'(?:[^']|'')*')|wf_increment(?s:[\x0a\x00]{4})(.{8})", re.DOTALL)
# npTDMS reads whole segments at a time unless asked for parts: this many bytes each.
_BLOCK = 2**23
_MOST_SCALES = 1000
# Scales that npTDMS computes. For any other it logs a line and hands over raw counts.
_SCALES = {
    "Linear", "Polynomial", "RTD", "Strain", "Table", "Thermistor", "Thermocouple", "Add", "Subtract",
    "AdvancedAPI",
}  # fmt: skip
_UNIT_PROPERTIES = ("unit_string", "NI_UnitDescription", "unit", "Unit")


def open_tdms(path: Path) -> Source:
    """Return the channels of a TDMS file, named ``group/channel``; each is read in parts from a huge file.

    The index file that may lie beside it is not used: it may be of another recording.
    """
    increments = _check_segments(path)
    with _open_tdms(path) as file:
        channels = [
            _describe_channel(path, file, channel, increments.get(channel.path, []))
            for group in file.groups()
            for channel in group.channels()
        ]
    return Source(path.name, channels)


def _describe_channel(
    path: Path, file: Any, channel: Any, increments: list[tuple[int, int, float]]
) -> Channel:
    name, properties = f"{channel.group_name}/{channel.name}", dict(channel.properties)
    scopes = (properties, dict(file[channel.group_name].properties), dict(file.properties))
    claimed = max(map(_n_scales, scopes))
    if claimed > _MOST_SCALES:  # npTDMS would count them one by one
        raise ValueError(f"{path.name} is damaged: channel {name!r} claims {claimed} scales")
    try:
        dtype: np.dtype[Any] | None = np.dtype(channel.dtype)
    except Exception:  # it has no type, or a scale that cannot be computed: reading it says why
        dtype = None
    kind = "?" if dtype is None else dtype.kind
    unit = next((str(properties[key]) for key in _UNIT_PROPERTIES if properties.get(key)), None)

    # The innermost scope with scales applies.
    scales = next(filter(_n_scales, (s for s in scopes if s.get("NI_Scaling_Status") != "scaled")), {})
    kinds = [scales.get(f"NI_Scale[{number}]_Scale_Type") for number in range(_n_scales(scales))]
    daqmx = bool(channel.scaler_data_types)
    unknown = [(n, k) for n, k in enumerate(kinds) if not (k in _SCALES or (k is None and daqmx))]
    error, raw = "", ""
    if unknown:
        error = (
            f"has a scale that cannot be computed (NI_Scale[{unknown[0][0]}]: {unknown[0][1]!r}); known are "
            f"{', '.join(sorted(_SCALES))}. Save it scaled: raw counts are not read in its place"
        )
    elif (kind in "iu" and words.clean_unit(unit) not in words.TORQUE_UNITS | words.CURRENT_UNITS) or (
        properties.get("NI_Scaling_Status") == "unscaled" and not _n_scales(properties)
    ):
        raw = f"raw counts ({dtype}), and the file states no scale; give scale= (Nm per count)"

    step_unit = words.clean_unit(str(properties.get("wf_xunit_string", ""))) or "s"
    several = len(increments) > 1
    stated: list[tuple[str, float, str | None, str]] = [
        ("dt", step, step_unit, "property 'wf_increment'" + f" of segment {number}" * several)
        for number, _, step in increments
    ]
    stated += [
        (key, float(value), None, f"property {key!r}{where}")
        for scope, where in zip(scopes, ("", " of the group", " of the file"), strict=True)
        for key, value in scope.items()
        if isinstance(value, (int, float, np.number)) and key != "wf_increment"
    ]
    start_time = properties.get("wf_start_time")
    return Channel(
        name, partial(_read_samples, path, name, (channel.group_name, channel.name), dtype, error), unit,
        channel.name, length=len(channel), usable=len(channel) > 0 and kind in "iuf",
        rates=words.list_rates(stated), meta={} if start_time is None else {"start_time": str(start_time)},
        raw=raw,
        segments=partial(_segment_starts, path, channel.path, increments, step_unit) if several else None,
    )  # fmt: skip


def _read_samples(
    path: Path, name: str, key: tuple[str, str], dtype: np.dtype[Any] | None, error: str
) -> NDArray[Any]:
    called, size = f"{path.name}: channel {name!r}", path.stat().st_size
    if error:
        raise ValueError(f"{called} {error}")
    with _open_tdms(path) as file:
        channel = file[key[0]][key[1]]
        n_values, done = len(channel), 0
        if n_values and (dtype is None or dtype.kind not in "iufM"):
            raise ValueError(f"{called} must hold real numbers, got {dtype or 'another type'}")
        if n_values > size:  # no sample takes less than a byte
            raise ValueError(f"{path.name} is damaged: it claims {n_values} samples in {size} bytes")
        values: NDArray[Any] = np.empty(n_values, dtype if dtype is not None and dtype.kind == "M" else float)
        rows = max(1, _BLOCK * n_values // max(size, 1))
        for start in range(0, n_values, rows):
            part = channel.read_data(start, min(rows, n_values - start))
            values[start : start + len(part)] = part
            done += len(part)
    if done != n_values:
        raise ValueError(f"{called} is not whole: {done} of {n_values} samples are there")
    return values


def _segment_starts(
    path: Path, channel: str, increments: list[tuple[int, int, float]], unit: str
) -> list[tuple[int, float]]:
    """Return the first sample and the rate of each segment with another increment."""
    starts = [0]
    for _, position, _ in increments[1:]:
        with _open_tdms(path, position) as file:
            lengths = {each.path: len(each) for group in file.groups() for each in group.channels()}
        starts.append(lengths.get(channel, 0))
    rates = [words.named_rate("dt", step, unit) or 0.0 for _, _, step in increments]
    return list(zip(starts, rates, strict=True))


class _Bounded(io.BufferedReader):
    """File that never reads beyond an end: a damaged length must not fill the memory."""

    def __init__(self, path: Path, end: int | None) -> None:
        super().__init__(io.FileIO(path))
        self.end = path.stat().st_size if end is None else end

    def read(self, size: int | None = -1, /) -> bytes:
        rest = max(0, self.end - self.tell())
        return super().read(rest if size is None or size < 0 else min(size, rest))

    def seek(self, offset: int, whence: int = 0, /) -> int:
        return super().seek(self.end + offset) if whence == 2 else super().seek(offset, whence)


@contextmanager
def _open_tdms(path: Path, end: int | None = None) -> Iterator[Any]:
    """Open the file with npTDMS, up to an end; its log messages about lost data become errors."""
    lost: list[str] = []

    def keep_losses(record: logging.LogRecord) -> bool:
        text = record.getMessage()
        if text.startswith(("Data size", "Cropping", "Last segment")):
            lost.append(text.partition(". ")[0])
        return False

    loggers = []

    def open_file(nptdms: Any) -> Any:
        loggers.extend(nptdms.log.log_manager.loggers.values())
        for logger in loggers:
            logger.addFilter(keep_losses)
        return nptdms.TdmsFile.open(stream)

    try:
        with _Bounded(path, end) as stream, open_with(path, "TDMS", "nptdms", open_file) as file:
            yield file
    finally:
        for logger in loggers:
            logger.removeFilter(keep_losses)
    if lost:
        raise ValueError(f"{path.name} is damaged: {lost[0]}")


def _check_segments(path: Path) -> dict[str, list[tuple[int, int, float]]]:
    """Check the lead-ins of all segments, and read the increments of waveforms from them.

    Return for each channel's path its increments where they change, with the number of the segment (from 1)
    and its first byte; npTDMS keeps only the last increment.
    It reads what it can of a damaged file; a record that lost its end must not pass for a whole one.
    """
    size = path.stat().st_size
    position, number = 0, 0
    current: dict[str, float] = {}
    increments: dict[str, list[tuple[int, int, float]]] = {}
    with path.open("rb") as file:
        while position < size:
            file.seek(position)
            lead_in, number = file.read(_LEAD_IN), number + 1
            where = f"the segment at byte {position}"
            if lead_in[:4] != b"TDSm":
                problem = f"is damaged: {where}" if position else "is no TDMS file: it"
                raise ValueError(f"{path.name} {problem} does not begin with 'TDSm'")
            lead_in = lead_in.ljust(_LEAD_IN, b"\xff")  # one that was cut has no end
            (mask,) = struct.unpack("<l", lead_in[4:8])
            order = ">" if mask & _BIG_ENDIAN else "<"
            version, following, data = struct.unpack(f"{order}lQQ", lead_in[8:])
            end = position + _LEAD_IN + following
            if end > size:
                raise ValueError(
                    f"{path.name} is not whole: {where} has no end (was the recording broken off?)"
                )
            if version not in (4712, 4713):
                raise ValueError(f"{path.name}: {where} is of TDMS version {version}, not 4712 or 4713")
            if data > following:
                raise ValueError(f"{path.name} is damaged: {where} has its data after its end")
            owner = ""
            for match in _INCREMENT.finditer(file.read(data)):
                owner = match[1].decode("utf-8", "replace") if match[1] else owner
                if match[2]:
                    current[owner] = struct.unpack(f"{order}d", match[2])[0]
            if following > data:
                for owner, step in current.items():
                    changes = increments.setdefault(owner, [])
                    if not changes or changes[-1][2] != step:
                        changes.append((number, position, step))
            position = end
    return increments


def _n_scales(properties: Mapping[str, Any]) -> int:
    """Number of scales that a channel, group or file states."""
    if "NI_Number_Of_Scales" in properties:
        return int(properties["NI_Number_Of_Scales"])
    matches = [re.match(r"NI_Scale\[(\d+)\]_Scale_Type", key) for key in properties]
    return max((int(match[1]) + 1 for match in matches if match), default=0)
