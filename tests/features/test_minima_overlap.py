"""Overlap of minima with the worst class: the recipe written out, alignment, reference, simulated torque."""

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from cyclofeat.datasets import make_rig_recordings
from cyclofeat.features import WaveletLevelStatistics, WaveletMinimaOverlap
from cyclofeat.signal.wavelets import as_wavelet, dwt, scalogram
from cyclofeat.simulators import Rig

RATE = 25_600
PERIOD = RATE / (500 / 60 * 16 / 15)  # 2880 samples


def torque(n_windows: int, n_samples: int, seed: int = 3, starts=None, noise: float = 0.03) -> np.ndarray:
    """Noise, and a burst in two lobes' slots of each lobe period."""
    rng = np.random.default_rng(seed)
    starts = rng.uniform(0, PERIOD, n_windows) if starts is None else np.asarray(starts)
    slot = (starts[:, np.newaxis] + np.arange(n_samples)) / (PERIOD / 15) % 15
    bursts = sum(np.exp(-(((slot - at) * 8) ** 2)) for at in (3.5, 5.5)) * (
        1 + np.cos(2 * np.pi * 9.3 * slot)
    )
    return 22 + 2 * bursts + rng.normal(scale=noise, size=bursts.shape)


def overlap(**parameters) -> WaveletMinimaOverlap:
    return WaveletMinimaOverlap(**{"sampling_rate": RATE, "levels": 6, "wavelet": "db4"} | parameters)


def test_overlap_against_brute_force():
    """The literal recipe: both pictures written out cell by cell, the median of the shares."""
    X, y = torque(9, 203), np.array([1, 2, 2, 0, 2, 1, 2, 2, 0])
    bank = as_wavelet("db4")
    dark = []
    for x in X:
        details = naive.dwt_details(x, bank.dec_lo, bank.dec_hi, 6)
        pictures = [naive.colours(naive.cells(d, level, 203), 16) for level, d in enumerate(details, 1)]
        dark.append([[colour == 1 for colour in row] for row in pictures])
    got = overlap(align="none", colours=16).fit(X, y).transform(X)
    reference = [1, 2, 4, 6, 7]
    for i, features in enumerate(got):
        for level in range(6):
            shares = [
                sum(a and b for a, b in zip(dark[i][level], dark[r][level], strict=True)) / 203
                for r in reference
                if r != i
            ]
            assert features[level] == pytest.approx(np.median(shares), abs=1e-12)


def test_aligned_overlap_against_the_pictures():
    """Cells from the border of coefficients that is nearest to the lobe phase on, over whole coefficients."""
    n_samples, levels = 9000, 9
    X = torque(4, n_samples)
    fitted = overlap(levels=levels, wavelet="mb32.3").fit(X[:3])
    starts = fitted._phase_starts(X, None)
    assert len(set(starts)) > 1
    masks = scalogram(X, levels=levels) == 1
    lengths = [detail.shape[1] for detail in dwt(X, levels=levels)]
    left = n_samples - int(np.ceil(PERIOD / 0.985))
    for level in range(1, levels + 1):
        size = 2**level
        cut = (lengths[level - 1] * size - n_samples) // 2
        parts = []
        for mask, start in zip(masks[:, level - 1], starts, strict=True):
            # Borders of coefficients, in cells of the window; cells beyond its end belong to its last one.
            borders = np.arange(0, n_samples + 3 * size, size) - cut % size
            at = borders[np.argmin(np.abs(borders - start - 1e-6))]
            middles = at + size // 2 + size * np.arange(max(left // size, 1))
            parts.append(mask[np.clip(middles, 0, n_samples - 1)])
        expected = np.median([np.mean(parts[3] & parts[reference]) for reference in range(3)])
        assert fitted.transform(X[3:])[0, level - 1] == pytest.approx(expected, abs=1e-12)


# Alignment


def test_aligned_overlap_does_not_depend_on_the_start_of_the_window():
    """Level 3 and 4 of windows that begin anywhere, against a reference that begins elsewhere."""
    X = torque(12, 23_040, starts=np.linspace(0, PERIOD, 12), noise=0.003)
    reference = torque(8, 23_040, seed=9, starts=np.zeros(8), noise=0.003)
    for levels in (3, 4):
        aligned = overlap(levels=levels).fit(reference).transform(X)[:, -1]
        loose = overlap(levels=levels, align="none").fit(reference).transform(X)[:, -1]
        assert np.ptp(aligned) < 0.25 * np.ptp(loose)
        # Bursts lie upon bursts: more of what is quiet is quiet in both.
        assert aligned.min() > np.median(loose) + 0.05


def test_starts_are_the_lobe_phase():
    starts = np.array([0.0, 400.0, 1500.0, 2800.0])
    found = overlap().fit(torque(2, 23_040))._phase_starts(torque(4, 23_040, starts=starts), None)
    # The bursts' centre, slot 4.5, comes 4.5 * 192 samples after the start of the period.
    expected = (4.5 * PERIOD / 15 - starts) % PERIOD
    off = (found - expected + PERIOD / 2) % PERIOD - PERIOD / 2
    assert np.abs(off).max() < PERIOD / 15 / 4


def test_short_windows_are_not_aligned():
    X = torque(4, 5759)  # a sample less than two lobe periods
    assert overlap().fit(X)._phase_starts(X, None) is None
    assert_array_equal(overlap().fit_transform(X), overlap(align="none").fit_transform(X))
    X = torque(4, 5760)
    assert overlap().fit(X)._phase_starts(X, None) is not None


