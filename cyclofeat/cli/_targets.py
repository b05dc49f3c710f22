"""Files and folders that a command writes: checked before any work, and never overwritten unasked."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Literal

from cyclofeat._base.files import check_parent
from cyclofeat.cli._idle import add_idle

Kind = Literal["file", "folder", "model", "page"]


def add_target(parser: argparse.ArgumentParser, option: str, kind: Kind = "file", **parsing: Any) -> None:
    """Add an option that names a file or folder to write, and ``--force`` with the first of them."""
    targets: dict[str, Kind] | None = parser.get_default("targets")
    if targets is None:
        targets = {}
        parser.set_defaults(targets=targets)
        parser.add_argument("--force", action="store_true", help="overwrite files that exist")
    action = parser.add_argument(option, **parsing)
    targets[option] = kind
    if not action.required and action.default is None:
        add_idle(parser, "--force", without=targets)  # with those to come


def check_targets(arguments: argparse.Namespace) -> None:
    """Check that every file named can be written.

    Raises
    ------
    FileExistsError
        If it exists, or is a folder that is not empty, and ``--force`` was not given.
    FileNotFoundError, IsADirectoryError, NotADirectoryError
        If its folder does not exist, or it is a folder in place of a file or a file in place of a folder.
    ImportError, ValueError
        If it needs a library that is not installed, has a wrong suffix, or is named by two options.
    """
    seen: dict[Path, str] = {}
    for option, kind in getattr(arguments, "targets", {}).items():
        name = getattr(arguments, option.removeprefix("--").replace("-", "_"))
        if name is None:
            continue
        path = Path(name)
        other = seen.setdefault(path.resolve(), option)
        if other != option:
            raise ValueError(f"{other} and {option} must name different files, both are {path}")
        written = [path]
        if kind == "folder":
            check_folder(option, path)
            written = [path] if path.is_dir() and any(path.iterdir()) else []
        elif path.is_dir():
            raise IsADirectoryError(f"{option} must name a file, {path} is a folder")
        else:
            check_parent(path, option)
        if kind == "page":
            from cyclofeat.report import check_page_path

            check_page_path(path)
        elif kind == "model":
            from cyclofeat.models.card import card_path
            from cyclofeat.models.persistence import check_model_path

            written.append(card_path(check_model_path(path)))
        for one in written:
            if one.exists() and not arguments.force:
                raise FileExistsError(f"{one} exists: give {option} another name, or --force to overwrite it")


def check_folder(option: str, path: Path) -> None:
    """Raise NotADirectoryError if an option's folder is a file."""
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(f"{option} must name a folder, {path} is a file")
