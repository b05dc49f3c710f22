"""The proof: distances by hand, their floor, the ratio's limits, and corrections against the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from cyclofeat.gap import Comparison
from cyclofeat.gap.comparison import measured_turns
from cyclofeat.gap.proof import distance
from cyclofeat.gap.proof.distance import Sample, Scale
from cyclofeat.gap.proof.prove import Proof, prove_condition, score_alternatives
from cyclofeat.gap.simulations import Bank
from cyclofeat.gap.summaries.summarise import Cell
from cyclofeat.simulators import BrakeRotor, CycloidalGearbox, Effect, Hum, Noise, Offset, Rig

FS = 6400.0
GEARBOX = CycloidalGearbox.steel(ramp_time=0.05)
BASE = Rig(GEARBOX, [BrakeRotor(0.005, 1e4, 0.05), Noise(0.05)], name="R1")
ONE = [Cell("orders", "lobe lines", "dB"), Cell("orders", "lobe lines", "dB")]
TWO = [*ONE, Cell("orders", "shaft lines", "dB"), Cell("features", "features", "1")]


# Distances


def test_weights_by_hand() -> None:
    """Two lobe lines share half of the orders, one shaft line has the other half, features are a family."""
    assert distance.families_of(TWO) == ["orders", "features"]
    assert distance.cell_weights(TWO) == pytest.approx(np.array([[0.25, 0.25, 0.5, 0], [0, 0, 0, 1]]))


def test_distance_by_hand() -> None:
    """Counts 0 and 2 differ by (2, 0) and (0, 4), spreads are 1 and 2: sqrt((4/2 + 4/2) / 2)."""
    measured = np.array([[2.0, 1.0], [2.0, 1.0], [5.0, 9.0], [5.0, 9.0]])
    simulated = np.array([[-1.0, 1.0], [1.0, 1.0], [5.0, 4.0], [5.0, 6.0]])
    counts = np.array([0, 0, 2, 2])
    scale = Scale(np.array([1.0, 2.0]), distance.cell_weights(ONE))
    found = distance.family_distances(Sample(measured, counts), Sample(simulated, counts), scale)
    assert found == pytest.approx(np.sqrt((4 / 2 + 4 / 2) / 2))


def test_distance_over_many_counts_is_that_of_the_straight_line() -> None:
    """Constant and linear part: what least squares over the counts explains, and nothing of its residual."""
    rng = np.random.default_rng(0)
    counts = np.repeat([0, 1, 3, 7], [1, 2, 1, 3])
    measured = rng.normal(size=(7, 1)) + counts[:, None]
    simulated = Sample(np.zeros((4, 1)), np.array([0, 1, 3, 7]))
    found = distance.family_distances(Sample(measured, counts), simulated, Scale(np.ones(1), np.ones((1, 1))))
    line = np.polyval(np.polyfit(counts, measured[:, 0], 1), counts)
    assert found[0, 0] == pytest.approx(np.sqrt(np.mean(line**2)))


def test_shape_of_amplitudes_is_a_wasserstein_distance() -> None:
    rng = np.random.default_rng(1)
    X = 22 + np.vstack([rng.normal(size=20_000), rng.uniform(size=20_000)])
    standardised = stats.zscore(X, axis=1)
    parts_at = [distance._amplitude_cells(x)[2:] for x in X]
    squared = np.mean((parts_at[0] - parts_at[1]) ** 2)
    order = np.sort(standardised, axis=1)
    assert squared == pytest.approx(np.mean((order[0] - order[1]) ** 2), rel=0.1)
    assert distance._amplitude_cells(X[0])[:2] == pytest.approx(
        [X[0].mean(), 10 * np.log10(X[0].var() + 1e-6)], rel=1e-9
    )


def test_deviations_of_replicates_and_of_lone_recordings() -> None:
    """By hand: 4 and 6 lie 1 from their mean; lone ones differ by 1 and 3 from simulated means."""
    measured = np.array([[4.0], [6.0], [10.0], [13.0]])
    counts = np.array([0, 0, 1, 2])
    simulated, of = np.array([[9.0], [9.0], [10.0], [10.0]]), np.array([1, 1, 2, 2])
    found = distance.replicate_deviations(Sample(measured, counts), Sample(simulated, of))
    assert found.n_free == 2
    lone = 1 / np.sqrt(1 + 1 / 2)  # less the error of a mean of two simulations
    assert found.values[:, 0] == pytest.approx([-1, 1, -lone, lone])


def test_spread_is_steadied_by_the_bank() -> None:
    measured, counts = np.array([[0.0], [2.0], [5.0], [7.0]]), np.array([0, 0, 1, 1])
    simulated, of = np.array([[0.0], [4.0], [0.0], [4.0]]), np.array([0, 0, 1, 1])
    parts = [Cell("features", "features", "1")]
    found = distance.replicate_spread(Sample(measured, counts), Sample(simulated, of), parts)
    # Two degrees of freedom with variance 2, and the bank's 8 as by four.
    assert found == pytest.approx([np.sqrt((2 * 2 + 4 * 8) / 6)])


def test_cells_without_spread_play_no_part() -> None:
    same, other = (Sample(np.full((4, 2), value), np.zeros(4)) for value in (3.0, 4.0))
    spread = distance.replicate_spread(same, same, ONE)
    assert np.all(np.isinf(spread))
    assert distance.family_distances(other, same, Scale(spread, np.ones((1, 2)))) == 0


@pytest.mark.parametrize("counts", [[0, 0, 0, 4, 4, 4], [0, 0, 2, 2, 5, 5, 7, 7], list(range(8)), [0] * 6])
def test_floor_is_the_distance_without_a_gap(counts: list[int]) -> None:
    """On average over data without any gap: halves and lone recordings, scaled, against the bank."""
    rng = np.random.default_rng(2)
    of_measured = np.array(counts)
    of_bank = np.resize(np.unique(of_measured), 48)
    parts, weights = [Cell("features", "features", "1")] * 30, np.full((1, 30), 1 / 30)
    found = []
    for _ in range(40):
        measured, simulated = (
            Sample(0.7 * rng.normal(size=(len(of), 30)) + 0.7 * rng.normal(size=(len(of), 1)), of)
            for of in (of_measured, of_bank)
        )
        scale = Scale(distance.replicate_spread(measured, simulated, parts), weights)
        replicates = distance.replicate_deviations(measured, simulated)
        error = distance.bank_error(of_measured, simulated, scale)
        floor = distance.family_floors(replicates, scale, of_measured, error, 10, rng)
        reached = distance.family_distances(measured, simulated, scale)
        found.append((floor[0], reached[0, 0]))
    floors, reached = np.mean(found, axis=0)
    assert floors == pytest.approx(reached, rel=0.12)


def test_bootstrap_varies_means_as_samples_do() -> None:
    """Half-samples: weights add up, stay in the strata, and give a stratum's mean the variance s^2/n."""
    rng = np.random.default_rng(3)
    groups = np.array([0, 0, 0, 0, 0, 1, 1, 2])
    chances = distance.bootstrap_chances(groups, 4000, rng)
    for group, share in ((0, 5 / 8), (1, 2 / 8), (2, 1 / 8)):
        assert chances[:, groups == group].sum(axis=1) == pytest.approx(share)
    x = rng.normal(size=5)
    means = chances[:, :5] @ x * 8 / 5
    assert means.var() == pytest.approx(x.var(ddof=1) / 5, rel=0.1)
    lengths = np.sum((chances[:, :5] - 1 / 8) ** 2, axis=1)
    assert lengths == pytest.approx(lengths[0])


