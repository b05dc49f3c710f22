"""The Morris family and wavelets by name."""

import json
from importlib import resources

import numpy as np
import pytest
import pywt
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cyclofeat.wavelets import as_wavelet, double_shift_error, level_band, level_of, morris, morris_names

every_member = pytest.mark.parametrize("name", morris_names())


def table(name):
    text = resources.files("cyclofeat").joinpath("filters/morris_filters.json").read_text("utf-8")
    return json.loads(text)[name]


@every_member
def test_every_member_is_orthonormal(name):
    taps = np.array(morris(name).rec_lo)
    assert double_shift_error(taps) < 1e-12
    assert taps.sum() == pytest.approx(np.sqrt(2), abs=1e-12)
    assert len(taps) == int(name[2:].split(".")[0])


@every_member
def test_a_signal_comes_back(name):
    signal = np.random.default_rng(1).normal(size=4096)
    levels = pywt.wavedec(signal, morris(name), mode="periodization", level=5)
    assert_allclose(pywt.waverec(levels, morris(name), mode="periodization"), signal, atol=1e-10)
    energy = sum(float(np.sum(level**2)) for level in levels)
    assert energy == pytest.approx(np.sum(signal**2), rel=1e-10)


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
