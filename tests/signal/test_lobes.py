"""Torque folded lobe by lobe: lines, slots, speed and whitening against brute force and known signals."""

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.signal import lfilter

from cyclofeat.features import LobeMap
from cyclofeat.signal import lobes

RATE = 25_600.0
SPEED = 500 / 60
N_SAMPLES = 46_080


def comb(amplitudes, phases, speed=SPEED, n_samples=N_SAMPLES, rate=RATE, n_lobes=15):
    """Sum of cosines at multiples 1, 2, ... of the lobe frequency."""
    time = np.arange(n_samples) / rate
    k = np.arange(1, len(amplitudes) + 1)[:, np.newaxis]
    frequency = lobes.lobe_frequency(speed, n_lobes)
    return (np.c_[amplitudes] * np.cos(2 * np.pi * k * frequency * time + np.c_[phases])).sum(0)


def lines_of(torque, rate=RATE, **comb):
    return lobes.lobe_lines(torque[np.newaxis], rate, SPEED, lobes.LobeComb(**comb))


def test_the_lobe_frequency_is_16_15_of_the_input_speed():
    assert lobes.lobe_frequency(500 / 60) == pytest.approx(8.8889, abs=1e-4)
    assert lobes.lobe_frequency(1.0, n_lobes=13) == pytest.approx(14 / 13)


def test_lines_are_the_amplitudes_and_phases_of_a_comb():
    rng = np.random.default_rng(5)
    amplitudes, phases = rng.uniform(0.5, 2, 20), rng.uniform(0, 2 * np.pi, 20)
    torque = comb(amplitudes, phases)
    found = lines_of(torque, n_lines=20, ar_order=0, speed_tolerance=0)
    expected = amplitudes * np.exp(1j * phases) / torque.std()
    # Hann's sidelobes of the neighbouring lines, 16 bins off, and straight lines between padded bins
    assert_allclose(found.lines[0], expected, rtol=0.01, atol=0.005)


@pytest.mark.slow
@settings(max_examples=10, derandomize=True, deadline=None)
@given(st.floats(-0.0145, 0.0145), st.integers(0, 1000))
def test_the_speed_is_found_anywhere_in_its_range(deviation, seed):
    rng = np.random.default_rng(seed)
    speed = SPEED * (1 + deviation)
    torque = comb(rng.uniform(0.2, 1, 40), rng.uniform(0, 7, 40), speed) + rng.normal(size=N_SAMPLES)
    found = lines_of(torque)
    # Under this noise the fit scatters by some 2e-4; 1e-3 is an eighth of a slot at either end of the window.
    assert found.input_speed_hz[0] == pytest.approx(speed, rel=1e-3)


@pytest.mark.parametrize("hum_hz", [50.0, 150.0, 250.0])
def test_mains_stronger_than_every_lobe_line_do_not_draw_the_speed(hum_hz):
    rng = np.random.default_rng(3)
    speed = SPEED * 1.006
    torque = comb(rng.uniform(0.2, 1, 40), rng.uniform(0, 7, 40), speed) + rng.normal(size=N_SAMPLES)
    torque += 5 * np.cos(2 * np.pi * hum_hz * np.arange(N_SAMPLES) / RATE)
    found = lines_of(torque, ar_order=0)
    assert found.input_speed_hz[0] == pytest.approx(speed, rel=1e-3)


def test_the_speed_is_found_in_noise_ten_times_the_comb():
    """Most lines drown; those that do not tell."""
    rng = np.random.default_rng(4)
    near = 0
    for deviation in rng.uniform(-0.01, 0.01, 10):
        torque = comb(rng.uniform(0.02, 0.3, 40), rng.uniform(0, 7, 40), SPEED * (1 + deviation))
        torque += 10 * torque.std() * rng.normal(size=N_SAMPLES)
        found = lines_of(torque).input_speed_hz[0]
        near += abs(found / (SPEED * (1 + deviation)) - 1) < 1e-3
    assert near >= 9


def test_folding_lines_is_the_synchronous_average():
    """The fold from lobe lines equals the average over periods, sample by sample."""
    rng = np.random.default_rng(7)
    # 128 samples a period, 16 periods
    rate = 128 * lobes.lobe_frequency(SPEED)
    torque = comb(rng.uniform(0.5, 2, 12), rng.uniform(0, 7, 12), n_samples=16 * 128, rate=rate)
    found = lines_of(torque, rate, n_lines=12, ar_order=0, speed_tolerance=0)
    folded = lobes.fold(found.lines, n_lobes=16, points=8, lowest_line=1).ravel() * torque.std()
    assert_allclose(folded, naive.synchronous_average(torque, 128), atol=0.03 * torque.std())


