"""Parameters, chunks and bad windows of every transformer."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal
from sklearn import config_context
from sklearn.base import clone
from transformers import RATE, SPECTRAL, STATISTICS, WAVELET, torque

from cyclofeat import features as f
from cyclofeat.features.base import reject_short_windows

every_transformer = pytest.mark.parametrize(
    "transformer", STATISTICS + SPECTRAL + WAVELET, ids=lambda t: repr(t)[:60]
)


@every_transformer
def test_chunks_and_memory_order_change_nothing(transformer):
    # 220: more than the functions of windows work on at one time
    X = torque(9, 6000) if transformer in WAVELET else torque(220, 600)
    y = np.arange(len(X)) % 2
    whole = clone(transformer).fit(X, y).transform(X)
    assert_array_equal(clone(transformer).fit(np.asfortranarray(X), y).transform(np.asfortranarray(X)), whole)
    tolerance = {"rtol": 1e-9, "atol": 1e-12} if transformer in SPECTRAL else {"rtol": 1e-12}
    with config_context(working_memory=len(X) / 4.1 * X.shape[1] / 2**17):  # five chunks
        assert_allclose(clone(transformer).fit(X, y).transform(X), whole, **tolerance)


samples = st.integers(-100_000, 100_000).map(lambda number: number / 1024)


@every_transformer
@settings(derandomize=True, deadline=None, database=None, max_examples=5)
@given(X=st.integers(1, 60).flatmap(lambda n: arrays(np.float64, (4, n), elements=samples)))
def test_batch_is_one_by_one_and_order_does_not_matter(transformer, X):
    fitted = clone(transformer).fit(X)
    batch = fitted.transform(X)
    assert np.isfinite(batch).all()
    tolerance = {"rtol": 1e-9, "atol": 1e-9 if transformer in SPECTRAL else 1e-12}
    assert_allclose(np.vstack([fitted.transform(x[np.newaxis]) for x in X]), batch, **tolerance)
    assert_allclose(fitted.transform(X[::-1])[::-1], batch, **tolerance)


@every_transformer
def test_sampling_rate_is_required_and_checked(transformer):
    with pytest.raises(TypeError, match="sampling_rate"):
        type(transformer)()
    for bad in (0, -1, np.nan, np.inf, "25600"):
        with pytest.raises(ValueError, match=f"'sampling_rate' parameter of .* Got '?{bad}'? instead"):
            clone(transformer).set_params(sampling_rate=bad).fit(torque(2, 100))


@pytest.mark.parametrize(
    ("transformer", "message"),
    [
        (
            f.SpectralEntropy(RATE, band=(0, 13_000)),
            r"\(0, 13000\) Hz reaches beyond the highest .* 12800 Hz",
        ),
        (f.NarrowbandRatio(RATE, n_harmonics=129), "harmonic 129 .* 12900 Hz"),
        (f.BandPower(RATE, bands=[(0, 100), (500, 400)]), r"got \(500, 400\)"),
        (f.BandPower(RATE, bands=()), r"got \(\)"),
        (f.WelchPSD(RATE, band=(0, 13_000)), "beyond the highest frequency"),
        (f.CoherenceToReference(RATE, bands=[(0, 13_000)]), "beyond the highest frequency, 12800 Hz"),
        (f.AmplitudeSpectrum(RATE, n_fft=7), "n_fft must be even, got 7"),
        (f.AmplitudeSpectrum(RATE, band=(1, 2)), "none of the 4097 spectral lines"),
        (f.HighPass(RATE, cutoff_hz=12_800.0), r"half of the sampling rate \(12800 Hz\), got 12800"),
        (f.WaveletLevelStatistics(RATE, wavelet="morl"), "wavelet must be a discrete wavelet .* got 'morl'"),
        (f.WaveletLevelStatistics(RATE, wavelet=[[1, 1], [1, -1]]), "four filters"),
        (f.WaveletEnvelopeSpectrum(200), "mesh .* = 133.333 must lie below half of sampling_rate=200"),
        (f.WaveletEnvelopeSpectrum(RATE, n_mesh_harmonics=6), "n_mesh_harmonics=6 reaches 812 Hz, .* most 5"),
        (f.WaveletEnvelopeSpectrum(RATE, n_shaft_harmonics=99), "n_shaft_harmonics=99 reaches .* at most 94"),
    ],
    ids=str,
)
def test_bad_parameters_are_quoted_by_fit(transformer, message):
    with pytest.raises(ValueError, match=message):
        transformer.fit(torque(2, 100))


@every_transformer
def test_constant_windows(transformer):
    for n_samples, value in itertools.product((1, 2, 8, 9, 50, 6000), (0.0, 22.1, -3.0)):
        X = np.full((3, n_samples), value)
        fitted = clone(transformer).fit(X)
        result = fitted.transform(X)
        assert np.isfinite(result).all(), (n_samples, value)
        expected = -300.0 if getattr(transformer, "decibels", False) else 0.0
        if transformer in WAVELET:
            names = fitted.get_feature_names_out()
            expected = [float(name.startswith(("minima_overlap", "wavelet_lowest"))) for name in names]
        elif value or isinstance(transformer, f.TorqueFeatures | f.TorqueStatistics):
            continue
        assert_allclose(result, np.broadcast_to(expected, result.shape), rtol=1e-12)


@every_transformer
def test_single_precision(transformer):
    # Rounded to 24 bits, 22 Nm moves by up to 1e-6 Nm, here 1e-6 of the ripple; some cells in a thousand may
    # change their colour.
    X, y = torque(5, 6000), None if transformer in WAVELET else [0, 0, 0, 1, 1]
    fitted = clone(transformer).fit(X, y)
    double = fitted.transform(X)
    single = clone(transformer).fit(X.astype(np.float32), y).transform(X.astype(np.float32))
    assert single.dtype == np.float64
    cells = np.char.find(fitted.get_feature_names_out().astype(str), "colours") >= 0
    assert_allclose(single[:, cells], double[:, cells], atol=2e-3)
    near = {"rtol": 1e-5, "atol": 1e-6} if transformer in STATISTICS else {"rtol": 1e-4, "atol": 1e-6}
    if transformer in SPECTRAL:
        near["atol"] = 1e-4 * np.abs(double).max(initial=1)
    assert_allclose(single[:, ~cells], double[:, ~cells], **near)


@pytest.mark.parametrize("transformer", [f.LobeMap(RATE), f.TorqueFeatures(RATE)])
def test_windows_that_are_too_short_are_told_once_and_are_an_error_in_training(transformer):
    words = r"needs windows of at least 23040 samples \(.*half an output turn\), got 3: .* little"
    turned = torque(3, 23_040).T[:2000]
    for method in (clone(transformer).fit, clone(transformer).fit(turned).transform):
        with pytest.warns(UserWarning, match=words + r"; is X, of shape \(2000, 3\), transposed\?") as told:
            method(turned)
        assert len(told) == 1
    with reject_short_windows(), pytest.raises(ValueError, match=words + "$"):
        clone(transformer).fit(torque(2, 3))
    with reject_short_windows():
        clone(transformer).fit(torque(2, 23_040))
