"""Torque records from and to files.

| module | job |
|---|---|
| `_read` | one record from a file of any kind, and back to a file |
| `_columns` | names, units, quantities and numbers that all kinds of files share |
| `_times` | sampling rate from a column of times, with its jitter and gaps |
| `_csv`, `_npz`, `_tdms`, `_matlab`, `_parquet`, `_wav`, `_xlsx` | one kind of file each |
| `_text` | text in any encoding, packed or not |
| `_labels` | labels as files hold them |
| `_folder` | a folder with its manifest |
| `_describe` | content of a record, and what would spoil a count |
"""

from cyclofeat.datasets.readers._columns import Source as Source
from cyclofeat.datasets.readers._describe import describe as describe
from cyclofeat.datasets.readers._describe import describe_recording as describe_recording
from cyclofeat.datasets.readers._describe import one_line as one_line
from cyclofeat.datasets.readers._describe import record_warnings as record_warnings
from cyclofeat.datasets.readers._folder import MANIFEST as MANIFEST
from cyclofeat.datasets.readers._folder import Entry as Entry
from cyclofeat.datasets.readers._folder import folder_entries as folder_entries
from cyclofeat.datasets.readers._folder import read_folder as read_folder
from cyclofeat.datasets.readers._read import SOURCES as SOURCES
from cyclofeat.datasets.readers._read import list_channels as list_channels
from cyclofeat.datasets.readers._read import read_recording as read_recording
from cyclofeat.datasets.readers._read import write_recording as write_recording
