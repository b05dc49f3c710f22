"""Spectra of the torque: their shape, and their lines one by one."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat import signal
from cyclofeat._base.sklearn_private import Interval, StrOptions
from cyclofeat.features.base import POSITIVE, WindowTransformer, at_least, parameter
from cyclofeat.features.registry import REGISTRY, band_qualifier
from cyclofeat.signal.density import band_slice, checked_bands
from cyclofeat.signal.welch import AMPLITUDE_WINDOWS, EIGHT_SEGMENTS, PRESETS, welch_frequencies
from cyclofeat.signal.windows import Float

BAND = None, tuple, list, None  # default and constraints of a parameter
PRESET = StrOptions(set(PRESETS))


@dataclass(eq=False, repr=False)
class SpectralTransformer(WindowTransformer):
    """Base of the transformers that need nothing but Welch's power spectral density of each window.

    A subclass implements ``_from_psd`` in place of ``_compute_features``, which lets a composite share one
    density. ``frequencies_`` are those of the density in Hz. Windows, or their parts, must hold 288 samples.
    """

    preset: str = parameter("matlab_pwelch", PRESET)

    def _shortest_window(self) -> tuple[int, str]:
        return EIGHT_SEGMENTS

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        self.frequencies_ = welch_frequencies(X.shape[1], self.sampling_rate)
        # Raises where a parameter does not fit.
        self._from_psd(self.frequencies_, np.zeros((1, self.frequencies_.size)))

    @abstractmethod
    def _from_psd(self, frequencies: Float, psd: Float) -> Float:
        """Features, shape (n_windows, n_features), of densities of shape (n_windows, n_bins) in Nm^2/Hz."""

    def _compute_features(self, X: NDArray[Any]) -> Float:
        return self._from_psd(*signal.welch_psd(X, self.sampling_rate, self.preset))


@dataclass(eq=False, repr=False)
class CourseTransformer(SpectralTransformer):
    """Base of the transformers that give one number per density, of whole windows or of their parts.

    A subclass implements ``_value_of``.
    """

    preset: str = "ripple"
    band: tuple[float, float] | None = parameter(*BAND)
    n_parts: int = parameter(1, at_least(1))

    def _shortest_window(self) -> tuple[int, str]:
        of_part, what = super()._shortest_window()
        return of_part * self.n_parts, what

    @abstractmethod
    def _value_of(self) -> Callable[..., Float]:
        """Return the function of density, frequencies and band that gives the value."""

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        super()._fit_windows(X[:, : max(1, X.shape[1] // self.n_parts)], y)

    def _feature_names(self) -> list[str]:
        stated = [self.preset, *([] if self.band is None else [band_qualifier(self.band)])]
        value_of, digits = self._value_of(), len(str(self.n_parts))
        if isinstance(value_of, partial):
            stated += [f"{name}{value:.12g}" for name, value in value_of.keywords.items()]
            value_of = value_of.func
        parts = [[f"part{i:0{digits}d}of{self.n_parts}"] for i in range(self.n_parts)]
        row = REGISTRY[value_of.__name__]
        return [row.column(*stated, *part) for part in (parts if self.n_parts > 1 else [[]])]

    def _from_psd(self, frequencies: Float, psd: Float) -> Float:
        return self._value_of()(psd, frequencies, band=self.band)[:, np.newaxis]

    def _compute_features(self, X: NDArray[Any]) -> Float:
        if self.n_parts == 1:
            return super()._compute_features(X)
        length = max(1, X.shape[1] // self.n_parts)
        # A window of fewer samples than parts repeats its last ones.
        begins = np.minimum(np.arange(self.n_parts) * length, X.shape[1] - length)
        parts = X[:, begins[:, np.newaxis] + np.arange(length)]
        frequencies, psd = signal.welch_psd(parts.reshape(-1, length), self.sampling_rate, self.preset)
        return self._from_psd(frequencies, psd).reshape(len(X), self.n_parts)


@dataclass(eq=False, repr=False)
class SpectralEntropy(CourseTransformer):
    """Spectral entropy of the torque in each window, in bits or normalized.

    That of :func:`cyclofeat.signal.shannon_entropy` or of :func:`cyclofeat.signal.normalized_entropy`.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    preset : {"matlab_pwelch", "ripple"}, default="matlab_pwelch"
        Definition of the density (``cyclofeat.signal.welch.PRESETS``): the papers', with the mean kept, or
        the torque ripple alone. The default is paper A's entropy, which mostly measures the ratio of ripple
        to mean.
    band : tuple of float, default=None
        Lower and upper limit in Hz, both included. ``None`` takes all frequencies.
    n_parts : int, default=1
        Parts into which each window is cut, of ``n_samples // n_parts`` samples, what is left at the end
        dropped. One column per part: the course of the entropy.
    normalize : bool, default=False
        Whether to normalize to the range from 0 to 1.

    Notes
    -----
    Compare windows of one length only, on which the entropy depends (``docs/windows.rst``).

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import SpectralEntropy
    >>> torque = 22 + np.outer([1, 4], np.sin(2 * np.pi * 133.3 * np.arange(46_080) / 25_600))
    >>> SpectralEntropy(sampling_rate=25_600).fit_transform(torque).round(3)
    array([[1.274],
           [1.39 ]])
    """

    preset: str = "matlab_pwelch"
    normalize: bool = parameter(False, "boolean")

    def _value_of(self) -> Callable[..., Float]:
        return signal.normalized_entropy if self.normalize else signal.shannon_entropy


class SpectralFlatness(CourseTransformer):
    """Flatness of the power spectral density: :func:`cyclofeat.signal.spectral_flatness`.

    Parameters
    ----------
    sampling_rate, band, n_parts
        See :class:`SpectralEntropy`.
    preset : {"ripple", "matlab_pwelch"}, default="ripple"
        The torque ripple alone, or the papers' definition, in which the mean torque's line outweighs all.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import SpectralFlatness
    >>> noise = np.random.default_rng(0).normal(size=(2, 46_080))
    >>> noise[1] += 22
    >>> SpectralFlatness(sampling_rate=25_600, preset="matlab_pwelch").fit_transform(noise).round(2)
    array([[0.93],
           [0.  ]])
    """

    def _value_of(self) -> Callable[..., Float]:
        return signal.spectral_flatness


class SpectralCentroid(CourseTransformer):
    """Centroid of the power spectral density in Hz: :func:`cyclofeat.signal.spectral_centroid`.

    Parameters
    ----------
    sampling_rate, preset, band, n_parts
        See :class:`SpectralFlatness`; paper A fig. 14 shows such a course.

    Examples
    --------
    A tone that rises from 500 to 2000 Hz within the window:

    >>> import numpy as np
    >>> from cyclofeat.features import SpectralCentroid
    >>> time = np.arange(46_080) / 25_600
    >>> torque = 22 + np.where(time < 0.9, np.sin(2e3 * np.pi / 2 * time), np.sin(4e3 * np.pi * time))
    >>> course = SpectralCentroid(sampling_rate=25_600, n_parts=2)
    >>> course.fit_transform(torque[np.newaxis]).round()
    array([[ 500., 2000.]])
    """

    def _value_of(self) -> Callable[..., Float]:
        return signal.spectral_centroid


@dataclass(eq=False, repr=False)
class SpectralRolloff(CourseTransformer):
    """Frequency in Hz up to which a fraction of the power lies: :func:`cyclofeat.signal.spectral_rolloff`.

    Parameters
    ----------
    sampling_rate, preset, band, n_parts
        See :class:`SpectralFlatness`. With the mean kept, more than 95 % of the power of most torque lies
        next to 0 Hz.
    fraction
        See :func:`cyclofeat.signal.spectral_rolloff`.

    Notes
    -----
    The roll-off is the frequency of a line: it moves in steps of their distance, 1.56 Hz in windows of 46,080
    samples at 25.6 kHz.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import SpectralRolloff
    >>> time = np.arange(46_080) / 25_600
    >>> torque = 22 + np.sin(2 * np.pi * 400 * time) + 0.1 * np.sin(2 * np.pi * 4000 * time)
    >>> SpectralRolloff(sampling_rate=25_600).fit_transform(torque[np.newaxis])
    array([[403.125]])
    """

    fraction: float = parameter(0.95, Interval(Real, 0, 1, closed="right"))

    def _value_of(self) -> Callable[..., Float]:
        return partial(signal.spectral_rolloff, fraction=self.fraction)


@dataclass(eq=False, repr=False)
class NarrowbandRatio(SpectralTransformer):
    """Share of the power around the harmonics of a frequency: :func:`cyclofeat.signal.narrowband_ratio`.

    Parameters
    ----------
    sampling_rate, preset
        See :class:`SpectralFlatness`.
    fundamental_hz, half_width_hz, n_harmonics
        See :func:`cyclofeat.signal.narrowband_ratio`. Paper A's 100 Hz is order 12 at 500 RPM, and the mains'
        second harmonic.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import NarrowbandRatio
    >>> phase = 2 * np.pi * np.arange(46_080) / 25_600
    >>> torque = 22 + np.sin(300 * phase) + np.sin(350 * phase)
    >>> NarrowbandRatio(sampling_rate=25_600).fit_transform(torque[np.newaxis]).round(3)
    array([[0.5]])
    """

    preset: str = "ripple"
    fundamental_hz: float = parameter(100.0, POSITIVE)
    half_width_hz: float = parameter(5.0, Interval(Real, 0, None, closed="left"))
    n_harmonics: int | None = parameter(None, at_least(1), None)

    def _feature_names(self) -> list[str]:
        count = "all" if self.n_harmonics is None else f"{self.n_harmonics}"
        width = f"{count}x{self.fundamental_hz:.12g}Hz+-{self.half_width_hz:.12g}Hz"
        return [REGISTRY["narrowband_ratio"].column(self.preset, width)]

    def _from_psd(self, frequencies: Float, psd: Float) -> Float:
        lines = self.fundamental_hz, self.half_width_hz, self.n_harmonics
        return signal.narrowband_ratio(psd, frequencies, *lines)[:, np.newaxis]


@dataclass(eq=False, repr=False)
class BandPower(SpectralTransformer):
    """Power of the torque in bands, in Nm^2: :func:`cyclofeat.signal.band_power`.

    Parameters
    ----------
    sampling_rate, preset
        See :class:`SpectralEntropy`. With the mean kept, the lowest band holds the square of the mean
        torque.
    bands : sequence of tuple of float, default=None
        Lower and upper limits in Hz, both included. ``None`` takes :func:`cyclofeat.signal.octave_bands`.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import BandPower
    >>> torque = 22 + 3 * np.sin(2 * np.pi * 400 * np.arange(46_080) / 25_600)
    >>> transformer = BandPower(sampling_rate=25_600, bands=[(0, 50), (300, 500)])
    >>> transformer.fit_transform(torque[np.newaxis]).round(2)
    array([[483.96,   4.5 ]])
    >>> transformer.get_feature_names_out()[0]
    'band_power_nm2(matlab_pwelch;0..50Hz)'
    """

    bands: Sequence[tuple[float, float]] | None = parameter(*BAND)

    def _feature_names(self) -> list[str]:
        bands = checked_bands(self.frequencies_, self.bands)
        return [REGISTRY["band_power"].column(self.preset, band_qualifier(band)) for band in bands]

    def _from_psd(self, frequencies: Float, psd: Float) -> Float:
        return signal.band_power(psd, frequencies, self.bands)


_FLOOR = 1e-30  # Nm^2/Hz, read as -300 dB


@dataclass(eq=False, repr=False)
class WelchPSD(SpectralTransformer):
    """Welch's power spectral density, one column per line: :func:`cyclofeat.signal.welch_psd`.

    Parameters
    ----------
    sampling_rate, preset
        See :class:`SpectralEntropy`.
    band : tuple of float, default=None
        Lower and upper limit in Hz of the lines kept, both included. ``None`` keeps all: 8193 lines, 64 KiB,
        per window of 46,080 samples.
    decibels : bool, default=False
        Whether to give ``10 log10`` of the density over 1 Nm^2/Hz instead of the density in Nm^2/Hz. What is
        below 1e-30 Nm^2/Hz, zero included, reads -300 dB.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import WelchPSD
    >>> torque = 22 + np.sin(2 * np.pi * 400 * np.arange(46_080) / 25_600)
    >>> transformer = WelchPSD(sampling_rate=25_600, preset="ripple", band=(390, 410))
    >>> psd = transformer.fit_transform(torque[np.newaxis])
    >>> transformer.get_feature_names_out()[psd[0].argmax()]
    'psd_nm2_per_hz(ripple;400Hz)'
    """

    band: tuple[float, float] | None = parameter(*BAND)
    decibels: bool = parameter(False, "boolean")

    def _feature_names(self) -> list[str]:
        row = REGISTRY["psd_level" if self.decibels else "psd"]
        frequencies = self.frequencies_[band_slice(self.frequencies_, self.band)]
        return [row.column(self.preset, f"{frequency:.12g}Hz") for frequency in frequencies]

    def _from_psd(self, frequencies: Float, psd: Float) -> Float:
        inside = psd[:, band_slice(frequencies, self.band)]
        return 10 * np.log10(np.maximum(inside, _FLOOR)) if self.decibels else inside


@dataclass(eq=False, repr=False)
class AmplitudeSpectrum(WindowTransformer):
    """Amplitudes of spectral lines in Nm, one column per line: :func:`cyclofeat.signal.amplitude_spectrum`.

    Parameters
    ----------
    sampling_rate, band
        See :class:`WelchPSD`.
    n_fft, window
        See :func:`cyclofeat.signal.amplitude_spectrum`.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import AmplitudeSpectrum
    >>> torque = 22 + 3 * np.sin(2 * np.pi * 400 * np.arange(46_080) / 25_600)
    >>> AmplitudeSpectrum(25_600, band=(400, 405)).fit_transform(torque[np.newaxis]).round(2)
    array([[3.  , 1.28]])
    """

    n_fft: int = parameter(8192, at_least(2))
    window: str = parameter("hamming", StrOptions(set(AMPLITUDE_WINDOWS)))
    band: tuple[float, float] | None = parameter(*BAND)

    def _shortest_window(self) -> tuple[int, str]:
        return self.n_fft, "one block of the transform"

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        # One window's spectrum: raises where a parameter does not fit.
        self.frequencies_, _ = signal.amplitude_spectrum(X[:1], self.sampling_rate, self.n_fft, self.window)
        band_slice(self.frequencies_, self.band)

    def _feature_names(self) -> list[str]:
        frequencies = self.frequencies_[band_slice(self.frequencies_, self.band)]
        definition = f"{self.window}{self.n_fft}"
        return [REGISTRY["amplitude"].column(definition, f"{frequency:.12g}Hz") for frequency in frequencies]

    def _compute_features(self, X: NDArray[Any]) -> Float:
        _, amplitudes = signal.amplitude_spectrum(X, self.sampling_rate, self.n_fft, self.window)
        return amplitudes[:, band_slice(self.frequencies_, self.band)]
