"""``cyclofeat watch``: the worn lobes of recordings as they arrive in a folder."""

from __future__ import annotations

import argparse
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cyclofeat._base.words import lobes_text, number
from cyclofeat.cli._history import HistoryWriter, add_history_options, history_writer
from cyclofeat.cli._models import (
    add_model_options,
    count_with_warnings,
    model_name,
    read_model,
    without_start,
)
from cyclofeat.cli._printing import note, warn
from cyclofeat.cli._reading import (
    UNREADABLE,
    FileResult,
    add_reading_options,
    error_text,
    placed,
    reading_arguments,
)
from cyclofeat.cli._table import Printed
from cyclofeat.cli.folder_watch import DoneList, FolderWatch

if TYPE_CHECKING:
    from cyclofeat.counting import LobeCount, LobeModel
    from cyclofeat.history import GearboxState

__all__ = ["Watched", "add_arguments", "printed", "run"]

_DAY_S = 86_400


class Watched(NamedTuple):
    """Answer for one recording, and the state of its gearbox where there is a history that could be read."""

    answer: LobeCount
    state: GearboxState | None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "folder", metavar="FOLDER", help="where recordings arrive; folders in it are left out"
    )
    add_model_options(parser)
    parser.add_argument("--once", action="store_true", help="count the files of the folder and stop")
    parser.add_argument("--done", metavar="FILE", help="list of counted files, which the next start skips")
    parser.add_argument(
        "--interval", type=float, default=1.0, help="seconds between checks of the folder (default 1)"
    )
    parser.add_argument(
        "--settle",
        type=float,
        default=1.0,
        help="seconds for which a file must not change before it is read (default 1); longer than the "
        "writer's longest pause",
    )
    parser.add_argument(
        "--strict", action=argparse.BooleanOptionalAction, default=True,
        help="exit with code 3 at the end if a recording was refused (default)",
    )  # fmt: skip
    add_history_options(parser, ", else the name of the folder")
    add_reading_options(parser)


def run(arguments: argparse.Namespace) -> Iterator[FileResult[Watched]]:
    """Count until asked to stop; with ``--once`` the files of the folder."""
    from cyclofeat.datasets.readers import MANIFEST, SOURCES

    folder = Path(arguments.folder)
    if not folder.is_dir():
        if folder.exists():
            raise NotADirectoryError(f"{folder} is a file: watch takes a folder")
        raise FileNotFoundError(f"no such folder: {folder}")
    for name in ("interval", "settle"):
        if not 0 < getattr(arguments, name) < _DAY_S:
            raise ValueError(f"--{name} must be seconds from 0 to a day, got {getattr(arguments, name):g}")
    options = reading_arguments(arguments)
    with _stop_on_signals() as stop:
        done = DoneList(None if arguments.done is None else Path(arguments.done))
        ignored = {MANIFEST} | ({Path(arguments.done).name} if arguments.done else set())
        watch = FolderWatch(folder, tuple(SOURCES), arguments.settle, done, ignored=ignored)
        model = read_model(arguments)
        if not arguments.once:
            note(f"cyclofeat: watching {folder}, stop with Ctrl-C")
        counted = failed = 0
        with history_writer(arguments, model, folder.resolve().name) as writer:
            for arrival in _arrivals(arguments, watch, model, writer, options, stop):
                counted += not arrival.error
                failed += bool(arrival.error)
                yield arrival
    if arguments.once and watch.unsettled:
        note(f"cyclofeat: {', '.join(sorted(watch.unsettled))}: still being written, left out")
    ended = "done" if arguments.once else "stopped"
    note(f"cyclofeat: {ended}: {counted} counted, {failed} could not be")


