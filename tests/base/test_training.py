"""Parts of the training of networks."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat._base.training import import_jax, make_dropout


@pytest.mark.slow
def test_dropout_takes_the_same_units_at_all_places_of_a_sample_and_keeps_the_mean() -> None:
    jax, _, _ = import_jax()
    keys = iter(jax.random.split(jax.random.PRNGKey(0), 2))
    thinned = make_dropout(0.25, keys)
    of_places = np.asarray(thinned(np.ones((400, 7, 50), dtype=np.float32)))
    of_samples = np.asarray(thinned(np.ones((400, 50), dtype=np.float32)))
    np.testing.assert_array_equal(of_places, np.repeat(of_places[:, :1], 7, axis=1))
    for kept in (of_places[:, 0], of_samples):
        np.testing.assert_allclose(np.unique(kept), [0, 4 / 3], rtol=1e-6)
        # Other units in other samples.
        share_of_samples = (kept > 0).mean(axis=0)
        assert share_of_samples.min() > 0
        assert share_of_samples.max() < 1
        # Standard deviation of the mean of 20,000 units: 4/3 sqrt(0.25 * 0.75 / 20000) = 0.004.
        assert abs(kept.mean() - 1) < 0.016
