"""Options of commands that read recordings, and the loop over files (``datasets.readers`` reads them)."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from cyclofeat._base.arguments import ArgumentError
from cyclofeat._base.progress import Progress
from cyclofeat._base.quantities import QUANTITIES
from cyclofeat.cli._idle import add_idle
from cyclofeat.cli._table import Printed

if TYPE_CHECKING:
    from cyclofeat.datasets.readers import Entry
    from cyclofeat.recordings import Recording

T = TypeVar("T")
FILES = "recordings (.csv, .csv.gz, .txt, .npz, .tdms, .mat, .parquet, .wav, .xlsx), or folders of them"
UNREADABLE = (ValueError, TypeError, OSError, ImportError)
_DELIMITERS = {",": ",", ";": ";", "tab": "\t", "space": " "}

# Argument of read_recording: its option, and how the option is parsed.
_OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "channel": ("--channel", {"help": "name of the channel to read, or its index from 0"}),
    "quantity": (
        "--quantity",
        {"choices": QUANTITIES, "help": "quantity that the channel holds (default output_torque)"},
    ),
    "sampling_rate": ("--sampling-rate", {"type": float, "metavar": "HZ", "help": "sampling rate in Hz"}),
    "time_channel": ("--time-channel", {"help": "channel of times, which gives the sampling rate"}),
    "angle_channel": ("--angle-channel", {"help": "channel of the shaft's angle"}),
    "angle_unit": ("--angle-unit", {"choices": ("rad", "deg", "rev"), "help": "unit of the angle"}),
    "pulses_per_turn": (
        "--pulses-per-turn",
        {"type": int, "metavar": "N", "help": "the angle's channel holds N pulses per turn (1: an index)"},
    ),
    "angle_is_absolute": (
        "--angle-absolute",
        {"action": "store_true", "default": None, "help": "the angle is zero where cam 0 is at pin 0"},
    ),
    "speed_rpm": ("--speed", {"type": float, "metavar": "RPM", "help": "nominal input speed, RPM"}),
    "n_lobes": ("--n-lobes", {"type": int, "metavar": "N", "help": "lobes of a disc (default 15)"}),
    "scale": ("--scale", {"type": float, "help": "Nm (or A) per unit of the channel"}),
    "delimiter": ("--delimiter", {"choices": tuple(_DELIMITERS), "help": "separator in CSV files"}),
}

# Arguments of the package's functions that options of other names set.
_ALIASES = {
    "n_jobs": ("--jobs",),
    "random_state": ("--seed",),
    "n_assemblies": ("--assemblies",),
    "defect_counts": ("--worn-count",),
    "worn": ("--worn-count",),
    "noise_nm": ("--noise",),
    "load_nm": ("--load", "--loads"),
    "speed_rpm": ("--speed", "--speeds"),
    "wear_um": ("--wear", "--mixed-wear"),
    "output_turns": ("--turns", "--windows"),
}


def add_reading_options(parser: argparse.ArgumentParser, *, sampling_rate: bool = True) -> None:
    """Add options that state what files do not; ``sampling_rate=False`` where the parser has that one."""
    group = parser.add_argument_group("what the files do not state")
    for argument, (option, parsing) in _OPTIONS.items():
        if argument != "sampling_rate" or sampling_rate:
            group.add_argument(option, dest=argument, **parsing)
    group.add_argument("--no-angle", action="store_true", help="ignore the shaft's angle")
    of_angle = ("--angle-channel", "--angle-unit", "--angle-absolute", "--pulses-per-turn")
    add_idle(parser, *of_angle, beside=["--no-angle"])
    add_idle(parser, "--angle-unit", beside=["--pulses-per-turn"])


READING = (*(option for option, _ in _OPTIONS.values()), "--no-angle")


def reading_arguments(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of ``read_recording`` that were typed."""
    typed = {argument: getattr(arguments, argument) for argument in _OPTIONS}
    if arguments.no_angle:
        typed["angle_channel"] = False
    if typed["delimiter"] is not None:
        typed["delimiter"] = _DELIMITERS[typed["delimiter"]]
    return {argument: value for argument, value in typed.items() if value is not None}


