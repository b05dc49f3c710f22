"""The third stage: hidden parameters found again, with intervals; what cannot be told is said so."""

from __future__ import annotations

import math
import pickle
import re
from typing import Any

import numpy as np
import pytest
from short_records import N_SAMPLES, RATE, Recorder

from cyclofeat.gap import (
    Bank,
    EffectFitter,
    NuisancePrior,
    _fit_interval,
    _fit_model,
    _fit_search,
    _fitter,
)
from cyclofeat.gap._summaries import Cell
from cyclofeat.simulators import (
    BrakeRotor,
    CompositeSimulator,
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


@pytest.fixture(autouse=True, scope="module")
def _small_bank():
    """40 recordings without the effect in place of 200: they are behind the weights only."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_fitter, "_BANK", 40)
        yield


def fitter(effect: Effect | list[Effect], simulations: Any, **options: Any) -> EffectFitter:
    return EffectFitter(effect, RATE, cache=simulations, **{"n_interval": 48, "n_sims": 160, **options})


@pytest.fixture(scope="module")
def with_hum(recorded: Recorder) -> Bank:
    return recorded([Hum(0.3)], COUNTS)


# Recovery


@pytest.mark.parametrize(
    ("truth", "start", "tolerance"),
    [
        (Hum(0.3), Hum(1.0), 0.1),
        (Offset(0.6), Offset(-0.3), 0.15),
        (TorqueMeterLowPass(150.0), TorqueMeterLowPass(1000.0), 0.1),
        (Noise(0.2), Noise(0.02), 0.1),
        pytest.param(ContactDampingScale(2.5), ContactDampingScale(1.0), 0.25, marks=pytest.mark.bench),
    ],
    ids=lambda value: value.effect_id if isinstance(value, Effect) else "",
)
def test_a_hidden_parameter_is_found_again(
    truth: Effect, start: Effect, tolerance: float, recorded: Recorder, simulations: Any
) -> None:
    bank = recorded([truth], COUNTS)
    found = fitter(start, simulations, alpha=0.02).fit(bank.X, y=bank.counts)
    (name,) = truth.vector_names()
    key, expected = f"{truth.effect_id}.{name}", getattr(truth, name)
    assert set(found.theta_) == set(found.theta_ci_) == set(found.identifiable_) == {key}
    assert found.theta_[key] == pytest.approx(expected, rel=tolerance)
    low, high = found.theta_ci_[key]
    assert low < found.theta_[key] < high
    assert low <= expected <= high
    assert found.identifiable_[key]
    assert not found.at_bound_[key]
    assert found.loss_ < 4
    assert found.n_failed_ == 0
    assert getattr(found.effects_[0], name) == found.theta_[key]


def test_the_model_with_the_effect_is_the_model_as_given_and_the_effect(
    with_hum: Bank, simulations: Any
) -> None:
    found = fitter(Hum(0.1), simulations).fit(with_hum.X, y=with_hum.counts)
    rig = Rig(name="mine", noise_nm=0.01)
    other = fitter(Hum(0.1), None, simulator=rig, n_sims=8, n_interval=0)
    assert found.simulator_.effects == found.effects_
    expected = CompositeSimulator(found.simulator_.base, found.effects_)
    assert found.simulator_.to_rig().to_text() == expected.to_rig().to_text()
    # The prior of what differs between assemblies belongs to the fit and not to the result.
    other.fit(with_hum.X, y=with_hum.counts)
    assert other.simulator_.base == rig


def test_two_effects_are_fitted_together(recorded: Recorder, simulations: Any) -> None:
    bank = recorded([Hum(0.3), Offset(0.6)], COUNTS)
    found = fitter([Hum(0.1), Offset(-0.2)], simulations, n_sims=240).fit(bank.X, y=bank.counts)
    assert found.theta_["hum.amplitude_nm"] == pytest.approx(0.3, rel=0.1)
    assert found.theta_["offset.offset_nm"] == pytest.approx(0.6, rel=0.15)
    assert [effect.effect_id for effect in found.effects_] == ["hum", "offset"]
    assert all(found.identifiable_.values())
    # One of them alone leaves what the other does.
    alone = fitter(Hum(0.1), simulations).fit(bank.X, y=bank.counts)
    assert alone.loss_ > 2 * found.loss_


# Repeats


@pytest.mark.bench
def test_equal_seeds_give_equal_bits_for_any_number_of_workers(with_hum: Bank, simulations: Any) -> None:
    first, again, two, other = (
        fitter(BrakeRotor(0.01, 2e4, 0.05), simulations, n_sims=16, n_interval=18, **options).fit(
            with_hum.X, y=with_hum.counts
        )
        for options in ({}, {}, {"n_jobs": 2}, {"random_state": 1})
    )
    for repeat in (again, two):
        assert repeat.theta_ == first.theta_
        assert repeat.theta_ci_ == first.theta_ci_
        assert repeat.loss_ == first.loss_
        assert repeat.n_calls_ == first.n_calls_
    assert other.theta_ != first.theta_


# What cannot be told


def test_a_truth_beyond_the_searched_range_is_at_its_bound(with_hum: Bank, simulations: Any) -> None:
    """Amplitudes are searched between 0.05 mNm and 400 Nm: no hum at all is the end of that."""
    plain = fitter(Hum(0.3), simulations)
    space = _fit_model.FitSpace((Hum(0.3),))
    assert np.exp(space.low) == pytest.approx([5e-5])
    low = plain.fit(with_hum.X - _hum_of(with_hum), y=with_hum.counts)
    assert low.theta_["hum.amplitude_nm"] < 0.02
    high = plain.fit(22 + 5e4 * _hum_of(with_hum), y=with_hum.counts)
    assert high.at_bound_["hum.amplitude_nm"]
    assert high.theta_["hum.amplitude_nm"] == pytest.approx(400, rel=0.3)


def _hum_of(bank: Bank) -> np.ndarray:
    """The part of each recording at 50 Hz, by least squares."""
    time = np.arange(N_SAMPLES) / RATE
    waves = np.column_stack([np.cos(2 * np.pi * 50 * time), np.sin(2 * np.pi * 50 * time)])
    return (waves @ np.linalg.lstsq(waves, bank.X.T - bank.X.mean(axis=1), rcond=None)[0]).T


def test_a_parameter_that_does_nothing_is_not_told(recorded: Recorder, simulations: Any) -> None:
    """A drift of no size has no cutoff."""
    bank = recorded([], COUNTS, seed=55)
    effect = SensorDrift(rms_nm=1e-3, cutoff_hz=2.0)
    found = fitter(effect, simulations, starts=[effect]).fit(bank.X, y=bank.counts)
    assert not found.identifiable_["sensor_drift.cutoff_hz"]
    assert math.isfinite(found.theta_["sensor_drift.cutoff_hz"])


# Simulations that fail


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch):
    """Makes runs fail, those for which a function of the recording's number and the effects says so."""
    real = _fit_model.machine

    def install(fails) -> None:
        def machine(simulator, nuisance, count, n_samples, rate, seed, spare=0.0):
            if seed.spawn_key and fails(seed.spawn_key[0], simulator.effects):
                raise SimulationFailed("it diverges")
            return real(simulator, nuisance, count, n_samples, rate, seed, spare=spare)

        monkeypatch.setattr(_fit_model, "machine", machine)

    return install


def test_simulations_that_fail_are_counted_and_left_out(
    with_hum: Bank, simulations: Any, failing: Any
) -> None:
    whole = fitter(Hum(0.1), simulations).fit(with_hum.X, y=with_hum.counts)
    failing(lambda i, _: i in (2, 11))
    found = fitter(Hum(0.1), simulations).fit(with_hum.X, y=with_hum.counts)
    assert found.n_failed_ == 2
    assert found.n_calls_ == whole.n_calls_
    assert found.theta_ != whole.theta_
    assert found.theta_["hum.amplitude_nm"] == pytest.approx(0.3, rel=0.1)


@pytest.mark.bench
def test_a_place_where_all_simulations_fail_is_left(
    recorded: Recorder, simulations: Any, failing: Any
) -> None:
    """Contacts damped four times as much and more cannot be simulated, say."""
    bank = recorded([ContactDampingScale(2.0)], COUNTS)
    failing(lambda _, effects: any(effect.factor > 3.0 for effect in effects))
    start = fitter(ContactDampingScale(3.9), simulations, starts=[ContactDampingScale(1.0)], n_sims=64)
    found = start.fit(bank.X, y=bank.counts)
    assert found.n_failed_ >= 4
    assert 1.0 < found.theta_["contact_damping_scale.factor"] < 3.0


def test_an_effect_that_never_can_be_simulated_is_an_error(
    with_hum: Bank, simulations: Any, failing: Any
) -> None:
    failing(lambda *_: True)
    with pytest.raises(SimulationFailed, match="the simulations.* fail"):
        fitter(Hum(0.1), simulations).fit(with_hum.X, y=with_hum.counts)


def test_an_interval_from_too_few_that_succeed_is_an_error(
    with_hum: Bank, simulations: Any, failing: Any
) -> None:
    failing(lambda i, _: i >= _fit_interval._APART and i % 4 == 1)
    with pytest.raises(SimulationFailed, match="only 3 of 4 simulations .* take a larger n_interval"):
        fitter(Hum(0.1), simulations, n_interval=12).fit(with_hum.X, y=with_hum.counts)


# Bad input


FLAT = np.full((2, N_SAMPLES), 22.0)


@pytest.mark.parametrize(
    ("effect", "X", "options", "error", "message"),
    [
        ([], FLAT, {}, TypeError, "effect must be an Effect or a sequence of them"),
        (["hum"], FLAT, {}, TypeError, "effect must be an Effect or a sequence of them, got ['hum']"),
        (
            [Hum(0.1), Hum(0.2)], np.random.default_rng(0).normal(22, 1, (2, N_SAMPLES)), {}, ValueError,
            "effect must name each effect once",
        ),
        (Hum(0.1), FLAT[:1], {}, ValueError, "groups must hold at least 2 recordings"),
        (Hum(0.1), FLAT, {"groups": [4, 4]}, ValueError, "groups must hold at least 2 recordings"),
        (Hum(0.1), FLAT[:, :2000], {}, ValueError, "at least one output turn"),
        (Hum(0.1), FLAT * np.nan, {}, ValueError, "X contains NaN"),
        (
            Hum(0.1), FLAT, {"n_interval": 4}, ValueError,
            "n_interval must be 0 or at least 9 for 1 counts of worn lobes and 1 parameters, got 4",
        ),
    ],
    ids=["nothing", "a name", "twice", "one", "one group", "short", "NaN", "few"],
)  # fmt: skip
def test_bad_input(
    effect: Any, X: np.ndarray, options: dict, error: type, message: str, simulations: Any
) -> None:
    of_fit = {name: value for name, value in options.items() if name == "groups"}
    of_fitter = {name: value for name, value in options.items() if name != "groups"}
    with pytest.raises(error, match=re.escape(message)):
        fitter(effect, simulations, **of_fitter).fit(X, y=[0, 0][: len(X)], **of_fit)


def test_an_effect_without_parameters_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Hum, "vector_names", classmethod(lambda _: []))
    with pytest.raises(ValueError, match="effect must have a parameter to fit"):
        EffectFitter(Hum(0.1), RATE).fit(FLAT)


