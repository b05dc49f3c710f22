"""Text of files, whatever its encoding, packed with gzip or not."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, cast

from cyclofeat.datasets.readers._columns import explain_damage, largest_unpacked

_LONGEST_LINE = 2**20  # a longer one is no row of samples, and splitting it would take long
_BLOCK = 2**20
# Those of UTF-32 first: that of UTF-16 begins one of them.
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
)  # fmt: skip
# Without a mark; the second is Latin-1 as Windows writes it, with five bytes undefined.
_UNMARKED = ("utf-8", "cp1252")
_REMEDY = "save it as text in UTF-8"


class TextLines:
    r"""Lines of a file without their ends, read anew by each iteration and never all at once.

    In UTF-8, UTF-16 or UTF-32 with a byte-order mark, or Latin-1; lines end with ``\n``, ``\r\n`` or ``\r``.
    Empty lines at the end are left out.

    Raises
    ------
    ValueError
        If it is in none of these encodings, unpacks to too much, or begins with an endless line.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.packed = path.suffix.lower() == ".gz"
        with self._open_bytes() as file:
            start = file.read(_LONGEST_LINE + 1)
        if len(start) > _LONGEST_LINE and b"\n" not in start and b"\r" not in start:
            raise ValueError(
                f"{path.name} is no CSV file of samples: its first line is longer than {_LONGEST_LINE} "
                "characters; one row per sample is right"
            )
        marked = next((encoding for mark, encoding in _MARKS if start.startswith(mark)), None)
        self._check_content(may_hold_zeros=marked is not None)
        for encoding in _UNMARKED if marked is None else (marked,):
            self.encoding = encoding
            wrong = self._first_undecodable()
            if wrong is None:
                return
        known = marked or "UTF-8, Latin-1, or UTF-16 with a byte-order mark"
        raise ValueError(f"{path.name} is not text in {known} (byte {wrong}); {_REMEDY}")

    def __iter__(self) -> Iterator[str]:
        empty = 0
        with self._open_bytes() as file, io.TextIOWrapper(file, self.encoding) as lines:
            for line in lines:
                if line.isspace():
                    empty += 1
                    continue
                if empty:
                    yield from [""] * empty
                    empty = 0
                yield line.removesuffix("\n")

    @contextmanager
    def _open_bytes(self) -> Iterator[IO[bytes]]:
        if not self.packed:
            with self.path.open("rb") as file:
                yield file
            return
        with explain_damage(self.path, "gzip"), gzip.open(self.path) as packed:
            yield cast("IO[bytes]", packed)

    def _check_content(self, *, may_hold_zeros: bool) -> None:
        limit = largest_unpacked(self.path) if self.packed else None
        size = 0
        with self._open_bytes() as file:
            while block := file.read(_BLOCK):
                size += len(block)
                if limit is not None and size > limit:
                    raise ValueError(
                        f"{self.path.name} takes more than {limit / 1e9:.3g} GB when unpacked: unpack it, or "
                        "split it"
                    )
                if not may_hold_zeros and b"\0" in block:
                    raise ValueError(
                        f"{self.path.name} holds binary data, or UTF-16 without a byte-order mark; {_REMEDY}"
                    )

    def _first_undecodable(self) -> int | None:
        """Return the first byte that is not in the encoding; None if all are."""
        decoder = codecs.getincrementaldecoder(self.encoding)()
        before = 0
        with self._open_bytes() as file:
            while True:
                block = file.read(_BLOCK)
                pending = len(decoder.getstate()[0])
                try:
                    decoder.decode(block, final=not block)
                except UnicodeDecodeError as error:
                    return before - pending + error.start
                if not block:
                    return None
                before += len(block)


def cells_of(line: str, delimiter: str, file: str) -> list[str]:
    """Return the cells of a row of a CSV file."""
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error as error:
        raise ValueError(f"{file} cannot be read as CSV ({error})") from None
