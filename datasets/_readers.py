"""Torque records from and to CSV and NPZ files."""

from __future__ import annotations

import csv
import json
import math
import os
import re
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from numpy.typing import NDArray

from cyclofeat._files import write_whole
from cyclofeat.recording import Recording

Float = NDArray[np.float64]
Channel = str | int

_FORMAT, _FORMAT_KEY = "cyclofeat recording", "cyclofeat_recording"
_VERSION = 1
# Parameters of Recording that a caller may give, and that written files hold.
_LABELS = (
    "angle_of", "angle_is_absolute", "assembly", "run", "defect_count", "worn_lobes", "speed_rpm", "load_nm",
    "source", "meta",
)  # fmt: skip

_TORQUE_NAMES = {"torque", "torque_out", "output_torque"}
_TIME_NAMES = {"time", "t"}
_ANGLE_NAMES = {"angle", "input_angle", "disc_angle"}
_TORQUE_UNITS = {"Nm": 1.0, "kNm": 1e3, "mNm": 1e-3, "Ncm": 1e-2, "Nmm": 1e-3}
_TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
_ANGLE_UNITS = {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180}

# Units that may follow a name after an underscore, as in torque_nm.
_UNIT_SUFFIXES = {unit.lower(): unit for unit in ("Nm", "kNm", "mNm", "rad", "deg", "s", "ms", "us")}

# Rounded times lie within a fraction of a sample of even spacing; one missing sample moves them by at least
# half a sample somewhere.
_JITTER = 0.25


