"""The second stage: names, look-alikes, the unknown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from short_records import N_SAMPLES, RATE, Recorder
from sklearn.model_selection import StratifiedKFold

from cyclofeat.gap import EffectRanker, EffectTable, GapLocator, NuisancePrior, _table, summarise
from cyclofeat.gap._learned import _SETS_PER_DRAW, Typical, _sets, _temperature, _ties, sharpened
from cyclofeat.gap._ranker import _together
from cyclofeat.gap._table import _used, make_table
from cyclofeat.simulators import (
    CycloidalGearbox,
    Effect,
    Gain,
    Hum,
    Offset,
    Rig,
    SimulationFailed,
    TorqueMeterLowPass,
)

FS = RATE
BASE = Rig.r1().replace(load_drift_nm=0.0, noise_nm=0.05)
PRIOR = NuisancePrior(defect_counts=(0, 3))
SMALL = {"nuisance": PRIOR, "n_draws": 10, "n_simulations": 2, "n_null": 16, "n_recordings": 6, "n_trees": 60}

# Parts


def test_temperature_makes_votes_as_bold_as_they_are_right() -> None:
    rng = np.random.default_rng(0)
    labels = rng.integers(0, 4, 2000)
    # Right in 90 % of the cases, but the votes give the favourite 0.4 only.
    votes = np.full((2000, 4), 0.2)
    favourite = np.where(rng.random(2000) < 0.9, labels, (labels + 1) % 4)
    votes[np.arange(2000), favourite] = 0.4
    sharp = sharpened(votes, _temperature(votes, labels))
    assert sharp.max(axis=1).mean() == pytest.approx(0.9, abs=0.02)
    assert sharp.sum(axis=1) == pytest.approx(np.ones(2000))


def test_ties_are_connected_by_confusion() -> None:
    confusion = np.eye(5)
    confusion[0, 1], confusion[1, 2], confusion[3, 4] = 0.5, 0.45, 0.3
    assert _ties(confusion, list("abcde")) == [("a", "b", "c")]


def test_what_one_speed_and_load_cannot_tell_is_always_a_tie() -> None:
    names = ["gain", "hum", "sensor_drift", "offset", "load_drift"]
    assert _ties(np.eye(5), names) == [("gain", "offset"), ("sensor_drift", "load_drift")]


def test_levels_that_two_effects_raise_add_up_as_powers() -> None:
    a, b = (
        np.array([[10 * np.log10(3), 10 * np.log10(3), -2.0, 0.5]]),
        np.array([[10 * np.log10(2), -4.0, -3.0, 0.5]]),
    )
    found = _together(a, b, np.array([True, True, True, False]))
    assert found.shape == (1, 1, 4)
    # 3 and 2 times the power without effect: 1 + 2 + 1 times it together.
    assert found[0, 0] == pytest.approx([10 * np.log10(4), a[0, 1] - 4, -5, 1])


def test_typical_cases_are_rarely_refused_and_strange_ones_are() -> None:
    rng = np.random.default_rng(1)
    centres = rng.normal(0, 3, (3, 30))
    labels = np.repeat(np.arange(3), 60)
    features = centres[labels] + rng.normal(0, 1, (180, 30))
    folds = StratifiedKFold(5, shuffle=True, random_state=0).split(features, labels)
    typical = Typical(features, labels, list(folds))
    fresh = centres[0] + rng.normal(0, 1, (400, 30))
    p = typical.conformal_p(fresh)[:, 0]
    assert np.mean(p <= 0.1) == pytest.approx(0.1, abs=0.06)
    strange = centres.mean(axis=0) + 10 * rng.normal(0, 1, (50, 30))
    assert np.mean(typical.conformal_p(strange).max(axis=1) <= 0.05) > 0.9


def test_unknown_effects_are_refused() -> None:
    with pytest.raises(ValueError, match="library must name different effects of pin_errors"):
        EffectRanker(FS, library=["magic"]).fit()


def test_a_rig_with_a_brake_has_no_second_one() -> None:
    names = [EffectRanker(FS, base)._names(NuisancePrior().simulator(base)) for base in (BASE, Rig.r0())]
    assert "brake_rotor" not in names[0]
    assert "brake_rotor" in names[1]


# The table


@pytest.mark.parametrize("n_classes", [1, 2, 4, 8])
@pytest.mark.parametrize("n_recordings", [2, 4, 8])
def test_recordings_without_effect_are_used_alike(n_classes: int, n_recordings: int) -> None:
    """A draw has as many different counts as it can have, no recording twice; all serve about as often."""
    n_null = 16
    used = _used(40, n_recordings, n_null, n_classes)
    assert used.shape == (40, n_recordings)
    counts = np.arange(n_null) % n_classes
    for row in used:
        assert len(set(row)) == n_recordings
        assert len(set(counts[row])) == min(n_classes, n_recordings)
    often = np.bincount(used.ravel(), minlength=n_null)
    assert often.min() >= 0.5 * used.size / n_null


@pytest.fixture(scope="module")
def table(simulations: Path) -> EffectTable:
    return make_table(
        None, PRIOR, ["offset", "gain", "quantisation"], n_draws=5, n_recordings=2, n_null=16,
        n_samples=N_SAMPLES, sampling_rate=RATE, input_speed_hz=500 / 60, cache=simulations,
    )  # fmt: skip


def test_the_table_is_paired(table: EffectTable, recorded: Recorder) -> None:
    """With and without an effect it is the same recording: an offset moves its mean and nothing else."""
    _, cells = summarise(recorded([], (0, 3), n=1).X, RATE, 500 / 60)
    names = [cell.name for cell in cells]
    mean, level = names.index("mean"), names.index("third octave at 501 Hz")
    offsets, gains = (table.vectors[name][:, 0] for name in ("offset", "gain"))
    assert table.shifts("offset")[:, mean] == pytest.approx(offsets, abs=1e-4)
    assert table.shifts("offset")[:, level] == pytest.approx(np.zeros(5), abs=1e-3)
    assert table.shifts("gain")[:, level] == pytest.approx(20 * np.log10(np.exp(gains)), abs=2e-3)
    assert table.n_failed == 0
    # Without effect nothing is left but what recordings differ by anyway, about the mean of their count.
    left = table.null_deviations()
    for count in (0, 3):
        assert left[table.counts == count].mean(axis=0) == pytest.approx(0, abs=1e-9)


def test_sets_are_the_change_and_what_recordings_differ_by() -> None:
    """Of recordings without a count's influence: means by the shift, variances by the scatter."""
    rng = np.random.default_rng(3)
    null, used = rng.normal(size=(64, 2)), _used(30, 8, 64, 1)
    values = {"a": null[used] + [5.0, 0.0] + 0.1 * rng.normal(size=(30, 8, 2))}
    made = EffectTable(("a",), {"a": np.zeros((30, 1))}, values, used, null, np.zeros(64, dtype=int))
    for n in (2, 16):
        means, variances, _ = _sets(made, made.null_deviations(), "a", n, rng)
        assert means.shape == (30 * _SETS_PER_DRAW, 2)
        assert means.mean(axis=0) == pytest.approx([5, 0], abs=0.15)
        assert means.std(axis=0) == pytest.approx(np.full(2, 1 / np.sqrt(n)), rel=0.25)
        assert variances.mean(axis=0) == pytest.approx(null.var(axis=0, ddof=1), rel=0.2)


