"""Commands in processes of their own, which can be cancelled and can die."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from cyclofeat.serve._commands import Order
from cyclofeat.serve._store import Refused

PROGRAM = (sys.executable, "-m", "cyclofeat")
_N_MESSAGES = 200
_GRACE_S = 3.0  # for a command to end by itself when it is cancelled
_LONGEST_LINE = 2**20  # bytes
_N_KEPT = 50

State = Literal["running", "done", "failed", "cancelled", "died"]


@dataclass
class Job:
    """One run of a command.

    Attributes
    ----------
    state : str
        ``"failed"``: the command says why; ``"died"``: it could not.
    messages : deque of str
        Progress, warnings and errors, the latest last.
    result : list of dict
        Documents that the command printed.
    error : str
        Why the job failed or died.
    """

    number: int
    order: Order
    folder: Path
    state: State = "running"
    messages: deque[str] = field(default_factory=lambda: deque(maxlen=_N_MESSAGES))
    result: list[dict[str, Any]] = field(default_factory=list)
    error: str = ""

    @property
    def outputs(self) -> list[str]:
        """Names of the files that can be downloaded."""
        return [name for name in self.order.outputs if self.path(name) is not None]

    def path(self, name: str) -> Path | None:
        """Return the path of a file that the job has written, by its name."""
        path = self.folder / name
        ended = self.state in ("done", "failed")  # a page may list nothing but failures
        return path if ended and name in self.order.outputs and path.is_file() else None


class Jobs:
    """All jobs of one server.

    Parameters
    ----------
    root : pathlib.Path
        Folder for the jobs' files.
    directory : pathlib.Path
        Working directory of the commands.
    most : int
        Number of jobs that run at a time.
    program : sequence of str
        The command line's program.
    """

    def __init__(self, root: Path, directory: Path, most: int, program: Sequence[str] = PROGRAM) -> None:
        self.root, self.directory, self.most, self.program = root, directory, most, program
        self.jobs: dict[int, Job] = {}
        self._started = 0
        self._tasks: dict[int, asyncio.Task[None]] = {}

    @property
    def running(self) -> list[Job]:
        """Jobs that have not ended."""
        return [job for job in self.jobs.values() if job.state == "running"]

    def job(self, number: int) -> Job:
        """Return a job by its number."""
        if number not in self.jobs:
            raise Refused(404, f"no such job: {number}")
        return self.jobs[number]

    def start(self, make: Callable[[Path], Order]) -> Job:
        """Start the command that ``make`` returns for the folder of its files."""
        if len(self.running) >= self.most:
            raise Refused(429, f"{self.most} jobs are running: wait until one ends, or cancel one")
        folder = self.root / f"job-{self._started + 1}"
        job = Job(self._started + 1, make(folder), folder)
        folder.mkdir()
        self._started += 1
        self.jobs[job.number] = job
        self._tasks[job.number] = asyncio.get_running_loop().create_task(self._run(job))
        for old in [one for one in self.jobs.values() if one.state != "running"][:-_N_KEPT]:
            del self.jobs[old.number]
        return job

    async def cancel(self, number: int) -> None:
        """End a job; return when its process is gone."""
        job = self.job(number)
        if job.state == "running":
            task = self._tasks[number]
            task.cancel()
            await asyncio.wait([task])

    async def close(self) -> None:
        """End all jobs."""
        await asyncio.gather(*(self.cancel(job.number) for job in self.running))

    async def _run(self, job: Job) -> None:
        """Run the process of a job and keep what it prints."""
        words = [*self.program, job.order.command, "--json", *job.order.arguments]
        alone: dict[str, Any] = {"start_new_session": True}  # with its own workers, so that all can be ended
        if sys.platform == "win32":
            alone = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        # No module is imported from the folder of uploads.
        environment = os.environ | {"PYTHONSAFEPATH": "1", "PYTHONIOENCODING": "utf-8"}
        process: asyncio.subprocess.Process | None = None
        try:
            process = await asyncio.create_subprocess_exec(
                *words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                cwd=self.directory, env=environment, limit=_LONGEST_LINE, **alone,
            )  # fmt: skip
            assert process.stdout is not None
            assert process.stderr is not None
            printed, _ = await asyncio.gather(process.stdout.read(), _note(process.stderr, job))
            code = await process.wait()
        except asyncio.CancelledError:
            job.state = "cancelled"
        except (OSError, ValueError) as error:  # ValueError: a line without end
            job.state, job.error = "died", f"the command cannot be run: {error}"
        else:
            _conclude(job, code, printed)
        finally:
            if process is not None and process.returncode is None:
                await _end(process)
            del self._tasks[job.number]


async def _note(stream: asyncio.StreamReader, job: Job) -> None:
    async for line in stream:
        text = line.decode(errors="replace").strip()
        if text:
            job.messages.append(text.removeprefix("cyclofeat: ").removeprefix("cyclofeat gap: "))


async def _end(process: asyncio.subprocess.Process) -> None:
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


def _conclude(job: Job, code: int, printed: bytes) -> None:
    """State how a job ended, from its exit code and what it printed."""
    with contextlib.suppress(ValueError):
        documents = json.loads(printed)
        job.result = documents if isinstance(documents, list) else [documents]
    last = job.messages[-1] if job.messages else "it said nothing"
    errors = [str(document["error"]) for document in job.result if "error" in document]
    if code == 2 and len(errors) == len(job.result):  # also where the options were not understood
        job.state, job.error = "failed", "; ".join(errors) or last
    elif code in (0, 2):
        job.state = "done"
    elif code < 0:
        name = signal.Signals(-code).name
        job.state = "died"
        job.error = f"the command was ended by the system ({name}), perhaps because memory was short: {last}"
    else:
        job.state, job.error = "died", f"the command ended with code {code}: {last}"
