"""Count and locate the worn lobes of a cycloidal disc from windows of output torque.

========================  =========================================================================
module                    responsibility
========================  =========================================================================
``cyclofeat.recording``   ``Recording`` (one torque record) and ``Windower`` (recordings to windows)
``cyclofeat.spectral``    pure functions of windows: PSD, spectral entropy, statistics
``cyclofeat.orders``      pure functions: speed estimation, angle resampling, folding into lobes
``cyclofeat.features``    one scikit-learn transformer per diagnostic method
``cyclofeat.counting``    classifiers, ready pipelines, evaluation grouped by assembly
``cyclofeat.plotting``    pictures of torque, spectrum and lobe map
``cyclofeat.report``      self-contained HTML reports
``cyclofeat.persistence`` models on disk
``cyclofeat.simulators``  the cycloidal gearbox as a multibody system (numba)
``cyclofeat.datasets``    published tables, real recordings, surrogate rig, file readers
========================  =========================================================================
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "Recording": "cyclofeat.recording",
    "Windower": "cyclofeat.recording",
}

__all__ = ["Recording", "Windower", "__version__"]


def __getattr__(name: str) -> Any:
    # Loaded on first use, so that "import cyclofeat" stays fast.
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
