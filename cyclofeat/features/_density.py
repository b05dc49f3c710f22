"""What the shape of the power spectral density says, per window or as a course over its parts."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._density import checked_bands
from cyclofeat._sklearn import Interval
from cyclofeat.features._registry import REGISTRY, band_qualifier
from cyclofeat.features._spectral import SpectralTransformer
from cyclofeat.spectral import (
    band_mask,
    band_power,
    narrowband_mask,
    narrowband_ratio,
    spectral_centroid,
    spectral_flatness,
    spectral_rolloff,
    welch_frequencies,
    welch_psd,
)


class CourseTransformer(SpectralTransformer):
    """Base of the transformers that give one number per density, of whole windows or of their parts.

    A subclass implements ``_value`` and names its row of the registry.
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **SpectralTransformer._parameter_constraints,
        "band": [tuple, list, None],
        "n_parts": [Interval(Integral, 1, None, closed="left")],
    }
    _row: ClassVar[str]

    band: tuple[float, float] | None
    n_parts: int

    @abstractmethod
    def _value(self, frequencies: NDArray[np.float64], psd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Value, shape (n_windows,), of densities of shape (n_windows, n_bins)."""

    def _qualifiers(self) -> tuple[str, ...]:
        """Qualifiers of a column's name besides preset, band and part."""
        return ()

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        self.frequencies_ = welch_frequencies(self._part_length(X), self.sampling_rate)
        if self.band is not None:
            band_mask(self.frequencies_, self.band)  # raises where the band does not fit

    def _part_length(self, X: NDArray[Any]) -> int:
        return max(1, int(X.shape[1]) // self.n_parts)

    def _columns(self) -> list[str]:
        row = REGISTRY[self._row]
        band = [] if self.band is None else [band_qualifier(self.band)]
        stated = [self.preset, *band, *self._qualifiers()]
        if self.n_parts == 1:
            return [row.column(*stated)]
        digits = len(str(self.n_parts))
        return [row.column(*stated, f"part{i:0{digits}d}of{self.n_parts}") for i in range(self.n_parts)]

    def _from_psd(self, frequencies: NDArray[np.float64], psd: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._value(frequencies, psd)[:, np.newaxis]

    def _compute(self, X: NDArray[Any]) -> NDArray[np.float64]:
        if self.n_parts == 1:
            return super()._compute(X)
        length = self._part_length(X)
        # A window of fewer samples than parts repeats its last ones.
        begins = np.minimum(np.arange(self.n_parts) * length, X.shape[1] - length)
        parts = X[:, begins[:, np.newaxis] + np.arange(length)]
        frequencies, psd = welch_psd(parts.reshape(-1, length), self.sampling_rate, self.preset)
        return self._value(frequencies, psd).reshape(len(X), self.n_parts)


class SpectralFlatness(CourseTransformer):
    """Flatness of the power spectral density: geometric over arithmetic mean (paper A eq. 9).

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    preset : {"matlab_pwelch", "ripple"}, default="matlab_pwelch"
        Definition of the density, see :data:`cyclofeat.spectral.PRESETS`.
    band : tuple of float, default=None
        Lower and upper limit in Hz, both included. ``None`` takes all frequencies.
    n_parts : int, default=1
        Parts into which each window is cut, of ``n_samples // n_parts`` samples, what is left at the end
        dropped. One column per part: the course of the flatness.

    Attributes
    ----------
    frequencies_ : ndarray, shape (n_bins,)
        Frequencies of the density in Hz.
    n_features_in_ : int
        Samples in a window.
    feature_names_in_ : ndarray of str, shape (n_samples,)
        Names of the samples, if ``fit`` was given a data frame.

    See Also
    --------
    cyclofeat.spectral.spectral_flatness : The same as a function.

    Notes
    -----
    The flatness does not depend on the scale of the torque and, under ``"ripple"``, not on its mean. A
    single line without power makes it 0, as the product of eq. 9 is; a window without any power has flatness
    0, too (zeros; under ``"ripple"`` any constant and any window of fewer than 9 samples).

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import SpectralFlatness
    >>> noise = np.random.default_rng(0).normal(size=(2, 46_080))
    >>> noise[1] += 22
    >>> SpectralFlatness(sampling_rate=25_600).fit_transform(noise).round(2)
    array([[0.93],
           [0.  ]])

    In pictures, on surrogate torque: ``examples/features/plot_spectral_shape.py``.
    """

    _row = "spectral_flatness"

    def __init__(
        self,
        sampling_rate: float,
        preset: str = "matlab_pwelch",
        band: tuple[float, float] | None = None,
        n_parts: int = 1,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.preset = preset
        self.band = band
        self.n_parts = n_parts

    def _value(self, frequencies: NDArray[np.float64], psd: NDArray[np.float64]) -> NDArray[np.float64]:
        return spectral_flatness(psd, frequencies, self.band)


class SpectralCentroid(CourseTransformer):
    """Centroid of the power spectral density, its mean frequency in Hz (paper A section 5.4).

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    preset : {"matlab_pwelch", "ripple"}, default="matlab_pwelch"
        Definition of the density, see :data:`cyclofeat.spectral.PRESETS`. With the mean kept, its line at
        0 Hz draws the centroid to a few Hz, as in paper A table 5.
    band : tuple of float, default=None
        Lower and upper limit in Hz, both included. ``None`` takes all frequencies.
    n_parts : int, default=1
        Parts into which each window is cut, of ``n_samples // n_parts`` samples, what is left at the end
        dropped. One column per part: the course of the centroid, as in paper A fig. 14.

    Attributes
    ----------
    frequencies_ : ndarray, shape (n_bins,)
        Frequencies of the density in Hz.
    n_features_in_ : int
        Samples in a window.
    feature_names_in_ : ndarray of str, shape (n_samples,)
        Names of the samples, if ``fit`` was given a data frame.

    See Also
    --------
    cyclofeat.spectral.spectral_centroid : The same as a function.

    Notes
    -----
    The centroid does not depend on the scale of the torque and, under ``"ripple"``, not on its mean. A window
    without power has centroid 0: a window of zeros and, under ``"ripple"``, any constant window and any of
    fewer than 9 samples.

    Examples
    --------
    A tone that rises from 500 to 2000 Hz within the window:

    >>> import numpy as np
    >>> from cyclofeat.features import SpectralCentroid
    >>> time = np.arange(46_080) / 25_600
    >>> torque = 22 + np.where(time < 0.9, np.sin(2e3 * np.pi / 2 * time), np.sin(4e3 * np.pi * time))
    >>> course = SpectralCentroid(sampling_rate=25_600, preset="ripple", n_parts=2)
    >>> course.fit_transform(torque[np.newaxis]).round()
    array([[ 500., 2000.]])
    >>> course.get_feature_names_out()[0]
    'spectral_centroid_hz(ripple;part0of2)'

    In pictures, on surrogate torque: ``examples/features/plot_spectral_shape.py``.
    """

    _row = "spectral_centroid"

    def __init__(
        self,
        sampling_rate: float,
        preset: str = "matlab_pwelch",
        band: tuple[float, float] | None = None,
        n_parts: int = 1,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.preset = preset
        self.band = band
        self.n_parts = n_parts

    def _value(self, frequencies: NDArray[np.float64], psd: NDArray[np.float64]) -> NDArray[np.float64]:
        return spectral_centroid(psd, frequencies, self.band)


class SpectralRolloff(CourseTransformer):
    """Frequency in Hz up to which a fraction of the power lies (paper A section 5.4: 95 %).

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    preset : {"matlab_pwelch", "ripple"}, default="matlab_pwelch"
        Definition of the density, see :data:`cyclofeat.spectral.PRESETS`. With the mean kept, more than 95 %
        of the power of most torque lies next to 0 Hz.
    fraction : float, default=0.95
        Fraction of the power, above 0 and at most 1.
    band : tuple of float, default=None
        Lower and upper limit in Hz, both included. ``None`` takes all frequencies.
    n_parts : int, default=1
        Parts into which each window is cut, of ``n_samples // n_parts`` samples, what is left at the end
        dropped. One column per part: the course of the roll-off, as in paper A fig. 14.

    Attributes
    ----------
    frequencies_ : ndarray, shape (n_bins,)
        Frequencies of the density in Hz.
    n_features_in_ : int
        Samples in a window.
    feature_names_in_ : ndarray of str, shape (n_samples,)
        Names of the samples, if ``fit`` was given a data frame.

    See Also
    --------
    cyclofeat.spectral.spectral_rolloff : The same as a function.

    Notes
    -----
    The roll-off is the frequency of a line: it moves in steps of their distance, 1.56 Hz in windows of 46,080
    samples at 25.6 kHz. It does not depend on the scale of the torque and, under ``"ripple"``, not on its
    mean. A window without power has roll-off 0: a window of zeros and, under ``"ripple"``, any constant
    window and any of fewer than 9 samples.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import SpectralRolloff
    >>> time = np.arange(46_080) / 25_600
    >>> torque = 22 + np.sin(2 * np.pi * 400 * time) + 0.1 * np.sin(2 * np.pi * 4000 * time)
    >>> SpectralRolloff(sampling_rate=25_600, preset="ripple").fit_transform(torque[np.newaxis])
    array([[403.125]])

    In pictures, on surrogate torque: ``examples/features/plot_spectral_shape.py``.
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **CourseTransformer._parameter_constraints,
        "fraction": [Interval(Real, 0, 1, closed="right")],
    }
    _row = "spectral_rolloff"

    def __init__(
        self,
        sampling_rate: float,
        preset: str = "matlab_pwelch",
        fraction: float = 0.95,
        band: tuple[float, float] | None = None,
        n_parts: int = 1,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.preset = preset
        self.fraction = fraction
        self.band = band
        self.n_parts = n_parts

    def _qualifiers(self) -> tuple[str, ...]:
        return (f"fraction{self.fraction:.12g}",)

    def _value(self, frequencies: NDArray[np.float64], psd: NDArray[np.float64]) -> NDArray[np.float64]:
        return spectral_rolloff(psd, frequencies, self.fraction, self.band)


class NarrowbandRatio(SpectralTransformer):
    """Share of the power around the harmonics of a frequency (paper A section 5.5).

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    preset : {"matlab_pwelch", "ripple"}, default="matlab_pwelch"
        Definition of the density, see :data:`cyclofeat.spectral.PRESETS`. With the mean kept, its line at
        0 Hz counts in the total.
    fundamental_hz : float, default=100.0
        Fundamental in Hz. Paper A's 100 Hz is order 12 at 500 RPM, and the mains' second harmonic.
    half_width_hz : float, default=5.0
        A line counts if it is no farther than this from a harmonic, in Hz. The line nearest to each harmonic
        always counts. **Assumption**: paper A gives no width.
    n_harmonics : int, default=None
        Number of harmonics. ``None`` takes all up to half of the sampling rate.

    Attributes
    ----------
    frequencies_ : ndarray, shape (n_bins,)
        Frequencies of the density in Hz.
    n_features_in_ : int
        Samples in a window.
    feature_names_in_ : ndarray of str, shape (n_samples,)
        Names of the samples, if ``fit`` was given a data frame.

    See Also
    --------
    cyclofeat.spectral.narrowband_ratio : The same as a function.

    Notes
    -----
    The ratio does not depend on the scale of the torque and, under ``"ripple"``, not on its mean. It is 0 for
    a window without power: a window of zeros and, under ``"ripple"``, any constant window and any of fewer
    than 9 samples.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import NarrowbandRatio
    >>> phase = 2 * np.pi * np.arange(46_080) / 25_600
    >>> torque = 22 + np.sin(300 * phase) + np.sin(350 * phase)
    >>> NarrowbandRatio(sampling_rate=25_600, preset="ripple").fit_transform(torque[np.newaxis]).round(3)
    array([[0.5]])

    In pictures, on surrogate torque: ``examples/features/plot_band_power.py``.
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **SpectralTransformer._parameter_constraints,
        "fundamental_hz": [Interval(Real, 0, None, closed="neither")],
        "half_width_hz": [Interval(Real, 0, None, closed="left")],
        "n_harmonics": [Interval(Integral, 1, None, closed="left"), None],
    }

    def __init__(
        self,
        sampling_rate: float,
        preset: str = "matlab_pwelch",
        fundamental_hz: float = 100.0,
        half_width_hz: float = 5.0,
        n_harmonics: int | None = None,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.preset = preset
        self.fundamental_hz = fundamental_hz
        self.half_width_hz = half_width_hz
        self.n_harmonics = n_harmonics

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        super()._learn(X, y)
        # Raises where the harmonics do not fit.
        narrowband_mask(self.frequencies_, self.fundamental_hz, self.half_width_hz, self.n_harmonics)

    def _columns(self) -> list[str]:
        count = "all" if self.n_harmonics is None else f"{self.n_harmonics}"
        width = f"{count}x{self.fundamental_hz:.12g}Hz+-{self.half_width_hz:.12g}Hz"
        return [REGISTRY["narrowband_ratio"].column(self.preset, width)]

    def _from_psd(self, frequencies: NDArray[np.float64], psd: NDArray[np.float64]) -> NDArray[np.float64]:
        ratio = narrowband_ratio(psd, frequencies, self.fundamental_hz, self.half_width_hz, self.n_harmonics)
        return ratio[:, np.newaxis]


class BandPower(SpectralTransformer):
    """Power of the torque in bands, in Nm^2: the mean square of what the band holds.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    preset : {"matlab_pwelch", "ripple"}, default="matlab_pwelch"
        Definition of the density, see :data:`cyclofeat.spectral.PRESETS`. With the mean kept, the lowest band
        holds the square of the mean torque.
    bands : sequence of tuple of float, default=None
        Lower and upper limits in Hz, both included. ``None`` takes those of
        :func:`cyclofeat.spectral.octave_bands`: 0 to 1/256 of the sampling rate and seven octaves above.

    Attributes
    ----------
    frequencies_ : ndarray, shape (n_bins,)
        Frequencies of the density in Hz.
    n_features_in_ : int
        Samples in a window.
    feature_names_in_ : ndarray of str, shape (n_samples,)
        Names of the samples, if ``fit`` was given a data frame.

    See Also
    --------
    cyclofeat.spectral.band_power : The same as a function.

    Notes
    -----
    The power grows with the square of the torque's scale; under ``"ripple"`` it does not depend on the mean,
    and is 0 for any constant window and any of fewer than 9 samples.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import BandPower
    >>> torque = 22 + 3 * np.sin(2 * np.pi * 400 * np.arange(46_080) / 25_600)
    >>> transformer = BandPower(sampling_rate=25_600, bands=[(0, 50), (300, 500)])
    >>> transformer.fit_transform(torque[np.newaxis]).round(2)
    array([[483.96,   4.5 ]])
    >>> transformer.get_feature_names_out()
    array(['band_power_nm2(matlab_pwelch;0..50Hz)',
           'band_power_nm2(matlab_pwelch;300..500Hz)'], dtype=object)

    In pictures, on surrogate torque: ``examples/features/plot_band_power.py``.
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **SpectralTransformer._parameter_constraints,
        "bands": [tuple, list, None],
    }

    def __init__(
        self,
        sampling_rate: float,
        preset: str = "matlab_pwelch",
        bands: Sequence[tuple[float, float]] | None = None,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.preset = preset
        self.bands = bands

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        super()._learn(X, y)
        checked_bands(self.frequencies_, self.bands)  # raises where a band does not fit

    def _columns(self) -> list[str]:
        bands = checked_bands(self.frequencies_, self.bands)
        return [REGISTRY["band_power"].column(self.preset, band_qualifier(band)) for band in bands]

    def _from_psd(self, frequencies: NDArray[np.float64], psd: NDArray[np.float64]) -> NDArray[np.float64]:
        return band_power(psd, frequencies, self.bands)
