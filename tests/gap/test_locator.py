"""The first stage: what is flagged, what is not, and how often it errs."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from short_records import BASE, N_SAMPLES, RATE, short

from cyclofeat.gap import Comparison
from cyclofeat.gap.comparison import measured_turns
from cyclofeat.gap.simulations import Bank
from cyclofeat.gap.summaries.summarise import FAMILIES, Cell, Kinematics, summarise_windows
from cyclofeat.gap.summaries.turns import class_means, less_class_means
from cyclofeat.gap.where.locate import LocatedGap, locate
from cyclofeat.gap.where.permutation import SPREADS, TOGETHER, Permuted, family_p, holm, statistics_by_family
from cyclofeat.simulators import Drift, Effect, Hum, Offset, TorqueMeterLowPass

FS, SPEED = 25_600, 500 / 60
COUNTS = [0, 3, 6]


def recordings(effects: list[Effect], n: int, seed: int, cache: Path) -> Bank:
    """Recordings of the same rig with effects in it, from other seeds."""
    rig = BASE.with_added(*effects)
    return short(rig=rig, cache=cache).bank(n, COUNTS, random_state=seed)


def compared(comparison: Comparison, bank: Bank, **options: Any) -> LocatedGap:
    return locate(
        comparison, measured_turns(comparison, bank.X, y=bank.counts, **options), n_permutations=499
    )


# Statistics


def test_maximum_of_one_cell_is_the_permutation_test_of_one_cell() -> None:
    """p of the studentised difference orders permutations as the plain difference of means does."""
    rng = np.random.default_rng(0)
    a, b = rng.normal(0.8, 1, 7), rng.normal(0, 1, 9)
    found = Permuted(a[:, None], b[:, None], 4999, np.random.default_rng(1)).step_down(np.array([0]))[0]
    exact = stats.permutation_test((a, b), lambda x, y: abs(x.mean() - y.mean()), n_resamples=np.inf)
    assert found == pytest.approx(exact.pvalue, abs=0.02)


def test_differences_and_errors_are_those_of_the_t_test() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.normal(1, 2, (6, 5)), rng.normal(0, 2, (20, 5))
    found = Permuted(a, b, 19, rng)
    expected = stats.ttest_ind(a, b)
    assert found.differences[:5] == pytest.approx(a.mean(axis=0) - b.mean(axis=0))
    assert found.t[0, :5] == pytest.approx(np.abs(expected.statistic))


def test_spreads_are_ratios_about_their_median() -> None:
    rng = np.random.default_rng(6)
    a, b = rng.normal(0, 1, (6, 2)), rng.normal(0, 1, (60, 2))
    tested = Permuted(a, b, 1999, rng)
    plain = 10 * np.log10(a.var(axis=0, ddof=1) / b.var(axis=0, ddof=1))
    # Variances of 6 values lean to small ones, by 10 log10 of the F distribution's median.
    assert tested.differences[2:4] - plain == pytest.approx(-10 * np.log10(stats.f.median(5, 59)), abs=0.4)


def test_a_larger_spread_is_no_larger_mean_and_the_other_way_round() -> None:
    rng = np.random.default_rng(6)
    a, b = rng.normal(0, 1, (6, 2)), rng.normal(0, 1, (60, 2))
    a = (a - a.mean(axis=0)) * [6.0, 1.0] + [0.0, 5.0]
    tested = Permuted(a, b, 1999, rng)
    wide, far, wide_spread, far_spread = (tested.step_down(np.array([k]))[0] for k in range(4))
    assert max(far, wide_spread) < 0.005
    assert min(wide, far_spread) > 0.05


def test_together_finds_what_hides_in_single_cells() -> None:
    """Cells that vary together, shifted against each other: small in each, large in their difference."""
    rng = np.random.default_rng(8)
    common = rng.normal(size=(66, 1))
    common[:6] -= common[:6].mean()
    values = common + 0.1 * rng.normal(size=(66, 12))
    values[:6] += 0.2 * np.resize([1, -1], 12)
    tested = Permuted(values[:6], values[6:], 999, rng)
    assert tested.step_down(np.arange(12)).min() > 0.3
    assert tested.step_down(np.array([24]))[0] <= 0.01
    # Less than usual is no disagreement.
    same = Permuted(np.tile(values.mean(axis=0), (6, 1)), values[6:], 999, rng)
    assert same.step_down(np.array([24]))[0] > 0.9


@pytest.mark.slow
def test_together_holds_its_level() -> None:
    rng = np.random.default_rng(9)
    p = []
    for _ in range(300):
        values = rng.normal(size=(50, 1)) + rng.standard_t(4, size=(50, 10))
        p.append(Permuted(values[:6], values[6:], 99, rng).step_down(np.array([20]))[0])
    assert min(p) >= 1 / 100  # never 0
    for level in (0.05, 0.2):
        assert stats.binomtest(int(np.sum(np.array(p) <= level)), 300, level).pvalue > 1e-3


def test_families_hold_every_statistic_once() -> None:
    cells = [Cell(family, str(k), "dB") for k in range(2) for family in FAMILIES]
    families = statistics_by_family(cells)
    assert list(families) == [*FAMILIES, SPREADS, TOGETHER.family]
    assert sorted(np.concatenate(list(families.values()))) == list(range(2 * len(cells) + 1))
    for family, at in families.items():
        if family in FAMILIES:
            assert [cells[k].family for k in at] == [family] * 2


def test_spreads_do_not_raise_the_bar_for_means() -> None:
    """A family's p is that of its own statistics times the number of families at most."""
    rng = np.random.default_rng(10)
    cells = [Cell(family, str(k), "dB") for k in range(3) for family in FAMILIES]
    measured, simulated = rng.normal(size=(6, len(cells))), rng.normal(size=(60, len(cells)))
    measured[:, 4] += 4.0
    p = family_p(measured, simulated, cells, 999, np.random.default_rng(11))
    assert min(p, key=p.get) in (FAMILIES[4], TOGETHER.family)
    # The floor: all families are paid for, and p is never 0.
    assert p[FAMILIES[4]] == pytest.approx(len(p) / 1000)


