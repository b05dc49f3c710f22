"""Reading and writing of one torque record, whatever the kind of file."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cyclofeat._base.checks import check_type
from cyclofeat._base.files import write_whole
from cyclofeat._base.quantities import QUANTITIES, QUANTITY_UNITS
from cyclofeat.datasets.readers import _binary, _csv, _matlab, _tdms
from cyclofeat.datasets.readers import _words as words
from cyclofeat.datasets.readers._columns import (
    ANGLE_REMEDY,
    Channel,
    Float,
    ReadingOptions,
    Source,
    name_errors,
)
from cyclofeat.datasets.readers._times import time_base, time_channels
from cyclofeat.recordings import Recording
from cyclofeat.signal.tachometer import angle_from_pulses, continuous_angle

# Function that returns the channels of each kind of file.
SOURCES: dict[str, Callable[..., Source]] = {
    ".csv": _csv.open_text, ".csv.gz": _csv.open_text, ".npz": _binary.open_npz, ".tdms": _tdms.open_tdms,
    ".mat": _matlab.open_matlab, ".h5": _matlab.open_hdf5, ".hdf5": _matlab.open_hdf5,
    ".mf4": _binary.open_mdf, ".unv": _binary.open_universal, ".uff": _binary.open_universal,
    ".parquet": _binary.open_parquet, ".wav": _binary.open_wav, ".xlsx": _csv.open_xlsx,
}  # fmt: skip
_TABLES = {".csv", ".csv.gz", ".xlsx"}  # whose functions take options
# Endings of the recordings of a folder; its other texts are notes, unless they are named.
RECORDINGS = (*SOURCES, ".lvm", ".asc", ".tsv")
# Read as these.
_TEXT_FILES = {
    **dict.fromkeys((".txt", ".asc", ".dat", ".lvm", ".log", ".tsv"), ".csv"), ".txt.gz": ".csv.gz",
}  # fmt: skip
# How files of each kind begin.
_SIGNATURES = (
    (b"PK\x03\x04", ".npz", ".xlsx"), (b"\xd0\xcf\x11\xe0", ".xls"),
    (b"TDSm", ".tdms"), (b"TDSh", ".tdms_index"), (b"MATLAB ", ".mat"), (b"MDF ", ".mf4"),
    (b"\x89HDF\r\n\x1a\n", ".mat", ".h5", ".hdf5"), (b"PAR1", ".parquet"), (b"RIFF", ".wav"),
    (b"RIFX", ".wav"), (b"RF64", ".wav"), (b"\x1f\x8b", ".csv.gz"), (b"%PDF", ".pdf"),
)  # fmt: skip
# In reverse the lobes pass, and are loaded, the other way round; or the sensor was mounted so.
_TURNED = "was turned round, since it fell: positions of lobes are relative, and may count the other way"
# No input shaft turns faster; an angle in degrees taken for rad would. A lower speed may be the output's.
_FASTEST_INPUT_HZ, _SLOWEST_RPM = 100.0, 100.0
_OPTIONS = frozenset(field.name for field in fields(ReadingOptions))


def read_recording(path: str | os.PathLike[str], **options: Any) -> Recording:
    """Read one record of torque or motor current from a file of text, numbers or measurement software.

    The recording's ``meta`` and :func:`describe` state what was assumed. One channel is read at a time: TDMS,
    HDF5, Parquet and WAV files may be larger than memory.

    Parameters
    ----------
    path : path
        File whose name says its kind: ``.csv``, ``.txt``, ``.asc``, ``.dat``, ``.lvm``, ``.log``, ``.tsv``
        (also packed, ``.csv.gz``), ``.xlsx``, ``.npz``, ``.tdms``, ``.mat``, ``.h5``, ``.hdf5``, ``.mf4``,
        ``.unv``, ``.uff``, ``.parquet`` or ``.wav``. Units may stand behind a name (``torque [Nm]``,
        ``torque_nm``). Channels of groups, structs and sheets are ``group/channel``, ``struct.field``,
        ``sheet/column``; columns of a matrix are ``name(:,1)``.
    channel : str or int, optional
        Channel (name, or index from 0 where the file has an order) that holds the quantity. Default: the one
        called "torque", "Drehmoment" and the like ("torque_in", "motor_current", "Motorstrom" for other
        quantities), else the one in the quantity's unit, else the only one besides time and angle.
    quantity : {"output_torque", "input_torque", "motor_current"}, optional
        Quantity to read. Default: what the file's labels state, else the output torque; a channel whose name
        states another quantity is then an error.
    sampling_rate : float, optional
        Samples per second, in Hz. Needed where the file does not state it, or contradicts itself; it precedes
        all that the file states, and ``meta["time_notes"]`` says what it overrides.
    time_channel : str, int or False, optional
        Channel of the times, numbers or dates, from which the rate follows. Default: those of the channel's
        own group and length called "time", "t", "Zeit" and the like; False or "none" leaves times out.
    time_unit : {"s", "ms", "us", "ns", "min", "h", "d"}, optional
        Unit of the times. Default: what the file states, else s, which must then give a rate between 200 Hz
        and 10 MHz.
    gaps : {"refuse", "cut"}, default "refuse"
        Gaps in the times, and segments of another rate, are an error; or the record is cut there, and the
        longest stretch returned (:func:`read_folder` returns all).
    angle_channel : str, int or False, optional
        Channel of the angle. Default: the one called "angle", "disc_angle", "Winkel" and the like; False
        leaves it out.
    angle_unit : {"rad", "deg", "rev"}, optional
        Unit of the angle; needed where the file does not state it, other than NPZ. An angle that starts again
        at each turn, or rises in an encoder's steps, is made continuous. Where the input's angle falls, its
        sign is changed, and it is not absolute.
    pulses_per_turn, counts_per_turn : int, optional
        The angle's channel holds so many pulses (1: an index), or counts of an encoder, in each turn of the
        shaft. Its default is then the one called "tacho", "index" or "position", "encoder" and the like.
    scale : float, optional
        Nm per unit of the channel, for files in a unit that is not known (Nm, lbf ft, ... are). Of a motor
        current in A or mA, its torque constant, after which the samples are in Nm; of one in another unit, A
        per unit. A motor current in % or p.u. (of the rated one) needs none.
    delimiter, decimal : str, optional
        Separator (comma, semicolon, tab, space) and decimal mark (comma, point) of a text; the other mark
        then separates thousands. Default: as most numbers are written.
    table_line : int, optional
        Line of a text, from 1, in which its columns are named, or its samples begin. Default: found.
    **labels
        Parameters of :class:`~cyclofeat.recordings.Recording`, e.g. ``assembly="A1"``; they take precedence
        over labels in the file, and ``meta`` is merged. Without angle and label, ``speed_rpm`` is the median
        of the only channel called "speed", "Drehzahl" and the like in rpm or 1/min, if that is 100 or more.

    Returns
    -------
    Recording

    Raises
    ------
    FileNotFoundError, ImportError
        If there is no such file; if the library that reads this kind of file is not installed.
    TypeError, ValueError
        If a parameter is wrong, or the file not as described; the message says what would be right.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "rig.csv"
    ...     _ = path.write_text("Zeit;Drehmoment\\nms;Nm\\n0;21,9\\n0,5;22,1\\n1;22,0\\n")
    ...     recording = read_recording(path, assembly="A1", speed_rpm=500)
    >>> recording.torque.tolist(), recording.sampling_rate
    ([21.9, 22.1, 22.0], 2000.0)
    """
    return max(read_stretches(path, **options), key=lambda recording: recording.n_samples)


def read_stretches(path: str | os.PathLike[str], **options: Any) -> list[Recording]:
    """Return all stretches into which :func:`read_recording` cuts a file: one, unless gaps are cut."""
    path = file_path(path)
    labels = {name: options[name] for name in options.keys() - _OPTIONS}
    if unknown := labels.keys() - set(words.LABELS):
        known = ", ".join(sorted({*_OPTIONS, *words.LABELS}))
        raise TypeError(f"unknown option or label {min(unknown)!r}; known are {known}")
    reading = ReadingOptions(**{name: options[name] for name in options.keys() & _OPTIONS})
    with name_errors(path.name):
        source = _open_source(path, reading)
        parameters, angle, stretches = _read_parameters(source, reading)
        meta = parameters["meta"] | dict(labels.pop("meta", None) or {})
        if "speed_rpm" in labels:
            meta.pop("speed_from", None)
        if labels.get("worn_lobes") is not None:
            parameters.pop("defect_count", None)  # the file's count belongs to the file's lobes
        elif labels.get("defect_count") is not None:
            parameters.pop("worn_lobes", None)
        torque = parameters["torque"]
        ends, recordings = pairwise([*stretches, (torque.size, 0.0)]), []
        long = [(begin, end, rate) for (begin, rate), (end, _) in ends if end - begin > 1]
        for number, (begin, end, rate) in enumerate(long, 1):
            samples = torque if end - begin == torque.size else torque[begin:end]
            part = parameters | {"sampling_rate": rate} | labels | {"torque": samples, "meta": dict(meta)}
            if len(long) > 1:
                part["meta"]["part"] = f"{number} of {len(long)}, from sample {begin}"
                part["meta"].pop("gaps", None)  # they lie between the parts
            if angle is not None:
                with name_errors(source.call(angle[0])):
                    part["angle"] = _read_angle(source, angle[0], angle[1][begin:end], reading, part["meta"])
            recordings.append(_make_recording(part))
    return recordings


def _make_recording(given: dict[str, Any]) -> Recording:
    """Return the recording of these parameters; a falling angle is turned, an unlikely unit is an error."""
    angle, meta = given.get("angle"), given["meta"]
    if angle is not None and given.get("angle_of", "input") == "input" and angle[-1] < angle[0]:
        given |= {"angle": -angle, "angle_is_absolute": False}
        first = f"{meta['angle_from']} and " if "angle_from" in meta else ""
        meta["angle_from"] = first + _TURNED
    for name in {"torque", "angle"} & given.keys():
        given[name].flags.writeable = False  # so that it is not copied
    recording = Recording(**given)
    if meta.get("angle_unit_assumed"):
        # An angle without a unit may turn as fast as only degrees would.
        steps, of_input = np.abs(np.diff(given["angle"])), recording.angle_of == "input"
        hertz = float(np.median(steps)) * recording.sampling_rate / (2 * math.pi)
        in_degrees, nominal = hertz * math.pi / 180, recording.input_speed_hz
        # Nearer to the nominal speed as degrees than as rad, on the scale of ratios.
        suits = of_input and nominal is not None and hertz * in_degrees > nominal**2
        if hertz > _FASTEST_INPUT_HZ / (1 if of_input else 5) or suits:
            raise ValueError(
                f"angle does not state its unit, and in rad it would turn at {60 * hertz:.5g} RPM (in deg at "
                f"{60 * in_degrees:.5g} RPM); {ANGLE_REMEDY}"
            )
    return recording


def list_channels(path: str | os.PathLike[str], **options: Any) -> dict[str, str | None]:
    """Return the names of a file's channels, as ``channel`` takes them, with their units or None.

    Options and errors are those of :func:`read_recording`.
    """
    reading = ReadingOptions(**{key: options[key] for key in options.keys() & _OPTIONS})
    path = file_path(path)
    with name_errors(path.name):
        return {channel.name: channel.unit for channel in _open_source(path, reading).channels}


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
    path = file_path(path)
    check_type("recording", recording, Recording)
    if path.is_dir():
        raise ValueError(f"{path} is a directory; give a file name")
    write = {".csv": _csv.write_csv, ".npz": _binary.write_npz}.get(path.suffix.lower())
    if write is None:
        raise ValueError(f"{path.name}: unknown kind of file {path.suffix!r}; .csv and .npz can be written")
    labels = words.labels_to_write(recording)
    write_whole(path, lambda file: write(file, recording, labels))


def file_path(path: Any) -> Path:
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"path must be a file name, got {path!r}")
    return Path(path)


def _open_source(path: Path, reading: ReadingOptions) -> Source:
    """Channels of a file; an error if it is not of the kind that its name says."""
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if not path.is_file():
        use = "is a directory; give a file in it, or use read_folder"
        raise ValueError(use if path.is_dir() else "no ordinary file")
    # The ending that says how the file is read; the name's own if none does.
    suffix = next((end for end in (*SOURCES, *_TEXT_FILES) if path.name.lower().endswith(end)), path.suffix)
    suffix = _TEXT_FILES.get(suffix, suffix)
    if suffix not in SOURCES:
        *others, last = SOURCES
        raise ValueError(f"unknown kind of file {path.suffix!r}; {', '.join(others)} and {last} can be read")
    with path.open("rb") as file:
        start = file.read(16)
    if not start:
        raise ValueError(f"{path.name} is empty")
    looks = next((kinds for begin, *kinds in _SIGNATURES if start.startswith(begin)), [suffix])
    if suffix not in looks:
        kinds = " or ".join(looks)
        remedy = f"; rename it to end in {kinds}" if looks[0] in SOURCES else ""
        raise ValueError(f"not a {suffix} file: it begins like a {kinds} file{remedy}")
    open_file = SOURCES[suffix]
    if suffix in _TABLES:
        return open_file(path, reading)
    for name in ("delimiter", "decimal", "table_line"):
        if (value := getattr(reading, name)) is not None:
            raise ValueError(f"{name} is for CSV files, got {value!r}")
    return open_file(path)


def _read_parameters(
    source: Source, reading: ReadingOptions
) -> tuple[dict[str, Any], tuple[Channel, Float] | None, list[tuple[int, float]]]:
    """Return parameters of the recording, the angle's channel with its values, and the time base."""
    others: list[Channel | None] = [*time_channels(source)]
    if reading.time_channel is not None and not reading.without_times:
        others.append(source.find_channel("time_channel", reading.time_channel))
    angle = _find_angle(source, reading)
    stated = source.labels.get("quantity")
    if stated is not None and reading.quantity not in (None, stated):
        raise ValueError(f"quantity = {reading.quantity!r} contradicts the file, which says {stated!r}")
    quantity = reading.quantity or stated or QUANTITIES[0]
    torque = source.find_torque(reading.channel, [*others, angle], reading.quantity or stated)
    factor, unit = source.unit_factor(torque, reading.scale, quantity)
    # The rate first: it is known without reading a long record.
    stretches, meta = time_base(source, torque, reading)
    samples = source.column_values(torque)
    samples = samples if factor == 1 else samples * factor
    meta |= {"unit": unit} if unit not in (None, QUANTITY_UNITS[quantity]) else {}
    if not source.is_own:
        meta |= {"file": source.file, "channel": torque.name, "unit_assumed": unit is None} | torque.meta
        meta |= {"scale": factor} if factor != 1 else {}
    elif reading.sampling_rate is None:
        meta.pop("rate_from")
    meta = source.labels.get("meta", {}) | meta
    parameters = {"quantity": quantity} | source.labels | {"torque": samples, "meta": meta}
    if angle is None:  # then the file's labels of the angle are void
        if "speed_rpm" not in parameters:
            _add_speed(source, parameters)
        return {key: x for key, x in parameters.items() if not key.startswith("angle")}, None, stretches
    parameters.setdefault("angle_of", "disc" if angle.base in words.DISC_ANGLE_NAMES else "input")
    return parameters, (angle, source.column_values(angle)), stretches


