"""Reading and writing of one torque record, whatever the kind of file."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from cyclofeat._base.checks import check_type
from cyclofeat._base.files import write_whole
from cyclofeat._base.quantities import QUANTITIES, QUANTITY_UNITS
from cyclofeat.datasets.readers._columns import (
    ANGLE_NAMES,
    ANGLE_REMEDY,
    COUNT_NAMES,
    DISC_ANGLE_NAMES,
    LABELS,
    PULSE_NAMES,
    Float,
    ReadingOptions,
    Source,
    labels_to_write,
)
from cyclofeat.datasets.readers._times import time_base, time_channels
from cyclofeat.recordings import Recording
from cyclofeat.signal.tachometer import angle_from_pulses, continuous_angle

# Module and class for each kind of file, imported when one is read; or the class itself.
SOURCES: dict[str, tuple[str, str] | Callable[..., Source]] = {
    ".csv": ("_csv", "CsvSource"), ".csv.gz": ("_csv", "CsvSource"), ".npz": ("_npz", "NpzSource"),
    ".tdms": ("_tdms", "TdmsSource"), ".mat": ("_matlab", "MatSource"),
    ".parquet": ("_parquet", "ParquetSource"), ".wav": ("_wav", "WavSource"),
    ".xlsx": ("_xlsx", "XlsxSource"),
}  # fmt: skip
# Read as these where they are named; a folder's other text files are notes.
_TEXT_FILES = {
    **dict.fromkeys((".txt", ".asc", ".dat", ".lvm", ".log", ".tsv"), ".csv"), ".txt.gz": ".csv.gz",
}  # fmt: skip
# How files of each kind begin.
_SIGNATURES = (
    (b"PK\x03\x04", ".npz", ".xlsx"), (b"\xd0\xcf\x11\xe0", ".xls"),
    (b"TDSm", ".tdms"), (b"TDSh", ".tdms_index"), (b"MATLAB ", ".mat"),
    (b"\x89HDF\r\n\x1a\n", ".mat"), (b"PAR1", ".parquet"), (b"RIFF", ".wav"), (b"RIFX", ".wav"),
    (b"RF64", ".wav"), (b"\x1f\x8b", ".csv.gz"), (b"%PDF", ".pdf"),
)  # fmt: skip
# In reverse the lobes pass, and are loaded, the other way round; or the sensor was mounted so.
_TURNED = "was turned round, since it fell: positions of lobes are relative, and may count the other way"
# No input shaft turns faster; an angle in degrees taken for rad would.
_FASTEST_INPUT_HZ = 100.0
_OPTIONS = frozenset(field.name for field in fields(ReadingOptions))


def read_recording(path: str | os.PathLike[str], **options: Any) -> Recording:
    """Read one record of torque or motor current from a CSV, NPZ, TDMS, MATLAB, Parquet, Excel or WAV file.

    The recording's ``meta`` and :func:`describe` state what was assumed (unit, decimal comma, sampling rate
    from a time column). One channel is read at a time: TDMS, MATLAB v7.3, Parquet and WAV files may be larger
    than memory.

    Parameters
    ----------
    path : path
        File whose name says its kind. Units may stand behind a channel's name (``torque [Nm]``,
        ``torque_nm``) where the file has no place of its own for them.

        ``.csv``, ``.txt``, ``.asc``, ``.dat``, ``.lvm``, ``.log``, ``.tsv``, ``.csv.gz`` or ``.txt.gz``: one
        row per sample; where the table begins and how it is written is found. ``.xlsx``: the same in a
        sheet, columns named ``sheet/column`` where several sheets hold data.

        ``.npz``: arrays ``torque`` (n,) in Nm (or ``input_torque`` in Nm, ``motor_current`` in A),
        ``sampling_rate`` () in Hz, optionally ``angle`` (n,) in rad, and the labels that
        :func:`write_recording` writes. Pickled objects are never loaded.

        ``.tdms``: channels ``group/channel``, scaled as the file says. ``.mat``: numeric vectors, columns
        ``name(:,1)``, fields ``struct.field``. ``.parquet``: columns. ``.wav``: channels from 0; whole
        numbers need ``scale``. TDMS, MATLAB v7.3, Parquet and Excel need libraries of the extra ``io``.
    channel : str or int, optional
        Channel (name, or index from 0 where the file has an order) that holds the quantity. Default: the one
        called "torque", "output_torque", "Drehmoment" and the like ("torque_in", "Motordrehmoment",
        "motor_current", "Motorstrom" for other quantities), else the one in the quantity's unit, else the
        only one besides time and angle.
    quantity : {"output_torque", "input_torque", "motor_current"}, optional
        Quantity to read. Default: what the file's labels state, else the output torque; a channel whose name
        states another quantity is then an error.
    sampling_rate : float, optional
        Samples per second, in Hz. Needed where the file does not state it, or contradicts itself; it precedes
        all that the file states, and ``meta["time_notes"]`` says what it overrides.
    time_channel : str, int or False, optional
        Channel of the time, from which the rate follows; its jitter and gaps are checked. Default: those of
        the channel's own group and length called "time", "t", "timestamp", "Zeit" and the like; False or
        "none" leaves times out. Numbers, or dates (ISO 8601).
    time_unit : {"s", "ms", "us", "ns", "min", "h", "d"}, optional
        Unit of the times. Default: what the file states, else s, which must then give a rate between 200 Hz
        and 10 MHz.
    angle_channel : str, int or False, optional
        Channel of the angle. Default: the one called "angle", "input_angle", "disc_angle", "Winkel" and the
        like; False leaves it out.
    angle_unit : {"rad", "deg", "rev"}, optional
        Unit of the angle; needed where the file does not state it. Only NPZ files are taken to be in rad. An
        angle that starts again at each turn, or rises in an encoder's steps, is made continuous. Where the
        input's angle falls, as of a machine in reverse, its sign is changed, and it is not absolute.
    pulses_per_turn : int, optional
        The angle's channel holds so many pulses in each turn of the shaft (1: an index). Its default is then
        the one called "pulses", "tacho", "index" and the like.
    scale : float, optional
        Nm per unit of the channel, for files in another unit than Nm, kNm, mNm, Ncm or Nmm. Of a motor
        current in A or mA, its torque constant, after which the samples are in Nm; of one in another unit, A
        per unit. A motor current in % or p.u. (of the rated one) needs none.
    counts_per_turn : int, optional
        The angle's channel holds an encoder's counts, so many in each turn. Its default is then the one
        called "position", "encoder", "counts" and the like.
    delimiter : {",", ";", "\\t", " "}, optional
        Separator of a text's columns. Default: the one that separates most numbers.
    decimal : {",", "."}, optional
        Mark of a text's decimals; the other one then separates thousands. Default: comma where numbers hold
        one that separates no columns.
    table_line : int, optional
        Line of a text, from 1, in which its columns are named, or its samples begin. Default: found.
    **labels
        Parameters of :class:`~cyclofeat.recordings.Recording`, e.g. ``assembly="A1"``; they take precedence
        over labels in the file, and ``meta`` is merged.

    Returns
    -------
    Recording

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ImportError
        If the library that reads this kind of file is not installed.
    TypeError
        If a parameter is of the wrong type or unknown.
    ValueError
        If the file is not as described; the message says what is wrong and what would be right.

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
    path = file_path(path)
    labels = {name: value for name, value in options.items() if name not in _OPTIONS}
    unknown = labels.keys() - set(LABELS)
    if unknown:
        raise TypeError(
            f"unknown option or label {min(unknown)!r}; known are {', '.join(sorted({*_OPTIONS, *LABELS}))}"
        )
    reading = ReadingOptions(**{name: options[name] for name in options.keys() & _OPTIONS})
    source = _open_source(path, reading)
    parameters = _recording_parameters(source, reading)
    if "angle" not in parameters:  # then the file's labels of the angle are void
        parameters = {key: value for key, value in parameters.items() if not key.startswith("angle")}
    meta = parameters.pop("meta", {}) | dict(labels.pop("meta", None) or {})
    if labels.get("worn_lobes") is not None:
        parameters.pop("defect_count", None)  # the file's count belongs to the file's lobes
    elif labels.get("defect_count") is not None:
        parameters.pop("worn_lobes", None)
    given = parameters | labels
    angle = given.get("angle")
    if angle is not None and given.get("angle_of", "input") == "input" and angle[-1] < angle[0]:
        given |= {"angle": -angle, "angle_is_absolute": False}
        first = f"{meta['angle_from']} and " if "angle_from" in meta else ""
        meta["angle_from"] = first + _TURNED
    for name in {"torque", "angle"} & given.keys():
        given[name].flags.writeable = False  # so that it is not copied
    try:
        recording = Recording(**given, meta=meta)
    except TypeError as error:
        raise TypeError(f"{path.name}: {error}") from None
    except ValueError as error:
        hint = " (angle_channel=False leaves the angle out)" if str(error).startswith("angle must") else ""
        raise ValueError(f"{path.name}: {error}{hint}") from None
    if meta.get("angle_unit_assumed"):
        # An angle without a unit may turn as fast as only degrees would.
        assert recording.angle is not None
        steps = np.abs(np.diff(recording.angle))
        hertz = float(np.median(steps)) * recording.sampling_rate / (2 * math.pi)
        limit = _FASTEST_INPUT_HZ / (1 if recording.angle_of == "input" else 5)
        nominal = recording.input_speed_hz
        in_degrees = hertz * math.pi / 180
        # Nearer to the nominal speed as degrees than as rad, on the scale of ratios.
        suits = recording.angle_of == "input" and nominal is not None and hertz * in_degrees > nominal**2
        if hertz > limit or suits:
            raise ValueError(
                f"{path.name}: angle does not state its unit, and in rad it would turn at {60 * hertz:.5g} "
                f"RPM (in deg at {60 * in_degrees:.5g} RPM); {ANGLE_REMEDY}"
            )
    return recording


