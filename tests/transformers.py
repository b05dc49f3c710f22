"""Transformers of every family with the parameters that change their way through the code, and windows."""

import numpy as np
import pywt

from cyclofeat.features import (
    AmplitudeSpectrum,
    BandPower,
    CoherenceToReference,
    HighPass,
    NarrowbandRatio,
    OrderSpectrum,
    SpectralCentroid,
    SpectralEntropy,
    SpectralFlatness,
    SpectralRolloff,
    TorqueFeatures,
    TorqueStatistics,
    WaveletEnvelopeSpectrum,
    WaveletLevelStatistics,
    WaveletMinimaOverlap,
    WelchPSD,
)

SAMPLING_RATE = 25_600
BANK = [list(taps) for taps in pywt.Wavelet("db2").filter_bank]

STATISTICS = [
    TorqueStatistics(SAMPLING_RATE),
    SpectralEntropy(SAMPLING_RATE),
    SpectralEntropy(SAMPLING_RATE, preset="ripple"),
    SpectralEntropy(SAMPLING_RATE, normalize=True, band=(0.0, 1500.0)),
]
SPECTRAL = [
    SpectralFlatness(SAMPLING_RATE),
    SpectralFlatness(SAMPLING_RATE, "ripple", band=(100.0, 5000.0), n_parts=2),
    SpectralCentroid(SAMPLING_RATE),
    SpectralCentroid(SAMPLING_RATE, n_parts=12),
    SpectralRolloff(SAMPLING_RATE),
    SpectralRolloff(SAMPLING_RATE, "ripple", fraction=0.5, band=(100.0, 5000.0)),
    NarrowbandRatio(SAMPLING_RATE),
    NarrowbandRatio(SAMPLING_RATE, "ripple", 133.3, 10.5, 7),
    BandPower(SAMPLING_RATE, bands=[(0, 1500.0), (200, 800)]),
    WelchPSD(SAMPLING_RATE, band=(390, 510)),
    WelchPSD(SAMPLING_RATE, "ripple", band=(390, 510), decibels=True),
    AmplitudeSpectrum(SAMPLING_RATE, band=(10, 14)),
    AmplitudeSpectrum(SAMPLING_RATE, 64, "hann", band=(0, 500)),
    CoherenceToReference(SAMPLING_RATE, bands=[(0, 1500)]),
    CoherenceToReference(SAMPLING_RATE, reference="first", bands=[(0, 1500), (100, 300)]),
    OrderSpectrum(SAMPLING_RATE, n_lines=2, n_mesh_lines=1),
    OrderSpectrum(SAMPLING_RATE, n_lines=60, n_mesh_lines=0, comb="mesh"),
    HighPass(SAMPLING_RATE),
    TorqueFeatures(SAMPLING_RATE, ["SpectralCentroid", "NormalizedEntropy", "CoherenceToReference"]),
    TorqueFeatures(SAMPLING_RATE),
]
WAVELET = [
    WaveletMinimaOverlap(SAMPLING_RATE, levels=5),
    WaveletMinimaOverlap(SAMPLING_RATE, wavelet=BANK, levels=3, colours=8, align="none"),
    WaveletEnvelopeSpectrum(SAMPLING_RATE),
    WaveletEnvelopeSpectrum(
        SAMPLING_RATE, wavelet=pywt.Wavelet("sym4"), n_mesh_harmonics=0, speed_tolerance=0
    ),
    WaveletLevelStatistics(SAMPLING_RATE),
    WaveletLevelStatistics(SAMPLING_RATE, wavelet="haar", levels=4, colours=16),
]


def torque(n_windows: int, n_samples: int, seed: int = 3) -> np.ndarray:
    """Windows with a mesh line of different height, and noise."""
    rng = np.random.default_rng(seed)
    mesh = np.sin(2 * np.pi * 133.3 * np.arange(n_samples) / SAMPLING_RATE)
    return 22 + mesh * rng.uniform(0.5, 4, (n_windows, 1)) + rng.normal(size=(n_windows, n_samples))