def _add_speed(source: Source, parameters: dict[str, Any]) -> None:
    """Add the speed in whole RPM that a channel holds, if one alone does, and if it is not the output's."""
    with suppress(TypeError, ValueError):  # of no or several channels, gaps or text
        [speed] = [x for x in source.channels if words.is_usual(x.base, "rpm") and "rpm" in (x.unit, x.base)]
        rpm = float(round(np.median(np.abs(source.column_values(speed)))))
        if _SLOWEST_RPM <= rpm <= 60 * _FASTEST_INPUT_HZ:
            parameters["speed_rpm"] = rpm
            parameters["meta"]["speed_from"] = source.call(speed)


def _find_angle(source: Source, reading: ReadingOptions) -> Channel | None:
    """Return the channel of the angle, or of pulses or counts from which it follows."""
    if reading.angle_channel is False:
        return None
    if reading.angle_channel is not None:
        return source.find_channel("angle_channel", reading.angle_channel)
    names, content = words.ANGLE_NAMES, ""
    if reading.pulses_per_turn is not None:
        names, content = words.PULSE_NAMES, "pulses"
    elif reading.counts_per_turn is not None:
        names, content = words.COUNT_NAMES | words.ANGLE_NAMES, "counts"
    angle = source.find_only("angle_channel", [x for x in source.channels if x.base in names])
    if angle is None and content:
        raise ValueError(
            f"angle_channel= must be given, to say which {source.noun} holds the {content}: "
            f"{source.list_names()}"
        )
    return angle


def _read_angle(
    source: Source, channel: Channel, values: Float, reading: ReadingOptions, meta: dict[str, Any]
) -> Float:
    """Return the angle in rad by values of a channel; ``meta`` then says what was done for it."""
    if reading.pulses_per_turn is not None:
        meta["angle_from"] = "follows from pulses"
        return angle_from_pulses(values, reading.pulses_per_turn)
    if reading.counts_per_turn is not None:
        factor = 2 * math.pi / reading.counts_per_turn
    else:
        factor, assumed = source.angle_factor(channel, reading.angle_unit)
        meta |= {"angle_unit_assumed": True} if assumed else {}
    given = values * factor
    angle = continuous_angle(given)
    meta |= {} if angle is given else {"angle_from": "was made continuous"}
    return angle
