"""Statistics of the torque signal as features."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cyclofeat.features._base import WindowTransformer
from cyclofeat.features._registry import REGISTRY
from cyclofeat.spectral import torque_statistics

_STATISTICS = ("min", "max", "mean", "std", "range", "rms", "crest_factor", "skewness", "kurtosis", "ripple")


class TorqueStatistics(WindowTransformer):
    """Ten statistics of the torque in each window (paper A table 4, and five more).

    Minimum, maximum, mean, standard deviation, range and rms in Nm; crest factor, skewness, kurtosis and
    ripple (std over absolute mean) as pure numbers. Formulas in :func:`cyclofeat.spectral.torque_statistics`.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz. The statistics do not depend on it; it is required, as everywhere, so that
        all transformers are made and searched over alike.

    Attributes
    ----------
    n_features_in_ : int
        Samples in a window.
    feature_names_in_ : ndarray of str, shape (n_samples,)
        Names of the samples, if ``fit`` was given a data frame.

    See Also
    --------
    cyclofeat.spectral.torque_statistics : The same as a function.

    Notes
    -----
    A constant window has std, range, skewness, kurtosis and ripple 0, a window of zeros also crest factor 0.

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

    In pictures, on surrogate torque: ``examples/features/plot_torque_statistics.py``.
    """

    def __init__(self, sampling_rate: float) -> None:
        self.sampling_rate = sampling_rate

    def _columns(self) -> list[str]:
        return [REGISTRY[f"torque_{name}"].column() for name in _STATISTICS]

    def _compute(self, X: NDArray[Any]) -> NDArray[np.float64]:
        statistics = torque_statistics(X)
        return np.column_stack([statistics[name] for name in _STATISTICS])
