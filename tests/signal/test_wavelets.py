"""Wavelets by name, the transform, scalograms and what is read from them."""

import csv
import json
from importlib import resources
from pathlib import Path

import naive
import numpy as np
import pytest
import pywt
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import signal, stats

from cyclofeat.signal.wavelets import (
    as_wavelet,
    dwt,
    envelope_lines,
    level_band,
    level_envelope,
    level_of,
    level_statistics,
    lowest_colour,
    morris,
    morris_names,
    scalogram,
    visible,
    wavelet_qualifier,
)

ORACLES = Path(__file__).parents[1] / "oracles"
WAVELETS = ["mb32.3", "db2", "haar", "bior3.1"]
every_wavelet = pytest.mark.parametrize("wavelet", WAVELETS)
every_member = pytest.mark.parametrize("name", morris_names())


def table(name):
    text = resources.files("cyclofeat.signal").joinpath("filters/morris_filters.json").read_text("utf-8")
    return json.loads(text)[name]


@every_member
def test_every_member_is_orthonormal(name):
    taps = np.array(morris(name).rec_lo)
    under_even_shifts = np.correlate(taps, taps, "full")[taps.size - 1 :: 2]
    assert_allclose(under_even_shifts, [1, *[0] * (taps.size // 2 - 1)], atol=1e-12)
    assert taps.sum() == pytest.approx(np.sqrt(2), abs=1e-12)
    assert len(taps) == int(name[2:].split(".")[0])


def test_every_tap_of_mb32_3_prints_as_published():
    for tap, digits in zip(morris("mb32.3").rec_lo, table("mb32.3")["published_digits"], strict=True):
        assert f"{tap:.6e}" == f"{digits:.6e}"


@every_member
def test_the_distance_to_matlab_is_what_the_table_says(name):
    distance = np.max(np.abs(np.array(morris(name).rec_lo) - table(name)["matlab_wfilters_LoR"]))
    assert distance == pytest.approx(table(name)["max_abs_diff_from_matlab"], rel=1e-3)


def test_a_wavelet_by_any_name():
    bank = as_wavelet("db3").filter_bank
    for wavelet in ("db3", pywt.Wavelet("db3"), bank):
        assert_allclose(as_wavelet(wavelet).rec_lo, pywt.Wavelet("db3").rec_lo)
    assert as_wavelet("mb8.2").orthogonal


@pytest.mark.parametrize(
    ("wavelet", "message"),
    [
        ("mb5.1", r"got 'mb5\.1'"),
        ("morl", "discrete wavelet.*got 'morl'"),
        ([[1, 1], [1, -1], [1, 1]], r"four filters.*lengths \[2, 2, 2\]"),
        ([[1, 1], [1, -1], [1, 1], [1]], r"lengths \[2, 2, 2, 1\]"),
        ([[1, np.nan], [1, -1], [1, 1], [-1, 1]], "finite"),
    ],
)
def test_bad_wavelets(wavelet, message):
    with pytest.raises(ValueError, match=message):
        as_wavelet(wavelet)
    with pytest.raises(ValueError, match="must be one of mb4.2, .* got 'db4'"):
        morris("db4")


@settings(derandomize=True, deadline=None)
@given(st.floats(1e-3, 12_799), st.sampled_from([25_600.0, 1000.0, 12_800.0]))
def test_the_level_of_a_frequency_has_it_in_its_band(frequency, rate):
    if frequency >= rate / 2:
        with pytest.raises(ValueError, match="half the sampling rate"):
            level_of(frequency, rate)
        return
    low, high = level_band(level_of(frequency, rate), rate)
    assert low <= frequency < high


def test_the_mesh_frequency_of_the_papers():
    """Paper A section 5.1: 133.3 Hz at 25.6 kHz lies at level 7, 100 to 200 Hz."""
    assert level_of(133.33, 25_600) == 7
    assert level_of(100.0, 25_600) == 7
    assert level_of(200.0, 25_600) == 6
    with pytest.raises(ValueError, match="level must be at least 1"):
        level_band(0, 25_600)


def test_names_of_wavelets_in_features_tell_filters_apart():
    assert wavelet_qualifier("mb32.3") == wavelet_qualifier(morris("mb32.3")) == "mb32.3"
    assert wavelet_qualifier(pywt.Wavelet("db3")) == "db3"
    bank = [list(taps) for taps in pywt.Wavelet("db3").filter_bank]
    assert wavelet_qualifier(bank) == wavelet_qualifier(as_wavelet(bank)) == wavelet_qualifier(np.array(bank))
    # A name says nothing where the filters are others.
    liar = pywt.Wavelet("db4", filter_bank=bank)
    assert wavelet_qualifier(liar) == wavelet_qualifier(bank) != "db4"
    other = [*bank[:3], bank[2]]
    assert wavelet_qualifier(other) != wavelet_qualifier(bank)


# The transform


def torque(n_windows: int, n_samples: int, seed: int = 5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    time = np.arange(n_samples) / 25_600
    bursts = np.exp(-((((time * 8.889 % 1) - 0.4) * 30) ** 2)) * np.sin(2 * np.pi * 900 * time)
    return (
        22 + rng.uniform(0.5, 3, (n_windows, 1)) * bursts + rng.normal(scale=0.1, size=(n_windows, n_samples))
    )


def test_transform_in_any_shape_and_precision():
    X = torque(6, 300).astype(np.float32)
    for level, detail in enumerate(dwt(X.reshape(2, 3, 300), levels=4)):
        assert detail.dtype == np.float64
        for row in range(6):
            assert_array_equal(detail[row // 3, row % 3], dwt(X[row].astype(float), levels=4)[level])


@pytest.mark.parametrize(
    ("levels", "words"), [(0, "at least 1"), (31, "at most 30"), (2.0, "a whole number")]
)
def test_bad_levels(levels, words):
    with pytest.raises((TypeError, ValueError), match=f"levels must be {words}, got {levels}"):
        dwt(np.ones(4), levels=levels)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_windows_that_are_not_finite(bad):
    for function in (dwt, scalogram):
        with pytest.raises(ValueError, match="X must be finite"):
            function([1.0, bad, 2.0])
        with pytest.raises(ValueError, match="at least one sample"):
            function(np.empty((2, 0)))


# Scalograms


@every_wavelet
@pytest.mark.parametrize("n_samples", [1, 3, 40, 77, 128])
@pytest.mark.parametrize("n_colours", [2, 7, 64])
def test_scalogram_against_brute_force(wavelet, n_samples, n_colours):
    bank = as_wavelet(wavelet)
    X = torque(2, n_samples)
    got = scalogram(X, wavelet, 8, n_colours)
    assert got.shape == (2, 8, n_samples)
    for x, picture in zip(X, got, strict=True):
        details = naive.dwt_details(x, bank.dec_lo, bank.dec_hi, 8)
        for level, (detail, row) in enumerate(zip(details, picture, strict=True), 1):
            assert row.tolist() == naive.colours(naive.cells(detail, level, n_samples), n_colours)


@settings(derandomize=True, deadline=None, database=None, max_examples=20)
@given(
    n_samples=st.integers(1, 5000),
    level=st.integers(1, 14),
    wavelet=st.sampled_from(WAVELETS),
    data=st.data(),
)
def test_cells_add_up_and_lie_as_the_recipe_cuts_them(n_samples, level, wavelet, data):
    length = n_samples
    for _ in range(level):
        length = (length + as_wavelet(wavelet).dec_len - 1) // 2
    shown, counts = visible(np.arange(1.0, length + 1), level, n_samples)
    assert counts.min() >= 1
    assert counts.sum() == n_samples
    row = np.repeat(np.arange(1, length + 1), 2**level)
    first = (row.size - n_samples) // 2
    place = data.draw(st.integers(0, n_samples - 1))
    assert np.repeat(shown, counts)[place] == row[first + place]


def test_lowest_colour_of_a_level():
    assert lowest_colour(np.array([0.0, 0.124, -0.126, 1.0]), 8).tolist() == [True, True, False, False]
    # A row of one size, and one below sqrt(eps) throughout
    assert lowest_colour(np.array([[3.0, -3.0], [1e-9, 1.4e-8]])).all()
    assert lowest_colour(np.array([1e-9, 1.6e-8])).tolist() == [True, False]


@pytest.mark.parametrize("colours", [1, 2.5, True])
def test_bad_colours(colours):
    with pytest.raises((TypeError, ValueError), match="colours must be (a whole number|at least 2), got"):
        scalogram(np.ones(4), colours=colours)


@settings(derandomize=True, deadline=None, database=None, max_examples=10)
@given(st.floats(0.01, 1000), st.integers(0, 2**32 - 1))
def test_colours_depend_neither_on_scale_nor_on_mean(scale, seed):
    X = torque(2, 200, seed)
    before, after = scalogram(X, "db3", 5), scalogram(scale * X - 7 * scale, "db3", 5)
    # Rounding may push a coefficient over the border of its colour.
    assert np.mean(before != after) < 0.01
    assert np.abs(before - after).max() <= 1


# GNU Octave


def rows(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_details_against_octave():
    torques = np.loadtxt(ORACLES / "wavelet_input.csv", delimiter=",").T
    coefficients = {name: dwt(torques, name, 9) for name in ("mb32.3", "db2")}
    found = rows(ORACLES / "wavelet_details.csv")
    theirs = np.array([float(row["detail"]) for row in found])
    ours = np.array(
        [coefficients[r["wavelet"]][int(r["level"]) - 1][int(r["torque"]), int(r["index"])] for r in found]
    )
    assert len(found) == sum(detail.size for name in coefficients for detail in coefficients[name][:-1])
    assert_allclose(ours, theirs, rtol=1e-10, atol=1e-11)  # of coefficients up to 500 Nm: 22 Nm times 2^(9/2)


def test_colours_against_octave():
    torques = np.loadtxt(ORACLES / "wavelet_input.csv", delimiter=",").T
    pictures = {name: scalogram(torques, name, 9) for name in ("mb32.3", "db2")}
    found = rows(ORACLES / "wavelet_colours.csv")
    assert len(found) == 2 * 3 * 9
    for row in found:
        theirs = [int(colour) for colour in row["colours"].split()]
        picture = pictures[row["wavelet"]][int(row["torque"])]
        assert picture[int(row["level"]) - 1].tolist() == theirs
    # The input is such that every branch of the recipe is taken.
    assert {1, 64} <= set(pictures["db2"][0].ravel())
    assert (pictures["db2"][2] == 1).all()


def test_the_filters_that_octave_was_given_are_ours():
    filters = np.genfromtxt(ORACLES / "wavelet_filters.csv", delimiter=",").T
    for column, taps in zip(
        filters, [f for name in ("mb32.3", "db2") for f in as_wavelet(name).filter_bank[:2]], strict=True
    ):
        assert_allclose(column[~np.isnan(column)], taps, rtol=1e-15)


# Statistics of levels


@every_wavelet
@pytest.mark.parametrize("n_samples", [90, 128])
def test_level_statistics_against_brute_force(wavelet, n_samples):
    bank, levels = as_wavelet(wavelet), 6
    X = torque(2, n_samples)
    got = level_statistics(dwt(X, wavelet, levels), n_samples, 16)
    for window, x in enumerate(X):
        details = naive.dwt_details(x, bank.dec_lo, bank.dec_hi, levels)
        table = [naive.cells(detail, level, n_samples) for level, detail in enumerate(details, 1)]
        powers = [sum(c * c for c in row) / n_samples / 2**level for level, row in enumerate(table, 1)]
        assert_allclose(got["rms"][window], np.sqrt(powers), rtol=1e-10)
        assert_allclose(got["energy_share"][window], np.array(powers) / sum(powers), rtol=1e-10)
        assert_allclose(got["kurtosis"][window], stats.kurtosis(table, axis=1, fisher=False), rtol=1e-9)
        lowest = [naive.colours(row, 16).count(1) / n_samples for row in table]
        assert_allclose(got["lowest_colour"][window], lowest, rtol=1e-12)


# Envelope


@every_wavelet
@pytest.mark.parametrize(("level", "steps", "n_samples"), [(2, 2, 90), (3, 3, 91), (5, 3, 240)])
def test_envelope_against_brute_force(wavelet, level, steps, n_samples):
    bank = as_wavelet(wavelet)
    X = torque(2, n_samples)
    envelope, step = level_envelope(dwt(X, wavelet, level)[level - 1], level, wavelet, n_samples)
    assert step == 2 ** (level - steps)
    assert envelope.shape == (2, -(-n_samples // step))
    for x, fast in zip(X, envelope, strict=True):
        detail = naive.dwt_details(x, bank.dec_lo, bank.dec_hi, level)[-1]
        slow = naive.level_envelope(detail, bank.rec_lo, bank.rec_hi, steps, envelope.shape[1], step == 1)
        assert_allclose(fast, np.array(slow) / np.sqrt(step), rtol=1e-9, atol=1e-11)


def test_envelope_is_that_of_the_full_reconstruction():
    """Three inverse steps instead of seven: the lines agree within 1 % of the envelope's mean."""
    rate, n_samples = 25_600, 46_080
    time = np.arange(n_samples) / rate
    mesh = (1 + 0.5 * np.cos(2 * np.pi * 8.333 * time)) * np.cos(2 * np.pi * 133.3 * time)
    x = torque(1, n_samples)[0] + mesh
    coefficients = dwt(x, levels=7)
    alone = [np.zeros_like(c) for c in coefficients]
    alone[6] = coefficients[6]
    full = pywt.waverec([alone[7], *alone[6::-1]], morris("mb32.3"), mode="symmetric")[:n_samples]
    expected = np.abs(signal.hilbert(full))
    envelope, step = level_envelope(coefficients[6], 7, "mb32.3", n_samples)
    harmonics = np.r_[np.arange(1, 16), 32, 48] * 500 / 60
    assert envelope.mean() == pytest.approx(expected.mean(), rel=2e-3)
    assert_allclose(
        envelope_lines(envelope, rate / step, harmonics),
        envelope_lines(expected, rate, harmonics),
        atol=2e-3 * envelope.mean(),
    )


def test_envelope_lines_are_amplitudes():
    rate, n = 1600, 2880
    time = np.arange(n) / rate
    envelope = 3 + 0.5 * np.cos(2 * np.pi * 10 * time) + 0.2 * np.cos(2 * np.pi * 50.3 * time + 1)
    # On a bin; beside one, at most 1.42 dB less; where nothing is; beyond the tolerance, 0.5 % off.
    lines = envelope_lines(envelope, rate, [10, 50.3, 200, 49.5], 0.0)
    assert lines[0] == pytest.approx(0.5, rel=1e-6)
    assert 0.2 * 10 ** (-1.43 / 20) < lines[1] <= 0.2
    assert lines[2] < 1e-4
    assert lines[3] < 0.1
    assert envelope_lines(envelope, rate, [49.5], 0.02)[0] == pytest.approx(lines[1])


@pytest.mark.parametrize("n_samples", [1, 2, 3])
def test_envelope_of_short_windows_is_finite(n_samples):
    for level in (1, 4, 9):
        envelope, step = level_envelope(dwt(np.ones(n_samples), "db2", level)[-2], level, "db2", n_samples)
        lines = envelope_lines(envelope, 25_600 / step, [8.3, 133.0])
        assert np.isfinite(lines).all()
