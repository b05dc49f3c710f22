"""Alternatives to the gap's corrected model: the model with retuned contacts, and black boxes behind it."""

from __future__ import annotations

import dataclasses
import itertools
import warnings
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, signal
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from cyclofeat.gap import Comparison
from cyclofeat.gap.comparison import summarise_bank
from cyclofeat.gap.proof.prove import Counts, simulate_alternative
from cyclofeat.gap.simulations import Bank
from cyclofeat.gap.summaries.summarise import smallest_spreads
from cyclofeat.gap.summaries.turns import MeasuredTurns, class_means, less_class_means, per_recording
from cyclofeat.simulators import Rig, Scale, SimulationFailed

Float = NDArray[np.float64]

_SEGMENT_S = 0.25  # length of a segment of the averaged spectra, which resolve the lines of lobes and shaft
_MOST_GAIN = 2.0  # limit of the gain of the equaliser; power that is still missing is added as noise
_BANDS_PER_OCTAVE = 6
_LOWEST_HZ = 6.0
_RETUNED_CALLS, _RETUNED_SIMS = 30, 8
_RETUNED_FROM = ((0.0, 0.0), (np.log(2), 0.0), (0.0, np.log(2)))  # logarithms of both factors
_RETUNED_WITHIN = ((-4.0, 4.0), (-4.0, 4.0))
_POWER_FLOOR = 1e-18  # Nm^2/Hz


class BlackBox:
    """Base of the alternatives: the original model, with ``n_bank`` simulated recordings."""

    def __init__(self, n_bank: int) -> None:
        self.n_bank = n_bank

    def fit(self, comparison: Comparison, measured: MeasuredTurns) -> Self:
        """Fit to measured recordings."""
        raise NotImplementedError

    def records(self, comparison: Comparison, counts: Counts) -> Bank:
        """Return recordings of the fitted alternative."""
        return simulate_alternative(comparison, counts, self.n_bank)


class Retuned(BlackBox):
    """Model with the stiffness and damping of all contacts fitted, as an engineer would try first."""

    def fit(self, comparison: Comparison, measured: MeasuredTurns) -> Self:
        """Bring the mean summaries of few simulated recordings next to the measured ones.

        The recordings have the same random numbers whatever the factors (Nelder and Mead 1965).
        """
        counts = None if measured.counts is None else np.unique(measured.counts).tolist()
        wanted = class_means(measured.values, measured.counts_or_zeros)
        n, smallest = max(_RETUNED_SIMS, 2 * len(counts or ())), smallest_spreads(measured.cells)

        def misfit(logarithms: Float) -> float:
            retuned = comparison.replace(rig=_with_contacts(comparison.rig, logarithms))
            try:
                bank = retuned.bank(n, counts)
            except SimulationFailed:
                return np.inf
            of_count = 0 * bank.counts if counts is None else bank.counts
            values = summarise_bank(retuned, bank)
            means = class_means(values, of_count)
            spread = np.hypot(less_class_means(values, of_count, means).std(axis=0), smallest)
            differences = [(wanted[count] - mean) / spread for count, mean in means.items()]
            return float(np.sum(np.square(differences)))

        found = optimize.minimize(
            misfit, np.zeros(2), method="Nelder-Mead", bounds=_RETUNED_WITHIN,
            options={"maxfev": _RETUNED_CALLS, "initial_simplex": _RETUNED_FROM},
        )  # fmt: skip
        self.rig_ = _with_contacts(comparison.rig, found.x)
        return self

    def records(self, comparison: Comparison, counts: Counts) -> Bank:
        """Return recordings of the model with the fitted contacts."""
        return simulate_alternative(comparison.replace(rig=self.rig_), counts, self.n_bank)


def _with_contacts(rig: Rig, logarithms: Float) -> Rig:
    """Return the rig with stiffness and damping of all contacts by factors."""
    stiffness, damping = np.exp(logarithms).tolist()
    return rig.with_added(Scale("contact_stiffness", stiffness), Scale("contact_damping", damping))


