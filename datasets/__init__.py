"""Recordings and published results: file readers, tables of the literature, measured gearbox vibration."""

from cyclofeat.datasets._oedi import load_oedi_gearbox
from cyclofeat.datasets._published import load_published_tables
from cyclofeat.datasets._readers import describe_recording, one_line, read_recording, write_recording

__all__ = [
    "describe_recording",
    "load_oedi_gearbox",
    "load_published_tables",
    "one_line",
    "read_recording",
    "write_recording",
]
