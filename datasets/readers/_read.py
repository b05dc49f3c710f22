"""One torque record from a file of any kind that is known."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cyclofeat._files import write_whole
from cyclofeat.datasets.readers._columns import (
    ANGLE_NAMES,
    DISC_ANGLE_NAMES,
    TIME_NAMES,
    Channel,
    Float,
    Source,
    check_rate,
    check_same_rate,
    is_number,
)
from cyclofeat.datasets.readers._csv import CsvSource, write_csv
from cyclofeat.datasets.readers._labels import LABELS, labels_to_write
from cyclofeat.datasets.readers._matlab import MatSource
from cyclofeat.datasets.readers._npz import NpzSource, write_npz
from cyclofeat.datasets.readers._parquet import ParquetSource
from cyclofeat.datasets.readers._tdms import TdmsSource
from cyclofeat.datasets.readers._times import rate_of
from cyclofeat.datasets.readers._wav import WavSource
from cyclofeat.recording import Recording

SOURCES = {
    ".csv": CsvSource, ".npz": NpzSource, ".tdms": TdmsSource, ".mat": MatSource, ".parquet": ParquetSource,
    ".wav": WavSource,
}  # fmt: skip
# How files begin, whatever they are called.
_BEGINNINGS = (
    (b"PK\x03\x04", ".npz"), (b"TDSm", ".tdms"), (b"TDSh", ".tdms_index"), (b"MATLAB ", ".mat"),
    (b"\x89HDF\r\n\x1a\n", ".mat"), (b"PAR1", ".parquet"), (b"RIFF", ".wav"), (b"RIFX", ".wav"),
    (b"RF64", ".wav"), (b"\x1f\x8b", ".gz"), (b"%PDF", ".pdf"),
)  # fmt: skip
# No gearbox here turns its input faster; an angle in degrees taken for rad would.
_FASTEST_INPUT_HZ = 100.0


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
    """Read one torque record from a CSV, NPZ, TDMS, MATLAB, Parquet or WAV file.

    What is assumed (unit, decimal comma, sampling rate from a time column) is stated in the recording's
    ``meta`` and by :func:`describe`. One channel is read at a time, so that it may lie in a file larger than
    memory (TDMS, MATLAB v7.3, Parquet, WAV).

    Parameters
    ----------
    path : path
        File whose name ends in one of the following. Units may stand behind a channel's name
        (``torque [Nm]``, ``torque (Nm)``, ``torque / Nm``, ``torque_nm``) where the file has no place of its
        own for them.

        ``.csv``: one row per sample, separated by comma, semicolon or tab, with or without a row of column
        names and a row of units below it, in UTF-8. With semicolon or tab, a comma in a number is a decimal
        comma.

        ``.npz``: arrays ``torque`` (n,) in Nm, ``sampling_rate`` () in Hz, optionally ``angle`` (n,) in rad,
        and the labels that :func:`write_recording` writes. Pickled objects are never loaded.

        ``.tdms``: channels of all groups and segments, named ``group/channel``; the rate from the property
        ``wf_increment``, the unit from ``unit_string``. Values are scaled as the file says; a scale that
        cannot be computed is an error. Needs npTDMS (extra ``io``).

        ``.mat``: numeric vectors, columns of matrices as ``name(:,1)``, fields of structs as ``struct.field``
        (timetables saved as structs); the rate from a number called ``fs``, ``SampleRate`` and the like, or
        a step called ``dt``. MATLAB v7.3 needs h5py (extra ``io``).

        ``.parquet``: columns; unit and ``sampling_rate`` may stand in the metadata. Needs pyarrow (extra
        ``io``).

        ``.wav``: channels, counted from 0; whole numbers are shares of full scale and need ``scale``.
    channel : str or int, optional
        Channel (name, or index from 0 where the file has an order) that holds the torque. Default: the one
        called "torque", "output_torque", "Drehmoment" and the like, else the only one beside time and angle.
    sampling_rate : float, optional
        Samples per second, in Hz. Needed where the file does not state it; an error where the file
        contradicts it.
    time_channel : str or int, optional
        Channel of the time, from which the rate follows; its jitter and gaps are checked. Default: the one
        called "time", "t", "timestamp", "Zeit" and the like. In s unless its name says ms, us or ns; dates
        (ISO 8601) are read too.
    angle_channel : str, int or False, optional
        Channel of the angle. Default: the one called "angle", "input_angle", "disc_angle", "Winkel" and the
        like; False leaves it out.
    angle_unit : {"rad", "deg"}, optional
        Unit of the angle; needed where the file does not state it. Only NPZ files are taken to be in rad.
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
    ImportError
        If the library that reads this kind of file is not installed.
    TypeError
        If a parameter is of the wrong type or unknown.
    ValueError
        If the file is not what it should be: the message names the file, what came and what would be right.

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
    unknown = labels.keys() - set(LABELS)
    if unknown:
        raise TypeError(f"unknown label {min(unknown)!r}; known are {', '.join(LABELS)}")
    if sampling_rate is not None:
        check_rate("sampling_rate", sampling_rate)
    if scale is not None and not (is_number(scale) and scale != 0):
        raise ValueError(f"scale must be a finite number other than 0 (Nm per unit), got {scale!r}")
    if angle_unit not in (None, "rad", "deg"):
        raise ValueError(f"angle_unit must be 'rad' or 'deg', got {angle_unit!r}")
    if delimiter not in (None, ",", ";", "\t"):
        raise ValueError(f"delimiter must be ',', ';' or a tab, got {delimiter!r}")
    source = _open(path, delimiter)
    found = _assemble(source, channel, sampling_rate, time_channel, angle_channel, angle_unit, scale)
    if "angle" not in found:  # left out: then what the file says of it is void
        found = {key: value for key, value in found.items() if not key.startswith("angle")}
    meta = found.pop("meta", {}) | dict(labels.pop("meta", None) or {})
    if labels.get("worn_lobes") is not None:
        found.pop("defect_count", None)  # the file's count belongs to the file's lobes
    elif labels.get("defect_count") is not None:
        found.pop("worn_lobes", None)
    try:
        recording = Recording(**(found | labels), meta=meta)
    except (TypeError, ValueError) as error:
        hint = " (angle_channel=False leaves the angle out)" if str(error).startswith("angle must") else ""
        raise type(error)(f"{path.name}: {error}{hint}") from None
    if meta.get("angle_unit_assumed"):
        _check_assumed_angle(path, recording)
    return recording


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
    path = file_path(path)
    given: Any = recording
    if not isinstance(given, Recording):
        raise TypeError(f"recording must be a Recording, got {type(given).__name__}")
    if path.is_dir():
        raise ValueError(f"{path} is a directory; give a file name")
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".npz"):
        raise ValueError(f"{path.name}: unknown kind of file {path.suffix!r}; .csv and .npz can be written")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"no such folder: {path.parent}")
    labels = labels_to_write(recording)
    write = write_csv if suffix == ".csv" else write_npz
    write_whole(path, lambda file: write(file, recording, labels))