def test_strata_pool_lone_recordings_apart_by_condition() -> None:
    counts = np.array([0, 0, 0, 1, 2, 3, 4])
    found = distance.number_strata(counts, apart=np.array([1, 1, 1, 1, 1, 0, 0]))
    assert [len(set(found[part])) for part in (slice(0, 3), slice(3, 5), slice(5, 7))] == [1, 1, 1]
    assert len(set(found)) == 3


# The comparison, from summaries


def case(
    gap: float, left: float, *, seed: int = 0, counts: list[int] | None = None
) -> tuple[Sample, dict[str, Sample], list[Cell]]:
    """Made-up summaries whose gap is closed but for a share that is left."""
    rng = np.random.default_rng(seed)
    of = np.array(counts if counts is not None else [0, 0, 0, 3, 3, 3, 6, 6, 6])
    of_bank = np.resize(np.unique(of), 48)
    parts = [Cell("spectrum", "spectrum", "dB")] * 20 + [Cell("features", "features", "1")] * 20
    pattern = np.repeat([1.0, 0.5], 20)
    simulated = rng.normal(size=(48, 40)) + of_bank[:, None]
    measured = rng.normal(size=(len(of), 40)) + of[:, None] + gap * pattern
    alternatives = {
        "nothing": Sample(simulated, of_bank),
        "after": Sample(simulated + gap * (1 - left) * pattern, of_bank),
    }
    return Sample(measured, of), alternatives, parts


