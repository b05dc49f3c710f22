"""Routes of the page, refusal of strangers, and the server: its address, the browser and its end."""

from __future__ import annotations

import contextlib
import errno
import inspect
import json
import secrets
import shutil
import socket
import tempfile
import threading
import webbrowser
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.types import ASGIApp

from cyclofeat import __version__
from cyclofeat.serve.jobs import PROGRAM, Session
from cyclofeat.serve.store import Limits, Refused
from cyclofeat.serve.view import TEMPLATES, render_parts

_LARGEST_REQUEST = 2**20  # bytes, of all but uploads
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; "
    "img-src data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the address holds the key
    "X-Content-Type-Options": "nosniff",
}
# A report keeps its own scripts, but not our origin: it can ask this server for nothing.
_REPORT_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; sandbox allow-scripts allow-modals"
)


def make_app(
    key: str, *, model: Sequence[str] = (), limits: Limits | None = None, program: Sequence[str] = PROGRAM
) -> Starlette:
    """Make the web application; its uploads lie in a private folder that its end deletes.

    Parameters
    ----------
    key : str
        Secret, the first part of every path. Requests without it, and from other origins, are refused.
    model : sequence of str
        Options of ``cyclofeat count`` that name the model: ``("--model", "model.skops")``. Default: the
        packaged models.
    limits : Limits, optional
    program : sequence of str
        The command line's program, to which commands are given.

    Returns
    -------
    starlette.applications.Starlette

    Examples
    --------
    >>> app = make_app("a-long-secret", model=("--model", "model.skops"))
    """

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        root = Path(tempfile.mkdtemp(prefix="cyclofeat-"))  # readable by its owner only
        session = app.state.session = Session(root, limits or Limits(), tuple(model), program)
        try:
            yield
        finally:
            await session.close()
            shutil.rmtree(root, ignore_errors=True)

    async def guard(request: Request, answer: RequestResponseEndpoint) -> Response:
        """Refuse requests of other pages and without the key, and add headers to each answer."""
        origin = request.headers.get("origin")
        if origin is not None and origin != f"http://{request.headers.get('host')}":
            response: Response = PlainTextResponse("requests of other pages are refused", 403)
        elif not secrets.compare_digest(request.scope["path"].split("/")[1].encode(), key.encode()):
            text = "open the address that cyclofeat serve printed, with its key"
            response = PlainTextResponse(text, 403)
        else:
            response = await answer(request)
        for name, value in _HEADERS.items():
            response.headers.setdefault(name, value)
        return response

    routes = [
        Route("/", get_page),
        Route("/app.js", get_script),
        *(Route(path, _answer_by(work), methods=[method]) for (method, path), work in WORK.items()),
        Route("/jobs/{number:int}/{name}", get_output),
    ]
    return Starlette(
        routes=[Mount(f"/{key}", routes=routes)],
        middleware=[
            # A page elsewhere may let its own name point to this machine (DNS rebinding).
            Middleware(TrustedHostMiddleware, allowed_hosts=["127.0.0.1", "localhost"], www_redirect=False),
            Middleware(BaseHTTPMiddleware, dispatch=guard),
        ],
        exception_handlers={Refused: refuse, ClientDisconnect: refuse},
        lifespan=lifespan,
    )


async def get_page(request: Request) -> Response:
    # Its script fetches the parts.
    return HTMLResponse(TEMPLATES.get_template("serve.html").render(title="cyclofeat", version=__version__))


async def get_script(request: Request) -> Response:
    return FileResponse(Path(__file__).with_name("templates") / "app.js", media_type="text/javascript")


async def get_output(request: Request) -> Response:
    name = request.path_params["name"]
    path = request.app.state.session.find_job(request.path_params["number"]).output_path(name)
    if path is None:
        raise Refused(404, f"no such file: {name!r}")
    shown = "attachment" if "download" in request.query_params else "inline"
    headers = {"Content-Security-Policy": _REPORT_POLICY}
    return FileResponse(path, filename=name, content_disposition_type=shown, headers=headers)


async def refuse(request: Request, error: Exception) -> Response:
    """Answer with the reason; nobody reads it where the browser has gone away in the middle."""
    return JSONResponse({"error": str(error)}, error.status if isinstance(error, Refused) else 400)


async def start_job(session: Session, request: Request) -> dict[str, int]:
    return {"number": session.start_job(await _read_object(request)).number}


async def state_facts(session: Session, request: Request) -> None:
    session.store.state_facts(_query_value(request), await _read_object(request))


async def add_file(session: Session, request: Request) -> dict[str, str]:
    folder = request.query_params.get("folder")
    return {"name": await session.store.add_file(_query_value(request), request.stream(), folder)}


# What the page asks and does, by method and path.
WORK: dict[tuple[str, str], Callable[[Session, Request], Any]] = {
    ("GET", "/state"): lambda session, _: render_parts(session),
    ("POST", "/folders"): lambda session, asked: {"name": session.store.add_folder(_query_value(asked))},
    ("POST", "/files"): add_file,
    ("POST", "/others"): lambda session, asked: session.store.add_other(_query_value(asked), asked.stream()),
    ("DELETE", "/recordings"): lambda session, asked: session.store.remove_recording(_query_value(asked)),
    ("POST", "/stated"): state_facts,
    ("POST", "/jobs"): start_job,
    ("DELETE", "/jobs"): lambda session, _: session.clear_jobs(),
    ("POST", "/jobs/{number:int}/cancel"): lambda session, asked: session.cancel_job(**asked.path_params),
}


def _answer_by(work: Callable[[Session, Request], Any]) -> Callable[[Request], Awaitable[Response]]:
    """Return the endpoint that answers with what some work returns."""

    async def answer(request: Request) -> Response:
        result = work(request.app.state.session, request)
        return JSONResponse((await result if inspect.isawaitable(result) else result) or {})

    return answer


async def _read_object(request: Request) -> dict[str, Any]:
    """Return the JSON object that a request holds."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _LARGEST_REQUEST:
            raise Refused(413, "the request is too long")
    try:
        asked = json.loads(body)
    except (ValueError, RecursionError):
        asked = None
    if not isinstance(asked, dict):
        raise Refused(400, "the request must be a JSON object")
    return asked


def _query_value(request: Request) -> str:
    value = request.query_params.get("name", "")
    if not value:
        raise Refused(400, "the address must end in ?name=...")
    return value


HOST = "127.0.0.1"
_GRACE_S = 2


@dataclass(frozen=True)
class Address:
    """Open port of this machine, and the key of those who may use it."""

    listener: socket.socket
    key: str

    @classmethod
    def of_port(cls, port: int) -> Address:
        """Open a port for this machine alone, with a new key; 0 takes any free port."""
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
    """Serve an application until Ctrl-C or the system ends it, and open its page in the user's browser."""
    config = uvicorn.Config(
        app, log_level="warning", access_log=False, timeout_graceful_shutdown=_GRACE_S, server_header=False
    )
    if browser:
        # The port takes connections already; a browser in a terminal would not let go of this thread.
        threading.Thread(target=webbrowser.open, args=(address.url,), daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt):  # raised again by uvicorn after all is closed
        uvicorn.Server(config).run(sockets=[address.listener])
