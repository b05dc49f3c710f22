"""Discrete wavelet transform of windows of torque, level by level, and what the papers read from it.

A window is the last axis of an array, as in :mod:`cyclofeat.signal`. Whatever takes a wavelet takes a name
of PyWavelets or of the Morris family (:func:`morris_names`), a :class:`pywt.Wavelet` or a filter bank.

Scalograms follow MATLAB's documented recipe, "Discrete Wavelet Transform, Absolute Coefficients" (Wavelet
Toolbox, "Continuous and Discrete Wavelet Analysis"): each coefficient of level k is repeated 2^k times, the
row is cut centrally to the window's length (``wkeep``), values below sqrt(eps) become zero, and each row is
coloured by itself (``wcodemat`` with ``'row'``). One of these repetitions is a *cell*: a row has as many
cells as the window has samples. Statistics count cells per coefficient (:func:`visible`) instead of writing
them out.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any, TypeAlias

import numpy as np
import pywt
from numpy.typing import ArrayLike
from scipy.signal import hilbert
from scipy.signal.windows import hann

from cyclofeat._base.checks import number_series, whole
from cyclofeat.signal.windows import Bool, Float, Int, as_windows, chunks, ratio

AnyWavelet: TypeAlias = str | pywt.Wavelet | Sequence[Sequence[float]]

SMALLEST = float(np.sqrt(np.finfo(np.float64).eps))
"""MATLAB's ``sqrt(eps)`` in Nm: smaller coefficients are taken for zero."""

_SYNTHESIS_STEPS = 3  # of level_envelope: Nyquist is then four times the upper limit of the level's band


@cache
def _filter_table() -> dict[str, Any]:
    text = resources.files("cyclofeat.signal").joinpath("filters/morris_filters.json").read_text("utf-8")
    return {name: row for name, row in json.loads(text).items() if not name.startswith("_")}


def morris_names() -> tuple[str, ...]:
    """Names of the Morris family, shortest filter first."""
    return tuple(_filter_table())


def morris(name: str) -> pywt.Wavelet:
    """Wavelet of the Morris minimum-bandwidth family; ``ValueError`` for another name.

    ``name`` is ``"mbN.L"``: N is the filter's length, L the level of the transform used in its design (every
    member has one vanishing moment). The wavelet is orthogonal to rounding, and within 8e-8 of MATLAB's
    ``wfilters`` for all but mb14.3 (5e-6) and mb18.3 (2e-7), whose printed tables have misprints (J. M.
    Morris and R. Peravali, "Minimum-bandwidth discrete-time wavelets", Signal Processing 76 (1999) 181-193).
    """
    if name not in _filter_table():
        raise ValueError(f"name must be one of {', '.join(morris_names())}, got {name!r}")
    wavelet = pywt.Wavelet(name, filter_bank=pywt.orthogonal_filter_bank(_filter_table()[name]["scaling"]))
    # PyWavelets cannot tell that a filter bank of ours is orthogonal.
    wavelet.orthogonal = wavelet.biorthogonal = True
    return wavelet


def as_wavelet(wavelet: AnyWavelet) -> pywt.Wavelet:
    """Wavelet of a name (of PyWavelets or Morris) or of four filters (dec_lo, dec_hi, rec_lo, rec_hi)."""
    if isinstance(wavelet, pywt.Wavelet):
        return wavelet
    if isinstance(wavelet, str):
        if wavelet in _filter_table():
            return morris(wavelet)
        if wavelet not in pywt.wavelist(kind="discrete"):
            raise ValueError(
                f"wavelet must be a discrete wavelet of PyWavelets or one of {', '.join(morris_names())}, "
                f"got {wavelet!r}"
            )
        return pywt.Wavelet(wavelet)
    filters = [number_series("wavelet", taps) for taps in wavelet]
    if len(filters) != 4 or any(f.size != filters[0].size or f.size < 2 for f in filters):
        raise ValueError(
            "wavelet as a filter bank must hold four filters of equal length of at least 2 "
            f"(dec_lo, dec_hi, rec_lo, rec_hi), got lengths {[f.size for f in filters]}"
        )
    return pywt.Wavelet("custom", filter_bank=filters)


