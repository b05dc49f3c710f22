"""Synchronous averages of measured and simulated torque, bin by bin of the turn."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cyclofeat.gap._summaries import SPEED_TOLERANCE, slots, speeds_by_mesh
from cyclofeat.orders import estimate_input_speed

Float = NDArray[np.float64]

_BINS = 240
_ROUNDS = 3  # of alignment
# The search takes the same number of steps whatever its tolerance: over a window's turns the finer ones draw
# a sharper picture.
_FINE_TOLERANCE = SPEED_TOLERANCE / 2


@dataclass(frozen=True)
class PhaseMap:
    """Torque folded over one turn of the input, or over the passage of one lobe.

    Attributes
    ----------
    name : {"input", "lobe"}
        ``"input"``: one turn of the input. ``"lobe"``: 15/16 of it, in which all 15 lobes pass in turn, once
        each.
    phase : ndarray, shape (n_bins,)
        Share of the turn at the middle of each bin.
    measured, simulated : ndarray, shape (n_bins,)
        Mean ripple in Nm over recordings, each turned to where it fits the others best.
    measured_spread, simulated_spread : ndarray, shape (n_bins,)
        Standard deviation of one recording in Nm.
    flagged : ndarray of bool, shape (n_bins,)
        Where the means differ by Welch's t-test at the level alpha, Bonferroni over the bins. A picture's
        mark, not part of the verdict: alignment favours agreement.
    """

    name: str
    phase: Float = field(repr=False)
    measured: Float = field(repr=False)
    simulated: Float = field(repr=False)
    measured_spread: Float = field(repr=False)
    simulated_spread: Float = field(repr=False)
    flagged: NDArray[np.bool_] = field(repr=False)


def phase_maps(
    measured: NDArray[Any],
    simulated: NDArray[Any],
    sampling_rate: float,
    input_speed_hz: float,
    n_lobes: int,
    alpha: float,
    tachometer: tuple[Float, Float] | None = None,
) -> dict[str, PhaseMap]:
    """Maps by input turn and by lobe of windows of measured and simulated torque in Nm.

    ``tachometer`` has the mean input speeds in Hz of both, where measured ones are known; else the mesh lines
    tell them.
    """
    maps = {}
    speeds = tachometer or [
        _fine_speeds(X, sampling_rate, input_speed_hz, n_lobes) for X in (measured, simulated)
    ]
    for name, per_turn in (("input", 1.0), ("lobe", (n_lobes + 1) / n_lobes)):
        folded = [
            _folded(X, own * per_turn / sampling_rate)
            for X, own in zip((measured, simulated), speeds, strict=True)
        ]
        reference = _mean_wave(folded[1])
        aligned = [np.array([_turned(wave, reference) for wave in waves]) for waves in folded]
        p = stats.ttest_ind(*aligned, equal_var=False, axis=0).pvalue
        ours, theirs = aligned
        maps[name] = PhaseMap(
            name,
            phase=(np.arange(_BINS) + 0.5) / _BINS,
            measured=ours.mean(axis=0),
            simulated=theirs.mean(axis=0),
            measured_spread=ours.std(axis=0, ddof=1),
            simulated_spread=theirs.std(axis=0, ddof=1),
            flagged=np.asarray(p * _BINS <= alpha),
        )
    return maps


def _fine_speeds(X: NDArray[Any], sampling_rate: float, nominal_hz: float, n_lobes: int) -> Float:
    """Mean input speed of each window in Hz, as far from the nominal one as summaries look for it."""
    near = estimate_input_speed(X, sampling_rate, nominal_hz, _FINE_TOLERANCE, comb="mesh", n_lobes=n_lobes)
    far = speeds_by_mesh(np.asarray(X, dtype=np.float64), sampling_rate, nominal_hz, n_lobes)
    return np.where(np.abs(far / nominal_hz - 1) > _FINE_TOLERANCE, far, near)


def _folded(X: NDArray[Any], turns_per_sample: Float) -> Float:
    """Mean of each bin of the turn, less the window's mean: (n_windows, _BINS)."""
    waves = []
    for x, step in zip(X, turns_per_sample, strict=True):
        slot = slots(x.size, float(step), _BINS)
        count = np.bincount(slot, minlength=_BINS)
        there = np.flatnonzero(count)
        mean = np.bincount(slot, x - x.mean(), _BINS)[there] / count[there]
        # Of few samples per turn at just the speed that repeats their places, some bins get none.
        waves.append(mean if there.size == _BINS else np.interp(np.arange(_BINS), there, mean, period=_BINS))
    return np.array(waves)


def _mean_wave(waves: Float) -> Float:
    """Mean of waves that are turned to fit it, found by turns from the largest of them."""
    mean = np.asarray(waves[int(np.argmax(waves.var(axis=1)))])
    for _ in range(_ROUNDS):
        mean = np.mean([_turned(wave, mean) for wave in waves], axis=0)
    return mean


def _turned(wave: Float, reference: Float) -> Float:
    """The wave, turned to its largest circular correlation with the reference."""
    correlation = np.fft.irfft(np.fft.rfft(reference) * np.conj(np.fft.rfft(wave)), wave.size)
    return np.roll(wave, int(np.argmax(correlation)))
