"""Transformers of every family with the parameters that change their way through the code, and windows."""

import numpy as np
import pywt

from cyclofeat import features as f

RATE = 25_600
BANK = [list(taps) for taps in pywt.Wavelet("db2").filter_bank]

STATISTICS = [
    f.TorqueStatistics(RATE),
    f.SpectralEntropy(RATE),
    f.SpectralEntropy(RATE, preset="ripple"),
    f.SpectralEntropy(RATE, normalize=True, band=(0.0, 1500.0)),
]
SPECTRAL = [
    f.SpectralFlatness(RATE),
    f.SpectralFlatness(RATE, "ripple", band=(100.0, 5000.0), n_parts=2),
    f.SpectralCentroid(RATE),
    f.SpectralCentroid(RATE, n_parts=12),
    f.SpectralRolloff(RATE),
    f.SpectralRolloff(RATE, "ripple", fraction=0.5, band=(100.0, 5000.0)),
    f.NarrowbandRatio(RATE),
    f.NarrowbandRatio(RATE, "ripple", 133.3, 10.5, 7),
    f.BandPower(RATE, bands=[(0, 1500.0), (200, 800)]),
    f.WelchPSD(RATE, band=(390, 510)),
    f.WelchPSD(RATE, "ripple", band=(390, 510), decibels=True),
    f.AmplitudeSpectrum(RATE, band=(10, 14)),
    f.AmplitudeSpectrum(RATE, 64, "hann", band=(0, 500)),
    f.CoherenceToReference(RATE, bands=[(0, 1500)]),
    f.CoherenceToReference(RATE, reference="first", bands=[(0, 1500), (100, 300)]),
    f.OrderSpectrum(RATE, n_lines=2, n_mesh_lines=1),
    f.OrderSpectrum(RATE, n_lines=60, n_mesh_lines=0, comb="mesh"),
    f.HighPass(RATE),
    f.TorqueFeatures(RATE, ["SpectralCentroid", "NormalizedEntropy", "CoherenceToReference"]),
    f.TorqueFeatures(RATE),
]
WAVELET = [
    f.WaveletMinimaOverlap(RATE, levels=5),
    f.WaveletMinimaOverlap(RATE, wavelet=BANK, levels=3, colours=8, align="none"),
    f.WaveletEnvelopeSpectrum(RATE),
    f.WaveletEnvelopeSpectrum(RATE, wavelet=pywt.Wavelet("sym4"), n_mesh_harmonics=0, speed_tolerance=0),
    f.WaveletLevelStatistics(RATE),
    f.WaveletLevelStatistics(RATE, wavelet="haar", levels=4, colours=16),
]


def torque(n_windows: int, n_samples: int, seed: int = 3) -> np.ndarray:
    """Windows with a mesh line of different height, and noise."""
    rng = np.random.default_rng(seed)
    mesh = np.sin(2 * np.pi * 133.3 * np.arange(n_samples) / RATE)
    return 22 + mesh * rng.uniform(0.5, 4, (n_windows, 1)) + rng.normal(size=(n_windows, n_samples))
