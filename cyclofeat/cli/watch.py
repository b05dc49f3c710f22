"""``cyclofeat watch``: the worn lobes of recordings as they arrive in a folder."""

from __future__ import annotations

import argparse
import itertools
import json
import os
import signal
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from cyclofeat._base.files import check_parent
from cyclofeat.cli._options import Arguments, Parser, Printed, name_file, note, positive, warn
from cyclofeat.cli.count import Counted, RecordingCounter

# A file that cannot be read is bad, and not only half written, after this many times the time to settle.
_PATIENCE = 5
_BEGINNING = b'{"file": '  # of the list of files that are done

# Size, time of change in ns, inode: another file renamed into its place has another inode.
Signature = tuple[int, int, int]


@dataclass
class _Seen:
    """State of a file, the time of its last change, and what became of it."""

    signature: Signature
    since: float
    tried: bool = False
    message: str | None = None
    reported: bool = False


@dataclass
class FolderWatch:
    """Report every file once it no longer changes, and again if it changes afterwards.

    Recordings end in one of ``suffixes`` (lower case, with the dot), unless their name is ``ignored``. Size
    and time of change must stay the same for ``settle_s``; files that are ``done`` are not reported.
    """

    folder: Path
    suffixes: tuple[str, ...]
    settle_s: float
    done: DoneList
    ignored: Collection[str] = ()
    _seen: dict[str, _Seen] = field(default_factory=dict, init=False)

    @property
    def unsettled_names(self) -> set[str]:
        """Names of files that are still changing."""
        return {name for name, file in self._seen.items() if not file.tried}

    def poll(self, now: float) -> list[Path]:
        """Return files to count, sorted by name; ``now`` in s of a clock that never goes back."""
        present: dict[str, Signature] = {}
        with os.scandir(self.folder) as entries:
            for entry in entries:
                hidden = entry.name.startswith(".") or entry.name in self.ignored
                if hidden or not entry.name.lower().endswith(self.suffixes):
                    continue
                with suppress(OSError):  # gone, or a link to nothing
                    if entry.is_file():
                        state = os.stat(entry.path)
                        present[entry.name] = (state.st_size, state.st_mtime_ns, state.st_ino)
        before, self._seen, ready = self._seen, {}, []
        for name, signature in sorted(present.items()):
            seen = before.get(name) or _Seen(signature, now)
            if seen.signature != signature:
                seen = _Seen(signature, now, reported=seen.reported)
            self._seen[name] = seen
            seen.tried = seen.tried or self.done.holds(name, signature)
            if not seen.tried and now - seen.since >= self.settle_s:
                seen.tried = True
                ready.append(self.folder / name)
        return ready

    def mark_counted(self, path: Path) -> None:
        seen = self._seen[path.name]
        seen.message, seen.reported = None, False
        self.done.add(path.name, seen.signature)

    def mark_failed(self, path: Path, message: str) -> None:
        """Remember why a file could not be counted; :meth:`bad_files` reports it later."""
        self._seen[path.name].message = message

    def bad_files(self, now: float, *, at_once: bool = False) -> list[tuple[Path, str]]:
        """Return files that could not be counted and have not changed for long, each once, and the reason."""
        files = []
        for name, seen in self._seen.items():
            waited = at_once or now - seen.since >= _PATIENCE * self.settle_s
            if seen.message is None or not waited:
                continue
            if not seen.reported:
                files.append((self.folder / name, seen.message))
            # Not done: the next start may read it, with other options.
            seen.message, seen.reported = None, True
        return files


