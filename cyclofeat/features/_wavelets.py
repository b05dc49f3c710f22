"""Levels of a wavelet transform: their statistics, and the envelope of one."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import numpy as np
import pywt
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.sklearn_private import Interval
from cyclofeat.features.base import INPUT_SPEED_HZ, SPEED_TOLERANCE, WindowTransformer, at_least, parameter
from cyclofeat.features.registry import REGISTRY
from cyclofeat.signal import wavelets
from cyclofeat.signal.windows import Float

# Defaults and constraints of parameters.
WAVELET = "mb32.3", str, pywt.Wavelet, "array-like"
LEVELS = 12, Interval(Integral, 1, 30, closed="both")
COLOURS = 64, at_least(2)


@dataclass(eq=False, repr=False)
class WaveletTransformer(WindowTransformer):
    """Base of the transformers that read the discrete wavelet transform of each window.

    A subclass implements ``_deepest_level`` and ``_from_coefficients`` in place of ``_compute_features``,
    which lets a composite share one transform, as deep as the deepest of its parts needs.
    """

    wavelet: wavelets.AnyWavelet = parameter(*WAVELET)

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        wavelets.as_wavelet(self.wavelet)  # raises where it is none

    @abstractmethod
    def _deepest_level(self) -> int:
        """Number of levels that ``_from_coefficients`` reads."""

    @abstractmethod
    def _from_coefficients(self, X: NDArray[Any], coefficients: Sequence[Float]) -> Float:
        """Features, shape (n_windows, n_features), of windows and their transform.

        ``coefficients`` are those of ``signal.wavelets.dwt``, of at least ``_deepest_level()`` levels.
        """

    def _compute_features(self, X: NDArray[Any]) -> Float:
        return self._from_coefficients(X, wavelets.dwt(X, self.wavelet, self._deepest_level()))


_STATISTICS = ("rms", "energy_share", "kurtosis", "lowest_colour")


@dataclass(eq=False, repr=False)
class WaveletLevelStatistics(WaveletTransformer):
    """Energy, peakedness and quiet of each level of a wavelet transform (paper B figs. 10-12 in numbers).

    Those of :func:`cyclofeat.signal.wavelets.level_statistics`: rms in Nm, share of the energy, kurtosis
    (the peaks of worn lobes raise it) and share of the lowest colour (paper B's "lack of vibrations") of each
    level, from the highest frequencies down.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz. Level k holds about ``sampling_rate / 2^(k+1)`` to ``sampling_rate / 2^k``.
    wavelet : str, pywt.Wavelet or sequence of four filters, default="mb32.3"
        Wavelet, see :func:`cyclofeat.signal.wavelets.as_wavelet`.
    levels : int, default=12
        Number of levels, 1 to 30. The share of energy is that in all of them.
    colours : int, default=64
        Number of colours of the scalogram.

    Notes
    -----
    A constant window has rms, share and kurtosis 0 and is of the lowest colour throughout. Windows must
    hold ``2 ** levels`` samples: in shorter ones, deep levels show how the window was continued.

    Examples
    --------
    A tone of 133.3 Hz, without and with bursts of 2 kHz at every input turn:

    >>> import numpy as np
    >>> from cyclofeat.features import WaveletLevelStatistics
    >>> time = np.arange(46_080) / 25_600
    >>> burst = np.exp(-((time * 500 / 60 % 1 - 0.5) * 300) ** 2) * np.sin(2 * np.pi * 2000 * time)
    >>> torque = 22 + np.sin(2 * np.pi * 133.3 * time) + np.outer([0, 1], burst)
    >>> transformer = WaveletLevelStatistics(sampling_rate=25_600).fit(torque)
    >>> features = dict(zip(transformer.get_feature_names_out(), transformer.transform(torque).T))
    >>> features["wavelet_lowest_colour(mb32.3;64colours;level03)"].round(2)
    array([0.01, 0.31])
    """

    levels: int = parameter(*LEVELS)
    colours: int = parameter(*COLOURS)

    def _shortest_window(self) -> tuple[int, str]:
        return 1 << self.levels, "one coefficient of the deepest level"

    def _feature_names(self) -> list[str]:
        columns = []
        for name in _STATISTICS:
            row = REGISTRY[f"wavelet_{name}"]
            # The share depends on which levels it is a share of.
            more = {"lowest_colour": (f"{self.colours}colours",), "energy_share": (f"of{self.levels}levels",)}
            definition = (wavelets.wavelet_qualifier(self.wavelet), *more.get(name, ()))
            columns += [row.column(*definition, f"level{level:02d}") for level in range(1, self.levels + 1)]
        return columns

    def _deepest_level(self) -> int:
        return self.levels

    def _from_coefficients(self, X: NDArray[Any], coefficients: Sequence[Float]) -> Float:
        details = coefficients[: self.levels + 1]  # the last one is not used
        return np.hstack([*wavelets.level_statistics(details, X.shape[1], self.colours).values()])


@dataclass(eq=False, repr=False)
class WaveletEnvelopeSpectrum(WaveletTransformer):
    """Envelope spectrum of the wavelet level that holds the mesh frequency (paper A section 5.1).

    Mean of that level's envelope (:func:`cyclofeat.signal.wavelets.level_envelope`) and its amplitudes at
    the harmonics of the shaft and of the mesh (:func:`~cyclofeat.signal.wavelets.envelope_lines`), in Nm.

    Parameters
    ----------
    sampling_rate, wavelet
        See :class:`WaveletLevelStatistics`; samples per input turn for windows on equal steps of the angle.
    shaft_hz : float, default=500/60
        Speed of the input shaft in turns per second; 1 for windows on equal steps of the angle.
    n_pins : int, default=16
        Number of external sleeves: the mesh frequency is ``shaft_hz * n_pins``.
    n_shaft_harmonics : int, default=15
        Number of harmonics of the shaft.
    n_mesh_harmonics : int, default=3
        Number of harmonics of the mesh.
    speed_tolerance : float, default=0.015
        How far harmonics may lie off, relative to their frequency; 0 for windows on equal steps of the angle.

    Attributes
    ----------
    level_ : int
        The level that holds the mesh frequency: 7 for the papers' drive at 25.6 kHz.

    Notes
    -----
    Only windows of four input turns resolve the shaft's harmonics. A constant window has features 0.

    A level taken alone has an image: a tone at f comes with a weaker one at fs/2^j - f, which other levels
    would have cancelled. At 500 RPM and 25.6 kHz the mesh's 133.3 Hz has its image at 66.7 Hz, and the two
    beat at shaft harmonic 8 and at the mesh frequency itself: judge these by comparison only. Paper A found
    that the method does not tell numbers of worn lobes apart.

    Examples
    --------
    Mesh torque whose amplitude swings by 40 % once per turn of the shaft:

    >>> import numpy as np
    >>> from cyclofeat.features import WaveletEnvelopeSpectrum
    >>> phase = 2 * np.pi * np.arange(46_080) / 25_600 * 500 / 60
    >>> torque = 22 + (1 + 0.4 * np.cos(phase)) * np.sin(16 * phase)
    >>> transformer = WaveletEnvelopeSpectrum(sampling_rate=25_600, n_shaft_harmonics=2, n_mesh_harmonics=1)
    >>> print(transformer.fit_transform(torque[np.newaxis])[0].round(2))
    [0.98 0.39 0.   0.1 ]
    """

    shaft_hz: float = parameter(*INPUT_SPEED_HZ)
    n_pins: int = parameter(16, at_least(1))
    n_shaft_harmonics: int = parameter(15, at_least(0))
    n_mesh_harmonics: int = parameter(3, at_least(0))
    speed_tolerance: float = parameter(*SPEED_TOLERANCE)

    def _shortest_window(self) -> tuple[int, str]:
        lowest = self.shaft_hz if self.n_shaft_harmonics else self.shaft_hz * self.n_pins
        what = "four turns of the shaft, or four periods of the mesh without shaft harmonics"
        return int(4 * self.sampling_rate / lowest), what

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        super()._fit_windows(X, y)
        mesh = self.shaft_hz * self.n_pins
        if mesh >= self.sampling_rate / 2:
            raise ValueError(
                f"the mesh frequency shaft_hz * n_pins = {mesh:g} must lie below half of sampling_rate="
                f"{self.sampling_rate:g}: sample faster, or check shaft_hz={self.shaft_hz:g}"
            )
        self.level_ = wavelets.level_of(mesh, self.sampling_rate)
        # What the envelope holds: its sampling rate is that of three levels up.
        highest = self.sampling_rate / 2 ** max(self.level_ - 3, 0) / 2
        for name, base, number in (
            ("n_shaft_harmonics", self.shaft_hz, self.n_shaft_harmonics),
            ("n_mesh_harmonics", mesh, self.n_mesh_harmonics),
        ):
            if number * base * (1 + self.speed_tolerance) > highest:
                raise ValueError(
                    f"{name}={number} reaches {number * base * (1 + self.speed_tolerance):g} Hz, but the "
                    f"envelope of level {self.level_} holds frequencies up to {highest:g} Hz: "
                    f"at most {int(highest / base / (1 + self.speed_tolerance))}"
                )

    def _feature_names(self) -> list[str]:
        definition = (wavelets.wavelet_qualifier(self.wavelet), f"level{self.level_:02d}")
        line = REGISTRY["wavelet_envelope_line"]
        shaft = [line.column(*definition, f"shaft{k:02d}") for k in range(1, self.n_shaft_harmonics + 1)]
        mesh = [line.column(*definition, f"mesh{k:02d}") for k in range(1, self.n_mesh_harmonics + 1)]
        return [REGISTRY["wavelet_envelope_mean"].column(*definition), *shaft, *mesh]

    def _deepest_level(self) -> int:
        return self.level_

    def _from_coefficients(self, X: NDArray[Any], coefficients: Sequence[Float]) -> Float:
        detail = coefficients[self.level_ - 1]
        envelope, step = wavelets.level_envelope(detail, self.level_, self.wavelet, X.shape[1])
        harmonics = np.r_[
            np.arange(1, self.n_shaft_harmonics + 1), self.n_pins * np.arange(1, self.n_mesh_harmonics + 1)
        ]
        rate = self.sampling_rate / step
        lines = wavelets.envelope_lines(envelope, rate, harmonics * self.shaft_hz, self.speed_tolerance)
        return np.hstack([envelope.mean(axis=1, keepdims=True), lines])
