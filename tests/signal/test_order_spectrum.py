"""Input speed without a tachometer, order lines and synchronous averages."""

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from cyclofeat.features import LobeMap, OrderSpectrum
from cyclofeat.signal.lobes import lobe_frequency
from cyclofeat.signal.orders import (
    COMBS,
    comb_lines,
    estimate_input_speed,
    order_lines,
    samples_at,
    synchronous_average,
)

RATE = 25_600.0
SPEED = 500 / 60
N_SAMPLES = 46_080


def orders(amplitudes, speed=SPEED, n_samples=N_SAMPLES, rate=RATE, seed=0):
    """Sum of cosines at orders of the input speed, of random phase: {order: amplitude}."""
    phase = 2 * np.pi * speed * np.arange(n_samples) / rate
    start = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(amplitudes))
    pairs = zip(amplitudes.items(), start, strict=True)
    return sum(amplitude * np.cos(order * phase + begin) for (order, amplitude), begin in pairs)


# Input speed


@pytest.mark.slow
@settings(max_examples=10, derandomize=True, deadline=None, database=None)
@given(st.floats(-0.0145, 0.0145), st.integers(0, 1000), st.sampled_from(COMBS))
def test_speed_is_found_to_three_hundredths_of_a_percent(deviation, seed, comb):
    speed = SPEED * (1 + deviation)
    lines = {16: 1.0, 32: 1.0}
    if comb == "lobe":
        lines |= {16 / 15 * k: 0.2 for k in range(1, 45) if k % 15}
    torque = 22 + orders(lines, speed, seed=seed) + np.random.default_rng(seed).normal(size=N_SAMPLES)
    found = estimate_input_speed(torque[np.newaxis], RATE, SPEED, comb=comb)
    assert found[0] == pytest.approx(speed, rel=3e-4)


def test_speed_is_that_of_the_lobe_map():
    X = 22 + np.random.default_rng(1).normal(size=(3, N_SAMPLES))
    lobe_map = LobeMap(RATE).fit(X)
    assert_array_equal(estimate_input_speed(X, RATE, SPEED), lobe_map.lines(X).input_speed_hz)


def test_speed_of_windows_without_any():
    assert_array_equal(estimate_input_speed(np.ones((2, 100)), RATE, SPEED), SPEED)
    assert_array_equal(estimate_input_speed(np.ones((2, N_SAMPLES)), RATE, SPEED, tolerance=0), SPEED)
    assert estimate_input_speed(np.zeros((1, N_SAMPLES)), RATE, SPEED)[0] == pytest.approx(SPEED, rel=0.0151)


def test_comb_is_cut_to_what_the_sampling_rate_holds():
    assert comb_lines(RATE, SPEED, 0.015) == 44
    assert comb_lines(400.0, SPEED, 0.015) == int(200 / (lobe_frequency(SPEED) * 1.015))
    torque = 22 + orders({16 / 15 * k: 1.0 for k in range(1, 21)}, SPEED * 1.01, 720, 400.0)
    assert estimate_input_speed(torque[np.newaxis], 400.0, SPEED)[0] == pytest.approx(SPEED * 1.01, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tolerance": 0.3}, "tolerance must be from 0 to 0.2 .*, got 0.3"),
        ({"tolerance": -0.1}, "got -0.1"),
        ({"nominal_hz": 0.0}, "nominal_hz must be positive and finite, got 0.0"),
        ({"comb": "pin"}, "comb must be 'lobe' or 'mesh', got 'pin'"),
        ({"sampling_rate": 50.0}, "sampling_rate=50 is too low .* at least 54.1"),
        ({"sampling_rate": 200.0, "comb": "mesh"}, "sampling_rate=200 is too low .* at least 270.6"),
        ({"X": np.ones(100)}, r"shape \(n_windows, n_samples\), got \(100,\)"),
        ({"X": np.full((1, 9), np.nan)}, "finite"),
    ],
)
def test_bad_arguments_of_the_speed(arguments, message):
    given = {"X": np.ones((1, 100)), "sampling_rate": RATE, "nominal_hz": SPEED, **arguments}
    with pytest.raises(ValueError, match=message):
        estimate_input_speed(**given)


# Order lines


@pytest.mark.parametrize("n_lobes", [15, 1])
@pytest.mark.parametrize("n_samples", [1, 2, 7, 60, 150, 301])
def test_lines_against_brute_force(n_lobes, n_samples):
    # 200 samples an output turn: what fits is 0, 1 or 1.5 turns of 15 lobes, and many of one.
    X = 22 + np.random.default_rng(2).normal(size=(3, n_samples))
    speeds = np.array([0.98, 1.0, 1.015])
    rate = 200 / 15
    n_lines = 50 if n_lobes == 15 else 5  # so many that nothing is thinned out
    lines = order_lines(X, rate, speeds, n_lines, n_lobes)
    for x, speed, row in zip(X, speeds, lines, strict=True):
        step = 2 * np.pi * speed / n_lobes / rate
        assert_allclose(row, naive.order_lines(x.tolist(), step, n_lines), atol=1e-10)


