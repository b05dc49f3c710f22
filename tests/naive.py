"""Brute-force oracles: the formulas, written out sample by sample, for small windows only.

Nothing here shares code with the package, and nothing here is fast.
"""

import cmath
import math
from collections.abc import Callable, Sequence
from typing import TypeAlias

Floats: TypeAlias = Sequence[float]


def hamming_symmetric(n: int) -> list[float]:
    """MATLAB's ``hamming(n)``."""
    return [0.54 - 0.46 * math.cos(2 * math.pi * k / (n - 1)) for k in range(n)] if n > 1 else [1.0]


def hann_periodic(n: int) -> list[float]:
    """MATLAB's ``hann(n, 'periodic')``."""
    return [0.5 - 0.5 * math.cos(2 * math.pi * k / n) for k in range(n)] if n > 1 else [1.0]


def transform(x: Sequence[complex], step: float) -> complex:
    """Sum of the samples times exp(-i step k)."""
    return sum(value * cmath.exp(-1j * step * k) for k, value in enumerate(x))


def power(x: Sequence[complex], n_fft: int, line: int) -> float:
    """Squared modulus of one line of the discrete Fourier transform of ``x``, padded to ``n_fft``."""
    return abs(transform(x, 2 * math.pi * line / n_fft)) ** 2


def product(x: Sequence[complex], weights: Floats) -> list[complex]:
    return [value * weight for value, weight in zip(x, weights, strict=True)]


def segments(x: Floats) -> tuple[list[list[float]], int]:
    """Half-overlapping segments of floor(n / 4.5) samples, and the length to which they are padded."""
    length = max(1, math.floor(len(x) / 4.5))
    n_fft = 256
    while n_fft < length:
        n_fft *= 2
    starts = range(0, len(x) - length + 1, length - math.floor(length / 2))
    return [[float(value) for value in x[start : start + length]] for start in starts], n_fft