# Parts


def test_whitened_deviations_are_uncorrelated() -> None:
    """Of recordings that scatter as those without effect: mean square one, hardly anything in common."""
    rng = np.random.default_rng(0)
    cells = [Cell("features", str(k), "1") for k in range(8)]
    mixing = np.eye(8) + 0.2 * rng.normal(size=(8, 8))
    null, fresh = (rng.normal(size=(2000, 8)) @ mixing for _ in range(2))
    found = np.cov(_fit_search.Whitener(null, null, cells)(fresh).T)
    assert np.diag(found) == pytest.approx(np.ones(8), abs=0.15)
    assert np.abs(found - np.diag(np.diag(found))).max() < 0.15


def test_a_line_through_places_is_the_line() -> None:
    """Means that are linear in the parameters give their slope back exactly."""

    class Linear:
        n_asked = 0

        def mean(self, place: np.ndarray) -> np.ndarray:
            return np.array([1.0, 2.0, 0.0]) + slope @ place

    slope = np.array([[1.0, 0.0], [0.5, -2.0], [0.0, 3.0]])
    space = _fit_model.FitSpace((SensorDrift(1.0, 2.0),))
    search = _fit_search.Search(Linear(), space, np.zeros(3), np.random.default_rng(0))
    for place in np.random.default_rng(1).uniform(-0.3, 0.3, (9, 2)):
        search.visit(space.given + place)
    mean, found = search.line(space.given)
    assert mean == pytest.approx(Linear().mean(space.given))
    assert found == pytest.approx(slope)


