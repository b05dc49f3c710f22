"""Pure functions of windows of torque: power spectral density, spectral entropy, statistics.

A window is the last axis of an array: ``X`` of shape (n_windows, n_samples) gives one result per window, a
single window of shape (n_samples,) gives one result. float32 and float64 are taken; all sums are float64.

One signal can have 0.9 or 4.2 bits of spectral entropy, depending on whether its mean was removed and on the
window. The choice is therefore a named preset (:data:`PRESETS`) and never implicit.

Papers A and B, quoted here with their numbers of equations and tables:

A. "Verification of the cycloidal gear train fault diagnosis methods based on measured data"
B. "Analysis of the single stage cycloidal gearbox with lobe defects. Fault diagnosis attempts using coherence
   function and Morris minimum-bandwidth wavelets"
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal
from scipy.special import entr

__all__ = [
    "EPSILON",
    "PRESETS",
    "WelchPreset",
    "band_mask",
    "get_preset",
    "normalized_entropy",
    "segment_length",
    "shannon_entropy",
    "torque_statistics",
    "welch_frequencies",
    "welch_psd",
]

Float = NDArray[np.float64]

EPSILON = float(np.finfo(np.float64).eps)
"""Assumed epsilon of paper A eq. 5: MATLAB's ``eps``, 2^-52. The paper gives no value."""

_LARGEST = 1e100  # Nm; the fourth power of a deviation or the square in a spectrum would overflow far beyond
_CHUNK = 2**21  # complex numbers (32 MiB) of the Fourier transforms that are held at one time


@dataclass(frozen=True)
class WelchPreset:
    """One complete definition of Welch's power spectral density.

    All presets share MATLAB's segmentation: segments of ``floor(n_samples / 4.5)`` samples with 50 % overlap
    (8 of them), zero-padded to ``max(256, 2**nextpow2(segment))``, one-sided, as a density.

    Parameters
    ----------
    name : str
        Name of the preset, printed in feature names and reports.
    window : str
        Window of :mod:`scipy.signal.windows`.
    symmetric : bool
        Whether the window is symmetric, or periodic (its first sample left to follow its last).
    remove_mean : bool
        Whether the mean of each segment is removed.
    """

    name: str
    window: str
    symmetric: bool
    remove_mean: bool

    def taper(self, n_samples: int) -> Float:
        """Window of ``n_samples`` samples, shape (n_samples,), without unit."""
        return np.asarray(signal.get_window(self.window, n_samples, fftbins=not self.symmetric))


PRESETS: Mapping[str, WelchPreset] = MappingProxyType(
    {
        preset.name: preset
        for preset in (
            WelchPreset("matlab_pwelch", window="hamming", symmetric=True, remove_mean=False),
            # Periodic: the Hann window for spectra. It also never vanishes, as the symmetric one of two
            # samples does.
            WelchPreset("ripple", window="hann", symmetric=False, remove_mean=True),
        )
    }
)
"""The presets by name.

``"matlab_pwelch"``
    MATLAB's ``pwelch(x, [], [], [], fs)``, which paper A used: symmetric Hamming window, mean kept. The mean
    torque's line at 0 Hz dominates it.
``"ripple"``
    The torque ripple alone: mean of each segment removed, periodic Hann window.
"""


def get_preset(name: str) -> WelchPreset:
    """Preset by its name.

    Parameters
    ----------
    name : str
        One of the names in :data:`PRESETS`.

    Returns
    -------
    WelchPreset

    Raises
    ------
    ValueError
        If there is no preset of that name.

    Examples
    --------
    >>> from cyclofeat.spectral import get_preset
    >>> get_preset("matlab_pwelch").remove_mean
    False
    """
    if name not in PRESETS:
        raise ValueError(f"preset must be one of {', '.join(PRESETS)}; got {name!r}")
    return PRESETS[name]


