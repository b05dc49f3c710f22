"""Which files of a folder are whole and new: polling, without the machine's own notifications.

Notifications do not cross network shares, and do not tell when a writer has finished either.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

# A file that cannot be read is bad, not just half written, once it has not changed for this many times the
# time to settle.
_PATIENCE = 5

# How a line of the list of what is done begins.
_BEGINNING = b'{"file": '

# Size, time of change in ns, inode: another file renamed into its place has another inode.
Signature = tuple[int, int, int]


@dataclass
class _Seen:
    """A file as last seen, and since when it has been so."""

    signature: Signature
    since: float
    tried: bool = False
    message: str | None = None
    told: bool = False


class FolderWatch:
    """Tells once of every file that has come to rest, and again if it changes afterwards.

    Parameters
    ----------
    folder : pathlib.Path
    suffixes : tuple of str
        Endings of recordings, in lower case, with the dot.
    settle_s : float
        Time for which size and time of change must stay the same.
    done : DoneList
        Files that need not be told of.
    left_out : collection of str
        Names that are no recordings.
    """

    def __init__(
        self,
        folder: Path,
        suffixes: tuple[str, ...],
        settle_s: float,
        done: DoneList,
        left_out: Collection[str] = (),
    ) -> None:
        self.folder = folder
        self.suffixes = suffixes
        self.settle_s = settle_s
        self.done = done
        self.left_out = left_out
        self._seen: dict[str, _Seen] = {}

    @property
    def unsettled(self) -> set[str]:
        """Names of files that are still changing."""
        return {name for name, file in self._seen.items() if not file.tried}

    def poll(self, now: float) -> list[Path]:
        """Files to be counted, in order of their names; ``now`` in s of a clock that never goes back."""
        present = dict(self._files())
        for name in self._seen.keys() - present.keys():
            del self._seen[name]
        ready = []
        for name in sorted(present):
            signature = present[name]
            seen = self._seen.get(name)
            if seen is None or seen.signature != signature:
                told = seen is not None and seen.told
                seen = self._seen[name] = _Seen(signature, now, told=told)
                seen.tried = self.done.holds(name, signature)
            if not seen.tried and now - seen.since >= self.settle_s:
                seen.tried = True
                ready.append(self.folder / name)
        return ready

    def counted(self, path: Path) -> None:
        """Remember a file that was counted."""
        seen = self._seen[path.name]
        seen.message, seen.told = None, False
        self.done.add(path.name, seen.signature)

    def failed(self, path: Path, message: str) -> None:
        """Remember why a file could not be counted; :meth:`bad` tells of it later."""
        self._seen[path.name].message = message

    def bad(self, now: float, *, at_once: bool = False) -> list[tuple[Path, str]]:
        """Files that could not be counted and have not changed since for long, each told of once."""
        found = []
        for name, seen in self._seen.items():
            waited = at_once or now - seen.since >= _PATIENCE * self.settle_s
            if seen.message is None or not waited:
                continue
            if not seen.told:
                found.append((self.folder / name, seen.message))
            # Not done: the next start may read it, with other options.
            seen.message, seen.told = None, True
        return found

    def _files(self) -> Iterator[tuple[str, Signature]]:
        with os.scandir(self.folder) as entries:
            for entry in entries:
                name = entry.name
                hidden = name.startswith(".") or name in self.left_out
                if hidden or Path(name).suffix.lower() not in self.suffixes:
                    continue
                try:
                    if entry.is_file():
                        state = os.stat(entry.path)
                        yield name, (state.st_size, state.st_mtime_ns, state.st_ino)
                except OSError:
                    continue  # gone, or a link to nothing


class DoneList:
    """Files that need not be counted again: in memory, and in a file for the next start.

    Each line of the file is one JSON object. The last line may be cut, as by a kill while it was written.

    Parameters
    ----------
    path : pathlib.Path, optional
        File; made if it does not exist. Default: memory only.

    Raises
    ------
    FileNotFoundError
        Where its folder does not exist.
    ValueError
        Where it holds something else.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._done: dict[str, tuple[int, int]] = {}
        self._path = path
        self._unwritten: list[bytes] = []
        self._whole: int | None = None  # bytes before a line that was cut
        if path is None:
            return
        if not path.parent.is_dir():
            raise FileNotFoundError(f"folder {path.parent} for --done does not exist: make it first")
        written = path.read_bytes() if path.exists() else b""
        whole = written[: written.rfind(b"\n") + 1]
        if not whole and written and not written.startswith(_BEGINNING):
            raise ValueError(f"{path} is not a list that watch wrote: name a new file for --done")
        for number, line in enumerate(whole.splitlines(), 1):
            try:
                entry = json.loads(line)
                self._done[str(entry["file"])] = (int(entry["size"]), int(entry["mtime_ns"]))
            except (ValueError, TypeError, KeyError, RecursionError):
                raise ValueError(
                    f"{path} is not a list that watch wrote (line {number}): name a new file for --done"
                ) from None
        with path.open("ab"):
            pass  # which tells now whether it can be written
        if len(whole) < len(written):
            self._whole = len(whole)

    def holds(self, name: str, signature: Signature) -> bool:
        """Whether this file, in this state, is done; a restored copy with another inode is the same."""
        return self._done.get(name) == signature[:2]

    def add(self, name: str, signature: Signature) -> None:
        """Remember a file in this state, for the next :meth:`write`."""
        self._done[name] = signature[:2]
        entry = {"file": name, "size": signature[0], "mtime_ns": signature[1]}
        self._unwritten.append(json.dumps(entry).encode() + b"\n")

    def write(self) -> None:
        """Write what was added since.

        Raises
        ------
        OSError
            If it cannot be written; the next call tries again.
        """
        if self._path is None or not self._unwritten:
            return
        with self._path.open("ab") as file:
            if self._whole is not None:
                file.truncate(self._whole)
            self._whole = file.seek(0, os.SEEK_END)
            file.write(b"".join(self._unwritten))
        self._whole = None
        self._unwritten.clear()
