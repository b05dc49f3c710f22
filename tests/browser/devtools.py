"""Chromium without a window, over a pair of pipes in the DevTools protocol: no driver, no library."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
_PATIENCE = 60.0


def find_chromium() -> str | None:
    """The browser's program; $CHROMIUM chooses another."""
    return os.environ.get("CHROMIUM") or next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One page of one browser, which offline reaches nothing at all, otherwise only this machine.

    ``said`` is what a page said to its console or the browser of it: errors, warnings, violated policies;
    ``asked`` are the addresses that were asked for.
    """

    def __init__(self, profile: Path, *, offline: bool = True) -> None:
        program = find_chromium()
        assert program is not None, "no Chromium; look with find_chromium() before"
        to_browser, self._out = os.pipe()
        self._in, from_browser = os.pipe()
        reached = "" if offline else ", EXCLUDE 127.0.0.1"
        command = [
            program, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
            "--no-first-run", "--disable-background-networking", "--disable-component-update",
            f"--host-resolver-rules=MAP * ~NOTFOUND{reached}", f"--user-data-dir={profile}",
            "--remote-debugging-pipe", "about:blank",
        ]  # fmt: skip
        # Chromium reads commands from file 3 and writes answers to file 4.
        shell = f'exec 3<&{to_browser} 4>&{from_browser}; exec "$@"'
        self._process = subprocess.Popen(
            ["bash", "-c", shell, "bash", *command],
            pass_fds=(to_browser, from_browser), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(to_browser)
        os.close(from_browser)
        self._buffer = b""
        self._number = 0
        self._session: str | None = None
        self._events: list[dict[str, Any]] = []
        self.said: list[str] = []
        self.asked: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        rates = dict.fromkeys(("downloadThroughput", "uploadThroughput"), 0 if offline else -1)
        self.call("Network.emulateNetworkConditions", offline=offline, latency=0, **rates)

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self._session = None
        try:
            self.call("Browser.close")
        except (OSError, AssertionError):
            self._process.kill()
        self._process.wait(timeout=_PATIENCE)
        os.close(self._out)
        os.close(self._in)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Ask for something and wait for the answer; what happens meanwhile is kept."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, f"{method}: {answer.get('error')}"
                return dict(answer["result"])
            self._note(answer)

    def _next(self) -> dict[str, Any]:
        end = time.monotonic() + _PATIENCE
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._in], [], [], max(0.0, end - time.monotonic()))
            assert ready, f"Chromium said nothing for {_PATIENCE:g} s"
            part = os.read(self._in, 1 << 20)
            assert part, "Chromium ended"
            self._buffer += part
        message, _, self._buffer = self._buffer.partition(b"\0")
        return dict(json.loads(message))

    def _note(self, event: dict[str, Any]) -> None:
        name, what = event.get("method"), event.get("params", {})
        if name == "Runtime.exceptionThrown":
            self.said.append(json.dumps(what["exceptionDetails"]))
        elif name == "Runtime.consoleAPICalled":
            self.said.append(f"{what['type']}: {[argument.get('value') for argument in what['args']]}")
        elif name == "Log.entryAdded":
            self.said.append(f"{what['entry']['level']}: {what['entry']['text']}")
        elif name == "Network.requestWillBeSent":
            self.asked.append(what["request"]["url"])
        self._events.append(event)

    def open(self, place: Path | str) -> None:
        """Load a file or an address and wait until all of it is there."""
        self._events.clear()
        self.call("Page.navigate", url=place if isinstance(place, str) else place.resolve().as_uri())
        self._heard("Page.loadEventFired")

    def _heard(self, name: str) -> dict[str, Any]:
        """Wait for an event and return what it says."""
        while True:
            for event in self._events:
                if event.get("method") == name:
                    return dict(event["params"])
            self._note(self._next())

    def run(self, script: str) -> Any:
        """Value of an expression in the page."""
        answer = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True, userGesture=True
        )
        assert "exceptionDetails" not in answer, answer.get("exceptionDetails")
        return answer["result"].get("value")

    def wait_for(self, script: str, holds: Callable[[Any], bool], seconds: float = 20.0) -> Any:
        """Value of an expression as soon as something holds of it."""
        end = time.monotonic() + seconds
        while not holds(value := self.run(script)):
            assert time.monotonic() < end, f"{script} stayed at {value!r} for {seconds:g} s"
            time.sleep(0.05)
        return value

    def press(self, key: str) -> None:
        """A key, as from the keyboard; ``" "`` is the space bar."""
        code = {
            "Tab": 9, "Enter": 13, " ": 32, "PageUp": 33, "PageDown": 34, "End": 35, "Home": 36,
            "ArrowLeft": 37, "ArrowRight": 39, "ArrowDown": 40, "0": 48, "+": 187, "-": 189, "Escape": 27,
        }[key]  # fmt: skip
        text = {"text": "\r" if key == "Enter" else key} if len(key) == 1 or key == "Enter" else {}
        for kind in ("keyDown", "keyUp"):
            more = text if kind == "keyDown" else {}
            self.call("Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code, **more)

    def choose(self, *files: Path) -> None:
        """Open the dialog of the input in focus by the space bar, and choose files or a folder in it."""
        self.call("Page.setInterceptFileChooserDialog", enabled=True)
        self._events.clear()
        self.press(" ")
        dialog = self._heard("Page.fileChooserOpened")
        self.call("DOM.setFileInputFiles", backendNodeId=dialog["backendNodeId"], files=[*map(str, files)])

    def box(self, selector: str) -> tuple[float, float, float, float]:
        """Left, top, width and height of an element, which is scrolled into view."""
        element = f"document.querySelector('{selector}')"
        self.run(f"{element}.scrollIntoView({{block: 'center'}})")
        left, top, width, height = self.run(
            f"['x', 'y', 'width', 'height'].map(k => {element}.getBoundingClientRect()[k])"
        )
        return left, top, width, height

    def drop(self, selector: str, *files: Path) -> None:
        """Drag files or folders onto an element and drop them there."""
        left, top, width, height = self.box(selector)
        dragged = {"items": [], "files": [str(file) for file in files], "dragOperationsMask": 1}  # a copy
        for kind in ("dragEnter", "dragOver", "drop"):
            x, y = left + width / 2, top + height / 2
            self.call("Input.dispatchDragEvent", type=kind, x=x, y=y, data=dragged)

    def prefer(self, scheme: str) -> None:
        """Prefer ``"light"`` or ``"dark"`` pages."""
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def resize(self, width: int, height: int = 900) -> None:
        """Size of the page in pixels."""
        screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **screen)

    def print(self) -> bytes:
        """The page on A4 paper, as PDF."""
        answer = self.call("Page.printToPDF", printBackground=False, paperWidth=8.27, paperHeight=11.69)
        return base64.b64decode(answer["data"])

    def text(self, name: str) -> str:
        """The text of an element, by its id."""
        return str(self.run(f"document.getElementById('{name}').textContent"))

    def click(self, name: str) -> None:
        """Click an element, by its id."""
        self.run(f"document.getElementById('{name}').click()")
