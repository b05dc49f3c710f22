"""Arguments of several commands: which have no effect beside others, files to write, recordings, models."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, NamedTuple, TypeVar, cast

from cyclofeat._base.arguments import ArgumentError
from cyclofeat._base.files import check_parent
from cyclofeat._base.progress import Progress
from cyclofeat._base.quantities import QUANTITIES, in_words
from cyclofeat.cli._printing import Printed, note

if TYPE_CHECKING:
    from cyclofeat.counting import LobeCount, LobeModel
    from cyclofeat.datasets.readers import Entry
    from cyclofeat.recordings import Recording


class Idle(NamedTuple):
    """Arguments without effect where any of ``beside`` is given, or none of ``without``.

    Arguments are named as people read them: an option like ``--depth``, a positional argument by its metavar.
    The other side may state a value too, or a pattern for it: ``--quantity motor_current``, ``--model
    *.skops``.
    """

    names: tuple[str, ...]
    beside: Collection[str] = ()
    without: Collection[str] = ()


class CommandParser(argparse.ArgumentParser):
    """Parser of one command; its result also holds ``typed``, the values that were typed, by name."""

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse as usual, and a second time without defaults, for what was typed."""
        parsed, rest = super().parse_known_args(args, namespace)
        defaults = [(action, action.default) for action in self._actions]
        try:
            for action, _ in defaults:
                action.default = argparse.SUPPRESS
            typed = vars(super().parse_known_args(args)[0])
        finally:
            for action, default in defaults:
                action.default = default
        parsed.typed = {
            name_of(action): typed[action.dest] for action in self._actions if action.dest in typed
        }
        return parsed, rest


def name_of(action: argparse.Action) -> str:
    """Return an argument's name as people read it."""
    return action.option_strings[0] if action.option_strings else str(action.metavar or action.dest)


def add_idle(
    parser: argparse.ArgumentParser,
    *names: str,
    beside: Collection[str] = (),
    without: Collection[str] = (),
) -> None:
    """State that the arguments named have no effect beside any of some others, or without all of them."""
    parser.set_defaults(idle=(*(parser.get_default("idle") or ()), Idle(names, beside, without)))


def refuse_idle(arguments: argparse.Namespace) -> None:
    """Raise ValueError if an argument was typed that has no effect beside the others."""
    for names, beside, without in getattr(arguments, "idle", ()):
        present = next((text for one in beside if (text := _typed_text(arguments.typed, one))), "")
        reason = f"with {present}" if present else ""
        if without and not any(_typed_text(arguments.typed, one) for one in without):
            *others, last = without
            reason = f"without {', '.join(others)}{' or ' if others else ''}{last}"
        for name in names:
            if reason and name in arguments.typed:
                raise ValueError(f"{name} has no effect {reason}: leave it out")


def _typed_text(typed: dict[str, Any], wanted: str) -> str:
    """Return an argument as it was typed, empty where it was not, or with another value than is wanted."""
    name, _, pattern = wanted.partition(" ")
    if name not in typed:
        return ""
    if not pattern:
        return name
    value = str(typed[name])
    return f"{name} {value}" if fnmatchcase(value.lower(), pattern) else ""


Kind = Literal["file", "folder", "model", "page"]


def add_target(parser: argparse.ArgumentParser, option: str, kind: Kind = "file", **parsing: Any) -> None:
    """Add an option that names a file or folder to write, and ``--force`` with the first of them."""
    targets: dict[str, Kind] | None = parser.get_default("targets")
    if targets is None:
        targets = {}
        parser.set_defaults(targets=targets)
        parser.add_argument("--force", action="store_true", help="overwrite files that exist")
    action = parser.add_argument(option, **parsing)
    targets[option] = kind
    if not action.required and action.default is None:
        add_idle(parser, "--force", without=targets)  # with those to come


def check_targets(arguments: argparse.Namespace) -> None:
    """Check that every file named can be written.

    Raises
    ------
    FileExistsError
        If it exists, or is a folder that is not empty, and ``--force`` was not given.
    FileNotFoundError, IsADirectoryError, NotADirectoryError
        If its folder does not exist, or it is a folder in place of a file or a file in place of a folder.
    ImportError, ValueError
        If it needs a library that is not installed, has a wrong suffix, or is named by two options.
    """
    seen: dict[Path, str] = {}
    for option, kind in getattr(arguments, "targets", {}).items():
        name = getattr(arguments, option.removeprefix("--").replace("-", "_"))
        if name is None:
            continue
        path = Path(name)
        other = seen.setdefault(path.resolve(), option)
        if other != option:
            raise ValueError(f"{other} and {option} must name different files, both are {path}")
        written = [path]
        if kind == "folder":
            check_folder(option, path)
            written = [path] if path.is_dir() and any(path.iterdir()) else []
        elif path.is_dir():
            raise IsADirectoryError(f"{option} must name a file, {path} is a folder")
        else:
            check_parent(path, option)
        if kind == "page":
            from cyclofeat.report import check_page_path

            check_page_path(path)
        elif kind == "model":
            from cyclofeat.models.card import card_path
            from cyclofeat.models.persistence import check_model_path

            written.append(card_path(check_model_path(path)))
        for one in written:
            if one.exists() and not arguments.force:
                raise FileExistsError(f"{one} exists: give {option} another name, or --force to overwrite it")