def file_path(path: Any) -> Path:
    """A path, or a ``TypeError``."""
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"path must be a file name, got {path!r}")
    return Path(path)


def _open(path: Path, delimiter: str | None) -> Source:
    """The channels of a file, after a look at whether it is what its name says."""
    if path.is_dir():
        raise ValueError(f"{path} is a directory; give a file in it, or use read_folder")
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if not path.is_file():
        raise ValueError(f"{path} is no ordinary file")
    suffix = path.suffix.lower()
    if suffix not in SOURCES:
        *others, last = SOURCES
        raise ValueError(
            f"{path.name}: unknown kind of file {path.suffix!r}; {', '.join(others)} and {last} can be read"
        )
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty")
    with path.open("rb") as file:
        start = file.read(16)
    looks = next((kind for begin, kind in _BEGINNINGS if start.startswith(begin)), suffix)
    if looks != suffix:
        raise ValueError(
            f"{path.name} is no {suffix} file: it begins like a {looks} file"
            + (f"; rename it to end in {looks}" if looks in SOURCES else "")
        )
    if suffix == ".csv":
        return CsvSource(path, delimiter)
    if delimiter is not None:
        raise ValueError(f"delimiter is for CSV files, got {delimiter!r} for {path.name}")
    kinds: dict[str, Any] = SOURCES
    source: Source = kinds[suffix](path)
    return source


def _assemble(
    source: Source,
    channel: Channel | None,
    sampling_rate: float | None,
    time_channel: Channel | None,
    angle_channel: Channel | Literal[False] | None,
    angle_unit: str | None,
    scale: float | None,
) -> dict[str, Any]:
    """Parameters of the recording that a file holds."""
    time = source.find("time_channel", time_channel, TIME_NAMES)
    angle = None
    if angle_channel is not False:
        angle = source.find("angle_channel", angle_channel, ANGLE_NAMES)
    torque = source.torque(channel, {time, angle})
    source.check_torque(torque, scale)
    factor, unit_assumed = source.torque_factor(torque, scale)
    # The rate first: it is known without reading a long record.
    if source.labels is None:
        rate, rate_meta = rate_of(source, time, torque, sampling_rate, asked=time_channel is not None)
    else:
        rate, rate_meta = source.labels["sampling_rate"], {}
        where = "its header" if isinstance(source, CsvSource) else "its array 'sampling_rate'"
        check_same_rate(source.file, sampling_rate, rate, where, tolerance=1e-6)
    found: dict[str, Any] = {"torque": _scaled(source.column(torque), factor)}
    angle_assumed = False
    if angle is not None:
        angle_factor, angle_assumed = source.angle_factor(angle, angle_unit)
        found["angle"] = _scaled(source.column(angle), angle_factor)
        found["angle_of"] = "disc" if source.bases[angle] in DISC_ANGLE_NAMES else "input"
    if source.labels is not None:
        return found | source.labels
    meta = {"file": source.file, "channel": source.names[torque], "unit_assumed": unit_assumed}
    if angle_assumed:
        meta["angle_unit_assumed"] = True
    meta |= rate_meta | source.meta(torque)
    if factor != 1:
        meta["scale"] = factor
    other = dict(source.other_labels)
    meta |= other.pop("meta", {})
    return found | {"sampling_rate": rate} | other | {"meta": meta}


def _scaled(values: Float, factor: float) -> Float:
    return values if factor == 1 else values * factor


def _check_assumed_angle(path: Path, recording: Recording) -> None:
    """Raise ``ValueError`` where an angle of no stated unit turns as fast as only degrees would."""
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
            f"{path.name}: angle does not state its unit, and in rad it would turn at {60 * hertz:.5g} RPM "
            f"(in deg at {60 * in_degrees:.5g} RPM); give angle_unit='rad' or 'deg', or angle_channel=False "
            "to leave it out"
        )
