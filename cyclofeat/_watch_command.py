"""``cyclofeat watch``: count recordings as they arrive in a folder."""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclofeat._reading import add_reading_options, in_options, reading_arguments

if TYPE_CHECKING:
    from cyclofeat.counting import LobeModel
    from cyclofeat.counting._watch import DoneList, FolderWatch
    from cyclofeat.recording import Recording

TEXT = "count recordings as they arrive in a folder"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``watch``."""
    parser.add_argument(
        "folder", metavar="FOLDER", help="where recordings arrive; folders in it are left out"
    )
    add_model_options(parser)
    parser.add_argument("--once", action="store_true", help="count what is there and stop")
    parser.add_argument("--done", metavar="FILE", help="remember there what was counted, for the next start")
    parser.add_argument("--interval", type=float, default=1.0, help="seconds between looks (default 1)")
    parser.add_argument(
        "--settle",
        type=float,
        default=1.0,
        help="seconds for which a file must not change before it is read (default 1); longer than the "
        "writer's longest pause",
    )
    add_reading_options(parser)


def add_model_options(parser: argparse.ArgumentParser) -> None:
    """Add what ``count`` and ``watch`` need of a model and of each recording."""
    parser.add_argument("--model", required=True, help="model file that train wrote, its card beside it")
    parser.add_argument(
        "--trust",
        "--trust-model",
        dest="trust",
        action="store_true",
        help="a joblib model is code: say that you trust it (.skops needs no trust)",
    )
    parser.add_argument(
        "--allow",
        action="append",
        default=[],
        metavar="NAME",
        help="what may differ from when the model was written: scikit-learn, numpy, features, ...",
    )
    parser.add_argument("--skip", type=float, default=0.0, help="seconds to leave out at the start (run-up)")


def read_model(arguments: argparse.Namespace) -> LobeModel:
    """The model that the options name."""
    from cyclofeat.persistence import as_lobe_model, load_model, read_card

    loaded = load_model(arguments.model, trusted=arguments.trust, allow=arguments.allow)
    return as_lobe_model(loaded, read_card(arguments.model))


def without_start(recording: Recording, seconds: float) -> Recording:
    """A recording without its run-up."""
    first = round(seconds * recording.sampling_rate) if math.isfinite(seconds) else -1
    if first == 0:
        return recording
    if not 0 < first < recording.n_samples - 1:
        raise ValueError(f"--skip must lie within the {recording.duration:g} s recorded, got {seconds:g} s")
    angle = None if recording.angle is None else recording.angle[first:]
    return recording.replace(torque=recording.torque[first:], angle=angle)


def run(arguments: argparse.Namespace) -> int:
    """Count until told to stop; 0, or with ``--once`` 2 where a file could not be counted."""
    from cyclofeat.counting._watch import DoneList, FolderWatch
    from cyclofeat.datasets.readers import SOURCES
    from cyclofeat.datasets.readers._folder import MANIFEST

    folder = Path(arguments.folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"no such folder: {folder}")
    for name in ("interval", "settle"):
        if not 0 < getattr(arguments, name) < 86_400:
            raise ValueError(f"--{name} must be seconds from 0 to a day, got {getattr(arguments, name):g}")
    options = reading_arguments(arguments)
    with _stop_on_signals() as stop:
        done = DoneList(None if arguments.done is None else Path(arguments.done))
        left_out = {MANIFEST} | ({Path(arguments.done).name} if arguments.done else set())
        watch = FolderWatch(folder, tuple(SOURCES), arguments.settle, done, left_out=left_out)
        model = read_model(arguments)
        if not arguments.once:
            _say(f"watching {folder}, stop with Ctrl-C")
        counted, failed = _loop(arguments, watch, model, options, stop)
    if arguments.once and watch.unsettled:
        _say(f"{', '.join(sorted(watch.unsettled))}: still being written, left out")
    _say(f"{'done' if arguments.once else 'stopped'}: {counted} counted, {failed} could not be")
    return 2 if arguments.once and failed else 0


class _Stop:
    """Set by signals. No threading.Event: its lock would bite a handler that interrupts its own wait."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, *_: object) -> None:
        if self.asked:  # a second time: whatever hangs is left hanging
            raise KeyboardInterrupt
        self.asked = True

    def is_asked(self) -> bool:
        return self.asked

    def wait(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while not self.asked and (left := end - time.monotonic()) > 0:
            time.sleep(min(left, 0.1))


def _loop(
    arguments: argparse.Namespace, watch: FolderWatch, model: LobeModel, options: dict[str, Any], stop: _Stop
) -> tuple[int, int]:
    """Look, count, wait; how many were counted and how many could not be."""
    counted = failed = 0
    began = time.monotonic()
    now = began
    lost = unwritten = False
    while not stop.is_asked():
        try:
            ready = watch.poll(now)
            lost = False
        except OSError as error:  # a share that is gone for a while
            if not lost:
                _say(f"error: folder cannot be read, trying on: {' '.join(str(error).split())}")
            lost, ready = True, []
        for path in ready:
            if stop.is_asked():  # by now, that is: signals come between any two lines
                break
            try:
                result = _counted(path, model, options, arguments.skip)
            except FileNotFoundError:
                continue  # taken away again
            except Exception as error:  # one bad file must not end the watch, whatever is wrong with it
                watch.failed(path, _reason(path, error))
                continue
            counted += 1
            _emit(path, result, arguments.json)
            watch.counted(path)
            unwritten = _written(watch.done, unwritten)
        if unwritten:
            unwritten = _written(watch.done, unwritten)
        # A file that cannot be read may only be half written, by a writer that pauses: told later, and once.
        last = arguments.once and now - began >= arguments.settle
        for path, message in watch.bad(now, at_once=last):
            failed += 1
            _emit_error(path, message, arguments.json)
        if last:
            break
        stop.wait(min(arguments.interval, arguments.settle) if arguments.once else arguments.interval)
        now = time.monotonic()
    return counted, failed


def _written(done: DoneList, before: bool) -> bool:
    """Write the list of what is done; whether it could not be, which is told once."""
    try:
        done.write()
    except OSError as error:  # a disk that is full, or a share that is gone for a while
        if not before:
            _say(f"error: --done cannot be written, trying on: {' '.join(str(error).split())}")
        return True
    return False


def _counted(path: Path, model: LobeModel, options: dict[str, Any], skip: float) -> dict[str, Any]:
    from cyclofeat.datasets import read_recording

    return model.count(without_start(read_recording(path, **options), skip)).to_dict()


def _reason(path: Path, error: Exception) -> str:
    known = isinstance(error, (ValueError, TypeError, OSError, ImportError))
    text = " ".join(str(error).split()) if known else f"{type(error).__name__}: {error}"
    message = in_options(text)
    return message if message.startswith((str(path), path.name)) else f"{path.name}: {message}"


def _emit(path: Path, result: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(json.dumps({"time": _now(), "file": str(path), **result}), flush=True)
        return
    count = result["defect_count"]
    text = (
        f"{count} worn lobe{'' if count == 1 else 's'} (probability {result['probability'][str(count)]:.2f})"
    )
    if result["lobes"]:
        # People count from 1.
        relative = "" if result["lobes_absolute"] else " (relative)"
        text += f" at {', '.join(str(lobe + 1) for lobe in result['lobes'])}{relative}"
    if result["refused"]:
        text += f", refused: {result['reason']}"
    n_windows = result["n_windows"]
    text += f", {n_windows} window{'' if n_windows == 1 else 's'}"
    text += "".join(f"; note: {warning}" for warning in result["warnings"])
    print(f"{_now()} {path.name}: {text}", flush=True)


def _emit_error(path: Path, message: str, as_json: bool) -> None:
    if as_json:
        print(json.dumps({"time": _now(), "file": str(path), "error": message}), flush=True)
    _say(f"error: {message}")


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _say(message: str) -> None:
    print(f"cyclofeat: {message}", file=sys.stderr, flush=True)


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