def read_recording(
    path: str | os.PathLike[str],
    *,
    channel: Channel | None = None,
    sampling_rate: float | None = None,
    time_channel: Channel | None = None,
    angle_channel: Channel | Literal[False] | None = None,
    angle_unit: str | None = None,
    scale: float | None = None,
    delimiter: str | None = None,
    **labels: Any,
) -> Recording:
    """Read one torque record from a CSV or NPZ file.

    What is assumed (unit, decimal comma, sampling rate from a time column) is stated in the recording's
    ``meta`` and by :func:`describe_recording`.

    Parameters
    ----------
    path : path
        File ending in ``.csv`` or ``.npz``.

        CSV: one row per sample, separated by comma, semicolon or tab, with or without a row of column names,
        in UTF-8. Units may stand behind the name: ``torque [Nm]``, ``torque (Nm)``, ``torque / Nm``,
        ``torque_nm``. With semicolon or tab, a comma in a number is a decimal comma.

        NPZ: arrays ``torque`` (n,) in Nm, ``sampling_rate`` () in Hz, optionally ``angle`` (n,) in rad, and
        the labels that :func:`write_recording` writes. Pickled objects are never loaded.
    channel : str or int, optional
        Column (name, or index from 0) or NPZ array that holds the torque. Default: the one called "torque",
        "torque_out" or "output_torque", else the only one beside time and angle.
    sampling_rate : float, optional
        Samples per second, in Hz. Needed where the file does not state it; an error where the file
        contradicts it.
    time_channel : str or int, optional
        Column of the time, from which the rate follows. Default: the one called "time" or "t". In s unless
        its name says ms or us.
    angle_channel : str, int or False, optional
        Column or array of the angle. Default: the one called "angle", "input_angle" or "disc_angle"; False
        leaves it out.
    angle_unit : {"rad", "deg"}, optional
        Unit of a CSV's angle column; needed where the column's name does not state it.
    scale : float, optional
        Nm per unit of the channel, for files in another unit than Nm, kNm, mNm, Ncm or Nmm.
    delimiter : {",", ";", "\\\\t"}, optional
        Separator of a CSV's columns. Default: the first of tab, semicolon, comma in the first row.
    **labels
        Further parameters of :class:`~cyclofeat.recording.Recording`, e.g. ``assembly="A1"``. They take
        precedence over labels in the file; ``meta`` is merged.

    Returns
    -------
    Recording

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    TypeError
        If a parameter is of the wrong type or unknown.
    ValueError
        If the file is not what it should be: the message names the file, what came and what would be right.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "rig.csv"
    ...     _ = path.write_text("time [ms];torque [Nm]\\n0;21,9\\n0,5;22,1\\n1;22,0\\n")
    ...     recording = read_recording(path, assembly="A1", speed_rpm=500)
    >>> recording.torque.tolist(), recording.sampling_rate
    ([21.9, 22.1, 22.0], 2000.0)
    """
    path = _path(path)
    unknown = labels.keys() - set(_LABELS)
    if unknown:
        raise TypeError(f"unknown label {min(unknown)!r}; known are {', '.join(_LABELS)}")
    if sampling_rate is not None:
        _check_rate("sampling_rate", sampling_rate)
    if scale is not None and not (_is_number(scale) and scale != 0):
        raise ValueError(f"scale must be a finite number other than 0 (Nm per unit), got {scale!r}")
    if angle_unit not in (None, "rad", "deg"):
        raise ValueError(f"angle_unit must be 'rad' or 'deg', got {angle_unit!r}")
    if delimiter not in (None, ",", ";", "\t"):
        raise ValueError(f"delimiter must be ',', ';' or a tab, got {delimiter!r}")
    if path.is_dir():
        raise ValueError(f"{path} is a directory; give a .csv or .npz file in it")
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    suffix = _suffix(path, "read")
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty")
    if suffix == ".csv":
        found = _read_csv(
            path, channel, sampling_rate, time_channel, angle_channel, angle_unit, scale, delimiter
        )
    else:
        for name, value in (
            ("time_channel", time_channel), ("angle_unit", angle_unit), ("delimiter", delimiter),
        ):  # fmt: skip
            if value is not None:
                raise ValueError(f"{name} is for CSV files, got {value!r} for {path.name}")
        found = _read_npz(path, channel, sampling_rate, angle_channel, scale)
    if "angle" not in found:  # left out: then what the file says of it is void
        found = {key: value for key, value in found.items() if not key.startswith("angle")}
    meta = found.pop("meta", {}) | dict(labels.pop("meta", None) or {})
    if labels.get("worn_lobes") is not None:
        found.pop("defect_count", None)  # the file's count belongs to the file's lobes
    elif labels.get("defect_count") is not None:
        found.pop("worn_lobes", None)
    try:
        return Recording(**(found | labels), meta=meta)
    except (TypeError, ValueError) as error:
        hint = " (angle_channel=False leaves the angle out)" if str(error).startswith("angle must") else ""
        raise type(error)(f"{path.name}: {error}{hint}") from None


def write_recording(path: str | os.PathLike[str], recording: Recording) -> None:
    """Write a recording with all its labels to a CSV or NPZ file.

    :func:`read_recording` gives back an equal recording. The file appears under its name only when it is
    whole; a file of that name is replaced.

    Parameters
    ----------
    path : path
        File ending in ``.csv`` (readable, with the labels as comments at its head) or ``.npz`` (smaller and
        faster).
    recording : Recording
        Its ``meta`` must hold only what JSON can hold: text, finite numbers, booleans, None, lists and
        dictionaries with text keys.

    Raises
    ------
    FileNotFoundError
        If the folder does not exist.
    TypeError
        If ``recording`` is not a Recording, or its ``meta`` holds something else.
    ValueError
        If the path is a directory or ends otherwise.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> recording = Recording([21.9, 22.1, 22.0], 25_600, assembly="A1", worn_lobes=(0, 4))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "run.npz"
    ...     write_recording(path, recording)
    ...     read_recording(path) == recording
    True
    """
    path = _path(path)
    if not _is_recording(recording):
        raise TypeError(f"recording must be a Recording, got {type(recording).__name__}")
    if path.is_dir():
        raise ValueError(f"{path} is a directory; give a file name")
    suffix = _suffix(path, "written")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"no such folder: {path.parent}")
    labels = _labels_to_write(recording)
    write = _write_csv if suffix == ".csv" else _write_npz
    write_whole(path, lambda file: write(file, recording, labels))


