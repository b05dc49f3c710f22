"""Files that a command writes: checked before any work, and never overwritten unasked."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Literal

__all__ = ["add_target", "check_targets"]

Kind = Literal["file", "model", "page"]


def add_target(parser: argparse.ArgumentParser, option: str, kind: Kind = "file", **parsing: Any) -> None:
    """Add an option that names a file to write, and ``--force`` with the first of them."""
    targets: dict[str, Kind] = parser.get_default("targets") or {}
    if not targets:
        parser.add_argument("--force", action="store_true", help="overwrite files that exist")
    parser.add_argument(option, **parsing)
    parser.set_defaults(targets=targets | {option: kind})


def check_targets(arguments: argparse.Namespace) -> None:
    """Check that every file named can be written.

    Raises
    ------
    FileExistsError
        If it exists, and ``--force`` was not given.
    FileNotFoundError, IsADirectoryError
        If its folder does not exist, or it is a folder itself.
    ImportError, ValueError
        If it needs a library that is not installed, or has a wrong suffix.
    """
    for option, kind in getattr(arguments, "targets", {}).items():
        name = getattr(arguments, option.removeprefix("--").replace("-", "_"))
        if name is None:
            continue
        path = Path(name)
        if path.is_dir():
            raise IsADirectoryError(f"{option} must name a file, {path} is a folder")
        if not path.parent.is_dir():
            raise FileNotFoundError(f"folder {path.parent} for {option} does not exist: make it first")
        if kind == "page":
            from cyclofeat.report import check_page_path

            check_page_path(path)
        elif kind == "model":
            from cyclofeat.models import check_model_path

            check_model_path(path)
        if path.exists() and not arguments.force:
            raise FileExistsError(f"{path} exists: give {option} another name, or --force to overwrite it")