def welch_psd(
    x: Floats, sampling_rate: float, preset: str = "matlab_pwelch"
) -> tuple[list[float], list[float]]:
    """Frequencies in Hz and one-sided density of one window, segment by segment and line by line."""
    pieces, n_fft = segments(x)
    window = {"matlab_pwelch": hamming_symmetric, "ripple": hann_periodic}[preset](len(pieces[0]))
    if preset == "ripple":
        means = [math.fsum(piece) / len(piece) for piece in pieces]
        pieces = [[value - mean for value in piece] for piece, mean in zip(pieces, means, strict=True)]
    norm = sampling_rate * math.fsum(weight**2 for weight in window) * len(pieces)
    frequencies, psd = [], []
    for line in range(n_fft // 2 + 1):
        sides = 1 if line in (0, n_fft // 2) else 2
        frequencies.append(line * sampling_rate / n_fft)
        psd.append(sides * math.fsum(power(product(piece, window), n_fft, line) for piece in pieces) / norm)
    return frequencies, psd


def shannon_entropy(psd: Floats) -> float:
    """Entropy in bits (paper A eq. 8)."""
    total = math.fsum(psd)
    return -math.fsum(p / total * math.log2(p / total) for p in psd if p > 0)


def normalized_entropy(psd: Floats, epsilon: float = 2.0**-52) -> float:
    """Normalized entropy (paper A eq. 4-7)."""
    total = math.fsum(psd)
    entropy = -math.fsum(p / total * math.log2(p / total + epsilon) for p in psd)
    return entropy / math.log2(len(psd))


def binary_entropy(a: float) -> float:
    """Entropy in bits of two outcomes with the probabilities a and 1 - a."""
    return -a * math.log2(a) - (1 - a) * math.log2(1 - a)


def synchronous_average(x: Floats, samples_per_period: int) -> list[float]:
    """Mean over whole periods, sample by sample."""
    n_periods = len(x) // samples_per_period
    return [
        sum(x[period * samples_per_period + k] for period in range(n_periods)) / n_periods
        for k in range(samples_per_period)
    ]


def dwt_step(x: Floats, taps: Floats) -> list[float]:
    """One step of the discrete wavelet transform, half-sample symmetric at the ends, tap by tap."""
    n, period = len(x), 2 * len(x)
    result = []
    for i in range((n + len(taps) - 1) // 2):
        places = [(2 * i + 1 - tap) % period for tap in range(len(taps))]
        result.append(
            math.fsum(
                h * x[place if place < n else period - 1 - place]
                for h, place in zip(taps, places, strict=True)
            )
        )
    return result


def dwt_details(x: Floats, low: Floats, high: Floats, levels: int) -> list[list[float]]:
    """Details of level 1, 2, ... with the decomposition filters ``low`` and ``high``."""
    details, approximation = [], [float(value) for value in x]
    for _ in range(levels):
        details.append(dwt_step(approximation, high))
        approximation = dwt_step(approximation, low)
    return details


def cells(detail: Floats, level: int, n: int) -> list[float]:
    """Each coefficient repeated 2^level times, and the middle n of them; what is below sqrt(eps) is 0."""
    repeated = [value for value in detail for _ in range(2**level)]
    first = (len(repeated) - n) // 2
    return [value if abs(value) >= 2.0**-26 else 0.0 for value in repeated[first : first + n]]


def colours(row: Floats, n_colours: int) -> list[int]:
    """MATLAB's ``wcodemat(row, n_colours, 'row')``."""
    sizes = [abs(value) for value in row]
    low = min(sizes)
    span = max(size - low for size in sizes)
    if span < 2.0**-52:
        return [1] * len(sizes)
    return [min(1 + math.floor(n_colours * ((size - low) / span)), n_colours) for size in sizes]


def level_envelope(
    detail: Floats, taps_low: Floats, taps_high: Floats, steps: int, n: int, whole: bool
) -> list[float]:
    """Envelope of a level after so many inverse steps with the reconstruction filters.

    Of n values: the first if the window as a ``whole`` is reached, else those in the middle.
    """
    signal = [float(value) for value in detail]
    for taps in [taps_high, *[taps_low] * (steps - 1)]:
        full = [0.0] * (2 * len(signal) + len(taps) - 2)
        for i, value in enumerate(signal):
            for tap, h in enumerate(taps):
                full[2 * i + tap] += h * value
        # The ends that lack part of their terms go.
        signal = full[len(taps) - 2 : 2 * len(signal)]
    first = 0 if whole else (len(signal) - n) // 2
    signal = signal[first : first + n]
    lines = [transform(signal, 2 * math.pi * line / n) for line in range(n)]
    # The analytic signal: negative frequencies go, positive ones count twice.
    weights = [1 if line in (0, n / 2) else 2 if line < n / 2 else 0 for line in range(n)]
    return [abs(transform(product(lines, weights), -2 * math.pi * k / n)) / n for k in range(n)]


def narrowband_lines(
    frequencies: Floats, fundamental: float, half_width: float, n_harmonics: int
) -> set[int]:
    """Lines around harmonics, harmonic by harmonic: those within the width, and the nearest."""
    lines = set()
    for number in range(1, n_harmonics + 1):
        distance = [abs(f - number * fundamental) for f in frequencies]
        lines |= {i for i, d in enumerate(distance) if d <= half_width}
        lines.add(distance.index(min(distance)))
    return lines


def amplitude_spectrum(x: Floats, n_fft: int) -> list[float]:
    """Amplitudes under a symmetric Hamming window, root of the mean power over half-overlapping blocks."""
    block = min(len(x), n_fft)
    window = hamming_symmetric(block) if block > 2 else [1.0] * block
    starts = range(0, len(x) - block + 1, n_fft // 2)
    amplitudes = []
    for line in range(n_fft // 2 + 1):
        powers = [power(product(x[start : start + block], window), n_fft, line) for start in starts]
        sides = 1 if line in (0, n_fft // 2) else 2
        amplitudes.append(sides * math.sqrt(math.fsum(powers) / len(powers)) / math.fsum(window))
    return amplitudes


def order_lines(x: Floats, step: float, n_lines: int) -> list[complex]:
    """Amplitudes of cosines at multiples of ``step`` (rad per sample), over the most whole turns."""
    turns = round(len(x) * step / (2 * math.pi))
    length = min(len(x), round(turns * 2 * math.pi / step)) or len(x)
    mean = math.fsum(x[:length]) / length
    ripple = [value - mean for value in x[:length]]
    return [2 / length * transform(ripple, k * step) for k in range(1, n_lines + 1)]


def profile_point(t: float, eccentricity: float, n_pins: int, shortening: float, depth: float) -> complex:
    """Point of a cycloidal wheel at profile parameter ``t``, ``depth`` below the path of pins' centres."""
    path = eccentricity * n_pins / shortening * cmath.exp(1j * t) + eccentricity * cmath.exp(1j * n_pins * t)
    tangent = 1j * eccentricity * n_pins / shortening * cmath.exp(1j * t)
    tangent += 1j * n_pins * eccentricity * cmath.exp(1j * n_pins * t)
    return path + 1j * depth * tangent / abs(tangent)


def pitch_error(t: float, errors: Floats) -> float:
    """Angle by which the profile is displaced at ``t``; ``errors`` in rad, one per lobe.

    From tip to pit that of the lobe, from pit to tip on to that of the next one.
    """
    n = len(errors)
    place = t / (2 * math.pi / n)
    lobe = math.floor(place)
    share = place - lobe
    here, following = errors[lobe % n], errors[(lobe + 1) % n]
    if share < 0.5:
        return here
    x = 2 * share - 1
    return here + (following - here) * (3 * x**2 - 2 * x**3)


def distance_to_curve(p: complex, curve: Callable[[float], complex], low: float, high: float) -> float:
    """Distance from ``p`` to the nearest point of a curve: of 400 points, then twice of 400 near the best."""
    nearest = math.inf
    for _ in range(3):
        step = (high - low) / 400
        places = [low + k * step for k in range(401)]
        distances = [abs(p - curve(place)) for place in places]
        nearest = min(distances)
        best = places[distances.index(nearest)]
        low, high = max(low, best - 2 * step), min(high, best + 2 * step)
    return nearest


def distance_to_polyline(p: complex, corners: Sequence[complex]) -> float:
    """Distance from ``p`` to the nearest point of a closed polyline, edge by edge."""
    nearest = math.inf
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        along = end - start
        share = ((p - start) * along.conjugate()).real / abs(along) ** 2
        nearest = min(nearest, abs(p - start - min(max(share, 0.0), 1.0) * along))
    return nearest
