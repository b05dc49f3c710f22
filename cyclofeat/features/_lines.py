"""Whole spectra as features, one column per line."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.sklearn_private import Interval, StrOptions
from cyclofeat.features._spectral import SpectralTransformer, lines_of
from cyclofeat.features.base import WindowTransformer
from cyclofeat.features.registry import REGISTRY
from cyclofeat.signal import AMPLITUDE_WINDOWS, amplitude_spectrum
from cyclofeat.signal.windows import Float

_FLOOR = 1e-30  # Nm^2/Hz, read as -300 dB


@dataclass(eq=False, repr=False)
class WelchPSD(SpectralTransformer):
    """Welch's power spectral density (paper A section 5.3): one column per line.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    preset : {"matlab_pwelch", "ripple"}, default="matlab_pwelch"
        Definition of the density, see :data:`cyclofeat.signal.PRESETS`.
    band : tuple of float, default=None
        Lower and upper limit in Hz of the lines kept, both included. ``None`` keeps all.
    decibels : bool, default=False
        Whether to give ``10 log10`` of the density over 1 Nm^2/Hz instead of the density in Nm^2/Hz. What is
        below 1e-30 Nm^2/Hz, zero included, reads -300 dB.

    Notes
    -----
    Windows of 46,080 samples have 8193 lines, 64 KiB per window.

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

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **SpectralTransformer._parameter_constraints,
        "band": [tuple, list, None],
        "decibels": ["boolean"],
    }

    band: tuple[float, float] | None = None
    decibels: bool = False

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        super()._learn(X, y)
        lines_of(self.frequencies_, self.band)  # raises where the band does not fit

    def _columns(self) -> list[str]:
        row = REGISTRY["psd_level" if self.decibels else "psd"]
        frequencies = self.frequencies_[lines_of(self.frequencies_, self.band)]
        return [row.column(self.preset, f"{frequency:.12g}Hz") for frequency in frequencies]

    def _from_psd(self, frequencies: Float, psd: Float) -> Float:
        inside = psd[:, lines_of(frequencies, self.band)]
        return 10 * np.log10(np.maximum(inside, _FLOOR)) if self.decibels else inside


@dataclass(eq=False, repr=False)
class AmplitudeSpectrum(WindowTransformer):
    """Amplitudes of the torque's spectral lines in Nm (paper B section 6): one column per line.

    A sine on a line reads its amplitude, constant torque its value; see
    :func:`cyclofeat.signal.amplitude_spectrum` for the equation.

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
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **WindowTransformer._parameter_constraints,
        "n_fft": [Interval(Integral, 2, None, closed="left")],
        "window": [StrOptions(set(AMPLITUDE_WINDOWS))],
        "band": [tuple, list, None],
    }

    n_fft: int = 8192
    window: str = "hamming"
    band: tuple[float, float] | None = None

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        # One window's spectrum: raises where a parameter does not fit.
        self.frequencies_, _ = amplitude_spectrum(X[:1], self.sampling_rate, self.n_fft, self.window)
        lines_of(self.frequencies_, self.band)

    def _columns(self) -> list[str]:
        frequencies = self.frequencies_[lines_of(self.frequencies_, self.band)]
        definition = f"{self.window}{self.n_fft}"
        return [REGISTRY["amplitude"].column(definition, f"{frequency:.12g}Hz") for frequency in frequencies]

    def _compute(self, X: NDArray[Any]) -> Float:
        _, amplitudes = amplitude_spectrum(X, self.sampling_rate, self.n_fft, self.window)
        return amplitudes[:, lines_of(self.frequencies_, self.band)]
