"""All stages in one: what is found, what is never looked at too early, what is said of poor recordings."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from short_records import GEARBOX, N_SAMPLES, Recorder, short

from cyclofeat.gap import (
    Bank,
    FittedParameter,
    GapResult,
    GapSettings,
    Windows,
    _workflow,
    find_gap,
)
from cyclofeat.gap._doubts import doubts_about
from cyclofeat.gap.simulations import Population
from cyclofeat.simulators import Gain, Hum, Offset, Rig, effect_library

pytestmark = pytest.mark.usefixtures("few_trees")

COUNTS, HOLD_COUNTS = (0, 3), (0, 3, 5)
SMALL = {
    "library": ["hum", "offset", "noise"], "n_after": 24, "n_report": 16, "n_draws": 8,
    "n_null": 24, "n_sims": 48, "n_interval": 24,
    "n_permutations": 499, "baselines": ("nothing",), "with_placebo": False, "pictures": False,
}  # fmt: skip


def found_in(
    measured: Any,
    held_out: Any = None,
    *,
    cache: Path | None = None,
    random_state: int = 0,
    progress: Any = None,
    **settings: Any,
) -> GapResult:
    """The gap of small recordings, by few simulations."""
    return find_gap(
        short(n_bank=24, cache=cache, random_state=random_state), measured, held_out,
        settings=GapSettings(**(SMALL | settings)), progress=progress,
    )  # fmt: skip


def of_bank(bank: Bank, **more: Any) -> Windows:
    return Windows(bank.X, bank.counts, **more)


@dataclasses.dataclass
class Done:
    """The gap of recordings in which hum is hidden."""

    result: GapResult
    fit: Bank
    hold: Bank
    folder: Path


@pytest.fixture(scope="module")
def done(recorded: Recorder, simulations: Path) -> Done:
    fit = recorded([Hum(0.4)], COUNTS, seed=101)
    hold = recorded([Hum(0.4)], HOLD_COUNTS, seed=102)
    return Done(found_in(of_bank(fit), of_bank(hold), cache=simulations), fit, hold, simulations)


# A hidden effect


def test_hum_is_found_named_fitted_and_added(done: Done) -> None:
    result = done.result
    assert result.verdict == "disagree"
    assert result.where.p <= 0.03
    (effect,) = result.effects
    assert effect.effect_id == "hum"
    assert result.probability("hum") > 0.5
    (amplitude,) = result.parameters
    assert (amplitude.effect, amplitude.name, amplitude.unit) == ("hum", "amplitude_nm", "Nm")
    assert amplitude.value == pytest.approx(0.4, rel=0.1)
    assert amplitude.low < 0.4 < amplitude.high
    assert not result.unknown
    assert effect == Hum(amplitude.value)
    assert result.rig.effects == result.effects


def test_the_gap_shrinks_on_recordings_held_out(done: Done) -> None:
    ours = done.result.proof.result
    assert ours.grr > 0.5
    assert ours.low <= ours.grr <= ours.high
    rows = {(row.alternative, row.condition): row for row in done.result.proof.rows}
    assert {condition for name, condition in rows if name == "after"} == {"all", "seen", "unseen"}
    assert rows["nothing", "all"].grr == pytest.approx(0.0)
    assert rows["nothing", "all"].beaten > 0.5


def test_few_recordings_held_out_are_warned_of(done: Done) -> None:
    assert done.result.proof.n_recordings == 6
    warning = "only 6 recordings held out: the share of the gap that closed is uncertain"
    assert sum(text.startswith(warning) for text in done.result.warnings) == 1
    for n, expected in ((1, ["only 1 recording held out"]), (9, ["only 9 recordings held out"]), (10, [])):
        assert [text.partition(":")[0] for text in _workflow.few_held_out(n)] == expected


def test_effects_that_cannot_be_named_are_warned_of() -> None:
    assert _workflow.not_considered((), ()) == []
    assert _workflow.not_considered(("brake_rotor",), ("hum", "gain")) == [
        "brake_rotor cannot be named as missing: the model already has it",
        "this model cannot have hum, gain at this rate: not considered",
    ]


def test_the_result_is_what_the_command_prints(done: Done) -> None:
    plain = done.result.to_dict()
    assert set(plain) == {
        "format", "verdict", "p", "effects", "ranking", "tie_group", "unknown", "unknown_score",
        "next_measurement", "loss", "verdict_after", "grr", "alternatives", "warnings", "seconds",
    }  # fmt: skip
    assert plain["format"] == "cyclofeat gap 1"
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert plain["ranking"][0]["id"] == "hum"
    assert {row["id"] for row in plain["ranking"]} == set(SMALL["library"])
    assert sum(row["probability"] for row in plain["ranking"]) <= 1 + 1e-5
    assert plain["effects"][0]["theta"] == {"amplitude_nm": done.result.parameters[0].value}
    assert set(plain["grr"]) == {"all", "seen", "unseen", "ci"}
    assert plain["alternatives"]["nothing"]["all"] == pytest.approx(0.0)
    assert isinstance(plain["next_measurement"], str)


def test_tables_of_the_result(done: Done) -> None:
    pytest.importorskip("pandas")
    result = done.result
    where = result.to_frame()
    assert len(where) == len(result.where.rows) == 2 * result.where.n_cells
    assert {"family", "name", "difference", "p", "mean"} <= set(where.columns)
    assert result.to_frame("parameters")["value"].tolist() == [row.value for row in result.parameters]
    assert result.to_frame("ranking")["effect"].tolist() == [row.effect for row in result.ranking]
    assert len(result.to_frame("proof")) == len(result.proof.rows)
    with pytest.raises(ValueError, match="table must be 'where'"):
        result.to_frame("what")
    assert "hum: amplitude_nm" in result._repr_html_()


@pytest.mark.slow
def test_a_library_of_one_effect(done: Done) -> None:
    result = found_in(of_bank(done.fit), cache=done.folder, library=["hum"])
    assert [effect.effect_id for effect in result.effects] == ["hum"]
    assert result.probability("hum") == 1.0
    assert result.proof is None  # nothing is held out


def test_nothing_is_named_where_nothing_is_missing(recorded: Recorder, simulations: Path) -> None:
    fit = recorded([], COUNTS, seed=103)
    result = found_in(of_bank(fit), Windows(_Unread(), _Unread()), cache=simulations)
    assert result.verdict == "unresolved"
    assert result.effects == result.ranking == result.tie_group == result.parameters == ()
    assert result.proof is None
    assert not result.unknown
    assert result.rig.effects == ()
    json.dumps(result.to_dict(), allow_nan=False)


# Recordings held out


class _Unread:
    """Recordings that nobody may look at."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        raise AssertionError("looked at")