def list_channels(path: str | os.PathLike[str], **options: Any) -> dict[str, str | None]:
    """Return the names of a file's channels, as ``channel`` takes them, with their units or None.

    Options and errors are those of :func:`read_recording`.
    """
    reading = ReadingOptions(**{name: options[name] for name in options.keys() & _OPTIONS})
    source = _open_source(file_path(path), reading)
    return dict(zip(source.names, source.units, strict=True))


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
    from cyclofeat.datasets.readers import _csv, _npz

    write = {".csv": _csv.write_csv, ".npz": _npz.write_npz}.get(path.suffix.lower())
    if write is None:
        raise ValueError(f"{path.name}: unknown kind of file {path.suffix!r}; .csv and .npz can be written")
    labels = labels_to_write(recording)
    write_whole(path, lambda file: write(file, recording, labels))


def file_path(path: Any) -> Path:
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"path must be a file name, got {path!r}")
    return Path(path)


def _open_source(path: Path, reading: ReadingOptions) -> Source:
    """Channels of a file; an error if it is not of the kind that its name says."""
    if path.is_dir():
        raise ValueError(f"{path} is a directory; give a file in it, or use read_folder")
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if not path.is_file():
        raise ValueError(f"{path} is no ordinary file")
    # The ending that says how the file is read; the name's own if none does.
    suffix = next((end for end in (*SOURCES, *_TEXT_FILES) if path.name.lower().endswith(end)), path.suffix)
    suffix = _TEXT_FILES.get(suffix, suffix)
    if suffix not in SOURCES:
        *others, last = SOURCES
        raise ValueError(
            f"{path.name}: unknown kind of file {path.suffix!r}; {', '.join(others)} and {last} can be read"
        )
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty")
    with path.open("rb") as file:
        start = file.read(16)
    looks = next((kinds for begin, *kinds in _SIGNATURES if start.startswith(begin)), [suffix])
    if suffix not in looks:
        kinds = " or ".join(looks)
        raise ValueError(
            f"{path.name} is no {suffix} file: it begins like a {kinds} file"
            + (f"; rename it to end in {kinds}" if looks[0] in SOURCES else "")
        )
    kind = SOURCES[suffix]
    if isinstance(kind, tuple):
        kind = getattr(import_module(f"cyclofeat.datasets.readers.{kind[0]}"), kind[1])
    if suffix.startswith((".csv", ".xlsx")):
        return kind(path, reading.of_table)
    for name, value in reading.of_table.items():
        raise ValueError(f"{name} is for CSV files, got {value!r} for {path.name}")
    return kind(path)