def wavelet_qualifier(wavelet: AnyWavelet) -> str:
    """Return the name of a wavelet in names of features, or a checksum of filters that no name stands for."""
    if isinstance(wavelet, str):
        return str(as_wavelet(wavelet).name)
    filters = np.array(as_wavelet(wavelet).filter_bank)
    name = getattr(wavelet, "name", "")
    known = name in _filter_table() or name in pywt.wavelist(kind="discrete")
    if known and np.array_equal(np.array(as_wavelet(name).filter_bank), filters):
        return str(name)
    return f"bank{zlib.crc32(filters.tobytes()):08x}"


def level_band(level: int, sampling_rate: float) -> tuple[float, float]:
    """Band in Hz of a detail level: fs/2^(j+1) <= f < fs/2^j (paper A section 5.1)."""
    whole("level", level, 1)
    return sampling_rate / 2 ** (level + 1), sampling_rate / 2**level


def level_of(frequency_hz: float, sampling_rate: float) -> int:
    """Detail level whose band holds a frequency below half the sampling rate (paper A section 5.1)."""
    if not 0 < frequency_hz < sampling_rate / 2:
        raise ValueError(
            f"frequency_hz must lie between 0 and half the sampling rate ({sampling_rate / 2:g} Hz), "
            f"got {frequency_hz!r}"
        )
    # Powers of two and what they multiply, from 0.5 to 1: exact at a band's very edge.
    (mantissa, exponent), (below, lower) = math.frexp(sampling_rate), math.frexp(frequency_hz)
    return exponent - lower - (mantissa <= below)


def dwt(X: ArrayLike, wavelet: AnyWavelet = "mb32.3", levels: int = 12) -> list[Float]:
    """Discrete wavelet transform of windows, with half-sample symmetric extension at their ends.

    ``X``, shape (..., n_samples), holds torque in Nm; ``wavelet`` is one of :func:`as_wavelet`. Returns the
    details of level 1 (highest frequencies) to the last of 1 to 30 ``levels``, then the approximation of the
    last, each of shape (..., n_coefficients), in Nm times the wavelet's 2^(k/2).

    These are MATLAB's ``wavedec`` coefficients in its default mode ``'sym'``: level k has ``(n + n_taps - 1)
    // 2`` of them, n being those of level k - 1. Beyond ``pywt.dwt_max_level`` (10 for 46,080 samples and
    mb32.3) every coefficient feels an end of the window; the papers show 12 all the same.
    """
    whole("levels", levels, least=1, most=30)
    bank = as_wavelet(wavelet)
    approximation = np.asarray(as_windows(X), dtype=np.float64)
    coefficients = []
    for _ in range(levels):
        approximation, detail = pywt.dwt(approximation, bank, mode="symmetric", axis=-1)
        coefficients.append(detail)
    return [*coefficients, approximation]


def visible(detail: Float, level: int, n_samples: int) -> tuple[Float, Int]:
    """Return the coefficients of level k that a scalogram shows, and the number of cells of each.

    ``detail``, shape (..., n_coefficients), is from :func:`dwt` of windows of ``n_samples``. Shown, as a
    view, are coefficients with at least one cell inside the central cut: 2^k cells, the first and last fewer.
    """
    # The first cell that MATLAB's wkeep(row, n_samples, 'c') keeps, counted from 0.
    start = ((detail.shape[-1] << level) - n_samples) // 2
    first, last = start >> level, (start + n_samples - 1) >> level
    borders = np.arange(first, last + 2, dtype=np.int64) << level
    return detail[..., first : last + 1], np.diff(borders.clip(start, start + n_samples))


