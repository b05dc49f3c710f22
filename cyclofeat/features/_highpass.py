"""Windows without what varies slowly."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import check_is_fitted

from cyclofeat._sklearn import Interval, check_feature_names_in
from cyclofeat.features._base import WindowTransformer
from cyclofeat.spectral import high_pass


class HighPass(WindowTransformer):
    """High-pass filter: each window becomes a window of the same length, in Nm (paper A section 2).

    A Butterworth filter runs forwards and backwards over each window, so that nothing is delayed. It goes
    before any other transformer of windows in a pipeline. Its columns are the samples, under the names they
    came with.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.
    cutoff_hz : float, default=10.0
        Cut-off in Hz, where half of the amplitude is left. Paper A tried 0.5, 1, 10 and 50 Hz.
    order : int, default=4
        Order of the filter that runs twice. **Assumption**: paper A gives none.

    Attributes
    ----------
    n_features_in_ : int
        Samples in a window.
    feature_names_in_ : ndarray of str, shape (n_samples,)
        Names of the samples, if ``fit`` was given a data frame.

    See Also
    --------
    cyclofeat.spectral.high_pass : The same as a function, with its gain.

    Notes
    -----
    A window is continued beyond its ends by its own samples, turned about the last one. Within about one
    period of the cut-off of either end the result is less accurate: all of a 1.8 s window at 0.5 Hz. The
    filter is linear; a constant changes nothing but rounding; a constant window and one of a single sample
    become zero.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.pipeline import make_pipeline
    >>> from cyclofeat.features import HighPass, TorqueStatistics
    >>> phase = 2 * np.pi * np.arange(46_080) / 25_600
    >>> torque = 22 + 3 * np.sin(phase) + np.sin(400 * phase)
    >>> pipeline = make_pipeline(HighPass(25_600, cutoff_hz=50), TorqueStatistics(25_600))
    >>> std = pipeline.fit_transform(torque[np.newaxis])[0, 3]
    >>> print(std.round(3))  # of the sine of 400 Hz alone
    0.707

    In pictures, on surrogate torque: ``examples/features/plot_high_pass.py``.
    """

    _parameter_constraints: ClassVar[dict[str, list[Any]]] = {
        **WindowTransformer._parameter_constraints,
        "cutoff_hz": [Interval(Real, 0, None, closed="neither")],
        "order": [Interval(Integral, 1, None, closed="left")],
    }

    def __init__(self, sampling_rate: float, cutoff_hz: float = 10.0, order: int = 4) -> None:
        self.sampling_rate = sampling_rate
        self.cutoff_hz = cutoff_hz
        self.order = order

    def _learn(self, X: NDArray[Any], y: ArrayLike | None) -> None:
        high_pass(X[:1, :1], self.sampling_rate, self.cutoff_hz, self.order)  # raises where they do not fit

    def _columns(self) -> list[str]:
        return [str(name) for name in check_feature_names_in(self, None)]

    def _compute(self, X: NDArray[Any]) -> NDArray[np.float64]:
        return high_pass(X, self.sampling_rate, self.cutoff_hz, self.order)

    def get_feature_names_out(self, input_features: ArrayLike | None = None) -> NDArray[np.object_]:
        """Names of the samples: those given, those seen in ``fit``, or ``x0``, ``x1``, ...

        Parameters
        ----------
        input_features : array-like of str, shape (n_samples,), optional
            Names of the samples of a window.

        Returns
        -------
        ndarray of str, shape (n_samples,)

        Raises
        ------
        NotFittedError
            If ``fit`` was not called.
        ValueError
            If ``input_features`` differ from what ``fit`` saw.
        """
        check_is_fitted(self)
        return np.asarray(check_feature_names_in(self, input_features), dtype=object)
