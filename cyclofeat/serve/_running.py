"""Address, browser and end of the server."""

from __future__ import annotations

import contextlib
import errno
import secrets
import socket
import threading
import webbrowser
from dataclasses import dataclass

import uvicorn
from starlette.types import ASGIApp

HOST = "127.0.0.1"
_GRACE_S = 2


@dataclass(frozen=True)
class Address:
    """Open port of this machine, and the key of those who may use it."""

    listener: socket.socket
    key: str

    @classmethod
    def of_port(cls, port: int) -> Address:
        """Open a port for this machine alone, with a new key; 0 takes any free port.

        Raises
        ------
        OSError
            If it is taken or may not be opened.
        ValueError
            If there is no such port.
        """
        if not 0 <= port < 65536:
            raise ValueError(f"--port must be from 0 to 65535, got {port}")
        try:
            listener = socket.create_server((HOST, port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                reason = "is taken, perhaps by another cyclofeat serve"
            else:
                reason = f"cannot be opened ({error.strerror})"
            raise OSError(f"port {port} {reason}: give --port another number, or 0 for any") from None
        return cls(listener, secrets.token_urlsafe(24))

    @property
    def url(self) -> str:
        """Address of the page, with the key."""
        return f"http://{HOST}:{self.listener.getsockname()[1]}/{self.key}/"


def serve(app: ASGIApp, address: Address, *, browser: bool = True) -> None:
    """Serve an application until Ctrl-C or the system ends it.

    Parameters
    ----------
    app : ASGI application
    address : Address
    browser : bool
        Open the page in the user's browser.
    """
    config = uvicorn.Config(
        app, log_level="warning", access_log=False, timeout_graceful_shutdown=_GRACE_S, server_header=False
    )
    if browser:
        # The port takes connections already; a browser in a terminal would not let go of this thread.
        threading.Thread(target=webbrowser.open, args=(address.url,), daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt):  # raised again by uvicorn after all is closed
        uvicorn.Server(config).run(sockets=[address.listener])