def _coefficient_sizes(shown: Float) -> Float:
    """Absolute values, and zero for what is below sqrt(eps)."""
    size = np.abs(shown)
    size *= size >= SMALLEST
    return size


def _colour_positions(size: Float, colours: int) -> Float:
    """Position of each size in its row, from 0 to ``colours``; 0 in rows of one size. Overwrites them."""
    size -= size.min(axis=-1, keepdims=True)
    span = size.max(axis=-1, keepdims=True)
    size /= np.where(span < np.finfo(np.float64).eps, np.inf, span)
    size *= colours
    return size


def lowest_colour(shown: Float, colours: int = 64) -> Bool:
    """Mark the coefficients of a level, from :func:`visible`, that have the lowest colour of their row.

    True where ``colours * (|c| - min) / (max - min) < 1``, with the row's extremes, and in rows of one size.
    """
    return np.asarray(_colour_positions(_coefficient_sizes(shown), colours) < 1)


def scalogram(X: ArrayLike, wavelet: AnyWavelet = "mb32.3", levels: int = 12, colours: int = 64) -> Int:
    """Scalogram of windows by MATLAB's recipe, "Discrete Wavelet Transform, Absolute Coefficients".

    Returns the colour of each cell, 1 (smallest coefficient of the row, paper B's "frequency does not exist")
    to ``colours`` (largest), shape (..., levels, n_samples); row 0 is level 1, the highest frequencies. Other
    arguments are those of :func:`dwt`. Paper B section 5 and figs. 10-12 have 12 levels, 64 colours, mb32.3.

    The colour is ``1 + fix(colours * (|c| - min) / (max - min))``, the maximum itself having the highest; it
    is 1 in rows of one size of coefficient, so everywhere in constant windows. Where sizes differ by rounding
    alone (windows of two or three samples), so do colours, as in MATLAB. It does not depend on the torque's
    scale.
    """
    whole("colours", colours, least=2)
    n_samples = np.shape(X)[-1] if np.ndim(X) else 0
    rows = []
    for level, detail in enumerate(dwt(X, wavelet, levels)[:-1], 1):
        shown, cells = visible(detail, level, n_samples)
        shade = _colour_positions(_coefficient_sizes(shown), colours).astype(np.int64)
        colour = np.minimum(1 + shade, colours)
        rows.append(np.repeat(colour, cells, axis=-1))
    return np.stack(rows, axis=-2)


def level_statistics(coefficients: Sequence[Float], n_samples: int, colours: int = 64) -> dict[str, Float]:
    r"""Energy, peakedness and quiet of each level of a wavelet transform.

    ====================  ====  =======================================================================
    key                   unit  definition, over the cells of a row of the scalogram
    ====================  ====  =======================================================================
    ``rms``               Nm    :math:`\sqrt{\mathrm{mean}(c^2) / 2^k}`, the level's part in the torque
    ``energy_share``      1     mean square of the level over the sum of those of all levels
    ``kurtosis``          1     :math:`m_4 / m_2^2` of c about its mean (3 for a normal distribution)
    ``lowest_colour``     1     share of cells with the lowest colour
    ====================  ====  =======================================================================

    ``coefficients`` are those of :func:`dwt` of windows of ``n_samples``; the approximation (last entry) is
    not used. The statistics, in the order of the table, have the shape (..., levels). Coefficients below
    sqrt(eps) count as zero, as in the scalogram.
    """
    shape = coefficients[0].shape[:-1]
    columns = np.empty((3, math.prod(shape), len(coefficients) - 1))
    for level, detail in enumerate(coefficients[:-1], 1):
        shown, cells = visible(detail, level, n_samples)
        rows = shown.reshape(-1, shown.shape[-1])
        for part in chunks(len(rows), shown.shape[-1]):
            columns[:, part, level - 1] = _row_statistics(rows[part], cells / n_samples, colours)
    powers, kurtosis, lowest = columns.reshape(3, *shape, -1)
    powers /= 2.0 ** np.arange(1, len(coefficients))
    return {
        "rms": np.sqrt(powers),
        "energy_share": ratio(powers, powers.sum(axis=-1, keepdims=True)),
        "kurtosis": kurtosis,
        "lowest_colour": lowest,
    }


