"""What a named effect is measured against: simulators and black boxes that close the gap otherwise."""

from __future__ import annotations

import dataclasses
import itertools
import os
import warnings
from collections.abc import Callable, Sequence
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from cyclofeat.gap._null import Bank, NuisancePrior, make_bank
from cyclofeat.gap._recordings import per_recording
from cyclofeat.simulators import (
    CompositeSimulator,
    ContactDampingScale,
    ContactStiffnessScale,
    CycloidalGearbox,
    Rig,
)

Float = NDArray[np.float64]
Simulator = CompositeSimulator | Rig | CycloidalGearbox | None

_SEGMENT_S = 0.25  # of the averaged spectra, which resolve the lines of lobes and shaft
_MOST_GAIN = 2.0  # of the equaliser: what the model lacks beyond it is no wrong gain, and comes as noise
_BANDS_PER_OCTAVE = 6
_LOWEST_HZ = 6.0
_RETUNED_SIMS = 100  # two parameters
_FEWEST_PER_COUNT = 4
_POWER_FLOOR = 1e-18  # Nm^2/Hz


@dataclasses.dataclass(frozen=True)
class FitData:
    """Recordings: windows, the recording of each, counts of recordings, angles of windows."""

    windows: NDArray[Any]
    of_window: NDArray[np.intp]
    counts: NDArray[np.int64] | None
    angle: NDArray[Any] | None = None


class Banks:
    """Simulated recordings on demand, each set simulated once.

    Parameters
    ----------
    nuisance, sampling_rate, input_speed_hz, n, n_jobs, cache
        As :func:`cyclofeat.gap.make_bank` takes them.
    """

    def __init__(
        self,
        nuisance: NuisancePrior,
        sampling_rate: float,
        input_speed_hz: float,
        n: int,
        n_jobs: int = 1,
        cache: str | os.PathLike[str] | None = None,
    ) -> None:
        self.nuisance = nuisance
        self.sampling_rate = sampling_rate
        self.input_speed_hz = input_speed_hz
        self.n = n
        self.n_jobs = n_jobs
        self.cache = cache
        self._made: dict[tuple[Any, ...], Bank] = {}

    def make(
        self, simulator: Simulator, counts: Sequence[int] | None, n_samples: int, random_state: int
    ) -> Bank:
        """Bank of a simulator; the same seed for all simulators pairs their random numbers."""
        n = self.n if counts is None else max(self.n, _FEWEST_PER_COUNT * len(counts))
        text = self.nuisance.simulator(simulator).to_rig().to_text()
        key = (text, None if counts is None else tuple(counts), n_samples, random_state)
        if key not in self._made:
            self._made[key] = make_bank(
                simulator,
                self.nuisance,
                counts,
                n=n,
                n_samples=n_samples,
                sampling_rate=self.sampling_rate,
                random_state=random_state,
                n_jobs=self.n_jobs,
                cache=self.cache,
            )
        return self._made[key]


class Alternative(Protocol):
    """Something that gives torque records for wanted counts."""

    def fit(self, data: FitData, banks: Banks, random_state: int) -> Self:
        """Fit on the fit recordings."""

    def records(self, banks: Banks, counts: Sequence[int] | None, n_samples: int, random_state: int) -> Bank:
        """Records of the wanted counts, gone through in turn."""


class Simulated:
    """A simulator as it is.

    Parameters
    ----------
    simulator : CompositeSimulator, Rig, CycloidalGearbox or None
    """

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator

    def fit(self, data: FitData, banks: Banks, random_state: int) -> Self:
        """Nothing to fit."""
        return self

    def records(self, banks: Banks, counts: Sequence[int] | None, n_samples: int, random_state: int) -> Bank:
        """Its bank."""
        return banks.make(self.simulator, counts, n_samples, random_state)


class Retuned(Simulated):
    """The simulator with stiffness and damping of all contacts fitted, and nothing else.

    What an engineer does first, and what absorbs a missing effect where it can.
    """

    def fit(self, data: FitData, banks: Banks, random_state: int) -> Self:
        """Fit both factors by :class:`cyclofeat.gap.EffectFitter`."""
        from cyclofeat.gap._fitter import EffectFitter

        fitter = EffectFitter(
            [ContactStiffnessScale(1.0), ContactDampingScale(1.0)],
            banks.sampling_rate,
            self.simulator,
            banks.nuisance,
            banks.input_speed_hz,
            n_sims=_RETUNED_SIMS,
            n_interval=0,
            starts=(),
            random_state=random_state,
            n_jobs=banks.n_jobs,
            cache=banks.cache,
        )
        y = None if data.counts is None else data.counts[data.of_window]
        fitter.fit(data.windows, y=y, groups=data.of_window, angle=data.angle)
        self.fitter_ = fitter
        self.simulator = fitter.simulator_
        return self


