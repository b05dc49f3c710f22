"""Searches: what they find, how often chance does, and what they refuse."""

import numpy as np
import pytest
import pywt
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import f_oneway, kendalltau

from cyclofeat.features import SpectralEntropy, WaveletMinimaOverlap
from cyclofeat.scans import Search, find_monotone_bands, scan_wavelets
from cyclofeat.scans._wavelet_scan import _kendall
from cyclofeat.signal import shannon_entropy, welch_psd
from cyclofeat.signal.wavelets import morris_names

RATE = 25_600
ENTROPY, RIPPLE = SpectralEntropy(RATE), SpectralEntropy(RATE, "ripple")
NO_CHANCE = Search(n_permutations=0)


def overlap(levels):
    return WaveletMinimaOverlap(RATE, levels=levels)


def bursts(counts, n_samples=8000, seed=0, noise=0.02):
    """A burst that grows with the count at each passage of one lobe, started anywhere."""
    rng = np.random.default_rng(seed)
    counts = np.asarray(counts)
    slot = (rng.uniform(0, 2880, (len(counts), 1)) + np.arange(n_samples)) / 192 % 15
    return (
        22 + counts[:, None] * np.exp(-(((slot - 3.5) * 8) ** 2)) + rng.normal(scale=noise, size=slot.shape)
    )


def tones(counts, seed=0, n_samples=4000):
    """Noise with a tone of 3 kHz that grows with the count."""
    rng = np.random.default_rng(seed)
    tone = np.sin(2 * np.pi * 3000 * np.arange(n_samples) / RATE)
    return 22 + rng.normal(size=(len(counts), n_samples)) + 0.1 * np.outer(counts, tone)


# Wavelets


def test_overlaps_are_those_of_the_transformer_without_the_own_assembly():
    y, groups = np.repeat([1, 2, 3], 4), np.repeat(np.arange(6), 2)
    X = bursts(y)
    scan = scan_wavelets(X, y, overlap(4), groups=groups, wavelets=["db3"], search=NO_CHANCE)
    overlaps = np.empty((12, 4))
    for i in range(12):
        others = X[(y == 3) & (groups != groups[i])]
        overlaps[i] = WaveletMinimaOverlap(RATE, "db3", levels=4).fit(others).transform(X[[i]])
    of_assembly = overlaps.reshape(6, 2, 4).mean(axis=1)
    of_class = of_assembly.reshape(3, 2, 4).mean(axis=1)
    assert scan.counts == (1.0, 2.0, 3.0)
    for row in scan.rows:
        column = of_class[:, row.level - 1]
        assert_allclose(row.class_means, column, rtol=1e-12)
        assert row.kendall == pytest.approx(kendalltau([1, 2, 3], column).statistic)
        assert row.strict == (np.diff(column) > 0).all()
        # Omega squared by its F: (k - 1)(F - 1) / ((k - 1)(F - 1) + n)
        f = f_oneway(*of_assembly[:, row.level - 1].reshape(3, 2)).statistic
        assert row.separability == pytest.approx(2 * (f - 1) / (2 * (f - 1) + 6), abs=1e-9)
        assert row.p_value is None


def test_scan_without_groups_ranks_by_monotony_alone():
    y = np.repeat([1, 2, 3, 5], 3)
    X = bursts(y)
    scan = scan_wavelets(X, y, overlap(3), wavelets=["db3", "mb8.2"])
    expected = WaveletMinimaOverlap(RATE, "mb8.2", levels=3).fit(X, y).transform(X)
    rows = {(row.wavelet, row.level): row for row in scan.rows}
    assert_allclose(rows["mb8.2", 2].class_means, expected[:, 1].reshape(4, 3).mean(axis=1), rtol=1e-12)
    assert all(row.separability is None and row.p_value is None for row in scan.rows)


def test_what_grows_is_found_and_separable():
    y, groups = np.repeat([1, 2, 3, 4, 5, 6], 2), np.arange(12)
    scan = scan_wavelets(
        bursts(y),
        y,
        overlap(6),
        groups=groups,
        wavelets=["db3", "haar"],
        search=Search(n_permutations=200),
    )
    first = scan.rows[0]
    assert first.kendall == 1.0
    assert first.strict
    assert first.separability > 0.9
    assert first.p_value < 0.05
    assert [row.kendall for row in scan.rows] == sorted((row.kendall for row in scan.rows), reverse=True)
    table = scan.to_frame()
    assert table.kendall.tolist() == [row.kendall for row in scan.rows]
    assert set(table) >= {"wavelet", "level", "kendall", "separability", "p_value"}


@pytest.mark.slow
def test_counts_that_mean_nothing_are_rarely_found():
    """Of 40 scans of pure noise at the 10 % level, 4 are expected; 10 would be beyond chance (p < 0.006)."""
    y, groups = np.repeat([0, 1, 2, 3, 4], 2), np.arange(10)
    found = 0
    for seed in range(40):
        X = bursts(np.zeros(10), n_samples=600, seed=seed)
        scan = scan_wavelets(
            X, y, overlap(3), groups=groups, wavelets=["db2", "db3"],
            search=Search(n_permutations=99, random_state=seed),
        )  # fmt: skip
        found += min(row.p_value for row in scan.rows) <= 0.1
        assert np.mean([row.separability for row in scan.rows]) < 0.6
    assert found < 10


