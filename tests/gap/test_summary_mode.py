"""Published statistics without recordings: exact tests, scores, effects hidden in eight rows of numbers."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

from cyclofeat.datasets import load_published_tables
from cyclofeat.gap import NuisancePrior
from cyclofeat.gap._null import record
from cyclofeat.gap._summary_mode import SummaryGap
from cyclofeat.gap._summary_rigs import SET_POINT, BrakeSetPoint, SimulatedRigs
from cyclofeat.gap._summary_scores import STATISTICS, crps, sign_flip_p, to_statistics
from cyclofeat.simulators import CompositeSimulator, CycloidalGearbox, Offset, Rig, SensorDrift

SMALL = {"duration_s": 0.1, "n_draws": 2, "library": ["sensor_drift", "gain", "offset"]}
PUBLISHED = load_published_tables()


def table_of(effects, seed: int, duration: float = 0.1) -> dict[str, np.ndarray]:
    """What a paper would print of eight discs on a rig with these effects."""
    nuisance = NuisancePrior()
    simulator = CompositeSimulator(nuisance.simulator(None).base, effects)
    n = round(duration * 25_600)
    torque = [
        record(simulator, nuisance, k, n, 25_600.0, np.random.SeedSequence([seed, k]))[0].astype(float)
        for k in range(8)
    ]
    columns = {
        "defect_count": range(8),
        "min_nm": [x.min() for x in torque],
        "max_nm": [x.max() for x in torque],
        "mean_nm": [x.mean() for x in torque],
        "std_nm": [x.std() for x in torque],
    }
    return {name: np.array(column) for name, column in columns.items()}


@pytest.mark.parametrize("alternative", ["two-sided", "greater"])
def test_sign_flip_against_scipy_s_permutation_test(alternative):
    differences = np.random.default_rng(0).normal(0.4, 1, 9)
    # "samples" permutes signs of one paired sample: all 2^9 of them.
    exact = stats.permutation_test(
        (differences,), np.mean, permutation_type="samples", alternative=alternative, n_resamples=np.inf
    )
    assert sign_flip_p(differences, alternative) == pytest.approx(exact.pvalue)


def test_eight_discs_cannot_fall_below_one_in_128():
    assert sign_flip_p(np.arange(1.0, 9)) == 2 / 2**8


def test_sign_flip_holds_its_level():
    random = np.random.default_rng(1)
    p = np.array([sign_flip_p(random.normal(size=8)) for _ in range(400)])
    assert np.mean(p <= 0.05) <= stats.binom.ppf(0.999, 400, 0.05) / 400


def test_crps_against_its_definition():
    random = np.random.default_rng(2)
    samples, observed = random.normal(size=(3, 25)), random.normal(size=3)
    for row, y, found in zip(samples, observed, crps(samples, observed), strict=True):
        pairs = np.mean([abs(a - b) for a, b in itertools.product(row, row)])
        assert found == pytest.approx(np.mean(np.abs(row - y)) - pairs / 2)


def test_crps_of_a_normal_against_its_closed_form():
    shares = (np.arange(4000) + 0.5) / 4000
    y = 0.7
    closed = y * (2 * stats.norm.cdf(y) - 1) + 2 * stats.norm.pdf(y) - 1 / np.sqrt(np.pi)
    assert float(crps(stats.norm.ppf(shares), y)) == pytest.approx(closed, rel=1e-3)


def test_what_the_tables_say_themselves():
    """Mean above the set-point in 8 of 8 by 0.51 Nm, up over down 1.62 in 8 of 8."""
    table = PUBLISHED.signal_statistics
    found = to_statistics(table["min_nm"], table["max_nm"], table["mean_nm"], table["std_nm"], 22.0)
    assert (found[:, 0] > 0).all()
    assert found[:, 0].mean() == pytest.approx(0.506, abs=0.001)
    assert (found[:, 2] > found[:, 3]).all()
    up, down = np.exp(found[:, 2:]).sum(axis=0)
    assert up / down == pytest.approx(1.62, abs=0.01)


@pytest.fixture(scope="module")
def drift():
    made = table_of([SensorDrift(rms_nm=4.0, cutoff_hz=15.0)], seed=5)
    return made, SummaryGap(**SMALL).fit(made, entropy=np.linspace(1, 2, 8))


@pytest.fixture(scope="module")
def simulated(drift, tmp_path_factory):
    """Settings with a table of what the fit above has simulated."""
    path = tmp_path_factory.mktemp("table") / "table.npz"
    drift[1].save_table(path)
    return {**SMALL, "table": path}


def test_a_hidden_drift_is_found_named_and_predicts_discs_left_out(drift):
    _, gap = drift
    rows = {row.statistic: row for row in gap.discrepancies_}
    assert rows["std"].p == 2 / 2**8
    assert rows["std"].difference > 1
    assert gap.steps_[0].effect_id == "sensor_drift"
    assert gap.simulator_.effects[0].effect_id == "sensor_drift"
    held = [row for row in gap.held_out_ if row.statistic == "std"]
    nothing = np.mean([abs(np.log(row.nothing / row.measured)) for row in held])
    predicted = np.mean([abs(np.log(row.predicted / row.measured)) for row in held])
    assert predicted < 0.5 * nothing
    assert {row.statistic for row in gap.held_out_} == {*STATISTICS, "range", "entropy"}


def test_a_disc_left_out_has_no_part_in_its_prediction(drift, simulated):
    """Another number for one disc moves no prediction of that disc, only the scale that scores are in."""
    made, _ = drift
    changed = {name: column.copy() for name, column in made.items()}
    changed["std_nm"][3] *= 1.3
    # With the scales of the first fit: they are the only way in.
    scaled = SummaryGap(**simulated).fit(changed)
    gap = SummaryGap(**simulated).fit(made)
    scaled.scales_ = gap.scales_
    scaled._scores, scaled._fits = {}, {}
    row = next(r for r in scaled._hold_out(None) if r.disc == 3 and r.statistic == "std")
    first = next(r for r in gap.held_out_ if r.disc == 3 and r.statistic == "std")
    assert (row.predicted, row.low, row.high, row.effects) == (
        first.predicted, first.low, first.high, first.effects,
    )  # fmt: skip
    assert row.measured != first.measured


def test_entropies_are_compared_and_never_used(drift, simulated):
    made, _ = drift
    gap = SummaryGap(**simulated).fit(made, entropy=np.linspace(1, 2, 8))
    other = SummaryGap(**simulated).fit(made, entropy=np.linspace(5, 2, 8))
    assert other.theta_ == gap.theta_
    assert [step.effect_id for step in other.steps_] == [step.effect_id for step in gap.steps_]


def test_nothing_is_named_where_nothing_is_missing(simulated):
    gap = SummaryGap(**simulated).fit(table_of([], seed=6))
    assert gap.steps_ == []
    assert gap.effects_ == ()


def test_a_table_saves_the_simulations(drift, simulated):
    made, gap = drift
    again = SummaryGap(**simulated).fit(made, entropy=np.linspace(1, 2, 8))
    assert again.n_simulated_ == 0
    assert [step.effect_id for step in again.steps_] == [step.effect_id for step in gap.steps_]
    # Half precision, through a fitted interpolation.
    assert again.theta_ == pytest.approx(gap.theta_, rel=0.05)
    with pytest.raises(ValueError, match="was made with another"):
        SummaryGap(**{**simulated, "random_state": 1}).fit(made)


def test_records_are_kept_and_the_same_again(tmp_path):
    made = table_of([Offset(2.0)], seed=7)
    options = {**SMALL, "library": ["offset"], "cache": tmp_path}
    first, second = (SummaryGap(**options).fit(made) for _ in range(2))
    assert first.n_simulated_ > 0
    assert second.n_simulated_ == 0
    assert first.ranking_ == second.ranking_


def test_a_set_point_is_a_load_and_no_effect_of_files():
    gap = SummaryGap(**{**SMALL, "library": [SET_POINT]}).fit(table_of([Offset(2.0)], seed=8))
    assert [step.effect_id for step in gap.steps_] == [SET_POINT]
    assert gap.simulator_.effects == ()
    base = gap.simulator_.base
    assert isinstance(base, Rig)
    assert base.gearbox.load_torque == pytest.approx(22.0 + gap.effects_[0].shift_nm)
    changed = BrakeSetPoint(0.5).change_gearbox(CycloidalGearbox.steel(), np.random.default_rng(0))
    assert changed.load_torque == 22.5


def test_a_constant_s_look_alikes_are_reported(simulated):
    gap = SummaryGap(**{**simulated, "library": ["gain", "offset"], "max_effects": 1})
    gap.fit(table_of([Offset(1.0)], seed=9))
    assert {gap.steps_[0].effect_id, *gap.steps_[0].look_alikes} == {"gain", "offset"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop("std_nm"), "columns defect_count, min_nm"),
        (lambda t: t.update(std_nm=t["std_nm"] * np.nan), "finite"),
        (lambda t: t.update(min_nm=t["max_nm"]), "min_nm < mean_nm"),
        (lambda t: t.update(range_nm=t["std_nm"]), "range_nm must be"),
        (lambda t: t.update({k: v[:2] for k, v in t.items()}), "3 to 20 rows"),
        (lambda t: t.update(defect_count=t["defect_count"] + 0.5), "whole numbers"),
    ],
)
def test_bad_tables_are_named(change, message):
    table = {
        name: PUBLISHED.signal_statistics[name].copy() for name in PUBLISHED.signal_statistics.dtype.names
    }
    change(table)
    with pytest.raises(ValueError, match=message):
        SummaryGap(**SMALL).fit(table)


def test_unknown_effects_and_entropies_of_other_discs_are_named():
    with pytest.raises(ValueError, match="library must name"):
        SummaryGap(library=["rust"]).fit(PUBLISHED.signal_statistics)
    with pytest.raises(ValueError, match="8 finite numbers"):
        SummaryGap(**SMALL).fit(PUBLISHED.signal_statistics, entropy=[1.0])
    with pytest.raises(ValueError, match="1 to 20 finite"):
        sign_flip_p([])


@pytest.mark.parametrize("key", [("clearance",), ("load_drift",), ("brake_rotor",), ("clearance", "gain")])
def test_no_rig_is_counted_twice(key):
    rigs = SimulatedRigs(
        np.array([0, 3, 6]), simulator=None, nuisance=NuisancePrior(), duration_s=0.1, sampling_rate=25_600.0,
        n_draws=4, table=None, random_state=0, n_jobs=1, cache=None,
    )  # fmt: skip
    theta = rigs.thetas(key)
    assert len(theta) == rigs.n_rigs(key)
    assert len(np.unique(theta, axis=0)) == len(theta)


@pytest.mark.parametrize(
    ("n", "named", "warning"),
    [
        (4, False, "4 discs: no effect can be named, as p over them is never below 0.062 and alpha is 0.05"),
        (5, True, "5 discs: no effect can be named without one of them"),
        (6, True, None),
    ],
)
def test_too_few_discs_are_warned_of(n, named, warning):
    made = {name: column[:n] for name, column in table_of([Offset(8.0)], seed=8).items()}
    gap = SummaryGap(**{**SMALL, "library": ["offset"], "max_effects": 1}).fit(made)
    assert bool(gap.steps_) == named
    assert any(row.effects for row in gap.held_out_) == (warning is None)
    if warning is None:
        assert gap.warnings_ == []
    else:
        assert gap.warnings_[0].startswith(warning)
