"""The tables hold what the article prints, and the relations that it states between the numbers."""

from __future__ import annotations

import numpy as np
import pytest

from cyclofeat.datasets import load_published_tables


@pytest.fixture
def tables():
    return load_published_tables()


def test_every_table_has_one_row_per_disc(tables):
    names = {"signal_statistics", "spectral_centroid", "spectral_entropy"}
    assert set(tables) == names | {"DESCR"}
    for name in names:
        assert tables[name]["defect_count"].tolist() == list(range(8))


def test_statistics_agree_with_each_other(tables):
    found = tables.signal_statistics
    assert found.dtype.names == ("defect_count", "min_nm", "max_nm", "mean_nm", "std_nm", "range_nm")
    # printed to four digits
    np.testing.assert_allclose(found["range_nm"], found["max_nm"] - found["min_nm"], atol=0.011)
    assert np.all((found["min_nm"] < found["mean_nm"]) & (found["mean_nm"] < found["max_nm"]))
    assert np.all(found["std_nm"] < found["range_nm"] / 2)
    assert found["std_nm"].argmin() == 0  # the healthy disc


def test_entropy_falls_from_one_to_seven_worn_lobes(tables):
    entropy = tables.spectral_entropy["entropy_bits"]
    assert np.all(np.diff(entropy[1:]) < 0)
    assert entropy.argmin() == 0
    assert entropy[[0, 7]].tolist() == [1.6838, 1.7241]


def test_entropy_restates_the_statistics(tables):
    # The share of the ripple in the power, a, gives all eight entropies with two fitted constants.
    statistics = tables.signal_statistics
    a = statistics["std_nm"] ** 2 / (statistics["mean_nm"] ** 2 + statistics["std_nm"] ** 2)
    binary = -a * np.log2(a) - (1 - a) * np.log2(1 - a)
    assert np.max(np.abs(1.534 + 1.174 * binary - tables.spectral_entropy["entropy_bits"])) < 0.0095


def test_centroid_shows_no_order(tables):
    steps = np.diff(tables.spectral_centroid["centroid"])
    assert (steps > 0).any()
    assert (steps < 0).any()


def test_the_description_gives_the_origin(tables):
    for words in (
        "Verification of the cycloidal gear train fault diagnosis methods",
        "one recording per disc",
        "Nm",
    ):
        assert words in tables.DESCR


def test_a_change_to_one_copy_leaves_the_next_alone(tables):
    tables.spectral_entropy["entropy_bits"][:] = 0
    assert load_published_tables().spectral_entropy["entropy_bits"][0] == 1.6838