def test_all_wavelets():
    y = [0, 0, 1, 1]
    done = []
    scan = scan_wavelets(
        bursts(y, n_samples=300), y, overlap(2), search=Search(progress=lambda i, n: done.append((i, n)))
    )
    assert done == [(i, 117) for i in range(1, 118)]
    assert len(scan.rows) == 234
    names = {row.wavelet for row in scan.rows}
    assert names == {*pywt.wavelist(kind="discrete"), *morris_names()}


def test_scan_in_processes_and_by_wavelets_of_any_form():
    y = np.repeat([1, 2], 3)
    X = bursts(y, n_samples=1000)
    forms = ["db2", pywt.Wavelet("db2"), [list(taps) for taps in pywt.Wavelet("db3").filter_bank]]
    one = scan_wavelets(X, y, overlap(2), wavelets=forms)
    two = scan_wavelets(X, y, overlap(2), wavelets=forms, search=Search(n_jobs=2))
    assert one == two
    first, second = (row.class_means for row in one.rows if row.wavelet == "db2" and row.level == 1)
    assert first == second


def test_an_assembly_that_changes_its_order_changes_nothing():
    y, groups = np.repeat([1, 2, 3], 6), np.repeat(np.arange(6), 3)
    X = bursts(y, n_samples=1000)
    order = np.random.default_rng(1).permutation(18)
    kwargs = {"overlap": overlap(3), "wavelets": ["db2"], "search": NO_CHANCE}
    before = scan_wavelets(X, y, groups=groups, **kwargs)
    after = scan_wavelets(X[order], y[order], groups=[f"rig-{g}" for g in groups[order]], **kwargs)
    # Which windows of an assembly are in the reference may differ, and so little more than that.
    for row, other in zip(before.rows, sorted(after.rows, key=lambda r: -r.kendall), strict=True):
        same = next(r for r in after.rows if r.level == row.level)
        assert_allclose(same.class_means, row.class_means, atol=0.05)
        assert other.separability is not None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"groups": [0, 0, 1, 1, 2, 2]}, "count 1, 2, 3 has one assembly: .* not its count"),
        ({"groups": [0, 1, 2, 3, 4, 0]}, "groups must name assemblies with one defect count each, but"),
        ({"groups": [0, 1]}, "inconsistent numbers of samples"),
        ({"y": [1] * 6}, r"at least two defect counts, finite, got \[1.0\]"),
        ({"y": list("aabbcc")}, "y must hold one defect count per window, as a number"),
        ({"wavelets": "db3"}, "wavelets must be 'all' or a sequence of wavelets, got 'db3'"),
        ({"wavelets": []}, "got an empty one"),
        ({"wavelets": ["db99"]}, "wavelet must be .* got 'db99'"),
        ({"overlap": overlap(0)}, "'levels' parameter .* Got 0"),
    ],
)
def test_bad_scans(change, message):
    arguments = {"y": [1, 1, 2, 2, 3, 3], "overlap": overlap(2), "wavelets": ["haar"]} | change
    with pytest.raises(ValueError, match=message):
        scan_wavelets(bursts([1, 1, 2, 2, 3, 3], n_samples=200), **arguments)


def test_kendall_is_scipys():
    rng = np.random.default_rng(0)
    means = rng.integers(0, 4, (6, 50)).astype(float)
    means[:, 0] = 3.0
    expected = [kendalltau(range(6), column).statistic for column in means.T]
    assert_allclose(_kendall(means), np.nan_to_num(expected), rtol=1e-12)


# Bands


@pytest.mark.parametrize("preset", ["matlab_pwelch", "ripple"])
def test_entropies_of_all_bands(preset):
    X = tones([1, 2])
    frequencies, psd = welch_psd(X, RATE, preset)
    # Edges on lines, between lines, and so close that some bands hold one line or none.
    edges = np.array([0.0, 25.0, 30.0, 100.0, 1234.5, 1250.0, 6400.0, 12_800.0])
    # An entropy that does not fall from one window to the other falls the other way.
    found = [
        find_monotone_bands(X, y, SpectralEntropy(RATE, preset), edges=edges, search=NO_CHANCE)
        for y in ([0, 1], [1, 0])
    ]
    entropies = dict(zip(map(tuple, found[0].bands), found[0].entropies, strict=True))
    entropies |= dict(zip(map(tuple, found[1].bands), found[1].entropies[:, ::-1], strict=True))
    tried = []
    for i, low in enumerate(edges):
        for upper in edges[i + 1 :]:
            if np.count_nonzero((frequencies >= low) & (frequencies <= upper)) >= 2:
                tried.append((low, upper))
                expected = shannon_entropy(psd, frequencies, (low, upper))
                assert_allclose(entropies[low, upper], expected, rtol=1e-9, atol=1e-12)
    assert sorted(entropies) == sorted(tried)
    assert found[0].n_tried == len(tried) < 28


