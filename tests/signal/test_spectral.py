"""Spectra, entropies and statistics against brute force, scipy, GNU Octave and closed forms."""

import csv
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal
from scipy import signal, stats

import cyclofeat.signal
from cyclofeat.signal import (
    amplitude_spectrum,
    band_power,
    high_pass,
    narrowband_ratio,
    normalized_entropy,
    octave_bands,
    shannon_entropy,
    spectral_centroid,
    spectral_flatness,
    spectral_rolloff,
    torque_statistics,
    welch_psd,
)
from cyclofeat.signal.density import band_slice, narrowband_mask
from cyclofeat.signal.welch import AMPLITUDE_WINDOWS, PRESETS, welch_frequencies

SAMPLING_RATE = 25_600
ORACLES = Path(__file__).parents[1] / "oracles"
both_presets = pytest.mark.parametrize("preset", sorted(PRESETS))


def torque(n_windows: int, n_samples: int, seed: int = 0) -> np.ndarray:
    """Windows of 22 Nm with a mesh line, drift and noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(n_samples) / SAMPLING_RATE
    mesh = 2 * np.sin(2 * np.pi * 133.3 * time + rng.uniform(0, 6, (n_windows, 1)))
    drift = rng.normal(size=(n_windows, 1)) * np.cos(2 * np.pi * time)
    return 22 + mesh + drift + rng.normal(size=(n_windows, n_samples))


# Welch's density


@both_presets
@pytest.mark.parametrize("n_samples", [1, 2, 5, 8, 9, 10, 13, 31, 64, 100])
def test_psd_against_brute_force(preset, n_samples):
    x = torque(1, n_samples)[0]
    expected_frequencies, expected = naive.welch_psd(x, SAMPLING_RATE, preset)
    frequencies, psd = welch_psd(x, SAMPLING_RATE, preset)
    assert_allclose(frequencies, expected_frequencies, rtol=1e-14)
    assert_allclose(psd, expected, rtol=1e-9, atol=1e-12 * max(expected))


def octave_rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def octave_input() -> np.ndarray:
    return np.loadtxt(ORACLES / "pwelch_input.csv")


@both_presets
@pytest.mark.parametrize("n_samples", [1500, 1152, 9])
def test_psd_against_octave(octave_input, n_samples, preset):
    rows = [
        (float(row["frequency_hz"]), float(row["psd"]))
        for row in octave_rows(ORACLES / "pwelch_psd.csv")
        if (int(row["n_samples"]), row["preset"]) == (n_samples, preset)
    ]
    frequencies, psd = welch_psd(octave_input[:n_samples], SAMPLING_RATE, preset)
    assert_allclose(frequencies, [f for f, _ in rows], rtol=1e-15)
    assert_allclose(psd, [p for _, p in rows], rtol=1e-10)


def test_entropies_and_statistics_against_octave(octave_input):
    rows = octave_rows(ORACLES / "pwelch_scalars.csv")
    assert len(rows) == 3 * (2 * 2 + 10)
    for row in rows:
        x = octave_input[: int(row["n_samples"])]
        if row["preset"]:
            _, psd = welch_psd(x, SAMPLING_RATE, row["preset"])
            value = getattr(cyclofeat.signal, row["name"])(psd)
        else:
            value = torque_statistics(x)[row["name"]]
        assert_allclose(value, float(row["value"]), rtol=1e-10, err_msg=str(row))


@both_presets
@pytest.mark.parametrize("n_samples", [1500, 1152, 90])
def test_shapes_of_the_density_against_octave(octave_input, n_samples, preset):
    rows = {
        row["name"]: float(row["value"])
        for row in octave_rows(ORACLES / "spectral_shape.csv")
        if (int(row["n_samples"]), row["preset"]) == (n_samples, preset)
    }
    frequencies, psd = welch_psd(octave_input[:n_samples], SAMPLING_RATE, preset)
    ours = {
        "spectral_flatness": spectral_flatness(psd),
        "spectral_centroid": spectral_centroid(psd, frequencies),
        "spectral_rolloff": spectral_rolloff(psd, frequencies),
        "narrowband_ratio": narrowband_ratio(psd, frequencies, 100.0, 30.0),
        "band_power": band_power(psd, frequencies, [(200, 3000)])[0],
    }
    assert ours.keys() == rows.keys()
    for name, value in rows.items():
        assert_allclose(ours[name], value, rtol=1e-10, err_msg=name)


@pytest.mark.parametrize("window", sorted(set(AMPLITUDE_WINDOWS) - {"flattop"}))
def test_amplitudes_against_octave(octave_input, window):
    rows = [row for row in octave_rows(ORACLES / "amplitude_spectrum.csv") if row["window"] == window]
    frequencies, amplitudes = amplitude_spectrum(octave_input, SAMPLING_RATE, 256, window)
    assert_allclose(frequencies, [float(row["frequency_hz"]) for row in rows], rtol=1e-15)
    assert_allclose(amplitudes, [float(row["amplitude"]) for row in rows], rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "outputs"),
    [
        ("pwelch_oracle.m", {"pwelch_psd.csv": "psd", "pwelch_scalars.csv": "value"}),
        (
            "spectral_oracle.m",
            {
                "spectral_shape.csv": "value",
                "amplitude_spectrum.csv": "amplitude",
                "mscohere_coherence.csv": "coherence",
            },
        ),
        ("wavelet_oracle.m", {"wavelet_details.csv": "detail", "wavelet_colours.csv": ""}),
    ],
)
def test_octave_still_says_the_same(tmp_path, script, outputs):
    octave = shutil.which("octave-cli") or shutil.which("octave")
    if octave is None:
        pytest.skip("GNU Octave is not installed")
    command = [octave, "--no-gui", "--no-init-file", "--quiet"]
    if subprocess.run([*command, "--eval", "pkg load signal"], capture_output=True, check=False).returncode:
        pytest.skip("GNU Octave lacks its package signal")
    subprocess.run([*command, script, str(tmp_path)], cwd=ORACLES, capture_output=True, check=True)
    for name, column in outputs.items():
        committed, now = octave_rows(ORACLES / name), octave_rows(tmp_path / name)
        values = [np.array([float(row.pop(column, 0)) for row in rows]) for rows in (committed, now)]
        assert committed == now
        assert_allclose(values[1], values[0], rtol=1e-10, atol=1e-11 * script.startswith("wavelet"))


def test_constant_windows():
    constant = np.full((2, 3000), [[0.1], [22.0]])
    _, psd = welch_psd(constant, SAMPLING_RATE, "ripple")
    assert not psd.any()
    assert_array_equal(shannon_entropy(psd), 0)
    assert_array_equal(normalized_entropy(psd), 0)
    _, psd = welch_psd(constant, SAMPLING_RATE)
    assert_allclose(shannon_entropy(psd)[0], shannon_entropy(psd)[1], rtol=1e-12)
    _, psd = welch_psd(np.zeros(3000), SAMPLING_RATE)
    assert shannon_entropy(psd) == 0


@both_presets
def test_leading_axes_and_integers(preset):
    X = np.round(torque(6, 200)).astype(int)
    _, psd = welch_psd(X, SAMPLING_RATE, preset)
    _, cube = welch_psd(X.reshape(2, 3, 200), SAMPLING_RATE, preset)
    assert cube.shape == (2, 3, 129)
    assert_array_equal(cube.reshape(6, 129), psd)
    assert shannon_entropy(cube).shape == (2, 3)
    assert welch_psd(X[:0], SAMPLING_RATE, preset)[1].shape == (0, 129)


# Bad input


@pytest.mark.parametrize(
    ("X", "message"),
    [
        ([1.0, np.nan], "finite"),
        ([1.0, np.inf], "finite"),
        (np.array([1, np.inf], dtype=np.float32), "finite"),
        ([1.0, -1e160], "1e\\+160"),
        (np.ones((3, 0)), r"\(3, 0\)"),
        (22.0, r"shape \(\)"),
        ([1j, 2j], "complex128"),
    ],
)
def test_bad_windows(X, message):
    with pytest.raises(ValueError, match=message):
        welch_psd(X, SAMPLING_RATE)
    with pytest.raises(ValueError, match=message):
        torque_statistics(X)


@pytest.mark.parametrize(
    ("band", "message"),
    [
        ((0, 12_801), r"12801\) Hz reaches beyond the highest frequency, 12800 Hz"),
        ((500, 100), r"0 <= low < high, got \(500, 100\)"),
        ((100, 100), r"0 <= low < high"),
        ((-1, 100), r"0 <= low < high"),
        ((np.nan, 100), "band must be finite, got nan"),
        ((1, 2), r"\(1, 2\) Hz holds none of the 129 spectral lines, which are 100 Hz apart"),
        ((1, 2, 3), r"two frequencies \(low, high\) in Hz, got 3 values \(1, 2, 3\)"),
        (100, "got 100"),
        (("low", "high"), "got .*low"),
    ],
)
def test_bad_bands(band, message):
    frequencies = welch_frequencies(100, SAMPLING_RATE)
    with pytest.raises((TypeError, ValueError), match=message):
        shannon_entropy(np.ones(129), frequencies, band)


@pytest.mark.parametrize("shape", [shannon_entropy, normalized_entropy, spectral_flatness])
def test_bad_densities(shape):
    for psd in ([1.0, np.nan], [1.0, -1.0, 3.0], [np.inf, 1.0]):
        with pytest.raises(ValueError, match="finite and not negative"):
            shape(psd)
    with pytest.raises(ValueError, match="frequencies are needed"):
        shape([1.0, 2.0], band=(0, 1))


# Entropy


def test_entropy_of_known_densities():
    assert_allclose(shannon_entropy(np.ones(64)), 6, rtol=1e-15)
    assert_allclose(normalized_entropy(np.ones(64)), 1, rtol=1e-13)
    line = np.eye(64)[5]
    assert shannon_entropy(line) == 0
    assert not np.signbit(shannon_entropy(line))
    assert abs(normalized_entropy(line)) < 1e-15
    assert_allclose(shannon_entropy([1, 3]), naive.binary_entropy(0.25), rtol=1e-15)
    assert_allclose(shannon_entropy([1e300, 1e300]), 1)
    assert_allclose(shannon_entropy([1e-300, 1e-300]), 1)


def test_band_limits_are_included_and_renormalised():
    x = torque(1, 1152)[0]
    frequencies, psd = welch_psd(x, SAMPLING_RATE)
    inside = psd[(frequencies >= 100) & (frequencies <= 500)]
    assert inside.size == 5
    for ours, oracle in [
        (shannon_entropy, naive.shannon_entropy),
        (normalized_entropy, naive.normalized_entropy),
    ]:
        assert_allclose(ours(psd, frequencies, (100, 500)), oracle(inside), rtol=1e-12)
    assert shannon_entropy(psd, frequencies, (90, 110)) == 0
    assert normalized_entropy(psd, frequencies, (90, 110)) == 0


@pytest.mark.parametrize("sampling_rate", [25_600, 10_000 / 3, 0.1, np.float32(1234.56)])
def test_half_of_the_sampling_rate_is_a_line(sampling_rate):
    frequencies = welch_frequencies(1000, sampling_rate)
    assert frequencies[-1] == float(sampling_rate) / 2
    assert band_slice(frequencies, (0, float(sampling_rate) / 2)) == slice(0, frequencies.size)


def test_mean_torque_alone_has_the_entropy_of_the_hamming_window():
    # 256 samples per segment: no zero-padding.
    _, psd = welch_psd(np.full(1152, 22.0), SAMPLING_RATE)
    window = naive.hamming_symmetric(256)
    density = [naive.power(window, 256, line) * (1 if line in (0, 128) else 2) for line in range(129)]
    assert_allclose(shannon_entropy(psd), naive.shannon_entropy(density), rtol=1e-10)
    # 0.54 at 0 Hz, half of 0.46 to either side of it
    centre, side = 0.54**2, 2 * 0.23**2
    assert_allclose(shannon_entropy(psd), naive.binary_entropy(side / (centre + side)), atol=0.005)
    assert_allclose(shannon_entropy(psd), 0.84, atol=0.005)


# Paper A: tables 4 and 6, measured, for 0 to 7 worn lobes.
TABLE_4_MEAN = np.array([22.03, 22.86, 22.71, 22.37, 22.8, 22.28, 22.83, 22.17])
TABLE_4_STD = np.array([2.912, 4.964, 4.557, 4.047, 4.232, 4.125, 3.923, 3.462])
TABLE_6_ENTROPY = np.array([1.6838, 1.8495, 1.8087, 1.7801, 1.7794, 1.776, 1.7516, 1.7241])


def test_entropy_of_mean_and_noise_is_a_function_of_their_power_ratio():
    rng = np.random.default_rng(1)
    entropies = []
    for mean, std in zip(TABLE_4_MEAN, TABLE_4_STD, strict=True):
        x = mean + std * rng.normal(size=(4, 46_080))
        entropies.append(shannon_entropy(welch_psd(x, SAMPLING_RATE)[1]))
    a = TABLE_4_STD**2 / (TABLE_4_MEAN**2 + TABLE_4_STD**2)
    noise = shannon_entropy(welch_psd(rng.normal(size=46_080), SAMPLING_RATE)[1])
    mean = shannon_entropy(welch_psd(np.ones(46_080), SAMPLING_RATE)[1])
    expected = [naive.binary_entropy(share) + (1 - share) * mean + share * noise for share in a]
    assert_allclose(np.mean(entropies, axis=1), expected, atol=0.01)
    # The order of table 6 follows from table 4 alone.
    assert stats.spearmanr(expected, TABLE_6_ENTROPY).statistic > 0.9


# Shape of the density


@settings(derandomize=True, deadline=None, database=None, max_examples=20)
@given(
    fundamental=st.floats(3.0, 900.0),
    half_width=st.floats(0.0, 700.0),
    n_harmonics=st.integers(1, 9) | st.none(),
    n_samples=st.integers(1, 3000),
)
def test_narrowband_lines_against_brute_force(fundamental, half_width, n_harmonics, n_samples):
    frequencies = welch_frequencies(n_samples, 20_000)
    count = n_harmonics or int(10_000 / fundamental)
    mask = narrowband_mask(frequencies, fundamental, half_width, n_harmonics)
    lines = naive.narrowband_lines(frequencies.tolist(), fundamental, half_width, count)
    assert set(np.flatnonzero(mask).tolist()) == lines


def test_narrowband_ratio_is_the_share_of_those_lines():
    frequencies, psd = welch_psd(torque(2, 5000), SAMPLING_RATE)
    mask = narrowband_mask(frequencies, 133.3, 20.0, 5)
    assert_allclose(
        narrowband_ratio(psd, frequencies, 133.3, 20.0, 5), psd[:, mask].sum(1) / psd.sum(1), rtol=1e-13
    )
    assert_allclose(narrowband_ratio(psd, frequencies, 0.5, 1e5), 1, rtol=1e-12)


def test_shapes_of_known_densities():
    frequencies = np.array([0.0, 100.0, 200.0, 300.0])
    assert_allclose(spectral_flatness(np.full(4, 1e-200)), 1, rtol=1e-14)
    assert_allclose(spectral_flatness([1.0, 2.0, 4.0, 8.0]), 64**0.25 / 3.75, rtol=1e-14)
    # One line of zero makes the product of eq. 9 zero, and so does a window without power.
    assert_array_equal(spectral_flatness([[1.0, 2.0, 0.0, 4.0], [0.0] * 4]), 0)
    assert spectral_centroid([1.0, 0.0, 0.0, 1.0], frequencies) == 150
    assert spectral_centroid([5.0, 1.0, 1.0, 0.0], frequencies, (100, 200)) == 150
    assert_array_equal(
        spectral_rolloff([[1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 2.0]], frequencies, 0.5), [100, 300]
    )
    assert spectral_rolloff([1.0, 1.0, 1.0, 1.0], frequencies, 1.0) == 300
    assert spectral_rolloff([9.0, 0.0, 1.0, 1.0], frequencies, 0.4, (200, 300)) == 200
    bands = [(0, 100), (100, 100.5), (50.0, 300)]
    assert_array_equal(band_power([1.0, 2.0, 4.0, 8.0], frequencies, bands), [300, 200, 1400])
    for value in (
        spectral_centroid([0.0] * 4, frequencies, (100, 300)),
        spectral_rolloff([0.0] * 4, frequencies, 0.95, (100, 300)),
        narrowband_ratio([0.0] * 4, frequencies),
    ):
        assert value == 0


def test_bands_by_default_are_octaves_and_hold_lines_however_short_the_window():
    bands = octave_bands(SAMPLING_RATE)
    assert bands[0] == (0.0, 100.0)
    assert bands[-1] == (6400.0, 12_800.0)
    assert all(high == 2 * low for low, high in bands[1:])
    assert all(one[1] == other[0] for one, other in pairwise(bands))
    for n_samples in (1, 46_080):
        frequencies, psd = welch_psd(torque(2, n_samples), SAMPLING_RATE)
        assert_array_equal(band_power(psd, frequencies), band_power(psd, frequencies, bands))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f, p: spectral_rolloff(p, f, 0.0), "fraction must be above 0 and at most 1, got 0.0"),
        (lambda f, p: spectral_rolloff(p, f, 1.1), "got 1.1"),
        (lambda f, p: spectral_centroid(p, f[1:]), r"each of the 129 lines, got shape \(128,\)"),
        (lambda f, p: band_power(p, f, []), r"sequence of \(low, high\) in Hz, got \[\]"),
        (lambda f, p: band_power(p, f, (100, 200)), r"got \(100, 200\)"),
        (lambda f, p: band_power(p, f, [(0, 13_000)]), "beyond the highest frequency, 12800 Hz"),
        (lambda f, p: band_power(p, f, "ab"), "got 'a'"),
        (lambda f, p: narrowband_ratio(p, f, 0), "fundamental_hz must be positive and finite, got 0"),
        (lambda f, p: narrowband_ratio(p, f, 100, -1), "half_width_hz must be .* not negative, got -1"),
        (lambda f, p: narrowband_ratio(p, f, 100, 5, 0), "n_harmonics must be at least 1, got 0"),
        (lambda f, p: narrowband_ratio(p, f, 100, 5, 129), "harmonic 129 .* 12900 Hz, beyond .* 12800 Hz"),
        (lambda f, p: narrowband_ratio(p, f, 13_000), "harmonic 1 .* 13000 Hz"),
        (lambda f, p: welch_psd(p, 0), "sampling_rate .* got 0"),
        (lambda f, p: welch_psd(p, -25_600), "sampling_rate .* got -25600"),
        (lambda f, p: welch_psd(p, np.nan), "sampling_rate .* got nan"),
        (lambda f, p: welch_psd(p, np.inf), "sampling_rate .* got inf"),
        (lambda f, p: welch_psd(p, 1.0, "welch"), "'matlab_pwelch' or 'ripple', got 'welch'"),
        (lambda f, p: amplitude_spectrum(p, -1), "sampling_rate .* got -1"),
        (lambda f, p: amplitude_spectrum(p, 1.0, n_fft=7), "n_fft must be even, got 7"),
        (lambda f, p: amplitude_spectrum(p, 1.0, n_fft=0), "n_fft must be at least 2, got 0"),
        (lambda f, p: amplitude_spectrum(p, 1.0, n_fft=64.0), "n_fft must be a whole number, got 64.0"),
        (
            lambda f, p: amplitude_spectrum(p, 1.0, window="kaiser"),
            "window must be one of 'hamming', .*, got 'kaiser'",
        ),
    ],
)
def test_bad_arguments(call, message):
    with pytest.raises((TypeError, ValueError), match=message):
        call(*welch_psd(np.ones(100), SAMPLING_RATE))


# Amplitudes


@pytest.mark.parametrize("n_samples", [1, 2, 3, 31, 32, 33, 48, 100])
def test_amplitudes_against_brute_force(n_samples):
    x = torque(1, n_samples)[0]
    frequencies, amplitudes = amplitude_spectrum(x, SAMPLING_RATE, 32)
    assert_allclose(frequencies, np.arange(17) * 800.0)
    assert_allclose(amplitudes, naive.amplitude_spectrum(x.tolist(), 32), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("window", AMPLITUDE_WINDOWS)
def test_a_sine_reads_its_amplitude(window):
    phase = 2 * np.pi * np.arange(46_080) / 8192
    frequencies, amplitudes = amplitude_spectrum(
        22 + 3 * np.sin(100 * phase + 1) + 0.5 * np.cos(4096 * phase), SAMPLING_RATE, window=window
    )
    assert frequencies[100] == 312.5
    assert_allclose(amplitudes[[0, 100, 4096]], [22, 3, 0.5], rtol=1e-3)


@pytest.mark.parametrize("window", AMPLITUDE_WINDOWS)
@pytest.mark.parametrize("n_samples", [1, 2, 3])
def test_amplitudes_of_shortest_windows_are_finite(window, n_samples):
    _, amplitudes = amplitude_spectrum(np.full(n_samples, 22.0), SAMPLING_RATE, 64, window)
    assert_allclose(amplitudes[0], 22, rtol=1e-12)
    assert np.isfinite(amplitudes).all()


# High-pass


@pytest.mark.parametrize("cutoff", [0.5, 1.0, 10.0, 50.0])
def test_high_pass_is_butterworth_run_twice(cutoff):
    # Far from the ends of a long record, lines come out scaled by the squared gain, without delay.
    rate = 200 * cutoff
    time = np.arange(40_000) / rate
    for factor in (0.5, 1.0, 2.0, 10.0):
        line = np.cos(2 * np.pi * factor * cutoff * time)
        # tan: the bilinear transform warps frequencies
        warped = np.tan(np.pi * factor * cutoff / rate) / np.tan(np.pi * cutoff / rate)
        gain = 1 / (1 + warped**-8)
        filtered = high_pass(22 + line, rate, cutoff)[15_000:25_000]
        assert_allclose(filtered, gain * line[15_000:25_000], atol=1e-9)


def test_high_pass_ends_and_short_windows():
    X = torque(3, 5000)
    sections = signal.butter(2, 20.0, "highpass", fs=SAMPLING_RATE, output="sos")
    expected = signal.sosfiltfilt(sections, X, axis=1, padtype="odd", padlen=1280)
    assert_allclose(high_pass(X, SAMPLING_RATE, 20.0, order=2), expected, atol=1e-9)
    for n_samples in (1, 2, 3):
        for cutoff in (0.5, 1.0, 10.0, 50.0):
            filtered = high_pass(torque(2, n_samples), SAMPLING_RATE, cutoff)
            assert filtered.shape == (2, n_samples)
            assert np.isfinite(filtered).all()
    for cutoff in (0.5, 1.0, 10.0, 50.0):
        assert_array_equal(high_pass(np.full(46_080, 22.1), SAMPLING_RATE, cutoff), 0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"cutoff_hz": 0}, r"half of the sampling rate \(12800 Hz\), got 0"),
        ({"cutoff_hz": 12_800}, "got 12800"),
        ({"cutoff_hz": np.nan}, "got nan"),
        ({"order": 0}, "order must be at least 1, got 0"),
        ({"sampling_rate": 0}, "sampling_rate .* got 0"),
    ],
)
def test_bad_arguments_of_the_high_pass(arguments, message):
    with pytest.raises(ValueError, match=message):
        high_pass(np.ones(100), **{"sampling_rate": SAMPLING_RATE, **arguments})


# Statistics


def test_statistics_of_degenerate_windows():
    values = torque_statistics([[22.1] * 7, [0.0] * 7, [-3.3] * 7])
    assert_array_equal(values["mean"], [22.1, 0, -3.3])
    for name in ("std", "range", "skewness", "kurtosis", "ripple"):
        assert_array_equal(values[name], 0, err_msg=name)
    assert_allclose(values["crest_factor"], [1, 0, 1], rtol=1e-15)
    single = torque_statistics([[5.0]])
    assert (single["std"], single["rms"], single["crest_factor"]) == (0, 5, 1)
    assert torque_statistics([-1.0, 1.0])["ripple"] == 0
    # Sums of these round: no mean can be told from zero.
    assert torque_statistics([0.1, 0.2, -0.3])["ripple"] == 0


def test_statistics_of_tiny_and_huge_windows():
    x = torque(1, 50)[0]
    for scale in (1e-120, 1e90):
        for name in ("crest_factor", "skewness", "kurtosis", "ripple"):
            assert_allclose(torque_statistics(x * scale)[name], torque_statistics(x)[name], rtol=1e-9)


# Properties. Multiples of 1/1024 add and subtract exactly, so that offsets can be told from rounding.

derandomized = settings(derandomize=True, deadline=None, database=None, max_examples=10)
samples = st.integers(-200_000, 200_000).map(lambda number: number / 1024)
windows = st.integers(1, 80).flatmap(lambda n: arrays(np.float64, (3, n), elements=samples))
offsets = st.integers(-500_000, 500_000).map(lambda number: number / 1024)
scales = st.floats(1e-6, 1e6)
presets = st.sampled_from(sorted(PRESETS))


@derandomized
@given(X=windows, preset=presets, scale=scales)
def test_entropies_are_bounded_and_depend_neither_on_scale_nor_on_sign(X, preset, scale):
    psd, scaled, turned = (welch_psd(x, SAMPLING_RATE, preset)[1] for x in (X, X * scale, -X))
    bits, limit = shannon_entropy(psd), np.log2(psd.shape[1])
    assert (bits >= 0).all()
    assert (bits <= limit + 1e-12).all()
    assert_allclose(normalized_entropy(psd), bits / limit, atol=1e-13)
    assert_allclose(shannon_entropy(scaled), bits, atol=1e-9)
    assert_allclose(shannon_entropy(turned), bits, atol=1e-12)


@derandomized
@given(X=windows, offset=offsets, scale=st.sampled_from([0.25, 2.0, 1024.0]))
def test_statistics_under_scale_and_offset(X, offset, scale):
    before, scaled, shifted = (torque_statistics(x) for x in (X, X * scale, X + offset))
    for name in ("min", "max", "mean", "std", "range", "rms"):
        assert_array_equal(scaled[name], before[name] * scale, err_msg=name)
    for name in ("crest_factor", "skewness", "kurtosis", "ripple"):
        assert_array_equal(scaled[name], before[name], err_msg=name)
    for name in ("std", "range", "skewness", "kurtosis"):
        assert_array_equal(shifted[name], before[name], err_msg=name)
    for name in ("min", "max"):
        assert_array_equal(shifted[name], before[name] + offset, err_msg=name)
    assert_allclose(shifted["mean"], before["mean"] + offset, atol=1e-9)


@derandomized
@given(X=windows, preset=presets, scale=scales, offset=offsets)
def test_shapes_under_scale_and_offset(X, preset, scale, offset):
    frequencies, psd = welch_psd(X, SAMPLING_RATE, preset)
    _, scaled = welch_psd(X * scale, SAMPLING_RATE, preset)
    _, shifted = welch_psd(X + offset, SAMPLING_RATE, "ripple")
    _, ripple = welch_psd(X, SAMPLING_RATE, "ripple")
    for shape in (
        lambda p: spectral_flatness(p, frequencies, (100, 12_000)),
        lambda p: spectral_centroid(p, frequencies),
        lambda p: narrowband_ratio(p, frequencies, 700.0),
    ):
        assert_allclose(shape(scaled), shape(psd), rtol=1e-6, atol=1e-9)
        assert_array_equal(shape(shifted), shape(ripple))
    assert_array_equal(shannon_entropy(shifted), shannon_entropy(ripple))
    assert_allclose(
        band_power(scaled, frequencies), scale**2 * band_power(psd, frequencies), rtol=1e-9, atol=1e-20
    )
    assert_array_equal(spectral_rolloff(shifted, frequencies), spectral_rolloff(ripple, frequencies))
    bounds = [(spectral_flatness(psd), 1 + 1e-9), (spectral_centroid(psd, frequencies), 12_800)]
    for value, limit in bounds:
        assert (value >= 0).all()
        assert (value <= limit).all()
    ratio = narrowband_ratio(psd, frequencies)
    assert (ratio >= 0).all()
    assert (ratio <= 1 + 1e-12).all()


@derandomized
@given(X=windows, scale=st.sampled_from([0.25, 2.0, 1024.0]), offset=offsets)
def test_amplitudes_and_high_pass_under_scale_and_offset(X, scale, offset):
    _, before = amplitude_spectrum(X, SAMPLING_RATE, 64)
    assert_array_equal(amplitude_spectrum(X * scale, SAMPLING_RATE, 64)[1], before * scale)
    assert_array_equal(high_pass(X * scale, SAMPLING_RATE, 50.0), high_pass(X, SAMPLING_RATE, 50.0) * scale)
    assert_array_equal(high_pass(X + offset, SAMPLING_RATE, 50.0), high_pass(X, SAMPLING_RATE, 50.0))
