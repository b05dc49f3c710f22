"""Shared code of the examples on the papers, ``benchmarks/papers.py`` and ``tests/literature``.

Lobes and sleeves count from 0 in code: the papers' 14th sleeve is sleeve 13. Everything here is simulated;
torque on an assumed rig is called surrogate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pywt
from numpy.typing import NDArray
from scipy.signal import butter, find_peaks, sosfiltfilt

from cyclofeat.datasets import load_published_tables, make_rig_recordings
from cyclofeat.signal import amplitude_spectrum, magnitude_squared_coherence, shannon_entropy, welch_psd
from cyclofeat.signal.wavelets import morris_names, scalogram
from cyclofeat.simulators import CycloidalGearbox, LobeDefects, SimulationRun, Solver, simulate

Float = NDArray[np.float64]

RATE = 10_000  # Hz: every 10th of the papers' steps of 1e-5 s
RIG_RATE = 25_600  # Hz: paper A's rig
LOBE_PERIOD = 1125  # samples at RATE in which every lobe passes the load once: 15/16 of an input turn
COUNTS = tuple(range(8))
STEEL = CycloidalGearbox.steel()  # paper B: C = 150 Ns/m
STEEL_A = CycloidalGearbox.steel(contact_damping=200.0)  # paper A table 3
ABS = CycloidalGearbox.abs()  # H = 0.2, an assumption: see A11
SOFT_ABS = ABS.replace(stiffness_scale=0.1)
HEALTHY = LobeDefects.healthy()
ONE, BOTH = (0,), (0, 1)
# The first wheel is unrotated, as eq. 1 draws it: the tip of its first lobe is at the first sleeve. The
# papers do not state this; the ringing of eight worn lobes at the start (B5) is the evidence for it.
START = -math.pi


def shades(n: int) -> Float:
    """Colours from dark to light, which remain distinguishable in a grey print."""
    return np.asarray(matplotlib.colormaps["viridis"](np.linspace(0, 0.9, n)))


def panels(
    n_rows: int, xlabel: str, ylabel: str = "", title: str = "", size: tuple[float, float] = (11, 8)
) -> NDArray[np.object_]:
    """Return two columns of axes of a new figure, with the same limits; the outer ones have labels."""
    fig, axes = plt.subplots(n_rows, 2, figsize=size, layout="constrained", sharex=True, sharey=True)
    for ax in axes[-1]:
        ax.set_xlabel(xlabel)
    for ax in axes[:, 0]:
        ax.set_ylabel(ylabel)
    if title:
        fig.suptitle(title)
    return np.asarray(axes)


# The papers' runs -------------------------------------------------------------------------------------------


@cache
def run(
    defects: LobeDefects = HEALTHY,
    gearbox: CycloidalGearbox = STEEL,
    duration: float = 0.6,
    start: float = START,
) -> SimulationRun:
    """Simulate a run as in the papers: from rest, ramps of 0.2 s, every 10th step stored, sleeve forces."""
    return simulate(
        gearbox, defects, duration=duration, sampling_rate=RATE, solver=Solver(decimation="pick"),
        start_angle=start, forces=True,
    )  # fmt: skip


def settled(torque: Float) -> Float:
    """The last two lobe periods of a record (0.225 s)."""
    return torque[-2 * LOBE_PERIOD :]


def torques(gearbox: CycloidalGearbox, wheels: Sequence[int] = BOTH, counts: Sequence[int] = COUNTS) -> Float:
    """Output torque of each count in Nm, shape (n_counts, 6000)."""
    return np.array([run(LobeDefects.worn(n, wheels=wheels), gearbox).torque_out for n in counts])


# Paper B ----------------------------------------------------------------------------------------------------


def sleeve_forces(defects: LobeDefects, kind: str = "external", **options: float) -> Float:
    """Force on every sleeve in N, both wheels added (paper B figs. 3 and 4): (n, n_sleeves)."""
    forces: Float = getattr(run(defects, **options), f"{kind}_forces")
    return np.asarray(forces.sum(axis=1))


def peaks(force: Float, height: float = 150.0) -> tuple[Float, Float]:
    """Times in s and heights in N of the peaks that are 5 ms or more apart."""
    found, _ = find_peaks(force, height=height, distance=50)
    return found / RATE, force[found]


def change_at_maxima(count: int) -> float:
    """Largest change of an internal sleeve's force where the healthy one is near its maximum, in N (B3)."""
    healthy, worn = (
        sleeve_forces(defects, "internal")[2000:] for defects in (HEALTHY, LobeDefects.worn(count))
    )
    return float(np.abs(worn - healthy)[healthy > 0.8 * healthy.max()].max())


def oscillation(torque: Float) -> Float:
    """Part of the torque above 100 Hz, without delay."""
    return np.asarray(sosfiltfilt(butter(4, 100, "highpass", fs=RATE, output="sos"), torque))


def first_oscillation(defects: LobeDefects, start: float = START) -> float:
    """Largest oscillation of the output torque in the first 0.12 s, in Nm (B5)."""
    return float(np.abs(oscillation(run(defects, start=start).torque_out)[:1200]).max())


def coherence_with_healthy(kind: str) -> tuple[Float, Float]:
    """Lines to 1500 Hz, and coherence of ``torque_in`` or ``torque_out`` with healthy, for 1 to 8 (B6)."""
    healthy = getattr(run(), kind)
    lines = [
        magnitude_squared_coherence(getattr(run(LobeDefects.worn(n)), kind), healthy, RATE)
        for n in range(1, 9)
    ]
    frequencies = lines[0][0]
    shown = frequencies <= 1500
    return frequencies[shown], np.array([values[shown] for _, values in lines])


