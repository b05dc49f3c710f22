"""The third stage: hidden parameters found again, with intervals; what cannot be told is said so."""

from __future__ import annotations

import dataclasses
import functools
import math
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from short_records import GEARBOX, N_SAMPLES, RATE, Recorder, short

from cyclofeat.gap import Bank, Comparison, FittedEffects, fit_effects
from cyclofeat.gap.simulations import Population
from cyclofeat.gap.size import _fit, _interval, _model, _search
from cyclofeat.gap.summaries import Cell
from cyclofeat.simulators import (
    BrakeRotor,
    ContactDampingScale,
    Effect,
    Hum,
    Noise,
    Offset,
    Rig,
    SensorDrift,
    SimulationFailed,
    TorqueMeterLowPass,
)

COUNTS = [0, 3]


# 24 recordings without the effect in place of 200: they are behind the weights only.
COMPARISON = short(n_bank=24)


def fit(
    bank: Bank, effects: Effect | list[Effect], comparison: Comparison = COMPARISON, **options: Any
) -> FittedEffects:
    measured = comparison.measured(bank.X, y=bank.counts)
    return fit_effects(comparison, measured, effects, **{"n_interval": 18, "n_sims": 64, **options})


def anew() -> Comparison:
    """The comparison without what was fitted and simulated so far."""
    return COMPARISON.replace(cache=None)


@pytest.fixture(scope="module")
def with_hum(recorded: Recorder) -> Bank:
    return recorded([Hum(0.3)], COUNTS)


# Recovery


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "start", "tolerance"),
    [
        (Hum(0.3), Hum(0.1), 0.1),
        (Offset(0.6), Offset(-0.3), 0.15),
        (TorqueMeterLowPass(150.0), TorqueMeterLowPass(1000.0), 0.1),
        (Noise(0.2), Noise(0.02), 0.1),
        pytest.param(ContactDampingScale(2.5), ContactDampingScale(1.0), 0.25, marks=pytest.mark.bench),
    ],
    ids=lambda value: value.effect_id if isinstance(value, Effect) else "",
)
def test_a_hidden_parameter_is_found_again(
    truth: Effect, start: Effect, tolerance: float, recorded: Recorder
) -> None:
    fitted = fit(recorded([truth], COUNTS), start)
    (row,) = fitted.parameters
    expected = getattr(truth, row.name)
    assert (row.effect, [row.name]) == (truth.effect_id, truth.vector_names())
    assert row.value == pytest.approx(expected, rel=tolerance)
    assert row.low < row.value < row.high
    assert abs(expected - row.value) <= row.high - row.low
    assert row.identifiable
    assert not row.at_bound
    assert fitted.loss < 4
    assert fitted.n_failed == 0
    assert getattr(fitted.effects[0], row.name) == row.value


def test_the_model_with_the_effect_is_the_model_as_given_and_the_effect(with_hum: Bank) -> None:
    fitted = fit(with_hum, Hum(0.1))
    rig = Rig(GEARBOX, [Noise(0.01)], name="mine")
    assert fitted.rig == Rig(GEARBOX, fitted.effects)
    # What may differ anyway belongs to the comparison and not to the result.
    other = fit(with_hum, Hum(0.1), COMPARISON.replace(rig=rig, n_bank=10), n_sims=8, n_interval=0)
    assert other.rig == rig.with_added(*other.effects)


@pytest.mark.slow
def test_two_effects_are_fitted_together(recorded: Recorder) -> None:
    bank = recorded([Hum(0.3), Offset(0.6)], COUNTS)
    fitted = fit(bank, [Hum(0.1), Offset(-0.2)], n_sims=240, n_interval=32)
    assert fitted["hum.amplitude_nm"].value == pytest.approx(0.3, rel=0.1)
    assert fitted["offset.offset_nm"].value == pytest.approx(0.6, rel=0.15)
    assert [effect.effect_id for effect in fitted.effects] == ["hum", "offset"]
    assert all(row.identifiable for row in fitted.parameters)
    # One of them alone leaves what the other does.
    assert fit(bank, Hum(0.1)).loss > 2 * fitted.loss


# Repeats


