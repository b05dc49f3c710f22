"""Angle and order domain: pure functions of torque and shaft angle.

Angles are in rad. The input shaft's angle phi increases as the machine runs; order k means k times per turn
of the input shaft. A disc with z_s lobes turns z_s times slower than the input, and against it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import firwin, kaiser_beta, upfirdn

Float = NDArray[np.float64]

# Anti-alias filter: flat up to 0.8 of the new Nyquist order, 80 dB down from that order on. By Kaiser's
# formula this takes (80 - 7.95) / (2.285 * 0.2 pi) = 50.2 samples of the result, hence 26 on either side.
_STOPBAND_DB = 80.0
_CUTOFF = 0.9
_HALF_WIDTH = 26
# Below this share of the median speed a turn holds so many samples that the grid would outgrow the record.
_SLOWEST_SHARE = 1 / 16
_SPEED_STEPS_PER_TURN = 8


def input_angle_from_disc(angle: ArrayLike, reduction: int = 15) -> Float:
    """Angle of the input shaft from the angle of the disc (wheel 0).

    Solves the rest position theta_1 = -(phi + pi) / z_s for phi. Both angles count counter-clockwise, so the
    disc's angle falls while the input's rises. The small rotation of the disc under load is left out.

    Parameters
    ----------
    angle : array_like of shape (n,)
        Angle theta_1 of the disc in rad, counter-clockwise positive.
    reduction : int, default 15
        Number of lobes z_s = input turns per turn of the disc.

    Returns
    -------
    ndarray of shape (n,)
        Angle phi of the input shaft in rad.

    Examples
    --------
    >>> import numpy as np
    >>> phi = np.array([0.0, 1.0, 2.0])
    >>> np.round(input_angle_from_disc(-(phi + np.pi) / 15), 12).tolist()
    [0.0, 1.0, 2.0]
    """
    return np.asarray(-reduction * np.asarray(angle, dtype=np.float64) - math.pi, dtype=np.float64)


def resample_by_angle(
    torque: ArrayLike, angle: ArrayLike, samples_per_turn: int, sampling_rate: float
) -> tuple[Float, Float]:
    """Torque at equal steps of the shaft angle, without aliasing.

    The result lies on whole multiples of ``2 pi / samples_per_turn`` from the angle's own zero, so records of
    one absolute angle share one grid. Torque is interpolated by a cubic spline in time, at times that are
    linear in between the samples of the angle. Where a turn of the record holds more samples than
    ``samples_per_turn``, the torque is first put on a finer grid and low-passed there: the filter cuts at a
    fixed *order*, however the speed varies.

    Parameters
    ----------
    torque : array_like of shape (n,)
        Torque in Nm, sampled uniformly in time.
    angle : array_like of shape (n,)
        Angle of the shaft in rad at the same moments, strictly increasing.
    samples_per_turn : int
        Samples per turn of the result.
    sampling_rate : float
        Samples per second of torque and angle, in Hz.

    Returns
    -------
    torque : ndarray of shape (m,)
        Torque in Nm at the angles below.
    angle : ndarray of shape (m,)
        Angles in rad, ``2 pi / samples_per_turn`` apart.

    Raises
    ------
    ValueError
        If shapes differ, values are not finite, the angle does not increase, the record is too short for the
        filter, or the shaft nearly stands still (below 1/16 of its median speed) where a low-pass is needed.

    Notes
    -----
    With the low-pass, orders up to ``0.4 * samples_per_turn`` pass unchanged and orders from
    ``0.5 * samples_per_turn`` on are 80 dB down. Only samples whose whole filter lies inside the record are
    returned, so that no padding enters: the result is then 26 samples shorter at either end than the angle's
    range. Between the samples the spline is true to 1 % up to a fifth of the sampling rate, to 0.1 % up to a
    tenth; next to the record's ends it is less accurate.

    Examples
    --------
    A torque of order 4 keeps its shape while the speed rises from 5 to 10 turns per second:

    >>> import numpy as np
    >>> time = np.arange(20_000) / 10_000
    >>> phi = 2 * np.pi * (5 * time + 1.25 * time**2)
    >>> torque, grid = resample_by_angle(22 + np.cos(4 * phi), phi, 256, 10_000)
    >>> bool(np.max(np.abs(torque - 22 - np.cos(4 * grid))) < 1e-3)
    True
    """
    torque, angle = _checked(torque, angle)
    step = 2 * math.pi / _checked_samples_per_turn(samples_per_turn)
    if not (np.isfinite(sampling_rate) and sampling_rate > 0):
        raise ValueError(f"sampling_rate must be positive and finite (Hz), got {sampling_rate!r}")

    fine = _refinement(angle, samples_per_turn, sampling_rate)
    # Rounding must not cost the first or last point where the record begins or ends on the grid.
    first = math.ceil(angle[0] / step - 1e-9)
    last = math.floor(angle[-1] / step + 1e-9)
    margin = 0 if fine == 1 else _HALF_WIDTH
    if last - first < 2 * margin:
        raise ValueError(
            f"angle covers {(angle[-1] - angle[0]) / (2 * math.pi):.3g} turns, too few to resample at "
            f"samples_per_turn = {samples_per_turn}: needed are {(2 * margin + 2) / samples_per_turn:.3g}"
        )
    spline = CubicSpline(np.arange(torque.size), torque)
    fine_grid = np.arange(first * fine, last * fine + 1) * (step / fine)
    values: Float = spline(np.interp(fine_grid, angle, np.arange(angle.size)))
    grid = np.arange(first + margin, last - margin + 1) * step
    if fine == 1:
        return values, grid
    taps = firwin(2 * margin * fine + 1, _CUTOFF / fine, window=("kaiser", kaiser_beta(_STOPBAND_DB)))
    # Index k of upfirdn's result is centred on coarse sample k - margin: those from 2 * margin to the end of
    # the input have the whole filter inside the record.
    filtered: Float = upfirdn(taps, values, 1, fine)[2 * margin : last - first + 1]
    return filtered, grid


def _refinement(angle: Float, samples_per_turn: int, sampling_rate: float) -> int:
    """How many times finer than the result the grid must be, to hold all that the record holds."""
    turns = (angle[-1] - angle[0]) / (2 * math.pi)
    # Speed over eighths of a turn: from sample to sample a noisy angle would give any speed.
    marks = angle[0] + 2 * math.pi / _SPEED_STEPS_PER_TURN * np.arange(int(turns * _SPEED_STEPS_PER_TURN) + 1)
    if marks.size < 2:
        densest = (angle.size - 1) / turns
    else:
        position = np.interp(marks, angle, np.arange(angle.size))
        density = np.diff(position) * _SPEED_STEPS_PER_TURN
        slowest = int(np.argmax(density))
        densest, usual = float(density[slowest]), float(np.median(density))
        if densest > samples_per_turn and densest > usual / _SLOWEST_SHARE:
            raise ValueError(
                f"the shaft nearly stands still at t = {position[slowest] / sampling_rate:.3g} s "
                f"({sampling_rate / densest:.2g} Hz, median {sampling_rate / usual:.3g} Hz): "
                "leave the start-up or standstill out of the record (Windower: skip_s)"
            )
    # A record that holds no more than the result needs no filter; half a sample is rounding, not content.
    return 1 if densest < samples_per_turn + 0.5 else math.ceil(densest / samples_per_turn)


def _checked(torque: ArrayLike, angle: ArrayLike) -> tuple[Float, Float]:
    torque = np.asarray(torque, dtype=np.float64)
    angle = np.asarray(angle, dtype=np.float64)
    if torque.ndim != 1 or torque.shape != angle.shape or torque.size < 2:
        raise ValueError(
            "torque and angle must be 1-D, of equal length and hold at least 2 samples, "
            f"got shapes {torque.shape} and {angle.shape}"
        )
    for name, values in (("torque", torque), ("angle", angle)):
        if not np.all(np.isfinite(values)):
            raise ValueError(f"{name} must be finite, got {values[~np.isfinite(values)][0]}")
    steps = np.diff(angle)
    if not np.all(steps > 0):
        where = int(np.argmax(steps <= 0))
        raise ValueError(
            f"angle must increase strictly (rad), got {angle[where]:.6g} at sample {where} "
            f"and {angle[where + 1]:.6g} at sample {where + 1}"
        )
    return torque, angle


def _checked_samples_per_turn(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 2:
        raise ValueError(f"samples_per_turn must be a whole number of at least 2, got {value!r}")
    return int(value)
