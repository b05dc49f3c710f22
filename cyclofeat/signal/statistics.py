"""Statistics of the torque in a window."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cyclofeat.signal.windows import Float, as_windows, chunks, ratio

__all__ = ["torque_statistics"]


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

    Raises
    ------
    ValueError
        If ``X`` is complex, empty or not finite.

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
        columns[:, chunk] = _statistics(np.asarray(windows[chunk], dtype=np.float64))
    names = ("min", "max", "mean", "std", "range", "rms", "crest_factor", "skewness", "kurtosis", "ripple")
    shape = X.shape[:-1]
    return {name: column.reshape(shape) for name, column in zip(names, columns, strict=True)}


def _statistics(x: Float) -> tuple[Float, ...]:
    """Statistics of ``x``, shape (n_windows, n_samples), in the order of :func:`torque_statistics`."""
    n_samples = x.shape[1]
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
    return low, high, mean, std, high - low, rms, crest_factor, skewness, kurtosis, ripple