def test_step_down_is_monotone_and_no_smaller_than_single_tests() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(0, 1, (5, 30)), rng.normal(0, 1, (40, 30))
    a[:, :3] += [3.0, 1.5, 1.0]
    tested = Permuted(a, b, 999, rng)
    adjusted = tested.step_down(np.arange(30))
    single = np.array([tested.step_down(np.array([k]))[0] for k in range(30)])
    assert np.all(adjusted >= single)
    assert np.all(np.diff(adjusted[np.argsort(-tested.t[0, :30])]) >= 0)
    assert adjusted[0] <= 0.01
    assert adjusted.min() >= 1 / 1000  # never 0


def test_holm() -> None:
    assert holm({"a": 0.01, "b": 0.04, "c": 0.03}) == pytest.approx({"a": 0.03, "c": 0.06, "b": 0.06})


@pytest.mark.slow
def test_family_wise_error_under_the_null_holds() -> None:
    """Correlated cells, few recordings against many: at most the nominal share of trials has a finding."""
    rng = np.random.default_rng(4)
    found = 0
    for _ in range(300):
        common = rng.normal(size=(64, 1))
        values = 0.7 * common + rng.standard_t(4, size=(64, 25))
        found += Permuted(values[:4], values[4:], 199, rng).step_down(np.arange(25)).min() <= 0.05
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
    (plain, cells), (with_tone, _) = (
        summarise_windows(tone(hz, size), Kinematics(FS, SPEED)) for size in (0.0, 0.3)
    )
    levels = [k for k, cell in enumerate(cells) if cell.unit == "dB" and cell.family != "averages"]
    change = (with_tone - plain).mean(axis=0)
    assert cells[levels[int(np.argmax(change[levels]))]].name == name


