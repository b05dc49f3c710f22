"""Published statistics without recordings: exact tests, scores, effects hidden in eight rows of numbers."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from scipy import stats

from cyclofeat.datasets import load_published_tables
from cyclofeat.gap import Comparison, find_published_gap
from cyclofeat.gap.published.published_gap import predict_statistics
from cyclofeat.gap.published.rigs import PublishedSettings, SimulatedRigs
from cyclofeat.gap.published.scores import crps, sign_flip_p, to_statistics
from cyclofeat.gap.published.search import Search
from cyclofeat.simulators import CycloidalGearbox, Drift, Offset, Rig

pytestmark = pytest.mark.slow

SMALL = {"duration": 0.1, "n_draws": 2, "library": ["sensor_drift", "gain", "offset"]}
PUBLISHED = load_published_tables()


def gap_of(statistics, entropy=None, cache=None, random_state=0, rig=None, **changes):
    comparison = Comparison(sampling_rate=25_600, rig=rig, cache=cache, random_state=random_state)
    return find_published_gap(
        comparison, statistics, entropy, settings=PublishedSettings(**(SMALL | changes))
    )


def table_of(effects, seed: int, duration: float = 0.1) -> dict[str, np.ndarray]:
    """Statistics that a paper would print of eight discs on a rig with these effects."""
    population = Comparison(sampling_rate=25_600, rig=Rig(CycloidalGearbox.steel(), effects)).population
    population = dataclasses.replace(population, n_samples=round(duration * 25_600))
    torque = [population.record(k, np.random.SeedSequence([seed, k])).torque.astype(float) for k in range(8)]
    columns = {f"{name}_nm": [getattr(x, name)() for x in torque] for name in ("min", "max", "mean", "std")}
    return {name: np.array(column) for name, column in ({"defect_count": range(8)} | columns).items()}


def statistics_of(table) -> np.ndarray:
    return np.stack([table[name] for name in ("min_nm", "max_nm", "mean_nm", "std_nm")], axis=-1)


@pytest.mark.parametrize("alternative", ["two-sided", "greater"])
def test_sign_flip_against_scipy_s_permutation_test(alternative):
    differences = np.random.default_rng(0).normal(0.4, 1, 9)
    # "samples" permutes signs of one paired sample: all 2^9 of them.
    exact = stats.permutation_test(
        (differences,), np.mean, permutation_type="samples", alternative=alternative, n_resamples=np.inf
    )
    assert sign_flip_p(differences, alternative) == pytest.approx(exact.pvalue)


def test_crps_against_its_definition():
    random = np.random.default_rng(2)
    samples, observed = random.normal(size=(3, 25)), random.normal(size=3)
    for row, y, found in zip(samples, observed, crps(samples, observed), strict=True):
        pairs = np.mean([abs(a - b) for a, b in itertools.product(row, row)])
        assert found == pytest.approx(np.mean(np.abs(row - y)) - pairs / 2)


def test_what_the_tables_say_themselves():
    """Mean above the set-point in 8 of 8 by 0.51 Nm, up over down 1.62 in 8 of 8."""
    table = PUBLISHED.signal_statistics
    found = to_statistics(statistics_of(table), 22.0)
    assert (found[:, 0] > 0).all()
    assert found[:, 0].mean() == pytest.approx(0.506, abs=0.001)
    assert (found[:, 2] > found[:, 3]).all()
    up, down = np.exp(found[:, 2:]).sum(axis=0)
    assert up / down == pytest.approx(1.62, abs=0.01)


@pytest.fixture(scope="module")
def drift():
    made = table_of([Drift(rms_nm=4.0, cutoff_hz=15.0, of="sensor")], seed=5)
    return made, gap_of(made, np.linspace(1, 2, 8))


@pytest.fixture(scope="module")
def simulated(drift, tmp_path_factory):
    """Settings with a table of everything simulated above."""
    path = tmp_path_factory.mktemp("table") / "table.npz"
    drift[1].save_table(path)
    return {"table": path}


def test_a_hidden_drift_is_found_named_and_predicts_discs_left_out(drift):
    _, gap = drift
    rows = {row.statistic: row for row in gap.discrepancies}
    assert rows["std"].p == 2 / 2**8
    assert rows["std"].difference > 1
    assert gap.steps[0].effect == "sensor_drift"
    assert gap.rig.effects[-1].effect_id == "sensor_drift"
    assert (gap.parameters[0].name, gap.parameters[0].unit) == ("sensor_drift.rms_nm", "Nm")
    assert (
        abs(gap.fitted[:, 1].mean() - gap.measured[:, 1].mean()) < 1
    )  # a factor of e; without it, more than 3
    held = [row for row in gap.held_out if row.statistic == "std"]
    nothing = np.mean([abs(np.log(row.nothing / row.measured)) for row in held])
    predicted = np.mean([abs(np.log(row.predicted / row.measured)) for row in held])
    assert predicted < 0.5 * nothing
    assert {row.statistic for row in gap.held_out} == {"mean", "std", "up", "down", "range", "entropy"}


def test_the_tables_of_the_gap_are_its_rows(drift):
    _, gap = drift
    for table in ("discrepancies", "ranking", "steps", "rejected", "parameters", "held_out"):
        assert len(gap.to_frame(table)) == len(getattr(gap, table)) > 0, table
    assert gap.to_frame().score.tolist() == [row.score for row in gap.ranking]
    with pytest.raises(ValueError, match="table must be one of 'discrepancies', .*, got 'dropped'"):
        gap.to_frame("dropped")


def test_a_disc_left_out_has_no_part_in_its_prediction(drift, simulated):
    """Another number for one disc moves no prediction of that disc; the scale of scores is held."""
    made, _ = drift
    settings = PublishedSettings(**(SMALL | simulated))
    rigs = SimulatedRigs(Comparison(sampling_rate=25_600), np.arange(8), settings)
    values = statistics_of(made)
    first = Search(rigs, to_statistics(values, rigs.set_point), tuple(SMALL["library"]), settings)
    values[3, 3] *= 1.3
    measured = to_statistics(values, rigs.set_point)
    other = Search(rigs, measured, first.library, settings)
    other.scales = first.scales
    one, two = (
        next(row for row in predict_statistics(search, 3) if row.statistic == "std")
        for search in (first, other)
    )
    assert two.measured != one.measured
    assert dataclasses.replace(two, measured=one.measured) == one


def test_entropies_are_compared_and_never_used(drift, simulated):
    made, _ = drift
    gap, other = (gap_of(made, np.linspace(start, 2, 8), **simulated) for start in (1, 5))
    assert other.parameters == gap.parameters
    assert other.steps == gap.steps


def test_nothing_is_named_where_nothing_is_missing(simulated):
    gap = gap_of(table_of([], seed=6), **simulated)
    assert gap.steps == ()
    assert gap.effects == ()


def test_a_table_saves_the_simulations(drift, simulated):
    made, gap = drift
    again = gap_of(made, np.linspace(1, 2, 8), **simulated)
    assert again.n_simulated == 0
    assert [step.effect for step in again.steps] == [step.effect for step in gap.steps]
    # Half precision, through a fitted interpolation.
    sizes, expected = ([row.value for row in one.parameters] for one in (again, gap))
    assert sizes == pytest.approx(expected, rel=0.05)
    with pytest.raises(ValueError, match="was made with another"):
        gap_of(made, random_state=1, **simulated)
    with pytest.raises(ValueError, match="was made with another"):
        gap_of(made, rig=CycloidalGearbox.steel().replace(load_torque=21.0), **simulated)


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    """Folder of simulated records."""
    return tmp_path_factory.mktemp("records")


def test_records_are_kept_and_the_same_again(records):
    made = table_of([Offset(2.0)], seed=7)
    first, second = (gap_of(made, library=["offset"], cache=records) for _ in range(2))
    assert first.n_simulated > 0
    assert second.n_simulated == 0
    assert [row.score for row in first.ranking] == [row.score for row in second.ranking]


def test_a_set_point_is_a_factor_on_the_load():
    gap = gap_of(table_of([Offset(2.0)], seed=8), library=["load_scale"])
    assert [step.effect for step in gap.steps] == ["load_scale"]
    assert gap.rig.effects[-1] == gap.effects[0]
    assert 1.02 < gap.effects[0].factor < 1.2  # 24/22 is four deviations out in the prior, of six draws


def test_a_constant_s_look_alikes_are_reported(simulated):
    gap = gap_of(table_of([Offset(1.0)], seed=9), library=["gain", "offset"], max_effects=1, **simulated)
    assert {gap.steps[0].effect, *gap.steps[0].look_alikes} == {"gain", "offset"}


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
        gap_of(table)


def test_unknown_effects_and_entropies_of_other_discs_are_named():
    with pytest.raises(ValueError, match="library must name"):
        gap_of(PUBLISHED.signal_statistics, library=["rust"])
    with pytest.raises(ValueError, match="8 finite numbers"):
        gap_of(PUBLISHED.signal_statistics, [1.0])
    with pytest.raises(ValueError, match="1 to 20 finite"):
        sign_flip_p([])


@pytest.mark.parametrize(
    ("key", "n_draws"),
    [
        (("clearance",), 4),
        (("load_drift",), 4),
        (("brake_rotor",), 2),
        (("clearance", "gain"), 4),
    ],
)
def test_no_rig_is_counted_twice(key, n_draws):
    settings = PublishedSettings(duration=0.1, n_draws=n_draws)
    rigs = SimulatedRigs(Comparison(sampling_rate=25_600), np.array([0]), settings)
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
def test_too_few_discs_are_warned_of(n, named, warning, records):
    made = {name: column[:n] for name, column in table_of([Offset(8.0)], seed=8).items()}
    gap = gap_of(made, library=["offset"], max_effects=1, cache=records)
    assert bool(gap.steps) == named
    assert any(row.effects for row in gap.held_out) == (warning is None)
    if warning is None:
        assert gap.warnings == ()
    else:
        assert gap.warnings[0].startswith(warning)