def test_bands_that_fall_are_found():
    y, groups = np.repeat([1, 2, 4, 5], 3), np.repeat(np.arange(4), 3)
    X = tones(y)
    edges = [0, 2000, 2900, 3100, 5000, 12_800]
    found = find_monotone_bands(X, y, RIPPLE, groups=groups, edges=edges, search=Search(n_permutations=50))
    assert found.n_tried == 15
    assert found.counts.tolist() == [1, 2, 4, 5]
    frequencies, psd = welch_psd(X, RATE, "ripple")
    expected = []
    for i, low in enumerate(edges):
        for upper in edges[i + 1 :]:
            means = shannon_entropy(psd, frequencies, (low, upper)).reshape(4, 3).mean(axis=1)
            if (np.diff(means) < 0).all():
                expected.append((low, upper))
    assert sorted(map(tuple, found.bands.tolist())) == expected
    assert (2900, 3100) in expected
    assert (np.diff(found.bands, axis=1)[:-1] >= np.diff(found.bands, axis=1)[1:]).all()
    assert (np.diff(found.entropies, axis=1) < 0).all()


def test_p_values_of_bands():
    counts = np.arange(6)
    groups = np.arange(6)
    found = find_monotone_bands(tones(counts, n_samples=12_000), counts, RIPPLE, groups=groups)
    assert found.p_number <= 0.01
    assert found.p_widest <= 0.01
    # At least this permutation: (b + 1) / (m + 1) is never 0.
    assert min(found.p_number, found.p_widest) >= 1 / 1001
    # Nothing found: chance always does as well.
    none = find_monotone_bands(tones(5 - counts), counts, RIPPLE, groups=groups, edges=[2900, 3100])
    assert len(none.bands) == 0
    assert none.p_number == none.p_widest == 1.0
    assert none.entropies.shape == (0, 6)


@pytest.mark.slow
def test_chance_finds_bands_too():
    """With four counts, one order in 24 falls in any one band: p-values of noise spread over 0 to 1."""
    p = []
    some = 0
    for seed in range(30):
        X = tones(np.zeros(8), seed=seed, n_samples=600)
        found = find_monotone_bands(
            X, np.repeat(np.arange(4), 2), ENTROPY, groups=np.arange(8), search=Search(n_permutations=99)
        )
        some += len(found.bands) > 0
        p.append(found.p_number)
    assert some > 5
    # Binomial(30, 0.2): 13 or more in 0.3 % of cases
    assert np.sum(np.array(p) <= 0.2) < 13


def test_windows_of_an_assembly_stay_together():
    """Of windows, 36 would be in order; three recordings are in order by chance in one case of six."""
    y = np.repeat([1, 2, 3], 12)
    found = find_monotone_bands(tones(y), y, RIPPLE, groups=y, search=Search(n_permutations=600))
    assert found.p_number == pytest.approx(1 / 6, abs=0.06)


def test_bands_without_groups_are_a_list_only():
    y = np.repeat([1, 2, 3], 2)
    with pytest.raises(ValueError, match=r"assembly .*n_permutations=0\) for bands"):
        find_monotone_bands(tones(y), y, ENTROPY)
    found = find_monotone_bands(tones(y), y, ENTROPY, search=NO_CHANCE)
    assert found.p_number is None
    assert found.p_widest is None
    assert found.n_tried == 2080


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"edges": [0.0]}, r"edges must be at least two increasing frequencies from 0 to 12800 Hz"),
        ({"edges": [100.0, 50.0]}, r"got \[100.0, 50.0\]"),
        ({"edges": [0.0, 13_000.0]}, "from 0 to 12800 Hz"),
        ({"edges": [1.0, 2.0]}, "hold no band with two of the"),
        ({"entropy": SpectralEntropy(RATE, "welch")}, "preset must be .* got 'welch'"),
        ({"groups": [0, 0, 0, 1, 1, 1]}, "assemblies with one defect count each"),
        ({"y": [2] * 6}, "at least two defect counts"),
    ],
)
def test_bad_bands(change, message):
    arguments = {"y": [1, 1, 2, 2, 3, 3], "entropy": ENTROPY, "groups": range(6)} | change
    with pytest.raises(ValueError, match=message):
        find_monotone_bands(tones([1, 1, 2, 2, 3, 3], n_samples=600), **arguments)


def test_the_order_of_windows_changes_nothing():
    y, groups = np.repeat([1, 2, 3], 4), np.repeat(np.arange(6), 2)
    X = tones(y)
    order = np.random.default_rng(1).permutation(12)
    before = find_monotone_bands(X, y, ENTROPY, groups=groups)
    after = find_monotone_bands(X[order], y[order], ENTROPY, groups=groups[order])
    assert_array_equal(before.bands, after.bands)
    assert (before.p_number, before.p_widest) == (after.p_number, after.p_widest)