def _row_statistics(shown: Float, weight: Float, colours: int) -> tuple[Float, Float, Float]:
    """Mean square, kurtosis and share of the lowest colour of rows, their coefficients weighted."""
    size = _coefficient_sizes(shown)
    peak = size.max(axis=1)
    # In units of the peak: fourth powers would leave the range of floats.
    scale = np.divide(1.0, peak, out=np.zeros_like(peak), where=peak > 0)
    c = np.copysign(size, shown) * scale[:, np.newaxis]
    square = c * c
    mean_square = square @ weight * peak**2
    c -= (c @ weight)[:, np.newaxis]
    np.multiply(c, c, out=square)
    second = square @ weight
    square *= square
    # Coefficients of one size and sign differ by rounding only.
    kurtosis = ratio(square @ weight, np.where(second > np.finfo(np.float64).eps, second, 0.0) ** 2)
    return mean_square, kurtosis, (_colour_positions(size, colours) < 1) @ weight


def level_envelope(detail: Float, level: int, wavelet: AnyWavelet, n_samples: int) -> tuple[Float, int]:
    """Hilbert envelope of the torque that one level holds (paper A section 5.1).

    ``detail``, shape (..., n_coefficients), is level j of :func:`dwt` with this wavelet. Returned are the
    magnitude of the analytic signal in Nm, shape (..., n_envelope), and the samples of the window between two
    of the envelope: 2^(j-3), at least 1.

    With all coefficients but the level's set to zero, the inverse transform stops at level j - 3. That
    approximation, over 2^((j-3)/2) for its unit and cut centrally to the window, is the level's torque at the
    sampling rate over 2^(j-3). The other steps would only interpolate: for mb32.3 and level 7 the envelope's
    lines differ by less than 0.2 % of its mean (more for the shortest filters, such as haar).
    """
    bank = as_wavelet(wavelet)
    left = max(level - _SYNTHESIS_STEPS, 0)
    detail = np.where(np.abs(detail) < SMALLEST, 0.0, detail)
    signal = pywt.idwt(None, detail, bank, mode="symmetric", axis=-1)
    for _ in range(level - left - 1):
        signal = pywt.idwt(signal, None, bank, mode="symmetric", axis=-1)
    step = 1 << left
    length = -(-n_samples // step)
    first = (signal.shape[-1] - length) // 2 if left else 0
    signal = signal[..., first : first + length] / np.sqrt(step)
    return np.abs(hilbert(signal, axis=-1)), step


def envelope_lines(
    envelope: Float, rate: float, frequencies: ArrayLike, speed_tolerance: float = 0.015
) -> Float:
    """Amplitudes of an envelope near given frequencies in Hz, up to half of its sampling ``rate``.

    For each frequency, shape (..., n_lines): the largest amplitude in Nm among the bins within the relative
    tolerance and half a bin, of the envelope without its mean under a periodic Hann window.
    """
    n = envelope.shape[-1]
    taper = hann(n, sym=False)
    ripple = envelope - envelope.mean(axis=-1, keepdims=True)
    amplitude = np.abs(np.fft.rfft(ripple * (2 / taper.sum() * taper)))
    last = amplitude.shape[-1] - 1
    lines = []
    for frequency in np.asarray(frequencies, dtype=np.float64).ravel():
        centre, reach = frequency * n / rate, 0.5 + speed_tolerance * frequency * n / rate
        low = min(max(int(np.ceil(centre - reach)), 0), last)
        high = min(max(int(np.floor(centre + reach)), low), last)
        lines.append(amplitude[..., low : high + 1].max(axis=-1))
    return np.stack(lines, axis=-1)
