"""Torque records from and to files.

| module | job |
|---|---|
| `_read` | one record from a file of any kind, and back to a file |
| `_columns` | names, units and numbers that all kinds of files share |
| `_quantities` | quantity of a channel, by its name and its unit |
| `_times` | sampling rate from a column of times, with its jitter and gaps |
| `_csv`, `_npz`, `_tdms`, `_matlab`, `_parquet`, `_wav`, `_xlsx` | one kind of file each |
| `_text` | text in any encoding, packed or not |
| `_labels` | labels as files hold them |
| `_folder` | a folder with its manifest |
| `_describe` | content of a record, and what would spoil a count |
"""

from cyclofeat.datasets.readers._columns import Source
from cyclofeat.datasets.readers._describe import describe, describe_recording, one_line, record_warnings
from cyclofeat.datasets.readers._folder import MANIFEST, Entry, folder_entries, read_folder
from cyclofeat.datasets.readers._npz import load_arrays
from cyclofeat.datasets.readers._read import (
    SOURCES,
    ReadingOptions,
    list_channels,
    read_recording,
    write_recording,
)

__all__ = [
    "MANIFEST",
    "SOURCES",
    "Entry",
    "ReadingOptions",
    "Source",
    "describe",
    "describe_recording",
    "folder_entries",
    "list_channels",
    "load_arrays",
    "one_line",
    "read_folder",
    "read_recording",
    "record_warnings",
    "write_recording",
]
