"""Welch's power spectral density as named presets define it, and the spectrum of amplitudes."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.fft
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from cyclofeat._base.checks import one_of, positive, whole
from cyclofeat.signal.windows import Complex, Float, as_windows, chunks, ratio

# SciPy's window, whether it is symmetric, whether each segment's mean is removed. The Hann window of spectra
# is periodic; it also never vanishes, as the symmetric one of two samples does.
PRESETS = {"matlab_pwelch": ("hamming", True, False), "ripple": ("hann", False, True)}
"""Definitions of Welch's power spectral density by name, all with MATLAB's segments.

``"matlab_pwelch"``
    MATLAB's ``pwelch(x, [], [], [], fs)``, which paper A used: symmetric Hamming window, mean kept. The mean
    torque's line at 0 Hz dominates it.
``"ripple"``
    The torque ripple alone: mean of each segment removed, periodic Hann window.
"""

#: Samples of the shortest window whose density means something, in words too.
EIGHT_SEGMENTS = 288, "eight half-overlapping segments of 64 samples"


def segment_lengths(n_samples: int) -> tuple[int, int]:
    """Return the samples in each of 8 segments with 50 % overlap, at least 1, and those when zero-padded.

    These are ``floor(n_samples / 4.5)`` and ``max(256, 2**nextpow2(segment))``.
    """
    segment = max(1, 2 * n_samples // 9)
    return segment, max(256, 1 << (segment - 1).bit_length())


def welch_frequencies(n_samples: int, sampling_rate: float) -> Float:
    """Frequencies in Hz of the lines of :func:`welch_psd`, shape (n_bins,), to half of the sampling rate."""
    positive("sampling_rate", sampling_rate)
    _, n_fft = segment_lengths(n_samples)
    return np.arange(n_fft // 2 + 1) * float(sampling_rate) / n_fft


class SegmentTransforms:
    """Fourier transforms of overlapping segments, times ``taper``, (segment,), zero-padded to ``n_fft``."""

    def __init__(self, taper: Float, n_samples: int, overlap: int, n_fft: int, remove_mean: bool) -> None:
        self.taper = taper
        self.step = taper.size - overlap
        self.n_segments = (n_samples - overlap) // self.step
        self.n_fft = n_fft
        self.remove_mean = remove_mean
        self._buffer = np.zeros((0, self.n_segments, n_fft))

    def __call__(self, x: NDArray[Any]) -> Complex:
        """Transforms, shape (n_windows, n_segments, n_bins), of windows of shape (n_windows, n_samples)."""
        if len(self._buffer) < len(x):
            self._buffer = np.zeros((len(x), self.n_segments, self.n_fft))
        padded = self._buffer[: len(x)]
        tapered = padded[..., : self.taper.size]
        if self.remove_mean:
            # A constant less its mean leaves rounding; less its own first sample it leaves nothing.
            x = np.asarray(x, dtype=np.float64) - x[:, :1].astype(np.float64)
        pieces = sliding_window_view(x, self.taper.size, axis=1)[:, :: self.step]
        if self.remove_mean:
            pieces = np.subtract(pieces, pieces.mean(axis=2, keepdims=True), out=tapered)
        # The taper is float64, and so are the products with samples of single precision.
        np.multiply(pieces, self.taper, out=tapered)
        return np.asarray(scipy.fft.rfft(padded, axis=-1))


def welch_transforms(n_samples: int, preset: str) -> SegmentTransforms:
    """Transforms of the segments that a preset makes of windows of ``n_samples`` samples."""
    window, symmetric, remove_mean = PRESETS[one_of("preset", preset, PRESETS)]
    segment, n_fft = segment_lengths(n_samples)
    taper = np.asarray(signal.get_window(window, segment, fftbins=not symmetric))
    return SegmentTransforms(taper, n_samples, segment // 2, n_fft, remove_mean)


def power_over_segments(transforms: Complex) -> Float:
    """Sum of the squared moduli over the segments, shape (n_windows, n_bins)."""
    total = np.square(transforms.view(np.float64)).sum(axis=1)  # real and imaginary parts in turn
    return np.asarray(total[:, ::2] + total[:, 1::2])


def one_sided(n_bins: int) -> Float:
    """Both sides of a spectrum in one: 1 at 0 Hz and at half of the sampling rate, 2 between them."""
    sides = np.full(n_bins, 2.0)
    sides[[0, -1]] = 1.0
    return sides


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

    Notes
    -----
    A constant window has the transform of the Hamming window under ``"matlab_pwelch"`` and is exactly zero
    under ``"ripple"``. A window of fewer than 9 samples has segments of one sample: its spectrum is flat
    under ``"matlab_pwelch"`` and zero under ``"ripple"``. The segments may not reach a window's end.

    References
    ----------
    Paper A section 5.3 names MATLAB's ``pwelch`` and gives no arguments, hence its defaults here.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.signal import welch_psd
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
    X = as_windows(X)
    n_samples = X.shape[-1]
    frequencies = welch_frequencies(n_samples, sampling_rate)
    transforms = welch_transforms(n_samples, preset)
    taper = transforms.taper
    norm = float(sampling_rate) * (taper @ taper) * transforms.n_segments
    scale = one_sided(frequencies.size) / norm
    windows = X.reshape(-1, n_samples)
    psd = np.empty((len(windows), frequencies.size))
    for chunk in chunks(len(windows), transforms.n_segments * frequencies.size):
        psd[chunk] = power_over_segments(transforms(windows[chunk])) * scale
    return frequencies, psd.reshape(*X.shape[:-1], frequencies.size)


AMPLITUDE_WINDOWS = ("hamming", "hann", "blackman", "boxcar", "flattop")
"""Windows for :func:`amplitude_spectrum`, all symmetric, as MATLAB's are by default."""


