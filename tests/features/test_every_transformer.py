"""Parameters and bad windows of every transformer."""

import pickle

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from transformers import SPECTRAL, STATISTICS, WAVELET, torque

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
    np.testing.assert_array_equal(pickle.loads(before).transform(X), result)


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
