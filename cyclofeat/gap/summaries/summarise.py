"""Summaries of recordings: the numbers (cells) by which two sets of recordings are compared."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.fft import rfft

from cyclofeat.signal.density import shannon_entropy, spectral_centroid, spectral_flatness, spectral_rolloff
from cyclofeat.signal.lobes import comb_prominence, searched_factors
from cyclofeat.signal.orders import comb_lines, estimate_input_speed
from cyclofeat.signal.wavelets import dwt, level_band
from cyclofeat.signal.welch import welch_psd

Float = NDArray[np.float64]

FAMILIES = (
    "speed", "slow part", "amplitudes", "spectrum", "lobe lines", "shaft lines", "floor", "averages",
    "features",
)  # fmt: skip

_SLOW_HZ = 4.0
# Third-octave bands are centred on 10^(n/10) Hz; the lowest of them has at least 4 bins in one output turn.
_LOWEST_BAND, _HIGHEST_BAND_SHARE = 10, 0.4
_LOBE_LINES, _SHAFT_LINES = 48, 20
_QUANTILES = (0.001, 0.01, 0.1, 0.9, 0.99, 0.999)
_WAVELET, _LEVELS = "db4", 10
SPEED_TOLERANCE = 0.03
_AT_THE_END = 0.99  # share of the tolerance from which a speed counts as at the end of the range
_BINS = 64  # bins of a synchronous average
_PER_PERIOD = 16  # samples in a period that are enough
HANN_POWER = 3 / 8  # mean square of the Hann window
_AT_A_TIME = 16

# Assumption: less than a millinewtonmetre of white noise is no difference. It is added, as a power, to every
# level and moment of both sides, and lies far above the difference between two integrators.
RESOLUTION_NM = 1e-3

# Assumption: smaller differences have no consequence. Added in quadrature to the spread of a cell.
_SMALLEST_SPREAD = {"dB": 0.1, "Nm": 0.01, "%": 0.02, "bit": 0.01, "1": 0.02}


@dataclass(frozen=True)
class Cell:
    """Number that is compared: name, unique within its family (of ``FAMILIES``), and unit.

    ``low_hz`` and ``high_hz`` limit the band that it describes (NaN: none), orders at the nominal speed.
    """

    family: str
    name: str
    unit: str
    low_hz: float = np.nan
    high_hz: float = np.nan


Columns = list[tuple[Cell, Float]]
"""Cells, each with its value in all recordings."""


def as_table(columns: Columns) -> tuple[Float, list[Cell]]:
    """Return the values of columns, (n_recordings, n_cells), and their cells."""
    return np.column_stack([values for _, values in columns]), [cell for cell, _ in columns]


@dataclass(frozen=True)
class Kinematics:
    """Sampling rate in Hz, nominal input speed in Hz and lobes of a wheel, which is also the reduction."""

    sampling_rate: float
    input_speed_hz: float
    n_lobes: int = 15

    def whole_turns(self, n_samples: int) -> int:
        """Samples of a window in its whole output turns at the nominal speed; ValueError without one."""
        turn, duration = self.n_lobes / self.input_speed_hz, n_samples / self.sampling_rate
        whole = math.floor(duration / turn + 0.01)
        if whole < 1:
            raise ValueError(
                f"X must hold windows of at least one output turn ({turn:.3g} s), got {duration:.3g} s"
            )
        return min(round(whole * turn * self.sampling_rate), n_samples)


def summarise_windows(
    X: NDArray[Any], kinematics: Kinematics, speeds: NDArray[Any] | None = None
) -> tuple[Float, list[Cell]]:
    """Summarise windows of torque in Nm (n_windows, n_samples), of at least one output turn each.

    ``speeds`` (n_windows,) are mean input speeds in Hz by a tachometer, by default from the mesh lines;
    orders are multiples of them. Returns values (n_windows, n_cells), and their cells, in families: the input
    speed; the part below 4 Hz; the distribution of amplitudes; third-octave levels; the lobe lines (16/15 of
    the input speed and its multiples) relative to the floor around them; the lines of the input shaft
    relative to theirs; that floor; averages synchronous with the input shaft and with the lobes, and the
    residual without them; and spectral and wavelet features.

    Left out are lines above the Nyquist frequency at 3 % above the nominal speed, lines without a floor
    (those of few lobes lie close together), and third octaves without a bin. Levels are in dB of Nm^2. The
    expected value of white noise of 1 mNm rms is added to every level and moment: a smaller difference is no
    difference on any torque meter (an assumption).
    """
    kinematics.whole_turns(np.shape(X)[1])
    given = None if speeds is None else np.asarray(speeds, dtype=float)
    rate, nominal_hz, n_lobes = kinematics.sampling_rate, kinematics.input_speed_hz, kinematics.n_lobes
    values: list[Float] = []
    cells: list[Cell] = []
    # A few windows at a time: a bank of recordings is large.
    for start in range(0, len(X), _AT_A_TIME):
        part = slice(start, start + _AT_A_TIME)
        torque = np.asarray(X[part], dtype=np.float64)
        by_mesh = speeds_by_mesh(torque, rate, nominal_hz, n_lobes)
        of_window = by_mesh if given is None else given[part]
        speed_ratios = {"input speed by the mesh lines": by_mesh / nominal_hz}
        if given is not None:
            speed_ratios["input speed by the tachometer"] = of_window / nominal_hz
            speed_ratios["mesh lines against the tachometer"] = by_mesh / of_window
        mean = torque.mean(axis=1, keepdims=True)
        ripple = torque - mean
        lines = rfft(ripple, axis=1)
        columns = [(Cell("speed", name, "%"), 100 * (ratio - 1)) for name, ratio in speed_ratios.items()]
        columns += _slow_cells(ripple, lines, rate)
        columns += _amplitude_cells(torque, ripple, mean[:, 0])
        columns += _band_cells(lines, ripple.shape[1], rate)
        columns += _order_cells(ripple, rate, of_window, nominal_hz, n_lobes)
        columns += _average_cells(ripple, rate, of_window, n_lobes)
        columns += _feature_cells(torque, ripple, rate)
        of_part, cells = as_table(columns)
        values.append(of_part)
    return np.vstack(values), cells


def smallest_spreads(cells: list[Cell]) -> Float:
    """Smallest spread of one recording that matters, for each cell, shape (n_cells,)."""
    return np.array([_SMALLEST_SPREAD[cell.unit] for cell in cells])


def level_db(power: Float) -> Float:
    """Power in Nm^2 as a level in dB."""
    return np.asarray(10 * np.log10(power))


def speeds_by_mesh(torque: Float, sampling_rate: float, nominal_hz: float, n_lobes: int) -> Float:
    """Input speed of each window in Hz, by the mesh lines."""
    speeds = estimate_input_speed(
        torque, sampling_rate, nominal_hz, SPEED_TOLERANCE, comb="mesh", n_lobes=n_lobes
    )
    at_the_end = np.flatnonzero(np.abs(speeds / nominal_hz - 1) > _AT_THE_END * SPEED_TOLERANCE)
    if not at_the_end.size:
        return speeds
    # It may be the flank of a lobe line beside one mesh line. The other mesh lines are then missing.
    factors = searched_factors(SPEED_TOLERANCE)
    n_lines = comb_lines(sampling_rate, nominal_hz, SPEED_TOLERANCE, "mesh", n_lobes)
    numbers = np.arange(n_lobes, n_lines + 1, n_lobes)
    combs = comb_prominence(torque[at_the_end], sampling_rate, nominal_hz, factors, numbers, n_lobes)
    for i, lines in zip(at_the_end, combs, strict=True):
        prominence = lines.sum(axis=1)
        within = signal.argrelmax(prominence)[0]
        if within.size and lines[np.argmax(prominence)].min() < 1:
            speeds[i] = factors[within[np.argmax(prominence[within])]] * nominal_hz
    return speeds


def block_means(X: NDArray[Any], sampling_rate: float, highest_hz: float) -> tuple[NDArray[Any], float]:
    """Return means of as many samples as leave 16 in a period of the highest frequency, and their rate in Hz.

    At that frequency they are 0.6 % smaller; what lies at the new rate less it keeps a fifteenth.
    """
    n = max(int(sampling_rate / (_PER_PERIOD * highest_hz)), 1)
    return box_means(X, n), sampling_rate / n


def box_means(X: NDArray[Any], n: int) -> NDArray[Any]:
    """Return the means of ``n`` samples each; those that fill no box are left out."""
    boxes = X[:, : X.shape[1] // n * n].reshape(-1, n)
    # A product takes a fraction of the time of the means of short rows.
    return np.asarray(boxes @ np.full(n, 1 / n, dtype=X.dtype)).reshape(len(X), -1)


def hann_lines(lines: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the transform of windows under a periodic Hann window: a sum over neighbouring lines."""
    under = 0.5 * lines  # a quotient of complex numbers takes several times as long
    under[:, 1:-1] -= 0.25 * (lines[:, 2:] + lines[:, :-2])
    return under


