"""Windows of torque: checks that all functions share, statistics, and a high-pass filter."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from cyclofeat._base.checks import positive, whole

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]
Complex = NDArray[np.complex128]

#: Keys of :func:`torque_statistics`.
STATISTICS = ("min", "max", "mean", "std", "range", "rms", "crest_factor", "skewness", "kurtosis", "ripple")
LARGEST = 1e100  # Nm; the fourth power of a deviation or the square in a spectrum would overflow far beyond
_CHUNK = 2**17  # numbers that are worked on at one time: 1 to 2 MiB stay in the processor's cache


def as_windows(X: ArrayLike) -> NDArray[Any]:
    """Return real, finite windows along the last axis, in their own precision."""
    X = np.asarray(X)
    if np.iscomplexobj(X):
        raise ValueError(f"X must be real, got {X.dtype}")
    if X.dtype not in (np.float32, np.float64):
        X = X.astype(np.float64)
    if X.ndim == 0 or X.shape[-1] == 0:
        raise ValueError(
            f"X must hold windows of at least one sample along its last axis, got shape {X.shape}"
        )
    if X.size:
        low, high = float(X.min()), float(X.max())
        if not (low >= -LARGEST and high <= LARGEST):  # true for NaN, too
            raise ValueError(
                f"X must be finite and within +-{LARGEST:g} Nm, got values from {low:g} to {high:g}"
            )
    return X


def chunks(n_windows: int, numbers_per_window: int) -> Iterator[slice]:
    """Slices of windows that need about ``_CHUNK`` numbers each."""
    step = max(1, _CHUNK // numbers_per_window)
    for start in range(0, n_windows, step):
        yield slice(start, min(start + step, n_windows))


def ratio(numerator: Float, denominator: Float) -> Float:
    """Divide by numbers that are not negative; zero where they are zero."""
    quotient = np.zeros_like(numerator)
    np.divide(numerator, denominator, out=quotient, where=denominator > 0)
    return quotient


def torque_statistics(X: ArrayLike) -> dict[str, Float]:
    r"""Statistics of the torque in a window: those of paper A table 4 and five more.

    ================  ==========  ==============================================================
    key               unit        definition
    ================  ==========  ==============================================================
    ``min``           Nm          smallest sample
    ``max``           Nm          largest sample
    ``mean``          Nm          :math:`\bar x = \sum x / n`
    ``std``           Nm          :math:`\sqrt{\sum (x - \bar x)^2 / (n - 1)}`, MATLAB's ``std``
    ``range``         Nm          max - min
    ``rms``           Nm          :math:`\sqrt{\sum x^2 / n}`
    ``crest_factor``  1           max abs(x) / rms
    ``skewness``      1           :math:`m_3 / m_2^{3/2}` with :math:`m_k = \sum (x - \bar x)^k / n`
    ``kurtosis``      1           :math:`m_4 / m_2^2` (3 for a normal distribution)
    ``ripple``        1           std / abs(mean)
    ================  ==========  ==============================================================

    Parameters
    ----------
    X : array-like, shape (..., n_samples)
        Windows of torque in Nm.

    Returns
    -------
    dict of str to ndarray, shape (...)
        The statistics in the order of the table, float64.

    Notes
    -----
    Every ratio with a denominator of zero is 0 (for the mean: up to 2^-52 of the rms). The std of a single
    sample is 0, as in MATLAB.

    Examples
    --------
    >>> from cyclofeat.signal import torque_statistics
    >>> statistics = torque_statistics([[20.0, 22.0, 24.0]])
    >>> print(statistics["mean"], statistics["std"], statistics["range"])
    [22.] [2.] [4.]
    """
    X = as_windows(X)
    n_samples = X.shape[-1]
    windows = X.reshape(-1, n_samples)
    columns = np.empty((10, len(windows)))
    for chunk in chunks(len(windows), n_samples):
        x = np.asarray(windows[chunk], dtype=np.float64)
        low, high = x.min(axis=1), x.max(axis=1)
        # Counted from the first sample, a constant deviates by exactly nothing.
        deviation = x - x[:, :1]
        shift = deviation.mean(axis=1)
        deviation -= shift[:, np.newaxis]
        mean = x[:, 0] + shift
        squares = np.einsum("ij,ij->i", deviation, deviation)
        std = np.sqrt(squares / max(n_samples - 1, 1))
        rms = np.sqrt(np.einsum("ij,ij->i", x, x) / n_samples)
        # Standardised first: powers of tiny or huge deviations would leave the range of floats.
        z = ratio(deviation, np.sqrt(squares / n_samples)[:, np.newaxis])
        z_squared = z * z
        skewness = np.einsum("ij,ij->i", z_squared, z) / n_samples
        kurtosis = np.einsum("ij,ij->i", z_squared, z_squared) / n_samples
        crest_factor = ratio(np.maximum(high, -low), rms)
        size_of_mean = np.abs(mean)
        ripple = ratio(std, np.where(size_of_mean > np.finfo(np.float64).eps * rms, size_of_mean, 0.0))
        columns[:, chunk] = low, high, mean, std, high - low, rms, crest_factor, skewness, kurtosis, ripple
    shape = X.shape[:-1]
    return {name: column.reshape(shape) for name, column in zip(STATISTICS, columns, strict=True)}


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
    positive("sampling_rate", sampling_rate)
    if not 0 < cutoff_hz < sampling_rate / 2:
        raise ValueError(
            f"cutoff_hz must lie between 0 and half of the sampling rate ({sampling_rate / 2:g} Hz), "
            f"got {cutoff_hz!r}"
        )
    whole("order", order, 1)
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
