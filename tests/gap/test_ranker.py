"""The second stage: names, look-alikes, the unknown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sklearn.model_selection import StratifiedKFold

from cyclofeat.gap import EffectRanker, GapLocator, NuisancePrior, make_bank
from cyclofeat.gap._ranker import _sharpened, _temperature, _ties, _Typical
from cyclofeat.simulators import CompositeSimulator, Effect, Gain, Hum, Offset, Rig, TorqueMeterLowPass

FS = 25_600
BASE = Rig.r1().replace(load_drift_nm=0.0, noise_nm=0.05)
COUNTS = [0, 3]

# Parts


def test_temperature_makes_votes_as_bold_as_they_are_right() -> None:
    rng = np.random.default_rng(0)
    labels = rng.integers(0, 4, 2000)
    # Right in 90 % of the cases, but the votes give the favourite 0.4 only.
    votes = np.full((2000, 4), 0.2)
    favourite = np.where(rng.random(2000) < 0.9, labels, (labels + 1) % 4)
    votes[np.arange(2000), favourite] = 0.4
    sharp = _sharpened(votes, _temperature(votes, labels))
    assert sharp.max(axis=1).mean() == pytest.approx(0.9, abs=0.02)
    assert sharp.sum(axis=1) == pytest.approx(np.ones(2000))


def test_ties_are_connected_by_confusion() -> None:
    confusion = np.eye(5)
    confusion[0, 1], confusion[1, 2], confusion[3, 4] = 0.5, 0.45, 0.3
    assert _ties(confusion, list("abcde")) == [("a", "b", "c")]


def test_typical_cases_are_rarely_refused_and_strange_ones_are() -> None:
    rng = np.random.default_rng(1)
    centres = rng.normal(0, 3, (3, 30))
    labels = np.repeat(np.arange(3), 60)
    features = centres[labels] + rng.normal(0, 1, (180, 30))
    typical = _Typical(features, labels, StratifiedKFold(5, shuffle=True, random_state=0))
    fresh = centres[0] + rng.normal(0, 1, (400, 30))
    p = typical.conformal_p(fresh)[:, 0]
    assert np.mean(p <= 0.1) == pytest.approx(0.1, abs=0.06)
    strange = centres.mean(axis=0) + 10 * rng.normal(0, 1, (50, 30))
    assert np.mean(typical.conformal_p(strange).max(axis=1) <= 0.05) > 0.9


def test_unknown_effects_are_refused() -> None:
    with pytest.raises(ValueError, match="library must name effects of pin_errors"):
        EffectRanker(FS, library=["magic"]).fit()


def test_a_rig_with_a_brake_has_no_second_one() -> None:
    names = [EffectRanker(FS, base)._names(NuisancePrior().simulator(base)) for base in (BASE, Rig.r0())]
    assert "brake_rotor" not in names[0]
    assert "brake_rotor" in names[1]


# The stage as a whole


@pytest.mark.slow
def test_hidden_effects_are_named_and_look_alikes_are_said(tmp_path: Path) -> None:
    library = ["hum", "offset", "gain", "torque_meter_low_pass"]
    options = {"n_draws": 24, "n_recordings": 3, "counts": COUNTS, "n_jobs": 2, "cache": tmp_path}
    ranker = EffectRanker(FS, BASE, library=library, **options).fit()
    again = EffectRanker(FS, BASE, library=library, **options).fit()  # from the cache
    assert np.array_equal(again.confusion_, ranker.confusion_)
    assert ranker.tie_groups_ == [("offset", "gain")]  # one load and one direction
    locator = GapLocator(FS, BASE, n_bank=40, n_permutations=199, cache=tmp_path, n_jobs=2)
    hidden: list[tuple[Effect, set[str]]] = [
        (Hum(0.4), {"hum"}),
        (TorqueMeterLowPass(120.0), {"torque_meter_low_pass"}),
        (Offset(1.0), {"offset", "gain"}),
        (Gain(1.04), {"offset", "gain"}),
    ]
    for effect, names in hidden:
        bank = make_bank(
            CompositeSimulator(BASE, [effect]), NuisancePrior(), COUNTS, n=6, random_state=9, n_jobs=2
        )
        locator.fit(bank.X, y=bank.counts)
        assert locator.verdict_ == "disagree", effect
        ranking = ranker.rank(locator)
        assert ranking[0].effect_id in names, effect
        assert {ranking[0].effect_id, *ranking[0].look_alikes} == names
        assert sum(ranker.proba_.values()) == pytest.approx(1.0)
        assert ranker.next_measurement_ == ranking[0].next_measurement
