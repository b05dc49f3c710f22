"""Torque records from and to files: a source for each kind of file lists channels, `_read` chooses one."""

from cyclofeat.datasets.readers._columns import Channel as Channel
from cyclofeat.datasets.readers._columns import Source as Source
from cyclofeat.datasets.readers._describe import describe as describe
from cyclofeat.datasets.readers._describe import one_line as one_line
from cyclofeat.datasets.readers._describe import record_warnings as record_warnings
from cyclofeat.datasets.readers._folder import MANIFEST as MANIFEST
from cyclofeat.datasets.readers._folder import Entry as Entry
from cyclofeat.datasets.readers._folder import folder_entries as folder_entries
from cyclofeat.datasets.readers._folder import read_folder as read_folder
from cyclofeat.datasets.readers._folder import write_folder as write_folder
from cyclofeat.datasets.readers._read import RECORDINGS as RECORDINGS
from cyclofeat.datasets.readers._read import SOURCES as SOURCES
from cyclofeat.datasets.readers._read import list_channels as list_channels
from cyclofeat.datasets.readers._read import read_recording as read_recording
from cyclofeat.datasets.readers._read import write_recording as write_recording
