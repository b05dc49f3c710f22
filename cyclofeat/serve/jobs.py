"""What the page asks: the command line of each request, its process, and the state of one server."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from cyclofeat._base.quantities import number_of
from cyclofeat.datasets.readers import MANIFEST, folder_entries
from cyclofeat.serve.store import STATED, Limits, Refused, Store, filled_texts

# Options of commands, as the page names them.
_READING = (
    "channel", "quantity", "speed", "scale", "sampling_rate", "time_channel", "time_unit", "angle_channel",
    "angle_unit", "pulses_per_turn", "counts_per_turn", "n_lobes", "delimiter", "decimal", "table_line",
    "no_angle", "angle_absolute",
)  # fmt: skip
_SWITCHES = ("no_angle", "angle_absolute")
# Title of each command but ``simulate``, the files that it writes by their options, and options of its own.
_COMMANDS: dict[str, tuple[str, dict[str, str], tuple[str, ...]]] = {
    "inspect": ("Inspection", {}, ()),
    "count": ("Count", {"--report": "count.html"}, ("skip",)),
    "gap": ("Gap", {"--out": "gap.html", "--save-simulator": "corrected.json"}, ("hold_out", "simulated")),
}


def make_job(asked: Mapping[str, Any], store: Store, model: Sequence[str], number: int) -> Job:
    """Return the job for a request of the page, or raise Refused if the page may not ask this.

    The page asks for ``command``, ``recordings`` (names) and ``options`` (name to text). ``model`` holds the
    options that name the model, none for the packaged ones.
    """
    folder = store.root / f"job-{number}"
    command = asked.get("command")
    if command == "simulate":
        name = store.claim_name("example.csv")
        worn = ["--worn-count", "3", "--rig", "r2", "--duration", "9"]
        arguments = [*worn, "--out", name, "--force"]
        title = "Simulation of an example with 3 worn lobes"
        return Job(number, folder, "simulate", title, arguments, (name,))
    if not isinstance(command, str) or command not in _COMMANDS:
        raise Refused(400, f"command must be one of simulate, inspect, count, gap, got {command!r}")
    title, targets, more = _COMMANDS[command]
    stated = asked.get("options") or {}
    if not isinstance(stated, dict):
        raise Refused(400, f"options must be names with values, got {stated!r}")
    options, more_words = filled_texts(stated), list[str]()
    if command == "gap":
        more_words = [f"--{kind}={path}" for kind, path in store.others.items() if kind != "model"]
        simulated, held_out = options.get("simulated"), options.get("hold_out", "")
        # Both can be paths, of which only uploaded ones are read.
        if held_out and not re.fullmatch(r"speed|load|0?[.]\d+", held_out):
            _recording_names([held_out], store)
        if simulated is not None:
            _recording_names([simulated], store)
            more_words, targets = [], {"--out": targets["--out"]}
    names = _recording_names(asked.get("recordings"), store)
    unknown = options.keys() - {*_READING, *more}
    if unknown:
        raise Refused(400, f"unknown option {min(unknown)!r}; known are {', '.join((*_READING, *more))}")
    rows = _manifest_rows(names, options, store)
    if rows and "simulated" in options:
        options["simulated"] = str(store.recordings / options["simulated"])
    # A value never becomes an option of its own.
    words = [
        f"--{name.replace('_', '-')}" + ("" if name in _SWITCHES else f"={value}")
        for name, value in options.items()
    ]
    words += more_words
    words += [word for option, name in targets.items() for word in (option, str(folder / name))]
    title += f" of {names[0] if len(names) == 1 else number_of(len(names), 'recording')}"
    read = [".", *(name for name in names if store.items[name])] if rows else names
    arguments = [*(model if command == "count" else ()), *words, *read]
    return Job(number, folder, command, title, arguments, names, tuple(targets.values()), rows)


def _manifest_rows(names: Sequence[str], options: dict[str, str], store: Store) -> dict[str, dict[str, str]]:
    """Return what is true of each file where the page states something of one; ``options`` lose it."""
    if not any(store.stated.get(name) for name in names):
        return {}
    folders = [name for name in names if store.items[name]]
    if folders and any(name in options for name in STATED):
        raise Refused(
            400, "beside a folder, channel, quantity and speed can be stated of all recordings or of single "
            f"files, not of both: remove {folders[0]}, or state them in its {MANIFEST}",
        )  # fmt: skip
    general = {name: options.pop(name) for name in STATED if name in options}
    rows = {name: general | store.stated.get(name, {}) for name in names if not store.items[name]}
    for name, row in rows.items():  # here, as a message of the command would name a line of the manifest
        speed = row.get("speed", "1")
        if not re.fullmatch(r"\d*\.?\d+(e\d+)?", speed) or not float(speed):
            raise Refused(400, f"the speed of {name} must be a positive number of RPM, got {speed!r}")
    return rows


def _recording_names(asked: Any, store: Store) -> tuple[str, ...]:
    """Return the names of stored recordings; those of folders name nothing outside."""
    if not isinstance(asked, list) or not asked:
        raise Refused(400, "choose at least one recording")
    for name in asked:
        if not isinstance(name, str) or name not in store.items:
            raise Refused(404, f"no such recording: {name!r}")
        if store.items[name]:
            folder = store.recordings / name
            with contextlib.suppress(ValueError, OSError):  # of which the command speaks better
                for entry in folder_entries(folder):
                    if not entry.path.resolve().is_relative_to(folder.resolve()):
                        raise Refused(
                            400,
                            f"{folder.name}/{MANIFEST} names a file outside the folder: {entry.path.name}",
                        )
    return tuple(dict.fromkeys(asked))


PROGRAM = (sys.executable, "-m", "cyclofeat")
_N_MESSAGES = 200
_LINKS = "recordings"  # folder of a job that has a manifest of its own
_GRACE_S = 3.0  # for a command to end by itself when it is cancelled
_LONGEST_LINE = 2**20  # bytes
_N_KEPT = 50

State = Literal["running", "done", "failed", "cancelled", "ended unexpectedly"]


@dataclass
class Job:
    """One run of a command: its messages so far, the documents that it printed, and why it failed or died.

    The command reads ``recordings``, or links to them beside a manifest of ``rows``, and writes ``targets``
    into its folder. One that has failed says why; one that died could not.
    """

    number: int
    folder: Path
    command: str
    title: str  # on the page
    arguments: list[str]
    recordings: tuple[str, ...] = ()
    targets: tuple[str, ...] = ()
    rows: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    state: State = "running"
    messages: deque[str] = field(default_factory=lambda: deque(maxlen=_N_MESSAGES))
    result: list[dict[str, Any]] = field(default_factory=list)
    error: str = ""
    began: float = field(default_factory=time.monotonic)
    task: asyncio.Task[None] | None = None

    @property
    def message(self) -> str:
        """The last message of the command."""
        return self.messages[-1] if self.messages else "starting"

    @property
    def outputs(self) -> list[str]:
        """Names of the files that can be downloaded."""
        return [name for name in self.targets if self.output_path(name) is not None]

    async def read_messages(self, stream: asyncio.StreamReader) -> None:
        """Keep what the command says while it works."""
        async for line in stream:
            if text := line.decode(errors="replace").strip():
                self.messages.append(text.removeprefix("cyclofeat: "))

    def conclude(self, code: int, printed: bytes) -> None:
        """State how the job ended, from the command's exit code and what it printed."""
        with contextlib.suppress(ValueError):
            documents = json.loads(printed)
            self.result = documents if isinstance(documents, list) else [documents]
        errors = [str(document["error"]) for document in self.result if "error" in document]
        if code == 2 and len(errors) == len(self.result):  # also where the options were not understood
            self.state, self.error = "failed", "; ".join(errors) or self.message
        elif code in (0, 2):
            self.state = "done"
        else:
            how = f"ended with code {code}"
            if code < 0:
                name = signal.Signals(-code).name
                how = f"was ended by the system ({name}), perhaps because memory was short"
            self.state, self.error = "ended unexpectedly", f"the command {how}: {self.message}"

    def output_path(self, name: str) -> Path | None:
        """Return the path of a file that the job has written, by its name."""
        path = self.folder / name
        ended = self.state in ("done", "failed")  # a page may list nothing but failures
        return path if ended and name in self.targets and path.is_file() else None


