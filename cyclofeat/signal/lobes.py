"""Torque folded lobe by lobe: pure functions of windows.

Each lobe of a disc with z_s lobes passes the load once in z_s/(z_s+1) of an input turn, so a worn lobe
disturbs the torque at (z_s+1)/z_s of the input speed: 16/15 for the papers' drive. Torque folded at that
*lobe frequency* gives every lobe a slot of its own; the fold's harmonics are the *lobe lines*. Shaft run-out
(order 1), the mains and a drifting brake do not repeat at the lobe frequency and average out.

The torsional resonance of rotor and torque meter would ring from slot to slot. An autoregressive model of
each window takes it out beforehand.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.linalg import solve_toeplitz
from scipy.ndimage import uniform_filter1d
from scipy.signal import firwin, lfilter, resample_poly
from scipy.signal.windows import hann

from cyclofeat.signal.windows import Complex, Float, ratio

#: Largest relative deviation from the nominal speed that the search for lobe lines covers by default.
SPEED_TOLERANCE = 0.015

#: Number of lobe lines of a map, of a count and of the search for the speed, and the fewest that tell it.
N_LINES, FEWEST_LINES = 44, 3

# Windows hold lobe lines up to this share of the sampling rate: the low-pass of resampling is flat there.
_SHARE_HELD = 0.4
# The reduced sampling rate, in lobe frequencies per lobe line kept: its Nyquist is 3 times the highest line.
_RATE_PER_LINE = 6
# Default order of the autoregressive model.
_AR_ORDER = 16
# A spectrum padded this many times is read between its bins by straight lines.
_PADDING = 8
# The local floor averages over this many lobe lines; the contrast compares a line with as many neighbours.
_FLOOR_WIDTH = 3
_CONTRAST_WIDTH = 5
# Steps of the speed search over its whole range; its first line, below which the brake drifts.
_SPEED_STEPS = 301
_FIRST_SEARCHED = 5
# Windows taken at once: their spectra need some fifty times their memory.
_BLOCK = 256
# Mean power over floor of lines that are absent, clear and strong; most that counts; their shares if worn.
_MEANS, _MOST, LOBE_LINE = np.array([1.0, 4.0, 10.0]), 15.0, (0.25, 0.4, 0.35)
#: Usual numbers of pins of the output, each of which a lobe passes as often as the load.
OUTPUT_PINS = range(6, 13)
# Prominence in dB of a mesh line that stands alone; evidence of lobe lines that may be there, and of those
# that surely are; the first of them.
_ALONE_DB, _LEAST_EVIDENCE, _CLEAR_EVIDENCE, _FIRST_CLEAR = 11.0, 6.0, 40.0, 3
# Power ratios are read down to -30 dB.
_TINY = 1e-3


class LobeLines(NamedTuple):
    """Lobe lines of windows: refined input speed of each, shape (n_windows,), lines, and power around them.

    ``lines``, shape (n_windows, n_lines), are the complex amplitudes c_k of lobe lines k = 1, 2, ...: the
    whitened torque, in units of its standard deviation, holds Re(c_k exp(2 pi i k f t)) with the lobe
    frequency f and t = 0 at the first sample. ``floor`` is the mean power of the spectrum within three lobe
    frequencies around each line.
    """

    input_speed_hz: Float
    lines: Complex
    floor: Float


def lobe_frequency(input_speed_hz: float, n_lobes: int = 15) -> float:
    """Rate in Hz at which one lobe passes the load: (z_s + 1)/z_s of the input speed."""
    return input_speed_hz * (n_lobes + 1) / n_lobes


def highest_frequency(input_speed_hz: float, n_lobes: int, n_lines: int, speed_tolerance: float) -> float:
    """Frequency in Hz up to which windows must hold torque for ``n_lines`` lobe lines."""
    return n_lines * lobe_frequency(input_speed_hz, n_lobes) * (1 + speed_tolerance)


def lines_held(
    sampling_rate: float,
    input_speed_hz: float,
    n_lobes: int,
    speed_tolerance: float = 0.0,
    most: int = N_LINES,
) -> int:
    """Return the number of lobe lines that windows hold for a count: ``most``, at a low rate down to 3."""
    highest = highest_frequency(input_speed_hz, n_lobes, 1, speed_tolerance)
    return max(FEWEST_LINES, min(most, int(_SHARE_HELD * sampling_rate / highest)))


def reduce_rate(X: Float, sampling_rate: float, wanted_rate: float) -> tuple[Float, float]:
    """Remove the mean, as the filter pads with zeros, and reduce the rate; return windows and rate in Hz."""
    factor = max(1, int(sampling_rate // wanted_rate))
    if factor < 2:
        return X - X.mean(axis=1, keepdims=True), sampling_rate
    taps = anti_alias(factor)
    # Row by row: a window and what is made of it stay in the processor's cache.
    rows = [resample_poly(row - row.mean(), 1, factor, window=taps) for row in X]
    return np.asarray(rows).reshape(len(X), -1), sampling_rate / factor


def whitened_rate(sampling_rate: float, input_speed_hz: float, n_lobes: int, n_lines: int) -> float:
    """Return the sampling rate in Hz to which windows are reduced before :func:`prewhiten`."""
    wanted = _RATE_PER_LINE * n_lines * lobe_frequency(input_speed_hz, n_lobes)
    return sampling_rate / max(1, int(sampling_rate // wanted))


@functools.lru_cache(maxsize=16)
def anti_alias(factor: int) -> Float:
    """Return the filter that ``scipy.signal.resample_poly`` would design anew for each window, read-only."""
    return _make_read_only(firwin(20 * factor + 1, 1 / factor, window=("kaiser", 5.0)))


@functools.lru_cache(maxsize=16)
def _hann_taper(n_samples: int) -> Float:
    return _make_read_only(hann(n_samples, sym=False))


def _make_read_only(values: NDArray[Any]) -> NDArray[Any]:
    """Make an array read-only, because cached arrays are shared."""
    values.flags.writeable = False
    return values


def prewhiten(X: Float, sampling_rate: float, order: int, lowest_hz: float) -> Float:
    """Residual of an autoregressive model of each window without mean, scaled to unit standard deviation.

    The model of the given order (0 scales only) is fitted by Yule-Walker's equations to the spectrum above
    ``lowest_hz``; the level just above replaces the spectrum below, so that drift does not use up the model.
    A linear rig's resonances have minimum phase: the residual is free of their ringing in phase as in
    amplitude. Constant windows become zero.
    """
    n_samples = X.shape[1]
    if order > 0:
        length = next_fast_len(2 * n_samples, real=True)
        power = np.abs(np.fft.rfft(X * _hann_taper(n_samples), length)) ** 2
        frequencies = np.fft.rfftfreq(length, 1 / sampling_rate)
        drifting = frequencies < lowest_hz
        above = ~drifting & (frequencies < 1.25 * lowest_hz)
        power[:, drifting] = power[:, above].mean(axis=1, keepdims=True)
        correlation = np.fft.irfft(power, length)[:, : order + 1]
        residual = np.zeros_like(X)
        for row, (r, x) in enumerate(zip(correlation, X, strict=True)):
            if r[0] > 0:
                # A millionth of white noise keeps the equations well posed where torque has lines only.
                r[0] *= 1 + 1e-6
                coefficients = solve_toeplitz(r[:-1], r[1:])
                residual[row] = lfilter(np.r_[1.0, -coefficients], 1.0, x)
        X = residual
    return ratio(X, X.std(axis=1, keepdims=True))


@dataclass(frozen=True)
class LobeComb:
    """Comb of lobe lines that is fitted to the spectrum of windows.

    ``ar_order`` is that of the autoregressive model that takes out torsional resonances; 0 for none.
    ``speed_tolerance`` is the largest relative deviation of the speed that is searched. ``searched`` are the
    numbers of the lobe lines that the search looks at: by default all from the fifth on, because the brake
    drifts below.
    """

    n_lobes: int = 15
    n_lines: int = N_LINES
    ar_order: int = _AR_ORDER
    speed_tolerance: float = SPEED_TOLERANCE
    searched: Sequence[int] | None = None


def lobe_lines(
    X: Float, sampling_rate: float, input_speed_hz: float, comb: LobeComb | None = None
) -> LobeLines:
    """Fit the lobe lines of each window, at the input speed that suits them best.

    The sampling rate is in Hz (samples per input turn for windows on equal steps of the angle, with
    ``input_speed_hz=1``), the nominal input speed in turns per second. The speed maximises the sum over lobe
    lines of power over local floor, by an exhaustive search: the power of a comb is its likelihood in white
    noise, and the floor keeps a single strong line, such as the mains', from outvoting it. Windows of under
    two lobe periods have lines and floor zero.
    """
    comb = comb or LobeComb()
    n_windows = X.shape[0]
    if n_windows > _BLOCK:
        blocks = (X[first : first + _BLOCK] for first in range(0, n_windows, _BLOCK))
        parts = [lobe_lines(one, sampling_rate, input_speed_hz, comb) for one in blocks]
        return LobeLines(*map(np.concatenate, zip(*parts, strict=True)))
    nominal = lobe_frequency(input_speed_hz, comb.n_lobes)
    if X.shape[1] * nominal < 2 * sampling_rate:
        return LobeLines(
            np.full(n_windows, float(input_speed_hz)),
            np.zeros((n_windows, comb.n_lines), dtype=complex),
            np.zeros((n_windows, comb.n_lines)),
        )
    white = _whitened_spectra(X, sampling_rate, nominal, comb.n_lines, comb.ar_order)
    numbers = np.arange(1, comb.n_lines + 1)
    factor = np.ones(n_windows)
    if comb.speed_tolerance > 0:
        teeth = numbers[min(_FIRST_SEARCHED, comb.n_lines) - 1 :]
        if comb.searched is not None:
            teeth = np.asarray(comb.searched)
        factors = searched_factors(comb.speed_tolerance)
        factor = factors[np.argmax(white.prominence(factors, teeth * nominal).sum(axis=2), axis=1)]
    frequencies = np.outer(factor * nominal, numbers)
    bins = frequencies / white.resolution
    at_centre = np.stack([_between_bins(*row) for row in zip(white.spectrum, bins, strict=True)])
    return LobeLines(
        input_speed_hz=factor * input_speed_hz,
        lines=at_centre * np.exp(-2j * np.pi * frequencies * white.centre),
        floor=np.stack([_between_bins(*row) for row in zip(white.floor, bins, strict=True)]),
    )


def searched_factors(speed_tolerance: float) -> Float:
    """Return the input speeds of a search, as multiples of the nominal one."""
    return np.asarray(1 + speed_tolerance * np.linspace(-1, 1, _SPEED_STEPS))


def comb_prominence(
    X: Float,
    sampling_rate: float,
    input_speed_hz: float,
    factors: Float,
    numbers: NDArray[Any],
    n_lobes: int = 15,
) -> Float:
    """Return the power of lobe lines over the spectrum around each, shape (n_windows, n_factors, n_lines).

    ``factors`` are input speeds as multiples of ``input_speed_hz``, ``numbers`` the lobe lines, counted from
    1, or places between them; other arguments as in :func:`lobe_lines`. Without lines the mean is 1.
    """
    nominal = lobe_frequency(input_speed_hz, n_lobes)
    white = _whitened_spectra(X, sampling_rate, nominal, int(numbers.max()), _AR_ORDER)
    return white.prominence(factors, numbers * nominal)


@dataclass(frozen=True)
class _Whitened:
    """Spectra of whitened windows about their middle."""

    spectrum: Complex
    power: Float
    floor: Float  # local mean of the power
    resolution: float  # Hz from bin to bin
    centre: float  # time of the middle in s

    def prominence(self, factors: Float, frequencies: NDArray[Any]) -> Float:
        """Power over floor, shape (n_windows, n_factors, n_frequencies)."""
        bins = np.outer(factors, frequencies / self.resolution)
        return np.stack([_between_bins(row, bins) for row in ratio(self.power, self.floor)])


def _whitened_spectra(
    X: Float, sampling_rate: float, nominal: float, n_lines: int, ar_order: int
) -> _Whitened:
    reduced, rate = reduce_rate(X, sampling_rate, _RATE_PER_LINE * n_lines * nominal)
    white = prewhiten(reduced, rate, ar_order, lowest_hz=2 * nominal)
    # Padded spectrum of tapered windows about their middle, its resolution in Hz, the middle's time in s.
    n_windows, n_samples = white.shape
    taper = _hann_taper(n_samples)
    tapered = white * (taper * (2 / taper.sum()))
    middle = n_samples // 2
    padded = np.zeros((n_windows, next_fast_len(_PADDING * n_samples, real=True)))
    padded[:, : n_samples - middle] = tapered[:, middle:]
    padded[:, padded.shape[1] - middle :] = tapered[:, :middle]
    spectrum, resolution, centre = np.fft.rfft(padded), rate / padded.shape[1], middle / rate
    power = np.abs(spectrum) ** 2
    floor = uniform_filter1d(power, max(1, round(_FLOOR_WIDTH * nominal / resolution)), axis=1)
    return _Whitened(spectrum, power, floor, resolution, centre)


def _between_bins(values: NDArray[Any], bins: Float) -> NDArray[Any]:
    """Values of a spectrum at fractional bins, by straight lines."""
    left = np.minimum(bins.astype(int), values.size - 2)
    share = bins - left
    return np.asarray(values[left] * (1 - share) + values[left + 1] * share)


def fold(lines: Complex, n_lobes: int = 15, points: int = 16, lowest_line: int = 3) -> Float:
    """Torque folded at the lobe frequency from its lobe lines, shape (n_windows, n_lobes, points).

    Slot 0 begins at the first sample, or where :func:`shift` moved it. Below ``lowest_line`` the brake
    drifts.
    """
    waves = _fold_waves(lowest_line, lines.shape[1], n_lobes * points)
    folded = lines[:, lowest_line - 1 :] @ waves
    return np.ascontiguousarray(folded.real).reshape(len(lines), n_lobes, points)


@functools.lru_cache(maxsize=16)
def _fold_waves(lowest_line: int, highest_line: int, n_points: int) -> Complex:
    """One turn of the fold of each lobe line, shape (n_lines, n_points)."""
    phase = np.outer(np.arange(lowest_line, highest_line + 1), np.arange(n_points) / n_points)
    return _make_read_only(np.exp(2j * np.pi * phase))


def shift(lines: Complex, turns: Float) -> Complex:
    """Lobe lines of the fold begun ``turns`` (shape (n_windows,)) of its period later."""
    return lines * np.exp(2j * np.pi * np.outer(turns, np.arange(1, lines.shape[1] + 1)))


def energy_centre(folded: Float) -> Float:
    """Return the circular mean of the fold's energy in turns, shape (n_windows,)."""
    energy = folded.reshape(len(folded), -1) ** 2
    angle = 2 * np.pi * np.arange(energy.shape[1]) / energy.shape[1]
    return np.asarray(np.angle(energy @ np.exp(1j * angle)) / (2 * np.pi))


