"""Angle and order domain: pure functions of torque, shaft angle and input speed.

Angles are in rad. The input shaft's angle phi increases as the machine runs; order k means k times per turn
of the input shaft. A disc with z_s lobes turns z_s times slower than the input, and against it.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import firwin, kaiser_beta, kaiserord, upfirdn, zoom_fft

from cyclofeat._base.checks import number_series, one_of, positive, whole
from cyclofeat.signal import lobes
from cyclofeat.signal.windows import Complex, Float, as_windows

# Anti-alias filter: flat up to 0.8 of the new Nyquist order, 80 dB down from that order on. By Kaiser's
# formula this takes (80 - 7.95) / (2.285 * 0.2 pi) = 50.2 samples of the result, hence 26 on either side.
_STOPBAND_DB = 80.0
_CUTOFF = 0.9
_HALF_WIDTH = 26
# Below this share of the median speed a turn holds so many samples that the grid would outgrow the record.
_SLOWEST_SHARE = 1 / 16
_SPEED_STEPS_PER_TURN = 8
# Samples that are read at a time; those on either side that a spline depends on, the next by 0.27 each.
_PIECE, _SEEN = 2**16, 40

# Order lines are read at a reduced rate, this many times the highest line; what folds down is 100 dB down.
_RATE_PER_HIGHEST_LINE = 4
_ALIAS_DB = 100.0


def mean_speed(angle: ArrayLike, sampling_rate: float) -> Float:
    """Mean speed of rotation in turns per second, shape (...), of unwrapped angles in rad, shape (..., n)."""
    angles = np.asarray(angle, dtype=float)
    turned = angles[..., -1] - angles[..., 0]
    return np.asarray(turned / (2 * np.pi * (angles.shape[-1] - 1)) * sampling_rate)


def samples_at(angles: Float, angle: Float) -> Float:
    """Return between which samples a shaft of increasing ``angle`` (n,) passes ``angles`` (m,), all in rad.

    Fractional numbers of samples from 0, by linear interpolation; outside the record its first or last.
    ``numpy.interp`` gives the same, but takes two more arrays as long as the record.
    """
    angles = np.clip(angles, angle[0], angle[-1])
    before = np.clip(np.searchsorted(angle, angles, side="right") - 1, 0, angle.size - 2)
    start = angle[before]
    return np.asarray(1.0 / (angle[before + 1] - start) * (angles - start) + before)


def at_every_sample(n_samples: int, known: NDArray[Any], values: Float) -> Float:
    """Return straight lines between ``values`` at increasing samples ``known``, at all ``n_samples``.

    ``numpy.interp`` gives the same, but takes several more arrays as long as the record.
    """
    line = np.empty(n_samples)
    for first in range(0, n_samples, _PIECE):
        last = min(first + _PIECE, n_samples)
        low = max(int(np.searchsorted(known, first, side="right")) - 1, 0)
        high = int(np.searchsorted(known, last - 1)) + 1
        line[first:last] = np.interp(np.arange(first, last), known[low:high], values[low:high])
    return line


def resample_by_angle(
    torque: ArrayLike, angle: ArrayLike, samples_per_turn: int, sampling_rate: float
) -> tuple[Float, Float]:
    """Resample torque to equal steps of the shaft angle, without aliasing; return both, shape (m,).

    ``torque`` in Nm and ``angle`` of the shaft in rad, strictly increasing, have the shape (n,) and are
    sampled at ``sampling_rate`` Hz. The result lies on whole multiples of ``2 pi / samples_per_turn`` from
    the angle's zero, so records of one absolute angle share one grid. Torque is interpolated by a cubic
    spline in time, accurate to 1 % up to a fifth of the sampling rate, to 0.1 % up to a tenth. Where a turn
    of the record holds more samples than ``samples_per_turn``, the torque is first low-passed on a finer
    grid, at a fixed *order*: orders up to ``0.4 * samples_per_turn`` pass unchanged and orders from ``0.5 *
    samples_per_turn`` on are 80 dB down; the result is then 26 samples shorter at either end than the angle's
    range.

    ``ValueError`` if shapes differ, values are not finite, the angle does not increase, the record is too
    short for the filter, or the shaft nearly stands still (below 1/16 of its median speed) where a low-pass
    is needed.
    """
    torque, angle = number_series("torque", torque, least=2), number_series("angle", angle, least=2)
    if torque.size != angle.size:
        raise ValueError(f"angle must have the length of torque, {torque.size}, got {angle.size}")
    if not np.all(np.diff(angle) > 0):
        where = int(np.argmax(np.diff(angle) <= 0))
        raise ValueError(
            f"angle must increase strictly (rad), got {angle[where]:.6g} at sample {where} "
            f"and {angle[where + 1]:.6g} at sample {where + 1}"
        )
    step = 2 * math.pi / whole("samples_per_turn", samples_per_turn, least=2)
    positive("sampling_rate", sampling_rate)
    # Return how many times finer than the result the grid must be to hold the whole record.
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
    fine = 1 if densest < samples_per_turn + 0.5 else math.ceil(densest / samples_per_turn)
    # Rounding must not cost the first or last point where the record begins or ends on the grid.
    first = math.ceil(angle[0] / step - 1e-9)
    last = math.floor(angle[-1] / step + 1e-9)
    margin = 0 if fine == 1 else _HALF_WIDTH
    if last - first < 2 * margin:
        raise ValueError(
            f"angle covers {(angle[-1] - angle[0]) / (2 * math.pi):.3g} turns, too few to resample at "
            f"samples_per_turn = {samples_per_turn}: needed are {(2 * margin + 2) / samples_per_turn:.3g}"
        )
    numbers = np.arange(first * fine, last * fine + 1)
    values = np.empty(numbers.size)
    # A long record is read in pieces: a spline hardly knows of samples that are some dozens away.
    for start in range(0, numbers.size, _PIECE):
        place = samples_at(np.asarray(numbers[start : start + _PIECE] * (step / fine), dtype=float), angle)
        low, high = max(int(place[0]) - _SEEN, 0), int(place[-1]) + 2 + _SEEN
        part = torque[low:high]
        values[start : start + _PIECE] = CubicSpline(np.arange(part.size), part)(place - low)
    grid = np.arange(first + margin, last - margin + 1) * step
    if fine == 1:
        return values, grid
    taps = _order_filter(fine)
    # Index k of upfirdn's result is centred on coarse sample k - margin: those from 2 * margin to the end of
    # the input have the whole filter inside the record.
    filtered: Float = upfirdn(taps, values, 1, fine)[2 * margin : last - first + 1]
    return filtered, grid


@functools.lru_cache(maxsize=16)
def _order_filter(fine: int) -> Float:
    """Return the low-pass of a grid that is so many times finer than its result, read-only."""
    window = ("kaiser", kaiser_beta(_STOPBAND_DB))
    return lobes._make_read_only(firwin(2 * _HALF_WIDTH * fine + 1, _CUTOFF / fine, window=window))


COMBS = ("lobe", "mesh")
"""Combs of lines that give the input speed."""


def comb_lines(
    sampling_rate: float, nominal_hz: float, tolerance: float, comb: str = "lobe", n_lobes: int = 15
) -> int:
    """Return the number of lobe lines for a speed, at most 44; ValueError if the rate holds too few."""
    one_of("comb", comb, COMBS)
    fewest = n_lobes if comb == "mesh" else lobes.FEWEST_LINES
    fitting = int(sampling_rate / 2 / lobes.highest_frequency(nominal_hz, n_lobes, 1, tolerance))
    if fitting < fewest:
        needed = 2 * lobes.highest_frequency(nominal_hz, n_lobes, fewest, tolerance)
        raise ValueError(
            f"sampling_rate={sampling_rate:g} is too low to find an input speed near {nominal_hz:g}: "
            f"at least {needed:g} is needed"
        )
    return min(fitting, max(lobes.N_LINES, n_lobes))


def estimate_input_speed(
    X: ArrayLike,
    sampling_rate: float,
    nominal_hz: float,
    tolerance: float = 0.015,
    comb: str = "lobe",
    n_lobes: int = 15,
) -> Float:
    """Estimate the input speed of each window from its lobe lines or its mesh lines, in turns per second.

    The lobe lines are the multiples of (z_s + 1)/z_s of the input speed; every z_s-th of them is a mesh line
    (order z_s + 1). The speed is the one, of 301 within the relative ``tolerance`` of ``nominal_hz`` (0
    returns that), whose comb stands out most over the local floor
    (:func:`cyclofeat.signal.lobes.lobe_lines`). ``comb="lobe"`` takes all lobe lines from the fifth to the
    44th; ``"mesh"`` the mesh lines among them alone, for torque in which the lobes do not differ. Other
    arguments are those of :func:`order_lines`.

    In windows of one output turn (1.8 s at 500 RPM) whose comb stands 10 dB out of the noise the estimate is
    within 0.03 % of the truth. For torque without such lines and for windows of few turns it is any speed
    within the tolerance.
    """
    if not 0 <= tolerance <= 0.2:
        raise ValueError(f"tolerance must be from 0 to 0.2 (a share of the speed), got {tolerance!r}")
    positive("nominal_hz", nominal_hz)
    X = as_windows(X)
    if X.ndim != 2:
        raise ValueError(f"X must have the shape (n_windows, n_samples), got {X.shape}")
    if tolerance == 0:
        return np.full(len(X), float(nominal_hz))
    n_lines = comb_lines(sampling_rate, nominal_hz, tolerance, comb, n_lobes)
    searched = range(n_lobes, n_lines + 1, n_lobes) if comb == "mesh" else None
    lines = lobes.LobeComb(n_lobes, n_lines, speed_tolerance=tolerance, searched=searched)
    return lobes.lobe_lines(np.asarray(X, dtype=float), sampling_rate, nominal_hz, lines).input_speed_hz


def order_lines(
    X: ArrayLike, sampling_rate: float, input_speed_hz: ArrayLike, n_lines: int, n_lobes: int = 15
) -> Complex:
    r"""Compute complex amplitudes of the torque at the lines of the output turn.

    .. math:: c_k = \frac{2}{L} \sum_{n=0}^{L-1} (x_n - \bar x) e^{-2 \pi j k f n / f_s}

    with f = the input speed over z_s (line k is order k/15 for 15 lobes) and the L samples of the largest
    whole number of output turns in the window. Over whole turns the lines do not disturb each other, and what
    does not repeat with the turn averages out: these are the lines of the torque's synchronous average,
    however high its resolution.

    Parameters
    ----------
    X : array-like, shape (n_windows, n_samples)
        Windows of torque in Nm.
    sampling_rate : float
        Samples per second in Hz (samples per input turn for windows on equal steps of the angle, with
        ``input_speed_hz=1``).
    input_speed_hz : array-like, shape (n_windows,)
        Input speed of each window in turns per second, as from :func:`estimate_input_speed`.
    n_lines : int
        Number of lines.
    n_lobes : int, default=15
        Number of lobes z_s of a disc; 1 gives the lines of the input turn.

    Returns
    -------
    ndarray of complex, shape (n_windows, n_lines)
        Amplitudes in Nm of lines k = 1, 2, ...: the torque holds Re(c_k exp(2 pi i k f t)), t = 0 at the
        first sample. True to 1e-4 of the largest amplitude in the window.

    Notes
    -----
    The number of turns is rounded: a window that misses half a turn or less of a whole number is taken whole,
    and so is a window of less than half a turn. Constant windows have lines 0.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.signal.orders import order_lines
    >>> phase = 2 * np.pi * 500 / 60 * np.arange(46_080) / 25_600
    >>> torque = 22 + 3 * np.cos(16 / 15 * phase)
    >>> lines = order_lines(torque[np.newaxis], 25_600, [500 / 60], 20)
    >>> print(np.abs(lines[0, 14:17]).round(3))  # orders 15/15, 16/15, 17/15
    [0. 3. 0.]
    """
    X = as_windows(X)
    speeds = np.asarray(input_speed_hz, dtype=np.float64)
    if X.ndim != 2 or speeds.shape != X.shape[:1]:
        raise ValueError(
            "X must have the shape (n_windows, n_samples) and input_speed_hz (n_windows,), "
            f"got {X.shape} and {speeds.shape}"
        )
    first = speeds * (1 / n_lobes)
    if not (speeds > 0).all():
        raise ValueError(f"input_speed_hz must be positive, got {speeds[~(speeds > 0)][0]}")
    whole("n_lines", n_lines, 1)
    highest = float(first.max(initial=0.0)) * n_lines
    if highest > sampling_rate / 2:
        raise ValueError(
            f"line {n_lines} lies at {highest:g}, beyond half of the sampling rate, {sampling_rate / 2:g}"
        )
    lines = np.empty((len(X), n_lines), dtype=np.complex128)
    if not len(X):
        return lines
    factor = max(1, int(sampling_rate / (_RATE_PER_HIGHEST_LINE * highest)))
    if factor > 1:
        # Nothing up to the highest line may be disturbed by what folds down onto it.
        stop = sampling_rate / factor - highest
        n_taps, beta = kaiserord(_ALIAS_DB, 2 * (stop - highest) / sampling_rate)
        taps: Float = firwin(n_taps | 1, (highest + stop) / 2, window=("kaiser", beta), fs=sampling_rate)
    for row, (x, line) in enumerate(zip(X, first, strict=True)):
        turns = round(x.size * line / sampling_rate)
        turned = x[: min(x.size, round(turns * sampling_rate / line)) or x.size].astype(np.float64)
        turned -= turned[0]  # a constant then leaves no rounding
        turned -= turned.mean()
        step = 2 * math.pi * line / sampling_rate
        if factor == 1:
            sums = _fourier_sums(turned, step, n_lines)
        else:
            thinned = upfirdn(taps, turned, 1, factor)
            gain = _fourier_sums(taps, step, n_lines)  # with the filter's delay
            sums = factor * _fourier_sums(thinned, step * factor, n_lines) / gain
        lines[row] = 2 / turned.size * sums
    return lines


def _fourier_sums(x: Float, step: float, n_lines: int) -> Complex:
    """Sums of ``x[n] exp(-i k step n)`` for k = 1 to ``n_lines``."""
    return np.asarray(zoom_fft(x, [step, (n_lines + 1) * step], n_lines, fs=2 * math.pi))


def synchronous_average(lines: Complex, n_points: int) -> Float:
    """Average the torque over output turns, or input turns, from the lines of that turn.

    ``lines`` are those of :func:`order_lines`. The result, shape (n_windows, n_points), is the torque in Nm
    without its mean, band-limited to the lines; the first point is the window's first sample.
    """
    whole("n_points", n_points, 1)
    return lobes.fold(lines, n_lobes=1, points=n_points, lowest_line=1)[:, 0]