def _slow_cells(ripple: Float, lines: NDArray[np.complex128], sampling_rate: float) -> Columns:
    n = ripple.shape[1]
    time = (np.arange(n) - (n - 1) / 2) / n
    trend = ripple @ time / (time @ time)
    kept = max(int(np.ceil(_SLOW_HZ * n / sampling_rate)), 2)
    power = 2 * np.sum(np.abs(lines[:, 1:kept]) ** 2, axis=1) / n**2
    powers = {
        f"level below {_SLOW_HZ:g} Hz": power + 2 * (kept - 1) * RESOLUTION_NM**2 / n,
        "size of the trend over the window": trend**2 + RESOLUTION_NM**2 / (time @ time),
    }
    return [(Cell("slow part", name, "dB", 0.0, _SLOW_HZ), level_db(p)) for name, p in powers.items()]


def _amplitude_cells(X: Float, ripple: Float, mean: Float) -> Columns:
    # Single precision, as torque is recorded: it is sorted in half the time.
    ordered = np.sort(X.astype(np.float32), axis=1)
    squares = ripple**2  # products: other powers of arrays take ten times as long
    square = squares.mean(axis=1)
    variance = square + RESOLUTION_NM**2
    cubes, fourths = np.mean(squares * ripple, axis=1), np.mean(squares**2, axis=1)
    at = np.round(np.array(_QUANTILES) * (X.shape[1] - 1)).astype(int)
    quantiles = (ordered[:, at] - mean[:, None]) / np.sqrt(variance)[:, None]
    distinct = 1 - np.mean(np.diff(ordered, axis=1) == 0, axis=1)
    # Cumulants: independent Gaussian noise does not change those above the second.
    excess = (fourths - 3 * square**2) / variance**2
    plain = {"skewness": cubes / variance**1.5, "excess kurtosis": signed_log(excess)}
    plain |= {f"quantile {q:g} over std": x for q, x in zip(_QUANTILES, quantiles.T, strict=True)}
    plain |= {"share of distinct values": distinct}
    return [
        (Cell("amplitudes", "mean", "Nm"), mean),
        (Cell("amplitudes", "level of the ripple", "dB"), level_db(variance)),
        *((Cell("amplitudes", name, "1"), x) for name, x in plain.items()),
    ]