def _recording_parameters(source: Source, reading: ReadingOptions) -> dict[str, Any]:
    times: set[int | None] = set(time_channels(source))
    if reading.time_channel is not None and not reading.without_times:
        times.add(source.find_channel("time_channel", reading.time_channel, set()))
    angle = None
    if reading.angle_channel is not False:
        by_pulses, by_counts = reading.pulses_per_turn is not None, reading.counts_per_turn is not None
        names = PULSE_NAMES if by_pulses else COUNT_NAMES | ANGLE_NAMES if by_counts else ANGLE_NAMES
        angle = source.find_channel("angle_channel", reading.angle_channel, names)
        if (by_pulses or by_counts) and angle is None:
            raise ValueError(
                f"{source.file}: angle_channel= must be given, to say which {source.noun} holds the "
                f"{'pulses' if by_pulses else 'counts'}: {source.channel_names()}"
            )
    labels = source.other_labels if source.labels is None else source.labels
    stated = labels.get("quantity")
    if stated is not None and reading.quantity not in (None, stated):
        raise ValueError(
            f"{source.file}: quantity = {reading.quantity!r} contradicts the file, which says {stated!r}"
        )
    sought = reading.quantity or stated
    quantity = sought or QUANTITIES[0]
    torque = source.find_torque(reading.channel, times | {angle}, sought)
    source.check_torque(torque, reading.scale)
    factor, unit = source.unit_factor(torque, reading.scale, quantity)
    # The rate first: it is known without reading a long record.
    rate, rate_meta = time_base(source, torque, reading)
    parameters: dict[str, Any] = {"torque": source.column_values(torque) * factor, "quantity": quantity}
    angle_meta: dict[str, Any] = {}
    if angle is not None:
        parameters["angle"], angle_meta = _read_angle(source, angle, reading)
        parameters["angle_of"] = "disc" if source.bases[angle] in DISC_ANGLE_NAMES else "input"
    scaled = {"unit": unit} if unit not in (None, QUANTITY_UNITS[quantity]) else {}
    if source.labels is not None:
        angle_meta.pop("angle_unit_assumed", None)  # by its layout it is in rad
        if reading.sampling_rate is None:
            rate_meta.pop("rate_from")
        meta = labels.get("meta", {}) | scaled | angle_meta | rate_meta
        return parameters | labels | {"sampling_rate": rate} | ({"meta": meta} if meta else {})
    meta = {"file": source.file, "channel": source.names[torque], "unit_assumed": unit is None} | scaled
    meta |= angle_meta | rate_meta | source.channel_meta(torque)
    meta |= {"scale": factor} if factor != 1 else {}
    meta |= labels.get("meta", {})
    return parameters | {"sampling_rate": rate} | labels | {"meta": meta}


def _read_angle(source: Source, index: int, reading: ReadingOptions) -> tuple[Float, dict[str, Any]]:
    """Return the angle in rad by a channel, and what was done for it."""
    values = source.column_values(index)
    factor, assumed = 1.0, False
    if reading.counts_per_turn is not None:
        factor = 2 * math.pi / reading.counts_per_turn
    elif reading.pulses_per_turn is None:
        factor, assumed = source.angle_factor(index, reading.angle_unit)
    meta: dict[str, Any] = {"angle_unit_assumed": True} if assumed else {}
    try:
        if reading.pulses_per_turn is not None:
            return angle_from_pulses(values, reading.pulses_per_turn), {"angle_from": "follows from pulses"}
        given = values * factor
        angle = continuous_angle(given)
    except ValueError as error:
        raise ValueError(
            f"{source.file}: {source.noun} {source.names[index]!r}: {error} (angle_channel=False leaves the "
            "angle out)"
        ) from None
    return angle, meta if angle is given else meta | {"angle_from": "was made continuous"}