def describe_recording(recording: Recording) -> dict[str, Any]:
    """What a recording holds: channel, unit, range, rate, duration and labels.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    dict
        ``file``, ``channel``, ``unit`` (Nm, unless ``meta`` states another for a record that is no torque),
        ``unit_assumed`` (bool), ``minimum``, ``maximum``, ``mean``, ``std`` (in that unit), ``constant``
        (bool), ``sampling_rate`` (Hz), ``rate_from``, ``n_samples``, ``duration_s``, ``angle`` (None, or
        shaft and kind of zero), ``speed_rpm``, ``load_nm``, ``assembly``, ``run``, ``defect_count``,
        ``worn_lobes`` (list, from 0) and ``source``. None stands for what is not known. Fit for JSON.

    Examples
    --------
    >>> found = describe_recording(Recording([21.0, 23.0], 25_600, speed_rpm=500))
    >>> found["unit"], found["minimum"], found["maximum"], found["sampling_rate"], found["n_samples"]
    ('Nm', 21.0, 23.0, 25600.0, 2)
    """
    torque = recording.torque
    meta = recording.meta or {}
    low, high = float(torque.min()), float(torque.max())
    angle = None
    if recording.angle is not None:
        angle = f"{recording.angle_of}, {'absolute' if recording.angle_is_absolute else 'relative'}"
    return {
        "file": meta.get("file"),
        "channel": meta.get("channel", "torque"),
        "unit": meta.get("unit", "Nm"),
        "unit_assumed": bool(meta.get("unit_assumed", False)),
        "minimum": low,
        "maximum": high,
        "mean": float(torque.mean()),
        "std": float(torque.std()),
        "constant": low == high,
        "sampling_rate": recording.sampling_rate,
        "rate_from": meta.get("rate_from"),
        "n_samples": recording.n_samples,
        "duration_s": recording.duration,
        "angle": angle,
        "speed_rpm": recording.speed_rpm,
        "load_nm": recording.load_nm,
        "assembly": recording.assembly,
        "run": recording.run,
        "defect_count": recording.defect_count,
        "worn_lobes": None if recording.worn_lobes is None else list(recording.worn_lobes),
        "source": recording.source,
    }


def one_line(recording: Recording) -> str:
    """A recording in one line for people, lobes counted from 1.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    str

    Examples
    --------
    >>> one_line(Recording([21.0, 23.0], 2_000, run="r7", worn_lobes=(0, 4)))
    "run 'r7': torque 21 to 23 Nm (mean 22), 2000 Hz, 2 samples = 0.001 s, no angle, 2 worn lobes (1, 5)"
    """
    found = describe_recording(recording)
    names = [f"{key} {found[key]!r}" for key in ("run", "assembly") if found[key] is not None]
    name = ", ".join(([found["file"]] if found["file"] else []) + names)
    unit = found["unit"] + (" (unit assumed)" if found["unit_assumed"] else "")
    values = f"{found['minimum']:.4g} to {found['maximum']:.4g} {unit} (mean {found['mean']:.4g})"
    parts = [f"{found['channel']} {values}"]
    if found["constant"]:
        parts.append("CONSTANT")
    rate_from = f" from {found['rate_from']}" if found["rate_from"] else ""
    parts.append(f"{found['sampling_rate']:g} Hz{rate_from}")
    parts.append(f"{found['n_samples']} samples = {found['duration_s']:.4g} s")
    if found["speed_rpm"] is not None:
        parts.append(f"{found['speed_rpm']:g} RPM")
    if found["load_nm"] is not None:
        parts.append(f"load {found['load_nm']:g} Nm")
    parts.append("no angle" if found["angle"] is None else f"angle of the {found['angle']}")
    if found["defect_count"] is not None:
        lobes = ", ".join(str(lobe + 1) for lobe in found["worn_lobes"] or ())
        count = found["defect_count"]
        parts.append(f"{count} worn lobe{'' if count == 1 else 's'}" + (f" ({lobes})" if lobes else ""))
    if found["source"]:
        parts.append(found["source"])
    return f"{name}: {', '.join(parts)}" if name else ", ".join(parts)