def signed_log(values: Float) -> Float:
    """Logarithm that keeps the sign, sign(x) log(1 + |x|), for values that range over orders of magnitude."""
    return np.asarray(np.sign(values) * np.log1p(np.abs(values)))


def _band_cells(lines: NDArray[np.complex128], n_samples: int, sampling_rate: float) -> Columns:
    frequencies = np.fft.rfftfreq(n_samples, 1 / sampling_rate)
    last = int(np.floor(10 * np.log10(_HIGHEST_BAND_SHARE * sampling_rate) - 0.5))
    edges = [10 ** ((band - 0.5) / 10) for band in range(_LOWEST_BAND, last + 2)]
    at = np.searchsorted(frequencies, edges).tolist()
    under = hann_lines(lines[:, : at[-1] + 1])[:, : at[-1]]
    psd = 2 * np.abs(under) ** 2 / (sampling_rate * n_samples * HANN_POWER) + _white_density(sampling_rate)
    columns = []
    for k, band in enumerate(range(_LOWEST_BAND, last + 1)):
        inside = psd[:, np.arange(at[k], at[k + 1])]
        if inside.size:  # else the windows are too short for the band
            name = f"third octave at {10 ** (band / 10):.3g} Hz"
            power = inside.sum(axis=1) * (frequencies[1] - frequencies[0])
            columns.append((Cell("spectrum", name, "dB", edges[k], edges[k + 1]), level_db(power)))
    return columns


