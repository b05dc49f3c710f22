"""All features in one row per window, what they share worked out once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import joblib
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base.sklearn_private import StrOptions
from cyclofeat.features import _spectra
from cyclofeat.features._coherence import CoherenceToReference
from cyclofeat.features._lobe_map import LobeMap
from cyclofeat.features._minima_overlap import WaveletMinimaOverlap
from cyclofeat.features._orders import OrderSpectrum
from cyclofeat.features._torque import TorqueStatistics
from cyclofeat.features._wavelets import (
    WAVELET,
    WaveletEnvelopeSpectrum,
    WaveletLevelStatistics,
    WaveletTransformer,
)
from cyclofeat.features.base import INPUT_SPEED_HZ, N_LOBES, SPEED_TOLERANCE, WindowTransformer, parameter
from cyclofeat.signal import lobes, welch_psd
from cyclofeat.signal.wavelets import AnyWavelet, dwt
from cyclofeat.signal.windows import Float

_PARTS: dict[str, type[WindowTransformer]] = {
    "TorqueStatistics": TorqueStatistics,
    "SpectralEntropy": _spectra.SpectralEntropy,
    "NormalizedEntropy": _spectra.SpectralEntropy,
    "SpectralFlatness": _spectra.SpectralFlatness,
    "SpectralCentroid": _spectra.SpectralCentroid,
    "SpectralRolloff": _spectra.SpectralRolloff,
    "NarrowbandRatio": _spectra.NarrowbandRatio,
    "BandPower": _spectra.BandPower,
    "CoherenceToReference": CoherenceToReference,
    "WaveletMinimaOverlap": WaveletMinimaOverlap,
    "WaveletEnvelopeSpectrum": WaveletEnvelopeSpectrum,
    "WaveletLevelStatistics": WaveletLevelStatistics,
    "LobeMap": LobeMap,
    "OrderSpectrum": OrderSpectrum,
}
_ALL = tuple(_PARTS)  # those that give numbers, not spectra
_PARTS.update(WelchPSD=_spectra.WelchPSD, AmplitudeSpectrum=_spectra.AmplitudeSpectrum)


@dataclass(eq=False, repr=False)
class TorqueFeatures(WindowTransformer):
    """All features of a window in one row, from one density, one wavelet transform and one input speed.

    The parts are the transformers of this package with their own defaults and the parameters below; their
    columns stand side by side, under their own names. What several parts need is computed once. Windows must
    be as long as the part that needs the longest takes; wavelets have no more levels than a window holds.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz, or per input turn for windows on equal steps of the angle.
    features : "all" or sequence of str, default="all"
        Names of the parts, in the order of the columns: those of the transformers and ``NormalizedEntropy``.
        ``"all"`` leaves out ``HighPass`` and, with thousands of columns, ``WelchPSD`` and
        ``AmplitudeSpectrum``.
    preset : {"ripple", "matlab_pwelch"}, default="ripple"
        Definition of the density of all parts, see :class:`SpectralEntropy`: they share one.
    wavelet
        See :class:`WaveletLevelStatistics`, for the parts that take one.
    input_speed_hz, n_lobes, speed_tolerance
        See :class:`LobeMap`.
    n_jobs : int, default=None
        Number of threads that work on chunks of windows, as in joblib: ``None`` is one, -1 all processors.
        ``joblib.parallel_config`` chooses processes or a cluster instead.

    Attributes
    ----------
    parts_ : dict of str to transformer
        The parts by name, fitted.

    Notes
    -----
    ``y`` matters to the parts with a reference, :class:`CoherenceToReference` (healthy) and
    :class:`WaveletMinimaOverlap` (worst). Windows are read chunk by chunk: memory maps of any length will do.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.features import TorqueFeatures
    >>> phase = 2 * np.pi * np.arange(46_080) / 25_600 * 500 / 60
    >>> torque = 22 + np.outer([1, 2], np.sin(16 * phase))
    >>> features = TorqueFeatures(sampling_rate=25_600, features=["SpectralEntropy", "SpectralCentroid"])
    >>> features.fit_transform(torque).round(2)
    array([[  1.93, 133.33],
           [  1.93, 133.33]])
    >>> len(features.set_params(features="all").fit(torque).get_feature_names_out())
    340
    """

    features: str | Sequence[str] = parameter("all", StrOptions({"all"}), list, tuple)
    preset: str = parameter("ripple", _spectra.PRESET)
    wavelet: AnyWavelet = parameter(*WAVELET)
    input_speed_hz: float = parameter(*INPUT_SPEED_HZ)
    n_lobes: int = parameter(*N_LOBES)
    speed_tolerance: float = parameter(*SPEED_TOLERANCE)
    n_jobs: int | None = parameter(None, Integral, None)

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        names = _ALL if isinstance(self.features, str) else tuple(self.features)
        if not names or not {*names} <= _PARTS.keys() or len({*names}) < len(names):
            known = ", ".join(_PARTS)
            raise ValueError(f"features must be 'all' or different names of {known}; got {self.features!r}")
        own: dict[str, dict[str, Any]] = {
            "NormalizedEntropy": {"normalize": True},
            "WaveletEnvelopeSpectrum": {"shaft_hz": self.input_speed_hz, "n_pins": self.n_lobes + 1},
        }
        parts = {}
        for name in names:
            kind = _PARTS[name]
            shared = {k: v for k, v in self.get_params().items() if k in kind._parameter_constraints}
            parts[name] = kind(**shared, **own.get(name, {}))
        for part in parts.values():
            # The windows are validated already, all parameters but those that must fit them, too.
            part.n_features_in_ = X.shape[1]
            if isinstance(part, WaveletLevelStatistics | WaveletMinimaOverlap):
                part.levels = min(part.levels, max(1, X.shape[1].bit_length() - 1))
            part._fit_windows(X, y)
        self.parts_ = parts

    def _warn_of_short_windows(self, X: NDArray[Any]) -> None:
        max(self.parts_.values(), key=lambda part: part.needed_samples())._warn_of_short_windows(X)

    def _feature_names(self) -> list[str]:
        return [column for part in self.parts_.values() for column in part._feature_names()]

    def _of_chunks(self, chunks: Iterable[NDArray[Any]]) -> list[Float]:
        if self.n_jobs in (None, 1):
            return super()._of_chunks(chunks)
        # Threads: most of the time goes into transforms and filters, which leave the interpreter to others,
        # and windows need not be copied to another process.
        parallel = joblib.Parallel(n_jobs=self.n_jobs, prefer="threads", pre_dispatch="2*n_jobs")
        return list(parallel(joblib.delayed(self._compute_features)(chunk) for chunk in chunks))

    def _compute_features(self, X: NDArray[Any]) -> Float:
        parts = self.parts_.values()
        density = None
        # The lobe lines of LobeMap serve other parts too; windows of less than two lobe periods have none.
        lobe_map = self.parts_.get("LobeMap")
        period = self.sampling_rate / lobes.lobe_frequency(self.input_speed_hz, self.n_lobes)
        lines = lobe_map.lines(X) if isinstance(lobe_map, LobeMap) and X.shape[1] >= 2 * period else None
        wavelets = [part for part in parts if isinstance(part, WaveletTransformer)]
        depth = max((part._deepest_level() for part in wavelets), default=0)
        coefficients = dwt(X, self.wavelet, depth) if depth else []
        results = []
        for part in parts:
            if isinstance(part, _spectra.SpectralTransformer):
                density = density or welch_psd(X, self.sampling_rate, self.preset)
                results.append(part._from_psd(*density))
            elif isinstance(part, WaveletMinimaOverlap):
                results.append(part._from_coefficients(X, coefficients, lines))
            elif isinstance(part, WaveletTransformer):
                results.append(part._from_coefficients(X, coefficients))
            elif lines is not None and isinstance(part, LobeMap):
                results.append(part.from_lines(lines))
            elif lines is not None and isinstance(part, OrderSpectrum):
                results.append(part._from_speed(X, lines.input_speed_hz))
            else:
                results.append(part._compute_features(X))
        return np.hstack(results)