# -- CSV


def _read_csv(
    path: Path,
    channel: Channel | None,
    sampling_rate: float | None,
    time_channel: Channel | None,
    angle_channel: Channel | Literal[False] | None,
    angle_unit: str | None,
    scale: float | None,
    delimiter: str | None,
) -> dict[str, Any]:
    table = _Table(path, delimiter)
    stated = table.labels  # of a file that write_recording wrote; else None
    time = table.find("time_channel", time_channel, _TIME_NAMES)
    angle = None
    if angle_channel is not False:
        angle = table.find("angle_channel", angle_channel, _ANGLE_NAMES)
    torque = table.torque_column(channel, {time, angle})

    factor, unit_assumed = _torque_factor(path, table.names[torque], table.units[torque], scale)
    found: dict[str, Any] = {"torque": table.column(torque) * factor}
    if angle is not None:
        stated_unit = table.units[angle]
        unit = angle_unit or stated_unit
        if stated_unit in _ANGLE_UNITS and _ANGLE_UNITS[stated_unit] != _ANGLE_UNITS.get(unit or ""):
            raise ValueError(
                f"{path.name}: angle_unit = {angle_unit!r} contradicts the column {table.names[angle]!r}"
            )
        if unit not in _ANGLE_UNITS:
            raise ValueError(
                f"{path.name}: column {table.names[angle]!r} does not say whether it is in rad or deg; give "
                "angle_unit='rad' or 'deg', or angle_channel=False to leave it out"
            )
        found["angle"] = table.column(angle) * _ANGLE_UNITS[unit]
        found["angle_of"] = "disc" if table.bases[angle] == "disc_angle" else "input"

    if stated is not None:
        _check_same_rate(path, sampling_rate, stated["sampling_rate"], "its header", tolerance=1e-6)
        return found | stated
    rate, rate_from = _csv_rate(path, table, time, sampling_rate, asked=time_channel is not None)
    meta = {
        "file": path.name,
        "channel": table.names[torque],
        "unit_assumed": unit_assumed,
        "rate_from": rate_from,
    }
    if table.decimal_comma:
        meta["decimal_comma"] = True
    if factor != 1:
        meta["scale"] = factor
    return found | {"sampling_rate": rate, "meta": meta}


def _csv_rate(
    path: Path, table: _Table, time: int | None, given: float | None, *, asked: bool
) -> tuple[float, str]:
    if time is None:
        if given is None:
            raise ValueError(
                f"{path.name}: no sampling rate: give sampling_rate= (Hz), or time_channel= for a column of "
                f"times; columns are {table.listed()}"
            )
        return float(given), "argument"
    name = table.names[time]
    unit = table.units[time] or "s"
    if unit not in _TIME_UNITS:
        raise ValueError(
            f"{path.name}: time column {name!r} must be in {', '.join(_TIME_UNITS)}, got {unit!r}"
        )
    try:
        seconds = table.column(time) * _TIME_UNITS[unit]
    except ValueError:
        if given is None or asked:
            raise
        return float(given), "argument"  # a clock in text: the rate was given, so it is not needed
    if given is not None:
        span = float(seconds[-1] - seconds[0])
        stated = (seconds.size - 1) / span if span > 0 else 0.0
        _check_same_rate(path, given, stated, f"its time column {name!r}", tolerance=0.01)
        return float(given), "argument"
    return _rate_from_time(path, name, seconds, table.first_line), f"time column {name!r}"


