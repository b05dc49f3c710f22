"""Recordings and published results: file readers, tables of the literature, measured gearbox vibration."""

from cyclofeat.datasets._jelmerv import load_jelmerv_cycloidal
from cyclofeat.datasets._oedi import load_oedi_gearbox
from cyclofeat.datasets._published import load_published_tables
from cyclofeat.datasets._surrogate import make_rig_recording, make_rig_recordings, rig_preset
from cyclofeat.datasets.readers import (
    describe,
    describe_recording,
    one_line,
    read_folder,
    read_recording,
    record_warnings,
    write_recording,
)

__all__ = [
    "describe",
    "describe_recording",
    "load_jelmerv_cycloidal",
    "load_oedi_gearbox",
    "load_published_tables",
    "make_rig_recording",
    "make_rig_recordings",
    "one_line",
    "read_folder",
    "read_recording",
    "record_warnings",
    "rig_preset",
    "write_recording",
]