@pytest.mark.bench
def test_equal_seeds_give_equal_results_for_any_number_of_workers(with_hum: Bank) -> None:
    first, again, two, other = (
        fit(with_hum, BrakeRotor(0.01, 2e4, 0.05), anew().replace(**options), n_sims=16, n_interval=18)
        for options in ({}, {}, {"n_jobs": 2}, {"random_state": 1})
    )
    assert again.parameters == two.parameters == first.parameters
    assert (again.loss, again.n_calls) == (two.loss, two.n_calls) == (first.loss, first.n_calls)
    assert other.parameters != first.parameters


def test_a_fit_is_kept(with_hum: Bank, tmp_path: Path, failing: Any) -> None:
    options = {"n_sims": 8, "n_interval": 0}
    comparison = COMPARISON.replace(n_bank=10, cache=tmp_path)
    fitted = fit(with_hum, Hum(0.1), comparison, **options)
    failing(lambda *_: True)  # nothing is simulated
    again = fit(with_hum, Hum(0.1), comparison.replace(cache=tmp_path, n_jobs=2), **options)
    assert again.parameters == fitted.parameters
    with pytest.raises(SimulationFailed):
        fit(with_hum, Hum(0.2), comparison, **options)


# What cannot be told


def test_a_truth_beyond_the_searched_range_is_at_its_bound(with_hum: Bank) -> None:
    """Amplitudes are searched between 0.05 mNm and 400 Nm: no hum at all is the end of that."""
    space = _model.FitSpace((Hum(0.3),))
    assert np.exp(space.low) == pytest.approx([5e-5])
    (low,) = fit(dataclasses.replace(with_hum, X=with_hum.X - _hum_of(with_hum)), Hum(0.3)).parameters
    assert low.value < 0.02
    (high,) = fit(dataclasses.replace(with_hum, X=22 + 5e4 * _hum_of(with_hum)), Hum(0.3)).parameters
    assert high.at_bound
    assert high.value == pytest.approx(400, rel=0.3)


def _hum_of(bank: Bank) -> np.ndarray:
    """The part of each recording at 50 Hz, by least squares."""
    time = np.arange(N_SAMPLES) / RATE
    waves = np.column_stack([np.cos(2 * np.pi * 50 * time), np.sin(2 * np.pi * 50 * time)])
    return (waves @ np.linalg.lstsq(waves, bank.X.T - bank.X.mean(axis=1), rcond=None)[0]).T


def test_a_parameter_that_does_nothing_is_not_told(recorded: Recorder) -> None:
    """A drift of no size has no cutoff."""
    effect = SensorDrift(rms_nm=1e-3, cutoff_hz=2.0)
    cutoff = fit(recorded([], COUNTS, seed=55), effect, starts=[effect])["sensor_drift.cutoff_hz"]
    assert not cutoff.identifiable
    assert math.isfinite(cutoff.value)


# Simulations that fail


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch):
    """Makes runs fail, those for which a function of the recording's number and the effects says so."""
    real = Population.run_machine

    def install(fails) -> None:
        def run_machine(self, count, random_state, assembly=None, spare=0.0):
            # The bank's runs have no spare time, those of a fit have.
            if spare and fails(random_state.spawn_key[0], self.rig.effects):
                raise SimulationFailed("it diverges")
            return real(self, count, random_state, assembly, spare)

        monkeypatch.setattr(Population, "run_machine", run_machine)

    return install


def test_simulations_that_fail_are_counted_and_left_out(with_hum: Bank, failing: Any) -> None:
    whole = fit(with_hum, Hum(0.1))
    failing(lambda i, _: i in (2, 11))
    fitted = fit(with_hum, Hum(0.1), anew())
    assert fitted.n_failed == 2
    assert fitted.n_calls == whole.n_calls
    assert fitted.parameters != whole.parameters
    assert fitted["hum.amplitude_nm"].value == pytest.approx(0.3, rel=0.1)


