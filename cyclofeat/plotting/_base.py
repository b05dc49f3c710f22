"""What the displays share."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cyclofeat.recording import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

Float = NDArray[np.float64]


def require_matplotlib(extra: str = "plot") -> None:
    """Raise ``ImportError`` that names the ``extra`` to install, where matplotlib is missing."""
    try:
        import_module("matplotlib.figure")
    except ImportError as error:
        raise ImportError(f'drawing needs matplotlib: pip install "cyclofeat[{extra}]"') from error


def axes_for(ax: Axes | None, figsize: tuple[float, float]) -> tuple[Figure | SubFigure, Axes]:
    """The given axes and their figure, or new ones of ``figsize`` in inches.

    Raises
    ------
    ImportError
        If matplotlib is not installed.
    """
    require_matplotlib()
    if ax is None:
        import matplotlib.pyplot as plt

        _, ax = plt.subplots(figsize=figsize, layout="constrained")
    return ax.figure, ax


def input_speed_from_angle(recording: Recording, n_lobes: int, start: int, stop: int) -> float | None:
    """Mean input speed in turns per second over samples [start, stop); None without an angle."""
    angle = recording.input_angle(n_lobes)
    if angle is None:
        return None
    turns = float(angle[stop - 1] - angle[start]) / (2 * np.pi)
    return turns * recording.sampling_rate / (stop - 1 - start)


def line_column(values: object, name: str, unit: str) -> Float:
    """Finite 1-D float64 array of at least two values."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1 or array.size < 2:
        raise ValueError(f"{name} must be 1-D with at least 2 values ({unit}), got shape {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite ({unit}), got {array[~np.isfinite(array)][0]}")
    return array


def plain_log_ticks(ax: Axes) -> None:
    """Ticks of a logarithmic axis as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = ax.get_xlim()
    wide = high / low > 1e4
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.10g}"))
