"""Count and locate the worn lobes of a cycloidal disc from windows of output torque.

=========================  =================================================================================
module                     responsibility
=========================  =================================================================================
``cyclofeat.recordings``   ``Recording`` (one torque record) and ``Windower`` (recordings to windows)
``cyclofeat.signal``       pure functions of windows: spectra, orders, lobes, wavelets, statistics
``cyclofeat.features``     one scikit-learn transformer per diagnostic method
``cyclofeat.counting``     counters, calibration, refusal, evaluation grouped by assembly
``cyclofeat.models``       models on disk
``cyclofeat.gap``          what a simulation lacks to agree with recordings
``cyclofeat.plotting``     pictures of torque, spectrum, lobe map and gap
``cyclofeat.report``       self-contained HTML pages
``cyclofeat.simulators``   the cycloidal gearbox as a multibody system (numba), rigs, effects and campaigns
                           (folder ``simulators/`` at the top level)
``cyclofeat.datasets``     published tables, real recordings, surrogate rigs, file readers
                           (folder ``datasets/`` at the top level)
``cyclofeat.cli``          the ``cyclofeat`` command, one module per command
=========================  =================================================================================
"""

from importlib import import_module
from typing import Any

from cyclofeat._base import load_with

__version__ = "0.2.0"

_PUBLIC = {"Recording": "cyclofeat.recordings", "Windower": "cyclofeat.recordings"}

__all__ = ["Recording", "Windower", "__version__"]

# ``plot`` of recordings and results needs displays, which lie above them: only the root may know both.
load_with(lambda: import_module("cyclofeat.plotting"))


def __getattr__(name: str) -> Any:
    # Loaded on first use, so that "import cyclofeat" stays fast.
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