class _Watched:
    """Data that note after which words of progress they were looked at."""

    def __init__(self, values: np.ndarray, said: list[str], reads: list[tuple[str, ...]]) -> None:
        self._values, self._said, self._reads = values, said, reads

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        self._reads.append(tuple(self._said))
        return np.asarray(self._values, dtype=dtype)


@dataclasses.dataclass
class _Seen:
    result: GapResult
    said: list[str]
    reads: dict[str, list[tuple[str, ...]]]


@pytest.fixture(scope="module")
def watched(done: Done) -> _Seen:
    """Other recordings held out, every stage computed anew but for simulations."""
    shutil.rmtree(done.folder / "fit")
    said: list[str] = []
    reads: dict[str, list[tuple[str, ...]]] = {"X": [], "y": [], "groups": []}
    hold = done.hold
    given = {"X": 22 + 3 * (hold.X - 22)[::-1], "y": hold.counts[::-1], "groups": np.arange(len(hold.X))}
    held = Windows(**{name: _Watched(values, said, reads[name]) for name, values in given.items()})
    result = found_in(of_bank(done.fit), held, cache=done.folder, progress=said.append)
    return _Seen(result, said, reads)


def test_recordings_held_out_are_not_looked_at_before_the_last_stage(watched: _Seen) -> None:
    last = "judging on recordings held out"
    assert watched.said[-1] == last
    before = tuple(watched.said[:-1])
    assert {"comparing measurement and model", "naming what is missing", "fitting hum"} <= set(before)
    for name, reads in watched.reads.items():
        assert reads, name
        assert all(read == (*before, last) for read in reads), name


def test_other_recordings_held_out_change_nothing_but_the_last_stage(done: Done, watched: _Seen) -> None:
    first, other = done.result, watched.result
    assert other.proof != first.proof
    for name in ("where", "where_after", "ranking", "effects", "parameters", "tie_group", "unknown", "loss"):
        assert getattr(other, name) == getattr(first, name), name
    assert other.unknown_score == first.unknown_score


