"""What a session has in common: speed and load are explained within the prior, an assembly counts once."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

import cyclofeat.gap
from cyclofeat.gap import EffectFitter, EffectRanker, GapLocator, NuisancePrior, _null, make_bank
from cyclofeat.gap._nuisance import SpeedAndLoad, alikeness, widening
from cyclofeat.gap._summaries import Cell
from cyclofeat.simulators import AssemblyTolerances, CompositeSimulator, CycloidalGearbox, Hum, Offset, Rig

CELLS = [
    Cell("speed", "input speed by the mesh lines", "%"),
    Cell("amplitudes", "mean", "Nm"),
    Cell("spectrum", "third octave at 10 Hz", "dB"),
]
SMALLEST = np.array([0.02, 0.01, 0.1])
SLOPES = np.array([5.0, -3.0])
SHORT = {"n_samples": 11_520, "sampling_rate": 6400.0}
BASE = Rig.r1().replace(load_drift_nm=0.0, noise_nm=0.05)
COUNTS = [0, 3, 6]


def recordings(n: int, seed: int, own: np.ndarray | None = None) -> np.ndarray:
    """Recordings whose third cell follows the other two."""
    rng = np.random.default_rng(seed)
    if own is None:
        own = rng.uniform(-1, 1, (n, 2)) * [0.3, 0.1]
    return np.column_stack([own, own @ SLOPES + 0.01 * rng.normal(size=len(own))])


def test_what_follows_speed_and_load_is_taken_out() -> None:
    bank = recordings(200, 0)
    trend = SpeedAndLoad(bank, CELLS, SMALLEST)
    left = trend.without(recordings(50, 1))
    assert np.all(left[:, :2] == 0)
    assert np.abs(left[:, 2] - trend.without(bank)[:, 2].mean()).max() < 0.06
    assert np.abs(recordings(50, 1)[:, 2]).max() > 1


def test_what_goes_beyond_the_bank_stays() -> None:
    own = np.array([[0.9, 0.0], [0.0, -0.5]])
    bank = recordings(2000, 0)
    trend = SpeedAndLoad(bank, CELLS, SMALLEST)
    left = trend.without(recordings(2, 1, own)) - [0, 0, trend.without(bank)[:, 2].mean()]
    assert left[[0, 1], [0, 1]] == pytest.approx([0.9, -0.5], abs=0.02)
    assert left[[0, 1], [1, 0]].tolist() == [0, 0]
    # The cell that follows keeps what the part beyond, by twice what is of no consequence, does to it.
    beyond = np.array([0.9 - 0.3, -(0.5 - 0.1)]) - [0.04, -0.02]
    assert left[:, 2] == pytest.approx(beyond * SLOPES, abs=0.1)


def test_the_tachometer_is_believed_where_there_is_one() -> None:
    cells = [CELLS[0], Cell("speed", "input speed by the tachometer", "%"), CELLS[1]]
    values = np.random.default_rng(0).normal(size=(50, 3))
    left = SpeedAndLoad(values, cells, SMALLEST).without(values)
    assert np.all(left[:, 1:] == 0)
    assert left[:, 0].std() > 0.5


def test_a_constant_speed_explains_nothing() -> None:
    bank = recordings(100, 0)
    bank[:, 0] = 0.0
    left = SpeedAndLoad(bank, CELLS, SMALLEST).without(bank)
    assert left[:, 2] == pytest.approx(bank[:, 2] - (bank[:, 1] - bank[:, 1].mean()) * _slope(bank), abs=1e-9)


def _slope(bank: np.ndarray) -> float:
    own = bank[:, 1] - bank[:, 1].mean()
    return float(own @ bank[:, 2] / (own @ own))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
def test_alikeness_is_the_share_of_variance(share: float) -> None:
    rng = np.random.default_rng(1)
    of = np.repeat(np.arange(4000), 4)
    values = np.sqrt(share) * rng.normal(size=(4000, 2))[of] + np.sqrt(1 - share) * rng.normal(
        size=(16_000, 2)
    )
    assert alikeness(values, of) == pytest.approx(share, abs=0.02)


def test_alikeness_of_unequal_assemblies() -> None:
    """One of three recordings failed now and then: the estimate is still the share."""
    rng = np.random.default_rng(2)
    of = np.repeat(np.arange(5000), rng.integers(1, 5, 5000))
    values = rng.normal(size=(5000, 1))[of] + rng.normal(size=(len(of), 1))
    assert alikeness(values, of) == pytest.approx(0.5, abs=0.03)


def test_widening_is_that_of_the_mean_of_correlated_recordings() -> None:
    rng, n, share = np.random.default_rng(3), 8, 0.4
    shared = np.sqrt(share) * rng.normal(size=(50_000, 1))
    means = (shared + np.sqrt(1 - share) * rng.normal(size=(50_000, n))).mean(axis=1)
    assert widening(np.array([share]), n)[0] == pytest.approx(means.std() * np.sqrt(n), rel=0.02)
    assert widening(np.array([0.0]), n)[0] == 1


def _session(cache: Path, seed: int, **of_rig: object) -> np.ndarray:
    """Six recordings at one end of what the prior allows."""
    tolerances = AssemblyTolerances(
        pin_position=5e-6, runout=0.0, stiffness=0.0, damping=0.0, load=0.0, speed=0.0, clearance=(0.0, 0.0)
    )
    rig = BASE.replace(gearbox=BASE.gearbox.replace(**of_rig))
    bank = make_bank(rig, NuisancePrior(tolerances), COUNTS, n=6, random_state=seed, cache=cache, **SHORT)
    return bank.X


@pytest.mark.slow
def test_a_session_at_the_end_of_the_prior_agrees(simulations: Path) -> None:
    """Lines through 200 recordings reach to the ends of the prior, through 40 they do not."""
    box = BASE.gearbox
    X = _session(simulations, 32, input_speed=box.input_speed * 0.9971, load_torque=box.load_torque * 1.0048)
    locator = GapLocator(SHORT["sampling_rate"], BASE, n_permutations=499, cache=simulations)
    assert locator.fit(X, y=COUNTS * 2).verdict_ != "disagree"


def test_a_session_beyond_it_does_not(simulations: Path) -> None:
    X = _session(simulations, 31, load_torque=BASE.gearbox.load_torque * 0.985)
    locator = GapLocator(SHORT["sampling_rate"], BASE, n_bank=40, n_permutations=499, cache=simulations)
    assert locator.fit(X, y=COUNTS * 2).family_p_["amplitudes"] <= 0.05


@pytest.mark.slow
def test_one_assembly_widens_and_is_learned_once(simulations: Path) -> None:
    bank = make_bank(
        BASE, NuisancePrior(), COUNTS, n=6, n_assemblies=1, random_state=32, cache=simulations, **SHORT
    )
    assert bank.assemblies.tolist() == [0] * 6
    options = {"n_bank": 40, "n_permutations": 499, "cache": simulations}
    many = GapLocator(SHORT["sampling_rate"], BASE, **options).fit(bank.X, y=bank.counts)
    one = GapLocator(SHORT["sampling_rate"], BASE, one_assembly=True, **options).fit(bank.X, y=bank.counts)
    assert not many.alike_.any()
    assert np.median(one.alike_) > 0.05
    assert one.alike_.max() < 1
    errors = [
        np.array([row.detectable for row in sorted(found.table_, key=lambda r: (r.of, str(r.cell)))])
        for found in (many, one)
    ]
    assert np.all(errors[1] >= errors[0] - 1e-12)
    again = GapLocator(SHORT["sampling_rate"], BASE, one_assembly=True, alike=one.alike_, **options)
    assert again.fit(bank.X, y=bank.counts).family_p_ == one.family_p_


def test_alike_of_another_number_of_cells_is_refused(simulations: Path) -> None:
    X = _session(simulations, 31)
    locator = GapLocator(
        SHORT["sampling_rate"], BASE, n_bank=40, one_assembly=True, alike=[0.1], cache=simulations
    )
    with pytest.raises(ValueError, match=r"alike must hold a share per cell: shape \(\d+,\), got \(1,\)"):
        locator.fit(X, y=COUNTS * 2)


def test_an_offset_within_what_the_load_may_do_is_not_a_disagreement(simulations: Path) -> None:
    truth = CompositeSimulator(BASE, [Offset(0.05)])
    bank = make_bank(truth, NuisancePrior(), COUNTS, n=6, random_state=33, cache=simulations, **SHORT)
    locator = GapLocator(SHORT["sampling_rate"], BASE, n_bank=40, n_permutations=499, cache=simulations)
    assert locator.fit(bank.X, y=bank.counts).family_p_["amplitudes"] > 0.05


# The model as the prior takes it


def test_a_gearbox_keeps_its_own_clearance() -> None:
    own = CycloidalGearbox.steel(clearance=5e-5)
    wide = NuisancePrior(AssemblyTolerances(clearance=(0.0, 2e-5)))
    for prior, expected in ((NuisancePrior(), (5e-5, 5e-5)), (wide, (5e-5, 7e-5))):
        assert prior.simulator(own).to_rig().tolerances.clearance == pytest.approx(expected)
    # a rig's is a spread between assemblies, which the prior replaces
    assert NuisancePrior().simulator(Rig.r1()).to_rig().tolerances.clearance == (0.0, 0.0)


def test_a_model_of_another_speed_is_refused() -> None:
    prior = NuisancePrior()
    assert prior.n_lobes(None, 500 / 60) == prior.n_lobes(None, 510 / 60) == 15
    X = np.random.default_rng(0).normal(22, 1, (4, 11_520))
    for call in (
        lambda: GapLocator(6400.0, input_speed_hz=1000 / 60).fit(X),
        lambda: EffectFitter(Hum(0.1), 6400.0, input_speed_hz=1000 / 60).fit(X),
        lambda: EffectRanker(6400.0, input_speed_hz=1000 / 60).fit(),
    ):
        with pytest.raises(ValueError, match=r"must be the model's speed, 8.333 Hz \(500 RPM\), got 16.67"):
            call()


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

    needed = imported("gap/_summaries.py", set()) | imported("gap/_recordings.py", set())
    assert needed == {*_null._SUMMARISED_WITH, "gap/_summaries.py", "gap/_recordings.py"}