class FilteredModel(BlackBox):
    """Black box that changes the records of the model."""

    def fit(self, comparison: Comparison, measured: MeasuredTurns) -> Self:
        """Fit to the difference between averaged spectra and means, count by count where counts are known."""
        self.sampling_rate_ = comparison.sampling_rate
        self.by_count_ = measured.counts is not None
        bank = super().records(
            comparison, np.unique(measured.counts_or_zeros).tolist() if self.by_count_ else None
        )
        of_simulated = bank.counts if self.by_count_ else 0 * bank.counts
        frequencies, psd = averaged_psd(measured.windows, comparison.sampling_rate)
        level = measured.windows.mean(axis=1, dtype=np.float64)[:, None]
        _, simulated_psd = averaged_psd(bank.X, comparison.sampling_rate)
        simulated_level = bank.X.mean(axis=1, dtype=np.float64)[:, None]
        of_measured = measured.counts_or_zeros
        spectra, levels = (
            class_means(per_recording(v, measured.of_window), of_measured) for v in (psd, level)
        )
        simulated_spectra, simulated_levels = (
            class_means(v, of_simulated) for v in (simulated_psd, simulated_level)
        )
        counts = np.intersect1d(of_measured, of_simulated)
        of_measured_counts = np.array([spectra[c] for c in counts])
        of_simulated_counts = np.array([simulated_spectra[c] for c in counts])
        offsets = np.array([(levels[c] - simulated_levels[c])[0] for c in counts])
        self._learn(frequencies, counts, of_measured_counts, of_simulated_counts, offsets)
        return self

    def records(self, comparison: Comparison, counts: Counts) -> Bank:
        """Return changed records of the model."""
        bank, state = super().records(comparison, counts), comparison.random_state
        changed = [
            self._changed(np.asarray(x, dtype=np.float64), int(c), np.random.default_rng([state, i]))
            for i, (x, c) in enumerate(zip(bank.X, bank.counts, strict=True))
        ]
        return dataclasses.replace(bank, X=np.array(changed, dtype=np.float32))

    def _learn(
        self, frequencies: Float, counts: NDArray[Any], measured: Float, simulated: Float, offsets: Float
    ) -> None:
        raise NotImplementedError

    def _changed(self, x: Float, count: int, random: np.random.Generator) -> Float:
        raise NotImplementedError


class Equaliser(FilteredModel):
    """FIR equaliser with shaped noise and an offset behind the model, the same for every count.

    |H|^2 is the ratio of the measured to the simulated averaged density, as the geometric mean over counts.
    The gain is limited to 2, and the power that is still missing is added as Gaussian noise of that density.
    The filter has 0.25 s, linear phase and no delay. The offset is the mean difference of the mean torques.
    """

    def _learn(
        self, frequencies: Float, counts: NDArray[Any], measured: Float, simulated: Float, offsets: Float
    ) -> None:
        ratio = np.exp(np.mean(np.log((measured + _POWER_FLOOR) / (simulated + _POWER_FLOOR)), axis=0))
        gain = np.minimum(np.sqrt(ratio), _MOST_GAIN)
        missing = np.mean(np.maximum(ratio / gain**2 - 1, 0) * gain**2 * simulated, axis=0)
        self.taps_ = _linear_phase(frequencies, gain, self.sampling_rate_)
        # White noise of unit variance has the one-sided density 2 / sampling rate.
        self.noise_taps_ = _linear_phase(
            frequencies, np.sqrt(missing * self.sampling_rate_ / 2), self.sampling_rate_
        )
        self.offset_ = float(offsets.mean())

    def _changed(self, x: Float, count: int, random: np.random.Generator) -> Float:
        mean = x.mean()
        half = self.taps_.size // 2
        padded = np.pad(x - mean, half, mode="reflect")
        ripple = signal.fftconvolve(padded, self.taps_, mode="valid")
        white = random.normal(size=x.size + self.noise_taps_.size - 1)
        noise = signal.fftconvolve(white, self.noise_taps_, mode="valid")
        return np.asarray(mean + self.offset_ + ripple + noise)