@pytest.mark.parametrize("n_lobes", [15, 1])
def test_thinning_out_changes_nothing(n_lobes):
    """Lines read at a reduced rate are those of an explicit sum over all samples, to 100 dB and rounding."""
    x = 22 + np.random.default_rng(3).normal(size=N_SAMPLES)
    speed, n_lines = 8.4, 30
    step = 2 * np.pi * speed / n_lobes / RATE
    turns = round(N_SAMPLES * step / (2 * np.pi))
    length = min(N_SAMPLES, round(turns * 2 * np.pi / step))
    kernel = np.exp(-1j * step * np.outer(np.arange(1, n_lines + 1), np.arange(length)))
    explicit = 2 / length * kernel @ (x[:length] - x[:length].mean())
    lines = order_lines(x[np.newaxis], RATE, [speed], n_lines, n_lobes)[0]
    assert_allclose(lines, explicit, atol=1e-4 * np.abs(explicit).max())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"input_speed_hz": [1.0, 2.0]}, r"got \(1, 100\) and \(2,\)"),
        ({"input_speed_hz": [0.0]}, "input_speed_hz must be positive, got 0.0"),
        ({"input_speed_hz": [np.nan]}, "got nan"),
        ({"n_lines": 0}, "n_lines must be at least 1, got 0"),
        ({"input_speed_hz": [8000.0], "n_lines": 30}, "line 30 lies at 16000, beyond .* 12800"),
        ({"X": np.ones(100)}, r"got \(100,\)"),
    ],
)
def test_bad_arguments_of_lines(arguments, message):
    given = {"X": np.ones((1, 100)), "sampling_rate": RATE, "input_speed_hz": [SPEED], "n_lines": 3}
    with pytest.raises(ValueError, match=message):
        order_lines(**{**given, **arguments})


def test_synchronous_average_is_the_mean_over_turns():
    # 128 samples an input turn; band-limited to half of them, the average is that of brute force
    rate, n_points = 128 * SPEED, 128
    x = 22 + np.random.default_rng(4).normal(size=12 * 128 + 5)
    average = synchronous_average(order_lines(x[np.newaxis], rate, [SPEED], 63, n_lobes=1), n_points)[0]
    expected = np.array(naive.synchronous_average(x.tolist(), 128))
    spectrum = np.fft.rfft(expected - x[: 12 * 128].mean())
    spectrum[-1] = 0
    assert_allclose(average, np.fft.irfft(spectrum), atol=1e-9)
    with pytest.raises(ValueError, match="n_points must be at least 1, got 0"):
        synchronous_average(np.ones((1, 63), dtype=complex), 0)


# The transformer


def test_features_are_the_amplitudes_of_the_named_lines():
    torque = 22 + orders({16 / 15 * k: 0.1 for k in range(1, 45)} | {16: 1.0, 15: 0.3, 17: 0.2}, SPEED * 1.01)
    transformer = OrderSpectrum(RATE).fit(torque[np.newaxis])
    names = transformer.get_feature_names_out().tolist()
    amplitudes = dict(zip(names, transformer.transform(torque[np.newaxis])[0], strict=True))
    assert len(names) == 48 + 2 * 33
    for k, amplitude in ((16, 0.1), (225, 0.3), (240, 1.0), (255, 0.2), (480, 0.1)):
        assert amplitudes[f"order_amplitude_nm(output;k{k:03d};v2)"] == pytest.approx(amplitude, abs=0.02)
    for k in (1, 230, 250, 470):
        assert amplitudes[f"order_amplitude_nm(output;k{k:03d};v2)"] < 0.03


def test_lines_kept():
    X = np.zeros((1, 100))

    def kept(**parameters):
        names = OrderSpectrum(RATE, **parameters).fit(X).get_feature_names_out()
        return [int(name.split(";k")[1].split(";")[0]) for name in names]

    assert kept(n_lines=3, n_mesh_lines=0) == [1, 2, 3]
    assert kept(n_lines=1) == [1, *range(224, 257), *range(464, 497)]
    assert kept(n_lines=1, n_mesh_lines=1, n_lobes=13) == [1, *range(14 * 13 - 16, 14 * 13 + 17)]
    assert kept(n_lines=1, n_mesh_lines=1, n_lobes=3) == list(range(1, 29))  # sidebands begin at line 1


def test_equal_steps_of_the_angle():
    """At 512 samples an input turn, lines are read without any search for the speed."""
    turns = np.arange(15 * 512) / 512
    torque = 22 + 3 * np.cos(2 * np.pi * 16 / 15 * turns)
    transformer = OrderSpectrum(512, input_speed_hz=1, speed_tolerance=0, n_mesh_lines=0)
    amplitudes = transformer.fit_transform(torque[np.newaxis])[0]
    assert_allclose(amplitudes, 3.0 * (np.arange(1, 49) == 16), atol=1e-3)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"sampling_rate": 500.0}, "sampling_rate=500 holds .* up to 250, but line 496 .* reaches 279"),
        ({"sampling_rate": 30.0, "n_lines": 3, "n_mesh_lines": 0}, "sampling_rate=30 is too low"),
    ],
)
def test_bad_parameters(parameters, message):
    with pytest.raises(ValueError, match=message):
        OrderSpectrum(**{"sampling_rate": RATE, **parameters}).fit(np.zeros((1, 100)))


def test_constant_windows_have_no_lines():
    for n_samples in (1, 2, 100, N_SAMPLES):
        assert_array_equal(OrderSpectrum(RATE).fit_transform(np.full((2, n_samples), 22.1)), 0)


def test_samples_at_an_angle_are_those_of_numpy():
    random = np.random.default_rng(3)
    angle = np.cumsum(random.uniform(0.1, 2.0, 500))
    angles = np.concatenate([random.uniform(angle[0] - 5, angle[-1] + 5, 900), angle])
    assert_array_equal(samples_at(angles, angle), np.interp(angles, angle, np.arange(angle.size)))
