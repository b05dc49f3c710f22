"""What all commands share: their parser, options of several of them, and what is printed of results."""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
import traceback
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, NoReturn, TypeVar, cast

from cyclofeat._base.files import check_parent
from cyclofeat._base.progress import Progress, erase_progress, is_hidden, seconds_text
from cyclofeat._base.quantities import QUANTITIES, in_words, number_of, some_of

if TYPE_CHECKING:
    from cyclofeat.counting import LobeModel
    from cyclofeat.datasets.readers import Entry
    from cyclofeat.recordings import Recording

T = TypeVar("T")

_LONG_S = 10.0
# Seconds of a core for each simulated second, one run at a time; batches need a fifth.
_SIMULATION_PACE = 0.15


@dataclass(frozen=True)
class Printed:
    """Printed form of a result: text for people, plain values for JSON, and an error.

    ``failed`` makes the exit code 2, ``refused`` makes it 3 if nothing failed.
    """

    text: str
    json: Any
    error: str = ""
    failed: bool = False
    refused: bool = False


def note(message: str) -> None:
    """Print a line on standard error, unless ``--quiet`` was given."""
    if not is_hidden.get():
        print_message(message)


def warn(error: str) -> None:
    print_message(f"cyclofeat: error: {error}")


def print_message(message: str) -> None:
    """Print a line on standard error, below no line of progress."""
    erase_progress()
    print(message, file=sys.stderr, flush=True)


Kind = Literal["file", "folder", "model", "page", "recordings"]


class RaisingParser(argparse.ArgumentParser):
    """Parser whose errors are raised, so that all errors are printed in the same way."""

    def error(self, message: str) -> NoReturn:
        wrong = re.search(r"invalid choice: '(.+)' \(choose from (.+)\)", message)
        hint = "" if wrong is None else _suggest(wrong[1], re.findall(r"[\w.-]+", wrong[2]))
        raise ValueError(f"{message}{hint}; see {self.prog} --help")

    def parse_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> Arguments:
        """Parse as usual."""
        return super().parse_args(args, Arguments())


def _suggest(typed: str, known: Iterable[str]) -> str:
    """Return a question for the known word that is most like the one typed; empty where none is."""
    from difflib import get_close_matches

    return "".join(f" (did you mean {near}?)" for near in get_close_matches(typed, known, n=1, cutoff=0.7))


