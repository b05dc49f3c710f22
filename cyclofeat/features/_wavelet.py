"""Base class of transformers that need a wavelet transform of each window."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import pywt
from numpy.typing import ArrayLike, NDArray

from cyclofeat.features.base import WindowTransformer
from cyclofeat.signal.wavelets import AnyWavelet, as_wavelet, dwt, wavelet_qualifier
from cyclofeat.signal.windows import Float


@dataclass(eq=False, repr=False)
class WaveletTransformer(WindowTransformer):
    """Base of the transformers that read the discrete wavelet transform of each window.

    A subclass implements ``_depth`` and ``_from_coefficients`` in place of ``_compute``, which lets a
    composite share one transform, as deep as the deepest of its parts needs.
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **WindowTransformer._parameter_constraints,
        "wavelet": [str, pywt.Wavelet, "array-like"],
    }

    wavelet: AnyWavelet = "mb32.3"

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        as_wavelet(self.wavelet)  # raises where it is none

    def _bank(self) -> str:
        """Name of the wavelet in feature names; the same for the same filters."""
        return wavelet_qualifier(self.wavelet)

    @abstractmethod
    def _depth(self) -> int:
        """Number of levels that ``_from_coefficients`` reads."""

    @abstractmethod
    def _from_coefficients(self, X: NDArray[Any], coefficients: Sequence[Float]) -> Float:
        """Features, shape (n_windows, n_features), of windows and their transform.

        ``coefficients`` are those of :func:`cyclofeat.signal.wavelets.dwt`, details of level 1 first, of at
        least ``_depth()`` levels; what follows these is ignored.
        """

    def _compute(self, X: NDArray[Any]) -> Float:
        return self._from_coefficients(X, dwt(X, self.wavelet, self._depth()))
