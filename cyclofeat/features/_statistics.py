"""Statistics of the torque signal as features."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.features.base import WindowTransformer
from cyclofeat.features.registry import REGISTRY
from cyclofeat.signal import torque_statistics
from cyclofeat.signal.windows import Float

_STATISTICS = ("min", "max", "mean", "std", "range", "rms", "crest_factor", "skewness", "kurtosis", "ripple")


class TorqueStatistics(WindowTransformer):
    """Ten statistics of the torque in each window (paper A table 4, and five more).

    Minimum, maximum, mean, standard deviation, range and rms in Nm; crest factor, skewness, kurtosis and
    ripple (std over absolute mean) as pure numbers. Formulas in :func:`cyclofeat.signal.torque_statistics`.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz. The statistics do not depend on it; all transformers take it.

    Examples
    --------
    >>> from cyclofeat.features import TorqueStatistics
    >>> transformer = TorqueStatistics(sampling_rate=25_600)
    >>> features = transformer.fit_transform([[20.0, 22.0, 24.0], [22.0, 22.0, 22.0]])
    >>> for name, values in zip(transformer.get_feature_names_out()[:4], features.T):
    ...     print(name, values)
    torque_min_nm [20. 22.]
    torque_max_nm [24. 22.]
    torque_mean_nm [22. 22.]
    torque_std_nm [2. 0.]
    """

    def _columns(self) -> list[str]:
        return [REGISTRY[f"torque_{name}"].column() for name in _STATISTICS]

    def _compute(self, X: NDArray[Any]) -> Float:
        statistics = torque_statistics(X)
        return np.column_stack([statistics[name] for name in _STATISTICS])
