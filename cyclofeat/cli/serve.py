"""``cyclofeat serve``: the commands as a page in the browser, on this machine only."""

from __future__ import annotations

import os
from collections.abc import Iterator

from cyclofeat.cli._options import Arguments, Parser, Printed, note, whole_number


def add_arguments(parser: Parser) -> None:
    parser.add_model_file()
    parser.add_argument(
        "--port", type=whole_number(0, 65_535), default=8765, metavar="N",
        help="port on this machine (default 8765; 0: any free port)",
    )  # fmt: skip
    parser.add_argument("--no-browser", action="store_true", help="print the address and open no browser")


def run(arguments: Arguments) -> Iterator[Printed]:
    """Yield the address of the page, then serve it until Ctrl-C."""
    try:
        from cyclofeat.serve.app import Address, make_app, serve
    except ImportError as error:
        raise ImportError(f"serve needs starlette, uvicorn and jinja2 (extra serve): {error}") from error
    model = []
    if arguments.model is not None:
        arguments.read_model()  # its errors now, not at the first count
        model = ["--model", os.path.abspath(arguments.model)]
        model += ["--trust"] * arguments.trust + [f"--allow={name}" for name in arguments.allow]
    address = Address.of_port(arguments.port)
    yield Printed(address.url, {"url": address.url})
    note("cyclofeat: serving on this machine only, stop with Ctrl-C")
    serve(make_app(address.key, model=model), address, browser=not arguments.no_browser)
    note("cyclofeat: stopped")