class _Shaped(_Unread):
    """Recordings that tell their size and nothing else."""

    def __init__(self, *shape: int, dtype: str = "float64") -> None:
        self.shape, self.dtype = shape, np.dtype(dtype)


def _of_two(n: int) -> np.ndarray:
    return np.arange(n) * np.ones((2, 1))


TWO = _Shaped(2, N_SAMPLES)


@pytest.mark.parametrize(
    ("X", "options", "message"),
    [
        (TWO, {}, "y_fit and y_hold must be given both or neither, got y_fit without y_hold"),
        (_Shaped(N_SAMPLES), {"y": [0, 3]}, r"X_hold must have the shape \(n_windows, n_samples\), got"),
        (_Shaped(2, N_SAMPLES, dtype="complex64"), {"y": [0, 3]}, "X_hold must hold real numbers, got"),
        (_Shaped(2, 2000), {"y": [0, 3]}, r"X_hold must hold windows of at least one output turn \(0.6 s\)"),
        ([[22.0] * 10] * 2, {"y": [0, 3]}, "X_hold must hold windows of at least one output turn"),
        (TWO, {"y": [0]}, r"y_hold must hold one count per window: shape \(2,\), got \(1,\)"),
        (TWO, {"y": [0, np.nan]}, "y_hold must hold whole numbers .*, got 0.0, nan"),
        (TWO, {"y": ["0", "some"]}, "y_hold must hold whole numbers .*, got '0', 'some'"),
        (TWO, {"y": [0, 16]}, "y_hold must hold counts from 0 to the 15 lobes, got 16"),
        (TWO, {"y": [0, 3], "groups": [0]}, "groups_hold must hold one recording per window"),
        (TWO, {"y": [0, 3], "groups": [1, np.nan]}, "groups_hold must name the recording of"),
        (TWO, {"y": [0, 3], "groups": [1, 1]}, "y_hold must be the same within a recording"),
        (TWO, {"y": [0, 3], "angle": _of_two(9)}, "angle_hold must have the shape of X_hold"),
        (
            TWO, {"y": [0, 3], "angle": np.nan * _of_two(N_SAMPLES)},
            "angle_hold must be finite",
        ),
        (TWO, {"y": [0, 3], "angle": -_of_two(N_SAMPLES)}, "angle_hold must grow over each"),
    ],
)  # fmt: skip
def test_what_is_held_out_is_refused_before_anything_is_simulated(
    X: Any, options: dict, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def simulated(*_: Any, **__: Any) -> None:
        raise AssertionError("simulated")

    monkeypatch.setattr(Population, "plan_run", simulated)
    with pytest.raises(ValueError, match=message):
        found_in(Windows(RIPPLE, [0, 0, 0, 0, 3, 3, 3, 3]), Windows(X, **options))


def test_the_values_held_out_are_not_read_by_the_check(recorded: Recorder, simulations: Path) -> None:
    """Where nothing is judged, nothing of them is read, though all that goes with them is there."""
    bank = recorded([], COUNTS, seed=103)
    angle = 2 * np.pi * bank.speeds[:, None] * np.arange(N_SAMPLES)
    held = Windows(_Shaped(*bank.X.shape), bank.counts, np.arange(len(bank.X)), angle)
    assert found_in(of_bank(bank), held, cache=simulations, max_effects=0).proof is None


# Again from the cache


@pytest.mark.slow
def test_a_second_run_goes_on_from_the_cache(
    done: Done, watched: _Seen, monkeypatch: pytest.MonkeyPatch
) -> None:
    def simulated(*_: Any, **__: Any) -> None:
        raise AssertionError("simulated again")

    monkeypatch.setattr(Population, "plan_run", simulated)
    again = found_in(of_bank(done.fit), of_bank(done.hold), cache=done.folder)
    expected = {k: v for k, v in done.result.to_dict().items() if k != "seconds"}
    assert {k: v for k, v in again.to_dict().items() if k != "seconds"} == expected
    # Another seed is another run.
    with pytest.raises(AssertionError, match="simulated again"):
        found_in(done.fit.X, cache=done.folder, random_state=1)


# Poor recordings


RIPPLE = np.random.default_rng(0).normal(22, 0.1, (8, 11_520))
TURNS = RIPPLE[:, :N_SAMPLES]


def doubts(X: np.ndarray = RIPPLE, y: Sequence[int] | None = (0, 0, 0, 0, 3, 3, 3, 3), **options: Any) -> str:
    given = {"groups": None, "angle": np.zeros(1), **options}
    return "\n".join(doubts_about(X, None if y is None else y[: len(X)], given["groups"], given["angle"]))


def test_good_recordings_are_not_doubted() -> None:
    assert doubts() == ""


@pytest.mark.parametrize(
    ("X", "options", "words"),
    [
        (RIPPLE, {"y": range(8)}, "one recording per class: exact tests .* cannot reject"),
        (RIPPLE[:3], {}, "3 recordings: how much they vary from one to the next is hardly known"),
        (RIPPLE, {"groups": [0, 0, 0, 0, 1, 1, 1, 1]}, "2 recordings: .*one recording per class"),
        (RIPPLE, {"y": None}, "counts of worn lobes are not known"),
        (RIPPLE, {"angle": None}, "no tachometer: an error of the speed and one of the converter's clock"),
        (np.minimum(RIPPLE, 22.2), {}, "8 of 8 recordings seem clipped: they stay at their largest value"),
        (np.maximum(RIPPLE, [[0]] * 7 + [[21.8]]), {}, "1 of 8 recordings seem clipped: .* smallest value"),
    ],
    ids=["one of each", "three", "two", "no counts", "no tachometer", "clipped", "clipped below"],
)  # fmt: skip
def test_what_limits_the_answer_is_said(X: np.ndarray, options: dict, words: str) -> None:
    if "clipped" in words:
        # Clipped are samples on end, not single extremes.
        X = np.repeat(X[:, ::8], 8, axis=1)
    assert re.search(words, doubts(X, **options), flags=re.DOTALL)


def test_coarse_codes_are_not_clipping() -> None:
    """A converter of few codes meets its largest often, and never for long."""
    assert doubts(np.round(RIPPLE, 1)) == ""


def test_doubts_are_among_the_warnings(recorded: Recorder, simulations: Path) -> None:
    bank = recorded([], COUNTS, n=2, seed=104)
    warnings = found_in(of_bank(bank), cache=simulations, max_effects=0).warnings
    for start in ("2 recordings", "one recording per class", "no tachometer"):
        assert any(text.startswith(start) for text in warnings)


@pytest.mark.parametrize(
    ("X", "options", "message"),
    [
        (np.where(np.arange(N_SAMPLES) == 99, np.nan, TURNS), {}, "contains NaN"),
        (TURNS[:1], {}, "at least 2 recordings"),
        (TURNS[:, :2000], {}, r"at least one output turn \(0.6 s\), got 0.312 s"),
        (TURNS, {"y": [0, 1]}, "y must hold one count per window"),
        (TURNS, {"y": [0.5] * 8}, "y must hold whole numbers of worn lobes"),
        (TURNS, {"groups": [1]}, "groups must hold one recording per window"),
        (TURNS, {"angle": np.zeros((8, 3))}, "angle must have the shape of X"),
        (TURNS, {"angle": np.zeros((8, N_SAMPLES))}, "angle must grow"),
    ],
)
def test_bad_input(X: np.ndarray, options: dict, message: str, simulations: Path) -> None:
    with pytest.raises(ValueError, match=message):
        found_in(Windows(X, **options), cache=simulations)


def test_effects_that_do_not_exist_are_named(done: Done) -> None:
    with pytest.raises(ValueError, match="library must name different effects of pin_errors"):
        found_in(of_bank(done.fit), cache=done.folder, library=["rust"])


# Wrong conditions


@pytest.mark.parametrize(
    ("base", "family", "cell", "size"),
    [
        (Rig(GEARBOX.replace(load_torque=26.0)), "amplitudes", "mean", 4.0),
        (
            Rig(GEARBOX.replace(input_speed=GEARBOX.input_speed * 0.98)), "speed",
            "input speed by the mesh lines", -2.0,
        ),
    ],
    ids=["load", "speed"],
)  # fmt: skip
def test_a_wrong_condition_is_a_finding(
    base: Rig, family: str, cell: str, size: float, recorded: Recorder, simulations: Path
) -> None:
    bank = recorded([], COUNTS, seed=105, base=base)
    where = found_in(of_bank(bank), cache=simulations, max_effects=0).where
    assert where.verdict == "disagree"
    assert where.family_p[family] <= 0.03
    row = next(row for row in where.means(family) if row.cell.name == cell)
    assert row.p <= 0.03
    assert row.difference == pytest.approx(size, rel=0.1)


# Whole chains that take longer


@pytest.mark.bench
def test_a_wrong_load_goes_through_the_whole_chain(recorded: Recorder, simulations: Path) -> None:
    """At one load it looks like an offset: the model with that predicts others of that load."""
    base = Rig(GEARBOX.replace(load_torque=23.0))
    fit, hold = (recorded([], counts, seed=s, base=base) for s, counts in ((106, COUNTS), (107, HOLD_COUNTS)))
    result = found_in(of_bank(fit), of_bank(hold), cache=simulations)
    assert result.effects[0].effect_id == "offset"
    assert result.parameters[0].value == pytest.approx(1.0, rel=0.1)
    assert result.proof.result.grr > 0.5


@pytest.mark.bench
def test_two_effects_that_cancel_in_the_mean_are_no_crash(recorded: Recorder, simulations: Path) -> None:
    bank = recorded([Gain(1.05), Offset(-1.1)], COUNTS, seed=108)
    result = found_in(of_bank(bank), cache=simulations, library=["gain", "offset", "hum"])
    mean = next(row for row in result.where.means() if row.cell.name == "mean")
    assert mean.p > 0.03  # they do cancel
    assert result.verdict in ("disagree", "unresolved")
    json.dumps(result.to_dict(), allow_nan=False)


@pytest.mark.bench
def test_all_alternatives_are_compared(done: Done) -> None:
    names = ("nothing", "retuned", "equaliser", "gaussian_process")
    result = found_in(
        of_bank(done.fit), of_bank(done.hold), cache=done.folder, baselines=names, with_placebo=True
    )
    grr = {row.alternative: row.grr for row in result.proof.rows if row.condition == "all"}
    assert set(grr) == {"after", *names, "placebo"}
    for name in ("nothing", "retuned", "placebo"):
        assert grr[name] < grr["after"], name


@pytest.mark.bench
def test_with_a_tachometer_the_whole_chain_uses_it(done: Done) -> None:
    fit, hold = (
        of_bank(bank, angle=2 * np.pi * bank.speeds[:, None] * np.arange(N_SAMPLES))
        for bank in (done.fit, done.hold)
    )
    result = found_in(fit, hold, cache=done.folder)
    for where in (result.where, result.where_after):
        assert "mesh lines against the tachometer" in [row.cell.name for row in where.rows]
    assert [effect.effect_id for effect in result.effects] == ["hum"]
    assert result.proof.result.grr > 0.5
    assert not any("tachometer" in text for text in result.warnings)


def test_every_effect_says_what_separates_it() -> None:
    """What the result's next measurement is taken from."""
    assert all(len(kind.separated_by) > 20 for kind in effect_library().values())


@pytest.mark.parametrize(
    ("alone", "together", "fixed", "taken"),
    [
        (21.0, 0.9, False, True),  # one effect cannot be the whole truth, two can
        (21.0, 9.0, False, False),  # two are not the whole truth either
        (21.0, 9.0, True, True),
        (1.9, 0.9, False, False),  # one may be the whole truth
        (1.9, 0.9, True, True),
        (1.9, 1.8, True, False),  # two hardly explain more
    ],
)
def test_when_a_second_effect_is_taken(alone: float, together: float, fixed: bool, taken: bool) -> None:
    def candidate(names: tuple[str, ...], loss: float) -> _workflow.Candidate:
        fit = SimpleNamespace(
            loss=loss, effects=tuple(effect_library()[name]() for name in names),
            parameters=tuple(
                FittedParameter(name, "size", 1.0, 0.5, 2.0, "1", name == names[0] or fixed) for name in names
            ),
        )  # fmt: skip
        return _workflow.Candidate(names, 0.9, fit)

    single, pair = candidate(("hum",), alone), candidate(("hum", "noise"), together)
    chosen = _workflow.chosen_pair(single, [pair])
    assert chosen is (pair if taken else None)
    assert _workflow.is_unknown(chosen or single, False) is ((together if taken else alone) > 2.5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"alpha": 0.0}, "alpha must be between 0 and 1, got 0.0"),
        ({"max_effects": 3}, "max_effects must be 0, 1 or 2, got 3"),
        ({"n_draws": 0}, "n_draws must be at least 5, got 0"),
    ],
)
def test_settings_out_of_range(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GapSettings(**options)
