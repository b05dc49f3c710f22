"""Angle, speed and acceleration of the input, and load, over time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.checks import number, repr_of
from cyclofeat.simulators.gearbox import CycloidalGearbox

Float = NDArray[np.float64]
TimeCourse = float | Callable[[Float], ArrayLike]

_COURSE = "a number or a function of time that returns numbers"
MARGIN = 40  # samples that a run is longer than its result, for the anti-alias filter


@dataclass(frozen=True, eq=False)
class Courses:
    """Input speed and load of one run over time, in place of the gearbox's.

    Each is a number, or a function that takes times of shape (n,) in s and returns as many values, each from
    its own time alone: batches ask for the times of a run in pieces.

    Parameters
    ----------
    speed, load : float or function of time, optional
        Input speed in rad/s and load torque in Nm. Only a number rises over the gearbox's ramp.
    speed_fluctuation, load_fluctuation : float or function of time, optional
        Added to input speed (rad/s) and load torque (Nm), under the ramp.

    Examples
    --------
    >>> swelling = Courses(load=20.0, load_fluctuation=lambda t: 2 * np.sin(30 * t))
    """

    speed: TimeCourse | None = None
    load: TimeCourse | None = None
    speed_fluctuation: TimeCourse | None = None
    load_fluctuation: TimeCourse | None = None


class DriveAndLoad:
    """Angle (rad), speed (rad/s) and acceleration (rad/s2) of the input, and load (Nm), of one run in pieces.

    At ``n`` times, ``step`` s apart from 0. Pieces follow one another and stay in the processor's cache; to
    the last bit, they hold what the whole does.
    """

    def __init__(
        self, gearbox: CycloidalGearbox, n: int, step: float, start_angle: float = 0.0,
        courses: Courses | None = None,
    ) -> None:  # fmt: skip
        self.n, self._gearbox, self._step = n, gearbox, step
        courses = courses or Courses()
        self._speed = _course_function("speed", courses.speed, gearbox.input_speed)
        self._load = _course_function("load", courses.load, gearbox.load_torque)
        self._fluctuates = courses.speed_fluctuation is not None
        self._faster = _course_function("speed_fluctuation", courses.speed_fluctuation)
        self._heavier = _course_function("load_fluctuation", courses.load_fluctuation)
        self._start_angle = start_angle
        # Angle by the part of the speed that has no formula, at the first time of the next piece.
        self._turned = 0.0

    def piece(self, first: int = 0, last: int | None = None, out: Float | None = None) -> Float:
        """Return the rows (4, ...) from time number ``first`` to ``last``, at which the next piece begins.

        They are the first columns of ``out``, if it is given.
        """
        last = self.n - 1 if last is None else last
        # One block: numpy requests large pages from 4 MB on, which halves the time.
        block: Float = np.empty((4, last + 1 - first)) if out is None else out[:, : last + 1 - first]
        # The acceleration is the slope between the neighbours.
        before, after = min(first, 1), min(self.n - 1 - last, 1)
        around = np.arange(first - before, last + after + 1, dtype=float) * self._step
        inside = slice(before, around.size - after)
        # Drive with a linear ramp to a constant speed. The angle is its integral: paper B eq. 6 has a jump.
        angle, omega, alpha, torque = block
        time = around[inside]
        speed = self._speed(around)
        steady = speed.ndim == 0
        alpha[:] = 0.0
        omega[:] = speed if steady else speed[inside]
        if steady:
            ramp = self._gearbox.ramp_time
            np.subtract(time, ramp / 2, out=angle)
            angle *= speed
            if ramp > 0:
                rising = slice(_n_rising(self._gearbox, time))
                angle[rising] = 0.5 * speed / ramp * time[rising] ** 2
                omega[rising] = speed / ramp * time[rising]
                alpha[rising] = speed / ramp
        else:
            angle[:] = 0.0
        if self._fluctuates or not steady:
            extra = _ramp_share(self._gearbox, around) * self._faster(around)
            numeric = extra if steady else speed + extra
            # The angle from the start of the run, by the trapezoid rule.
            fast = numeric[inside]
            growth = np.empty(fast.size)
            growth[0] = self._turned
            growth[1:] = self._step * (fast[1:] + fast[:-1]) / 2.0
            turned = np.cumsum(growth)
            self._turned = float(turned[-1])
            angle += turned
            alpha += np.gradient(numeric, self._step)[inside]
            omega += extra[inside]
        angle += self._start_angle
        # The load (paper B eq. 9-10), plus its fluctuation, both under the ramp.
        given, extra = self._load(around), self._heavier(around)
        heavier = extra[inside] if extra.ndim else extra
        if given.ndim > 0:
            torque[:] = given[inside] + heavier * _ramp_share(self._gearbox, time)
        else:
            np.add(given, heavier, out=torque)
            n_rising = _n_rising(self._gearbox, time)
            torque[:n_rising] *= time[:n_rising] / self._gearbox.ramp_time
        return block


def _course_function(name: str, course: TimeCourse | None, default: float = 0.0) -> Callable[[Float], Float]:
    """Return a course as a function of times that gives a number where it is one."""
    if callable(course):
        return _OfTime(name, course)
    value = np.asarray(number(name, default if course is None else course, _COURSE), dtype=float)
    return lambda time: value


class _OfTime:
    """A user's function of time, which must not depend on how many times it is given."""

    def __init__(self, name: str, function: Callable[[Float], ArrayLike]) -> None:
        self._name, self._function = name, function
        self._known: tuple[Float, Float] | None = None  # the last times of the last piece, and the values

    def __call__(self, time: Float) -> Float:
        given = self._function(time)
        try:
            course = np.asarray(given, dtype=float)
        except (TypeError, ValueError):
            raise TypeError(f"{self._name} must be {_COURSE}, got {repr_of(given)}") from None
        if course.shape not in ((), time.shape):
            raise ValueError(f"{self._name} must give one number per time, got shape {course.shape}")
        if not np.all(np.isfinite(course)):
            raise ValueError(f"{self._name} must be finite, it gave NaN or infinity")
        course = np.broadcast_to(course, time.shape)
        if self._known is not None:
            times, values = self._known
            again = course[np.searchsorted(time, times)]
            if np.any(np.abs(again - values) > 1e-9 * (1 + np.abs(values))):
                raise ValueError(
                    f"{self._name} must be a function of time alone: at {times[-1]:g} s it gave "
                    f"{values[-1]:.6g} and, among other times, {again[-1]:.6g}"
                )
        self._known = time[-2:].copy(), course[-2:].copy()
        return course


def _ramp_share(gearbox: CycloidalGearbox, time: Float) -> Float:
    """Share of the final speed and load at each time of the ramp."""
    share = np.ones_like(time)
    n_rising = _n_rising(gearbox, time)
    share[:n_rising] = time[:n_rising] / gearbox.ramp_time
    return share


def _n_rising(gearbox: CycloidalGearbox, time: Float) -> int:
    """Number of times before the end of the ramp, from increasing times."""
    return int(np.searchsorted(time, gearbox.ramp_time))


def interpolate_rows(values: NDArray[Any], instants: NDArray[Any]) -> NDArray[Any]:
    """Return rows (n, ...) at instants in rows from 0 to n - 1, by straight lines."""
    before = np.minimum(np.floor(instants).astype(int), max(len(values) - 2, 0))
    after = np.minimum(before + 1, len(values) - 1)
    share = (instants - before).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(values[before] + share * (values[after] - values[before]))
