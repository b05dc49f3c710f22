"""Whole spectra as features, one column per line."""

from __future__ import annotations

from numbers import Integral
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._sklearn import Interval, StrOptions
from cyclofeat.features._base import WindowTransformer
from cyclofeat.features._registry import REGISTRY
from cyclofeat.features._spectral import SpectralTransformer
from cyclofeat.spectral import AMPLITUDE_WINDOWS, amplitude_spectrum, band_mask

_FLOOR = 1e-30  # Nm^2/Hz, read as -300 dB


def _line_qualifier(frequency: float) -> str:
    return f"{frequency:.12g}Hz"


class WelchPSD(SpectralTransformer):
    """Welch's power spectral density (paper A section 5.3): one column per line.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    preset : {"matlab_pwelch", "ripple"}, default="matlab_pwelch"
        Definition of the density, see :data:`cyclofeat.spectral.PRESETS`.
    band : tuple of float, default=None
        Lower and upper limit in Hz of the lines kept, both included. ``None`` keeps all.
    decibels : bool, default=False
        Whether to give ``10 log10`` of the density over 1 Nm^2/Hz instead of the density in Nm^2/Hz. What is
        below 1e-30 Nm^2/Hz, zero included, reads -300 dB.

    Attributes
    ----------
    frequencies_ : ndarray, shape (n_bins,)
        Frequencies of the density in Hz, before the band is cut out.
    n_features_in_ : int
        Samples in a window.
    feature_names_in_ : ndarray of str, shape (n_samples,)
        Names of the samples, if ``fit`` was given a data frame.

    See Also
    --------
    cyclofeat.spectral.welch_psd : The same as a function.

    Notes
    -----
    The density grows with the square of the torque's scale; under ``"ripple"`` it does not depend on the
    mean. Windows of 46,080 samples have 8193 lines, 64 KiB per window.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import WelchPSD
    >>> torque = 22 + np.sin(2 * np.pi * 400 * np.arange(46_080) / 25_600)
    >>> transformer = WelchPSD(sampling_rate=25_600, preset="ripple", band=(390, 410))
    >>> psd = transformer.fit_transform(torque[np.newaxis])
    >>> transformer.get_feature_names_out()[psd[0].argmax()]
    'psd_nm2_per_hz(ripple;400Hz)'

    In pictures, on surrogate torque: ``examples/features/plot_spectra.py``.
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **SpectralTransformer._parameter_constraints,
        "band": [tuple, list, None],
        "decibels": ["boolean"],
    }

    def __init__(
        self,
        sampling_rate: float,
        preset: str = "matlab_pwelch",
        band: tuple[float, float] | None = None,
        decibels: bool = False,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.preset = preset
        self.band = band
        self.decibels = decibels

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        super()._learn(X, y)
        self._lines(self.frequencies_)  # raises where the band does not fit

    def _lines(self, frequencies: NDArray[np.float64]) -> NDArray[np.bool_] | slice:
        return slice(None) if self.band is None else band_mask(frequencies, self.band)

    def _columns(self) -> list[str]:
        row = REGISTRY["psd_level" if self.decibels else "psd"]
        kept = self.frequencies_[self._lines(self.frequencies_)]
        return [row.column(self.preset, _line_qualifier(frequency)) for frequency in kept]

    def _from_psd(self, frequencies: NDArray[np.float64], psd: NDArray[np.float64]) -> NDArray[np.float64]:
        kept = psd[:, self._lines(frequencies)]
        return 10 * np.log10(np.maximum(kept, _FLOOR)) if self.decibels else kept


class AmplitudeSpectrum(WindowTransformer):
    """Amplitudes of the torque's spectral lines in Nm (paper B section 6): one column per line.

    Each window is cut into blocks of ``n_fft`` samples that begin ``n_fft // 2`` samples apart; each block is
    multiplied by the window function; the squared moduli of their transforms are averaged, and the root is
    scaled so that a sine on a line reads its amplitude, constant torque its value.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    n_fft : int, default=8192
        Samples in a block; even.
    window : {"hamming", "hann", "blackman", "boxcar", "flattop"}, default="hamming"
        Window by which each block is multiplied; symmetric, as MATLAB's are.
    band : tuple of float, default=None
        Lower and upper limit in Hz of the lines kept, both included. ``None`` keeps all.

    Attributes
    ----------
    frequencies_ : ndarray, shape (n_fft // 2 + 1,)
        Frequencies of the lines in Hz, before the band is cut out.
    n_features_in_ : int
        Samples in a window.
    feature_names_in_ : ndarray of str, shape (n_samples,)
        Names of the samples, if ``fit`` was given a data frame.

    See Also
    --------
    cyclofeat.spectral.amplitude_spectrum : The same as a function, with the equation.

    Notes
    -----
    The amplitudes grow with the torque's scale; its mean is kept and fills the line at 0 Hz. The average over
    blocks is an assumption, as paper B names only the length and the window. Windows of fewer samples than a
    block are tapered over their own length and zero-padded; a window of zeros has amplitudes 0.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import AmplitudeSpectrum
    >>> torque = 22 + 3 * np.sin(2 * np.pi * 400 * np.arange(46_080) / 25_600)
    >>> transformer = AmplitudeSpectrum(sampling_rate=25_600, band=(400, 405))
    >>> transformer.fit_transform(torque[np.newaxis]).round(2)
    array([[3.  , 1.28]])
    >>> transformer.get_feature_names_out()[0]
    'amplitude_nm(hamming8192;400Hz)'

    In pictures, on surrogate torque: ``examples/features/plot_spectra.py``.
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **WindowTransformer._parameter_constraints,
        "n_fft": [Interval(Integral, 2, None, closed="left")],
        "window": [StrOptions(set(AMPLITUDE_WINDOWS))],
        "band": [tuple, list, None],
    }

    def __init__(
        self,
        sampling_rate: float,
        n_fft: int = 8192,
        window: str = "hamming",
        band: tuple[float, float] | None = None,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.n_fft = n_fft
        self.window = window
        self.band = band

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        # One window's spectrum: raises where a parameter does not fit.
        self.frequencies_, _ = amplitude_spectrum(X[:1], self.sampling_rate, self.n_fft, self.window)
        self._lines()

    def _lines(self) -> NDArray[np.bool_] | slice:
        return slice(None) if self.band is None else band_mask(self.frequencies_, self.band)

    def _columns(self) -> list[str]:
        kept = self.frequencies_[self._lines()]
        definition = f"{self.window}{self.n_fft}"
        return [REGISTRY["amplitude"].column(definition, _line_qualifier(frequency)) for frequency in kept]

    def _compute(self, X: NDArray[Any]) -> NDArray[np.float64]:
        _, amplitudes = amplitude_spectrum(X, self.sampling_rate, self.n_fft, self.window)
        return amplitudes[:, self._lines()]