class GaussianProcessGap(FilteredModel):
    """Gaussian process of the spectrum's error, over log frequency and count, behind the model.

    This is the discrepancy model of Kennedy and O'Hagan (2001) for the level of the density in sixths of an
    octave. The kernel is squared-exponential with one length per input, fitted by maximum likelihood. The
    result is applied to the records of the simulator as a zero-phase filter. The difference of the mean
    torque is a Gaussian process over the count. If counts are unknown, or there is only one, frequency is the
    only input.
    """

    def _learn(
        self, frequencies: Float, counts: NDArray[Any], measured: Float, simulated: Float, offsets: Float
    ) -> None:
        self.centres_, pooling = _octave_bands(frequencies)
        levels = 10 * np.log10((measured @ pooling.T + _POWER_FLOOR) / (simulated @ pooling.T + _POWER_FLOOR))
        self.with_count_ = self.by_count_ and len(counts) > 1
        inputs = np.vstack([self._inputs(int(c)) for c in counts])
        lengths, bounds = [0.5, 3.0], [(0.05, 10.0), (2.0, 50.0)]
        k = inputs.shape[1]
        self.process_ = _fitted_process(inputs, levels.ravel(), lengths[:k], bounds[:k])
        self.offset_ = float(offsets.mean())
        self.offset_process_ = None
        if self.with_count_:
            self.offset_process_ = _fitted_process(
                counts[:, None].astype(float), offsets, lengths[1:], bounds[1:]
            )
        self.gains_: dict[int, Float] = {}

    def _inputs(self, count: int) -> Float:
        octaves = np.log2(self.centres_)
        return np.column_stack([octaves, np.full(octaves.size, count)] if self.with_count_ else [octaves])

    def _changed(self, x: Float, count: int, random: np.random.Generator) -> Float:
        if count not in self.gains_:
            self.gains_[count] = self.process_.predict(self._inputs(count))
        offset = self.offset_
        if self.offset_process_ is not None:
            offset = float(self.offset_process_.predict([[float(count)]])[0])
        mean = x.mean()
        margin = min(round(_SEGMENT_S * self.sampling_rate_), x.size - 1)
        padded = np.pad(x - mean, margin, mode="reflect")
        frequencies = np.fft.rfftfreq(padded.size, 1 / self.sampling_rate_)
        octaves = np.log2(np.maximum(frequencies, self.centres_[0]))
        gain = 10 ** (np.interp(octaves, np.log2(self.centres_), self.gains_[count]) / 20)
        ripple = np.fft.irfft(gain * np.fft.rfft(padded), padded.size)[margin : margin + x.size]
        return np.asarray(mean + offset + ripple)


BLACK_BOXES: dict[str, type[BlackBox]] = {
    "retuned": Retuned,
    "equaliser": Equaliser,
    "gaussian_process": GaussianProcessGap,
}


def averaged_psd(X: NDArray[Any], sampling_rate: float) -> tuple[Float, Float]:
    """Frequencies in Hz and Welch's density of each window's ripple in Nm^2/Hz, over 0.25 s."""
    n = min(round(_SEGMENT_S * sampling_rate), X.shape[1])
    ripple = np.asarray(X, dtype=np.float64) - X.mean(axis=1, keepdims=True, dtype=np.float64)
    frequencies, psd = signal.welch(ripple, sampling_rate, nperseg=n, detrend=False, axis=1)
    return frequencies, psd


def _linear_phase(frequencies: Float, gain: Float, sampling_rate: float) -> Float:
    """Return the taps of a symmetric FIR filter with a gain given on an even grid up to Nyquist."""
    grid = np.linspace(0, sampling_rate / 2, frequencies.size)
    values = np.interp(grid, frequencies, gain)
    # The removal of the mean distorts the lowest lines: use the gain beside them.
    values[:2] = values[2]
    n_taps = 2 * (frequencies.size - 1) // 2 * 2 + 1
    return np.asarray(signal.firwin2(n_taps, grid, values, fs=sampling_rate, window="hann"))


def _octave_bands(frequencies: Float) -> tuple[Float, Float]:
    """Centres in Hz of bands of a sixth of an octave that hold a line, and the bands as rows of weights."""
    low, high = np.log2(_LOWEST_HZ), np.log2(frequencies[-1])
    edges = 2.0 ** np.arange(low, high, 1 / _BANDS_PER_OCTAVE)
    rows, centres = [], []
    for a, b in itertools.pairwise(edges):
        inside = (frequencies >= a) & (frequencies < b)
        if inside.any():
            rows.append(inside / inside.sum())
            centres.append(float(np.sqrt(a * b)))
    return np.array(centres), np.array(rows)


def _fitted_process(
    inputs: Float, values: Float, lengths: list[float], bounds: list[tuple[float, float]]
) -> GaussianProcessRegressor:
    # The values are scaled to mean 0 and variance 1, so the kernel has a variance of about 1.
    kernel = ConstantKernel(1.0, (1e-2, 1e2)) * RBF(lengths, bounds) + WhiteKernel(0.1, (1e-4, 10.0))
    process = GaussianProcessRegressor(kernel, normalize_y=True)
    with warnings.catch_warnings():
        # A length at its bound means that the input has no influence.
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(inputs, values)
    return process