def _rate_from_time(path: Path, name: str, seconds: Float, first_line: int) -> float:
    """Rate of an evenly spaced time column."""
    steps = seconds.size - 1
    if not seconds[-1] > seconds[0]:
        raise ValueError(
            f"{path.name}: time column {name!r} must rise, it goes from {seconds[0]:g} to {seconds[-1]:g} s"
        )
    rate = steps / float(seconds[-1] - seconds[0])
    off = np.abs((seconds - seconds[0]) * rate - np.arange(seconds.size))
    worst = int(np.argmax(off))
    if off[worst] > _JITTER:
        raise ValueError(
            f"{path.name}: time column {name!r} is not evenly spaced: at line {first_line + worst} it is "
            f"{off[worst]:.2g} samples away from {rate:.6g} Hz (samples missing, or times rounded too "
            "coarsely); if the samples are even, give sampling_rate="
        )
    # Rounded times give 25600.0003 Hz, and no two files the same rate: a whole number of Hz within what the
    # column's own scatter leaves open is taken.
    slack = rate * (2 * float(off[worst]) / steps + 1e-9)
    return float(round(rate)) if abs(rate - round(rate)) <= slack and round(rate) > 0 else rate


class _Table:
    """Columns of a CSV file, converted to numbers when they are asked for."""

    def __init__(self, path: Path, delimiter: str | None) -> None:
        self.file = path.name
        lines = _decoded(path).split("\n")
        while lines and not lines[-1].strip():
            lines.pop()
        head = 0
        while head < len(lines) and (lines[head].startswith("#") or not lines[head].strip()):
            head += 1
        if head == len(lines):
            raise ValueError(f"{self.file} holds no row of data")
        self.labels = _labels_from_comments(self.file, lines[:head])
        # Comma last: with the others it is a decimal comma.
        self.delimiter = delimiter or next((d for d in "\t;," if d in lines[head]), ",")
        self.decimal_comma = self.delimiter != "," and any("," in line for line in lines[head:])
        first = self._cells(lines[head])
        self.named = all(self._number(cell) is None for cell in first)
        if self.named:
            head += 1
            if head == len(lines):
                raise ValueError(f"{self.file} holds column names, but no row of data")
        self.first_line = head + 1  # as editors count
        self.names = [cell.strip() if self.named else str(index) for index, cell in enumerate(first)]
        split = [_name_and_unit(name) for name in self.names]
        self.bases = [base for base, _ in split]
        self.units = [unit for _, unit in split]
        self.rows = lines[head:]
        self._check_width()

    def _cells(self, line: str) -> list[str]:
        return next(csv.reader([line], delimiter=self.delimiter), [])

    def _number(self, cell: str) -> float | None:
        try:
            return float(cell.replace(",", ".") if self.decimal_comma else cell)
        except ValueError:
            return None

    def _check_width(self) -> None:
        width = len(self.names)
        for index, row in enumerate(self.rows):
            cells = row.count(self.delimiter) + 1 if '"' not in row else len(self._cells(row))
            if cells != width or not row.strip():
                came = "1 column" if cells == 1 else f"{cells} columns"
                doubled = self.delimiter == "," and cells == 2 * width
                raise ValueError(
                    f"{self.file}: line {self.first_line + index} must have {width} columns as the first row "
                    f"has, got {came if row.strip() else 'an empty line'}"
                    + ("; are these decimal commas? give delimiter=';'" if doubled else "")
                )

    def listed(self) -> str:
        """Names of all columns, for messages."""
        names = self.names if not self.named else [repr(name) for name in self.names]
        return ", ".join(names) + ("" if self.named else " (no names in the file)")

    def find(self, argument: str, wanted: Any, usual: set[str]) -> int | None:
        """Index of the column that is asked for, else of the one with a usual name, else None."""
        if wanted is None:
            matches = [i for i, base in enumerate(self.bases) if base in usual]
            if len(matches) > 1:
                names = ", ".join(repr(self.names[i]) for i in matches)
                raise ValueError(f"{self.file}: {argument} must be given, since several columns fit: {names}")
            return matches[0] if matches else None
        if isinstance(wanted, (bool, np.bool_)) or not isinstance(wanted, (str, int, np.integer)):
            raise TypeError(f"{argument} must be a column's name or index from 0, got {wanted!r}")
        if not isinstance(wanted, str):
            if not 0 <= wanted < len(self.names):
                raise self._unknown(argument, wanted)
            return int(wanted)
        matches = [i for i, name in enumerate(self.names) if name == wanted]
        matches = matches or [i for i, base in enumerate(self.bases) if base == wanted.strip().lower()]
        if not matches:
            raise self._unknown(argument, wanted)
        if len(matches) > 1:
            raise ValueError(f"{self.file}: {argument} = {wanted!r} fits columns {matches}; give one index")
        return matches[0]

    def _unknown(self, argument: str, wanted: Any) -> ValueError:
        return ValueError(f"{self.file}: {argument} = {wanted!r} does not exist; columns are {self.listed()}")

    def torque_column(self, wanted: Channel | None, others: set[int | None]) -> int:
        """Index of the torque's column."""
        found = self.find("channel", wanted, _TORQUE_NAMES)
        left = [i for i in range(len(self.names)) if i not in others]
        if found is None and len(left) == 1:
            found = left[0]
        if found is None:
            raise ValueError(
                f"{self.file}: channel must be given, to say which column is the torque: {self.listed()}"
            )
        return found

    def column(self, index: int) -> Float:
        """Numbers of one column."""
        rows = [row.replace(",", ".") for row in self.rows] if self.decimal_comma else self.rows
        try:
            values = np.loadtxt(
                rows, delimiter=self.delimiter, usecols=index, comments=None, quotechar='"', ndmin=1
            )
        except ValueError as error:
            raise self._not_numbers(index, error) from None
        if not np.all(np.isfinite(values)):
            where = int(np.argmax(~np.isfinite(values)))
            raise ValueError(
                f"{self.file}: line {self.first_line + where}, column {self.names[index]!r} holds "
                f"{values[where]}; every sample must be a finite number"
            )
        if values.size < 2:
            raise ValueError(f"{self.file} holds one sample; a record needs at least 2")
        return np.asarray(values, dtype=np.float64)

    def _not_numbers(self, index: int, error: ValueError) -> ValueError:
        """What to say of a column that did not convert: its first cell that is not a number."""
        column = f"column {self.names[index]!r}"
        for row, line in enumerate(self.rows):
            cell = self._cells(line)[index]
            if self._number(cell) is None:
                came = (
                    f"{cell!r}, which is not a number" if cell.strip() else "nothing; it must hold a number"
                )
                return ValueError(f"{self.file}: line {self.first_line + row}, {column} holds {came}")
        return ValueError(f"{self.file}: {column} cannot be read as numbers ({error})")