def segment_length(n_samples: int) -> int:
    """Samples in a segment: ``floor(n_samples / 4.5)``, which makes 8 segments with 50 % overlap.

    Windows of fewer than 9 samples get segments of one sample.

    Examples
    --------
    >>> from cyclofeat.spectral import segment_length
    >>> segment_length(46_080)
    10240
    """
    return max(1, 2 * n_samples // 9)


def _n_fft(n_samples: int) -> int:
    return max(256, 1 << (segment_length(n_samples) - 1).bit_length())


def _check_sampling_rate(sampling_rate: float) -> None:
    if not 0 < sampling_rate < np.inf:
        raise ValueError(f"sampling_rate must be positive and finite, in Hz; got {sampling_rate!r}")


def welch_frequencies(n_samples: int, sampling_rate: float) -> Float:
    """Frequencies of the lines of :func:`welch_psd`.

    Parameters
    ----------
    n_samples : int
        Samples in a window.
    sampling_rate : float
        Samples per second in Hz.

    Returns
    -------
    ndarray, shape (n_bins,)
        Frequencies in Hz, from 0 to half of the sampling rate.

    Raises
    ------
    ValueError
        If the sampling rate is not positive and finite.

    Examples
    --------
    >>> from cyclofeat.spectral import welch_frequencies
    >>> frequencies = welch_frequencies(46_080, 25_600)
    >>> print(frequencies.size, frequencies[1], frequencies[-1])
    8193 1.5625 12800.0
    """
    _check_sampling_rate(sampling_rate)
    n_fft = _n_fft(n_samples)
    return np.arange(n_fft // 2 + 1) * float(sampling_rate) / n_fft


def _as_windows(X: ArrayLike) -> NDArray[Any]:
    """Real, finite windows along the last axis, in their own precision."""
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
        if not (low >= -_LARGEST and high <= _LARGEST):  # true for NaN, too
            raise ValueError(
                f"X must be finite and within +-{_LARGEST:g} Nm, got values from {low:g} to {high:g}"
            )
    return X


def _chunks(n_windows: int, numbers_per_window: int) -> Iterator[slice]:
    """Slices of windows that need about ``_CHUNK`` numbers each."""
    step = max(1, _CHUNK // numbers_per_window)
    for start in range(0, n_windows, step):
        yield slice(start, start + step)


def welch_psd(X: ArrayLike, sampling_rate: float, preset: str = "matlab_pwelch") -> tuple[Float, Float]:
    r"""One-sided power spectral density by Welch's method, as a named preset defines it.

    .. math:: P(f_i) = \frac{c_i}{f_s \sum_k w_k^2} \frac{1}{M} \sum_{m=1}^{M}
              \left| \sum_k w_k x_{m,k} e^{-2 \pi j i k / N} \right|^2

    with the M segments :math:`x_m`, the window w, N = ``max(256, 2**nextpow2(segment))`` and :math:`c_i` = 1
    at 0 Hz and at half of the sampling rate, 2 between them.

    Parameters
    ----------
    X : array-like, shape (..., n_samples)
        Windows of torque in Nm.
    sampling_rate : float
        Samples per second in Hz.
    preset : str, default="matlab_pwelch"
        Definition of the spectrum, a name in :data:`PRESETS`.

    Returns
    -------
    frequencies : ndarray, shape (n_bins,)
        Frequencies in Hz, from 0 to half of the sampling rate.
    psd : ndarray, shape (..., n_bins)
        Power spectral density in Nm^2/Hz, float64.

    Raises
    ------
    ValueError
        If ``X`` is complex, empty or not finite, the sampling rate not positive or the preset unknown.

    Notes
    -----
    A constant window has the transform of the Hamming window under ``"matlab_pwelch"`` and is exactly zero
    under ``"ripple"``. A window of fewer than 9 samples has segments of one sample: its spectrum is flat
    under ``"matlab_pwelch"`` and zero under ``"ripple"``. The segments do not reach the last
    ``(n_samples - segment) % (segment - segment // 2)`` samples of a window.

    References
    ----------
    Paper A section 5.3 names MATLAB's ``pwelch`` and gives no arguments, hence its defaults here.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.spectral import welch_psd
    >>> time = np.arange(46_080) / 25_600
    >>> torque = 22 + np.sin(2 * np.pi * 400 * time)
    >>> frequencies, psd = welch_psd(torque[np.newaxis], 25_600, "ripple")
    >>> psd.shape
    (1, 8193)
    >>> print(frequencies[psd[0].argmax()])
    400.0
    >>> print(round(psd.sum() * frequencies[1], 6))  # the sine's mean square
    0.5
    """
    definition = get_preset(preset)
    X = _as_windows(X)
    n_samples = X.shape[-1]
    frequencies = welch_frequencies(n_samples, sampling_rate)
    segment = segment_length(n_samples)
    n_segments = (n_samples - segment // 2) // (segment - segment // 2)
    taper = definition.taper(segment)
    windows = X.reshape(-1, n_samples)
    psd = np.empty((len(windows), frequencies.size))
    for chunk in _chunks(len(windows), n_segments * frequencies.size):
        # Single precision would stay single precision in scipy.
        x = np.asarray(windows[chunk], dtype=np.float64)
        if definition.remove_mean:
            # A constant less its mean leaves rounding; less its own first sample it leaves nothing.
            x = x - x[:, :1]
        _, psd[chunk] = signal.welch(
            x,
            fs=float(sampling_rate),
            window=taper,
            nperseg=segment,
            noverlap=segment // 2,
            nfft=_n_fft(n_samples),
            detrend="constant" if definition.remove_mean else False,
        )
    return frequencies, psd.reshape(*X.shape[:-1], frequencies.size)


def band_mask(frequencies: ArrayLike, band: tuple[float, float]) -> NDArray[np.bool_]:
    """Which spectral lines lie in a band, its limits included.

    Parameters
    ----------
    frequencies : array-like, shape (n_bins,)
        Frequencies in Hz, increasing to half of the sampling rate.
    band : tuple of float
        Lower and upper limit in Hz.

    Returns
    -------
    ndarray of bool, shape (n_bins,)

    Raises
    ------
    ValueError
        If not ``0 <= low < high``, or if the band reaches beyond the last frequency or holds no line.

    Examples
    --------
    >>> from cyclofeat.spectral import band_mask
    >>> band_mask([0.0, 50.0, 100.0, 150.0], (40.0, 100.0))
    array([False,  True,  True, False])
    """
    frequencies = np.asarray(frequencies, dtype=np.float64)
    try:
        low, high = (float(limit) for limit in band)
    except (TypeError, ValueError):
        raise ValueError(f"band must be two frequencies (low, high) in Hz, got {band!r}") from None
    if not 0 <= low < high:
        raise ValueError(f"band must be (low, high) in Hz with 0 <= low < high, got {band!r}")
    if high > frequencies[-1]:
        raise ValueError(
            f"band {band!r} Hz reaches beyond the highest frequency, {frequencies[-1]:g} Hz "
            "(half of the sampling rate)"
        )
    mask: NDArray[np.bool_] = (frequencies >= low) & (frequencies <= high)
    if not mask.any():
        raise ValueError(
            f"band {band!r} Hz holds none of the {frequencies.size} spectral lines, which are "
            f"{np.diff(frequencies[:2]).sum():g} Hz apart"
        )
    return mask


def _power_share(psd: ArrayLike, frequencies: ArrayLike | None, band: tuple[float, float] | None) -> Float:
    """PSD over its sum in the band (paper A eq. 4); zero everywhere if there is no power."""
    psd = np.asarray(psd, dtype=np.float64)
    if band is not None:
        if frequencies is None:
            raise ValueError(f"frequencies are needed to find the band {band!r} Hz, got None")
        psd = psd[..., band_mask(frequencies, band)]
    total = psd.sum(axis=-1, keepdims=True)
    if not (np.isfinite(total).all() and (psd >= 0).all()):
        raise ValueError("psd must be finite and not negative")
    return _ratio(psd, total)


def shannon_entropy(
    psd: ArrayLike, frequencies: ArrayLike | None = None, band: tuple[float, float] | None = None
) -> Float:
    r"""Shannon entropy of a power spectral density in bits (paper A eq. 8).

    .. math:: H = -\sum_i p_i \log_2 p_i, \qquad p_i = P(f_i) / \sum_k P(f_k)

    where :math:`0 \log_2 0 = 0` and both sums run over the band. It does not depend on the unit or scale of
    the torque; it grows with ``log2`` of the zero-padding.

    Parameters
    ----------
    psd : array-like, shape (..., n_bins)
        Power spectral density, as from :func:`welch_psd`.
    frequencies : array-like, shape (n_bins,), optional
        Frequencies in Hz; needed for a band.
    band : tuple of float, optional
        Lower and upper limit in Hz, both included. By default all frequencies count.

    Returns
    -------
    ndarray, shape (...)
        Entropy in bits, from 0 (one line) to ``log2`` of the number of lines in the band. 0 where there is no
        power at all.

    Raises
    ------
    ValueError
        If the PSD is negative or not finite, or the band not one of its frequencies.

    Examples
    --------
    Four equal lines have two bits.

    >>> from cyclofeat.spectral import shannon_entropy
    >>> print(shannon_entropy([3.0, 3.0, 3.0, 3.0]))
    2.0
    """
    share = _power_share(psd, frequencies, band)
    # + 0.0, since a single line would give -0.0
    return np.asarray(entr(share).sum(axis=-1) / np.log(2) + 0.0)


def normalized_entropy(
    psd: ArrayLike,
    frequencies: ArrayLike | None = None,
    band: tuple[float, float] | None = None,
    epsilon: float = EPSILON,
) -> Float:
    r"""Spectral entropy as a share of the largest possible (paper A eq. 4-7).

    .. math:: E = \frac{-\sum_i p_i \log_2 (p_i + \epsilon)}{\log_2 N}, \qquad p_i = P(f_i) / \sum_k P(f_k)

    with the N lines in the band.

    Parameters
    ----------
    psd : array-like, shape (..., n_bins)
        Power spectral density, as from :func:`welch_psd`.
    frequencies : array-like, shape (n_bins,), optional
        Frequencies in Hz; needed for a band.
    band : tuple of float, optional
        Lower and upper limit in Hz, both included. By default all frequencies count.
    epsilon : float, default=EPSILON
        Small positive constant. **Assumption**: the paper gives no value; MATLAB's ``eps`` (2^-52) changes
        nothing beyond rounding.

    Returns
    -------
    ndarray, shape (...)
        Normalized entropy from 0 to 1, without unit; with the default epsilon it can pass these limits by
        rounding (1e-15). 0 where there is no power at all and where the band holds a single line.

    Raises
    ------
    ValueError
        If epsilon is not positive, the PSD is negative or not finite, or the band not one of its frequencies.

    Examples
    --------
    >>> from cyclofeat.spectral import normalized_entropy
    >>> print(normalized_entropy([1.0, 1.0, 0.0, 0.0]).round(12))
    0.5
    """
    if not 0 < epsilon < np.inf:
        raise ValueError(f"epsilon must be positive and finite, got {epsilon!r}")
    share = _power_share(psd, frequencies, band)
    n_lines = share.shape[-1]
    if n_lines == 1:
        return np.zeros(share.shape[:-1])
    entropy = -(share * np.log2(share + epsilon)).sum(axis=-1)
    return np.asarray(entropy / np.log2(n_lines))


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
    Every ratio with a denominator of zero is 0: skewness and kurtosis of a constant window, crest factor of a
    window of zeros, ripple where the mean is zero. "Zero" for the mean is what rounding cannot tell from it,
    2^-52 of the rms. The std of a single sample is 0, as in MATLAB.

    Examples
    --------
    >>> from cyclofeat.spectral import torque_statistics
    >>> statistics = torque_statistics([[20.0, 22.0, 24.0]])
    >>> print(statistics["mean"], statistics["std"], statistics["range"])
    [22.] [2.] [4.]
    """
    X = _as_windows(X)
    n_samples = X.shape[-1]
    windows = X.reshape(-1, n_samples)
    columns = np.empty((10, len(windows)))
    for chunk in _chunks(len(windows), n_samples):
        columns[:, chunk] = _statistics(np.asarray(windows[chunk], dtype=np.float64))
    names = ("min", "max", "mean", "std", "range", "rms", "crest_factor", "skewness", "kurtosis", "ripple")
    shape = X.shape[:-1]
    return {name: column.reshape(shape) for name, column in zip(names, columns, strict=True)}


def _statistics(x: Float) -> tuple[Float, ...]:
    """Statistics of ``x``, shape (n_windows, n_samples), in the order of :func:`torque_statistics`."""
    n_samples = x.shape[1]
    low = x.min(axis=1)
    high = x.max(axis=1)
    # Counted from the first sample, a constant deviates by exactly nothing.
    deviation = x - x[:, :1]
    shift = deviation.mean(axis=1)
    deviation -= shift[:, np.newaxis]
    mean = x[:, 0] + shift
    squares = np.einsum("ij,ij->i", deviation, deviation)
    std = np.sqrt(squares / max(n_samples - 1, 1))
    rms = np.sqrt(np.einsum("ij,ij->i", x, x) / n_samples)
    # Standardised first: powers of tiny or huge deviations would leave the range of floats.
    z = _ratio(deviation, np.sqrt(squares / n_samples)[:, np.newaxis])
    z_squared = z * z
    skewness = np.einsum("ij,ij->i", z_squared, z) / n_samples
    kurtosis = np.einsum("ij,ij->i", z_squared, z_squared) / n_samples
    crest_factor = _ratio(np.maximum(high, -low), rms)
    size_of_mean = np.abs(mean)
    ripple = _ratio(std, np.where(size_of_mean > np.finfo(np.float64).eps * rms, size_of_mean, 0.0))
    return low, high, mean, std, high - low, rms, crest_factor, skewness, kurtosis, ripple


def _ratio(numerator: Float, denominator: Float) -> Float:
    """Quotient by something that is not negative, and zero where that is zero."""
    quotient = np.zeros_like(numerator)
    np.divide(numerator, denominator, out=quotient, where=denominator > 0)
    return quotient
