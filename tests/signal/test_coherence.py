"""Coherence against scipy and GNU Octave; the transformer's references, bands and labels."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal
from scipy import signal
from sklearn.pipeline import make_pipeline

from cyclofeat.features import CoherenceToReference, HighPass
from cyclofeat.signal import magnitude_squared_coherence, octave_bands
from cyclofeat.signal.welch import without_rounding

SAMPLING_RATE = 25_600
ORACLES = Path(__file__).parents[1] / "oracles"


def torque(n_windows: int, n_samples: int, seed: int = 0) -> np.ndarray:
    """Windows of 22 Nm that share a mesh line under noise."""
    rng = np.random.default_rng(seed)
    mesh = np.sin(2 * np.pi * 400 * np.arange(n_samples) / SAMPLING_RATE)
    return 22 + mesh + rng.normal(size=(n_windows, n_samples))


# The function


@pytest.mark.parametrize("n_samples", [1500, 1152, 90])
def test_coherence_against_octave(n_samples):
    x, reference = (
        np.loadtxt(ORACLES / name)[:n_samples] for name in ("pwelch_input.csv", "mscohere_reference.csv")
    )
    with (ORACLES / "mscohere_coherence.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if int(row["n_samples"]) == n_samples]
    frequencies, coherence = magnitude_squared_coherence(x, reference, SAMPLING_RATE)
    assert_allclose(frequencies, [float(row["frequency_hz"]) for row in rows], rtol=1e-15)
    assert_allclose(coherence, [float(row["coherence"]) for row in rows], rtol=1e-10)


def test_coherence_is_scipys_with_explicit_arguments():
    X, Y = torque(3, 9000, 1), torque(3, 9000, 2)
    _, expected = signal.coherence(
        X, Y, SAMPLING_RATE, signal.windows.hamming(2000), noverlap=1000, nfft=2048, detrend=False
    )
    _, coherence = magnitude_squared_coherence(X, Y, SAMPLING_RATE)
    assert_allclose(coherence, expected, rtol=1e-8)
    _, with_one = magnitude_squared_coherence(X, Y[1], SAMPLING_RATE)
    assert_allclose(with_one[1], expected[1], rtol=1e-8)
    _, cube = magnitude_squared_coherence(X[:, np.newaxis], Y[:, np.newaxis], SAMPLING_RATE)
    assert_allclose(cube[:, 0], coherence)


def test_a_window_and_itself_or_its_multiple_have_coherence_one():
    x = torque(1, 3000)[0]
    assert_allclose(magnitude_squared_coherence(x, x, SAMPLING_RATE)[1], 1, rtol=1e-12)
    assert_allclose(magnitude_squared_coherence(x, -3 * x, SAMPLING_RATE)[1], 1, rtol=1e-12)
    assert magnitude_squared_coherence(x, x, SAMPLING_RATE)[1].max() <= 1


def test_lines_without_power_have_coherence_zero():
    x = torque(1, 1152)[0]
    assert_array_equal(magnitude_squared_coherence(x, np.zeros(1152), SAMPLING_RATE)[1], 0)
    # Segments of two equal samples have no power at half of the sampling rate.
    _, coherence = magnitude_squared_coherence(np.ones(9), np.ones(9), SAMPLING_RATE)
    assert_allclose(coherence, np.repeat([1.0, 0.0], [128, 1]), rtol=1e-12)


def test_lines_of_nothing_but_rounding_have_no_power():
    powers = np.array([[3.0, 2e-26, 2e-30], [0.0, 0.0, 0.0], [1e-40, 1e-50, 1e-70]])
    assert_array_equal(without_rounding(powers), [[3.0, 2e-26, 0.0], [0.0] * 3, [1e-40, 1e-50, 0.0]])


@pytest.mark.parametrize("n_samples", [1, 2, 8])
def test_windows_too_short_for_segments(n_samples):
    x, y = torque(2, n_samples)
    _, coherence = magnitude_squared_coherence(x, y, SAMPLING_RATE)
    assert_allclose(coherence, (x @ y) ** 2 / (x @ x) / (y @ y), rtol=1e-10)


def test_single_precision_and_chunks():
    X, y = torque(150, 2000).astype(np.float32), torque(1, 2000, 3)[0]  # more than is worked on at one time
    whole = magnitude_squared_coherence(X, y, SAMPLING_RATE)[1]
    assert_array_equal(magnitude_squared_coherence(X.astype(np.float64), y, SAMPLING_RATE)[1], whole)
    alone = [magnitude_squared_coherence(x, y, SAMPLING_RATE)[1] for x in X]
    assert_allclose(alone, whole, rtol=1e-10)


@pytest.mark.parametrize(
    ("x", "reference", "message"),
    [
        (np.ones((2, 9)), np.ones(8), r"shape of x, \(2, 9\), or of one of its windows, \(9,\); got \(8,\)"),
        (np.ones((2, 9)), np.ones((1, 9)), r"got \(1, 9\)"),
        (np.ones(9), np.full(9, np.nan), "finite"),
    ],
)
def test_bad_windows(x, reference, message):
    with pytest.raises(ValueError, match=message):
        magnitude_squared_coherence(x, reference, SAMPLING_RATE)


derandomized = settings(derandomize=True, deadline=None, database=None, max_examples=15)
samples = st.integers(-100_000, 100_000).map(lambda number: number / 1024)
pairs = st.integers(1, 80).flatmap(lambda n: arrays(np.float64, (2, n), elements=samples))


@derandomized
@given(pair=pairs, scale=st.sampled_from([0.25, -2.0, 1024.0]))
def test_coherence_is_bounded_symmetric_and_free_of_scale(pair, scale):
    x, y = pair
    _, coherence = magnitude_squared_coherence(x, y, SAMPLING_RATE)
    assert (coherence >= 0).all()
    assert (coherence <= 1).all()
    assert_allclose(magnitude_squared_coherence(y, x, SAMPLING_RATE)[1], coherence, atol=1e-12)
    assert_allclose(magnitude_squared_coherence(x * scale, y, SAMPLING_RATE)[1], coherence, atol=1e-12)


# The transformer


def test_feature_is_the_median_over_references_of_the_mean_in_the_band():
    X = torque(6, 4000)
    y = ["healthy", "worn", "healthy", "worn", "healthy", "worn"]
    bands = [(0.0, 1000.0), (350.0, 450.0)]
    transformer = CoherenceToReference(SAMPLING_RATE, bands=bands).fit(X, y)
    assert_array_equal(transformer.references_, X[::2])
    result = transformer.transform(X)
    for row, x in zip(result, X, strict=True):
        means = []
        for reference in X[::2]:
            if not np.array_equal(reference, x):
                frequencies, coherence = magnitude_squared_coherence(x, reference, SAMPLING_RATE)
                inside = [(frequencies >= low) & (frequencies <= high) for low, high in bands]
                means.append([coherence[lines].mean() for lines in inside])
        assert len(means) in (2, 3)
        assert_allclose(row, np.median(means, axis=0), rtol=1e-10)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_reference_is_known_again_in_another_precision(dtype):
    X = torque(3, 2000)
    fitted = CoherenceToReference(SAMPLING_RATE, reference="first").fit(X.astype(np.float32))
    expected = CoherenceToReference(SAMPLING_RATE, reference="first").fit(X).transform(X)
    assert_allclose(fitted.transform(X.astype(dtype)), expected, rtol=1e-4)


def test_a_reference_is_known_again_behind_a_filter():
    X = torque(3, 2000)
    pipeline = make_pipeline(HighPass(SAMPLING_RATE, 50.0), CoherenceToReference(SAMPLING_RATE))
    assert pipeline.fit_transform(X).max() < 0.9  # with itself it would be 1


def test_which_windows_become_references():
    X = torque(30, 50)
    letters = np.tile(["b", "a", "c"], 10)
    chosen = {
        "healthy, 0 is smallest": ("healthy", np.tile([2, 0, 1], 10), X[1::3]),
        "healthy, by its name": ("healthy", np.tile(["z", "a", "healthy"], 10), X[2::3]),
        "healthy, first letter": ("healthy", letters, X[1::3]),
        "no labels": ("healthy", None, X),
        "a label": ("c", letters, X[2::3]),
        "a number": (2, np.tile([2, 0, 1], 10), X[::3]),
    }
    for case, (reference, y, candidates) in chosen.items():
        references = CoherenceToReference(SAMPLING_RATE, reference=reference).fit(X, y).references_
        assert references.shape == (8, 50), case
        rows = [int(np.flatnonzero((candidates == reference).all(1))[0]) for reference in references]
        # evenly spread, from the first to the last
        assert rows[0] == 0, case
        assert rows[-1] == len(candidates) - 1, case
        assert np.ptp(np.diff(rows)) <= 1, case
    first = CoherenceToReference(SAMPLING_RATE, reference="first").fit(X, letters)
    assert_array_equal(first.references_, X[:8])
    few = CoherenceToReference(SAMPLING_RATE).fit(X[:4], letters[:4])
    assert_array_equal(few.references_, X[1:2])


@pytest.mark.parametrize(
    ("reference", "y", "message"),
    [
        (7, [0, 1, 2], r"reference must be 'healthy' or a label in y \(0, 1, 2\), got 7"),
        ("worn", [0, 1, 2], "got 'worn'"),
        (3, None, "reference=3 is a label of y, but fit was given no y"),
        ("healthy", [0, 1], "inconsistent numbers of samples"),
    ],
)
def test_bad_references(reference, y, message):
    with pytest.raises(ValueError, match=message):
        CoherenceToReference(SAMPLING_RATE, reference=reference).fit(torque(3, 50), y)


def test_bands_by_default_reach_beyond_the_papers_1500_hz():
    names = CoherenceToReference(SAMPLING_RATE).fit(torque(3, 50)).get_feature_names_out()
    assert names[0] == "coherence(mscohere;healthy;0..100Hz)"
    assert names[-1] == "coherence(mscohere;healthy;800..1600Hz)"
    assert len(names) == len(octave_bands(SAMPLING_RATE)) - 3
    odd = CoherenceToReference(SAMPLING_RATE, reference="a, b [2]").fit(torque(2, 50), ["a, b [2]", "c"])
    assert odd.get_feature_names_out()[0] == "coherence(mscohere;a__b__2_;0..100Hz)"


def test_without_another_reference_or_power_there_is_no_coherence():
    X = torque(2, 500)
    transformer = CoherenceToReference(SAMPLING_RATE).fit(X, [0, 1])
    assert_array_equal(transformer.transform(X)[0], 0)
    assert (transformer.transform(X)[1] > 0).all()
    assert_array_equal(transformer.transform(np.zeros((1, 500))), 0)
