"""All features in one row per window, what they share worked out once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Integral, Real
from types import MappingProxyType
from typing import Any, ClassVar

import joblib
import numpy as np
import pywt
from numpy.typing import ArrayLike, NDArray

from cyclofeat import lobes
from cyclofeat._sklearn import Interval, StrOptions
from cyclofeat._welch import (
    Complex,
    SegmentTransforms,
    get_preset,
    power_over_segments,
    welch_scale,
    welch_transforms,
)
from cyclofeat.features._base import WindowTransformer
from cyclofeat.features._coherence import CoherenceToReference
from cyclofeat.features._density import (
    BandPower,
    NarrowbandRatio,
    SpectralCentroid,
    SpectralFlatness,
    SpectralRolloff,
)
from cyclofeat.features._envelope import WaveletEnvelopeSpectrum
from cyclofeat.features._levels import WaveletLevelStatistics
from cyclofeat.features._lines import AmplitudeSpectrum, WelchPSD
from cyclofeat.features._lobe_map import LobeMap
from cyclofeat.features._minima_overlap import WaveletMinimaOverlap
from cyclofeat.features._orders import OrderSpectrum
from cyclofeat.features._spectral import SpectralEntropy, SpectralTransformer
from cyclofeat.features._statistics import TorqueStatistics
from cyclofeat.features._wavelet import WaveletTransformer
from cyclofeat.spectral import PRESETS, welch_frequencies
from cyclofeat.wavelets import AnyWavelet, dwt


def _spectral(kind: Callable[..., SpectralTransformer], **fixed: Any) -> Callable[..., WindowTransformer]:
    return lambda whole: kind(whole.sampling_rate, preset=whole.preset, **fixed)


# Name of a part -> the part with the composite's parameters. "all" are those that give numbers, not spectra.
_PARTS: Mapping[str, Callable[[TorqueFeatures], WindowTransformer]] = MappingProxyType(
    {
        "TorqueStatistics": lambda whole: TorqueStatistics(whole.sampling_rate),
        "SpectralEntropy": _spectral(SpectralEntropy),
        "NormalizedEntropy": _spectral(SpectralEntropy, normalize=True),
        "SpectralFlatness": _spectral(SpectralFlatness),
        "SpectralCentroid": _spectral(SpectralCentroid),
        "SpectralRolloff": _spectral(SpectralRolloff),
        "NarrowbandRatio": _spectral(NarrowbandRatio),
        "BandPower": _spectral(BandPower),
        "CoherenceToReference": lambda whole: CoherenceToReference(whole.sampling_rate),
        "WaveletMinimaOverlap": lambda whole: WaveletMinimaOverlap(
            whole.sampling_rate,
            wavelet=whole.wavelet,
            input_speed_hz=whole.input_speed_hz,
            n_lobes=whole.n_lobes,
            speed_tolerance=whole.speed_tolerance,
        ),
        "WaveletEnvelopeSpectrum": lambda whole: WaveletEnvelopeSpectrum(
            whole.sampling_rate,
            wavelet=whole.wavelet,
            shaft_hz=whole.input_speed_hz,
            n_pins=whole.n_lobes + 1,
            speed_tolerance=whole.speed_tolerance,
        ),
        "WaveletLevelStatistics": lambda whole: WaveletLevelStatistics(
            whole.sampling_rate, wavelet=whole.wavelet
        ),
        "LobeMap": lambda whole: LobeMap(
            whole.sampling_rate,
            input_speed_hz=whole.input_speed_hz,
            n_lobes=whole.n_lobes,
            speed_tolerance=whole.speed_tolerance,
        ),
        "OrderSpectrum": lambda whole: OrderSpectrum(
            whole.sampling_rate,
            input_speed_hz=whole.input_speed_hz,
            n_lobes=whole.n_lobes,
            speed_tolerance=whole.speed_tolerance,
        ),
        "WelchPSD": _spectral(WelchPSD),
        "AmplitudeSpectrum": lambda whole: AmplitudeSpectrum(whole.sampling_rate),
    }
)
_WHOLE_SPECTRA = ("WelchPSD", "AmplitudeSpectrum")
_ALL = tuple(name for name in _PARTS if name not in _WHOLE_SPECTRA)


class TorqueFeatures(WindowTransformer):
    """All features of a window in one row, from one density, one wavelet transform and one input speed.

    The parts are the transformers of this package with their own defaults and the parameters below; their
    columns stand side by side, under their own names. What several parts need is worked out once.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz. For windows on equal steps of the shaft's angle: samples per input turn.
    features : "all" or sequence of str, default="all"
        Names of the parts, in the order of the columns: ``TorqueStatistics``, ``SpectralEntropy`` (in bits),
        ``NormalizedEntropy``, ``SpectralFlatness``, ``SpectralCentroid``, ``SpectralRolloff``,
        ``NarrowbandRatio``, ``BandPower``, ``CoherenceToReference``, ``WaveletMinimaOverlap``,
        ``WaveletEnvelopeSpectrum``, ``WaveletLevelStatistics``, ``LobeMap``, ``OrderSpectrum`` - these are
        ``"all"`` - and, by name only, the whole spectra ``WelchPSD`` and ``AmplitudeSpectrum`` with thousands
        of columns.
    preset : {"matlab_pwelch", "ripple"}, default="matlab_pwelch"
        Definition of the density, see :data:`cyclofeat.spectral.PRESETS`.
    wavelet : str, pywt.Wavelet or sequence of four filters, default="mb32.3"
        Wavelet of the parts that take one.
    input_speed_hz : float, default=500/60
        Nominal input speed in turns per second. For windows on equal steps of the angle: 1.
    n_lobes : int, default=15
        Number of lobes z_s of a disc.
    speed_tolerance : float, default=0.015
        Largest relative deviation from the nominal speed that is searched; 0 takes the nominal speed.
    n_jobs : int, default=None
        Number of threads that work on chunks of windows, as in joblib: ``None`` is one, -1 all processors.
        ``joblib.parallel_config`` chooses processes or a cluster instead.

    Attributes
    ----------
    parts_ : dict of str to transformer
        The parts by name, fitted.
    n_features_in_ : int
        Samples in a window.
    feature_names_in_ : ndarray of str, shape (n_samples,)
        Names of the samples, if ``fit`` was given a data frame.

    Notes
    -----
    ``y`` matters to the parts with a reference: :class:`CoherenceToReference` (healthy) and
    :class:`WaveletMinimaOverlap` (worst); see there for what they do without labels. Memory beyond the
    windows' own is bounded: they are read chunk by chunk, so that a memory map of any length will do.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import TorqueFeatures
    >>> phase = 2 * np.pi * np.arange(46_080) / 25_600 * 500 / 60
    >>> torque = 22 + np.outer([1, 2], np.sin(16 * phase))
    >>> features = TorqueFeatures(sampling_rate=25_600, features=["SpectralEntropy", "SpectralCentroid"])
    >>> features.fit_transform(torque).round(2)
    array([[1.27, 1.1 ],
           [1.3 , 1.51]])
    >>> features.get_feature_names_out()
    array(['shannon_entropy_bits(matlab_pwelch)',
           'spectral_centroid_hz(matlab_pwelch)'], dtype=object)
    >>> len(features.set_params(features="all").fit(torque).get_feature_names_out())
    340

    In pictures, on surrogate torque: ``examples/features/plot_torque_features.py``.
    """

    preset: str
    wavelet: AnyWavelet
    input_speed_hz: float
    n_lobes: int
    speed_tolerance: float

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **WindowTransformer._parameter_constraints,
        "features": [StrOptions({"all"}), list, tuple],
        "preset": [StrOptions(set(PRESETS))],
        "wavelet": [str, pywt.Wavelet, "array-like"],
        "input_speed_hz": [Interval(Real, 0, None, closed="neither")],
        "n_lobes": [Interval(Integral, 3, None, closed="left")],
        "speed_tolerance": [Interval(Real, 0, 0.2, closed="left")],
        "n_jobs": [Integral, None],
    }

    def __init__(
        self,
        sampling_rate: float,
        features: str | Sequence[str] = "all",
        preset: str = "matlab_pwelch",
        wavelet: AnyWavelet = "mb32.3",
        input_speed_hz: float = 500 / 60,
        n_lobes: int = 15,
        speed_tolerance: float = 0.015,
        n_jobs: int | None = None,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.features = features
        self.preset = preset
        self.wavelet = wavelet
        self.input_speed_hz = input_speed_hz
        self.n_lobes = n_lobes
        self.speed_tolerance = speed_tolerance
        self.n_jobs = n_jobs

    def _names(self) -> tuple[str, ...]:
        if isinstance(self.features, str):
            return _ALL
        names = tuple(self.features)
        if not names:
            raise ValueError(f"features must be 'all' or names of parts, got {self.features!r}")
        for name in names:
            if name not in _PARTS:
                raise ValueError(f"features must be 'all' or hold names of {', '.join(_PARTS)}; got {name!r}")
            if names.count(name) > 1:
                raise ValueError(f"features must hold each name once, got {name!r} {names.count(name)} times")
        return names

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        parts = {name: _PARTS[name](self) for name in self._names()}
        for part in parts.values():
            # The windows are validated already, all parameters but those that must fit them, too.
            part.n_features_in_ = X.shape[1]
            part._learn(X, y)
        self.parts_ = parts

    def _columns(self) -> list[str]:
        return [column for part in self.parts_.values() for column in part._columns()]

    def _of_chunks(self, chunks: Iterable[NDArray[Any]]) -> list[NDArray[np.float64]]:
        if self.n_jobs in (None, 1):
            return super()._of_chunks(chunks)
        # Threads: most of the time goes into transforms and filters, which leave the interpreter to others,
        # and windows need not be copied to another process.
        parallel = joblib.Parallel(n_jobs=self.n_jobs, prefer="threads", pre_dispatch="2*n_jobs")
        return list(parallel(joblib.delayed(self._compute)(chunk) for chunk in chunks))

    def _compute(self, X: NDArray[Any]) -> NDArray[np.float64]:
        parts = self.parts_
        results: dict[str, NDArray[np.float64]] = {}
        self._from_spectra(X, results)
        found = self._lobe_lines(X)
        transformed = {name: part for name, part in parts.items() if isinstance(part, WaveletTransformer)}
        if transformed:
            depth = max(part._depth() for part in transformed.values())
            coefficients = dwt(X, self.wavelet, depth)
            for name, part in transformed.items():
                if isinstance(part, WaveletMinimaOverlap):
                    results[name] = part._from_coefficients(X, coefficients, found)
                else:
                    results[name] = part._from_coefficients(X, coefficients)
        for name, part in parts.items():
            if name in results:
                continue
            if found is not None and isinstance(part, LobeMap):
                results[name] = part._from_lines(found)
            elif found is not None and isinstance(part, OrderSpectrum):
                results[name] = part._from_speed(X, found.input_speed_hz)
            else:
                results[name] = part._compute(X)
        return np.hstack([results[name] for name in parts])

    def _lobe_lines(self, X: NDArray[Any]) -> lobes.LobeLines | None:
        """LobeMap's lobe lines, which place windows and tell their speed; None if every part finds its own.

        Other parts would find the very same lines: LobeMap's ``fit`` made sure that all of them lie below
        half of the sampling rate. Windows of less than two lobe periods have none.
        """
        part = self.parts_.get("LobeMap")
        period = self.sampling_rate / lobes.lobe_frequency(self.input_speed_hz, self.n_lobes)
        return part.lines(X) if isinstance(part, LobeMap) and X.shape[1] >= 2 * period else None

    def _from_spectra(self, X: NDArray[Any], results: dict[str, NDArray[np.float64]]) -> None:
        """Enter what comes from the power spectral density, and coherence where it shares its transforms."""
        spectral = {n: part for n, part in self.parts_.items() if isinstance(part, SpectralTransformer)}
        if not spectral:
            return
        transforms = welch_transforms(X.shape[1], get_preset(self.preset))
        coherent = self.parts_.get("CoherenceToReference") if self.preset == "matlab_pwelch" else None
        if isinstance(coherent, CoherenceToReference):
            references = coherent._of_references(transforms)
            rows = []

            def look(x: NDArray[Any], of_x: Complex, power: NDArray[np.float64]) -> None:
                rows.append(coherent._of_window(x, of_x[0], power[0], references))

            frequencies, psd = self._psd(X, transforms, look)
            results["CoherenceToReference"] = np.vstack(rows)
        else:
            frequencies, psd = self._psd(X, transforms)
        for name, part in spectral.items():
            results[name] = part._from_psd(frequencies, psd)

    def _psd(
        self,
        X: NDArray[Any],
        transforms: SegmentTransforms,
        look: Callable[[NDArray[Any], Complex, NDArray[np.float64]], None] | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Frequencies and density; ``look`` is shown each window, its transforms and their power."""
        scale = welch_scale(transforms, self.sampling_rate)
        psd = np.empty((len(X), scale.size))
        for row, x in enumerate(X):
            of_x = transforms(x[np.newaxis])
            power = power_over_segments(of_x)
            psd[row] = power[0] * scale
            if look is not None:
                look(x, of_x, power)
        return welch_frequencies(X.shape[1], self.sampling_rate), psd