class Session:
    """Recordings, model and jobs of one server, whose files lie in the private folder ``root``.

    ``given`` are the options that name the model on the command line, ``program`` is the command line itself.
    """

    def __init__(
        self, root: Path, limits: Limits, given: Sequence[str] = (), program: Sequence[str] = PROGRAM
    ) -> None:
        self.store, self.given, self.program = Store(root, limits), given, program
        self.jobs: dict[int, Job] = {}
        self._numbers = itertools.count(1)

    def clear_jobs(self) -> None:
        """Forget the results of jobs that have ended, but for what was found in recordings."""
        for number, job in [*self.jobs.items()]:
            if job.state != "running" and job.command != "inspect":
                del self.jobs[number]

    @property
    def running_jobs(self) -> list[Job]:
        """Jobs that have not ended."""
        return [job for job in self.jobs.values() if job.state == "running"]

    def find_job(self, number: int) -> Job:
        """Return a job by its number."""
        if number not in self.jobs:
            raise Refused(404, f"no such job: {number}")
        return self.jobs[number]

    def start_job(self, asked: Mapping[str, Any]) -> Job:
        """Start the command that the page asks for."""
        most = self.store.limits.jobs
        if len(self.running_jobs) >= most:
            raise Refused(429, f"{most} jobs are running: wait until one ends, or cancel one")
        number = next(self._numbers)
        uploaded = self.store.others.get("model")
        model = self.given if uploaded is None else ("--model", str(uploaded))
        job = make_job(asked, self.store, model, number)
        job.folder.mkdir()
        if job.rows:
            self.store.link_recordings(job.recordings, job.folder / _LINKS, job.rows)
        self.jobs[number] = job
        job.task = asyncio.create_task(self._run_job(job))
        for old in [ended for ended in self.jobs.values() if ended.state != "running"][:-_N_KEPT]:
            del self.jobs[old.number]
        return job

    async def cancel_job(self, number: int) -> None:
        """End a job; return when its process is gone."""
        job = self.find_job(number)
        if job.state == "running" and job.task is not None:
            job.task.cancel()
            await asyncio.wait([job.task])

    async def close(self) -> None:
        """End all jobs."""
        await asyncio.gather(*(self.cancel_job(job.number) for job in self.running_jobs))

    async def _run_job(self, job: Job) -> None:
        """Run the process of a job and keep what it prints."""
        words = [*self.program, job.command, "--json", *job.arguments]
        alone: dict[str, Any] = {"start_new_session": True}  # with its own workers, so that all can be ended
        if sys.platform == "win32":
            alone = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        # No module is imported from the folder of uploads.
        environment = os.environ | {"PYTHONSAFEPATH": "1", "PYTHONIOENCODING": "utf-8"}
        process: asyncio.subprocess.Process | None = None
        place = job.folder / _LINKS if job.rows else self.store.recordings
        try:
            process = await asyncio.create_subprocess_exec(
                *words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                cwd=place, env=environment, limit=_LONGEST_LINE, **alone,
            )  # fmt: skip
            assert process.stdout is not None
            assert process.stderr is not None
            printed, _ = await asyncio.gather(process.stdout.read(), job.read_messages(process.stderr))
            code = await process.wait()
        except asyncio.CancelledError:
            job.state = "cancelled"
        except (OSError, ValueError) as error:  # ValueError: a line without end
            job.state, job.error = "ended unexpectedly", f"the command cannot be run: {error}"
        else:
            job.conclude(code, printed)
        finally:
            if process is not None and process.returncode is None:
                await _end_process(process)


async def _end_process(process: asyncio.subprocess.Process) -> None:
    """Interrupt a command as Ctrl-C does, and kill it and its workers where that does not suffice."""
    if sys.platform == "win32":
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        return
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGINT)
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(process.wait(), _GRACE_S)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    await process.wait()