class Parser(RaisingParser):
    """Parser of one command, which refuses arguments without effect."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.idle: list[tuple[Collection[str], Collection[str], Collection[str]]] = []
        self.targets: dict[str, Kind] = {}

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse as usual, and a second time without defaults, for what was typed."""
        parsed, rest = super().parse_known_args(args, namespace)
        if rest:
            options = [word.partition("=")[0] for word in rest if word.startswith("--")]
            hint = _suggest(options[0], self._option_string_actions) if options else ""
            self.error(f"unrecognized arguments: {' '.join(rest)}{hint}")
        defaults = [(action, action.default) for action in self._actions]
        try:
            for action, _ in defaults:
                action.default = argparse.SUPPRESS
            typed = vars(super().parse_known_args(args)[0])
        finally:
            for action, default in defaults:
                action.default = default
        parsed.typed, parsed.options, parsed.targets = {}, {}, self.targets
        for action in self._actions:
            value = typed.get(action.dest)
            constant = action.const if action.nargs == 0 else ""
            if action.dest in typed and isinstance(value, bool) == (action.nargs == 0):
                parsed.typed[name_of(action)] = value
            if action.option_strings:
                parsed.options[f"{action.dest}={constant}"] = action.option_strings[0]
        for names, beside, without in self.idle:
            present = next((text for other in beside if (text := _typed_text(parsed.typed, other))), "")
            reason = f"with {present}" if present else ""
            if without and not any(_typed_text(parsed.typed, other) for other in without):
                *others, last = without
                reason = f"without {', '.join(others)}{' or ' if others else ''}{last}"
            for name in names:
                if reason and name in parsed.typed:
                    raise ValueError(f"{name} has no effect {reason}: leave it out")
        return parsed, rest

    def add_idle(self, *names: str, beside: Collection[str] = (), without: Collection[str] = ()) -> None:
        """State that arguments have no effect where any of ``beside`` is given, or none of ``without``.

        Arguments are named as people read them: an option like ``--depth``, a positional argument by its
        metavar. The other side may state a value too, or a pattern for it: ``--quantity motor_current``,
        ``--model *.skops``.
        """
        self.idle.append((names, beside, without))

    def add_target(self, option: str, kind: Kind = "file", **parsing: Any) -> None:
        """Add an option that names a file or folder to write, and ``--force`` with the first of them.

        ``"recordings"`` is a folder where ``--count`` is given, else a file.
        """
        if not self.targets:
            self.add_argument("--force", action="store_true", help="overwrite files that exist")
        action = self.add_argument(option, **parsing)
        self.targets[option] = kind
        if not action.required and action.default is None:
            self.add_idle("--force", without=self.targets)  # with those to come

    def add_jobs(self, workers: str = "processes", to: argparse._ActionsContainer | None = None) -> None:
        """Add the option that states how many ``workers`` there are, to the parser or one of its groups."""
        (to or self).add_argument(
            "--jobs", dest="n_jobs", type=int, default=-1, metavar="N", help=f"{workers} (default: all cores)"
        )

    def add_seed(self, drawn: str, default: int = 0) -> None:
        """Add the option that states the seed of what is ``drawn``."""
        self.add_argument(
            "--seed", dest="random_state", type=whole_number(0), default=default, metavar="N",
            help=f"seed of {drawn} (default {default})",
        )  # fmt: skip

    def add_reading_options(self, *, sampling_rate: bool = True, recordings: str = "") -> None:
        """Add options that state what files do not; ``sampling_rate=False`` where the parser has that one.

        Without ``recordings``, an argument, they have no effect, but for the quantity.
        """
        group = self.add_argument_group("what the files do not state")
        channel_of_angle = group.add_mutually_exclusive_group()
        for option, parsing in _OPTIONS.items():
            if option != "--sampling-rate" or sampling_rate:
                to = channel_of_angle if option == "--angle-channel" else group
                to.add_argument(option, **parsing)
        channel_of_angle.add_argument(
            "--no-angle",
            dest="angle_channel",
            action="store_const",
            const=False,
            help="ignore the shaft's angle",
        )
        of_turns = ("--pulses-per-turn", "--counts-per-turn")
        self.add_idle("--angle-unit", "--angle-absolute", *of_turns, beside=["--no-angle"])
        self.add_idle("--angle-unit", beside=of_turns)
        if recordings:
            always = ("--quantity",) if sampling_rate else ("--quantity", "--sampling-rate")
            others = (option for option in (*_OPTIONS, "--no-angle") if option not in always)
            self.add_idle(*others, without=[recordings])

    def add_model_options(self) -> None:
        """Add the options that name a model, and the one that cuts the start of each recording."""
        self.add_model_file()
        self.add_argument(
            "--skip",
            type=float,
            default=0.0,
            help="seconds to leave out at the start (run-up of the machine)",
        )

    def add_model_file(
        self,
        description: str = "model file that train wrote, with its card in the same folder (default: the "
        "packaged model of the quantity, trained on simulated assemblies of rig R2 at 100 to 1,500 RPM and "
        "3 to 40 Nm)",
    ) -> None:
        """Add the options that name a model and state how it is loaded."""
        self.add_argument("--model", help=description)
        self.add_argument(
            "--trust",
            action="store_true",
            help="load a joblib model, which can run any code (a .skops model needs no trust)",
        )
        self.add_argument(
            "--allow", action="append", default=[], metavar="NAME",
            help="accept a version other than the model's, of scikit-learn, numpy, features, ...",
        )  # fmt: skip
        self.add_idle("--trust", beside=["--model *.skops"])
        self.add_idle("--trust", "--allow", without=["--model"])

    def add_history_options(self, default_name: str) -> None:
        """Add the options that name a history and the gearbox whose recordings are counted."""
        self.add_argument(
            "--history", metavar="FILE.sqlite", help="file to which each count is added; created if missing"
        )
        self.add_argument(
            "--gearbox",
            metavar="NAME",
            help="name of the gearbox in the history (default the assembly that a file states"
            f"{default_name})",
        )
        self.add_alarm_options()
        of_history = ("--gearbox", "--false-alarms-per-month", "--recordings-per-month")
        self.add_idle(*of_history, without=["--history"])

    def add_alarm_options(self) -> None:
        """Add the options from which the rule of the alarm follows."""
        self.add_argument(
            "--false-alarms-per-month", type=positive, default=0.1, metavar="N",
            help="accepted false alarms per gearbox and month (default 0.1)",
        )  # fmt: skip
        self.add_argument(
            "--recordings-per-month", type=positive, metavar="N",
            help="recordings of a gearbox per month (default: the rate so far, over at least an hour)",
        )  # fmt: skip


