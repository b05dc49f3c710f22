"""Transformers of the wavelet transform: names, values, sharing, properties, errors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from transformers import RATE, WAVELET, torque

from cyclofeat.features import WaveletEnvelopeSpectrum, WaveletLevelStatistics
from cyclofeat.signal.wavelets import as_wavelet, dwt, envelope_lines, level_envelope, level_statistics

every_transformer = pytest.mark.parametrize("transformer", WAVELET, ids=lambda t: repr(t)[:60])


# Names: stored models and reports hold them, so they are written out here; those by default are golden data.


def test_names_and_order_of_the_features():
    X = torque(2, 500)
    names = [clone(t).fit(X).get_feature_names_out().tolist() for t in WAVELET]
    bank = "bank180df8e9"
    assert names[0] == [f"minima_overlap(mb32.3;64colours;energy;worst;level0{k};v2)" for k in range(1, 6)]
    assert names[1] == [f"minima_overlap({bank};8colours;none;worst;level0{k};v2)" for k in range(1, 4)]
    assert names[3] == [
        "wavelet_envelope_mean_nm(sym4;level07)",
        *(f"wavelet_envelope_line_nm(sym4;level07;shaft{k:02d})" for k in range(1, 16)),
    ]
    assert names[5][4] == "wavelet_energy_share(haar;of4levels;level01)"
    assert names[5][-1] == "wavelet_lowest_colour(haar;16colours;level04)"


# Values


def test_values_are_those_of_the_pure_functions():
    X = torque(4, 6000)
    coefficients = dwt(X, "mb32.3", 12)
    statistics = level_statistics(coefficients, 6000)
    assert_array_equal(WaveletLevelStatistics(RATE).fit_transform(X), np.hstack([*statistics.values()]))
    envelope, step = level_envelope(coefficients[6], 7, "mb32.3", 6000)
    harmonics = np.r_[1:16, 16, 32, 48] * (500 / 60)
    lines = envelope_lines(envelope, RATE / step, harmonics)
    features = WaveletEnvelopeSpectrum(RATE).fit_transform(X)
    assert_array_equal(features, np.column_stack([envelope.mean(axis=1), lines]))


def test_the_level_is_that_of_the_mesh():
    X = torque(2, 600)
    assert WaveletEnvelopeSpectrum(RATE).fit(X).level_ == 7
    assert WaveletEnvelopeSpectrum(12_800).fit(X).level_ == 6
    # Samples per turn: 16 pins are the lower limit of the level from 2048/128 to 2048/64.
    assert WaveletEnvelopeSpectrum(2048, shaft_hz=1.0).fit(X).level_ == 6


def test_a_modulated_mesh_is_found_at_its_harmonic():
    time = np.arange(46_080) / RATE
    for harmonic in (1, 2):
        swing = 1 + 0.5 * np.cos(2 * np.pi * harmonic * 8.37 * time)  # 0.4 % fast
        x = 22 + 2 * swing * np.sin(2 * np.pi * 16 * 8.37 * time)
        features = WaveletEnvelopeSpectrum(RATE).fit_transform(x[np.newaxis])[0]
        lines = features[1:8]  # harmonic 8 is the image's
        assert np.argmax(lines) == harmonic - 1
        assert lines.max() == pytest.approx(1.0, abs=0.1)
        assert features[0] == pytest.approx(2.0, abs=0.1)


@every_transformer
def test_one_transform_serves_all(transformer):
    """A composite hands over a transform that may be deeper than needed: the same to the last bit."""
    X, y = torque(4, 6000), [0, 1, 2, 2]
    fitted = clone(transformer).fit(X, y)
    deeper = dwt(X, transformer.wavelet, fitted._deepest_level() + 3)
    assert_array_equal(fitted._from_coefficients(X, deeper), fitted.transform(X))


@every_transformer
def test_any_form_of_a_wavelet_gives_the_same(transformer):
    X = torque(3, 6000)
    filters = as_wavelet(transformer.wavelet).filter_bank
    whole = clone(transformer).fit(X).transform(X)
    for form in (as_wavelet(filters), filters, np.array(filters)):
        assert_array_equal(clone(transformer).set_params(wavelet=form).fit(X).transform(X), whole)


@settings(derandomize=True, deadline=None, database=None, max_examples=8)
@given(st.floats(0.01, 100), st.floats(-30, 30))
def test_scale_and_mean(scale, offset):
    """Nm grow with the torque, pure numbers do not; the mean counts for nothing."""
    X = torque(3, 3000)
    for transformer in WAVELET[2:]:
        fitted = clone(transformer).fit(X)
        before, after = fitted.transform(X), fitted.transform(scale * X + offset)
        names = fitted.get_feature_names_out().astype(str)
        in_nm = np.char.find(names, "_nm(") >= 0
        cells = np.char.find(names, "colours") >= 0
        assert_allclose(after[:, in_nm], scale * before[:, in_nm], rtol=1e-6, atol=1e-9)
        assert_allclose(after[:, cells], before[:, cells], atol=2e-3)
        pure = ~in_nm & ~cells
        assert_allclose(after[:, pure], before[:, pure], rtol=1e-6)