@settings(max_examples=8, derandomize=True, deadline=None)
@given(st.integers(0, 14), st.floats(0, 1))
def test_aligned_slots_do_not_depend_on_where_the_window_starts(lobe, fraction):
    period = RATE / lobes.lobe_frequency(SPEED)
    start = round((lobe + fraction) / 15 * period)
    record = one_disturbed_lobe(N_SAMPLES + int(period) + 2)
    lobe_map = LobeMap(RATE, speed_tolerance=0).fit(record[np.newaxis, :N_SAMPLES])
    here = lobe_map.transform(record[np.newaxis, :N_SAMPLES])
    there = lobe_map.transform(record[np.newaxis, start : start + N_SAMPLES])
    assert_allclose(there[:, :30], here[:, :30], atol=0.05)


def one_disturbed_lobe(n_samples, lobe=4, noise=0.02):
    """Bursts whenever one lobe passes the load."""
    position = np.arange(n_samples) / RATE * lobes.lobe_frequency(SPEED) * 15
    burst = ((position % 15).astype(int) == lobe) * np.sin(2 * np.pi * 3 * position)
    return 22 + burst + noise * np.random.default_rng(8).normal(size=n_samples)


def test_a_disturbed_lobe_shows_in_its_own_slot():
    lobe_map = LobeMap(RATE, align="start", speed_tolerance=0, ar_order=0)
    rms = lobe_map.fit_transform(one_disturbed_lobe(N_SAMPLES)[np.newaxis])[0, 15:30]
    assert np.argmax(rms) == 4
    assert rms[4] > 4 * np.median(rms)


def test_prewhitening_undoes_a_resonance():
    """A damped oscillator rings for many slots; the autoregressive residual puts each impact in its slot."""
    ringing = one_disturbed_lobe(N_SAMPLES)
    radius, angle = np.exp(-0.02 * 2 * np.pi * 112 / RATE), 2 * np.pi * 112 / RATE
    ringing = 22 + lfilter([1.0], [1, -2 * radius * np.cos(angle), radius**2], ringing - 22)
    contrast = {}
    for order in (0, 16):
        lobe_map = LobeMap(RATE, align="start", speed_tolerance=0, ar_order=order)
        rms = lobe_map.fit_transform(ringing[np.newaxis])[0, 15:30]
        assert order == 0 or np.argmax(rms) == 4
        contrast[order] = rms.max() / np.median(rms)
    assert contrast[16] > 2 * contrast[0]


def test_prewhitening_finds_the_coefficients_of_an_autoregressive_process():
    rng = np.random.default_rng(9)
    drive = rng.normal(size=20_000)
    process = lfilter([1.0], [1, -1.6, 0.9], drive)
    residual = lobes.prewhiten((process - process.mean())[np.newaxis], 2560.0, 2, lowest_hz=5.0)[0]
    assert np.corrcoef(residual[50:], drive[50:])[0, 1] > 0.99
    lagged = [abs(np.corrcoef(residual[: -lag or None], residual[lag:])[0, 1]) for lag in (1, 2, 3)]
    assert max(lagged) < 4 / np.sqrt(drive.size)


def test_drift_of_the_brake_does_not_use_up_the_model():
    """A drift a hundred times stronger than the rest changes the whitened lines by little."""
    rng = np.random.default_rng(10)
    torque = one_disturbed_lobe(N_SAMPLES, noise=0.2)
    time = np.arange(N_SAMPLES) / RATE
    drift = 20 * np.sin(2 * np.pi * 0.9 * time + rng.uniform(0, 7))
    prominence = [
        lobes.line_prominence(lines_of(x, speed_tolerance=0))[0, 4:] for x in (torque, torque + drift)
    ]
    strong = prominence[0] > 3
    assert strong.sum() > 10
    assert_allclose(prominence[1][strong], prominence[0][strong], atol=2.0)