def name_of(action: argparse.Action) -> str:
    """Return an argument's name as people read it."""
    return action.option_strings[0] if action.option_strings else str(action.metavar or action.dest)


def _typed_text(typed: dict[str, Any], wanted: str) -> str:
    """Return an argument as it was typed, empty where it was not, or with another value than is wanted."""
    name, _, pattern = wanted.partition(" ")
    if name not in typed:
        return ""
    if not pattern:
        return name
    value = str(typed[name])
    return f"{name} {value}" if fnmatchcase(value.lower(), pattern) else ""


def expected_errors() -> tuple[type[Exception], ...]:
    """Return the errors of input and surroundings, without importing the simulators for one of theirs."""
    simulators = sys.modules.get("cyclofeat.simulators")
    failed = () if simulators is None else (simulators.SimulationFailed,)
    return ValueError, TypeError, OSError, ImportError, MemoryError, *failed


def whole_number(least: int, most: float = math.inf) -> Callable[[str], int]:
    """Return the type of an option that takes a whole number within these limits."""

    def parse_whole(text: str) -> int:
        number = int(text) if re.fullmatch(r"\s*[+-]?\d+\s*", text) else None
        if number is None or not least <= number <= most:
            limits = f"of at least {least}" if most == math.inf else f"from {least} to {most}"
            raise argparse.ArgumentTypeError(f"must be a whole number {limits}, got {text!r}")
        return number

    return parse_whole


def positive(text: str) -> float:
    """Return a positive, finite number: the type of an option."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"must be a positive, finite number, got {text!r}")
    return number


def range_of(unit: str, most: float = math.inf) -> Callable[[str], tuple[float, float]]:
    """Return the type of an option that takes ``LOW:HIGH`` or one number."""

    def parse_range(text: str) -> tuple[float, float]:
        ends = [positive(end) for end in text.split(":", 1)]
        if not ends[0] <= ends[-1] <= most:
            limit = "" if most == math.inf else f" and at most {most:g}"
            raise argparse.ArgumentTypeError(f"must be LOW:HIGH or one number in {unit}{limit}, got {text!r}")
        return ends[0], ends[-1]

    return parse_range


def list_of(parse: Callable[[str], T]) -> Callable[[str], list[T]]:
    """Return the type of an option that takes several values, separated by commas."""
    return lambda text: [parse(part) for part in text.split(",")]


def check_folder(option: str, path: Path) -> None:
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(f"{option} must name a folder, {path} is a file")


FILES = (
    "recordings (.csv, .txt, .npz, .tdms, .mat, .h5, .mf4, .parquet, .wav, .xlsx, ...), or folders of them"
)
_DELIMITERS = {",": ",", ";": ";", "|": "|", "tab": "\t", "space": " "}
_COUNT: dict[str, Any] = {"type": whole_number(1), "metavar": "N"}

# Options of read_recording; its arguments have their names, unless ``dest`` states another.
_OPTIONS: dict[str, dict[str, Any]] = {
    "--channel": {"help": "name of the channel to read, or its index from 0"},
    "--quantity": {"choices": QUANTITIES, "help": "quantity of the channel (default output_torque)"},
    "--sampling-rate": {"type": positive, "metavar": "HZ", "help": "sampling rate in Hz"},
    "--time-channel": {"help": "channel of times; none leaves times out"},
    "--time-unit": {"choices": ("s", "ms", "us", "ns", "min", "h", "d"), "help": "unit of the times"},
    "--angle-channel": {"help": "channel of the shaft's angle"},
    "--angle-unit": {"choices": ("rad", "deg", "rev"), "help": "unit of the angle"},
    "--pulses-per-turn": _COUNT | {"help": "the angle's channel holds N pulses per turn (1: an index)"},
    "--counts-per-turn": _COUNT | {"help": "the angle's channel holds counts of an encoder, N per turn"},
    "--angle-absolute": {
        "dest": "angle_is_absolute", "action": "store_true", "default": None,
        "help": "the angle is zero where cam 0 is at pin 0",
    },
    "--speed": {
        "dest": "speed_rpm", "type": positive, "metavar": "RPM", "help": "nominal input speed, RPM",
    },
    "--n-lobes": {"type": int, "metavar": "N", "help": "lobes of a disc (default 15)"},
    "--scale": {"type": float, "help": "Nm (or A) per unit of the channel"},
    "--delimiter": {
        "choices": tuple(_DELIMITERS), "metavar": "MARK", "help": "separator of a text: , ; | tab or space",
    },
    "--decimal": {"choices": (",", "."), "metavar": "MARK", "help": "mark of the decimals of a text: , or ."},
    "--table-line": _COUNT | {"help": "line of the column names in text files, from 1"},
    "--gaps": {"choices": ("refuse", "cut"), "help": "at gaps in the times: an error (default), or cut"},
}  # fmt: skip


@dataclass(frozen=True)
class FileResult(Generic[T]):
    """Result of a recording, or the error of its file; ``title`` is its path and content in one line."""

    entry: Entry
    title: str = ""
    value: T | None = None
    error: str = ""
    number: int = 0  # of the recording in its file

    def format_result(
        self, lines: Sequence[str] = (), facts: dict[str, Any] | None = None, *, refused: bool = False
    ) -> Printed:
        """Return the title, the lines and the facts, or the error, with the file's path."""
        file = {"file": str(self.entry.path)}  # first, and not the name that a recording states
        text = "\n".join([self.title, *(f"  {line}" for line in lines)])
        if self.error:
            failure = file | {"error": self.error} | (facts or {})
            return Printed(text, failure, name_file(self.entry.path, self.error), failed=True)
        return Printed(text, file | (facts or {}) | file, refused=refused)