def test_levels_are_those_of_the_tone() -> None:
    values, cells = summarise_windows(tone(1000.0, 0.3), Kinematics(FS, SPEED))
    band = next(k for k, cell in enumerate(cells) if cell.name == "third octave at 1e+03 Hz")
    assert values[:, band] == pytest.approx(10 * math.log10(0.3**2 / 2), abs=0.3)


def test_cells_are_unique_and_complete() -> None:
    values, cells = summarise_windows(tone(100.0, 0.1, 3), Kinematics(FS, SPEED))
    assert values.shape == (3, len(cells))
    assert np.all(np.isfinite(values))
    assert len({(cell.family, cell.name) for cell in cells}) == len(cells)
    constant, _ = summarise_windows(np.full((1, 46_080), 22.0), Kinematics(FS, SPEED))
    assert np.all(np.isfinite(constant))


def test_too_short_windows_are_refused() -> None:
    with pytest.raises(ValueError, match=r"at least one output turn \(1.8 s\), got 0.6 s"):
        summarise_windows(tone(100.0, 0.1)[:, :15_360], Kinematics(FS, SPEED))


# Bank


@pytest.mark.slow
def test_a_bank_is_the_same_from_the_cache_and_for_every_worker(tmp_path: Path) -> None:
    one = short(rig=BASE, random_state=3, cache=tmp_path)
    first = one.bank(4, [1, 2])
    for same in (one.replace(cache=tmp_path), one.replace(n_jobs=2, cache=None)):
        bank = same.bank(4, [1, 2])
        assert np.array_equal(bank.X, first.X)
        assert bank.counts.tolist() == [1, 2, 1, 2]
        assert np.array_equal(bank.speeds, first.speeds)
    assert len(kept(tmp_path)) == 1
    other = one.bank(4, [1, 2], random_state=4)
    assert not np.array_equal(other.X, first.X)
    one.replace(may_differ=one.may_differ[:1]).bank(4, [1, 2])
    assert len(kept(tmp_path)) == 3


def kept(folder: Path) -> list[Path]:
    return list(folder.rglob("*.joblib"))


# The stage as a whole


@pytest.mark.slow
def test_no_effect_is_not_flagged(comparison: Comparison, simulations: Path) -> None:
    located = compared(comparison, recordings([], 6, 101, simulations))
    assert located.where.verdict == "unresolved"
    assert all(row.low <= row.difference <= row.high for row in located.where.rows)
    assert all(row.detectable > 0 for row in located.where.rows if row.spread > 0)


@pytest.mark.slow
def test_simulated_recordings_in_the_place_of_measured_ones_rarely_disagree(
    comparison: Comparison, simulations: Path
) -> None:
    located = compared(comparison, recordings([], 6, 101, simulations))
    counts = located.bank.counts
    values = less_class_means(located.simulated, counts, class_means(located.simulated, counts))
    random = np.random.default_rng(1)
    alarms = 0
    for _ in range(40):
        order = random.permutation(len(values))
        p = family_p(values[order[:6]], values[order[6:]], located.cells, 499, random)
        alarms += min(p.values()) <= 0.05
    assert stats.binomtest(alarms, 40, 0.05, alternative="greater").pvalue > 1e-3


@pytest.mark.parametrize(
    ("effect", "family", "name"),
    [
        (Hum(0.2), "shaft lines", "input order 2"),
        (Drift(0.5), "slow part", "level below 4 Hz"),
        (TorqueMeterLowPass(150.0), "spectrum", "third octave"),
        (Offset(1.0), "amplitudes", "mean"),
    ],
    ids=["hum", "drift", "low-pass", "offset"],
)
def test_an_effect_is_found_where_it_is(
    comparison: Comparison, simulations: Path, effect: Effect, family: str, name: str
) -> None:
    located = compared(comparison, recordings([effect], 6, 102, simulations))
    assert located.where.verdict == "disagree"
    assert located.where.family_p[family] <= 0.05
    flagged = [row.cell.name for row in located.where.rows if row.p <= 0.05 and row.cell.family == family]
    assert any(cell.startswith(name) for cell in flagged)