def ratio(*args: object, condition: str = "all", alternative: str = "after") -> float:
    rows = score_alternatives(*args, random_state=0).rows  # type: ignore[arg-type]
    return next(row.grr for row in rows if (row.alternative, row.condition) == (alternative, condition))


@pytest.mark.parametrize(("left", "expected"), [(0.0, 1.0), (1.0, 0.0), (2.0, -1.0), (0.5, 0.55)])
def test_ratio_of_what_is_left(left: float, expected: float) -> None:
    """Large gap: D is nearly proportional to it; 0.5 left leaves 2.5 of 5 spreads, both over a floor."""
    assert ratio(*case(5.0, left)) == pytest.approx(expected, abs=0.15)


def test_no_gap_has_no_ratio_and_says_so() -> None:
    undefined = 0
    for seed in range(12):
        rows = score_alternatives(*case(0.0, 0.0, seed=seed), random_state=0).rows
        undefined += np.isnan(rows[0].grr)
        if np.isnan(rows[0].grr):
            assert "does not stand out" in rows[0].undefined
            assert np.isnan(rows[0].low)
    assert undefined >= 10


@pytest.mark.parametrize(
    ("counts", "defined"),
    [([0, 1, 2, 3], True), ([0, 0, 3, 3], True), ([0, 3, 6], False), ([0], False), ([2, 2], False)],
)
def test_few_recordings(counts: list[int], defined: bool) -> None:
    found = score_alternatives(*case(6.0, 0.0, counts=counts), random_state=0).rows[0]
    assert np.isnan(found.grr) != defined
    assert ("at least 4 are needed" in found.undefined) != defined


def test_order_units_and_names_of_counts_change_nothing() -> None:
    sample, alternatives, parts = case(4.0, 0.3)
    measured, of = sample.values, sample.counts
    plain = ratio(sample, alternatives, parts)
    rng = np.random.default_rng(4)
    scale, shift = rng.uniform(0.1, 10, 40).repeat(1), rng.normal(size=40)
    # One scale per part and unit: cells are compared by their own spreads.
    scale[:20], scale[20:] = scale[0], scale[20]
    rescaled = {k: Sample(a.values * scale + shift, a.counts) for k, a in alternatives.items()}
    assert ratio(Sample(measured * scale + shift, of), rescaled, parts) == pytest.approx(plain)
    within = np.r_[2, 0, 1, 5, 4, 3, 6, 8, 7]
    assert ratio(Sample(measured[within], of[within]), alternatives, parts) == pytest.approx(plain, abs=0.01)
    stretched = {k: Sample(a.values, 2 * a.counts + 1) for k, a in alternatives.items()}
    assert ratio(Sample(measured, 2 * of + 1), stretched, parts) == pytest.approx(plain)


def test_conditions_are_those_of_the_fit() -> None:
    """A correction that holds for counts seen in fitting only."""
    measured, alternatives, parts = case(5.0, 0.0)
    after = alternatives["after"]
    wrong = after.values.copy()
    wrong[after.counts == 6] = alternatives["nothing"].values[after.counts == 6]
    alternatives = alternatives | {"box": Sample(wrong, after.counts)}
    found = score_alternatives(measured, alternatives, parts, measured.counts != 6, random_state=0)
    by = {(row.alternative, row.condition): row.grr for row in found.rows}
    assert by["box", "seen"] == pytest.approx(1.0, abs=0.1)
    assert by["box", "unseen"] == pytest.approx(0.0, abs=0.1)
    assert by["after", "unseen"] == pytest.approx(1.0, abs=0.1)
    assert {row.condition for row in found.distances} == {"all", "seen", "unseen"}


