"""The second stage: names, look-alikes, the unknown."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from short_records import BASE, GEARBOX, RATE, SPEED, Recorder, short
from sklearn.model_selection import StratifiedKFold

from cyclofeat.gap import (
    Bank,
    Comparison,
    Conditions,
    EffectRanker,
    EffectTable,
    LocatedGap,
    learn_effects,
    locate,
    summarise,
)
from cyclofeat.gap.simulations import Population, _population
from cyclofeat.gap.what import Typical, _ranker, _table, make_table, sharpened
from cyclofeat.gap.what._learned import _SETS_PER_DRAW, _sets, _temperature, _ties
from cyclofeat.gap.what._ranker import _in_model, _names, _together
from cyclofeat.gap.what._table import _used
from cyclofeat.simulators import (
    Effect,
    Gain,
    Hum,
    Offset,
    Rig,
    SimulationFailed,
    TorqueMeterLowPass,
)

pytestmark = pytest.mark.usefixtures("few_trees")

SMALL = {"n_draws": 10, "n_simulations": 2, "n_null": 16}


@pytest.fixture(scope="module")
def comparison(simulations: Path) -> Comparison:
    return short(rig=BASE, defect_counts=(0, 3), n_bank=24, cache=simulations)


def compared(comparison: Comparison, bank: Bank) -> LocatedGap:
    return locate(comparison, comparison.measured(bank.X, y=bank.counts), n_permutations=499)


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


def test_a_library_of_unknown_effects_is_refused(comparison: Comparison) -> None:
    with pytest.raises(ValueError, match="library must name different effects of pin_errors"):
        learn_effects(comparison, library=["magic"])
    with pytest.raises(ValueError, match="library must name different effects"):
        learn_effects(comparison, library=["hum", "hum"])


def test_a_rig_with_a_brake_has_no_second_one(comparison: Comparison) -> None:
    assert "brake_rotor" not in _names(comparison.rig, None)
    assert "brake_rotor" in _names(Rig.r0(), None)
    assert (_in_model(comparison.rig), _in_model(Rig.r0())) == (("brake_rotor",), ())


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
def table(comparison: Comparison) -> EffectTable:
    plain = comparison.replace(rig=Rig(GEARBOX))
    return make_table(plain, ["offset", "gain", "quantisation"], n_draws=5, n_recordings=2, n_null=16)


def test_the_table_is_paired(table: EffectTable, recorded: Recorder) -> None:
    """With and without an effect it is the same recording: an offset moves its mean and nothing else."""
    _, cells = summarise(recorded([], (0, 3), n=1).X, Conditions(RATE, SPEED))
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
    comparison: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, anew = _table.attempt_planned, comparison.replace(cache=None)

    def attempt_planned(plans, kernel):
        failing = [{"clearance", "hum"} & {one.effect_id for one in plan.machine.effects} for plan in plans]
        runs = zip(failing, real(plans, kernel), strict=True)
        return [SimulationFailed("it diverges") if fails else run for fails, run in runs]

    monkeypatch.setattr(_table, "attempt_planned", attempt_planned)
    size = {"n_draws": 5, "n_recordings": 2, "n_null": 16}
    table = make_table(anew, ["offset", "clearance"], **size)
    assert table.n_failed == 10
    assert np.all(np.isnan(table.values["clearance"]))
    assert np.all(np.isfinite(table.values["offset"]))
    hum = anew.replace(rig=BASE.with_added(Hum(0.1)))
    with pytest.raises(SimulationFailed, match="without any effect"):
        make_table(hum, ["offset"], **size)


def test_batches_change_no_verdict(
    comparison: Comparison, recorded: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside what recordings differ by, the error of single precision is nothing."""
    measured = recorded([Hum(0.3)], (0, 3), n=6, base=BASE)
    made = {}
    for kernel in ("exact", "batch"):
        for module in (_population, _table):
            monkeypatch.setattr(module, "KERNEL", kernel)
        anew = comparison.replace(cache=None)
        located = compared(anew, measured)
        made[kernel] = located, learn_effects(anew, library=["hum", "offset", "clearance"], **SMALL)
    (exact, of_exact), (batch, of_batch) = made.values()
    _, cells = summarise(measured.X[:1], comparison.conditions)
    # How often two samples agree in all digits is left to chance with either kernel.
    rounded = np.array([cell.name == "share of distinct values" for cell in cells])
    spread = exact.simulated.std(axis=0)[~rounded]
    error = np.abs(batch.simulated - exact.simulated)[:, ~rounded]
    assert error.max() > 0
    assert np.all(error <= 0.01 * spread)
    for name in of_exact.names:
        shift = of_batch.table.shifts(name) - of_exact.table.shifts(name)
        assert np.all(np.abs(shift[:, ~rounded]) <= 0.01 * spread), name
    for one, other in zip(exact.table, batch.table, strict=True):
        assert one.low <= other.difference <= one.high, one
    found = [{row.cell.name for row in one.table if row.p < 0.05} for one in (exact, batch)]
    assert found[0] == found[1] != set()
    for ranking in (of_exact.rank(exact), of_batch.rank(batch)):
        assert (ranking.rows[0].effect_id, ranking.unknown) == ("hum", False)


# The stage as a whole


@pytest.fixture(scope="module")
def ranker(comparison: Comparison) -> EffectRanker:
    return learn_effects(comparison, library=["hum", "offset", "gain", "torque_meter_low_pass"], **SMALL)