def test_windows_of_one_recording_are_no_replicates(comparison: Comparison, simulations: Path) -> None:
    """The same data cut into recordings of two windows each: fewer units, so wider intervals."""
    bank = recordings([], 6, 101, simulations)
    twice = dataclasses.replace(bank, X=np.repeat(bank.X, 2, axis=0), counts=np.repeat(bank.counts, 2))
    alone, doubled = (
        np.median([row.high - row.low for row in located.where.rows])
        for located in (
            compared(comparison, bank),
            compared(comparison, twice, groups=np.repeat(range(6), 2)),
        )
    )
    assert doubled == pytest.approx(alone, rel=1e-6)


def test_together_is_one_row_and_paid_for(comparison: Comparison, simulations: Path) -> None:
    located = compared(comparison, recordings([Hum(0.2)], 6, 102, simulations))
    n_cells = len(located.cells)
    assert [row.of for row in located.where.rows] == ["mean"] * n_cells + ["spread"] * n_cells
    assert located.together.cell is TOGETHER
    assert set(located.where.family_p) == {*FAMILIES, SPREADS, TOGETHER.family}
    for family, p in located.where.family_p.items():
        of_family = [
            row.p
            for row in (*located.where.rows, located.together)
            if (row.cell.family == family and row.of == "mean") or (family == SPREADS and row.of == "spread")
        ]
        assert min(of_family) == pytest.approx(p)


def test_a_tachometer_adds_its_cells(comparison: Comparison, simulations: Path) -> None:
    """By its own clock: a converter whose clock is off shows against it, an error of the speed does not."""
    name = "mesh lines against the tachometer"
    bank = recordings([], 6, 101, simulations)
    angle = 2 * np.pi * bank.speeds[:, None] * np.arange(bank.X.shape[1]) / RATE
    for factor, flagged in ((1.0, False), (1.01, True)):
        located = compared(comparison.replace(tachometer=True), bank, angle=factor * angle)
        row = next(row for row in located.where.rows if row.cell.name == name)
        assert (row.p <= 0.05) == flagged
        assert row.difference == pytest.approx(100 * (1 / factor - 1), abs=0.1)
    assert all(name != row.cell.name for row in compared(comparison, bank).where.rows)


def test_bad_arguments(comparison: Comparison) -> None:
    X = np.full((2, N_SAMPLES), 22.0)
    with pytest.raises(ValueError, match="at least 2 recordings"):
        locate(comparison, measured_turns(comparison, X[:1]))
    with pytest.raises(ValueError, match="n_permutations must be at least 219 for alpha=0.05"):
        locate(comparison, measured_turns(comparison, X), n_permutations=100)


def test_bad_comparisons() -> None:
    for counts in ((), (0, 2.5), (0, -1), (0, np.nan), ("0", "3"), 3):
        with pytest.raises(ValueError, match="defect_counts must hold whole numbers from 0, got"):
            Comparison(sampling_rate=RATE, defect_counts=counts)  # type: ignore[arg-type]
    assert Comparison(sampling_rate=RATE, defect_counts=np.array([0.0, 3.0])).defect_counts == (0, 3)
    with pytest.raises(ValueError, match=r"wheels must hold at least one of \(0,\), \(1,\) and \(0, 1\)"):
        Comparison(sampling_rate=RATE, wheels=())
    with pytest.raises(ValueError, match=r"wheels must be \(0,\), \(1,\) or \(0, 1\)"):
        Comparison(sampling_rate=RATE, wheels=((2,),))
    with pytest.raises(ValueError, match="sampling_rate must be positive"):
        Comparison(sampling_rate=0.0)
