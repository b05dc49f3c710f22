"""Recordings and published results: file readers, tables of the literature, measured gearbox vibration."""

from cyclofeat.datasets._loaders import load_jelmerv_cycloidal, load_oedi_gearbox, load_published_tables
from cyclofeat.datasets._surrogate import make_rig_recording, make_rig_recordings, rig_preset
from cyclofeat.datasets.readers import (
    describe,
    read_folder,
    read_recording,
    write_recording,
)

__all__ = [
    "describe",
    "load_jelmerv_cycloidal",
    "load_oedi_gearbox",
    "load_published_tables",
    "make_rig_recording",
    "make_rig_recordings",
    "read_folder",
    "read_recording",
    "rig_preset",
    "write_recording",
]
