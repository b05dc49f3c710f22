"""Windows of one output turn on equal steps of the input shaft's angle, at any speed."""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import resample_poly

from cyclofeat.recordings._recording import Recording
from cyclofeat.recordings._windower import WindowSet, windows_of_one
from cyclofeat.signal.orders import resample_by_angle
from cyclofeat.signal.windows import Float

__all__ = ["RESOLUTIONS", "WINDOW_TURNS", "shaft_windows"]

#: Samples per input turn of windows: the most that a recording holds are taken.
RESOLUTIONS = (320, 160, 80, 40)
#: Share of an output turn that a window covers. A recording of a whole number of turns at the nominal speed
#: holds as many windows although its true speed is a per cent lower.
WINDOW_TURNS = 0.98

# Samples per turn that are left to the interpolation, in multiples of the result's.
_DENSE = 2.5
# Samples of the result by which a recording is continued at either end, where the filters settle.
_MARGIN = 40


def shaft_windows(recording: Recording, angle: Float, n_lobes: int) -> WindowSet:
    """Cut a recording into windows on equal steps of the shaft's angle.

    Parameters
    ----------
    recording : Recording
    angle : ndarray, shape (n,)
        Angle of the input shaft in rad at the samples, strictly increasing.
    n_lobes : int
        Input turns per output turn.

    Returns
    -------
    WindowSet
        Of :data:`WINDOW_TURNS` of an output turn each, one after the other from the first sample on. The
        ``sampling_rate`` is in samples per input turn. Torque whose mean is negative changes its sign:
        conventions differ between rigs.

    Raises
    ------
    ValueError
        If the recording is shorter than a window, or holds fewer than 40 samples per turn.
    """
    turns = np.ptp(angle) / (2 * np.pi)
    per_turn, fastest = _resolution(angle)
    length = round(WINDOW_TURNS * n_lobes * per_turn)
    n_windows = math.floor(turns * per_turn / length + 1e-9)
    if n_windows < 1:
        raise ValueError(
            f"the recording is too short: it lasts {recording.duration:.4g} s and holds {turns:.4g} turns of "
            f"the input, a window of one output turn needs {WINDOW_TURNS * n_lobes:g}"
        )
    torque, grid = _on_grid(recording, angle, per_turn, fastest)
    starts = np.arange(n_windows) * length
    at = np.interp(grid[starts], angle, np.arange(angle.size))
    windows = torque[: n_windows * length].reshape(n_windows, length)
    return windows_of_one(
        recording, windows, float(per_turn), start_s=at / recording.sampling_rate, start_angle=grid[starts]
    )