def _decoded(path: Path) -> str:
    try:
        text = path.read_text(encoding="utf-8-sig")  # read_text turns all line ends into \n
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path.name} is not UTF-8 text (byte {error.start}); save it as CSV in UTF-8"
        ) from None
    if "\0" in text:
        raise ValueError(f"{path.name} holds binary data, not CSV text")
    return text


def _name_and_unit(name: str) -> tuple[str, str | None]:
    """Lower-case base name and unit of a column: ``Torque [Nm]`` gives ("torque", "Nm")."""
    found = re.fullmatch(r"(.+?)\s*(?:\[(.*)\]|\((.*)\)|/\s*(\S+)|\bin\s+(\S+))", name)
    if found:
        unit = next(group for group in found.groups()[1:] if group is not None)
        return found[1].strip().lower(), re.sub(r"[\s·⋅*.]", "", unit) or None
    base, _, suffix = name.lower().rpartition("_")
    if base and suffix in _UNIT_SUFFIXES:
        return base, _UNIT_SUFFIXES[suffix]
    return name.lower(), None


def _torque_factor(path: Path, name: str, unit: str | None, scale: float | None) -> tuple[float, bool]:
    """Nm per unit, and whether that is assumed."""
    if scale is not None:
        return float(scale), False
    if unit is None:
        return 1.0, True
    if unit not in _TORQUE_UNITS:
        raise ValueError(
            f"{path.name}: channel {name!r} is in {unit!r}, known are {', '.join(_TORQUE_UNITS)}; give "
            "scale= (Nm per unit)"
        )
    return _TORQUE_UNITS[unit], False