def _white_density(sampling_rate: float) -> float:
    """One-sided power spectral density of white noise of the resolution, in Nm^2/Hz."""
    return 2 * RESOLUTION_NM**2 / sampling_rate


def _order_cells(
    ripple: Float, sampling_rate: float, speeds: Float, nominal_hz: float, n_lobes: int
) -> Columns:
    """Lines of lobes and shaft over their floor, and that floor.

    Windows are cut to one output turn at their own speed and transformed at multiples of the output speed.
    """
    # Lines below the Nyquist frequency at the highest speed: the same cells for all recordings.
    below_nyquist = int(n_lobes * sampling_rate / 2 / (nominal_hz * (1 + SPEED_TOLERANCE))) + 1
    n_bins = min((n_lobes + 1) * (_LOBE_LINES + 1), below_nyquist)
    ripple, sampling_rate = block_means(ripple, sampling_rate, n_bins / n_lobes * nominal_hz)
    of_windows = zip(ripple, speeds, strict=True)
    power = np.array([_lines_of_a_turn(x, sampling_rate, speed, n_lobes, n_bins) for x, speed in of_windows])
    per_line, reach = n_lobes + 1, (n_lobes + 1) // 2  # bins from one line of the lobe comb to the next
    bins = per_line * np.arange(1, _LOBE_LINES + 1)
    bins, levels, floors = _levels_over_floor(power, bins, np.r_[-reach:-2, 3 : reach + 1], n_lobes)
    cells, floor_cells = [], []
    for at in bins.tolist():
        order, half = at / n_lobes, per_line / 2 / n_lobes * nominal_hz
        band = order * nominal_hz - half, order * nominal_hz + half
        cells.append(Cell("lobe lines", f"lobe line {at // per_line} (order {order:.3g})", "dB", *band))
        floor_cells.append(Cell("floor", f"around order {order:.3g}", "dB", *band))
    bins = n_lobes * np.arange(1, _SHAFT_LINES + 1)
    bins = bins[bins % per_line > 0]
    bins, of_shaft, _ = _levels_over_floor(power, bins, np.r_[-6:-2, 3:7], per_line)
    for turn in (bins // n_lobes).tolist():
        hz, half = turn * nominal_hz, nominal_hz / 2
        cells.append(Cell("shaft lines", f"input order {turn}", "dB", hz - half, hz + half))
    values = np.hstack([levels, of_shaft, floors])
    return [*zip(cells + floor_cells, values.T, strict=True)]


def _levels_over_floor(
    power: Float, bins: NDArray[np.intp], offsets: NDArray[np.intp], period: int
) -> tuple[NDArray[np.intp], Float, Float]:
    """Return those of the bins that have a floor, their levels over it, and its level, in dB.

    The floor is the median of the bins at the offsets, but for those at or beside multiples of ``period``.
    """
    near = bins[:, np.newaxis] + offsets
    usable = (near > 2) & (near % period > 1) & (period - near % period > 1)
    known = usable.any(axis=1) & (near.max(axis=1, initial=0) < power.shape[1])
    bins, usable = bins[known], usable[known]
    # All medians at once; infinity stands for the bins that are left out.
    around = np.sort(np.where(usable, power[:, near[known]], np.inf), axis=2)
    lines, n_usable = np.arange(bins.size), usable.sum(axis=1)
    floor = level_db((around[:, lines, (n_usable - 1) // 2] + around[:, lines, n_usable // 2]) / 2)
    return bins, level_db(power[:, bins]) - floor, floor


def _lines_of_a_turn(x: Float, sampling_rate: float, speed: float, n_lobes: int, n_bins: int) -> Float:
    """Power at the multiples of 1/n_lobes of the input's speed, shape (n_bins,), in Nm^2."""
    n_turn = n_lobes / speed * sampling_rate
    n_cut = min(round(n_turn), x.size)
    piece = x[:n_cut] - x[:n_cut].mean()
    if n_cut < round(n_turn) or n_bins >= n_cut // 2 + 1:
        # The window is shorter than the turn, so that its bins miss the multiples; or the speed is above the
        # searched range, and the last multiples lie above the Nyquist frequency.
        piece *= signal.windows.hann(n_cut, sym=False)
        lines = signal.czt(piece, n_bins, np.exp(-2j * np.pi / n_turn))
    else:
        # Rounded to whole samples: the highest line is less than 0.03 of a bin from its multiple.
        lines = hann_lines(rfft(piece)[None, : n_bins + 1])[0, :n_bins]
    power = 2 * np.abs(lines) ** 2 / n_cut**2 / HANN_POWER
    return np.asarray(power + 2 * RESOLUTION_NM**2 / n_cut)


def _average_cells(ripple: Float, sampling_rate: float, speeds: Float, n_lobes: int) -> Columns:
    """Level and crest of the averages over input turns and over lobes, and level of the residual."""
    columns: Columns = []
    for by, per_turn in (("input turns", 1.0), ("lobes", (n_lobes + 1) / n_lobes)):
        powers = []
        for x, speed in zip(ripple, speeds, strict=True):
            average, slot, n = synchronous_average(x, speed * per_turn / sampling_rate, _BINS)
            # Mean square less squared mean: what the average leaves in each bin.
            left = np.bincount(slot, x**2, _BINS) - n * average**2
            spread = left / np.maximum(n, 1)
            of_average = np.array([np.mean(average**2), np.max(average**2)])
            of_rest = np.array([left.sum() / x.size, spread.max(), spread.min()])
            resolution = RESOLUTION_NM**2
            powers.append(np.r_[of_average + resolution * _BINS / x.size, of_rest + resolution])
        level, highest, rest, most, least = level_db(np.transpose(powers))
        levels = {
            "level of the average over": level, "crest of the average over": highest - level,
            "level left by the average over": rest, "unevenness left over": most - least,
        }  # fmt: skip
        columns += [(Cell("averages", f"{name} {by}", "dB"), values) for name, values in levels.items()]
    return columns


def synchronous_average(
    x: Float, turns_per_sample: float, n_bins: int
) -> tuple[Float, NDArray[np.intp], NDArray[np.intp]]:
    """Mean of a signal in each bin of the turn (0 in an empty one), bin of each sample, samples in each."""
    slots = (np.arange(x.size) * (turns_per_sample * n_bins)).astype(np.intp)
    slots -= slots // n_bins * n_bins  # the remainder, in a fraction of its time
    n = np.bincount(slots, minlength=n_bins)
    return np.bincount(slots, x, minlength=n_bins) / np.maximum(n, 1), slots, n


def _feature_cells(X: Float, ripple: Float, sampling_rate: float) -> Columns:
    columns = []
    for preset in ("matlab_pwelch", "ripple"):
        frequencies, psd = welch_psd(X, sampling_rate, preset)
        psd = psd + _white_density(sampling_rate)
        entropy = shannon_entropy(psd, frequencies)
        columns.append((Cell("features", f"Shannon entropy ({preset})", "bit"), entropy))
    shapes = {
        "spectral flatness": spectral_flatness(psd, frequencies),
        "spectral centroid": spectral_centroid(psd, frequencies),
        "roll-off": spectral_rolloff(psd, frequencies),
    }
    columns += [(Cell("features", name, "dB"), level_db(shape)) for name, shape in shapes.items()]
    details = dwt(ripple, _WAVELET, _LEVELS)
    for number, coefficients in enumerate(details[:-1], start=1):
        low, high = level_band(number, sampling_rate)
        around = coefficients - coefficients.mean(axis=1, keepdims=True)
        squares = around**2
        square, fourth = np.mean(squares, axis=1), np.mean(squares**2, axis=1)
        excess = (fourth - 3 * square**2) / (square + RESOLUTION_NM**2) ** 2
        cell = Cell("features", f"kurtosis of wavelet level {number}", "1", low, high)
        columns.append((cell, signed_log(excess)))
    return columns
