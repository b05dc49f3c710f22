"""Summaries of a recording for the joint posterior."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

from cyclofeat.gap.summaries.summarise import (
    HANN_POWER,
    RESOLUTION_NM,
    SPEED_TOLERANCE,
    Cell,
    Columns,
    Kinematics,
    as_table,
    block_means,
    box_means,
    hann_lines,
    level_db,
    signed_log,
    summarise_windows,
)
from cyclofeat.signal.faults import find_runs

Float = NDArray[np.float64]

_MESH_LINES = 4
_BOX_S, _BOXES, _HOP = 0.014, 16, 4  # moving averages: their unit in s, and their length and step in units
_LEAST_SLOW_NM = 0.05  # a slow torque below it says nothing of what follows it
_MAINS_HZ = (50.0, 100.0, 150.0)
_MAINS_REACH_HZ = 1.5  # for a clock that is off by a percent
_SLOW_EDGES_HZ = (0.0, 0.75, 1.5, 3.0, 6.0, 12.0, 24.0)
_DECAYS_S = (0.3, 0.6, 1.2, 2.5)
_DECAY_HZ = 12.0
_SLIP_BOXES_S = (0.028, 0.014, 0.007)


def turn_samples(kinematics: Kinematics) -> int:
    """Return the number of samples of one output turn, also where the speed is low by the tolerance."""
    turn = kinematics.n_lobes / kinematics.input_speed_hz * kinematics.sampling_rate
    return int(next_fast_len(math.ceil(turn * (1 + SPEED_TOLERANCE)), real=True))


def recording_cells(X: NDArray[np.float32], kinematics: Kinematics) -> tuple[Float, list[Cell]]:
    """Summarise recordings of one output turn (n_recordings, n_samples) in Nm, positive for a braking load.

    Returns values (n_recordings, n_cells) and their cells: those of :func:`summarise_windows`, and modulation
    of the mesh lines' amplitudes and phases and how far it follows the slow torque (a drift of the load does,
    one of the sensor does not); mains lines and slow part in Hz; signed trend and curvature; exponential
    decays, and the torque that they settle to; repeated, equal and extreme values.
    """
    values, cells = summarise_windows(X, kinematics)
    mean = X.mean(axis=1, dtype=np.float64)
    ripple = X.astype(np.float64) - mean[:, None]
    speeds = kinematics.input_speed_hz * (1 + values[:, 0] / 100)
    columns = _modulation_cells(ripple, kinematics, speeds)
    columns += _fixed_in_hz(ripple, kinematics.sampling_rate)
    columns += _shape_cells(ripple, mean, kinematics.sampling_rate)
    more, more_cells = as_table(columns + _code_cells(X))
    return np.hstack([values, more]), cells + more_cells


def _modulation_cells(ripple: Float, kinematics: Kinematics, speeds: Float) -> Columns:
    """Modulation of the mesh lines, and its regression on the slow torque."""
    highest = _MESH_LINES * (kinematics.n_lobes + 1) * kinematics.input_speed_hz * (1 + SPEED_TOLERANCE)
    ripple, sampling_rate = block_means(ripple, kinematics.sampling_rate, highest)
    n_samples = ripple.shape[1]
    box = max(round(_BOX_S * sampling_rate), 1)
    weights = np.hanning(_BOXES + 2)[1:-1]
    weights /= weights.sum()

    def smooth_boxes(means: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(
            np.lib.stride_tricks.sliding_window_view(means, _BOXES, axis=1)[:, ::_HOP] @ weights
        )

    means = box_means(ripple, box)
    slow = smooth_boxes(means)
    slow = slow - slow.mean(axis=1, keepdims=True)
    slow_power = np.mean(slow**2, axis=1)
    columns = [(Cell("modulation", "slow torque", "dB"), level_db(slow_power + RESOLUTION_NM**2))]
    # Without the slow torque, which is up to a thousand times a mesh line and would leak into it.
    place = np.clip((np.arange(n_samples) + 0.5) / box - 0.5, 0, means.shape[1] - 1)
    before = np.minimum(place.astype(int), means.shape[1] - 2)
    share = place - before
    between_boxes = means[:, before] * (1 - share) + means[:, before + 1] * share
    light = (ripple - between_boxes).astype(np.float32)
    turns = (kinematics.n_lobes + 1) * speeds[:, None] * np.arange(n_samples) / sampling_rate
    first = np.empty(turns.shape, dtype=np.complex64)
    first.real, first.imag = np.cos(-2 * np.pi * turns), np.sin(-2 * np.pi * turns)
    carrier = np.ones_like(first)
    for line in range(1, _MESH_LINES + 1):
        carrier = carrier * first
        phasor = smooth_boxes(box_means(light * carrier, box))
        phasor = phasor / (phasor.mean(axis=1, keepdims=True) + 1e-9)
        # Without mean and straight line: an error of the speed turns the phase steadily.
        time = np.linspace(-1, 1, phasor.shape[1])
        time = time / np.sqrt(time @ time)
        for what, part in (("amplitude", phasor.real - 1), ("phase", np.angle(phasor))):
            part = np.clip(part, -10, 10)
            part = part - part.mean(axis=1, keepdims=True)
            part = part - (part @ time)[:, None] * time
            power = np.mean(part**2, axis=1)
            together = np.mean(part * slow, axis=1)
            level, correlation = level_db(power + 1e-8), together / np.sqrt(power * slow_power + 1e-12)
            slope = signed_log(10 * together / (slow_power + _LEAST_SLOW_NM**2))
            columns += [
                (Cell("modulation", f"{what} of mesh line {line}", "dB"), level),
                (Cell("modulation", f"correlation of {what} {line} with the slow torque", "1"), correlation),
                (Cell("modulation", f"slope of {what} {line} over the slow torque", "1"), slope),
            ]
    return columns


def _fixed_in_hz(ripple: Float, sampling_rate: float) -> Columns:
    """Mains lines over their surroundings, and the slow part."""
    ripple, sampling_rate = block_means(ripple, sampling_rate, 2 * _MAINS_HZ[-1])
    n = ripple.shape[1]
    hz = np.fft.rfftfreq(n, 1 / sampling_rate)
    lines = rfft(ripple, axis=1)[:, : np.searchsorted(hz, 2 * _MAINS_HZ[-1])]
    hz = hz[: lines.shape[1]]
    power = 2 * np.abs(hann_lines(lines)) ** 2 / (n * HANN_POWER * n) + 2 * RESOLUTION_NM**2 / n
    columns = []
    for mains in _MAINS_HZ:
        distance = np.abs(hz - mains)
        line = power[:, distance <= _MAINS_REACH_HZ].max(axis=1)
        around = power[:, (distance > 2 * _MAINS_REACH_HZ) & (distance < 5 * _MAINS_REACH_HZ)]
        above, name = level_db(line) - level_db(np.median(around, axis=1)), f"line at {mains:g} Hz"
        columns += [
            (Cell("mains", name, "dB", mains, mains), level_db(line)),
            (Cell("mains", f"{name} over its surroundings", "dB", mains, mains), above),
        ]
    total = np.cumsum(2 * np.abs(lines) ** 2 / n**2, axis=1)
    # A bin reaches half its width to either side.
    ends = hz[: total.shape[1]] + hz[1] / 2
    at = np.array([np.interp(_SLOW_EDGES_HZ, ends, row) for row in total])
    for low, high, power_between in zip(_SLOW_EDGES_HZ, _SLOW_EDGES_HZ[1:], np.diff(at).T, strict=False):
        cell = Cell("slow bands", f"{low:g} to {high:g} Hz", "dB", low, high)
        columns.append((cell, level_db(power_between + RESOLUTION_NM**2 / n)))
    return columns


def _shape_cells(ripple: Float, mean: Float, sampling_rate: float) -> Columns:
    """Line and parabola through the record, exponential decays, and slips."""
    time = np.linspace(-1, 1, ripple.shape[1])
    shapes = np.column_stack([time, 1.5 * time**2 - 0.5])
    sizes = signed_log(10 * (ripple @ (shapes / np.sum(shapes**2, axis=0))))
    columns = [
        (Cell("course", "straight line", "1"), sizes[:, 0]), (Cell("course", "parabola", "1"), sizes[:, 1])
    ]  # fmt: skip
    # The size of each decay, the level that it leaves, and what the torque settles to.
    slow, rate = block_means(ripple, sampling_rate, _DECAY_HZ)
    slow = slow - slow.mean(axis=1, keepdims=True)
    time = np.arange(slow.shape[1]) / rate
    for time_constant in _DECAYS_S:
        decay = np.exp(-time / time_constant)
        shape = decay - decay.mean()
        size = slow @ shape / (shape @ shape)
        left = np.mean((slow - size[:, None] * shape) ** 2, axis=1)
        name = f"a decay in {time_constant:g} s"
        columns += [
            (Cell("decays", f"size of {name}", "Nm"), size),
            (Cell("decays", f"level left by {name}", "dB"), level_db(left + RESOLUTION_NM**2)),
            (Cell("decays", f"torque settled after {name}", "Nm"), mean - size * decay.mean()),
        ]
    # Stick-slip climbs slowly and falls fast: the changes of the slow torque are skewed.
    for box_s in _SLIP_BOXES_S:
        box = max(round(box_s * sampling_rate), 1)
        changes = np.diff(box_means(ripple, box), axis=1)
        cubes = np.mean(changes**3, axis=1)
        name = f"changes in {1e3 * box_s:g} ms"
        skewness = cubes / (np.mean(changes**2, axis=1) + RESOLUTION_NM**2) ** 1.5
        columns.append((Cell("slips", f"skewness of {name}", "1"), skewness))
        columns.append((Cell("slips", f"third moment of {name}", "1"), signed_log(1e3 * cubes)))
    return columns


def _code_cells(X: NDArray[np.float32]) -> Columns:
    """Values that repeat, runs of equal values, and values at the ends of the range."""
    ordered = np.sort(X, axis=1)
    steps = np.diff(ordered, axis=1)
    distinct = np.sum(steps > 0, axis=1) + 1
    smallest = np.where(steps > 0, steps, np.inf).min(axis=1, initial=np.inf)
    equal = np.diff(X, axis=1) == 0
    lowest, highest = ordered[:, :1], ordered[:, -1:]
    values = {
        "number of values": np.log10(distinct),
        "smallest step": np.log10(np.clip(smallest, 1e-9, 1e3)),
        "range over the number of values": np.log10(((highest - lowest)[:, 0] + RESOLUTION_NM) / distinct),
        "longest run of a value": np.log1p(np.array([find_runs(row)[1].max(initial=0) for row in equal])),
        "share of the largest value": np.log10(np.mean(highest == X, axis=1)),
        "share of the smallest value": np.log10(np.mean(lowest == X, axis=1)),
        "share of zeros": np.mean(X == 0, axis=1),
    }
    return [(Cell("codes", name, "1"), column) for name, column in values.items()]