def _write_csv(file: IO[bytes], recording: Recording, labels: dict[str, Any]) -> None:
    head = [f"# {_FORMAT}: {_VERSION}"]
    head += [f"# {key}: {json.dumps(value)}" for key, value in labels.items()]
    columns, names = [recording.torque], ["torque [Nm]"]
    if recording.angle is not None:
        columns.append(recording.angle)
        names.append("angle [rad]")
    file.write("\n".join([*head, ",".join(names), ""]).encode("ascii"))
    np.savetxt(file, np.column_stack(columns), fmt="%.17g", delimiter=",")  # 17 digits give back every bit


def _labels_from_comments(file: str, comments: Iterable[str]) -> dict[str, Any] | None:
    """Labels at the head of a file that :func:`write_recording` wrote; None for any other file."""
    pairs = [comment[1:].strip().partition(": ") for comment in comments if comment.startswith("#")]
    if not pairs or pairs[0][0] != _FORMAT:
        return None
    labels = {}
    for key, _, value in pairs:
        try:
            labels[key] = json.loads(value)
        except ValueError:
            raise ValueError(f"{file}: label {key!r} in its header is not JSON, got {value!r}") from None
    _check_version(file, labels.pop(_FORMAT))
    unknown = labels.keys() - {*_LABELS, "sampling_rate"}
    if unknown:
        raise ValueError(
            f"{file}: unknown label {min(unknown)!r} in its header; known are {', '.join(_LABELS)}"
        )
    _check_rate(f"{file}: sampling_rate in its header", labels.get("sampling_rate"))
    return labels


# -- NPZ