class _Filtered:
    """A black box behind the simulator: its records, changed."""

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator

    def fit(self, data: FitData, banks: Banks, random_state: int) -> Self:
        """Fit to the difference between averaged spectra and means, count by count where counts are known."""
        self.sampling_rate_ = banks.sampling_rate
        known = None if data.counts is None else np.unique(data.counts).tolist()
        bank = banks.make(self.simulator, known, data.windows.shape[1], random_state)
        of_measured, of_simulated = data.counts, bank.counts
        self.by_count_ = of_measured is not None
        if of_measured is None:
            of_measured = np.zeros(int(data.of_window.max()) + 1, dtype=np.int64)
            of_simulated = np.zeros(len(bank.X), dtype=np.int64)
        frequencies, measured = averaged_psd(data.windows, banks.sampling_rate)
        _, simulated = averaged_psd(bank.X, banks.sampling_rate)
        measured = per_recording(measured, data.of_window)
        level_measured = per_recording(data.windows.mean(axis=1, dtype=np.float64)[:, None], data.of_window)
        level_simulated = bank.X.mean(axis=1, dtype=np.float64)
        counts = np.intersect1d(of_measured, of_simulated)
        self._learn(
            frequencies,
            counts,
            np.array([measured[of_measured == c].mean(axis=0) for c in counts]),
            np.array([simulated[of_simulated == c].mean(axis=0) for c in counts]),
            np.array(
                [level_measured[of_measured == c].mean() - level_simulated[of_simulated == c].mean()
                 for c in counts]
            ),
        )  # fmt: skip
        return self

    def records(self, banks: Banks, counts: Sequence[int] | None, n_samples: int, random_state: int) -> Bank:
        """The simulator's bank, changed."""
        bank = banks.make(self.simulator, counts, n_samples, random_state)
        changed = [
            self._changed(np.asarray(x, dtype=np.float64), int(c), np.random.default_rng([random_state, i]))
            for i, (x, c) in enumerate(zip(bank.X, bank.counts, strict=True))
        ]
        return dataclasses.replace(bank, X=np.array(changed, dtype=np.float32), key="")

    def _learn(
        self, frequencies: Float, counts: NDArray[Any], measured: Float, simulated: Float, offsets: Float
    ) -> None:
        raise NotImplementedError

    def _changed(self, x: Float, count: int, random: np.random.Generator) -> Float:
        raise NotImplementedError


class Equaliser(_Filtered):
    """FIR equaliser with shaped noise and an offset behind the simulator.

    |H|^2 is the ratio of the measured to the simulated averaged density, the geometric mean over counts,
    which is the least-squares solution for the logarithms; a gain above 2 is cut, and the power that is then
    still missing is added as Gaussian noise of that density. Linear phase without delay, of 0.25 s; offset:
    the mean difference of the mean torques. One and the same for every count.
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


class GaussianProcessGap(_Filtered):
    """Gaussian process of what the spectrum lacks, over log frequency and count, behind the simulator.

    The discrepancy model of Kennedy and O'Hagan (2001) for the level of the density in sixths of an octave:
    a squared-exponential kernel with one length per input, its sizes by maximum likelihood; applied to the
    simulator's records as a filter of zero phase. The mean torque's difference is a Gaussian process over
    the count. Where counts are not known (or there is one), frequency is the only input.
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


BASELINES: dict[str, Callable[[Simulator], Alternative]] = {
    "nothing": Simulated,
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
    """Taps of an FIR of odd length around its middle with the gain given on an even grid up to Nyquist."""
    grid = np.linspace(0, sampling_rate / 2, frequencies.size)
    values = np.interp(grid, frequencies, gain)
    # The density of the lowest lines is what the mean's removal has left: they take their neighbours' gain.
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
    # The values are scaled to mean 0 and variance 1: so is the kernel.
    kernel = ConstantKernel(1.0, (1e-2, 1e2)) * RBF(lengths, bounds) + WhiteKernel(0.1, (1e-4, 10.0))
    process = GaussianProcessRegressor(kernel, normalize_y=True)
    with warnings.catch_warnings():
        # A length at its bound says that the input does not matter: no trouble.
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(inputs, values)
    return process
