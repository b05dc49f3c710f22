"""The first stage: what is flagged, what is not, and how often it errs."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from cyclofeat.gap import Bank, GapLocator, NuisancePrior, make_bank, summarise
from cyclofeat.gap._locator import _holm, _Permuted
from cyclofeat.simulators import (
    AssemblyTolerances,
    CompositeSimulator,
    Effect,
    Hum,
    LoadDrift,
    Offset,
    Rig,
    TorqueMeterLowPass,
)

FS, SPEED = 25_600, 500 / 60
BASE = Rig.r1().replace(load_drift_nm=0.0, noise_nm=0.05)
COUNTS = [0, 3, 6]


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("banks")


def measured(effects: list[Effect], n: int, seed: int, cache: Path) -> Bank:
    """Recordings of the same rig with effects in it, from other seeds."""
    return make_bank(
        CompositeSimulator(BASE, effects), NuisancePrior(), COUNTS, n=n, random_state=seed, cache=cache
    )


@pytest.fixture(scope="module")
def locator(cache: Path) -> GapLocator:
    return GapLocator(FS, BASE, n_bank=40, n_permutations=199, cache=cache)


# Statistics


def test_maximum_of_one_cell_is_the_permutation_test_of_one_cell() -> None:
    """p of the studentised difference orders permutations as the plain difference of means does."""
    rng = np.random.default_rng(0)
    a, b = rng.normal(0.8, 1, 7), rng.normal(0, 1, 9)
    found = _Permuted(a[:, None], b[:, None], 4999, np.random.default_rng(1)).step_down(np.array([0]))[0]
    exact = stats.permutation_test((a, b), lambda x, y: abs(x.mean() - y.mean()), n_resamples=np.inf)
    assert found == pytest.approx(exact.pvalue, abs=0.02)


def test_effects_and_errors_are_those_of_the_t_test() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.normal(1, 2, (6, 5)), rng.normal(0, 2, (20, 5))
    found = _Permuted(a, b, 19, rng)
    expected = stats.ttest_ind(a, b)
    assert found.effects == pytest.approx(a.mean(axis=0) - b.mean(axis=0))
    assert found.t[0] == pytest.approx(np.abs(expected.statistic))


def test_step_down_is_monotone_and_no_smaller_than_single_tests() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(0, 1, (5, 30)), rng.normal(0, 1, (40, 30))
    a[:, :3] += [3.0, 1.5, 1.0]
    tested = _Permuted(a, b, 999, rng)
    adjusted = tested.step_down(np.arange(30))
    single = np.array([tested.step_down(np.array([k]))[0] for k in range(30)])
    assert np.all(adjusted >= single)
    assert np.all(np.diff(adjusted[np.argsort(-tested.t[0])]) >= 0)
    assert adjusted[0] <= 0.01
    assert adjusted.min() >= 1 / 1000  # never 0


def test_holm() -> None:
    assert _holm({"a": 0.01, "b": 0.04, "c": 0.03}) == pytest.approx({"a": 0.03, "c": 0.06, "b": 0.06})


def test_family_wise_error_under_the_null_holds() -> None:
    """Correlated cells, few recordings against many: at most the nominal share of trials has a finding."""
    rng = np.random.default_rng(4)
    found = 0
    for _ in range(300):
        common = rng.normal(size=(64, 1))
        values = 0.7 * common + rng.standard_t(4, size=(64, 25))
        found += _Permuted(values[:4], values[4:], 199, rng).step_down(np.arange(25)).min() <= 0.05
    assert stats.binomtest(found, 300, 0.05, alternative="greater").pvalue > 1e-3


# Summaries


def tone(hz: float, amplitude: float, n_windows: int = 2) -> np.ndarray:
    time = np.arange(46_080) / FS
    rng = np.random.default_rng(5)
    mesh = 0.5 * np.cos(2 * np.pi * 16 * SPEED * time)
    noise = rng.normal(0, 0.05, (n_windows, time.size))
    return 22 + mesh + amplitude * np.cos(2 * np.pi * hz * time) + noise


@pytest.mark.parametrize(
    ("hz", "name"),
    [
        (6 * SPEED, "input order 6"),
        (5 * 16 / 15 * SPEED, "lobe line 5 (order 5.33)"),
        (1000.0, "third octave at 1e+03 Hz"),
        (1.5, "level below 4 Hz"),
    ],
)
def test_a_tone_shows_in_its_own_cell_most(hz: float, name: str) -> None:
    (plain, cells), (with_tone, _) = (summarise(tone(hz, size), FS, SPEED) for size in (0.0, 0.3))
    levels = [k for k, cell in enumerate(cells) if cell.unit == "dB" and cell.family != "averages"]
    change = (with_tone - plain).mean(axis=0)
    assert cells[levels[int(np.argmax(change[levels]))]].name == name


def test_levels_are_those_of_the_tone() -> None:
    values, cells = summarise(tone(1000.0, 0.3), FS, SPEED)
    band = next(k for k, cell in enumerate(cells) if cell.name == "third octave at 1e+03 Hz")
    assert values[:, band] == pytest.approx(10 * math.log10(0.3**2 / 2), abs=0.3)


def test_cells_are_unique_and_complete() -> None:
    values, cells = summarise(tone(100.0, 0.1, 3), FS, SPEED)
    assert values.shape == (3, len(cells))
    assert np.all(np.isfinite(values))
    assert len({(cell.family, cell.name) for cell in cells}) == len(cells)
    constant, _ = summarise(np.full((1, 46_080), 22.0), FS, SPEED)
    assert np.all(np.isfinite(constant))


def test_order_of_windows_changes_nothing() -> None:
    X = tone(60.0, 0.2, 4)
    assert summarise(X[::-1], FS, SPEED)[0] == pytest.approx(summarise(X, FS, SPEED)[0][::-1], rel=1e-9)


def test_too_short_windows_are_refused() -> None:
    with pytest.raises(ValueError, match=r"at least one output turn \(1.8 s\), got 0.6 s"):
        summarise(tone(100.0, 0.1)[:, :15_360], FS, SPEED)


# Bank


def test_a_bank_is_the_same_from_the_cache_and_for_every_worker(tmp_path: Path) -> None:
    one = make_bank(BASE, NuisancePrior(), [1, 2], n=4, n_samples=4000, random_state=3, cache=tmp_path)
    again = make_bank(BASE, NuisancePrior(), [1, 2], n=4, n_samples=4000, random_state=3, cache=tmp_path)
    two = make_bank(BASE, NuisancePrior(), [1, 2], n=4, n_samples=4000, random_state=3, n_jobs=2)
    assert len(list(tmp_path.iterdir())) == 1
    for bank in (again, two):
        assert np.array_equal(bank.X, one.X)
        assert bank.counts.tolist() == [1, 2, 1, 2]
        assert np.array_equal(bank.input_angle, one.input_angle)
    other = make_bank(BASE, NuisancePrior(), [1, 2], n=4, n_samples=4000, random_state=4, cache=tmp_path)
    assert not np.array_equal(other.X, one.X)
    changed = NuisancePrior(tolerances=AssemblyTolerances(load=0.0))
    make_bank(BASE, changed, [1, 2], n=4, n_samples=4000, random_state=3, cache=tmp_path)
    assert len(list(tmp_path.iterdir())) == 3


# The stage as a whole


@pytest.mark.slow
def test_no_effect_is_not_flagged(locator: GapLocator, cache: Path) -> None:
    bank = measured([], 6, 101, cache)
    locator.fit(bank.X, y=bank.counts)
    assert locator.verdict_ == "unresolved"
    assert min(locator.p_global_.values()) > 0.01
    assert all(row.low <= row.effect <= row.high for row in locator.table_)
    assert all(row.detectable > 0 for row in locator.table_ if row.spread > 0)
    rate = locator.calibrate_null(40)
    assert stats.binomtest(round(rate * 40), 40, 0.05, alternative="greater").pvalue > 1e-3


@pytest.mark.parametrize(
    ("effect", "family", "name"),
    [
        (Hum(0.2), "shaft lines", "input order 6"),
        pytest.param(LoadDrift(0.5), "slow part", "level below 4 Hz", marks=pytest.mark.slow),
        (TorqueMeterLowPass(150.0), "spectrum", "third octave"),
        pytest.param(Offset(1.0), "amplitudes", "mean", marks=pytest.mark.slow),
    ],
    ids=["hum", "drift", "low-pass", "offset"],
)
def test_an_effect_is_found_where_it_is(
    locator: GapLocator, cache: Path, effect: Effect, family: str, name: str
) -> None:
    bank = measured([effect], 6, 102, cache)
    locator.fit(bank.X, y=bank.counts)
    assert locator.verdict_ == "disagree"
    assert locator.family_p_[family] <= 0.05
    flagged = [row.cell.name for row in locator.table_ if row.p <= 0.05 and row.cell.family == family]
    assert any(found.startswith(name) for found in flagged)


def test_windows_of_one_recording_are_no_replicates(locator: GapLocator, cache: Path) -> None:
    """The same data cut into recordings of two windows each: fewer units, so wider intervals."""
    bank = measured([], 6, 101, cache)
    alone = locator.fit(bank.X, y=bank.counts)
    wide_alone = np.median([row.high - row.low for row in alone.table_])
    doubled = locator.fit(
        np.repeat(bank.X, 2, axis=0), y=np.repeat(bank.counts, 2), groups=np.repeat(range(6), 2)
    )
    assert np.median([row.high - row.low for row in doubled.table_]) == pytest.approx(wide_alone, rel=1e-6)


def test_same_seed_same_table(locator: GapLocator, cache: Path) -> None:
    bank = measured([Hum(0.2)], 6, 102, cache)
    tables = [locator.fit(bank.X, y=bank.counts).table_ for _ in range(2)]
    assert tables[0] == tables[1]


@pytest.mark.parametrize(
    ("X", "options", "message"),
    [
        (np.full((1, 46_080), 22.0), {}, "at least 2 recordings"),
        (np.full((3, 15_360), 22.0), {}, "at least one output turn"),
        (np.full((3, 46_080), 22.0), {"groups": [0, 1]}, "groups must hold one recording per window"),
    ],
)
def test_bad_input(locator: GapLocator, X: np.ndarray, options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        locator.fit(X, **options)


def test_bad_prior() -> None:
    with pytest.raises(ValueError, match="defect_counts must hold whole numbers from 0"):
        NuisancePrior(defect_counts=())
    with pytest.raises(ValueError, match=r"wheels must be \(0,\), \(1,\) or \(0, 1\)"):
        NuisancePrior(wheels=((2,),))
