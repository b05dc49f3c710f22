"""What two sets of recordings are compared by: numbers per recording, in families of cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal, stats

from cyclofeat._density import shannon_entropy, spectral_centroid, spectral_flatness, spectral_rolloff
from cyclofeat._welch import welch_psd
from cyclofeat.orders import estimate_input_speed
from cyclofeat.wavelets import dwt, level_band

Float = NDArray[np.float64]

FAMILIES = (
    "slow part", "amplitudes", "spectrum", "lobe lines", "shaft lines", "floor", "averages", "features",
)  # fmt: skip

_SLOW_HZ = 4.0
# Third-octave bands are centred on 10^(n/10) Hz; the lowest of them has at least 4 bins in one output turn.
_LOWEST_BAND, _HIGHEST_BAND_SHARE = 10, 0.4
_LOBE_LINES, _SHAFT_LINES = 48, 20
_QUANTILES = (0.001, 0.01, 0.1, 0.9, 0.99, 0.999)
_POWER_FLOOR = 1e-12  # Nm^2: a microNewtonmetre, below anything that a torque meter resolves
_WAVELET, _LEVELS = "db4", 10


@dataclass(frozen=True)
class Cell:
    """One number that is compared.

    Parameters
    ----------
    family : str
        One of ``FAMILIES``.
    name : str
        What it is, unique within the family.
    unit : str
        ``"dB"``, ``"Nm"``, ``"bit"`` or ``"1"``.
    low_hz, high_hz : float
        Band that it describes, in Hz; NaN where it has none. Orders are stated at the nominal speed.
    """

    family: str
    name: str
    unit: str
    low_hz: float = np.nan
    high_hz: float = np.nan


def summarise(
    X: NDArray[Any], sampling_rate: float, input_speed_hz: float, n_lobes: int = 15
) -> tuple[Float, list[Cell]]:
    """Summaries of windows of torque.

    Parameters
    ----------
    X : ndarray, shape (n_windows, n_samples)
        Torque in Nm, at least one output turn each.
    sampling_rate : float
        In Hz.
    input_speed_hz : float
        Nominal input speed; each window's own is refined from its mesh lines, and all orders are of that.
    n_lobes : int
        Lobes of a wheel, which is also the reduction.

    Returns
    -------
    values : ndarray, shape (n_windows, n_cells)
    cells : list of Cell

    Raises
    ------
    ValueError
        If a window is shorter than one output turn, in which lobes and shaft come apart.

    Notes
    -----
    Families: the part below 4 Hz (rms, trend); the distribution of amplitudes (mean, std, skewness,
    excess kurtosis, standardised quantiles, share of distinct values, which steps of a converter lower);
    third-octave levels; the lines of the lobe comb (16/15 of the input speed and its multiples) over the
    floor around them; the lines of the input shaft over theirs; that floor; the averages synchronous with
    the input's turn and with the lobes, and what they leave; and features that the toolkit counts by.
    Levels are in dB of Nm^2.
    """
    torque: Float = np.asarray(X, dtype=np.float64)
    n = torque.shape[1]
    turn = n_lobes / input_speed_hz
    if n / sampling_rate < 0.99 * turn:
        raise ValueError(
            f"X must hold windows of at least one output turn ({turn:.3g} s), got {n / sampling_rate:.3g} s"
        )
    speeds = estimate_input_speed(torque, sampling_rate, input_speed_hz, comb="mesh", n_lobes=n_lobes)
    mean = torque.mean(axis=1, keepdims=True)
    ripple = torque - mean
    parts = [
        _slow(ripple, sampling_rate),
        _amplitudes(torque, ripple, mean[:, 0]),
        _bands(ripple, sampling_rate),
        _orders(ripple, sampling_rate, speeds, input_speed_hz, n_lobes),
        _averages(ripple, sampling_rate, speeds, input_speed_hz, n_lobes),
        _features(torque, sampling_rate),
    ]
    return np.hstack([values for values, _ in parts]), [cell for _, cells in parts for cell in cells]


def level(power: Float) -> Float:
    """Power in Nm^2 as a level in dB, bounded below."""
    return 10 * np.log10(np.maximum(power, _POWER_FLOOR))


def _slow(ripple: Float, sampling_rate: float) -> tuple[Float, list[Cell]]:
    n = ripple.shape[1]
    time = (np.arange(n) - (n - 1) / 2) / n
    trend = ripple @ time / (time @ time)
    kept = max(int(np.ceil(_SLOW_HZ * n / sampling_rate)), 2)
    power = 2 * np.sum(np.abs(np.fft.rfft(ripple, axis=1)[:, 1:kept]) ** 2, axis=1) / n**2
    cells = [
        Cell("slow part", f"level below {_SLOW_HZ:g} Hz", "dB", 0.0, _SLOW_HZ),
        Cell("slow part", "size of the trend over the window", "dB", 0.0, _SLOW_HZ),
    ]
    return np.column_stack([level(power), level(trend**2)]), cells


def _amplitudes(X: Float, ripple: Float, mean: Float) -> tuple[Float, list[Cell]]:
    std = ripple.std(axis=1)
    scaled = ripple / np.maximum(std, 1e-9)[:, None]
    quantiles = np.quantile(scaled, _QUANTILES, axis=1).T
    distinct = np.array([np.unique(x).size for x in X]) / X.shape[1]
    columns = [mean, level(std**2), stats.skew(ripple, axis=1), stats.kurtosis(ripple, axis=1)]
    names = [("mean", "Nm"), ("level of the ripple", "dB"), ("skewness", "1"), ("excess kurtosis", "1")]
    names += [(f"quantile {q:g} over std", "1") for q in _QUANTILES]
    names += [("share of distinct values", "1")]
    values = np.column_stack([*columns, quantiles, distinct])
    # A window without ripple has no shape.
    return np.nan_to_num(values, nan=0.0), [Cell("amplitudes", name, unit) for name, unit in names]


def _bands(ripple: Float, sampling_rate: float) -> tuple[Float, list[Cell]]:
    frequencies, psd = signal.periodogram(ripple, sampling_rate, window="hann", detrend=False, axis=1)
    last = int(np.floor(10 * np.log10(_HIGHEST_BAND_SHARE * sampling_rate) - 0.5))
    columns, cells = [], []
    for band in range(_LOWEST_BAND, last + 1):
        low, high = 10 ** ((band - 0.5) / 10), 10 ** ((band + 0.5) / 10)
        inside = (frequencies >= low) & (frequencies < high)
        columns.append(level(psd[:, inside].sum(axis=1) * (frequencies[1] - frequencies[0])))
        cells.append(Cell("spectrum", f"third octave at {10 ** (band / 10):.3g} Hz", "dB", low, high))
    return np.column_stack(columns), cells


def _orders(
    ripple: Float, sampling_rate: float, speeds: Float, nominal_hz: float, n_lobes: int
) -> tuple[Float, list[Cell]]:
    """Lines of lobes and shaft over their floor, and that floor.

    Every window is cut to one output turn of its own speed and transformed at exactly the multiples of
    1/n_lobes of it, with a Hann window over two such lines.
    """
    n_bins = (n_lobes + 1) * (_LOBE_LINES + 1)
    power = np.array(
        [
            _lines_of_a_turn(x, sampling_rate, speed, n_lobes, n_bins)
            for x, speed in zip(ripple, speeds, strict=True)
        ]
    )
    per_line = n_lobes + 1  # bins from one line of the lobe comb to the next
    columns, cells, floors, floor_cells = [], [], [], []
    for line in range(1, _LOBE_LINES + 1):
        at = line * per_line
        near = np.r_[at - per_line // 2 : at - 2, at + 3 : at + per_line // 2 + 1]
        # Multiples of the input's own speed are lines too.
        near = near[near % n_lobes > 1]
        near = near[(n_lobes - near % n_lobes) > 1]
        floor = np.median(power[:, near], axis=1)
        hz, half = at / n_lobes * nominal_hz, per_line / 2 / n_lobes * nominal_hz
        order = f"order {at / n_lobes:.3g}"
        columns.append(level(power[:, at]) - level(floor))
        cells.append(Cell("lobe lines", f"lobe line {line} ({order})", "dB", hz - half, hz + half))
        floors.append(level(floor))
        floor_cells.append(Cell("floor", f"around {order}", "dB", hz - half, hz + half))
    for turn in range(1, _SHAFT_LINES + 1):
        at = turn * n_lobes
        if at % per_line == 0:
            continue
        near = np.r_[at - 6 : at - 2, at + 3 : at + 7]
        near = near[(near > 2) & (near % per_line > 1) & ((per_line - near % per_line) > 1)]
        hz, half = turn * nominal_hz, nominal_hz / 2
        columns.append(level(power[:, at]) - level(np.median(power[:, near], axis=1)))
        cells.append(Cell("shaft lines", f"input order {turn}", "dB", hz - half, hz + half))
    return np.column_stack([*columns, *floors]), cells + floor_cells


def _lines_of_a_turn(x: Float, sampling_rate: float, speed: float, n_lobes: int, n_bins: int) -> Float:
    """Power at the multiples of 1/n_lobes of the input's speed, shape (n_bins,), in Nm^2."""
    n_cut = min(round(n_lobes / speed * sampling_rate), x.size)
    piece = x[:n_cut] - x[:n_cut].mean()
    # A turn is hardly ever a whole number of samples: the transform is taken at the exact lines.
    spacing = speed / n_lobes / sampling_rate
    weighted = piece * signal.windows.hann(n_cut, sym=False)
    lines = signal.zoom_fft(weighted, [0, n_bins * spacing * 2], m=n_bins, fs=2, endpoint=False)
    return np.asarray(8 / 3 * 2 * np.abs(lines) ** 2 / n_cut**2)