def check_folder(option: str, path: Path) -> None:
    """Raise NotADirectoryError if an option's folder is a file."""
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(f"{option} must name a folder, {path} is a file")


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
    message = error.format_message(option_of) if isinstance(error, ArgumentError) else str(error)
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


def list_entries(paths: Sequence[str]) -> list[Entry | UnreadableFolder]:
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
    files = list_entries(paths)
    recordings: list[Recording] = []
    with Progress("reading recordings") as progress:
        for entry in files:
            try:
                recordings.append(entry.read(**options))
            except UNREADABLE as error:
                raise ValueError(name_file(entry.path, error_text(error))) from error
            progress(len(recordings), len(files))
    return recordings


@dataclass(frozen=True)
class FileResult(Generic[T]):
    """Result of one file, or the error; ``title`` is its path and content in one line."""

    path: Path
    title: str = ""
    value: T | None = None
    error: str = ""

    def format_result(
        self, lines: Sequence[str] = (), facts: dict[str, Any] | None = None, *, refused: bool = False
    ) -> Printed:
        """Return the title, the lines and the facts, or the error, with the file's path."""
        file = {"file": str(self.path)}  # first, and not the name that a recording states
        text = "\n".join([self.title, *(f"  {line}" for line in lines)])
        if self.error:
            failure = file | {"error": self.error} | (facts or {})
            return Printed(text, failure, name_file(self.path, self.error), failed=True)
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
    from cyclofeat.datasets.readers import one_line

    with Progress(doing) as progress:
        for done, entry in enumerate(files, 1):
            title = ""
            try:
                recording = entry.read(**options)
                title = name_file(entry.path, one_line(recording))
                result = FileResult(entry.path, title, work(entry.path, recording))
            except UNREADABLE as error:
                result = FileResult(entry.path, title, error=error_text(error))
            progress(done, len(files))
            yield result


def name_file(path: Path, message: str) -> str:
    """Return a message about a file that states the file's path."""
    if re.search(rf"(?<!\w){re.escape(str(path))}(?!\w)", message):
        return message
    if message.startswith(path.name):
        return f"{path}{message.removeprefix(path.name)}"
    return f"{path}: {message}"


def add_model_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a model, and the one that cuts the start of each recording."""
    add_model_file(parser)
    parser.add_argument(
        "--skip", type=float, default=0.0, help="seconds to leave out at the start (run-up of the machine)"
    )


def add_model_file(
    parser: argparse.ArgumentParser,
    description: str = "model file that train wrote, with its card in the same folder (default: the packaged "
    "model of the quantity, trained on simulated assemblies of rig R2 at 100 to 1,500 RPM and 3 to 40 Nm)",
) -> None:
    """Add the options that name a model and state how it is loaded."""
    parser.add_argument("--model", help=description)
    parser.add_argument(
        "--trust",
        "--trust-model",
        dest="trust",
        action="store_true",
        help="load a joblib model, which can run any code (a .skops model needs no trust)",
    )
    parser.add_argument(
        "--allow",
        action="append",
        default=[],
        metavar="NAME",
        help="accept a version other than the model's, of scikit-learn, numpy, features, ...",
    )
    add_idle(parser, "--trust", beside=["--model *.skops"])
    add_idle(parser, "--trust", "--allow", without=["--model"])


def read_model(arguments: argparse.Namespace) -> LobeModel:
    """Return the model that the options name, or the packaged one, which is then stated."""
    _import_scikit_learn()
    from cyclofeat.models import load_default_model, load_model
    from cyclofeat.models.persistence import as_lobe_model

    if arguments.model is None:
        model = load_default_model(arguments.quantity or QUANTITIES[0])
        note(f"model: {model_name(arguments)}, trained on {model.card_['description']}")
        return model
    loaded = load_model(arguments.model, trusted=arguments.trust, allow=arguments.allow)
    return as_lobe_model(loaded)


def count_with_warnings(model: LobeModel, recording: Recording) -> LobeCount:
    """Count a recording; warnings about the record itself follow those of the count."""
    from cyclofeat.datasets.readers import record_warnings

    count = model.count(recording)
    of_record = record_warnings(recording, reduction=model.n_lobes_)
    return replace(count, warnings=(*count.warnings, *of_record))


def model_name(arguments: argparse.Namespace) -> str:
    """Return what names the model in a result: its file, or which of the packaged ones it is."""
    return arguments.model or f"packaged, {in_words(arguments.quantity or QUANTITIES[0])}"


def _import_scikit_learn() -> None:
    """Import scikit-learn without pandas: half a second that no count needs."""
    if "pandas" in sys.modules:
        return
    hidden = cast("dict[str, None]", sys.modules)
    hidden["pandas"] = None  # an import finds nothing
    try:
        import_module("sklearn.base")
    finally:
        del hidden["pandas"]


def without_start(recording: Recording, seconds: float) -> Recording:
    """Return a recording without its first seconds."""
    if not 0 <= seconds < recording.duration:
        raise ValueError(f"--skip must lie within the {recording.duration:g} s recorded, got {seconds:g} s")
    return recording.part(seconds) if seconds else recording