class _Stop:
    """Request to stop, set by signals; a handler must not take the lock of a threading.Event."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, *_: object) -> None:
        if self.asked:  # a second signal: do not wait for work that hangs
            raise KeyboardInterrupt
        self.asked = True

    def is_asked(self) -> bool:
        return self.asked

    def wait(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while not self.asked and (rest := end - time.monotonic()) > 0:
            time.sleep(min(rest, 0.1))


def _arrivals(
    arguments: argparse.Namespace,
    watch: FolderWatch,
    model: LobeModel,
    writer: HistoryWriter | None,
    options: dict[str, Any],
    stop: _Stop,
) -> Iterator[FileResult[Watched]]:
    """Look, count, wait."""
    from cyclofeat.datasets import read_recording

    began = now = time.monotonic()
    lost, unwritten, unsaved = (
        _Trouble("folder cannot be read"),
        _Trouble(f"--done {arguments.done} cannot be written"),
        _Trouble(f"--history {arguments.history} cannot be written"),
    )
    while not stop.is_asked():
        ready: list[Path] = []
        with lost:
            ready = watch.poll(now)
        for path in ready:
            if stop.is_asked():
                break
            name = ""
            try:
                recording = without_start(read_recording(path, **options), arguments.skip)
                count = count_with_warnings(model, recording)
                if writer is not None:
                    name = writer.add(path, recording, count)
            except FileNotFoundError:
                continue  # removed since
            except Exception as error:  # one bad file must not end the watch, whatever is wrong with it
                name = "" if isinstance(error, UNREADABLE) else f"{type(error).__name__}: "
                watch.failed(path, placed(path, name + error_text(error)))
                continue
            state = None
            with unsaved:
                if writer is not None:
                    writer.history.write()
                    state = writer.state(name)
            yield FileResult(path, value=Watched(count, state))
            watch.counted(path)
            _write_done(watch, writer, unwritten)
        with unsaved:
            if writer is not None:
                writer.history.write()
        _write_done(watch, writer, unwritten)
        # A file that cannot be read may only be half written, by a writer that pauses: reported later, once.
        last = arguments.once and now - began >= arguments.settle
        for path, message in watch.bad(now, at_once=last):
            yield FileResult(path, error=message)
        if last:
            break
        stop.wait(min(arguments.interval, arguments.settle) if arguments.once else arguments.interval)
        now = time.monotonic()


def _write_done(watch: FolderWatch, writer: HistoryWriter | None, unwritten: _Trouble) -> None:
    """Write the list of files that are done, unless counts of them are not in the history yet."""
    with unwritten:
        if writer is None or not writer.history.pending:
            watch.done.write()


class _Trouble:
    """Context that reports an OSError once, until it succeeds again: a full disk, a share that is gone."""

    def __init__(self, problem: str) -> None:
        self.problem = problem
        self.reported = False

    def __enter__(self) -> None:
        """Do nothing."""

    def __exit__(self, kind: object, error: BaseException | None, _: object) -> bool:
        if isinstance(error, OSError):
            if not self.reported:
                warn(f"{self.problem}, retrying: {error_text(error)}")
            self.reported = True
            return True
        self.reported = self.reported and error is not None
        return False


@contextmanager
def _stop_on_signals() -> Iterator[_Stop]:
    """Ctrl-C and SIGTERM ask to stop: the file in hand is finished first."""
    stop = _Stop()
    before: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():  # Python allows handlers nowhere else
        for name in (signal.SIGINT, signal.SIGTERM):
            before[name] = signal.signal(name, stop)
    try:
        yield stop
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)


def printed(arguments: argparse.Namespace, result: FileResult[Watched]) -> Printed:
    time_text = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    facts: dict[str, Any] = {"time": time_text, "file": str(result.path)}
    if result.value is None:
        return Printed("", facts | {"error": result.error}, result.error, failed=arguments.once)
    count, state = result.value
    probability = count.probability[count.defect_count]
    line = f"{number(count.defect_count, 'worn lobe')} (probability {probability:.2f})"
    if count.refused:
        line = f"refused: {count.reason}; would be {line}"
    elif count.lobes:
        line += f" at {lobes_text(count.lobes)}{'' if count.absolute else ' (relative)'}"
    line += f", {number(count.n_windows, 'window')}"
    line += "".join(f"; note: {warning}" for warning in count.warnings)
    facts |= {**count.to_dict(), "model": model_name(arguments)}
    if state is not None:
        line += f"; {state.gearbox}: {state}"
        facts |= {"gearbox": state.gearbox, "alarm": state.alarm, "history": state.to_dict()}
    return Printed(
        f"{time_text} {result.path.name}: {line}",
        facts,
        refused=count.refused and arguments.strict,
    )
