"""Recordings and published results: file readers, tables of the literature, measured gearbox vibration."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from cyclofeat.datasets.readers import describe, read_folder, read_recording, write_recording

if TYPE_CHECKING:
    from cyclofeat.datasets._loaders import load_jelmerv_cycloidal, load_oedi_gearbox, load_published_tables
    from cyclofeat.datasets._surrogate import make_rig_recording, make_rig_recordings, rig_preset

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

if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        # Loaded on first use: to read a recording needs neither tables nor rigs.
        if name in __all__:
            module = "_loaders" if name.startswith("load_") else "_surrogate"
            return getattr(import_module(f"{__name__}.{module}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
