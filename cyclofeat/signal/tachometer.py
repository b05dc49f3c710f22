"""Angle of a shaft from what a tachometer records: pulses, or an angle that starts again at each turn."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from cyclofeat._base import checks

Float = NDArray[np.float64]

__all__ = ["angle_from_pulses", "continuous_angle"]

# Pulses switch on above the first and off below the second share of their range.
_ON, _OFF = 0.6, 0.4
_FEWEST_PULSES = 3
_MISSED = 1.6  # times the usual distance of pulses, from which one is missing
_LARGEST_STEP = np.pi / 2  # of an angle that rises in steps
# Samples on the way down at the start of a turn, at most; rad that others may lie beside the line.
_FALLING, _OFF_LINE = 3, 0.2


def angle_from_pulses(signal: ArrayLike, pulses_per_turn: int) -> Float:
    """Angle of a shaft from a train of pulses.

    Rising edges are the instants at which the signal, read between samples, passes the middle of its range;
    noise smaller than a tenth of the range makes no edges. Between edges the angle follows a monotone cubic
    curve (PCHIP; Fritsch and Carlson, "Monotone piecewise cubic interpolation", SIAM Journal on Numerical
    Analysis 17, 1980), before the first and after the last one a straight line.

    Parameters
    ----------
    signal : array-like, shape (n,)
        Voltage or logic level of the pulses; one pulse per turn is an index.
    pulses_per_turn : int

    Returns
    -------
    ndarray, shape (n,)
        Angle in rad, strictly increasing, 0 at the first edge.

    Raises
    ------
    ValueError
        If the signal is constant or has fewer than three pulses, or if one is missing.

    Examples
    --------
    >>> turns = 3.0 * np.arange(2000) / 1000  # 3 turns per second, sampled at 1 kHz
    >>> angle = angle_from_pulses(np.sin(2 * np.pi * 4 * turns) > 0, 4)
    >>> round(float(np.mean(np.diff(angle)) * 1000 / (2 * np.pi)), 2)
    3.0
    """
    per_turn = checks.whole("pulses_per_turn", pulses_per_turn, 1)
    values = np.asarray(signal, dtype=float)
    low, high = float(values.min()), float(values.max())
    if low == high:
        raise ValueError(f"signal must hold pulses, got {low:g} throughout")
    share = (values - low) / (high - low)
    edges = _rising_edges(share)
    if edges.size < _FEWEST_PULSES:
        raise ValueError(f"signal must hold at least {_FEWEST_PULSES} pulses, got {edges.size}")
    distances = np.diff(edges)
    # Against the neighbours, since the speed may change.
    usual = np.minimum(np.r_[np.inf, distances[:-1]], np.r_[distances[1:], np.inf])
    worst = int(np.argmax(distances / usual))
    if distances[worst] > _MISSED * usual[worst]:
        raise ValueError(
            f"signal must hold all pulses, got {distances[worst]:.4g} samples between two at sample "
            f"{edges[worst]:.0f}, where {usual[worst]:.4g} are usual"
        )
    at = 2 * np.pi / per_turn * np.arange(edges.size)
    curve = PchipInterpolator(edges, at, extrapolate=False)
    place = np.arange(values.size, dtype=float)
    angle = np.asarray(curve(place))
    for outside, edge, slope in (
        (place < edges[0], 0, (at[1] - at[0]) / distances[0]),
        (place > edges[-1], -1, (at[-1] - at[-2]) / distances[-1]),
    ):
        angle[outside] = at[edge] + slope * (place[outside] - edges[edge])
    return angle


def _rising_edges(share: Float) -> Float:
    """Instants in samples at which a signal from 0 to 1 rises through its middle, with a hysteresis."""
    state = np.where(share > _ON, 1, np.where(share < _OFF, 0, -1))
    known = np.flatnonzero(state >= 0)
    rises = np.flatnonzero((state[known[1:]] == 1) & (state[known[:-1]] == 0))
    edges = np.empty(rises.size)
    for k, (before, after) in enumerate(zip(known[rises], known[rises + 1], strict=True)):
        part = share[before : after + 1]
        j = int(np.argmax(part >= 0.5))
        edges[k] = before + j - 1 + (0.5 - part[j - 1]) / (part[j] - part[j - 1])
    return edges


def continuous_angle(angle: ArrayLike) -> Float:
    """Angle without the falls to its start once per turn, and without the steps of a coarse encoder.

    Parameters
    ----------
    angle : array-like, shape (n,)
        In rad. It rises, or falls, and may start again after each turn. Of a value that is held for several
        samples the first one counts; the others lie on a straight line to the next value. So do up to three
        samples on the way down.

    Returns
    -------
    ndarray, shape (n,)
        In rad, strictly monotone; an angle that is that already comes back unchanged.

    Raises
    ------
    ValueError
        If the angle does neither, or steps by more than a quarter of a turn.

    Examples
    --------
    >>> turned = np.linspace(0, 20, 500)
    >>> bool(np.allclose(continuous_angle(turned % (2 * np.pi)), turned))
    True
    """
    values = np.asarray(angle, dtype=float)
    steps = np.diff(values)
    if np.all(steps > 0) or np.all(steps < 0):
        return values
    moving = steps[steps != 0]
    sign = -1.0 if moving.size and np.median(moving) < 0 else 1.0
    turned, falling = _without_falls(sign * values)
    before = np.maximum.accumulate(np.where(falling, -np.inf, turned))
    after = np.minimum.accumulate(np.where(falling, np.inf, turned)[::-1])[::-1]
    kept = np.flatnonzero(~falling & (turned > np.r_[-np.inf, before[:-1]]) & (turned <= after))
    if kept.size < 2 or np.diff(turned[kept]).max() > _LARGEST_STEP:
        raise ValueError("angle must rise or fall in steps of less than a quarter of a turn")
    place = np.arange(values.size)
    line = np.interp(place, kept, turned[kept])
    for outside, end, (one, other) in (
        (place < kept[0], kept[0], kept[:2]),
        (place > kept[-1], kept[-1], kept[-2:]),
    ):
        slope = (turned[other] - turned[one]) / (other - one)
        line[outside] = turned[end] + slope * (place[outside] - end)
    held = np.r_[False, np.diff(turned) == 0]
    beside = ~falling & ~held & (np.abs(line - turned) > _OFF_LINE)
    if beside.any():
        raise ValueError(
            f"angle must rise or fall steadily, but for its start at each turn, got "
            f"{values[beside][0]:.4g} rad at sample {int(np.argmax(beside))}"
        )
    return np.asarray(sign * line)


def _without_falls(rising: Float) -> tuple[Float, NDArray[np.bool_]]:
    """Add a turn after each fall of more than half a one, and mark the samples on its way."""
    down = np.diff(rising) < 0
    edges = np.flatnonzero(np.diff(np.r_[False, down, False].astype(int)))
    turned, falling = rising.copy(), np.zeros(rising.size, dtype=bool)
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if rising[first] - rising[last] > np.pi and last - first <= _FALLING + 1:
            turned[last:] += 2 * np.pi
            # With samples on the way, the last before and the first after it are off too.
            falling[first + 1 : last] = True
            falling[[first, last]] = last > first + 1
    return turned, falling
