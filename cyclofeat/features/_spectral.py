"""Features of the power spectral density."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.sklearn_private import StrOptions
from cyclofeat.features.base import WindowTransformer
from cyclofeat.features.registry import REGISTRY, band_qualifier
from cyclofeat.signal import (
    PRESETS,
    band_mask,
    normalized_entropy,
    shannon_entropy,
    welch_frequencies,
    welch_psd,
)
from cyclofeat.signal.windows import Float


def lines_of(frequencies: Float, band: tuple[float, float] | None) -> NDArray[np.bool_] | slice:
    """Lines of a spectrum in a band, all of them for None; ``ValueError`` where the band does not fit."""
    return slice(None) if band is None else band_mask(frequencies, band)


@dataclass(eq=False, repr=False)
class SpectralTransformer(WindowTransformer):
    """Base of the transformers that need nothing but Welch's power spectral density of each window.

    A subclass implements ``_from_psd`` in place of ``_compute``, which lets a composite share one density.
    ``frequencies_`` are those of the density in Hz.
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **WindowTransformer._parameter_constraints,
        "preset": [StrOptions(set(PRESETS))],
    }

    preset: str = "matlab_pwelch"

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        self.frequencies_ = welch_frequencies(X.shape[1], self.sampling_rate)

    @abstractmethod
    def _from_psd(self, frequencies: Float, psd: Float) -> Float:
        """Features, shape (n_windows, n_features), of densities of shape (n_windows, n_bins) in Nm^2/Hz."""

    def _compute(self, X: NDArray[Any]) -> Float:
        return self._from_psd(*welch_psd(X, self.sampling_rate, self.preset))


@dataclass(eq=False, repr=False)
class SpectralEntropy(SpectralTransformer):
    """Spectral entropy of the torque in each window, in bits or normalized.

    Shannon entropy ``-sum(p log2(p))`` in bits (paper A eq. 8), or the normalized entropy
    ``-sum(p log2(p + epsilon)) / log2(N)`` (paper A eq. 4-7, epsilon assumed to be 2^-52), where p is Welch's
    power spectral density divided by its sum over the N lines of the band.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    preset : {"matlab_pwelch", "ripple"}, default="matlab_pwelch"
        Definition of the density, see :data:`cyclofeat.signal.PRESETS`. The default is paper A's: with the
        mean kept, the entropy over all frequencies mostly measures the ratio of ripple to mean.
    normalize : bool, default=False
        Whether to normalize to the range from 0 to 1.
    band : tuple of float, default=None
        Lower and upper limit in Hz, both included. ``None`` takes all frequencies.

    Notes
    -----
    The entropy depends on the length of the windows, through resolution and zero-padding: constant torque has
    1.26 bits in windows of 46,080 samples and 1.05 bits in 57,600. Compare windows of one length only.

    Under ``"matlab_pwelch"`` a constant window has the entropy of the Hamming window's transform, 0.84 bits
    without zero-padding, and one of fewer than 9 samples that of a flat spectrum.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import SpectralEntropy
    >>> time = np.arange(46_080) / 25_600
    >>> torque = 22 + np.outer([1, 4], np.sin(2 * np.pi * 133.3 * time))
    >>> transformer = SpectralEntropy(sampling_rate=25_600).fit(torque)
    >>> transformer.transform(torque).round(3)
    array([[1.274],
           [1.39 ]])
    >>> transformer.get_feature_names_out()
    array(['shannon_entropy_bits(matlab_pwelch)'], dtype=object)
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **SpectralTransformer._parameter_constraints,
        "normalize": ["boolean"],
        "band": [tuple, list, None],
    }

    normalize: bool = False
    band: tuple[float, float] | None = None

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        super()._learn(X, y)
        lines_of(self.frequencies_, self.band)  # raises where the band does not fit

    def _columns(self) -> list[str]:
        row = REGISTRY["normalized_entropy" if self.normalize else "shannon_entropy"]
        band = () if self.band is None else (band_qualifier(self.band),)
        return [row.column(self.preset, *band)]

    def _from_psd(self, frequencies: Float, psd: Float) -> Float:
        entropy = normalized_entropy if self.normalize else shannon_entropy
        return entropy(psd, frequencies, self.band)[:, np.newaxis]
