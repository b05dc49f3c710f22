"""Envelope spectrum of the level that holds the mesh frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.sklearn_private import Interval
from cyclofeat.features._wavelet import WaveletTransformer
from cyclofeat.features.registry import REGISTRY
from cyclofeat.signal.wavelets import envelope_lines, level_envelope, level_of
from cyclofeat.signal.windows import Float


@dataclass(eq=False, repr=False)
class WaveletEnvelopeSpectrum(WaveletTransformer):
    """Envelope spectrum of the wavelet level that holds the mesh frequency (paper A section 5.1).

    The mesh frequency is ``shaft_hz * n_pins``; level j holds it if fs/2^(j+1) <= f < fs/2^j. The features
    describe the Hilbert envelope of this level's torque
    (:func:`cyclofeat.signal.wavelets.level_envelope`):

    - mean of the envelope in Nm,
    - amplitude of the envelope in Nm at the harmonics 1, 2, ... of the shaft,
    - the same at the harmonics of the mesh.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz. For windows on equal steps of the shaft's angle: samples per input turn.
    wavelet : str, pywt.Wavelet or sequence of four filters, default="mb32.3"
        Name of PyWavelets or of the Morris family, a wavelet, or a filter bank (dec_lo, dec_hi, rec_lo,
        rec_hi).
    shaft_hz : float, default=500/60
        Speed of the input shaft in turns per second. For windows on equal steps of the angle: 1.
    n_pins : int, default=16
        Number of external sleeves: meshings per turn of the input.
    n_shaft_harmonics : int, default=15
        Number of harmonics of the shaft.
    n_mesh_harmonics : int, default=3
        Number of harmonics of the mesh.
    speed_tolerance : float, default=0.015
        How far harmonics may lie off, relative to their frequency: the largest amplitude within it counts.
        For windows on equal steps of the angle: 0.

    Attributes
    ----------
    level_ : int
        The level that holds the mesh frequency: 7 for the papers' drive at 25.6 kHz.

    Notes
    -----
    Only windows of several input turns resolve the shaft's harmonics. A constant window has features 0.

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
    >>> features = transformer.fit_transform(torque[np.newaxis])[0]
    >>> for name, value in zip(transformer.get_feature_names_out(), features):
    ...     print(name, value.round(2))
    wavelet_envelope_mean_nm(mb32.3;level07) 0.98
    wavelet_envelope_line_nm(mb32.3;level07;shaft01) 0.39
    wavelet_envelope_line_nm(mb32.3;level07;shaft02) 0.0
    wavelet_envelope_line_nm(mb32.3;level07;mesh01) 0.1
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **WaveletTransformer._parameter_constraints,
        "shaft_hz": [Interval(Real, 0, None, closed="neither")],
        "n_pins": [Interval(Integral, 1, None, closed="left")],
        "n_shaft_harmonics": [Interval(Integral, 0, None, closed="left")],
        "n_mesh_harmonics": [Interval(Integral, 0, None, closed="left")],
        "speed_tolerance": [Interval(Real, 0, 0.2, closed="left")],
    }

    shaft_hz: float = 500 / 60
    n_pins: int = 16
    n_shaft_harmonics: int = 15
    n_mesh_harmonics: int = 3
    speed_tolerance: float = 0.015

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        super()._learn(X, y)
        mesh = self.shaft_hz * self.n_pins
        if mesh >= self.sampling_rate / 2:
            raise ValueError(
                f"the mesh frequency shaft_hz * n_pins = {mesh:g} must lie below half of sampling_rate="
                f"{self.sampling_rate:g}: sample faster, or check shaft_hz={self.shaft_hz:g}"
            )
        self.level_ = level_of(mesh, self.sampling_rate)
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

    def _columns(self) -> list[str]:
        definition = (self._bank(), f"level{self.level_:02d}")
        line = REGISTRY["wavelet_envelope_line"]
        shaft = [line.column(*definition, f"shaft{k:02d}") for k in range(1, self.n_shaft_harmonics + 1)]
        mesh = [line.column(*definition, f"mesh{k:02d}") for k in range(1, self.n_mesh_harmonics + 1)]
        return [REGISTRY["wavelet_envelope_mean"].column(*definition), *shaft, *mesh]

    def _depth(self) -> int:
        return self.level_

    def _from_coefficients(self, X: NDArray[Any], coefficients: Sequence[Float]) -> Float:
        detail = coefficients[self.level_ - 1]
        envelope, step = level_envelope(detail, self.level_, self.wavelet, X.shape[1])
        harmonics = np.r_[
            np.arange(1, self.n_shaft_harmonics + 1), self.n_pins * np.arange(1, self.n_mesh_harmonics + 1)
        ]
        rate = self.sampling_rate / step
        lines = envelope_lines(envelope, rate, harmonics * self.shaft_hz, self.speed_tolerance)
        return np.hstack([envelope.mean(axis=1, keepdims=True), lines])
