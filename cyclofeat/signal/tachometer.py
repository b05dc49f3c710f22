"""Angle of a shaft from what a tachometer records: pulses, or an angle that starts again at each turn."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from cyclofeat._base import checks
from cyclofeat.signal.orders import at_every_sample
from cyclofeat.signal.windows import Bool, Float

# Pulses switch on above the first and off below the second share of their range.
_ON, _OFF = 0.6, 0.4
_FEWEST_PULSES, _FEWEST_SAMPLES = 3, 4  # in all; of a pulse, since others may be aliases of a faster shaft
_MISSED = 1.6  # times the usual distance of pulses, from which one is missing
_LARGEST_STEP = np.pi / 2  # of an angle that rises in steps
# Samples on the way down at the start of a turn, at most; rad that others may lie beside the line.
_FALLING, _OFF_LINE = 3, 0.2
# Samples at most that alone span a range of pulses (spikes); change of a noisy angle between samples that is
# the start of a turn; multiple of the samples whose means rise, over which noise is averaged.
_SPIKES, _TURN_BEGINS, _SMOOTHER = 3, 1.5 * np.pi, 4


def angle_from_pulses(signal: ArrayLike, pulses_per_turn: int) -> Float:
    """Angle of a shaft in rad from a train of pulses, 0 at the first edge, strictly increasing.

    Rising edges are the instants at which the ``signal``, a voltage or logic level, passes the middle of its
    range; noise smaller than a tenth of the range makes no edges. Between edges the angle follows a monotone
    cubic curve (PCHIP; Fritsch and Carlson, "Monotone piecewise cubic interpolation", SIAM Journal on
    Numerical Analysis 17, 1980), before the first and after the last one a straight line, of less than one
    pulse.

    ``ValueError`` if the signal is constant, not finite or has fewer than three pulses, if one is missing or
    double, or if there are fewer than four samples per pulse.
    """
    per_turn = checks.whole("pulses_per_turn", pulses_per_turn, 1)
    values = checks.number_series("signal", signal, kinds="biuf")
    low, high = float(values.min()), float(values.max())
    if low == high:
        raise ValueError(f"signal must hold pulses, got {low:g} throughout")
    share = (values - low) / (high - low)
    on = share > _ON
    known = np.flatnonzero(on | (share < _OFF))
    rises = np.flatnonzero(on[known[1:]] & ~on[known[:-1]])
    edges = np.empty(rises.size)
    for k, (before, after) in enumerate(zip(known[rises], known[rises + 1], strict=True)):
        part = share[before : after + 1]
        j = int(np.argmax(part >= 0.5))
        edges[k] = before + j - 1 + (0.5 - part[j - 1]) / (part[j] - part[j - 1])
    if edges.size < _FEWEST_PULSES:
        above = share > 0.5
        rare = np.flatnonzero(above if 2 * above.sum() < above.size else ~above)
        spikes = f": a spike at sample {rare[0]} hides them?" if rare.size <= _SPIKES else ""
        raise ValueError(
            f"signal must hold at least {_FEWEST_PULSES} pulses, got {edges.size} in its range, {low:g} to "
            f"{high:g}{spikes}"
        )
    distances = np.diff(edges)
    if np.median(distances) < _FEWEST_SAMPLES:
        raise ValueError(
            f"signal must have at least {_FEWEST_SAMPLES} samples per pulse, got {np.median(distances):.3g}: "
            "sample faster, or use fewer pulses per turn"
        )
    # Against the neighbours, since the speed may change.
    usual = np.minimum(np.r_[np.inf, distances[:-1]], np.r_[distances[1:], np.inf])
    worst = int(np.argmax(distances / usual))
    if distances[worst] > _MISSED * usual[worst]:
        raise ValueError(
            f"signal must hold each pulse once, got {distances[worst]:.4g} samples between two at sample "
            f"{edges[worst]:.0f}, where {usual[worst]:.4g} are usual"
        )
    at = 2 * np.pi / per_turn * np.arange(edges.size)
    angle = np.asarray(PchipInterpolator(edges, at, extrapolate=False)(np.arange(values.size, dtype=float)))
    _extend_lines(angle, edges, at)
    return angle


def _extend_lines(angle: Float, known: NDArray[Any], rising: NDArray[Any]) -> None:
    """Write lines before the first and after the last known value, by less than a step: a shaft may stop."""
    place = np.arange(angle.size)
    for outside, end, other in ((place < known[0], 0, 1), (place > known[-1], -1, -2)):
        if outside.any():
            away = place[outside] - known[end]
            slope = (rising[other] - rising[end]) / (known[other] - known[end])
            most = abs(rising[other] - rising[end]) / np.abs(away).max()
            angle[outside] = rising[end] + min(slope, most) * away


def continuous_angle(angle: ArrayLike) -> Float:
    """Angle in rad without the falls to its start once per turn, and without the steps of a coarse encoder.

    Of a value that is held for several samples the first one counts; the others, and up to three samples on
    the way down, lie on a straight line to the next value, and after the last step within one more step. An
    angle with noise is averaged over as many samples as make it rise. The result is strictly monotone; an
    angle that is that already comes back unchanged. ``ValueError`` if the angle is not finite, neither rises
    nor falls, or steps by more than a quarter of a turn.
    """
    values = checks.number_series("angle", angle)
    steps = np.diff(values)
    if np.all(steps > 0) or np.all(steps < 0):
        return values
    moving = steps[steps != 0]
    sign = -1.0 if moving.size and np.median(moving) < 0 else 1.0
    del steps, moving  # of a long record, arrays go as soon as they have served
    turned, falling = _without_falls(sign * values)
    # The samples that lie above all before, and not above any after them.
    highest = np.where(falling, -np.inf, turned)
    np.maximum.accumulate(highest, out=highest)
    rising = ~falling
    rising[1:] &= turned[1:] > highest[:-1]
    highest[falling] = np.inf
    highest[~falling] = turned[~falling]
    lowest_after = highest[::-1]
    np.minimum.accumulate(lowest_after, out=lowest_after)
    kept = np.flatnonzero(rising & (turned <= highest))
    del highest, lowest_after, rising
    if kept.size < 2:
        raise ValueError("angle must rise or fall, but for its start at each turn: these samples do neither")
    rises = np.diff(turned[kept])
    if rises.max() > _LARGEST_STEP:
        if (smooth := _without_noise(values)) is not None:
            return smooth
        raise ValueError(
            f"angle must rise or fall in steps of less than a quarter of a turn, got {rises.max():.4g} rad "
            f"after sample {kept[int(np.argmax(rises))]}: wrong unit, or noise?"
        )
    del rises
    same = np.diff(turned) == 0
    held = np.r_[same[0], same]
    if held[0] and kept.size > 2:
        kept = kept[1:]  # when the shaft came to its first value is not known
    line = at_every_sample(values.size, kept, turned[kept])
    _extend_lines(line, kept, turned[kept])
    beside = ~falling & ~held & (np.abs(line - turned) > _OFF_LINE)
    if beside.any():
        raise ValueError(
            f"angle must rise or fall steadily, but for its start at each turn, got "
            f"{values[beside][0]:.4g} rad at sample {int(np.argmax(beside))}"
        )
    return np.asarray(sign * line)


def _without_noise(values: Float) -> Float | None:
    """Return the monotone curve through the means of a noisy angle; None where it lies off its samples."""
    place = np.arange(values.size)
    for sign in (1.0, -1.0):
        turned, falling = _without_falls(np.unwrap(sign * values, discont=_TURN_BEGINS))
        known = np.flatnonzero(~falling)
        sizes = [2**k for k in range(1, known.size.bit_length()) if _SMOOTHER**2 * 2**k <= known.size]
        size = next((size for size in sizes if np.all(np.diff(_group_means(turned[known], size)) > 0)), None)
        if size is None:
            continue
        at, means = (_group_means(x, _SMOOTHER * size) for x in (known, turned[known]))
        line = np.asarray(PchipInterpolator(at, means, extrapolate=False)(place))
        _extend_lines(line, at, means)
        beside = np.abs(line - turned)[known].max() > _OFF_LINE
        if not beside and np.diff(means).max() <= _LARGEST_STEP and np.all(np.diff(line) > 0):
            return np.asarray(sign * line)
    return None


def _group_means(values: NDArray[Any], size: int) -> Float:
    """Return the means of adjacent samples; those at the end that make no group are left out."""
    return np.asarray(values[: values.size // size * size].reshape(-1, size).mean(axis=1))


def _without_falls(rising: Float) -> tuple[Float, Bool]:
    """Add a turn after each fall of more than half a one, and mark the samples on its way."""
    down = np.r_[False, np.diff(rising) < 0, False]
    edges = np.flatnonzero(down[1:] != down[:-1])
    turned, falling = rising.copy(), np.zeros(rising.size, dtype=bool)
    begun = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if rising[first] - rising[last] > np.pi and last - first <= _FALLING + 1:
            begun.append(last)
            # With samples on the way, the last before and the first after it are off too.
            falling[first + 1 : last] = True
            falling[[first, last]] = last > first + 1
    for turns, (first, last) in enumerate(itertools.pairwise([*begun, rising.size]), start=1):
        turned[first:last] += 2 * np.pi * turns
    return turned, falling
