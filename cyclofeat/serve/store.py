"""Private folder of uploads, and its bounds."""

from __future__ import annotations

import csv
import os
import re
import shutil
import tempfile
from collections.abc import AsyncIterable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cyclofeat.datasets.readers import MANIFEST
from cyclofeat.models.card import CARD_SUFFIX, card_path

STATED = ("channel", "quantity", "speed")  # of single files
_KINDS = {".skops": "model", ".json": "simulator", ".npz": "posterior"}  # of files beside recordings

_LONGEST_VALUE = 200
_LONGEST_NAME = 150  # bytes; file systems take 255
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)  # by Windows
_ENDINGS = re.compile(r"((?:\.[A-Za-z]\w{0,9}){0,2})$")


class Refused(Exception):
    """A request that is not done; ``status`` is that of HTTP."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


@dataclass(frozen=True)
class Limits:
    """Bounds of what one server takes."""

    total_bytes: int = 4 * 2**30  # of all uploads together
    files: int = 1000  # those in folders included
    jobs: int = 4  # that run at a time


@dataclass
class Store:
    """Uploaded recordings and models, in the folder ``root`` that nobody else can read.

    ``items`` holds the name of each recording in the folder ``recordings``, and whether it is a folder;
    ``stated`` holds what the page states of single ones, by the columns of a manifest; ``others`` are the
    uploaded ``model``, rig (``simulator``) and ``posterior``.
    """

    root: Path
    limits: Limits
    items: dict[str, bool] = field(default_factory=dict)
    stated: dict[str, dict[str, str]] = field(default_factory=dict)
    others: dict[str, Path] = field(default_factory=dict)
    _bytes: int = 0
    _files: int = 0

    def __post_init__(self) -> None:
        self.recordings = self.root / "recordings"
        self.recordings.mkdir()

    def add_folder(self, name: str) -> str:
        """Make an empty folder, and return its name, which differs from ``name`` where that is taken."""
        unused = self._unused_name(plain_name(name))
        (self.recordings / unused).mkdir()
        self.items[unused] = True
        return unused

    async def add_file(self, name: str, content: AsyncIterable[bytes], folder: str | None = None) -> str:
        """Store a recording, in a folder or by itself, and return its name."""
        stored = plain_name(name)
        if folder is None:
            stored = self._unused_name(stored)
        elif not self.items.get(folder):
            raise Refused(404, f"no such folder: {folder!r}")
        elif (self.recordings / folder / stored).exists():
            # A manifest names its files: none may get another name than its own.
            raise Refused(409, f"two files of the folder would be called {stored!r}: rename one")
        await self._write_file(self.recordings / (folder or "") / stored, content)
        if folder is None:
            self.items[stored] = False
        return stored

    def claim_name(self, name: str) -> str:
        """Return a name for a recording that a command will write."""
        unused = self._unused_name(name)
        self.items[unused] = False
        return unused

    def remove_recording(self, name: str) -> None:
        """Delete a recording or a folder of them."""
        if name not in self.items:
            raise Refused(404, f"no such recording: {name!r}")
        path = self.recordings / name
        files = [file for file in path.iterdir() if file.is_file()] if self.items[name] else [path]
        for file in files:
            if file.exists():
                self._bytes -= file.stat().st_size
                self._files -= 1
        del self.items[name]
        self.stated.pop(name, None)
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)

    def link_recordings(
        self, names: Iterable[str], folder: Path, rows: Mapping[str, Mapping[str, str]]
    ) -> None:
        """Make a folder of links to recordings, with a manifest of these rows by the names of their files."""
        folder.mkdir()
        for name in names:
            if self.items[name]:
                shutil.copytree(self.recordings / name, folder / name, copy_function=_link_file)
            else:
                _link_file(self.recordings / name, folder / name)
        with (folder / MANIFEST).open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, ("file", *STATED), restval="")
            writer.writeheader()
            writer.writerows({"file": name, **row} for name, row in rows.items())

    def state_facts(self, name: str, asked: Mapping[str, Any]) -> None:
        """Keep what the page states of one file; empty texts state nothing."""
        if self.items.get(name) is not False:
            raise Refused(404, f"no such file: {name!r}")
        if unknown := asked.keys() - {*STATED}:
            raise Refused(400, f"unknown fact {min(unknown)!r}; known are {', '.join(STATED)}")
        self.stated[name] = filled_texts(asked)

    async def add_other(self, name: str, content: AsyncIterable[bytes]) -> None:
        """Store a model, rig or posterior in place of the one before, or the card of the model before it."""
        if name.endswith(CARD_SUFFIX):
            model = self.others.get("model")
            if model is None or card_path(model).exists():
                raise Refused(409, "a card follows its model file: choose both files together")
            await self._write_file(card_path(model), content)
            return
        kind = _KINDS.get(Path(name).suffix)
        if kind is None:
            raise Refused(
                415,
                f"a model is a .skops file, a rig a .json file and a posterior a .npz file, got {name!r}; a "
                ".joblib file can run any code when loaded: if you trust it, start cyclofeat serve --model "
                "FILE --trust",
            )
        folder = Path(tempfile.mkdtemp(dir=self.root))
        await self._write_file(folder / plain_name(name), content)
        self.others[kind] = folder / plain_name(name)

    async def _write_file(self, path: Path, content: AsyncIterable[bytes]) -> None:
        """Write a new file within the bounds; nothing stays of one that exceeds them or breaks off."""
        if self._files >= self.limits.files:
            raise Refused(413, f"at most {self.limits.files} files can be uploaded: remove some")
        self._files += 1
        written = 0
        try:
            with path.open("xb") as file:
                async for part in content:
                    written += len(part)
                    self._bytes += len(part)
                    if self._bytes > self.limits.total_bytes:
                        raise Refused(
                            413,
                            f"{path.name} is too large: uploads may take "
                            f"{self.limits.total_bytes / 2**20:,.0f} MB together; remove some, or use the "
                            "command line, which reads files where they are",
                        )
                    file.write(part)
        except BaseException as error:
            self._files -= 1
            self._bytes -= written
            path.unlink(missing_ok=True)
            if isinstance(error, OSError):
                raise Refused(507, f"{path.name} cannot be stored: {error.strerror or error}") from error
            raise

    def _unused_name(self, name: str) -> str:
        stem, ending, _ = _ENDINGS.split(name, maxsplit=1)
        number, unused = 1, name
        while unused in self.items or (self.recordings / unused).exists():
            number += 1
            unused = f"{stem} ({number}){ending}"
        return unused


def filled_texts(asked: Mapping[str, Any]) -> dict[str, str]:
    """Return the texts that are not empty, by their names; raise Refused for other values."""
    for name, value in asked.items():
        if not isinstance(value, str) or len(value) > _LONGEST_VALUE or not value.isprintable():
            raise Refused(400, f"{name} must be a text of up to {_LONGEST_VALUE} printable characters")
    return {name: value.strip() for name, value in asked.items() if value.strip()}


def _link_file(source: str | Path, target: str | Path) -> None:
    """Link a file, or copy it where the file system has no links."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def plain_name(name: str) -> str:
    """Return the last part of a file's name, of letters, digits and a few signs: safe as a file's name here.

    Examples
    --------
    >>> plain_name("../../etc/Prüfstand 7.tdms"), plain_name("<b>.csv"), plain_name("-"), plain_name("NUL")
    ('Prüfstand 7.tdms', '_b_.csv', 'recording', '_NUL')
    """
    last = re.split(r"[/\\]", name)[-1]
    plain = re.sub(r"[^\w .()+-]", "_", last).strip(" .").lstrip("-")
    stem, ending, _ = _ENDINGS.split(plain, maxsplit=1)
    room = _LONGEST_NAME - len(ending.encode())
    plain = stem.encode()[:room].decode(errors="ignore").rstrip(" .") + ending
    return f"_{plain}" if _RESERVED.match(plain) else plain or "recording"
