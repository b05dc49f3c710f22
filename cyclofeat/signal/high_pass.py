"""High-pass filtering of windows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from cyclofeat.signal.windows import Float, as_windows, check_sampling_rate, chunks

__all__ = ["high_pass"]


def high_pass(X: ArrayLike, sampling_rate: float, cutoff_hz: float = 10.0, order: int = 4) -> Float:
    r"""Windows without what varies slowly: a Butterworth high-pass without delay.

    The filter runs over each window forwards and backwards, so that no phase turns. Its gain is

    .. math:: G(f) = \frac{1}{1 + (f_c / f)^{2 n}}

    for frequencies far below half of the sampling rate: 1/2 at the cut-off :math:`f_c`, n being the order.

    Parameters
    ----------
    X : array-like, shape (..., n_samples)
        Windows of torque in Nm.
    sampling_rate : float
        Samples per second in Hz.
    cutoff_hz : float, default=10.0
        Cut-off in Hz, below half of the sampling rate.
    order : int, default=4
        Order n of the filter that runs twice. **Assumption**: paper A gives none.

    Returns
    -------
    ndarray, shape (..., n_samples)
        Filtered windows in Nm, float64.

    Raises
    ------
    ValueError
        If ``X`` is complex, empty or not finite, the sampling rate not positive, the cut-off not between 0
        and half of the sampling rate, or the order not positive.

    Notes
    -----
    Beyond its ends a window is continued by its own samples, turned about the last one, for one period of the
    cut-off or as far as it reaches. Within about one such period of the ends (2 s at 0.5 Hz, 0.1 s at 10 Hz)
    the result is less accurate: filter records before they are cut into windows where that matters. A
    constant window becomes zero exactly.

    References
    ----------
    Paper A section 2 tried cut-offs of 0.5, 1, 10 and 50 Hz and rejected them.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.signal import high_pass
    >>> time = np.arange(46_080) / 25_600
    >>> drift, mesh = 3 * np.sin(2 * np.pi * time), np.sin(2 * np.pi * 400 * time)
    >>> filtered = high_pass(22 + drift + mesh, 25_600, cutoff_hz=50)
    >>> bool(np.abs(filtered - mesh)[5000:-5000].max() < 1e-3)
    True
    """
    check_sampling_rate(sampling_rate)
    if not 0 < cutoff_hz < sampling_rate / 2:
        raise ValueError(
            f"cutoff_hz must lie between 0 and half of the sampling rate ({sampling_rate / 2:g} Hz), "
            f"got {cutoff_hz!r}"
        )
    if order < 1:
        raise ValueError(f"order must be at least 1, got {order!r}")
    X = as_windows(X)
    n_samples = X.shape[-1]
    sections = signal.butter(order, cutoff_hz, "highpass", fs=sampling_rate, output="sos")
    margin = min(n_samples - 1, math.ceil(sampling_rate / cutoff_hz))
    windows = X.reshape(-1, n_samples)
    filtered = np.empty(windows.shape)
    for chunk in chunks(len(windows), n_samples):
        # Counted from the first sample: a constant is then filtered without rounding.
        x = np.asarray(windows[chunk], dtype=np.float64) - windows[chunk, :1]
        filtered[chunk] = signal.sosfiltfilt(sections, x, axis=1, padlen=margin)
    return filtered.reshape(X.shape)