def name_file(path: Path, message: str) -> str:
    """Return a message about a file that states the file's path."""
    if re.search(rf"(?<!\w){re.escape(str(path))}(?!\w)", message):
        return message
    if message.startswith(path.name):
        return f"{path}{message.removeprefix(path.name)}"
    return f"{path}: {message}"


class Arguments(argparse.Namespace):
    """What was typed for a command, and what follows from it.

    Beside the values, it holds ``typed``, those that were typed, by name; ``options``, the option of each
    argument of a function as messages name it: ``sampling_rate=``, ``angle_channel=False``; and ``targets``,
    what each option that names something to write names.
    """

    def error_text(self, error: Exception) -> str:
        """Return the message of an error on one line, with options in place of arguments of functions.

        Messages name an argument first (``speed_rpm must be positive``), then it is an option if that was
        typed, or with its sign of equality (``give speed_rpm=``, ``channel = 'x' does not exist``). An
        unexpected error gets its type and its place in the code.
        """
        message = " ".join(str(error).split())
        if isinstance(error, MemoryError):
            message = f"not enough memory: {message}"
        elif not isinstance(error, expected_errors()):
            place = traceback.extract_tb(error.__traceback__)[-1]
            return f"{type(error).__name__}: {message} ({Path(place.filename).name}, line {place.lineno})"
        first, space, rest = message.partition(" ")
        option = self.options.get(f"{first}=")
        if option in self.typed:
            message = f"{option}{space}{rest}"

        def name_option(match: re.Match[str]) -> str:
            option = self.options.get(f"{match[1]}={match[2] or ''}")
            return match[0] if option is None else option + " " * message.startswith("'", match.end())

        return re.sub(r"\b(\w+) ?=(True|False)?(?!\w)", name_option, message)

    def note_duration(self, doing: str, core_seconds: float) -> None:
        """Say beforehand about how long work of all jobs takes, if that is more than ten seconds."""
        n_jobs = getattr(self, "n_jobs", -1)
        cores = (os.cpu_count() or 1) if n_jobs < 1 else n_jobs
        if core_seconds > _LONG_S * cores:
            time = seconds_text(core_seconds / cores)
            note(f"{doing} takes about {time} on {number_of(cores, 'free core')}")

    def note_simulation(self, simulated_s: float, *, in_batches: bool = False) -> None:
        """Say beforehand about how long the simulation of so many seconds takes."""
        self.note_duration("simulating", _SIMULATION_PACE * simulated_s / (5 if in_batches else 1))

    def check_targets(self) -> None:
        """Raise the error of each file named that cannot be written, or exists without ``--force``."""
        seen: dict[Path, str] = {}
        for option, kind in self.targets.items():
            name = getattr(self, option.removeprefix("--").replace("-", "_"))
            if name is None:
                continue
            path = Path(name)
            other = seen.setdefault(path.resolve(), option)
            if other != option:
                raise ValueError(f"{other} and {option} must name different files, both are {path}")
            written = [path]
            if kind == "folder" or (kind == "recordings" and self.count is not None):
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
            for file in written:
                if file.exists() and not self.force:
                    raise FileExistsError(
                        f"{file} exists: give {option} another name, or --force to overwrite it"
                    )

    def reading_arguments(self) -> dict[str, Any]:
        """Return the arguments of ``read_recording`` that were typed."""
        names = [parsing.get("dest", option[2:].replace("-", "_")) for option, parsing in _OPTIONS.items()]
        typed = {name: getattr(self, name) for name in names}
        if typed["delimiter"] is not None:
            typed["delimiter"] = _DELIMITERS[typed["delimiter"]]
        return {argument: value for argument, value in typed.items() if value is not None}

    def process_files(
        self, doing: str, paths: Sequence[str], work: Callable[[Path, Recording], T]
    ) -> Iterator[FileResult[T]]:
        """Read file by file, and yield the result of ``work(path, recording)`` or the error of each.

        Files are those named, and those of the folders named, as their manifests state. No error of one file,
        or folder, ends the others. ``doing`` says in the line of progress what is done, such as "counting".
        """
        from cyclofeat.datasets.readers import Entry, folder_entries, one_line

        def raise_error(error: Exception, *_: object, **__: object) -> list[Recording]:
            raise error

        entries: list[Entry] = []
        for path in map(Path, paths):
            try:
                entries += folder_entries(path) if path.is_dir() else [Entry(path)]
            except Exception as error:
                entries.append(Entry(path, reader=partial(raise_error, error)))
        options = self.reading_arguments()
        with Progress(doing) as progress:
            for done, entry in enumerate(entries, 1):
                recordings: list[Recording] = []
                results: list[FileResult[T]] = []
                try:
                    recordings = entry.read(**options)
                except Exception as error:
                    results.append(FileResult(entry, error=self.error_text(error)))
                for number, recording in enumerate(recordings):
                    title = ""
                    try:
                        title = name_file(entry.path, one_line(recording))
                        results.append(FileResult(entry, title, work(entry.path, recording), number=number))
                    except Exception as error:
                        results.append(FileResult(entry, title, error=self.error_text(error)))
                progress(done, len(entries))
                yield from results

    def read_all(self, paths: Sequence[str]) -> list[Recording]:
        """Return all recordings that the paths name; the error names each bad file."""
        results = list(self.process_files("reading recordings", paths, lambda _, recording: recording))
        wrong = [name_file(result.entry.path, result.error) for result in results if result.value is None]
        if wrong:
            raise ValueError(some_of(wrong, 10, separator="; "))
        return [result.value for result in results if result.value is not None]

    def write_report(self, write: Callable[..., Path], *shown: Any, **options: Any) -> None:
        """Write the page that ``--report`` names; arguments before and behind its path are given."""
        with Progress("writing the report"):
            path = write(*shown, self.report, **options)
        note(f"report: {path}")

    def alarm_rates(self) -> dict[str, Any]:
        """Return the arguments of ``History.state`` that the options state."""
        return {name: getattr(self, name) for name in ("false_alarms_per_month", "recordings_per_month")}

    def read_model(self, packaged: str = "") -> LobeModel:
        """Return the model that the options name, or the packaged one of a quantity, stated on stderr."""
        if "pandas" not in sys.modules:
            # scikit-learn imports pandas if it can: half a second that no count needs.
            hidden = cast("dict[str, None]", sys.modules)
            hidden["pandas"] = None
            try:
                import_module("sklearn.base")
            finally:
                del hidden["pandas"]
        from cyclofeat.models import load_default_model, load_model
        from cyclofeat.models.persistence import as_lobe_model

        if self.model is not None and not packaged:
            return as_lobe_model(load_model(self.model, trusted=self.trust, allow=self.allow))
        model = load_default_model(packaged or self.quantity or QUANTITIES[0])
        card = model.card_
        note(f"model: packaged, {in_words(card['quantity'])}, trained on {card['description']}")
        return model

    def model_name(self, quantity: str) -> str:
        """Return what names the model in a result: its file, or the quantity of the packaged one."""
        return self.model or f"packaged, {in_words(quantity)}"
