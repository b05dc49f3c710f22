"""Windows of one output turn on equal steps of the input shaft's angle, at any speed."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import resample_poly

from cyclofeat.recordings._recording import Recording
from cyclofeat.recordings._windower import Cut, WindowSet, window_set
from cyclofeat.signal.orders import resample_by_angle
from cyclofeat.signal.windows import Float

__all__ = ["SAMPLES_PER_TURN", "WINDOW_TURNS", "shaft_windows"]

#: Samples per input turn of the windows. They hold 44 lobe lines.
SAMPLES_PER_TURN = 128
#: Share of an output turn that a window covers: a recording of whole turns at the nominal speed holds as many
#: windows although its true speed is a per cent lower.
WINDOW_TURNS = 0.98

# Samples per turn that are left to the interpolation, in multiples of the result's.
_DENSE = 2.5
# Turns by which a recording is continued at either end, where the filters settle.
_MARGIN_TURNS = 0.35


def shaft_windows(recordings: Sequence[Recording], angles: Sequence[Float], n_lobes: int) -> WindowSet:
    """Cut recordings into windows on equal steps of the input shaft's angle.

    Parameters
    ----------
    recordings : sequence of Recording
    angles : sequence of ndarray
        Angle of the input shaft in rad at the samples of each recording, strictly increasing.
    n_lobes : int
        Input turns per output turn.

    Returns
    -------
    WindowSet
        Of :data:`WINDOW_TURNS` of an output turn each, one after the other from the first sample of a
        recording on. The ``sampling_rate`` is in samples per input turn. Where the mean torque is negative,
        its sign is changed: conventions differ between rigs.

    Raises
    ------
    ValueError
        If a recording is shorter than a window or holds fewer than 128 samples per turn.
    """
    cuts = [_cut(recording, angle, n_lobes) for recording, angle in zip(recordings, angles, strict=True)]
    return window_set(recordings, cuts, float(SAMPLES_PER_TURN))


def _cut(recording: Recording, angle: Float, n_lobes: int) -> Cut:
    rate = recording.sampling_rate
    turns = float(np.ptp(angle)) / (2 * np.pi)
    length = round(WINDOW_TURNS * n_lobes * SAMPLES_PER_TURN)
    if turns * SAMPLES_PER_TURN < length:
        raise ValueError(
            f"the recording is too short: it lasts {recording.duration:.4g} s and holds {turns:.4g} input "
            f"turns, a window of one output turn needs {WINDOW_TURNS * n_lobes:g}"
        )
    per_turn = angle.size / turns
    if per_turn < SAMPLES_PER_TURN:
        raise ValueError(
            f"sampling_rate must be at least {SAMPLES_PER_TURN * rate / per_turn:.5g} Hz at "
            f"{60 * rate / per_turn:.5g} RPM ({SAMPLES_PER_TURN} samples per input turn hold the lobe "
            f"lines), got {rate:g} Hz"
        )
    torque, grid = _on_grid(recording.torque, angle, rate, per_turn)
    starts = np.arange(torque.size // length) * length
    windows = np.lib.stride_tricks.sliding_window_view(torque, length)[starts]
    if np.any(np.ptp(windows, axis=1) == 0):
        raise ValueError(
            f"the recording is constant ({recording.torque[0]:g} Nm) over a whole window: nothing can be "
            "diagnosed from it (sensor dead or not connected?)"
        )
    at = np.interp(grid[starts], angle, np.arange(angle.size))
    return windows, at / rate, grid[starts]


def _on_grid(torque: Float, angle: Float, rate: float, per_turn: float) -> tuple[Float, Float]:
    """Return torque without its mean, and positive for a load that brakes, on the grid of the angle."""
    mean = float(torque.mean())
    centred = (torque - mean) * (-1.0 if mean < 0 else 1.0)
    thinning = max(1, int(per_turn / (SAMPLES_PER_TURN * _DENSE)))
    margin = math.ceil(_MARGIN_TURNS * per_turn / thinning) * thinning
    margin = min(margin, (torque.size - 1) // thinning * thinning)
    longer, turning = _continued(centred, margin), _continued(angle, margin)
    if thinning > 1:
        longer = resample_poly(longer, 1, thinning)
        turning = turning[::thinning]
    even, grid = resample_by_angle(longer, turning, SAMPLES_PER_TURN, rate / thinning)
    inside = (grid >= angle[0] - 1e-9) & (grid <= angle[-1] + 1e-9)
    return even[inside], grid[inside]


def _continued(values: Float, margin: int) -> Float:
    """Continue a curve by its point reflection at either end: neither value nor slope has a step there."""
    before = 2 * values[0] - values[margin:0:-1]
    return np.concatenate([before, values, 2 * values[-1] - values[-2 : -margin - 2 : -1]])