@pytest.fixture(scope="module")
def located(comparison: Comparison, recorded: Recorder) -> dict[str, LocatedGap]:
    """What the first stage says of recordings with an effect hidden in them."""
    hidden: list[Effect] = [Hum(0.4), TorqueMeterLowPass(120.0), Offset(1.0), Gain(1.04)]
    return {
        effect.effect_id: compared(comparison, recorded([effect], (0, 3), n=6, seed=9, base=BASE))
        for effect in hidden
    }


def test_hidden_effects_are_named(ranker: EffectRanker, located: dict[str, LocatedGap]) -> None:
    for name, gap in located.items():
        # One load and one direction: both move the mean.
        ties = {"offset", "gain"} if name in ("offset", "gain") else {name}
        assert gap.verdict == "disagree", name
        rows = ranker.rank(gap).rows
        assert rows[0].effect_id in ties, name
        shares = [row.probability for row in rows]
        assert sum(shares) == pytest.approx(1.0)
        assert shares == sorted(shares, reverse=True)
        assert rows[0].next_measurement != ""


def test_look_alikes_are_those_of_the_confusion(
    ranker: EffectRanker, located: dict[str, LocatedGap], monkeypatch: pytest.MonkeyPatch
) -> None:
    learned = ranker.learned(6)
    assert learned.tie_groups == _ties(learned.confusion, list(ranker.names))
    monkeypatch.setattr(learned, "tie_groups", [("offset", "gain")])
    ties = {row.effect_id: row.look_alikes for row in ranker.rank(located["hum"]).rows}
    assert ties == {"hum": (), "torque_meter_low_pass": (), "offset": ("gain",), "gain": ("offset",)}


def test_what_is_left_out_is_not_named(ranker: EffectRanker, located: dict[str, LocatedGap]) -> None:
    rows = ranker.rank(located["hum"], without=["hum"]).rows
    assert sorted(row.effect_id for row in rows) == ["gain", "offset", "torque_meter_low_pass"]
    assert sum(row.probability for row in rows) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="without must leave an effect"):
        ranker.rank(located["hum"], without=ranker.names)


def test_a_search_starts_near_the_truth(
    ranker: EffectRanker, located: dict[str, LocatedGap], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A draw's own change leads back to that draw; measured hum of 0.4 Nm to draws within a factor of 4."""
    nearest = ranker.nearest("hum", located["hum"], 2)
    assert all(0.1 < effect.amplitude_nm < 1.6 for effect in nearest)
    drawn = np.exp(ranker.table.vectors["hum"][:, 0])
    assert drawn.min() < 0.02
    for amplitude, shift in zip(drawn, ranker.table.shifts("hum"), strict=True):
        monkeypatch.setattr(EffectRanker, "_deviation", lambda *_, shift=shift: (shift, None))
        (own,) = ranker.nearest("hum", located["hum"])
        assert own.amplitude_nm == pytest.approx(amplitude)


def test_two_effects_are_found_as_a_pair(
    ranker: EffectRanker, located: dict[str, LocatedGap], recorded: Recorder
) -> None:
    bank = recorded([TorqueMeterLowPass(120.0), Hum(0.4)], (0, 3), n=6, seed=10, base=BASE)
    pairs = ranker.nearest_pairs(compared(ranker.comparison, bank))
    assert len(pairs) == 6
    assert pairs[0].names == ("hum", "torque_meter_low_pass")
    assert sum(pair.probability for pair in pairs) == pytest.approx(1)
    assert pairs[0].probability > 0.5
    # Nothing to choose from where one effect explains all.
    alone = ranker.nearest_pairs(located["hum"])
    assert all("hum" in pair.names for pair in alone[:2])


def test_a_table_from_the_cache_is_learned_again_to_the_same(
    ranker: EffectRanker, located: dict[str, LocatedGap], simulations: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Population, "plan_run", None)  # nothing is simulated
    again = learn_effects(ranker.comparison.replace(cache=simulations), library=ranker.names, **SMALL)
    assert np.array_equal(again.learned(6).confusion, ranker.learned(6).confusion)
    assert again.rank(located["offset"]) == ranker.rank(located["offset"])


def test_what_is_never_found_still_has_a_name(ranker: EffectRanker) -> None:
    """At least the strongest sets of an effect are learned."""
    learned = ranker.learned(6)
    assert set(learned.detectable) == set(ranker.names)
    assert all(0 <= share <= 1 for share in learned.detectable.values())
    assert np.allclose(learned.confusion.sum(axis=1), 1)


def test_summaries_of_another_rate_are_refused(ranker: EffectRanker, recorded: Recorder) -> None:
    bank = recorded([], (0, 3), n=4, seed=10, base=BASE)
    other = ranker.comparison.replace(sampling_rate=RATE / 2, n_bank=10)
    halved = dataclasses.replace(bank, X=bank.X[:, ::2])
    with pytest.raises(ValueError, match="located must be of the ranker's .*sampling_rate=6400.0"):
        ranker.rank(compared(other, halved))


def test_what_a_model_or_a_rate_cannot_have_is_left_out(comparison: Comparison) -> None:
    """The conservative law has no damping whose form could change."""
    conservative = comparison.replace(rig=Rig(GEARBOX.replace(contact_law="conservative")))
    options = {"n_draws": 5, "n_null": 16, "n_simulations": 2}
    with pytest.raises(ValueError, match="that this model and rate can have, got contact_damping_form"):
        learn_effects(conservative, library=["offset", "contact_damping_form"], **options)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_ranker, "_names", lambda *_: ["offset", "contact_damping_form", "noise"])
        ranker = learn_effects(conservative, **options)
    assert ranker.names == ("offset", "noise")
    assert ranker.unavailable == ("contact_damping_form",)
