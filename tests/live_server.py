"""A server in a thread of the tests, requests to it, and commands that stand in for the real ones."""

from __future__ import annotations

import http.client
import json
import sys
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any
from urllib.parse import quote

import uvicorn

from cyclofeat.serve import make_app
from cyclofeat.serve.app import Address

# Prints what it was asked, and misbehaves as the channel says.
_COMMAND = """
import json, os, signal, sys, time
words = sys.argv[1:]
manner = next((word.partition("=")[2] for word in words if word.startswith("--channel=")), "")
if manner == "deaf":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
print(f"cyclofeat: process {os.getpid()}", file=sys.stderr, flush=True)
if manner in ("wait", "deaf"):
    time.sleep(120)
if manner == "killed":
    os.kill(os.getpid(), signal.SIGKILL)
if manner == "crash":
    raise RuntimeError("a defect")
if manner == "long":
    sys.stderr.write("x" * 2**21)
if manner == "usage":
    print("cyclofeat count: error: bad --speed", file=sys.stderr)
    sys.exit(2)
for option in ("--report", "--out", "--save-simulator"):
    if option in words:
        open(words[words.index(option) + 1], "w").write('"written"')
if os.path.exists("printed.json"):
    print(open("printed.json").read())
elif manner == "fail":
    print(json.dumps([{"file": "a.csv", "error": "a.csv is empty"}]))
    sys.exit(2)
else:
    gap = {"text": ["nothing"]}
    print(json.dumps([{"file": "a.csv", "error": "stands in", "words": words} | gap]))
"""
PROGRAM = (sys.executable, "-c", _COMMAND)


class Live:
    """A served application, stopped at the end of the ``with`` block."""

    def __init__(self, **options: Any) -> None:
        self.address = Address.of_port(0)
        self.app = make_app(self.address.key, **({"program": PROGRAM} | options))
        self.server = uvicorn.Server(uvicorn.Config(self.app, log_level="error", lifespan="on"))
        self._thread = threading.Thread(target=self.server.run, kwargs={"sockets": [self.address.listener]})

    def __enter__(self) -> Live:
        self._thread.start()
        wait_for(lambda: self.server.started)
        return self

    def __exit__(self, *_: object) -> None:
        self.server.should_exit = True
        self._thread.join(20)
        assert not self._thread.is_alive()

    @property
    def session(self) -> Any:
        """What the server holds."""
        return self.app.state.session

    def ask(
        self,
        method: str,
        path: str,
        body: bytes | Iterable[bytes] | dict[str, Any] | None = None,
        *,
        key: str | None = None,
        **headers: str,
    ) -> tuple[int, Any, dict[str, str]]:
        """Status, JSON or text, and headers of an answer."""
        host, port = self.address.listener.getsockname()
        connection = http.client.HTTPConnection(host, port, timeout=20)
        content = json.dumps(body).encode() if isinstance(body, dict) else body
        connection.request(method, f"/{self.address.key if key is None else key}/{path}", content, headers)
        answer = connection.getresponse()
        text = answer.read().decode()
        connection.close()
        told = {name.lower(): value for name, value in answer.getheaders()}
        return answer.status, json.loads(text) if "json" in told.get("content-type", "") else text, told

    def add(self, name: str, content: bytes = b"torque\n1\n2\n", folder: str = "") -> tuple[int, Any]:
        """Status and answer of an upload."""
        inside = f"&folder={quote(folder)}" if folder else ""
        return self.ask("POST", f"files?name={quote(name)}{inside}", content)[:2]

    def start(self, command: str, *recordings: str, **options: str) -> tuple[int, Any]:
        """Status and answer of the start of a job."""
        asked = {"command": command, "recordings": list(recordings), "options": options}
        return self.ask("POST", "jobs", asked)[:2]

    def run(self, command: str, *recordings: str, **options: str) -> Any:
        """A job that has ended."""
        job = self.session.find_job(self.start(command, *recordings, **options)[1]["number"])
        wait_for(lambda: job.state != "running")
        return job


def wait_for(holds: Callable[[], Any], seconds: float = 20.0) -> None:
    """Wait until something holds."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, f"not within {seconds:g} s"
        time.sleep(0.01)