def _averages(
    ripple: Float, sampling_rate: float, speeds: Float, nominal_hz: float, n_lobes: int
) -> tuple[Float, list[Cell]]:
    """Level of the averages over input turns and over lobes, their crest, and what they leave."""
    bins = 64
    columns = []
    for per_turn in (1.0, (n_lobes + 1) / n_lobes):
        found = []
        for x, speed in zip(ripple, speeds, strict=True):
            phase = (np.arange(x.size) * (speed * per_turn / sampling_rate)) % 1.0
            slot = np.minimum((phase * bins).astype(int), bins - 1)
            count = np.bincount(slot, minlength=bins)
            average = np.bincount(slot, x, minlength=bins) / np.maximum(count, 1)
            left = x - average[slot]
            spread = np.bincount(slot, left**2, minlength=bins) / np.maximum(count, 1)
            powers = [np.mean(average**2), np.max(average**2), np.mean(left**2), spread.max(), spread.min()]
            found.append(powers)
        power = np.array(found)
        columns += [level(power[:, 0]), level(power[:, 1]) - level(power[:, 0]), level(power[:, 2])]
        columns += [level(power[:, 3]) - level(power[:, 4])]
    names = ("level of the average over", "crest of the average over", "level left by the average over",
             "unevenness left over")  # fmt: skip
    cells = [Cell("averages", f"{name} {by}", "dB") for by in ("input turns", "lobes") for name in names]
    return np.column_stack(columns), cells


def _features(X: Float, sampling_rate: float) -> tuple[Float, list[Cell]]:
    columns, cells = [], []
    for preset in ("matlab_pwelch", "ripple"):
        frequencies, psd = welch_psd(X, sampling_rate, preset)
        columns.append(shannon_entropy(psd, frequencies))
        cells.append(Cell("features", f"Shannon entropy ({preset})", "bit"))
    columns += [
        10 * np.log10(np.maximum(spectral_flatness(psd, frequencies), 1e-12)),
        10 * np.log10(np.maximum(spectral_centroid(psd, frequencies), 1e-3)),
        10 * np.log10(np.maximum(spectral_rolloff(psd, frequencies), 1e-3)),
    ]
    cells += [Cell("features", name, "dB") for name in ("spectral flatness", "spectral centroid", "roll-off")]
    details = dwt(X - X.mean(axis=1, keepdims=True), _WAVELET, _LEVELS)
    for number, coefficients in enumerate(details[:-1], start=1):
        low, high = level_band(number, sampling_rate)
        columns.append(stats.kurtosis(coefficients, axis=1))
        cells.append(Cell("features", f"kurtosis of wavelet level {number}", "1", low, high))
    return np.nan_to_num(np.column_stack(columns), nan=0.0), cells
