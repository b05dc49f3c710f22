"""Coherence with windows of a reference class."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import check_consistent_length, column_or_1d

from cyclofeat.features.base import WindowTransformer
from cyclofeat.features.registry import EIGHT_SEGMENTS, REGISTRY, band_qualifier
from cyclofeat.signal import octave_bands
from cyclofeat.signal.density import band_slice, checked_bands
from cyclofeat.signal.welch import (
    FEWEST_SAMPLES,
    PRESETS,
    SegmentTransforms,
    coherence_of_transforms,
    power_over_segments,
    welch_frequencies,
    welch_transforms,
    without_rounding,
)
from cyclofeat.signal.windows import Complex, Float

_MOST_REFERENCES = 8
_DEFAULT_BANDS = 5
# Equal windows may differ by the rounding of one of them to single precision.
_SAME = 1e-6


class References(NamedTuple):
    """References in the frequency domain: lines of the bands, one beyond the last, transforms, powers."""

    bands: list[slice]
    last: int
    transforms: Complex
    powers: Float


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

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **WindowTransformer._parameter_constraints,
        "reference": [str, Real],
        "bands": [tuple, list, None],
    }

    needs: ClassVar[str] = EIGHT_SEGMENTS

    reference: str | float = "healthy"
    bands: Sequence[tuple[float, float]] | None = None

    def needed_samples(self) -> int:
        return FEWEST_SAMPLES

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        self.frequencies_ = welch_frequencies(X.shape[1], self.sampling_rate)
        self._band_limits()  # raises where a band does not fit
        rows = np.arange(len(X))
        if isinstance(self.reference, str) and self.reference == "first":
            rows = rows[:_MOST_REFERENCES]
        elif y is not None:
            labels = column_or_1d(y)
            check_consistent_length(rows, labels)
            classes = np.unique(labels).tolist()
            wanted: Any = self.reference
            if wanted == "healthy" and wanted not in classes:
                wanted = classes[0]
            if wanted not in classes:
                raise ValueError(
                    f"reference must be 'healthy', 'first' or one of the labels in y, {classes}; "
                    f"got {wanted!r}"
                )
            rows = rows[[label == wanted for label in labels.tolist()]]
        elif self.reference != "healthy":
            raise ValueError(
                f"reference={self.reference!r} is a label, so y must hold the labels of the windows, got None"
            )
        spread = np.linspace(0, rows.size - 1, min(rows.size, _MOST_REFERENCES))
        self.references_ = np.array(X[rows[np.rint(spread).astype(int)]])

    def _band_limits(self) -> tuple[tuple[float, float], ...]:
        if self.bands is None:
            return octave_bands(self.sampling_rate)[:_DEFAULT_BANDS]
        return checked_bands(self.frequencies_, self.bands)

    def _feature_names(self) -> list[str]:
        reference = "".join(c if c.isalnum() or c in "._-+" else "_" for c in str(self.reference))
        return [
            REGISTRY["coherence"].column("mscohere", reference, band_qualifier(band))
            for band in self._band_limits()
        ]

    def _compute_features(self, X: NDArray[Any]) -> Float:
        transforms = welch_transforms(X.shape[1], PRESETS["matlab_pwelch"])
        references = self._of_references(transforms)
        rows = []
        for x in X:
            a = transforms(x[np.newaxis])
            rows.append(self._of_window(x, a[0], power_over_segments(a)[0], references))
        return np.stack(rows)

    def _of_references(self, transforms: SegmentTransforms) -> References:
        """Return what ``_of_window`` needs of the references, computed once for many windows."""
        bands = [band_slice(self.frequencies_, band) for band in self._band_limits()]
        # Lines above the highest band are left out.
        last = max(band.stop for band in bands)
        of_references = [transforms(reference[np.newaxis]) for reference in self.references_]
        powers = [without_rounding(power_over_segments(one))[0, :last] for one in of_references]
        return References(
            bands, last, np.stack([one[0, :, :last] for one in of_references]), np.stack(powers)
        )

    def _of_window(self, x: NDArray[Any], transforms: Complex, power: Float, references: References) -> Float:
        """Features, shape (n_bands,), of one window, its transforms and their power over segments."""
        limit = _SAME * max(float(x.max()), -float(x.min()))
        # Equal windows are left out; nearly all pairs differ at once.
        others = np.array([
            any(
                float(np.abs(np.subtract(a, b, dtype=np.float64)).max()) > limit
                for a, b in ((x[:64], reference[:64]), (x, reference))
            )
            for reference in self.references_
        ])  # fmt: skip
        if not others.any():
            return np.zeros(len(references.bands))
        kept = slice(None) if others.all() else others
        coherence = coherence_of_transforms(
            transforms[:, : references.last],
            without_rounding(power[np.newaxis])[0, : references.last],
            references.transforms[kept],
            references.powers[kept],
        )
        means = [coherence[:, band].mean(axis=1) for band in references.bands]
        return np.asarray(np.median(means, axis=1))