def test_simulations_that_fail_are_counted_and_not_learned(
    simulations: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = _table.machine

    def machine(simulator, *arguments, **options):
        if simulator.effects:
            raise SimulationFailed("it diverges")
        return real(simulator, *arguments, **options)

    monkeypatch.setattr(_table, "machine", machine)
    arguments = {"n_null": 16, "n_samples": N_SAMPLES, "sampling_rate": RATE, "input_speed_hz": 500 / 60}
    made = make_table(BASE, PRIOR, ["offset", "clearance"], n_draws=5, n_recordings=2, **arguments)
    assert made.n_failed == 10
    assert np.all(np.isnan(made.values["clearance"]))
    assert np.all(np.isfinite(made.values["offset"]))
    monkeypatch.setattr(_table, "machine", lambda *_, **__: machine(Failing()))
    with pytest.raises(SimulationFailed, match="without any effect"):
        make_table(BASE, PRIOR, ["offset"], n_draws=5, n_recordings=2, **arguments)


class Failing:
    effects = (Hum(0.1),)


# The stage as a whole


@pytest.fixture(scope="module")
def ranker(simulations: Path) -> EffectRanker:
    library = ["hum", "offset", "gain", "torque_meter_low_pass"]
    return EffectRanker(RATE, BASE, library=library, cache=simulations, **SMALL).fit()


@pytest.fixture(scope="module")
def locators(recorded: Recorder, simulations: Path) -> dict[str, GapLocator]:
    """What the first stage says of recordings with an effect hidden in them."""
    hidden: list[Effect] = [Hum(0.4), TorqueMeterLowPass(120.0), Offset(1.0), Gain(1.04)]
    found = {}
    for effect in hidden:
        bank = recorded([effect], (0, 3), n=6, seed=9, base=BASE)
        locator = GapLocator(RATE, BASE, PRIOR, n_bank=40, n_permutations=499, cache=simulations)
        found[effect.effect_id] = locator.fit(bank.X, y=bank.counts)
    return found


def test_hidden_effects_are_named(ranker: EffectRanker, locators: dict[str, GapLocator]) -> None:
    for name, locator in locators.items():
        # One load and one direction: both move the mean.
        alike = {"offset", "gain"} if name in ("offset", "gain") else {name}
        assert locator.verdict_ == "disagree", name
        ranking = ranker.rank(locator)
        assert ranking[0].effect_id in alike, name
        assert sum(ranker.proba_.values()) == pytest.approx(1.0)
        assert [row.probability for row in ranking] == sorted(ranker.proba_.values(), reverse=True)
        assert ranker.next_measurement_ == ranking[0].next_measurement != ""


def test_look_alikes_are_those_of_the_confusion(
    ranker: EffectRanker, locators: dict[str, GapLocator], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert ranker.tie_groups_ == _ties(ranker.confusion_, ranker.classes_)
    learned = ranker._learn(len(locators["hum"].measured_))
    monkeypatch.setattr(learned, "tie_groups", [("offset", "gain")])
    alike = {row.effect_id: row.look_alikes for row in ranker.rank(locators["hum"])}
    assert alike == {"hum": (), "torque_meter_low_pass": (), "offset": ("gain",), "gain": ("offset",)}


def test_what_is_left_out_is_not_named(ranker: EffectRanker, locators: dict[str, GapLocator]) -> None:
    names = [row.effect_id for row in ranker.rank(locators["hum"], without=["hum"])]
    assert sorted(names) == ["gain", "offset", "torque_meter_low_pass"]
    assert sum(row.probability for row in ranker.ranking_) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="without must leave an effect"):
        ranker.rank(locators["hum"], without=ranker.classes_)


def test_a_search_starts_near_the_truth(ranker: EffectRanker, locators: dict[str, GapLocator]) -> None:
    """Of ten draws between 0.01 and 2 Nm the nearest to 0.4 lie within a factor of three or so."""
    nearest = ranker.nearest("hum", locators["hum"], 2)
    drawn = np.exp(ranker.table_.vectors["hum"][:, 0])
    best = np.sort(np.abs(np.log(drawn / 0.4)))[:3]
    assert all(abs(np.log(effect.amplitude_nm / 0.4)) <= best[-1] + 1e-9 for effect in nearest)


def test_two_effects_are_found_as_a_pair(
    ranker: EffectRanker, locators: dict[str, GapLocator], recorded: Recorder, simulations: Path
) -> None:
    bank = recorded([TorqueMeterLowPass(120.0), Hum(0.4)], (0, 3), n=6, seed=10, base=BASE)
    locator = GapLocator(RATE, BASE, PRIOR, n_bank=40, n_permutations=499, cache=simulations)
    pairs = ranker.nearest_pairs(locator.fit(bank.X, y=bank.counts))
    assert len(pairs) == 6
    assert pairs[0].names == ("hum", "torque_meter_low_pass")
    assert sum(pair.probability for pair in pairs) == pytest.approx(1)
    assert pairs[0].probability > 0.5
    # Nothing to choose from where one effect explains all.
    alone = ranker.nearest_pairs(locators["hum"])
    assert all("hum" in pair.names for pair in alone[:2])


def test_a_table_from_the_cache_is_learned_alike(
    ranker: EffectRanker, locators: dict[str, GapLocator], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_table, "machine", None)  # nothing is simulated
    again = EffectRanker(**ranker.get_params()).fit()
    assert np.array_equal(again.confusion_, ranker.confusion_)
    assert again.rank(locators["offset"]) == ranker.rank(locators["offset"])
    assert again.conformal_p_ == ranker.conformal_p_


def test_what_is_never_found_still_has_a_name(ranker: EffectRanker) -> None:
    """At least the strongest sets of an effect are learned."""
    assert set(ranker.detectable_) == set(ranker.classes_)
    assert all(0 <= share <= 1 for share in ranker.detectable_.values())
    assert np.allclose(ranker.confusion_.sum(axis=1), 1)


def test_summaries_of_another_rate_are_refused(ranker: EffectRanker, recorded: Recorder) -> None:
    bank = recorded([], (0, 3), n=4, seed=10, base=BASE)
    other = GapLocator(RATE / 2, BASE, PRIOR, n_bank=10, n_permutations=219)
    other.fit(bank.X[:, ::2], y=bank.counts)
    with pytest.raises(ValueError, match="same sampling_rate"):
        ranker.rank(other)


def test_what_a_model_or_a_rate_cannot_have_is_left_out(tmp_path: Path) -> None:
    """The conservative law has no damping whose form could change."""
    base = CycloidalGearbox.steel(contact_law="conservative")
    options = {"n_draws": 5, "n_null": 16, "n_simulations": 2, "n_trees": 10, "cache": tmp_path}
    with pytest.raises(ValueError, match="that this model and rate can have, got contact_damping_form"):
        EffectRanker(FS, base, library=["offset", "contact_damping_form"], **options).fit()
    ranker = EffectRanker(FS, base, **options)
    ranker._names = lambda _: ["offset", "contact_damping_form", "noise"]
    assert ranker.fit().classes_ == ["offset", "noise"]
    assert ranker.left_out_ == ("contact_damping_form",)


def test_an_effect_named_twice_is_refused() -> None:
    with pytest.raises(ValueError, match="library must name different effects"):
        EffectRanker(FS, library=["hum", "hum"]).fit()
