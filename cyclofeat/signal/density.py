"""Shape of a power spectral density: entropy, flatness, centroid, roll-off, power in bands."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import entr

from cyclofeat._base.checks import not_negative, number_pair, positive, whole
from cyclofeat.signal.windows import Bool, Float, ratio

Band = tuple[float, float]  # lower and upper limit in Hz
_EPSILON = float(np.finfo(np.float64).eps)  # assumed in paper A eq. 5: MATLAB's eps


def band_slice(frequencies: ArrayLike, band: Band | None) -> slice:
    """Return which lines of increasing frequencies lie in a band in Hz, its limits included; all for None."""
    if band is None:
        return slice(None)
    frequencies = np.asarray(frequencies, dtype=np.float64)
    low, high = number_pair("band", band, "two frequencies (low, high) in Hz")
    if not 0 <= low < high:
        raise ValueError(f"band must be (low, high) in Hz with 0 <= low < high, got {band!r}")
    if high > frequencies[-1]:
        raise ValueError(
            f"band {band!r} Hz reaches beyond the highest frequency, {frequencies[-1]:g} Hz "
            "(half of the sampling rate)"
        )
    inside = np.flatnonzero((frequencies >= low) & (frequencies <= high))
    if not inside.size:
        raise ValueError(
            f"band {band!r} Hz holds none of the {frequencies.size} spectral lines, which are "
            f"{np.diff(frequencies[:2]).sum():g} Hz apart"
        )
    return slice(int(inside[0]), int(inside[-1]) + 1)


def _cut_band(psd: ArrayLike, frequencies: ArrayLike | None, band: Band | None = None) -> tuple[Float, Float]:
    """Return the checked density and the frequencies of the lines in the band."""
    psd = np.asarray(psd, dtype=np.float64)
    if frequencies is None:
        if band is not None:
            raise ValueError(f"frequencies are needed to find the band {band!r} Hz, got None")
        frequencies = np.zeros(psd.shape[-1])
    frequencies = np.asarray(frequencies, dtype=np.float64)
    if frequencies.shape != psd.shape[-1:]:
        raise ValueError(
            f"frequencies must hold one frequency for each of the {psd.shape[-1]} lines, "
            f"got shape {frequencies.shape}"
        )
    inside = band_slice(frequencies, band)
    psd = psd[..., inside]
    if not (np.isfinite(psd).all() and (psd >= 0).all()):
        raise ValueError("psd must be finite and not negative")
    return psd, frequencies[inside]


def _power_share(psd: ArrayLike, frequencies: ArrayLike | None, band: Band | None) -> Float:
    """PSD over its sum in the band (paper A eq. 4); zero everywhere if there is no power."""
    psd, _ = _cut_band(psd, frequencies, band)
    return ratio(psd, psd.sum(axis=-1, keepdims=True))


def shannon_entropy(psd: ArrayLike, frequencies: ArrayLike | None = None, band: Band | None = None) -> Float:
    r"""Shannon entropy of a power spectral density in bits (paper A eq. 8).

    .. math:: H = -\sum_i p_i \log_2 p_i, \qquad p_i = P(f_i) / \sum_k P(f_k)

    where :math:`0 \log_2 0 = 0` and both sums run over the band. It grows with ``log2`` of the zero-padding.

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

    Examples
    --------
    >>> from cyclofeat.signal import shannon_entropy
    >>> print(shannon_entropy([3.0, 3.0, 3.0, 3.0]))
    2.0
    """
    share = _power_share(psd, frequencies, band)
    # + 0.0, since a single line would give -0.0
    return np.asarray(entr(share).sum(axis=-1) / np.log(2) + 0.0)


def normalized_entropy(
    psd: ArrayLike, frequencies: ArrayLike | None = None, band: Band | None = None
) -> Float:
    r"""Spectral entropy as a share of the largest possible (paper A eq. 4-7).

    .. math:: E = \frac{-\sum_i p_i \log_2 (p_i + \epsilon)}{\log_2 N}, \qquad p_i = P(f_i) / \sum_k P(f_k)

    with the N lines in the band. **Assumption**: the paper gives no epsilon; MATLAB's ``eps`` (2^-52) changes
    nothing beyond rounding.

    Parameters
    ----------
    psd, frequencies, band
        See :func:`shannon_entropy`.

    Returns
    -------
    ndarray, shape (...)
        Normalized entropy from 0 to 1, without unit; it can pass these limits by rounding (1e-15). 0
        where there is no power at all and where the band holds a single line.

    Examples
    --------
    >>> from cyclofeat.signal import normalized_entropy
    >>> print(normalized_entropy([1.0, 1.0, 0.0, 0.0]).round(12))
    0.5
    """
    share = _power_share(psd, frequencies, band)
    n_lines = share.shape[-1]
    if n_lines == 1:
        return np.zeros(share.shape[:-1])
    entropy = -(share * np.log2(share + _EPSILON)).sum(axis=-1)
    return np.asarray(entropy / np.log2(n_lines))


def spectral_flatness(
    psd: ArrayLike, frequencies: ArrayLike | None = None, band: Band | None = None
) -> Float:
    r"""Flatness of a power spectral density: geometric over arithmetic mean (paper A eq. 9).

    .. math:: F = \frac{\left(\prod_i P(f_i)\right)^{1/N}}{\frac{1}{N} \sum_i P(f_i)}
              = N \exp\left(\frac{1}{N} \sum_i \ln p_i\right), \qquad p_i = P(f_i) / \sum_k P(f_k)

    over the N lines of the band, computed by the second form: the product of thousands of densities would
    leave the range of floats.

    Parameters
    ----------
    psd, frequencies, band
        See :func:`shannon_entropy`.

    Returns
    -------
    ndarray, shape (...)
        Flatness without unit, from 0 (one line) to 1 (all lines equal; 1e-12 beyond it by rounding). A single
        line of zero makes the product and so the flatness 0; so does a density without any power.

    Examples
    --------
    >>> from cyclofeat.signal import spectral_flatness
    >>> print(spectral_flatness([[1.0, 4.0], [3.0, 3.0], [1.0, 0.0]]).round(12))
    [0.8 1.  0. ]
    """
    share = _power_share(psd, frequencies, band)
    with np.errstate(divide="ignore"):  # ln 0 = -inf, whose exponential is the right 0
        mean_log = np.log(share).mean(axis=-1)
    return np.asarray(share.shape[-1] * np.exp(mean_log))


def spectral_centroid(psd: ArrayLike, frequencies: ArrayLike, band: Band | None = None) -> Float:
    r"""Centroid of a power spectral density: its mean frequency (paper A section 5.4).

    .. math:: f_c = \sum_i f_i P(f_i) / \sum_i P(f_i)

    Parameters
    ----------
    psd, frequencies, band
        See :func:`shannon_entropy`.

    Returns
    -------
    ndarray, shape (...)
        Frequency in Hz; 0 where there is no power at all.

    Notes
    -----
    With the mean torque kept, its line at 0 Hz draws the centroid to a few Hz, as in paper A table 5. The
    paper gives no formula; its weights could also be amplitudes.

    Examples
    --------
    >>> from cyclofeat.signal import spectral_centroid
    >>> print(spectral_centroid([3.0, 0.0, 1.0], [0.0, 50.0, 100.0]))
    25.0
    """
    psd, frequencies = _cut_band(psd, frequencies, band)
    return np.asarray(ratio(psd, psd.sum(axis=-1, keepdims=True)) @ frequencies)


def spectral_rolloff(
    psd: ArrayLike, frequencies: ArrayLike, fraction: float = 0.95, band: Band | None = None
) -> Float:
    r"""Roll-off frequency: the lowest line up to which a fraction of the power lies (paper A section 5.4).

    .. math:: f_r = \min \left\{ f_i : \sum_{k \le i} P(f_k) \ge q \sum_k P(f_k) \right\}

    Parameters
    ----------
    psd, frequencies, band
        See :func:`shannon_entropy`.
    fraction : float, default=0.95
        Fraction q of the power, above 0 and at most 1.

    Returns
    -------
    ndarray, shape (...)
        Frequency of a line in Hz; 0 where there is no power at all.

    Examples
    --------
    >>> from cyclofeat.signal import spectral_rolloff
    >>> print(spectral_rolloff([90.0, 6.0, 3.0, 1.0], [0.0, 50.0, 100.0, 150.0]))
    50.0
    """
    if not 0 < fraction <= 1:
        raise ValueError(f"fraction must be above 0 and at most 1, got {fraction!r}")
    psd, frequencies = _cut_band(psd, frequencies, band)
    power = np.cumsum(psd, axis=-1)
    total = power[..., -1]
    reached = power >= fraction * total[..., np.newaxis]
    return np.asarray(np.where(total > 0, frequencies[reached.argmax(axis=-1)], 0.0))


def octave_bands(sampling_rate: float) -> tuple[Band, ...]:
    """Eight bands from 0 to half of the sampling rate, those above the lowest an octave wide.

    The upper seven are the bands of the wavelet detail levels 7 to 1 (paper A section 5.1). Each holds a line
    of :func:`welch_psd` however short the windows are.

    Parameters
    ----------
    sampling_rate : float
        Samples per second in Hz.

    Returns
    -------
    tuple of tuple of float
        Lower and upper limits in Hz, lowest band first.

    Examples
    --------
    >>> from cyclofeat.signal import octave_bands
    >>> octave_bands(25_600)[:3]
    ((0.0, 100.0), (100.0, 200.0), (200.0, 400.0))
    """
    positive("sampling_rate", sampling_rate)
    limits = [0.0, *(float(sampling_rate) / 2**power for power in range(8, 0, -1))]
    return tuple(pairwise(limits))


def checked_bands(frequencies: Float, bands: Sequence[Band] | None) -> tuple[Band, ...]:
    """Bands that fit the frequencies; ``None`` stands for :func:`octave_bands`."""
    if bands is None:
        return octave_bands(2 * frequencies[-1])
    if len(bands) == 0 or not all(np.iterable(band) for band in bands):
        raise ValueError(f"bands must be a sequence of (low, high) in Hz, got {bands!r}")
    for band in bands:
        band_slice(frequencies, band)  # raises where a band does not fit
    return tuple(bands)


def band_power(psd: ArrayLike, frequencies: ArrayLike, bands: Sequence[Band] | None = None) -> Float:
    r"""Power of the torque in bands: the sum of the lines times their distance.

    .. math:: W = \Delta f \sum_{f_{low} \le f_i \le f_{high}} P(f_i)

    Parameters
    ----------
    psd : array-like, shape (..., n_bins)
        Power spectral density, as from :func:`welch_psd`.
    frequencies : array-like, shape (n_bins,)
        Frequencies in Hz, evenly spaced from 0 to half of the sampling rate.
    bands : sequence of tuple of float, optional
        Lower and upper limits in Hz, both included: a line on the limit of two bands counts in both. By
        default those of :func:`octave_bands`.

    Returns
    -------
    ndarray, shape (..., n_bands)
        Power in Nm^2: the mean square of the torque within the band.

    Examples
    --------
    >>> from cyclofeat.signal import band_power
    >>> print(band_power([1.0, 2.0, 3.0], [0.0, 10.0, 20.0], [(0.0, 20.0), (15.0, 20.0)]))
    [60. 30.]
    """
    psd, frequencies = _cut_band(psd, frequencies)
    distance = frequencies[-1] / max(frequencies.size - 1, 1)
    bands = checked_bands(frequencies, bands)
    sums = [psd[..., band_slice(frequencies, band)].sum(axis=-1) for band in bands]
    return np.asarray(distance * np.stack(sums, axis=-1))


def narrowband_mask(
    frequencies: ArrayLike, fundamental_hz: float, half_width_hz: float, n_harmonics: int | None
) -> Bool:
    """Mark the spectral lines around the harmonics of a frequency; arguments of :func:`narrowband_ratio`."""
    frequencies = np.asarray(frequencies, dtype=np.float64)
    positive("fundamental_hz", fundamental_hz)
    not_negative("half_width_hz", half_width_hz)
    highest = fundamental_hz * whole("n_harmonics", 1 if n_harmonics is None else n_harmonics, 1)
    if highest > frequencies[-1]:
        raise ValueError(
            f"harmonic {n_harmonics or 1} of fundamental_hz={fundamental_hz:g} Hz lies at {highest:g} Hz, "
            f"beyond the highest frequency, {frequencies[-1]:g} Hz (half of the sampling rate)"
        )
    count = n_harmonics or int(frequencies[-1] / fundamental_hz * (1 + 1e-12))
    harmonics = fundamental_hz * np.arange(1, count + 1)
    number = np.clip(np.rint(frequencies / fundamental_hz), 1, count)
    mask: Bool = np.abs(frequencies - number * fundamental_hz) <= half_width_hz
    right = np.minimum(np.searchsorted(frequencies, harmonics), frequencies.size - 1)
    left = np.maximum(right - 1, 0)
    nearer_left = harmonics - frequencies[left] < np.abs(frequencies[right] - harmonics)
    mask[np.where(nearer_left, left, right)] = True
    return mask


def narrowband_ratio(
    psd: ArrayLike,
    frequencies: ArrayLike,
    fundamental_hz: float = 100.0,
    half_width_hz: float = 5.0,
    n_harmonics: int | None = None,
) -> Float:
    r"""Share of the power that lies around the harmonics of a frequency (paper A section 5.5).

    .. math:: R = \sum_{i \in N} P(f_i) / \sum_i P(f_i)

    where N are the lines around the harmonics.

    Parameters
    ----------
    psd : array-like, shape (..., n_bins)
        Power spectral density, as from :func:`welch_psd`. With the mean torque kept, its line at 0 Hz counts
        in the total.
    frequencies : array-like, shape (n_bins,)
        Frequencies in Hz, increasing to half of the sampling rate.
    fundamental_hz : float, default=100.0
        Fundamental in Hz.
    half_width_hz : float, default=5.0
        A line counts if it is no farther than this from a harmonic, in Hz. The line nearest to each harmonic
        always counts. **Assumption**: paper A gives no width.
    n_harmonics : int, optional
        Number of harmonics, the fundamental being the first. By default as many as fit below or at half of
        the sampling rate.

    Returns
    -------
    ndarray, shape (...)
        Ratio without unit, from 0 to 1; 0 where there is no power at all.

    Examples
    --------
    >>> from cyclofeat.signal import narrowband_ratio
    >>> print(narrowband_ratio([2.0, 0.0, 1.0, 0.0, 1.0], [0.0, 50.0, 100.0, 150.0, 200.0]))
    0.5
    """
    psd, frequencies = _cut_band(psd, frequencies)
    mask = narrowband_mask(frequencies, fundamental_hz, half_width_hz, n_harmonics)
    return np.asarray(ratio(psd @ mask.astype(np.float64), psd.sum(axis=-1)))