@pytest.mark.bench
def test_a_place_where_all_simulations_fail_is_left(recorded: Recorder, failing: Any) -> None:
    """Contacts damped four times as much and more cannot be simulated, say."""
    bank = recorded([ContactDampingScale(2.0)], COUNTS)
    failing(lambda _, effects: any(isinstance(e, ContactDampingScale) and e.factor > 3.0 for e in effects))
    starts = [ContactDampingScale(1.0)]
    fitted = fit(bank, ContactDampingScale(3.9), anew(), starts=starts, n_sims=64)
    assert fitted.n_failed >= 4
    assert 1.0 < fitted["contact_damping_scale.factor"].value < 3.0


def test_an_effect_that_never_can_be_simulated_is_an_error(with_hum: Bank, failing: Any) -> None:
    failing(lambda *_: True)
    with pytest.raises(SimulationFailed, match="the simulations.* fail"):
        fit(with_hum, Hum(0.1), anew())


def test_an_interval_from_too_few_that_succeed_is_an_error(with_hum: Bank, failing: Any) -> None:
    failing(lambda i, _: i >= _interval._FIRST_NUMBER and i % 4 == 1)
    with pytest.raises(SimulationFailed, match="only 3 of 4 simulations .* take a larger n_interval"):
        fit(with_hum, Hum(0.1), anew(), n_interval=12)


# Bad input


FLAT = np.full((2, N_SAMPLES), 22.0)


@pytest.mark.parametrize(
    ("effect", "X", "options", "error", "message"),
    [
        ([], FLAT, {}, TypeError, "effects must be an Effect or a sequence of them"),
        (["hum"], FLAT, {}, TypeError, "effects must be an Effect or a sequence of them, got ['hum']"),
        ([Hum(0.1), Hum(0.2)], FLAT, {}, ValueError, "effect must name each effect once"),
        (Hum(0.1), FLAT[:1], {}, ValueError, "groups must hold at least 2 recordings"),
        (
            Hum(0.1), FLAT, {"n_interval": 4}, ValueError,
            "n_interval must be 0 or at least 9 for 1 counts of worn lobes and 1 parameters, got 4",
        ),
    ],
    ids=["nothing", "a name", "twice", "one", "few"],
)  # fmt: skip
def test_bad_input(effect: Any, X: np.ndarray, options: dict, error: type, message: str) -> None:
    measured = COMPARISON.measured(X, y=[0, 0][: len(X)])
    with pytest.raises(error, match=re.escape(message)):
        fit_effects(COMPARISON, measured, effect, **options)


def test_an_effect_without_parameters_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Hum, "vector_names", classmethod(lambda _: []))
    with pytest.raises(ValueError, match="effects must have a parameter to fit"):
        fit_effects(COMPARISON, COMPARISON.measured(FLAT), Hum(0.1))


# Parts


def test_whitened_deviations_are_uncorrelated() -> None:
    """Of recordings that scatter as those without effect: mean square one, hardly anything in common."""
    rng = np.random.default_rng(0)
    cells = [Cell("features", str(k), "1") for k in range(8)]
    mixing = np.eye(8) + 0.2 * rng.normal(size=(8, 8))
    null, fresh = (rng.normal(size=(2000, 8)) @ mixing for _ in range(2))
    found = np.cov(_search.Whitener(null, null, cells)(fresh).T)
    assert np.diag(found) == pytest.approx(np.ones(8), abs=0.15)
    assert np.abs(found - np.diag(np.diag(found))).max() < 0.15


def test_a_line_through_places_is_the_line() -> None:
    """Means that are linear in the parameters give their slope back exactly."""

    class Linear:
        n_asked = 0
        space = _model.FitSpace((SensorDrift(1.0, 2.0),))

        def mean(self, place: np.ndarray) -> np.ndarray:
            return np.array([1.0, 2.0, 0.0]) + slope @ place

    slope = np.array([[1.0, 0.0], [0.5, -2.0], [0.0, 3.0]])
    space = Linear.space
    search = _search.Search(Linear(), np.zeros(3), np.random.default_rng(0))
    for place in np.random.default_rng(1).uniform(-0.3, 0.3, (9, 2)):
        search.visit(space.given + place)
    mean, found = search.line(space.given)
    assert mean == pytest.approx(Linear().mean(space.given))
    assert found == pytest.approx(slope)


