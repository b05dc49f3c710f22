"""Options of commands that read recordings, and errors of reading in the words of those options."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cyclofeat.datasets.readers import Entry
    from cyclofeat.recording import Recording

FILES = "recordings (.csv, .npz, .tdms, .mat, .parquet, .wav), or folders of them"
# What the functions call it, and what people type.
_OPTIONS = {
    "sampling_rate": "--sampling-rate", "time_channel": "--time-channel", "angle_channel": "--angle-channel",
    "angle_unit": "--angle-unit", "channel": "--channel", "scale": "--scale", "delimiter": "--delimiter",
    "speed_rpm": "--speed", "n_lobes": "--n-lobes",
}  # fmt: skip


def add_reading_options(parser: argparse.ArgumentParser, *, sampling_rate: bool = True) -> None:
    """Add what can be said of files that do not say it themselves."""
    group = parser.add_argument_group("what the files do not say themselves")
    group.add_argument("--channel", help="name or index from 0 of the torque's channel")
    if sampling_rate:
        group.add_argument("--sampling-rate", type=float, help="Hz")
    group.add_argument("--time-channel", help="channel of times, from which the rate follows")
    group.add_argument("--angle-channel", help="channel of the shaft's angle")
    group.add_argument("--angle-unit", choices=("rad", "deg"))
    group.add_argument("--angle-absolute", action="store_true", help="the angle's zero is cam 0 at pin 0")
    group.add_argument("--no-angle", action="store_true", help="leave the shaft's angle out")
    group.add_argument("--speed", type=float, help="nominal input speed, RPM")
    group.add_argument("--n-lobes", type=int, metavar="N", help="lobes of a disc (15)")
    group.add_argument("--scale", type=float, help="Nm per unit of the channel")
    group.add_argument("--delimiter", choices=(",", ";", "tab"), help="of CSV files")
    parser.set_defaults(reads=True)


def reading_arguments(arguments: argparse.Namespace) -> dict[str, Any]:
    """Arguments of ``read_recording`` that were typed."""
    if arguments.no_angle and (arguments.angle_channel or arguments.angle_unit or arguments.angle_absolute):
        raise ValueError("--no-angle goes without --angle-channel, --angle-unit and --angle-absolute")
    found = {
        "channel": arguments.channel,
        "sampling_rate": arguments.sampling_rate,
        "time_channel": arguments.time_channel,
        "angle_channel": False if arguments.no_angle else arguments.angle_channel,
        "angle_unit": arguments.angle_unit,
        "angle_is_absolute": True if arguments.angle_absolute else None,
        "speed_rpm": arguments.speed,
        "n_lobes": arguments.n_lobes,
        "scale": arguments.scale,
        "delimiter": "\t" if arguments.delimiter == "tab" else arguments.delimiter,
    }
    return {key: value for key, value in found.items() if value is not None}


@dataclass(frozen=True)
class _Unreadable:
    """A folder without recordings or with a wrong manifest, which is an error only when it comes to it."""

    path: Path
    error: Exception

    def read(self, **_: Any) -> Recording:
        raise self.error


def entries(paths: Sequence[str]) -> list[Entry | _Unreadable]:
    """The files named, and what the folders named hold, by their manifests."""
    from cyclofeat.datasets.readers import Entry, folder_entries

    found: list[Entry | _Unreadable] = []
    for name in paths:
        path = Path(name)
        try:
            found += folder_entries(path) if path.is_dir() else [Entry(path)]
        except (ValueError, OSError) as error:
            found.append(_Unreadable(path, error))
    return found


def read_all(paths: Sequence[str], arguments: argparse.Namespace) -> list[Recording]:
    """All recordings that the paths name, read as the options say."""
    options = reading_arguments(arguments)
    return [entry.read(**options) for entry in entries(paths)]


def titled(path: object, recording: Recording) -> str:
    """The path and what was read from it, in one line."""
    from cyclofeat.datasets import one_line

    text = one_line(recording)
    # The line begins with the file's own name, where it was read from one.
    name = str((recording.meta or {}).get("file") or "")
    return f"{path}{text.removeprefix(name)}" if name else f"{path}: {text}"


def in_options(message: str) -> str:
    """An error of reading, with options in place of arguments of functions.

    Examples
    --------
    >>> in_options("a.csv: give sampling_rate= (Hz), or time_channel= for a column of times")
    'a.csv: give --sampling-rate (Hz), or --time-channel for a column of times'
    >>> in_options("a.csv: channel = 'x' does not exist")
    "a.csv: --channel 'x' does not exist"
    >>> in_options("give angle_unit='rad' or 'deg', or angle_channel=False to leave it out")
    'give --angle-unit rad or deg, or --no-angle to leave it out'
    """
    message = message.replace("angle_channel=False", "--no-angle")
    message = message.replace("angle_unit='rad' or 'deg'", "--angle-unit rad or deg")
    message = message.replace("delimiter=';'", "--delimiter ';'")
    message = message.replace(
        "angle_is_absolute must be False where there is no angle, got True",
        "--angle-absolute needs an angle, and the file has none",
    )
    message = message.replace("Windower(input_speed_hz=...) or Recording(speed_rpm=...)", "--speed (RPM)")
    names = "|".join(_OPTIONS)
    # Not within quotes or after a dot: there it is a name in the file.
    message = re.sub(rf"(?<![\w'.-])({names})=(?=[\s,;)]|$)", lambda match: _OPTIONS[match[1]], message)
    message = re.sub(rf"(?<![\w'.-])({names}) = ", lambda match: f"{_OPTIONS[match[1]]} ", message)
    return re.sub(rf"(?<![\w'.-])({names}) must ", lambda match: f"{_OPTIONS[match[1]]} must ", message)
