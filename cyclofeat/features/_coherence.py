"""Coherence with windows of a reference class."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat.features.base import WindowTransformer, parameter, reference_windows
from cyclofeat.features.registry import REGISTRY, band_qualifier, label_qualifier
from cyclofeat.signal import octave_bands
from cyclofeat.signal.density import band_slice, checked_bands
from cyclofeat.signal.welch import (
    EIGHT_SEGMENTS,
    coherence_of_transforms,
    power_over_segments,
    welch_frequencies,
    welch_transforms,
    without_rounding,
)
from cyclofeat.signal.windows import Complex, Float

_DEFAULT_BANDS = 5
# Equal windows may differ by the rounding of one of them to single precision.
_SAME = 1e-6


@dataclass(eq=False, repr=False)
class CoherenceToReference(WindowTransformer):
    """Mean coherence, band by band, with training windows of a reference class (paper A 5.2, paper B 5).

    Each window's :func:`cyclofeat.signal.magnitude_squared_coherence` with each of up to 8 references is
    averaged over the lines of each band; the feature is the median over the references.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    reference : str or number, default="healthy"
        Label of the training windows that are the reference. ``"healthy"`` stands for the smallest label (in
        sorted order: 0 worn lobes) where no window has it, and for all windows where there are no labels;
        ``"first"`` takes the first 8 windows whatever their labels. Of more than 8 windows, 8 evenly spread
        over the training set are kept.
    bands : sequence of tuple of float, default=None
        Lower and upper limits in Hz, both included. ``None`` takes the lowest five of
        :func:`cyclofeat.signal.octave_bands`, 0 to 1600 Hz at 25.6 kHz: the papers looked at 0 to 1500 Hz.

    Attributes
    ----------
    references_ : ndarray, shape (n_references, n_samples)
        Windows of the reference class.
    frequencies_ : ndarray, shape (n_bins,)
        Frequencies of the coherence in Hz.

    Notes
    -----
    A reference that equals the window to 1e-6 of its largest sample is left out: with itself a window has
    coherence 1, which would give the label away in training. A window without any other reference, and one
    without power, has coherence 0. Where windows of one recording are both references and evaluated, what
    repeats in that recording alone raises their coherence: split by assembly. Windows must hold 288 samples.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import CoherenceToReference
    >>> rng = np.random.default_rng(0)
    >>> mesh = np.sin(2 * np.pi * 133 * np.arange(46_080) / 25_600)
    >>> X = np.vstack([mesh + 0.1 * rng.normal(size=(2, 46_080)), rng.normal(size=(1, 46_080))])
    >>> transformer = CoherenceToReference(sampling_rate=25_600, bands=[(130, 136)])
    >>> coherence = transformer.fit(X, ["healthy", "healthy", "worn"]).transform(X)
    >>> bool(coherence[:2].min() > 0.9 > coherence[2])
    True
    """

    reference: str | float = parameter("healthy", str, Real)
    bands: Sequence[tuple[float, float]] | None = parameter(None, tuple, list, None)

    def _shortest_window(self) -> tuple[int, str]:
        return EIGHT_SEGMENTS

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        self.frequencies_ = welch_frequencies(X.shape[1], self.sampling_rate)
        self._band_limits()  # raises where a band does not fit
        if self.reference == "first":
            X, y = X[:8], None
        name = "first" if self.reference == "first" else "healthy"
        self.references_, _ = reference_windows(X, y, self.reference, (name, 0))

    def _band_limits(self) -> tuple[tuple[float, float], ...]:
        if self.bands is None:
            return octave_bands(self.sampling_rate)[:_DEFAULT_BANDS]
        return checked_bands(self.frequencies_, self.bands)

    def _feature_names(self) -> list[str]:
        reference = label_qualifier(self.reference)
        return [
            REGISTRY["coherence"].column("mscohere", reference, band_qualifier(band))
            for band in self._band_limits()
        ]

    def _compute_features(self, X: NDArray[Any]) -> Float:
        transforms_of = welch_transforms(X.shape[1], "matlab_pwelch")
        bands = [band_slice(self.frequencies_, band) for band in self._band_limits()]
        last = max(band.stop for band in bands)

        def transform(x: NDArray[Any]) -> tuple[Complex, Float]:
            """Return transforms of a window's segments and their power, without lines above all bands."""
            of_x = transforms_of(x[np.newaxis])
            return of_x[0, :, :last], without_rounding(power_over_segments(of_x))[0, :last]

        transforms, powers = map(np.stack, zip(*map(transform, self.references_), strict=True))
        features = np.zeros((len(X), len(bands)))
        for row, x in zip(features, X, strict=True):
            others = self._other_references(x)
            if others.any():
                kept = slice(None) if others.all() else others
                coherence = coherence_of_transforms(*transform(x), transforms[kept], powers[kept])
                row[:] = np.median([coherence[:, band].mean(axis=1) for band in bands], axis=1)
        return features

    def _other_references(self, x: NDArray[Any]) -> NDArray[np.bool_]:
        """Mark the references that differ from a window; nearly all do so in their first samples."""
        limit = _SAME * max(float(x.max()), -float(x.min()))
        return np.array([
            any(
                float(np.abs(np.subtract(a, b, dtype=np.float64)).max()) > limit
                for a, b in ((x[:64], reference[:64]), (x, reference))
            )
            for reference in self.references_
        ])  # fmt: skip