def _read_npz(
    path: Path,
    channel: Channel | None,
    sampling_rate: float | None,
    angle_channel: Channel | Literal[False] | None,
    scale: float | None,
) -> dict[str, Any]:
    arrays = load_arrays(path)
    listed = ", ".join(repr(name) for name in arrays) or "none"
    found: dict[str, Any] = {}
    for argument, given, key in (("channel", channel, "torque"), ("angle_channel", angle_channel, "angle")):
        if given is not None and given is not False and not isinstance(given, str):
            raise TypeError(f"{argument} must be the name of an array, got {given!r}; arrays are {listed}")
        name = given or key
        if given is False or (key == "angle" and given is None and name not in arrays):
            continue
        if name not in arrays:
            raise ValueError(f"{path.name}: {argument} = {name!r} does not exist; arrays are {listed}")
        values = arrays[name]
        if values.dtype.kind not in "iuf" or values.ndim != 1:
            raise ValueError(
                f"{path.name}: array {name!r} must be 1-D and hold real numbers, got shape {values.shape} of "
                f"dtype {values.dtype}"
            )
        found[key] = values
    if "sampling_rate" in arrays:
        rate = arrays["sampling_rate"]
        if rate.size != 1 or rate.dtype.kind not in "iuf":
            raise ValueError(f"{path.name}: array 'sampling_rate' must be one number in Hz, got {rate!r}")
        stated = float(rate.reshape(()))
        _check_rate(f"{path.name}: array 'sampling_rate'", stated)
        _check_same_rate(path, sampling_rate, stated, "its array 'sampling_rate'", tolerance=1e-6)
        found["sampling_rate"] = stated
    elif sampling_rate is None:
        raise ValueError(
            f"{path.name}: no sampling rate: give sampling_rate= (Hz), or add an array 'sampling_rate'; "
            f"arrays are {listed}"
        )
    else:
        found["sampling_rate"] = float(sampling_rate)
    if scale is not None:
        found["torque"] = found["torque"] * float(scale)
    labels = {key: _plain(path, key, arrays[key]) for key in _LABELS if key in arrays}
    if _FORMAT_KEY in arrays:
        _check_version(path.name, arrays[_FORMAT_KEY].tolist())
    else:
        labels["meta"] = {
            "file": path.name,
            "channel": channel or "torque",
            # An array "torque" is in Nm by the layout; of any other nothing is known.
            "unit_assumed": channel not in (None, "torque") and scale is None,
            "rate_from": "array 'sampling_rate'" if "sampling_rate" in arrays else "argument",
        } | labels.get("meta", {})
    return found | labels


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an NPZ file. Pickled ones are refused: they are code."""
    try:
        # Opened here: np.load leaves a damaged file open.
        with path.open("rb") as file:
            archive = np.load(file, allow_pickle=False)
            if isinstance(archive, np.ndarray):
                raise ValueError(
                    f"{path.name} is a single array, not an NPZ archive; save it with numpy.savez"
                )
            return {name: np.asarray(archive[name]) for name in archive.files}
    except PermissionError:
        raise
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, KeyError) as error:
        raise ValueError(f"{path.name} is damaged or not whole, it cannot be read as NPZ ({error})") from None
    except ValueError as error:
        text = str(error)
        if "Object arrays" in text:
            text = f"{path.name} holds pickled objects, which are never loaded; save plain numeric arrays"
        elif path.name not in text:
            text = f"{path.name} is damaged or not an NPZ archive"
        raise ValueError(text) from None


def _plain(path: Path, key: str, array: NDArray[Any]) -> Any:
    """A label as Python object."""
    value = array.tolist()
    if key != "meta":
        return value
    try:
        meta = json.loads(value)
    except (TypeError, ValueError):
        meta = None
    if not isinstance(meta, dict):
        raise ValueError(f"{path.name}: array 'meta' must be a JSON object as text, got {value!r}")
    return meta


def _write_npz(file: IO[bytes], recording: Recording, labels: dict[str, Any]) -> None:
    arrays: dict[str, NDArray[Any]] = {"torque": recording.torque}
    if recording.angle is not None:
        arrays["angle"] = recording.angle
    for key, value in labels.items():
        if key == "meta":
            value = json.dumps(value)
        elif key == "worn_lobes":
            value = np.asarray(value, dtype=np.int64)  # an empty list would become float
        arrays[key] = np.asarray(value)
    arrays[_FORMAT_KEY] = np.asarray(_VERSION)
    np.savez(file, **arrays)  # type: ignore[arg-type]


# -- both


def _path(path: Any) -> Path:
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"path must be a file name, got {path!r}")
    return Path(path)


def _suffix(path: Path, verb: str) -> str:
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".npz"):
        raise ValueError(f"{path.name}: unknown kind of file {path.suffix!r}; .csv and .npz can be {verb}")
    return suffix


def _is_recording(value: Any) -> bool:
    return isinstance(value, Recording)


def _is_number(value: Any) -> bool:
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    return number and math.isfinite(value)


def _check_rate(name: str, value: Any) -> None:
    if not (_is_number(value) and value > 0):
        raise ValueError(f"{name} must be a positive, finite number (Hz), got {value!r}")


def _check_same_rate(path: Path, given: float | None, stated: float, where: str, *, tolerance: float) -> None:
    if given is not None and not math.isclose(given, stated, rel_tol=tolerance):
        raise ValueError(
            f"{path.name}: sampling_rate = {given:g} Hz contradicts {where}, which says {stated:g} Hz"
        )


def _check_version(file: str, version: Any) -> None:
    if version != _VERSION:
        raise ValueError(f"{file} is of format {version!r}, but {_VERSION} can be read; update cyclofeat")


def _labels_to_write(recording: Recording) -> dict[str, Any]:
    """Labels that are known, as JSON can hold them."""
    labels: dict[str, Any] = {"sampling_rate": recording.sampling_rate}
    for key in _LABELS:
        value = getattr(recording, key)
        if value is None or (key == "meta" and not value):
            continue
        if recording.angle is None and key.startswith("angle"):
            continue
        labels[key] = list(value) if key == "worn_lobes" else value
    meta = labels.get("meta", {})
    try:
        same = json.loads(json.dumps(meta, allow_nan=False)) == meta
    except (TypeError, ValueError):
        same = False
    if not same:
        raise TypeError(
            "meta must hold only text, finite numbers, booleans, None, lists and dictionaries with text "
            f"keys, to be written to a file; got {meta!r}"
        )
    return labels