def test_interval_holds_the_ratio_and_errors_fall_with_recordings() -> None:
    widths = []
    for n in (3, 12):
        counts = np.repeat([0, 3, 6], n).tolist()
        row = score_alternatives(*case(3.0, 0.4, counts=counts), random_state=0).rows[1]
        assert row.low <= row.grr <= row.high
        widths.append(row.high - row.low)
    assert widths[1] < widths[0]


# Rigs and recordings


def comparison_at(simulations: Path, *effects: Effect) -> Comparison:
    return Comparison(sampling_rate=FS, rig=BASE.with_added(*effects), random_state=0, cache=simulations)


def prove_rig(
    corrected: Rig,
    hold: Bank,
    simulations: Path,
    *,
    seen: list[int] | None = None,
    others: dict | None = None,
) -> Proof:
    comparison = comparison_at(simulations)
    turns = measured_turns(comparison, hold.X, hold.counts)
    return prove_condition(comparison, corrected, turns, fitted_counts=seen, n_simulated=10, others=others)


@pytest.fixture(scope="module")
def hold(simulations: Path) -> Bank:
    return comparison_at(simulations, Noise(0.3)).bank(9, [0, 4, 7], random_state=102)


@pytest.fixture(scope="module")
def scored(hold: Bank, simulations: Path) -> Proof:
    truth = BASE.with_added(Noise(0.3))
    others = {"wrong": BASE.with_added(Hum(0.3)), "oracle": truth}
    return prove_rig(truth, hold, simulations, seen=[0, 4], others=others)


@pytest.mark.slow
def test_the_true_effect_closes_the_gap(scored: Proof) -> None:
    ours = scored.result
    assert ours.undefined == ""
    assert ours.grr == pytest.approx(1.0, abs=0.1)
    assert ours.low <= ours.grr <= ours.high
    by = {(row.alternative, row.condition): row.grr for row in scored.rows}
    for condition in ("all", "seen", "unseen"):
        assert by["nothing", condition] == 0.0
        assert by["after", condition] == by["oracle", condition]
        assert by["wrong", condition] < 0.3


@pytest.mark.slow
def test_distances_are_complete_and_add_up(scored: Proof) -> None:
    names = {"after", "nothing", "wrong", "oracle", "floor"}
    keys = [(row.alternative, row.condition, row.family) for row in scored.distances]
    families = (*distance.FAMILIES, "overall")
    assert sorted(keys) == sorted(
        (name, condition, family) for name in names for condition in ("all", "seen", "unseen")
        for family in families
    )  # fmt: skip
    by = dict(zip(keys, (row.distance for row in scored.distances), strict=True))
    overall = {name: by[name, "all", "overall"] for name in names}
    assert overall["after"] == pytest.approx(np.mean([by["after", "all", f] for f in distance.FAMILIES]))
    expected = 1 - (overall["after"] - overall["floor"]) / (overall["nothing"] - overall["floor"])
    assert scored.result.grr == pytest.approx(expected)


@pytest.mark.slow
def test_same_simulator_wrong_simulator_and_order(hold: Bank, simulations: Path) -> None:
    assert prove_rig(BASE, hold, simulations).result.grr == 0.0
    wrong = BASE.with_added(Offset(2.0))
    expected = prove_rig(wrong, hold, simulations).result.grr
    assert expected < -0.1
    # Recordings in another order and under other names, each of two windows.
    order = np.random.default_rng(7).permutation(len(hold.X)).repeat(2)
    names = np.array([f"record {9 - k}" for k in order])
    comparison = comparison_at(simulations)
    turns = measured_turns(comparison, hold.X[order], hold.counts[order], names)
    assert prove_condition(comparison, wrong, turns, n_simulated=10).result.grr == pytest.approx(
        expected, abs=0.05
    )


@pytest.mark.bench
def test_counts_may_be_unknown(hold: Bank, simulations: Path) -> None:
    comparison = comparison_at(simulations).replace(defect_counts=(0, 4, 7))
    proof = prove_condition(
        comparison, BASE.with_added(Noise(0.3)), measured_turns(comparison, hold.X), n_simulated=10
    )
    assert proof.result.grr == pytest.approx(1.0, abs=0.15)
    assert {row.condition for row in proof.rows} == {"all"}
