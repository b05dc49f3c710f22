"""Routes of the page, and refusal of strangers."""

from __future__ import annotations

import json
import secrets
import shutil
import tempfile
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from cyclofeat.serve._jobs import PROGRAM, Jobs
from cyclofeat.serve._session import Session
from cyclofeat.serve._store import Limits, Refused, Store
from cyclofeat.serve._view import page, parts

_LARGEST_REQUEST = 2**20  # bytes, of all but uploads
_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the address holds the key
    "X-Content-Type-Options": "nosniff",
}
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
# A report keeps its own scripts, but not our origin: it can ask this server for nothing.
_REPORT_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; sandbox allow-scripts allow-modals"
)


def make_app(
    key: str,
    *,
    model: Sequence[str] = (),
    limits: Limits | None = None,
    program: Sequence[str] = PROGRAM,
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

    Examples
    --------
    >>> app = make_app("a-long-secret", model=("--model", "model.skops"))
    """
    bounds = limits or Limits()

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        root = Path(tempfile.mkdtemp(prefix="cyclofeat-"))  # readable by its owner only
        store = Store(root, bounds)
        jobs = Jobs(root, store.recordings, bounds.jobs, program)
        app.state.session = Session(store, jobs, tuple(model))
        try:
            yield
        finally:
            await jobs.close()
            shutil.rmtree(root, ignore_errors=True)

    routes = [
        Route("/", _index),
        Route("/app.js", _script),
        Route("/state", _state),
        Route("/folders", _add_folder, methods=["POST"]),
        Route("/files", _add_file, methods=["POST"]),
        Route("/model", _add_model, methods=["POST"]),
        Route("/recordings", _remove, methods=["DELETE"]),
        Route("/jobs", _start, methods=["POST"]),
        Route("/jobs/{number:int}/cancel", _cancel, methods=["POST"]),
        Route("/jobs/{number:int}/{name}", _output),
    ]
    return Starlette(
        routes=[Mount(f"/{key}", routes=routes)],
        middleware=[
            # A page elsewhere may let its own name point to this machine (DNS rebinding).
            Middleware(TrustedHostMiddleware, allowed_hosts=["127.0.0.1", "localhost"], www_redirect=False),
            Middleware(_Guard, key=key),
        ],
        exception_handlers={Refused: _refused, ClientDisconnect: _left},
        lifespan=lifespan,
    )


class _Guard:
    """Refuse requests of other pages and without the key, and add headers to each answer."""

    def __init__(self, app: ASGIApp, key: str) -> None:
        self.app, self.key = app, key

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in {"Content-Security-Policy": _POLICY, **_HEADERS}.items():
                    headers.setdefault(name, value)
            await send(message)

        headers = Headers(scope=scope)
        origin = headers.get("origin")
        answer: ASGIApp = self.app
        if origin is not None and origin != f"http://{headers.get('host')}":
            answer = PlainTextResponse("requests of other pages are refused", 403)
        elif not secrets.compare_digest(scope["path"].split("/")[1].encode(), self.key.encode()):
            answer = PlainTextResponse("open the address that cyclofeat serve printed, with its key", 403)
        await answer(scope, receive, with_headers)


def _session(request: Request) -> Session:
    session: Session = request.app.state.session
    return session


async def _index(request: Request) -> Response:
    return HTMLResponse(page())


async def _script(request: Request) -> Response:
    return FileResponse(Path(__file__).with_name("templates") / "app.js", media_type="text/javascript")


async def _state(request: Request) -> Response:
    return JSONResponse(parts(_session(request)))


async def _add_folder(request: Request) -> Response:
    name = _session(request).store.add_folder(_parameter(request, "name"))
    return JSONResponse({"name": name}, 201)


async def _add_file(request: Request) -> Response:
    name, folder = _parameter(request, "name"), request.query_params.get("folder")
    stored = await _session(request).store.add_file(name, request.stream(), folder)
    return JSONResponse({"name": stored}, 201)


async def _add_model(request: Request) -> Response:
    await _session(request).add_model(_parameter(request, "name"), request.stream())
    return JSONResponse({}, 201)


async def _remove(request: Request) -> Response:
    _session(request).store.remove(_parameter(request, "name"))
    return JSONResponse({})


async def _start(request: Request) -> Response:
    job = _session(request).start(await _json(request))
    return JSONResponse({"number": job.number}, 201)


async def _cancel(request: Request) -> Response:
    await _session(request).jobs.cancel(request.path_params["number"])
    return JSONResponse({})


async def _output(request: Request) -> Response:
    name = request.path_params["name"]
    path = _session(request).jobs.job(request.path_params["number"]).path(name)
    if path is None:
        raise Refused(404, f"no such file: {name!r}")
    shown = "attachment" if "download" in request.query_params else "inline"
    headers = {"Content-Security-Policy": _REPORT_POLICY}
    return FileResponse(path, filename=name, content_disposition_type=shown, headers=headers)


def _parameter(request: Request, name: str) -> str:
    value = request.query_params.get(name, "")
    if not value:
        raise Refused(400, f"the address must end in ?{name}=...")
    return value


async def _json(request: Request) -> dict[str, Any]:
    """Return the object in the body of a request, which may not be long."""
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


async def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, Refused)
    return JSONResponse({"error": str(error)}, error.status)


async def _left(request: Request, error: Exception) -> Response:
    """Nobody reads the answer: the browser has gone away in the middle of a request."""
    return Response(status_code=400)