def amplitude_spectrum(
    X: ArrayLike, sampling_rate: float, n_fft: int = 8192, window: str = "hamming"
) -> tuple[Float, Float]:
    r"""Amplitudes of the torque's spectral lines, averaged over blocks.

    .. math:: A(f_i) = \frac{c_i}{\sum_k w_k} \sqrt{\frac{1}{M} \sum_{m=1}^{M}
              \left| \sum_k w_k x_{m,k} e^{-2 \pi j i k / N} \right|^2}

    over the M blocks :math:`x_m` of N = ``n_fft`` samples that fit into a window, each begun ``n_fft // 2``
    samples after the one before; :math:`c_i` = 1 at 0 Hz and at half of the sampling rate, 2 between them. A
    sine of amplitude A on a line of the spectrum reads A, constant torque its own value.

    Parameters
    ----------
    X : array-like, shape (..., n_samples)
        Windows of torque in Nm.
    sampling_rate : float
        Samples per second in Hz.
    n_fft : int, default=8192
        Samples in a block; even.
    window : {"hamming", "hann", "blackman", "boxcar", "flattop"}, default="hamming"
        Window by which each block is multiplied; symmetric.

    Returns
    -------
    frequencies : ndarray, shape (n_fft // 2 + 1,)
        Frequencies in Hz, from 0 to half of the sampling rate.
    amplitudes : ndarray, shape (..., n_fft // 2 + 1)
        Amplitudes in Nm, float64.

    Notes
    -----
    The mean is kept. Powers are averaged, so that noise reads its rms whatever the number of blocks. A window
    of fewer than ``n_fft`` samples is one block, tapered over its own length and zero-padded; one or two
    samples are not tapered, since symmetric windows of two samples can be zero.

    References
    ----------
    Paper B section 6 names the 8192-point transform and its Hamming window, not how blocks are averaged:
    that is an assumption here. Paper A fig. 20 compares such spectra.

    Examples
    --------
    >>> import numpy as np
    >>> from cyclofeat.signal import amplitude_spectrum
    >>> torque = 22 + 3 * np.sin(2 * np.pi * 400 * np.arange(46_080) / 25_600)
    >>> frequencies, amplitudes = amplitude_spectrum(torque, 25_600)
    >>> line = int(np.flatnonzero(frequencies == 400.0)[0])
    >>> print(amplitudes[[0, line]].round(3))
    [22.  3.]
    """
    positive("sampling_rate", sampling_rate)
    if whole("n_fft", n_fft, least=2) % 2:
        raise ValueError(f"n_fft must be even, got {n_fft!r}")
    one_of("window", window, AMPLITUDE_WINDOWS)
    X = as_windows(X)
    n_samples = X.shape[-1]
    frequencies = np.arange(n_fft // 2 + 1) * float(sampling_rate) / n_fft
    block = min(n_samples, n_fft)
    taper = signal.get_window(window if block > 2 else "boxcar", block, fftbins=False)
    overlap = n_fft - n_fft // 2 if block == n_fft else 0
    windows = X.reshape(-1, n_samples)
    amplitudes = np.empty((len(windows), frequencies.size))
    transforms = SegmentTransforms(taper, n_samples, overlap, n_fft, remove_mean=False)
    for chunk in chunks(len(windows), transforms.n_segments * frequencies.size):
        amplitudes[chunk] = np.sqrt(power_over_segments(transforms(windows[chunk])) / transforms.n_segments)
    amplitudes *= one_sided(frequencies.size) / taper.sum()
    return frequencies, amplitudes.reshape(*X.shape[:-1], frequencies.size)


# Share of the largest line's power below which a line of a Fourier transform is rounding.
_ROUNDING = 1e-28


def without_rounding(power: Float) -> Float:
    """Powers of lines, shape (n_windows, n_bins), with 0 for those that hold nothing but rounding."""
    return np.where(power > _ROUNDING * power.max(axis=1, keepdims=True), power, 0.0)


def coherence_of_transforms(a: Complex, a_power: Float, b: Complex, b_power: Float) -> Float:
    """Coherence, shape (..., n_bins), of transforms (..., n_segments, n_bins) and their powers."""
    cross = np.einsum("...sk,...sk->...k", a.conj(), b)
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
    transforms = welch_transforms(n_samples, "matlab_pwelch")
    windows: NDArray[Any] = x.reshape(-1, n_samples)
    references: NDArray[Any] = reference.reshape(-1, n_samples)
    coherence = np.empty((len(windows), frequencies.size))
    for chunk in chunks(len(windows), 2 * transforms.n_segments * frequencies.size):
        a = transforms(windows[chunk])
        b = transforms(references if len(references) == 1 else references[chunk])
        a_power, b_power = (without_rounding(power_over_segments(part)) for part in (a, b))
        coherence[chunk] = coherence_of_transforms(a, a_power, b, b_power)
    return frequencies, coherence.reshape(*x.shape[:-1], frequencies.size)