def option_of(argument: str, rest: str) -> str:
    """Return the option of an argument, with the value that follows the argument's name in a message.

    Examples
    --------
    >>> option_of("sampling_rate", "="), option_of("channel", " = 'x'"), option_of("angle_channel", "=False")
    ('--sampling-rate', "--channel 'x'", '--no-angle')
    """
    if (argument, rest) == ("angle_channel", "=False"):
        return "--no-angle"
    if argument not in _OPTIONS:
        return argument + rest
    option, parsing = _OPTIONS[argument]
    value = rest.lstrip(" =")
    return option if not value or "action" in parsing else f"{option} {value}"


def error_text(error: Exception, typed: Collection[str] = ()) -> str:
    """Return the message of an error on one line, with options in place of arguments of functions.

    A message that begins with an argument of a function means the option, of those typed, that sets it.
    """
    message = error.spelled(option_of) if isinstance(error, ArgumentError) else str(error)
    if isinstance(error, MemoryError):
        message = f"not enough memory: {error}"
    message = message.replace("n_splits=", "--folds ").replace("n_splits", "--folds")  # no other means these
    first, *rest = message.split() or [""]
    options = (f"--{first.replace('_', '-')}", *_ALIASES.get(first, ()))
    return " ".join([next((option for option in options if option in typed), first), *rest])


@dataclass(frozen=True)
class UnreadableFolder:
    """A folder that holds no recordings or a wrong manifest; the error is raised when it is read."""

    path: Path
    error: Exception

    def read(self, **_: Any) -> Recording:
        """Raise the error."""
        raise self.error


def entries(paths: Sequence[str]) -> list[Entry | UnreadableFolder]:
    """Return the files named, and the files of the folders named, as their manifests state."""
    from cyclofeat.datasets.readers import Entry, folder_entries

    files: list[Entry | UnreadableFolder] = []
    for path in map(Path, paths):
        try:
            files += folder_entries(path) if path.is_dir() else [Entry(path)]
        except (ValueError, OSError) as error:
            files.append(UnreadableFolder(path, error))
    return files


def read_all(paths: Sequence[str], arguments: argparse.Namespace) -> list[Recording]:
    """Return all recordings that the paths name, read as the options state."""
    options = reading_arguments(arguments)
    files = entries(paths)
    recordings: list[Recording] = []
    with Progress("reading recordings") as progress:
        for entry in files:
            try:
                recordings.append(entry.read(**options))
            except UNREADABLE as error:
                raise ValueError(placed(entry.path, error_text(error))) from error
            progress(len(recordings), len(files))
    return recordings


@dataclass(frozen=True)
class FileResult(Generic[T]):
    """Result of one file, or the error; ``title`` is its path and content in one line."""

    path: Path
    title: str = ""
    value: T | None = None
    error: str = ""

    def printed(
        self, lines: Sequence[str] = (), facts: dict[str, Any] | None = None, *, refused: bool = False
    ) -> Printed:
        """Return the title, the lines and the facts, or the error, with the file's path."""
        file = {"file": str(self.path)}  # first, and not the name that a recording states
        text = "\n".join([self.title, *(f"  {line}" for line in lines)])
        if self.error:
            failure = file | {"error": self.error} | (facts or {})
            return Printed(text, failure, placed(self.path, self.error), failed=True)
        return Printed(text, file | (facts or {}) | file, refused=refused)


def each_recording(
    doing: str,
    files: Sequence[Entry | UnreadableFolder],
    options: dict[str, Any],
    work: Callable[[Path, Recording], T],
) -> Iterator[FileResult[T]]:
    """Read file by file and yield what ``work`` makes of path and recording.

    A file that fails does not stop the others.
    ``doing`` says in the line of progress what is done, such as "counting".
    """
    with Progress(doing) as progress:
        for done, entry in enumerate(files, 1):
            result = _of_file(entry, options, work)
            progress(done, len(files))
            yield result


def _of_file(
    entry: Entry | UnreadableFolder, options: dict[str, Any], work: Callable[[Path, Recording], T]
) -> FileResult[T]:
    from cyclofeat.datasets.readers import one_line

    title = ""
    try:
        recording = entry.read(**options)
        title = placed(entry.path, one_line(recording))
        return FileResult(entry.path, title, work(entry.path, recording))
    except UNREADABLE as error:
        return FileResult(entry.path, title, error=error_text(error))


def placed(path: Path, message: str) -> str:
    """Return a message about a file that states the file's path."""
    if re.search(rf"(?<!\w){re.escape(str(path))}(?!\w)", message):
        return message
    if message.startswith(path.name):
        return f"{path}{message.removeprefix(path.name)}"
    return f"{path}: {message}"
