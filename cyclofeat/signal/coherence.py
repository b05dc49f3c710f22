"""Magnitude-squared coherence of windows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat.signal.welch import (
    PRESETS,
    power_over_segments,
    welch_frequencies,
    welch_transforms,
)
from cyclofeat.signal.windows import Complex, Float, as_windows, chunks, ratio

__all__ = [
    "coherence_of_transforms",
    "magnitude_squared_coherence",
    "without_rounding",
]

# Share of the largest line's power below which a line of a Fourier transform is rounding.
_ROUNDING = 1e-28


def without_rounding(power: Float) -> Float:
    """Powers of lines, shape (n_windows, n_bins), with 0 for those that hold nothing but rounding."""
    return np.where(power > _ROUNDING * power.max(axis=1, keepdims=True), power, 0.0)


def coherence_of_transforms(a: Complex, a_power: Float, b: Complex, b_power: Float) -> Float:
    """Coherence, shape (n_references, n_bins), of a window ``a`` with references ``b``.

    Transforms have the shape (..., n_segments, n_bins), powers (..., n_bins).
    """
    cross = np.einsum("sk,rsk->rk", a.conj(), b)
    coherence = ratio(cross.real**2 + cross.imag**2, a_power * b_power)
    return np.minimum(coherence, 1.0)  # by rounding, equal windows pass 1


def magnitude_squared_coherence(
    x: ArrayLike, reference: ArrayLike, sampling_rate: float
) -> tuple[Float, Float]:
    r"""Magnitude-squared coherence of windows and a reference, by the defaults of MATLAB's ``mscohere``.

    .. math:: C(f_i) = \frac{\left| \sum_m X_m^*(f_i) R_m(f_i) \right|^2}
              {\sum_m |X_m(f_i)|^2 \sum_m |R_m(f_i)|^2}

    with the Fourier transforms X and R of 8 segments of ``floor(n_samples / 4.5)`` samples with 50 % overlap,
    each multiplied by a symmetric Hamming window and zero-padded to ``max(256, 2**nextpow2(segment))``; the
    mean is kept.

    Parameters
    ----------
    x : array-like, shape (..., n_samples)
        Windows of torque in Nm.
    reference : array-like, shape (n_samples,) or that of ``x``
        One reference for all windows, or one for each. Unit and scale do not matter.
    sampling_rate : float
        Samples per second in Hz.

    Returns
    -------
    frequencies : ndarray, shape (n_bins,)
        Frequencies in Hz, from 0 to half of the sampling rate.
    coherence : ndarray, shape (..., n_bins)
        Coherence from 0 to 1, without unit.

    Raises
    ------
    ValueError
        If the shapes do not fit, ``x`` or ``reference`` is complex, empty or not finite, or the sampling rate
        not positive.

    Notes
    -----
    Lines whose power is less than 1e-28 of the largest line's (rounding) have coherence 0. Two independent
    windows of noise have a mean coherence of about 0.14, as 8 overlapping segments are few. Windows of fewer
    than 9 samples have segments of one sample, and their coherence does not depend on the frequency.

    References
    ----------
    Paper A section 5.2 and paper B section 5, which name ``mscohere`` with its defaults.

    Examples
    --------
    Two windows of noise share a line at 400 Hz:

    >>> import numpy as np
    >>> from cyclofeat.signal import magnitude_squared_coherence
    >>> line = np.sin(2 * np.pi * 400 * np.arange(46_080) / 25_600)
    >>> healthy, worn = line + np.random.default_rng(0).normal(size=(2, 46_080))
    >>> frequencies, coherence = magnitude_squared_coherence(worn, healthy, 25_600)
    >>> print(frequencies[coherence.argmax()])
    400.0
    """
    x, reference = as_windows(x), as_windows(reference)
    if reference.shape not in (x.shape, x.shape[-1:]):
        raise ValueError(
            f"reference must have the shape of x, {x.shape}, or of one of its windows, {x.shape[-1:]}; "
            f"got {reference.shape}"
        )
    n_samples = x.shape[-1]
    frequencies = welch_frequencies(n_samples, sampling_rate)
    transforms = welch_transforms(n_samples, PRESETS["matlab_pwelch"])
    windows: NDArray[Any] = x.reshape(-1, n_samples)
    references: NDArray[Any] = reference.reshape(-1, n_samples)
    coherence = np.empty((len(windows), frequencies.size))
    for chunk in chunks(len(windows), 2 * transforms.n_segments * frequencies.size):
        a = transforms(windows[chunk])
        b = transforms(references if len(references) == 1 else references[chunk])
        cross = np.einsum("wsk,wsk->wk", a.conj(), np.broadcast_to(b, a.shape))
        power = without_rounding(power_over_segments(a)) * without_rounding(power_over_segments(b))
        coherence[chunk] = np.minimum(ratio(cross.real**2 + cross.imag**2, power), 1.0)
    return frequencies, coherence.reshape(*x.shape[:-1], frequencies.size)
