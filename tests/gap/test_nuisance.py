"""What a session has in common: speed and load are explained within the prior, an assembly counts once."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import uniform
from short_records import BASE, RATE, short

import cyclofeat.gap
from cyclofeat.gap import Comparison
from cyclofeat.gap.comparison import corrected_rig, measured_turns
from cyclofeat.gap.simulations import SIMULATED_BY
from cyclofeat.gap.summaries.summarise import Cell
from cyclofeat.gap.where.locate import (
    LocatedGap,
    SpeedAndLoadTrend,
    intraclass_correlation,
    locate,
    widening_factor,
)
from cyclofeat.simulators import Clearance, CycloidalGearbox, Offset, PinErrors, Rig

CELLS = [
    Cell("speed", "input speed by the mesh lines", "%"),
    Cell("amplitudes", "mean", "Nm"),
    Cell("spectrum", "third octave at 10 Hz", "dB"),
]
SMALLEST = np.array([0.02, 0.01, 0.1])
SLOPES = np.array([5.0, -3.0])
COUNTS = [0, 3, 6]


def recordings(n: int, seed: int, own: np.ndarray | None = None) -> np.ndarray:
    """Recordings whose third cell follows the other two."""
    rng = np.random.default_rng(seed)
    if own is None:
        own = rng.uniform(-1, 1, (n, 2)) * [0.3, 0.1]
    return np.column_stack([own, own @ SLOPES + 0.01 * rng.normal(size=len(own))])


def test_what_follows_speed_and_load_is_taken_out() -> None:
    bank = recordings(200, 0)
    trend = SpeedAndLoadTrend(bank, CELLS, SMALLEST)
    left = trend.without(recordings(50, 1))
    assert np.all(left[:, :2] == 0)
    assert np.abs(left[:, 2] - trend.without(bank)[:, 2].mean()).max() < 0.06
    assert np.abs(recordings(50, 1)[:, 2]).max() > 1


def test_what_goes_beyond_the_bank_stays() -> None:
    own = np.array([[0.9, 0.0], [0.0, -0.5]])
    bank = recordings(2000, 0)
    trend = SpeedAndLoadTrend(bank, CELLS, SMALLEST)
    left = trend.without(recordings(2, 1, own)) - [0, 0, trend.without(bank)[:, 2].mean()]
    assert left[[0, 1], [0, 1]] == pytest.approx([0.9, -0.5], abs=0.02)
    assert left[[0, 1], [1, 0]].tolist() == [0, 0]
    # The cell that follows keeps what the part beyond, by twice what is of no consequence, does to it.
    beyond = np.array([0.9 - 0.3, -(0.5 - 0.1)]) - [0.04, -0.02]
    assert left[:, 2] == pytest.approx(beyond * SLOPES, abs=0.1)


def test_the_tachometer_is_believed_where_there_is_one() -> None:
    cells = [CELLS[0], Cell("speed", "input speed by the tachometer", "%"), CELLS[1]]
    values = np.random.default_rng(0).normal(size=(50, 3))
    left = SpeedAndLoadTrend(values, cells, SMALLEST).without(values)
    assert np.all(left[:, 1:] == 0)
    assert left[:, 0].std() > 0.5


def test_a_constant_speed_explains_nothing() -> None:
    bank = recordings(100, 0)
    bank[:, 0] = 0.0
    left = SpeedAndLoadTrend(bank, CELLS, SMALLEST).without(bank)
    assert left[:, 2] == pytest.approx(bank[:, 2] - (bank[:, 1] - bank[:, 1].mean()) * _slope(bank), abs=1e-9)


def _slope(bank: np.ndarray) -> float:
    own = bank[:, 1] - bank[:, 1].mean()
    return float(own @ bank[:, 2] / (own @ own))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
def test_the_intraclass_correlation_is_the_share_of_variance(share: float) -> None:
    rng = np.random.default_rng(1)
    of = np.repeat(np.arange(4000), 4)
    values = np.sqrt(share) * rng.normal(size=(4000, 2))[of] + np.sqrt(1 - share) * rng.normal(
        size=(16_000, 2)
    )
    assert intraclass_correlation(values, of) == pytest.approx(share, abs=0.02)


def test_the_intraclass_correlation_of_unequal_assemblies() -> None:
    """One of three recordings failed now and then: the estimate is still the share."""
    rng = np.random.default_rng(2)
    of = np.repeat(np.arange(5000), rng.integers(1, 5, 5000))
    values = rng.normal(size=(5000, 1))[of] + rng.normal(size=(len(of), 1))
    assert intraclass_correlation(values, of) == pytest.approx(0.5, abs=0.03)


def test_widening_is_that_of_the_mean_of_correlated_recordings() -> None:
    rng, n, share = np.random.default_rng(3), 8, 0.4
    shared = np.sqrt(share) * rng.normal(size=(50_000, 1))
    means = (shared + np.sqrt(1 - share) * rng.normal(size=(50_000, n))).mean(axis=1)
    assert widening_factor(np.array([share]), n)[0] == pytest.approx(means.std() * np.sqrt(n), rel=0.02)
    assert widening_factor(np.array([0.0]), n)[0] == 1


def _session(cache: Path, seed: int, **of_rig: object) -> np.ndarray:
    """Six recordings at one end of what may differ."""
    rig = BASE.replace(gearbox=BASE.gearbox.replace(**of_rig))
    comparison = short(rig=rig, may_differ=(PinErrors(5e-6),), cache=cache)
    return comparison.bank(6, COUNTS, random_state=seed).X


def compared(comparison: Comparison, X: np.ndarray, **options: Any) -> LocatedGap:
    return locate(comparison, measured_turns(comparison, X, y=COUNTS * 2), n_permutations=499, **options)


@pytest.mark.slow
def test_a_session_at_the_end_of_the_prior_agrees(comparison: Comparison, simulations: Path) -> None:
    """Lines through 200 recordings reach to the ends of the prior, through 40 they do not."""
    box = BASE.gearbox
    X = _session(simulations, 32, input_speed=box.input_speed * 0.9971, load_torque=box.load_torque * 1.0048)
    assert compared(comparison.replace(n_bank=200), X).where.verdict != "disagree"


def test_a_session_beyond_it_does_not(comparison: Comparison, simulations: Path) -> None:
    X = _session(simulations, 31, load_torque=BASE.gearbox.load_torque * 0.985)
    assert compared(comparison, X).where.family_p["amplitudes"] <= 0.05


@pytest.mark.slow
def test_one_assembly_widens(comparison: Comparison) -> None:
    bank = comparison.bank(6, COUNTS, n_assemblies=1, random_state=32)
    assert bank.assemblies.tolist() == [0] * 6
    of_one = comparison.replace(one_assembly=True)
    many, one = compared(comparison, bank.X), compared(of_one, bank.X)
    assert not many.shared_variance.any()
    assert np.median(one.shared_variance) > 0.05
    assert one.shared_variance.max() < 1
    errors = [
        np.array([row.detectable for row in sorted(located.where.rows, key=lambda r: (r.of, str(r.cell)))])
        for located in (many, one)
    ]
    assert np.all(errors[1] >= errors[0] - 1e-12)


def test_an_offset_within_what_the_load_may_do_is_not_a_disagreement(comparison: Comparison) -> None:
    truth = comparison.replace(rig=BASE.with_added(Offset(0.05)))
    X = truth.bank(6, COUNTS, random_state=33).X
    assert compared(comparison, X).where.family_p["amplitudes"] > 0.05


# The model with what may differ


def test_what_may_differ_is_added_where_a_model_does_not_state_it() -> None:
    own = Comparison(sampling_rate=RATE, rig=Rig(CycloidalGearbox.steel(clearance=5e-5)))
    wide = own.replace(may_differ=(Clearance(uniform(0.0, 2e-5)),)).population.rig
    clearances = [wide.draw(seed).gearbox.clearance for seed in range(40)]
    assert 5e-5 < min(clearances) < 5.3e-5 < 6.7e-5 < max(clearances) < 7e-5
    assert own.population.rig.draw(0).gearbox.clearance == 5e-5
    stated = own.replace(rig=Rig(effects=[PinErrors(20e-6)])).population.rig
    assert [effect.effect_id for effect in stated.effects] == ["pin_errors", "load_scale", "speed_scale"]
    assert stated.effects[0] == PinErrors(20e-6)


def test_a_correction_comes_on_top_of_what_may_differ() -> None:
    comparison = short(rig=BASE)
    assert corrected_rig(comparison, [Offset(1.0)]) == BASE.with_added(Offset(1.0))
    of_pins = corrected_rig(comparison, [PinErrors(20e-6)])
    assert of_pins == BASE.with_added(PinErrors(5e-6), PinErrors(20e-6))


def test_a_model_of_another_speed_is_refused() -> None:
    for speed in (500 / 60, 510 / 60):
        assert Comparison(sampling_rate=RATE, input_speed_hz=speed).n_lobes == 15
    with pytest.raises(ValueError, match=r"must be the model's speed, 8.333 Hz \(500 RPM\), got 16.67"):
        Comparison(sampling_rate=RATE, input_speed_hz=1000 / 60)


# Kept banks


def test_banks_are_named_by_all_the_code_that_summarises_them() -> None:
    package = Path(cyclofeat.gap.__file__).parents[1]

    def imported(name: str, seen: set[str]) -> set[str]:
        if name not in seen and (package / name).exists():
            seen.add(name)
            for node in ast.walk(ast.parse((package / name).read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("cyclofeat"):
                    inside = "/".join((node.module or "").split(".")[1:])
                    names = [inside] if inside else [alias.name for alias in node.names]
                    for other in names:
                        imported(f"{other}.py", seen)
        return seen

    start = ("summaries/summarise", "summaries/turns", "simulations")
    needed = set().union(*(imported(f"gap/{name}.py", set()) for name in start))
    named = (*SIMULATED_BY, "_base")
    assert len(needed) > len(start)
    assert all(name.startswith(tuple(f"{room}/" for room in named)) or name[:-3] in named for name in needed)