def test_means_of_counts_take_out_their_share_and_no_more() -> None:
    rng = np.random.default_rng(2)
    values, counts = rng.normal(size=(4000, 1)), np.repeat(np.arange(2000), 2)
    left = _fit_model.less_means(values + 9.0 * counts[:, None], counts)
    assert left.std() == pytest.approx(1.0, abs=0.05)
    assert np.all(np.abs(left.mean()) < 1e-12)


def test_recordings_of_an_evaluation_have_the_measured_counts() -> None:
    matched = _fit_model.matched_counts(np.array([4, 0, 0, 2]), NuisancePrior(), 16)
    step = _fit_model.PER_STEP
    assert sorted(matched[:step]) == sorted([0, 0, 2, 4] * (step // 4))
    assert len(matched) == 16
    assert sorted(_fit_model.matched_counts(None, NuisancePrior(), 8)) == [*range(8)]


def test_the_misfit_is_one_where_nothing_but_scatter_is_left() -> None:
    rng = np.random.default_rng(3)
    cells = [Cell("features", str(k), "1") for k in range(8)]
    null = rng.normal(size=(200, 8))

    class Normal:
        def summaries(self, place: np.ndarray, n: int) -> np.ndarray:
            return place + rng.normal(size=(n, 8))

        def centred(self, values: np.ndarray) -> np.ndarray:
            return values - values.mean(axis=0)

    for offset, least, most in ((0.0, 0.9, 1.15), (2.0, 10.0, 50.0)):
        found = [
            _fitter._misfit(Normal(), np.full(8, offset), rng.normal(size=(8, 8)), null, cells)
            for _ in range(300)
        ]
        assert least < np.mean(found) < most


def test_where_the_line_leads_astray_the_search_is_believed(
    with_hum: Bank, simulations: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_fitter, "calibrated", lambda *_: (np.log([3.0]), np.array([0.1])))
    found = fitter(Hum(0.1), simulations).fit(with_hum.X, y=with_hum.counts)
    assert found.theta_["hum.amplitude_nm"] == pytest.approx(0.3, rel=0.1)
    assert found.loss_ < 4
    low, high = found.theta_ci_["hum.amplitude_nm"]
    assert low <= 0.3 <= 3.0 <= high * 1.001  # what they disagree about is not known


def test_counts_of_recordings_are_those_measured_however_many() -> None:
    for counts, n in (([*range(8)] * 8, 48), ([*range(8)], 32), ([0, 0, 0, 3], 16)):
        found = _fit_model.matched_counts(np.array(counts), NuisancePrior(), n)
        assert len(found) == n
        for count in set(counts):
            assert np.mean(found == count) == pytest.approx(np.mean(np.array(counts) == count), abs=1 / n)


def test_both_halves_hold_all_counts_alike() -> None:
    for counts in ([0, 2, 4, 6] * 4, [0, 0, 3, 3] * 4, [5] * 8):
        of = np.array(counts)
        half = _fitter._every_other(of)
        assert sorted(of[half]) == sorted(of[~half])


# Worker processes


def test_workers_are_sent_no_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every job goes through a pickle and back, as to another process, and gives the same numbers."""
    effects, counts = (Hum(0.3), ContactDampingScale(2.0)), np.array([0, 3, 0, 3])

    def model() -> _fit_model.FitModel:
        return _fit_model.FitModel(
            composite=NuisancePrior().simulator(None), nuisance=NuisancePrior(), effects=effects,
            counts=counts, by_count=True, n_samples=N_SAMPLES, sampling_rate=RATE, input_speed_hz=500 / 60,
            n_lobes=15, by_tachometer=True, random_state=0, n_jobs=1,
        )  # fmt: skip

    here = model()
    place = _fit_model.FitSpace(effects).given
    expected = here.summaries(place, 4), *here.scattered(place[None] * np.ones((3, 1)), None, 7)
    sizes = []

    class Parallel:
        def __init__(self, n_jobs: int) -> None:
            assert n_jobs == 1

        def __call__(self, jobs: Any) -> list[Any]:
            sent = [pickle.dumps(job) for job in jobs]
            sizes.extend(len(one) for one in sent)
            return [function(*args, **options) for function, args, options in map(pickle.loads, sent)]

    monkeypatch.setattr(_fit_model.joblib, "Parallel", Parallel)
    there = model()
    there.summaries(place, 2)
    found = there.summaries(place, 4), *there.scattered(place[None] * np.ones((3, 1)), None, 7)
    assert all(np.array_equal(a, b) for a, b in zip(found, expected, strict=True))
    assert len(sizes) == 4 + 3
    assert max(sizes) < min(5000 + min(sizes), 4 * N_SAMPLES)
