"""Complete and new files of a folder, by polling.

Notifications of the operating system do not cross network shares, nor state when a writer has finished.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from cyclofeat._base.files import check_parent

__all__ = ["DoneList", "FolderWatch"]

# A file that cannot be read is bad, and not only half written, after this many times the time to settle.
_PATIENCE = 5
_BEGINNING = b'{"file": '  # of the list of files that are done

# Size, time of change in ns, inode: another file renamed into its place has another inode.
Signature = tuple[int, int, int]


@dataclass
class _Seen:
    """State of a file, the time of its last change, and what became of it."""

    signature: Signature
    since: float
    tried: bool = False
    message: str | None = None
    reported: bool = False


@dataclass
class FolderWatch:
    """Report every file once it no longer changes, and again if it changes afterwards.

    Parameters
    ----------
    folder : pathlib.Path
    suffixes : tuple of str
        Endings of recordings, in lower case, with the dot.
    settle_s : float
        Time for which size and time of change must stay the same.
    done : DoneList
        Files that need not be reported.
    ignored : collection of str
        Names of files that are no recordings.
    """

    folder: Path
    suffixes: tuple[str, ...]
    settle_s: float
    done: DoneList
    ignored: Collection[str] = ()
    _seen: dict[str, _Seen] = field(default_factory=dict, init=False)

    @property
    def unsettled(self) -> set[str]:
        """Names of files that are still changing."""
        return {name for name, file in self._seen.items() if not file.tried}

    def poll(self, now: float) -> list[Path]:
        """Return files to count, sorted by name; ``now`` in s of a clock that never goes back."""
        present = dict(sorted(self._files()))
        for name in self._seen.keys() - present.keys():
            del self._seen[name]
        ready = []
        for name, signature in present.items():
            seen = self._seen.get(name)
            if seen is None or seen.signature != signature:
                reported = seen is not None and seen.reported
                seen = _Seen(signature, now, tried=self.done.holds(name, signature), reported=reported)
                self._seen[name] = seen
            if not seen.tried and now - seen.since >= self.settle_s:
                seen.tried = True
                ready.append(self.folder / name)
        return ready

    def counted(self, path: Path) -> None:
        """Remember a file that was counted."""
        seen = self._seen[path.name]
        seen.message, seen.reported = None, False
        self.done.add(path.name, seen.signature)

    def failed(self, path: Path, message: str) -> None:
        """Remember why a file could not be counted; :meth:`bad` reports it later."""
        self._seen[path.name].message = message

    def bad(self, now: float, *, at_once: bool = False) -> list[tuple[Path, str]]:
        """Return files that could not be counted and have not changed for long, each once, and the reason."""
        files = []
        for name, seen in self._seen.items():
            waited = at_once or now - seen.since >= _PATIENCE * self.settle_s
            if seen.message is None or not waited:
                continue
            if not seen.reported:
                files.append((self.folder / name, seen.message))
            # Not done: the next start may read it, with other options.
            seen.message, seen.reported = None, True
        return files

    def _files(self) -> Iterator[tuple[str, Signature]]:
        with os.scandir(self.folder) as entries:
            for entry in entries:
                name = entry.name
                hidden = name.startswith(".") or name in self.ignored
                if hidden or not name.lower().endswith(self.suffixes):
                    continue
                try:
                    if entry.is_file():
                        state = os.stat(entry.path)
                        yield name, (state.st_size, state.st_mtime_ns, state.st_ino)
                except OSError:
                    continue  # gone, or a link to nothing


class DoneList:
    """Files that need not be counted again: in memory, and at ``path`` (if any) for the next start.

    Each line of that file is one JSON object; the last is cut if the process was killed while writing it.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._done: dict[str, tuple[int, int]] = {}
        self._path = path
        self._unwritten: list[bytes] = []
        self._whole: int | None = None  # bytes before a line that was cut
        if path is None:
            return
        check_parent(path, "--done")
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
            pass  # an error now rather than after the first count
        if len(whole) < len(written):
            self._whole = len(whole)

    def holds(self, name: str, signature: Signature) -> bool:
        """Return True if this file in this state is done; a restored copy with another inode is the same."""
        return self._done.get(name) == signature[:2]

    def add(self, name: str, signature: Signature) -> None:
        """Add a file in this state, for the next :meth:`write`."""
        self._done[name] = signature[:2]
        entry = {"file": name, "size": signature[0], "mtime_ns": signature[1]}
        self._unwritten.append(json.dumps(entry).encode() + b"\n")

    def write(self) -> None:
        """Write the files added since the last call; after an OSError the next call tries again."""
        if self._path is None or not self._unwritten:
            return
        with self._path.open("ab") as file:
            if self._whole is not None:
                file.truncate(self._whole)
            self._whole = file.seek(0, os.SEEK_END)
            file.write(b"".join(self._unwritten))
        self._whole = None
        self._unwritten.clear()
