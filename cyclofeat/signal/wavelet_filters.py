"""Wavelets by name and their frequency bands. Public as :mod:`cyclofeat.signal.wavelets`."""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import pywt

__all__ = [
    "as_wavelet",
    "level_band",
    "level_of",
    "morris",
    "morris_names",
    "wavelet_qualifier",
]


@cache
def _table() -> dict[str, Any]:
    text = resources.files("cyclofeat.signal").joinpath("filters/morris_filters.json").read_text("utf-8")
    return {name: row for name, row in json.loads(text).items() if not name.startswith("_")}


def morris_names() -> tuple[str, ...]:
    """Names of the Morris family, shortest filter first.

    Examples
    --------
    >>> morris_names()[0], morris_names()[-1], len(morris_names())
    ('mb4.2', 'mb32.3', 11)
    """
    return tuple(_table())


def morris(name: str) -> pywt.Wavelet:
    """A wavelet of the Morris minimum-bandwidth family.

    Parameters
    ----------
    name : str
        ``"mbN.L"``: N is the filter's length, L the level of the transform used in its design (not a number
        of vanishing moments; every member has one).

    Returns
    -------
    pywt.Wavelet
        Orthogonal to rounding; within 8e-8 of MATLAB's ``wfilters`` for all but mb14.3 (5e-6) and mb18.3
        (2e-7), whose printed tables have misprints.

    Raises
    ------
    ValueError
        For a name outside the family.

    References
    ----------
    J. M. Morris and R. Peravali, "Minimum-bandwidth discrete-time wavelets", Signal Processing 76 (1999)
    181-193.

    Examples
    --------
    >>> morris("mb32.3").dec_len
    32
    """
    if name not in _table():
        raise ValueError(f"name must be one of {', '.join(morris_names())}, got {name!r}")
    wavelet = pywt.Wavelet(name, filter_bank=pywt.orthogonal_filter_bank(_table()[name]["scaling"]))
    # PyWavelets cannot tell that a filter bank of ours is orthogonal.
    wavelet.orthogonal = wavelet.biorthogonal = True
    return wavelet


def as_wavelet(wavelet: str | pywt.Wavelet | Sequence[Sequence[float]]) -> pywt.Wavelet:
    """A discrete wavelet from whatever names it.

    Parameters
    ----------
    wavelet : str, pywt.Wavelet or sequence of four filters
        Name of PyWavelets or of the Morris family, a wavelet, or a filter bank
        ``(dec_lo, dec_hi, rec_lo, rec_hi)``.

    Raises
    ------
    ValueError
        For an unknown name or filters that do not form a bank.

    Examples
    --------
    >>> as_wavelet("mb4.2").name, as_wavelet("db4").name
    ('mb4.2', 'db4')
    """
    if isinstance(wavelet, pywt.Wavelet):
        return wavelet
    if isinstance(wavelet, str):
        if wavelet in _table():
            return morris(wavelet)
        if wavelet not in pywt.wavelist(kind="discrete"):
            raise ValueError(
                f"wavelet must be a discrete wavelet of PyWavelets or one of {', '.join(morris_names())}, "
                f"got {wavelet!r}"
            )
        return pywt.Wavelet(wavelet)
    filters = [np.asarray(taps, dtype=float) for taps in wavelet]
    if len(filters) != 4 or any(f.ndim != 1 or f.size != filters[0].size or f.size < 2 for f in filters):
        raise ValueError(
            "wavelet as a filter bank must hold four filters of equal length of at least 2 "
            f"(dec_lo, dec_hi, rec_lo, rec_hi), got lengths {[f.size for f in filters]}"
        )
    if not all(np.isfinite(f).all() for f in filters):
        raise ValueError("wavelet as a filter bank must be finite, got NaN or infinity")
    return pywt.Wavelet("custom", filter_bank=filters)


def wavelet_qualifier(wavelet: str | pywt.Wavelet | Sequence[Sequence[float]]) -> str:
    """Return the name of a wavelet in names of features, or a checksum of filters that no name stands for.

    Examples
    --------
    >>> wavelet_qualifier("mb32.3"), wavelet_qualifier([[1, 1], [1, -1], [1, 1], [-1, 1]])
    ('mb32.3', 'bankcbd66947')
    """
    if isinstance(wavelet, str):
        return str(as_wavelet(wavelet).name)
    filters = np.array(as_wavelet(wavelet).filter_bank)
    name = getattr(wavelet, "name", "")
    known = name in _table() or name in pywt.wavelist(kind="discrete")
    if known and np.array_equal(np.array(as_wavelet(name).filter_bank), filters):
        return str(name)
    return f"bank{zlib.crc32(filters.tobytes()):08x}"


def level_band(level: int, sampling_rate: float) -> tuple[float, float]:
    """Band in Hz of a detail level: fs/2^(j+1) <= f < fs/2^j (paper A section 5.1).

    Examples
    --------
    >>> level_band(7, 25_600)
    (100.0, 200.0)
    """
    if level < 1:
        raise ValueError(f"level must be at least 1, got {level!r}")
    return sampling_rate / 2 ** (level + 1), sampling_rate / 2**level


def level_of(frequency_hz: float, sampling_rate: float) -> int:
    """Detail level whose band holds a frequency below half the sampling rate (paper A section 5.1).

    Examples
    --------
    >>> level_of(16 * 500 / 60, 25_600)  # the papers' mesh frequency
    7
    """
    if not 0 < frequency_hz < sampling_rate / 2:
        raise ValueError(
            f"frequency_hz must lie between 0 and half the sampling rate ({sampling_rate / 2:g} Hz), "
            f"got {frequency_hz!r}"
        )
    level = int(np.floor(np.log2(sampling_rate / frequency_hz)))
    low, high = level_band(level, sampling_rate)
    # Rounding of the logarithm at a band's very edge.
    return level + 1 if frequency_hz < low else level - 1 if frequency_hz >= high else level
