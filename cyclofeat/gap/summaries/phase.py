"""Synchronous averages of measured and simulated torque over the turn, for pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cyclofeat.gap.summaries.summarise import SPEED_TOLERANCE, Kinematics, speeds_by_mesh, synchronous_average
from cyclofeat.signal.orders import estimate_input_speed

Float = NDArray[np.float64]

_BINS = 240
_ROUNDS = 3  # of alignment
# The search has a fixed number of steps: a smaller tolerance gives a finer speed and a sharper picture.
_FINE_TOLERANCE = SPEED_TOLERANCE / 2


@dataclass(frozen=True)
class PhaseMap:
    """Torque folded over one turn of the input ("input"), or over the passage of all lobes ("lobe").

    Arrays (n_bins,): share of the turn at the middle of each bin; mean ripple in Nm over recordings, each
    shifted in phase to fit the others best, and the standard deviation of one; and ``flagged`` bins, whose
    means differ by Welch's t-test at the level alpha, Bonferroni over the bins. These mark a picture and are
    no part of the verdict: alignment favours agreement.
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
    kinematics: Kinematics,
    alpha: float,
    speeds: tuple[Float, Float] | None = None,
) -> dict[str, PhaseMap]:
    """Fold torque (n_windows, n_samples) over the input's turn and over the passage of the lobes.

    ``speeds`` are the mean input speeds in Hz of measured and simulated windows, by default from mesh lines.
    """
    maps = {}
    rate, n_lobes = kinematics.sampling_rate, kinematics.n_lobes
    known: list[Float] = list(speeds or ())
    for X in () if speeds else (measured, simulated):
        # With finer steps near the nominal speed.
        nominal_hz = kinematics.input_speed_hz
        near = estimate_input_speed(X, rate, nominal_hz, _FINE_TOLERANCE, comb="mesh", n_lobes=n_lobes)
        far = speeds_by_mesh(np.asarray(X, dtype=np.float64), rate, nominal_hz, n_lobes)
        known.append(np.where(np.abs(far / nominal_hz - 1) > _FINE_TOLERANCE, far, near))
    for name, per_turn in (("input", 1.0), ("lobe", (n_lobes + 1) / n_lobes)):
        folded = [
            _fold_windows(X, speed * per_turn / rate)
            for X, speed in zip((measured, simulated), known, strict=True)
        ]
        # The mean of the simulated waves shifted to fit it, by iteration from the largest of them.
        reference = np.asarray(folded[1][int(np.argmax(folded[1].var(axis=1)))])
        for _ in range(_ROUNDS):
            reference = np.mean([_align_wave(wave, reference) for wave in folded[1]], axis=0)
        aligned = [np.array([_align_wave(wave, reference) for wave in waves]) for waves in folded]
        p = stats.ttest_ind(*aligned, equal_var=False, axis=0).pvalue
        of_measured, of_simulated = aligned
        maps[name] = PhaseMap(
            name,
            phase=(np.arange(_BINS) + 0.5) / _BINS,
            measured=of_measured.mean(axis=0),
            simulated=of_simulated.mean(axis=0),
            measured_spread=of_measured.std(axis=0, ddof=1),
            simulated_spread=of_simulated.std(axis=0, ddof=1),
            flagged=np.asarray(p * _BINS <= alpha),
        )
    return maps


def _fold_windows(X: NDArray[Any], turns_per_sample: Float) -> Float:
    """Mean of each bin of the turn, less the window's mean: (n_windows, _BINS)."""
    waves = []
    for x, step in zip(X, turns_per_sample, strict=True):
        mean, slot, _ = synchronous_average(x - x.mean(), float(step), _BINS)
        filled = np.unique(slot)
        # If a turn has few samples, always at the same phases, some bins are empty: interpolate.
        waves.append(np.interp(np.arange(_BINS), filled, mean[filled], period=_BINS))
    return np.array(waves)


def _align_wave(wave: Float, reference: Float) -> Float:
    """Return the wave shifted to its largest circular correlation with the reference."""
    correlation = np.fft.irfft(np.fft.rfft(reference) * np.conj(np.fft.rfft(wave)), wave.size)
    return np.roll(wave, int(np.argmax(correlation)))
