"""Angle, speed and acceleration of the input, and load, over time."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import cumulative_trapezoid

from cyclofeat._base.checks import short
from cyclofeat.simulators._lines import on_lines
from cyclofeat.simulators.gearbox import CycloidalGearbox

__all__ = ["Courses", "TimeCourse", "drive_and_load"]

Float = NDArray[np.float64]
TimeCourse = float | ArrayLike | Callable[[Float], ArrayLike]

_GRID = 2**16  # times are made in blocks, so that runs of different length share them
MARGIN = 40  # samples that a run is longer than its result, for the anti-alias filter


@dataclass(frozen=True, eq=False)
class Courses:
    """Input speed and load of one run over time, in place of the gearbox's.

    Each is a number, an array with one value per sample of the result (linearly interpolated), or a function
    that takes times of shape (n,) in s and returns as many values.

    Parameters
    ----------
    speed, load : float, array or function of time, optional
        Input speed in rad/s and load torque in Nm. Only a number rises over the gearbox's ramp.
    speed_fluctuation, load_fluctuation : float, array or function of time, optional
        Added to input speed (rad/s) and load torque (Nm), under the ramp.

    Examples
    --------
    >>> swelling = Courses(load=20.0, load_fluctuation=lambda t: 2 * np.sin(30 * t))
    """

    speed: TimeCourse | None = None
    load: TimeCourse | None = None
    speed_fluctuation: TimeCourse | None = None
    load_fluctuation: TimeCourse | None = None


def drive_and_load(
    gearbox: CycloidalGearbox,
    n: int,
    step: float,
    sampling_rate: float,
    start_angle: float = 0.0,
    courses: Courses | None = None,
) -> Float:
    """Angle (rad), speed (rad/s) and acceleration (rad/s2) of the input, and load (Nm): rows of (4, n).

    At ``n`` times, ``step`` s apart from 0. Arrays among the courses are at ``sampling_rate``.
    """
    # One block: numpy requests large pages from 4 MB on, which halves the time.
    block: Float = np.empty((4, n))
    time = _times(-(-n // _GRID) * _GRID, step)[:n]
    courses = courses or Courses()
    _drive(block[:3], gearbox, time, start_angle, sampling_rate, courses)
    _load(block[3], gearbox, time, sampling_rate, courses)
    return block


@functools.lru_cache(maxsize=1)
def _times(n: int, step: float) -> Float:
    """Return ``n`` times ``step`` apart from 0, which most runs of a batch share."""
    times: Float = np.arange(n, dtype=float)
    times *= step
    times.flags.writeable = False
    return times


def _drive(
    out: Float,
    gearbox: CycloidalGearbox,
    time: Float,
    start_angle: float,
    sampling_rate: float,
    courses: Courses,
) -> None:
    """Drive with linear ramp to a constant speed; the angle is its integral (paper B eq. 6 has a jump)."""
    angle, omega, alpha = out
    speed, fluctuation = courses.speed, courses.speed_fluctuation
    given = _course("speed", gearbox.input_speed if speed is None else speed, sampling_rate, time)
    steady = given.ndim == 0
    alpha[:] = 0.0
    omega[:] = given
    if steady:
        ramp = gearbox.ramp_time
        np.subtract(time, ramp / 2, out=angle)
        angle *= given
        if ramp > 0:
            rising = slice(_n_rising(gearbox, time))
            angle[rising] = 0.5 * given / ramp * time[rising] ** 2
            omega[rising] = given / ramp * time[rising]
            alpha[rising] = given / ramp
    else:
        angle[:] = 0.0
    if fluctuation is not None or not steady:
        extra: Float | float = 0.0
        if fluctuation is not None:
            extra = _ramp(gearbox, time) * _course("speed_fluctuation", fluctuation, sampling_rate, time)
        numeric = np.asarray(extra) if steady else omega + extra
        angle += cumulative_trapezoid(numeric, dx=time[1] - time[0], initial=0)
        alpha += np.gradient(numeric, time[1] - time[0])
        omega += extra
    angle += start_angle


def _load(out: Float, gearbox: CycloidalGearbox, time: Float, sampling_rate: float, courses: Courses) -> None:
    """Load torque on the output (paper B eq. 9-10), plus its fluctuation, both under the ramp."""
    load, fluctuation = courses.load, courses.load_fluctuation
    given = _course("load", gearbox.load_torque if load is None else load, sampling_rate, time)
    extra = _course("load_fluctuation", 0.0 if fluctuation is None else fluctuation, sampling_rate, time)
    if given.ndim > 0:
        out[:] = given + extra * _ramp(gearbox, time)
        return
    np.add(given, extra, out=out)
    n_rising = _n_rising(gearbox, time)
    out[:n_rising] *= time[:n_rising] / gearbox.ramp_time


def _course(name: str, values: TimeCourse, sampling_rate: float, time: Float) -> Float:
    """Return a number unchanged, or the values of an array or a function at ``time``."""
    if callable(values):
        course = _floats(name, values(time))
        if course.ndim > 1 or (course.ndim == 1 and course.shape != time.shape):
            raise ValueError(
                f"{name} must be a number, an array or a function of time that returns one value per time; "
                f"it gave shape {course.shape} for {time.shape[0]} times"
            )
        course = np.broadcast_to(course, time.shape)
    else:
        course = _floats(name, values)
        if course.ndim > 1:
            raise ValueError(f"{name} as an array must have one dimension, got shape {course.shape}")
        if course.ndim == 1:
            course = _interpolated(name, course, sampling_rate, time)
    if not np.all(np.isfinite(course)):
        raise ValueError(f"{name} must be finite, it gave NaN or infinity")
    return course


def _floats(name: str, values: ArrayLike) -> Float:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise TypeError(
            f"{name} must be a number, an array or a function of time, and hold or return numbers, "
            f"got {short(values)}"
        ) from None


def _interpolated(name: str, values: Float, sampling_rate: float, time: Float) -> Float:
    # The last value continues, because the run is longer for the anti-alias filter.
    needed = math.floor(time[-1] * sampling_rate) - MARGIN
    if values.size < max(needed, 1):
        raise ValueError(
            f"{name} as an array must hold one value per sample of the result, at least {needed} at "
            f"{sampling_rate:g} Hz, got {values.size}"
        )
    return np.asarray(on_lines(time, np.arange(values.size) / sampling_rate, values))


def _ramp(gearbox: CycloidalGearbox, time: Float) -> Float:
    """Share of the final speed and load at each time of the ramp."""
    share = np.ones_like(time)
    n_rising = _n_rising(gearbox, time)
    share[:n_rising] = time[:n_rising] / gearbox.ramp_time
    return share


def _n_rising(gearbox: CycloidalGearbox, time: Float) -> int:
    """Number of times before the end of the ramp, from increasing times."""
    return int(np.searchsorted(time, gearbox.ramp_time))
