"""Statistics of each level of a wavelet transform."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from cyclofeat._base.sklearn_private import Interval
from cyclofeat.features._wavelet import WaveletTransformer
from cyclofeat.features.registry import REGISTRY
from cyclofeat.signal.wavelets import level_statistics
from cyclofeat.signal.windows import Float

_STATISTICS = ("rms", "energy_share", "kurtosis", "lowest_colour")


@dataclass(eq=False, repr=False)
class WaveletLevelStatistics(WaveletTransformer):
    """Energy, peakedness and quiet of each level of a wavelet transform (paper B figs. 10-12 in numbers).

    Each window gives for each level, from the highest frequencies (level 1) down,

    - rms of the torque that the level holds, in Nm,
    - its share in the energy of all levels,
    - kurtosis of its coefficients: the peaks of worn lobes raise it,
    - share of the lowest colour in its row of the scalogram: paper B's "lack of vibrations".

    Definitions in :func:`cyclofeat.signal.wavelets.level_statistics`.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz. Level k holds about ``sampling_rate / 2^(k+1)`` to ``sampling_rate / 2^k``.
    wavelet : str, pywt.Wavelet or sequence of four filters, default="mb32.3"
        Name of PyWavelets or of the Morris family, a wavelet, or a filter bank (dec_lo, dec_hi, rec_lo,
        rec_hi).
    levels : int, default=12
        Number of levels, 1 to 30. The share of energy is that in all of them.
    colours : int, default=64
        Number of colours of the scalogram.

    See Also
    --------
    cyclofeat.signal.wavelets.level_statistics : The same as a function.
    cyclofeat.signal.wavelets.scalogram : The picture behind it.

    Notes
    -----
    A constant window has rms, share and kurtosis 0 and is of the lowest colour throughout. In short windows,
    deep levels show how the window was continued beyond its ends.

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
    >>> features["wavelet_rms_nm(mb32.3;level03)"].round(2)
    array([0.02, 0.05])
    >>> features["wavelet_lowest_colour(mb32.3;64colours;level03)"].round(2)
    array([0.01, 0.31])
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **WaveletTransformer._parameter_constraints,
        "levels": [Interval(Integral, 1, 30, closed="both")],
        "colours": [Interval(Integral, 2, None, closed="left")],
    }

    levels: int = 12
    colours: int = 64

    def _columns(self) -> list[str]:
        columns = []
        for name in _STATISTICS:
            row = REGISTRY[f"wavelet_{name}"]
            # The share depends on which levels it is a share of.
            more = {"lowest_colour": (f"{self.colours}colours",), "energy_share": (f"of{self.levels}levels",)}
            definition = (self._bank(), *more.get(name, ()))
            columns += [row.column(*definition, f"level{level:02d}") for level in range(1, self.levels + 1)]
        return columns

    def _depth(self) -> int:
        return self.levels

    def _from_coefficients(self, X: NDArray[Any], coefficients: Sequence[Float]) -> Float:
        details = coefficients[: self.levels + 1]  # the last one is not used
        statistics = level_statistics(details, X.shape[1], self.colours)
        return np.hstack([statistics[name] for name in _STATISTICS])
