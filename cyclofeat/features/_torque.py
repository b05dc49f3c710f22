"""Torque in time: its statistics, and windows without what varies slowly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import OneToOneFeatureMixin

from cyclofeat._base.sklearn_private import check_feature_names_in
from cyclofeat.features.base import POSITIVE, WindowTransformer, at_least, parameter
from cyclofeat.features.registry import REGISTRY
from cyclofeat.signal import high_pass, torque_statistics
from cyclofeat.signal.windows import STATISTICS, Float


class TorqueStatistics(WindowTransformer):
    """Ten statistics of the torque in each window, those of :func:`cyclofeat.signal.torque_statistics`.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz. The statistics do not depend on it; all transformers take it.

    Examples
    --------
    >>> from cyclofeat.features import TorqueStatistics
    >>> transformer = TorqueStatistics(sampling_rate=25_600)
    >>> transformer.fit_transform([[20.0, 22.0, 24.0], [22.0, 22.0, 22.0]])[:, :4]
    array([[20., 24., 22.,  2.],
           [22., 22., 22.,  0.]])
    """

    def _feature_names(self) -> list[str]:
        return [REGISTRY[f"torque_{name}"].column() for name in STATISTICS]

    def _compute_features(self, X: NDArray[Any]) -> Float:
        return np.column_stack([*torque_statistics(X).values()])


@dataclass(eq=False, repr=False)
class HighPass(OneToOneFeatureMixin, WindowTransformer):
    """High-pass filter: each window becomes a window of the same length, in Nm (paper A section 2).

    That of :func:`cyclofeat.signal.high_pass`. It goes before any other transformer of windows in a pipeline.
    Its columns are the samples, under the names they came with. Windows must hold half a period of the
    cut-off.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    cutoff_hz, order
        See :func:`cyclofeat.signal.high_pass`.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.pipeline import make_pipeline
    >>> from cyclofeat.features import HighPass, TorqueStatistics
    >>> phase = 2 * np.pi * np.arange(46_080) / 25_600
    >>> torque = 22 + 3 * np.sin(phase) + np.sin(400 * phase)
    >>> pipeline = make_pipeline(HighPass(25_600, cutoff_hz=50), TorqueStatistics(25_600))
    >>> print(pipeline.fit_transform(torque[np.newaxis])[0, 3].round(3))  # std of the sine of 400 Hz alone
    0.707
    """

    cutoff_hz: float = parameter(10.0, POSITIVE)
    order: int = parameter(4, at_least(1))

    def _shortest_window(self) -> tuple[int, str]:
        return int(self.sampling_rate / self.cutoff_hz / 2), "half a period of the cut-off"

    def _fit_windows(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        high_pass(X[:1, :1], self.sampling_rate, self.cutoff_hz, self.order)  # raises where they do not fit

    def _feature_names(self) -> list[str]:
        return [str(name) for name in check_feature_names_in(self, None)]

    def _compute_features(self, X: NDArray[Any]) -> Float:
        return high_pass(X, self.sampling_rate, self.cutoff_hz, self.order)