@pytest.mark.parametrize("levels", [1, 12, 20])
def test_any_number_of_levels_can_be_aligned(levels):
    X = torque(3, 6000)
    features = overlap(levels=levels, speed_tolerance=0.15).fit_transform(X)
    assert features.shape == (3, levels)
    assert ((features >= 0) & (features <= 1)).all()


# Reference


def test_reference_is_the_largest_label():
    X = torque(6, 400)
    numbers, words = [0, 10, 9, 10, 0, 9], ["a", "c", "b", "c", "a", "b"]
    for labels, worst in ((numbers, 10), (words, "c"), (np.array(numbers, dtype=float), 10.0)):
        fitted = overlap().fit(X, labels)
        assert fitted.reference_class_ == worst
        assert [len(minima) for minima in fitted.reference_minima_] == [2] * 6
        assert_array_equal(fitted.transform(X), overlap().fit(X, numbers).transform(X))


def test_reference_by_label_or_without_labels():
    X, y = torque(6, 400), [7, 7, 8, 8, 0, 0]
    by_label = overlap(reference=7).fit(X, y)
    assert by_label.reference_class_ == 7
    assert_array_equal(by_label.transform(X), overlap().fit(X[:2]).transform(X))
    assert overlap().fit(X).reference_class_ is None
    assert by_label.get_feature_names_out()[0] == "minima_overlap(db4;64colours;energy;7;level01;v2)"
    named = overlap(reference="worn (5, x)").fit(X, ["worn (5, x)"] * 6)
    assert named.get_feature_names_out()[0] == "minima_overlap(db4;64colours;energy;worn__5__x_;level01;v2)"


def test_a_window_is_not_compared_with_itself():
    X = torque(4, 300)
    fitted = overlap().fit(X)
    for i in range(4):
        expected = overlap().fit(np.delete(X, i, axis=0)).transform(X[[i]])
        assert_array_equal(fitted.transform(X[[i]]), expected)
    # Off by a rounding it is another window.
    moved = X.copy()
    moved[:, 150] *= 1 + 1e-15
    assert (fitted.transform(moved) >= fitted.transform(X)).all()
    assert (fitted.transform(moved) > fitted.transform(X)).any()


def test_the_only_window_in_the_reference_is_compared_with_itself():
    X = torque(1, 300)
    extent = WaveletLevelStatistics(RATE, wavelet="db4", levels=6).fit_transform(X)[:, -6:]
    assert_allclose(overlap().fit_transform(X), extent, rtol=1e-12)


@pytest.mark.parametrize(
    ("parameters", "y", "message"),
    [
        ({"reference": 3}, [1, 2, 2], "reference must be 'worst' or a label in y \\(1, 2\\), got 3"),
        ({"reference": 3}, None, "reference=3 is a label of y, but fit was given no y"),
        ({"input_speed_hz": 1000.0}, None, "sampling_rate=25600 .* placing 15 lobes .* align='none'"),
        ({"wavelet": "db99"}, None, "wavelet must be .* got 'db99'"),
        ({"align": "start"}, None, "'align' parameter .* Got 'start'"),
    ],
)
def test_bad_parameters(parameters, y, message):
    with pytest.raises(ValueError, match=message):
        overlap(**parameters).fit(torque(3, 100), y)


# Properties


@settings(derandomize=True, deadline=None, database=None, max_examples=8)
@given(st.floats(0.01, 100), st.floats(-50, 50))
def test_overlap_depends_neither_on_scale_nor_on_mean(scale, offset):
    X = torque(5, 6000)
    before = overlap().fit(X[1:]).transform(X)
    after = overlap().fit(scale * X[1:] + offset).transform(scale * X + offset)
    # A coefficient may pass the border of its colour by rounding.
    assert_allclose(after, before, atol=2e-3)


# Simulated torque


@pytest.fixture(scope="module")
def simulated():
    """One assembly each of 1, 4 and 7 worn lobes in both wheels on the papers' free output, without noise."""
    recordings = make_rig_recordings(
        1, (1, 4, 7), rig=Rig.r0().without("noise"), random_state=2, duration=2.2, wheels=(0, 1), n_jobs=2
    )
    torques = np.stack([recording.torque for recording in recordings])
    counts = np.array([recording.defect_count for recording in recordings])
    return torques[:, :46_080], torques[:, 7777 : 7777 + 46_080], counts


@pytest.mark.slow
def test_the_worst_class_overlaps_most_with_itself(simulated):
    """A later window of the reference's recording shares more minima than windows of other recordings do.

    At every level from 1 to 6 and, 2.7 lobe periods later, because of the alignment. It is one case that
    works: both wheels worn, no noise. With wear in one wheel the reference has few minima, and a recording
    with more of them shares more, whatever its count.
    """
    early, late, counts = simulated
    for worst in np.flatnonzero(counts == 7):
        others = np.vstack([np.delete(early, worst, axis=0), np.delete(late, worst, axis=0)])
        aligned = overlap(wavelet="mb32.3").fit(early[[worst]])
        assert (aligned.transform(late[[worst]]) > aligned.transform(others).max(axis=0)).all()
        loose = overlap(wavelet="mb32.3", align="none").fit(early[[worst]])
        assert (loose.transform(late[[worst]]) < loose.transform(others).max(axis=0)).all()
