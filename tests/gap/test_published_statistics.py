"""Published statistics without recordings: effects hidden in eight rows of numbers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cyclofeat.datasets import load_published_tables
from cyclofeat.gap import Comparison, find_published_gap
from cyclofeat.gap.cases.published_table import (
    PublishedTable,
    published_effects,
    published_session,
    to_statistics,
)
from cyclofeat.gap.engine.search import explain
from cyclofeat.simulators import CycloidalGearbox, Drift, Offset, Rig

pytestmark = pytest.mark.slow

DRIFT, OFFSET = "sensor_drift or load_drift", "offset or gain or load_scale"
EFFECTS = {name: effect for name, effect in published_effects().items() if name in (DRIFT, OFFSET, "noise")}
PUBLISHED = load_published_tables().signal_statistics


def session_of(statistics, table=None, effects=EFFECTS, random_state=0, rig=None):
    comparison = Comparison(sampling_rate=25_600, rig=rig, random_state=random_state)
    session = published_session(comparison, statistics, duration=0.1, n_draws=2, table=table)
    session.problem.effects = effects
    return session


def table_of(effects, seed: int, duration: float = 0.1) -> dict[str, np.ndarray]:
    """Statistics that a paper would print of eight discs on a rig with these effects."""
    population = Comparison(sampling_rate=25_600, rig=Rig(CycloidalGearbox.steel(), effects)).population
    population = dataclasses.replace(population, n_samples=round(duration * 25_600))
    torque = [population.record(k, np.random.SeedSequence([seed, k])).torque.astype(float) for k in range(8)]
    columns = {f"{name}_nm": [getattr(x, name)() for x in torque] for name in ("min", "max", "mean", "std")}
    return {name: np.array(column) for name, column in ({"defect_count": range(8)} | columns).items()}


def test_what_the_tables_say_themselves():
    """Mean above the set-point in 8 of 8 by 0.51 Nm, up over down 1.62 in 8 of 8."""
    columns = [PUBLISHED[name] for name in ("min_nm", "max_nm", "mean_nm", "std_nm")]
    statistics = to_statistics(np.stack(columns, axis=-1), 22.0)
    assert (statistics[:, 0] > 0).all()
    assert statistics[:, 0].mean() == pytest.approx(0.506, abs=0.001)
    assert (statistics[:, 2] > statistics[:, 3]).all()
    up, down = np.exp(statistics[:, 2:]).sum(axis=0)
    assert up / down == pytest.approx(1.62, abs=0.01)


@pytest.fixture(scope="module")
def drift():
    session = session_of(table_of([Drift(rms_nm=4.0, cutoff_hz=15.0, of="sensor")], seed=5))
    return session, explain(session)


@pytest.fixture(scope="module")
def stored(drift, tmp_path_factory):
    """File of everything simulated above."""
    path = tmp_path_factory.mktemp("table") / "table.npz"
    drift[0].problem.save(path)
    return path


def test_a_hidden_drift_is_found_with_its_size(drift):
    session, gap = drift
    assert gap.order[0] == DRIFT
    assert [name for name, p in gap.probabilities.items() if p >= 0.5] == [DRIFT] == list(gap.rig)
    assert gap.sizes[DRIFT]["rms_nm"].unit == "Nm"
    assert 2.0 < gap.rig[DRIFT]["rms_nm"] < 8.0
    without, with_it = np.abs(session.deviations([{}, gap.rig]))[..., 1].mean(axis=1)
    assert with_it < 0.2 * without


def test_nothing_is_named_where_nothing_is_missing(stored):
    gap = explain(session_of(table_of([], seed=6), stored))
    assert max(gap.probabilities.values()) < 0.5
    assert gap.rig == {}


def test_a_constant_is_found_with_its_look_alikes(stored):
    gap = explain(session_of(table_of([Offset(1.0)], seed=9), stored))
    assert gap.state(OFFSET) == "missing"
    assert gap.rig[OFFSET]["offset_nm"] == pytest.approx(1.0, abs=0.2)


def test_stored_simulations_are_the_same_again(drift, stored, monkeypatch):
    session = drift[0]
    again = session_of(table_of([], seed=6), stored)
    monkeypatch.setattr(PublishedTable, "_simulate_gear", None)
    for key, parts in session.problem.tables.items():
        for one, other in zip(parts, again.problem.table(key), strict=True):
            assert other == pytest.approx(one, rel=2e-3, abs=2e-3)
    made = {name: PUBLISHED[name] for name in PUBLISHED.dtype.names}
    for change in ({"random_state": 1}, {"rig": CycloidalGearbox.steel().replace(load_torque=21.0)}):
        with pytest.raises(ValueError, match="was made with another"):
            session_of(made, stored, **change)


def test_one_effect_of_look_alikes_is_tried_and_one_of_the_gearbox():
    effects = published_effects()
    words = [word for name in effects for word in name.split(" or ")]
    assert len(set(words)) == len(words)
    assert {DRIFT, OFFSET, "brake_rotor"} <= effects.keys()
    assert not any("clock" in word for word in words)
    assert {"clearance", "speed_wander"} <= {*effects["brake_rotor"].excludes}
    assert effects[DRIFT].excludes == ()


@pytest.mark.parametrize("key", [("clearance",), ("brake_rotor",), ("clearance", "offset"), ("hum", "noise")])
def test_no_rig_is_counted_twice_and_the_interpolation_stays_among_them(key):
    problem = PublishedTable(
        Comparison(sampling_rate=25_600), np.array([0]), np.ones(4), duration=0.1, n_draws=2
    )
    theta, values = problem.table(key)
    assert len(np.unique(theta, axis=0)) == len(theta) == len(values)
    high = theta.max(axis=0)
    beyond = problem.interpolate(key)(np.array([high, high * 10]))
    assert beyond[0] == pytest.approx(beyond[1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop("std_nm"), "columns defect_count, min_nm"),
        (lambda t: t.update(std_nm=t["std_nm"] * np.nan), "finite"),
        (lambda t: t.update(min_nm=t["max_nm"]), "min_nm < mean_nm"),
        (lambda t: t.update(range_nm=t["std_nm"]), "range_nm must be"),
        (lambda t: t.update({k: v[:2] for k, v in t.items()}), "at least 3 rows"),
        (lambda t: t.update(defect_count=t["defect_count"] + 0.5), "whole numbers"),
        (lambda t: t.update(std_nm=t["std_nm"] * 0 + 3.0), "must differ between discs"),
    ],
)
def test_bad_tables_are_named(change, message):
    table = {name: PUBLISHED[name].copy() for name in PUBLISHED.dtype.names}
    change(table)
    with pytest.raises(ValueError, match=message):
        find_published_gap(Comparison(sampling_rate=25_600), table)