def test_means_of_counts_take_out_their_share_and_no_more() -> None:
    rng = np.random.default_rng(2)
    values, counts = rng.normal(size=(4000, 1)), np.repeat(np.arange(2000), 2)
    left = _model.less_own_means(values + 9.0 * counts[:, None], counts)
    assert left.std() == pytest.approx(1.0, abs=0.05)
    assert np.all(np.abs(left.mean()) < 1e-12)


def test_recordings_of_an_evaluation_have_the_measured_counts() -> None:
    matched = _model.matched_counts(np.array([4, 0, 0, 2]), 16)
    step = _model.PER_STEP
    assert sorted(matched[:step]) == sorted([0, 0, 2, 4] * (step // 4))
    assert len(matched) == 16
    assert sorted(_model.matched_counts(np.arange(8), 8)) == [*range(8)]


def test_the_misfit_is_one_where_nothing_but_scatter_is_left() -> None:
    rng = np.random.default_rng(3)
    cells = [Cell("features", str(k), "1") for k in range(8)]
    weigh = functools.partial(_search.Whitener, rng.normal(size=(200, 8)), cells=cells)

    class Normal:
        def summaries(self, place: np.ndarray, n: int) -> np.ndarray:
            return place + rng.normal(size=(n, 8))

        def centred(self, values: np.ndarray) -> np.ndarray:
            return values - values.mean(axis=0)

    for offset, least, most in ((0.0, 0.9, 1.15), (2.0, 10.0, 50.0)):
        found = [
            _fit._misfit(Normal(), rng.normal(size=(8, 8)), weigh, np.full(8, offset)) for _ in range(300)
        ]
        assert least < np.mean(found) < most


def test_where_the_line_leads_astray_the_search_is_believed(
    with_hum: Bank, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_fit, "calibrated", lambda *_: (np.log([3.0]), np.array([0.1])))
    fitted = fit(with_hum, Hum(0.1), anew())
    (row,) = fitted.parameters
    assert row.value == pytest.approx(0.3, rel=0.1)
    assert fitted.loss < 4
    assert row.low <= 0.3 <= 3.0 <= row.high * 1.001  # the interval holds both


def test_counts_of_recordings_are_those_measured_however_many() -> None:
    for counts, n in (([*range(8)] * 8, 48), ([*range(8)], 32), ([0, 0, 0, 3], 16)):
        found = _model.matched_counts(np.array(counts), n)
        assert len(found) == n
        for count in set(counts):
            assert np.mean(found == count) == pytest.approx(np.mean(np.array(counts) == count), abs=1 / n)


def test_both_halves_hold_all_counts_alike() -> None:
    for counts in ([0, 2, 4, 6] * 4, [0, 0, 3, 3] * 4, [5] * 8):
        of = np.array(counts)
        half = _fit._every_other(of)
        assert sorted(of[half]) == sorted(of[~half])


# Worker processes


def test_workers_are_sent_no_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every job goes through a pickle and back, as to another process, and gives the same numbers."""
    effects, counts = (Hum(0.3), ContactDampingScale(2.0)), np.array([0, 3, 0, 3])

    def model() -> _model.FitModel:
        return _model.FitModel(COMPARISON.replace(tachometer=True), effects, counts)

    here = model()
    place = _model.FitSpace(effects).given
    expected = here.summaries(place, 4), *here.scattered(place[None] * np.ones((3, 1)), 7)
    sizes = []

    class Parallel:
        def __init__(self, n_jobs: int) -> None:
            assert n_jobs == 1

        def __call__(self, jobs: Any) -> list[Any]:
            sent = [pickle.dumps(job) for job in jobs]
            sizes.extend(len(one) for one in sent)
            return [function(*args, **options) for function, args, options in map(pickle.loads, sent)]

    monkeypatch.setattr(_model.joblib, "Parallel", Parallel)
    there = model()
    there.summaries(place, 2)
    found = there.summaries(place, 4), *there.scattered(place[None] * np.ones((3, 1)), 7)
    assert all(np.array_equal(a, b) for a, b in zip(found, expected, strict=True))
    assert len(sizes) == 4 + 3
    assert max(sizes) < min(5000 + min(sizes), 4 * N_SAMPLES)