class DoneList:
    """Files that need not be counted again: in memory, and at ``path`` (if any) for the next start.

    Each line of that file is one JSON object. A line that was cut, by a full disk or where the process was
    killed, is none: each entry begins a line of its own.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._done: dict[str, tuple[int, int]] = {}
        self._path = path
        self._unwritten: list[bytes] = []
        if path is None:
            return
        check_parent(path, "--done")
        with path.open("a+b") as file:  # or an error now rather than after the first count
            file.seek(0)
            lines = file.read().split(b"\n")
        if not all(line.startswith(_BEGINNING[: len(line)]) for line in lines):
            raise ValueError(f"{path} is not a list that watch wrote: name a new file for --done")
        for line in lines:
            with suppress(ValueError, TypeError, KeyError, RecursionError):  # cut
                entry = json.loads(line)
                self._done[entry["file"]] = (int(entry["size"]), int(entry["mtime_ns"]))

    def holds(self, name: str, signature: Signature) -> bool:
        """Return True if this file in this state is done; a restored copy with another inode is the same."""
        return self._done.get(name) == signature[:2]

    def add(self, name: str, signature: Signature) -> None:
        """Add a file in this state, for the next :meth:`write`."""
        self._done[name] = signature[:2]
        entry = {"file": name, "size": signature[0], "mtime_ns": signature[1]}
        self._unwritten.append(b"\n" + json.dumps(entry).encode())

    def write(self) -> None:
        """Write the files added since the last call; after an OSError the next call tries again."""
        if self._path is not None and self._unwritten:
            with self._path.open("ab") as file:
                file.write(b"".join(self._unwritten))
            self._unwritten.clear()


def add_arguments(parser: Parser) -> None:
    parser.add_argument(
        "folder", metavar="FOLDER", help="where recordings arrive; folders in it are left out"
    )
    parser.add_model_options()
    parser.add_argument("--once", action="store_true", help="count the files of the folder and stop")
    parser.add_argument("--done", metavar="FILE", help="list of counted files, which the next start skips")
    parser.add_argument(
        "--interval", type=positive, default=1.0, help="seconds between checks of the folder (default 1)"
    )
    parser.add_argument(
        "--settle", type=positive, default=1.0,
        help="seconds for which a file must not change before it is read (default 1); longer than the "
        "writer's longest pause",
    )  # fmt: skip
    parser.add_argument(
        "--strict", action=argparse.BooleanOptionalAction, default=True,
        help="exit with code 3 at the end if a recording was refused (default)",
    )  # fmt: skip
    parser.add_history_options(", else the name of the folder")
    parser.add_reading_options()


def run(arguments: Arguments) -> Iterator[Printed]:
    """Count until asked to stop; with ``--once`` the files of the folder."""
    from cyclofeat.datasets.readers import MANIFEST, RECORDINGS

    folder = Path(arguments.folder)
    if not folder.is_dir():
        if folder.exists():
            raise NotADirectoryError(f"{folder} is a file: watch takes a folder")
        raise FileNotFoundError(f"no such folder: {folder}")
    with _stop_on_request() as stops:
        done = DoneList(None if arguments.done is None else Path(arguments.done))
        ignored = {MANIFEST} | ({Path(arguments.done).name} if arguments.done else set())
        watch = FolderWatch(folder, RECORDINGS, arguments.settle, done, ignored=ignored)
        if not arguments.once:
            note(f"cyclofeat: watching {folder}, stop with Ctrl-C")
        counted = failed = 0
        with RecordingCounter(arguments, folder.resolve().name) as counter:
            for arrival in _count_arrivals(arguments, watch, counter, stops):
                counted += not arrival.error
                failed += bool(arrival.error)
                yield arrival
    if arguments.once and watch.unsettled_names:
        note(f"cyclofeat: {', '.join(sorted(watch.unsettled_names))}: still being written, left out")
    ended = "done" if arguments.once else "stopped"
    note(f"cyclofeat: {ended}: {counted} counted, {failed} could not be")


@contextmanager
def _stop_on_request() -> Iterator[Callable[[], bool]]:
    """Yield a function that tells whether Ctrl-C or SIGTERM asks to stop, once the file in hand is finished.

    A signal's handler must not take the lock of a threading.Event.
    """
    asked: list[int] = []

    def ask(number: int, _: object) -> None:
        if asked:  # a second signal: do not wait for work that hangs
            raise KeyboardInterrupt
        asked.append(number)

    main = threading.current_thread() is threading.main_thread()  # Python allows handlers nowhere else
    before = {name: signal.signal(name, ask) for name in (signal.SIGINT, signal.SIGTERM) if main}
    try:
        yield lambda: bool(asked)
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)


def _count_arrivals(
    arguments: Arguments, watch: FolderWatch, counter: RecordingCounter, stops: Callable[[], bool]
) -> Iterator[Printed]:
    """Look, count, wait."""
    from cyclofeat.datasets import read_recording

    options = arguments.reading_arguments()
    troubles: set[str] = set()

    def write_files(counted: Counted | None = None) -> None:
        """Write the history and, once it holds their counts, the list of files that are done."""
        with _retrying(f"--history {arguments.history} cannot be written", troubles):
            counter.write(counted)
            with _retrying(f"--done {arguments.done} cannot be written", troubles):
                watch.done.write()

    began = now = time.monotonic()
    while not stops():
        ready: list[Path] = []
        with _retrying("folder cannot be read", troubles):
            ready = watch.poll(now)
        for path in itertools.takewhile(lambda _: not stops(), ready):
            try:
                counted = counter.count(path, read_recording(path, **options))
            except FileNotFoundError:
                continue  # removed since
            except Exception as error:  # one bad file must not end the watch, whatever is wrong with it
                watch.mark_failed(path, name_file(path, arguments.error_text(error)))
                continue
            write_files(counted)
            facts = {"time": _time_text(), "file": str(path), **counted.facts}
            text = f"{facts['time']} {path.name}: {'; '.join(counted.lines)}"
            yield Printed(text, facts, refused=counted.count.refused and arguments.strict)
            watch.mark_counted(path)
            write_files()
        write_files()
        # A file that cannot be read may only be half written, by a writer that pauses: reported later, once.
        last = arguments.once and now - began >= arguments.settle
        for path, message in watch.bad_files(now, at_once=last):
            facts = {"time": _time_text(), "file": str(path), "error": message}
            yield Printed("", facts, message, failed=arguments.once)
        if last:
            break
        pause = min(arguments.interval, arguments.settle) if arguments.once else arguments.interval
        while not stops() and (rest := now + pause - time.monotonic()) > 0:
            time.sleep(min(rest, 0.1))
        now = time.monotonic()


@contextmanager
def _retrying(problem: str, reported: set[str]) -> Iterator[None]:
    """Report an OSError once, until it succeeds again: a full disk, a share that is gone."""
    try:
        yield
        reported.discard(problem)
    except OSError as error:
        if problem not in reported:
            warn(f"{problem}, retrying: {error}")
        reported.add(problem)


def _time_text() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