def test_contrast_is_blind_to_smooth_changes_of_the_spectrum():
    rng = np.random.default_rng(11)
    lines = rng.normal(size=(3, 44, 2)) @ np.array([1, 1j])
    tilt = np.exp(0.02 * np.arange(44))
    floor = np.ones((3, 44))
    flat, tilted = (
        lobes.line_contrast(lobes.LobeLines(np.ones(3), values, floor)) for values in (lines, lines * tilt)
    )
    assert_allclose(tilted, flat, atol=0.5)


@pytest.mark.parametrize(
    ("numbers", "n_lobes", "alone", "worn"),
    [
        ([15, 30], 15, True, False), ([8, 15, 16, 24, 30, 32], 15, True, False), ([], 15, False, False),
        (range(1, 40), 15, False, True), (range(2, 40, 2), 14, False, True),
        ([15, 30, 4, 7, 11], 15, False, False),
    ],
)  # fmt: skip
def test_mesh_lines_stand_alone_beside_those_of_the_output_s_pins(numbers, n_lobes, alone, worn):
    """Opposite worn lobes of a disc of 14 have every second line; without any line, nothing is known."""
    amplitudes = np.zeros(44)
    amplitudes[np.array(numbers, dtype=int) - 1] = 1.0
    torque = comb(amplitudes, np.arange(44.0), n_lobes=n_lobes)
    torque += 0.5 * np.random.default_rng(0).normal(size=N_SAMPLES)
    lobe_map = LobeMap(sampling_rate=RATE, n_lobes=n_lobes, speed_tolerance=0)
    assert lobes.tell_wear(lobe_map.fit_transform(torque[np.newaxis]), n_lobes) == ([alone], [worn])


def test_zeros_of_the_pattern_stand_in_the_contrast():
    """n consecutive equal lobes have no line at multiples of 15/n (Dirichlet kernel)."""
    record = np.zeros(N_SAMPLES)
    position = np.arange(N_SAMPLES) / RATE * lobes.lobe_frequency(SPEED) * 15
    record[np.isin((position % 15).astype(int), [2, 3, 4])] = 1.0
    record *= np.sin(np.pi * (position % 1)) ** 2
    record += 1e-3 * np.random.default_rng(12).normal(size=N_SAMPLES)
    found = lines_of(record, n_lines=14, speed_tolerance=0, ar_order=0)
    contrast = lobes.line_contrast(found)[0]
    zeros = [4, 9]  # lines 5 and 10
    assert contrast[zeros].max() < -15
    assert np.delete(contrast, zeros)[:8].min() > -12


def test_scale_and_offset_change_nothing():
    torque = one_disturbed_lobe(N_SAMPLES)[np.newaxis]
    lobe_map = LobeMap(RATE).fit(torque)
    assert_allclose(lobe_map.transform(1000 * torque), lobe_map.transform(torque), atol=1e-6)
    assert_allclose(lobe_map.transform(torque + 300), lobe_map.transform(torque), atol=1e-5)


@pytest.mark.parametrize(
    "window", [np.full(N_SAMPLES, 22.0), np.zeros(N_SAMPLES), np.zeros(100), np.arange(3.0)]
)
def test_constant_and_short_windows_have_documented_values(window):
    features = LobeMap(RATE).fit_transform(window[np.newaxis])
    assert_allclose(features[0, :30], 0)
    assert_allclose(features[0, 30:], -30)


@pytest.mark.slow
def test_lines_of_many_windows_are_those_of_each():
    """Many windows are taken in blocks, of which none may be lost or change its lines."""
    X = np.random.default_rng(0).normal(size=(600, 480))
    comb = lobes.LobeComb(n_lines=5)
    whole = lobes.lobe_lines(X, 32, 1.0, comb)
    parts = zip(*(lobes.lobe_lines(X[k : k + 1], 32, 1.0, comb) for k in range(600)), strict=True)
    alone = lobes.LobeLines(*map(np.concatenate, parts))
    for name, values in whole._asdict().items():
        assert_allclose(values, getattr(alone, name), atol=1e-12)


def test_windows_on_equal_steps_of_the_angle():
    """Samples per turn in place of the rate, 1 in place of the speed: the same features."""
    record = one_disturbed_lobe(N_SAMPLES)
    in_time = LobeMap(RATE, speed_tolerance=0).fit_transform(record[np.newaxis])
    in_angle = LobeMap(RATE / SPEED, input_speed_hz=1.0, speed_tolerance=0).fit_transform(record[np.newaxis])
    assert_allclose(in_angle, in_time, atol=1e-9)