def line_prominence(lines: LobeLines) -> Float:
    """Power of each lobe line over the spectrum around it, in dB; -30 where there is no power."""
    return np.asarray(10 * np.log10(ratio(np.abs(lines.lines) ** 2, lines.floor) + _TINY))


def line_contrast(lines: LobeLines) -> Float:
    """Power of each lobe line over the mean of the five lines around it, in dB; -30 without power.

    A rig's resonance raises neighbouring lines alike; what is left is the pattern of the worn lobes, whose
    spectrum is that of a row of z_s slots: n consecutive worn lobes put zeros at multiples of z_s/n.
    """
    power = np.abs(lines.lines) ** 2
    around = uniform_filter1d(power, _CONTRAST_WIDTH, axis=1, mode="nearest")
    return np.asarray(10 * np.log10(ratio(power, around) + _TINY))


def log_ratio(power: Float, shares: tuple[float, ...]) -> Float:
    """Logarithm of the probability of lines' power over their floor, over that of noise."""
    power = np.minimum(power, _MOST)
    mixed = sum(
        share / mean * np.exp(power * (1 - 1 / mean)) for share, mean in zip(shares, _MEANS, strict=True)
    )
    return np.asarray(np.log(mixed))


def sum_to_last_line(ratios: Float) -> Any:
    """Return the log probability ratio over noise of lines from the first to an unknown last one, or none."""
    sums = np.cumsum(ratios, axis=-1)
    return np.logaddexp(0.0, np.logaddexp.reduce(sums, axis=-1)) - np.log(ratios.shape[-1] + 1)


def tell_wear(features: Float, n_lobes: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell of each window whether lines of the mesh alone stand out, and whether lobe lines surely do.

    Where the last line of the mesh or most of them do, noise does not hide lobe lines. A worn disc has those
    of most numbers; a sound one of the mesh and of the output's pins, of which there are six to twelve.
    ``features`` are those of a lobe map.
    """
    prominence = features[:, 2 * n_lobes : features.shape[1] // 2 + n_lobes]
    numbers = np.arange(1, prominence.shape[1] + 1)
    clear = prominence[:, numbers % n_lobes == 0] > _ALONE_DB
    reaches = (clear.sum(axis=1) > max(1, clear.shape[1] / 2)) | clear[:, 1:][:, -1:].any(axis=1)
    ratios = log_ratio(10 ** (prominence / 10), LOBE_LINE)
    others = (numbers >= _FIRST_CLEAR) & (numbers % n_lobes > 0)
    by_pins = [sum_to_last_line(ratios[:, others & (numbers % n_pins > 0)]) for n_pins in OUTPUT_PINS]
    evidence = np.min(by_pins, axis=0)
    return reaches & (evidence < _LEAST_EVIDENCE), evidence > _CLEAR_EVIDENCE
