"""Text of files, whatever its encoding, packed with gzip or not."""

from __future__ import annotations

import codecs
import gzip
from pathlib import Path

from cyclofeat.datasets.readers._columns import largest_unpacked, reading

_LONGEST_LINE = 2**20  # a longer one is no row of samples, and splitting it would take long
# Those of UTF-32 first: that of UTF-16 begins one of them.
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
)  # fmt: skip
# Without a mark; the second is Latin-1 as Windows writes it, with five bytes undefined.
_UNMARKED = ("utf-8", "cp1252")
_REMEDY = "save it as text in UTF-8"


def read_text(path: Path) -> str:
    r"""Text of a file, all line ends ``\n``: in UTF-8, UTF-16 or UTF-32 with a byte-order mark, or Latin-1.

    Raises
    ------
    ValueError
        If it is in none of these encodings, unpacks to too much, or begins with an endless line.
    """
    content = _content(path)
    marked = next((encoding for mark, encoding in _MARKS if content.startswith(mark)), None)
    if marked is None and b"\0" in content:
        raise ValueError(f"{path.name} holds binary data, or UTF-16 without a byte-order mark; {_REMEDY}")
    for encoding in _UNMARKED if marked is None else (marked,):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError as error:
            wrong = error.start
        else:
            return text.replace("\r\n", "\n").replace("\r", "\n")
    known = marked or "UTF-8, Latin-1, or UTF-16 with a byte-order mark"
    raise ValueError(f"{path.name} is not text in {known} (byte {wrong}); {_REMEDY}")


def _content(path: Path) -> bytes:
    if path.suffix.lower() != ".gz":
        with path.open("rb") as file:
            _check_first_line(path, file.read(_LONGEST_LINE + 1))
        return path.read_bytes()
    limit = largest_unpacked(path)
    with reading(path, "gzip"), gzip.open(path) as packed:
        start = packed.read(_LONGEST_LINE + 1)
        _check_first_line(path, start)
        content = start + packed.read(limit)
    if len(content) > limit:
        raise ValueError(
            f"{path.name} takes more than {limit / 1e9:.3g} GB when unpacked: unpack it, or split it"
        )
    return content


def _check_first_line(path: Path, start: bytes) -> None:
    if len(start) > _LONGEST_LINE and b"\n" not in start and b"\r" not in start:
        raise ValueError(
            f"{path.name} is no CSV file of samples: its first line is longer than {_LONGEST_LINE} "
            "characters; one row per sample is right"
        )