def minima_shared_with_seven(torque: Float, **options: object) -> tuple[NDArray[np.bool_], Float]:
    """Cells of the lowest colour both in each record and in the last one, and their shares per level (B10).

    Shapes (n_records - 1, levels, n_samples) and (n_records - 1, levels).
    """
    minima = scalogram(torque, **options) == 1  # type: ignore[arg-type]
    shared = minima[:-1] & minima[-1]
    return shared, shared.mean(axis=-1)


@cache
def graded_wavelets() -> dict[str, bool]:
    """Test per wavelet if the overlap at levels 3 and 4 grows at every step from 1 to 6 worn lobes (B7)."""
    torque = torques(STEEL)[1:]
    found = {}
    for name in (*morris_names(), *pywt.wavelist(kind="discrete")):
        _, share = minima_shared_with_seven(torque, wavelet=name, levels=4)
        found[name] = bool(np.all(np.diff(share[:, 2:], axis=0) > 0))
    return found


def amplitude_lines(torque: Float) -> tuple[Float, Float]:
    """Frequencies and amplitudes in Nm: 8192-point transform, Hamming window, of the last samples (B9)."""
    part = torque[-8192:]
    return amplitude_spectrum(part - part.mean(), RATE)


def from_200_to_800_hz(torque: Float) -> float:
    """Root of the summed squared amplitudes from 200 to 800 Hz, in Nm (B9)."""
    frequencies, amplitudes = amplitude_lines(torque)
    return float(np.linalg.norm(amplitudes[(frequencies >= 200) & (frequencies <= 800)]))


# Paper A ----------------------------------------------------------------------------------------------------


@cache
def surrogate_set(seed: int, rig: str = "published") -> Float:
    """Eight **surrogate** records of 1.8 s, one per count as on paper A's rig: torque in Nm, (8, 46080)."""
    made = make_rig_recordings(1, COUNTS, rig=rig, random_state=seed)
    return np.array([recording.torque for recording in made])


def surrogate_sets(rig: str = "published") -> Float:
    """Four sets of eight **surrogate** records, each record of a separate assembly: (4, 8, 46080)."""
    return np.array([surrogate_set(seed, rig) for seed in range(4)])


def binary_entropy(share: Float) -> Float:
    """Entropy in bits of two outcomes with the probabilities ``share`` and ``1 - share``."""
    return np.asarray(-share * np.log2(share) - (1 - share) * np.log2(1 - share))


def table_6_from_table_4() -> tuple[Float, Float, Float]:
    """Published entropies, those fitted from mean and deviation, and the two constants of the fit.

    With a = std^2 / (mean^2 + std^2) the entropy is b + c h(a), h the binary entropy.
    """
    tables = load_published_tables()
    mean, std = (tables.signal_statistics[name] for name in ("mean_nm", "std_nm"))
    h = binary_entropy(std**2 / (mean**2 + std**2))
    entropy = tables.spectral_entropy["entropy_bits"]
    slope, constant = np.polyfit(h, entropy, 1)
    return entropy, constant + slope * h, np.array([constant, slope])


def bands_of_falling_entropy(torque: Float, from_sample: int = 2000) -> tuple[Float, NDArray[np.bool_]]:
    """Line frequencies, and for each pair of first and last line whether entropy falls strictly (A10).

    ``torque`` holds one record per count, in their order. Bands have five lines or more. The entropy of the
    lines p with the sum s is log2 s - sum(p log2 p) / s, from cumulative sums.
    """
    frequencies, density = welch_psd(torque[:, from_sample:], RATE)
    density = np.maximum(density, 1e-300)
    n = density.shape[1]
    sums, products = (
        np.pad(np.cumsum(values, axis=1), ((0, 0), (1, 0)))
        for values in (density, density * np.log2(density))
    )
    falls = np.zeros((n, n), dtype=bool)
    for low in range(n - 4):
        s = sums[:, low + 5 :] - sums[:, [low]]
        entropy = np.log2(s) - (products[:, low + 5 :] - products[:, [low]]) / s
        falls[low, low + 4 :] = np.all(np.diff(entropy, axis=0) < 0, axis=0)
    return frequencies, falls


def n_bands(n_lines: int) -> int:
    """Number of bands of five lines or more among ``n_lines`` lines."""
    return (n_lines - 4) * (n_lines - 3) // 2


def spectrum(record: Float, rate: float = RATE) -> tuple[Float, Float]:
    """Frequencies and amplitudes in Nm under a Hann window, mean removed (A11)."""
    return amplitude_spectrum(record - record.mean(), rate, record.size, "hann")


def amplitude_in(record: Float, low: float, high: float) -> float:
    """Root of the summed squared amplitudes from ``low`` to below ``high``, in Nm."""
    frequencies, amplitudes = spectrum(record)
    return float(np.linalg.norm(amplitudes[(frequencies >= low) & (frequencies < high)]))


def upward_over_downward(torque: Float) -> Float:
    """(max - mean) / (mean - min) of each record (A12): 1 is symmetric."""
    mean = torque.mean(axis=-1)
    return np.asarray((torque.max(axis=-1) - mean) / (mean - torque.min(axis=-1)))


def entropy_bits(torque: Float) -> Float:
    """Shannon entropy of the density in bits, mean kept: MATLAB's pwelch defaults, eq. 8 (A6)."""
    return np.asarray(shannon_entropy(welch_psd(torque, RIG_RATE)[1]))


def falls_strictly(values: Float) -> bool:
    """Return True if each value is below the previous one."""
    return bool(np.all(np.diff(values) < 0))
