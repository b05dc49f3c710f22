"""Parameters, chunks and bad windows of every transformer."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal
from sklearn import config_context
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from transformers import SAMPLING_RATE, SPECTRAL, STATISTICS, WAVELET, torque

from cyclofeat.features import LobeMap, SpectralRolloff, TorqueFeatures
from cyclofeat.features.base import ShortWindowWarning, reject_short_windows

every_transformer = pytest.mark.parametrize(
    "transformer", STATISTICS + SPECTRAL + WAVELET, ids=lambda t: repr(t)[:60]
)


@every_transformer
def test_parameters_are_stored_untouched_and_transform_writes_nothing(transformer):
    X = torque(3, 500)
    X.flags.writeable = False
    parameters = transformer.get_params(deep=False)
    made = type(transformer)(**parameters).fit(X)
    before = pickle.dumps(made)
    result = made.transform(X)
    made.get_feature_names_out()
    assert pickle.dumps(made) == before
    for name, value in parameters.items():
        assert getattr(made, name) is value
    assert_array_equal(pickle.loads(before).transform(X), result)


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


@every_transformer
def test_bad_windows(transformer):
    X = torque(3, 100)
    with pytest.raises(NotFittedError):
        clone(transformer).transform(X)
    fitted = clone(transformer).fit(X)
    for bad in (np.nan, np.inf):
        broken = X.copy()
        broken[1, 7] = bad
        for method in (clone(transformer).fit, fitted.transform):
            with pytest.raises(ValueError, match=r"Input X contains (NaN|infinity)"):
                method(broken)
    with pytest.raises(ValueError, match=r"X has 99 features, but .* is expecting 100 features"):
        fitted.transform(X[:, :99])
    with pytest.raises(ValueError, match="Expected 2D array, got 1D array"):
        fitted.transform(X[0])


@pytest.mark.parametrize("transformer", [LobeMap(SAMPLING_RATE), TorqueFeatures(SAMPLING_RATE)])
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
    assert issubclass(ShortWindowWarning, UserWarning)


def test_defaults_describe_the_ripple():
    X = torque(4, 46_080)
    assert np.ptp(SpectralRolloff(SAMPLING_RATE).fit_transform(X)) > 100
    assert (SpectralRolloff(SAMPLING_RATE, preset="matlab_pwelch").fit_transform(X) == 3.125).all()
