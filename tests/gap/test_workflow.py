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
from short_records import N_SAMPLES, RATE, Recorder

from cyclofeat.gap import Bank, DiscrepancyWorkflow, _fit_model, _fitter, _null, _table, _workflow
from cyclofeat.gap._doubts import doubts_about
from cyclofeat.simulators import CycloidalGearbox, Gain, Hum, Offset, effect_library

COUNTS, HOLD_COUNTS = (0, 3), (0, 3, 5)
SMALL = {
    "library": ["hum", "offset", "noise"], "n_bank": 40, "n_after": 24, "n_report": 16, "n_draws": 8,
    "n_null": 24, "n_sims": 48, "n_interval": 24,
    "n_permutations": 499, "baselines": ("nothing",), "with_placebo": False,
}  # fmt: skip
STEEL = CycloidalGearbox.steel()


@pytest.fixture(autouse=True, scope="module")
def _small_bank():
    """The fitter's weights from the same 40 recordings as the locator's comparison."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_fitter, "_BANK", SMALL["n_bank"])
        yield


@pytest.fixture
def first_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workflows stop after the comparison."""
    monkeypatch.setattr(DiscrepancyWorkflow, "_name", lambda *_: None)


@dataclasses.dataclass
class Done:
    """A workflow with hum hidden in its recordings, and what it was given and said."""

    workflow: DiscrepancyWorkflow
    fit: Bank
    hold: Bank
    folder: Path


@pytest.fixture(scope="module")
def done(recorded: Recorder, simulations: Path) -> Done:
    fit = recorded([Hum(0.4)], COUNTS, seed=101)
    hold = recorded([Hum(0.4)], HOLD_COUNTS, seed=102)
    workflow = DiscrepancyWorkflow(RATE, cache=simulations, **SMALL)
    workflow.fit(fit.X, hold.X, y_fit=fit.counts, y_hold=hold.counts)
    return Done(workflow, fit, hold, simulations)


# A hidden effect


def test_hum_is_found_named_fitted_and_added(done: Done) -> None:
    found = done.workflow.result_
    assert found["verdict"] == "disagree"
    assert found["p"] <= 0.03
    (named,) = found["effects"]
    assert named["id"] == "hum"
    assert named["probability"] > 0.5
    assert named["theta"]["amplitude_nm"] == pytest.approx(0.4, rel=0.1)
    low, high = named["interval"]["amplitude_nm"]
    assert low < 0.4 < high
    assert not found["unknown"]
    assert done.workflow.effects_[0] == Hum(named["theta"]["amplitude_nm"])
    assert done.workflow.simulator_.effects == done.workflow.effects_


def test_the_gap_shrinks_on_recordings_held_out(done: Done) -> None:
    grr = done.workflow.result_["grr"]
    assert grr["all"] > 0.5
    low, high = grr["ci"]
    assert low <= grr["all"] <= high
    assert set(grr) == {"all", "seen", "unseen", "ci"}
    assert done.workflow.result_["alternatives"]["nothing"]["all"] == pytest.approx(0.0)


def test_few_recordings_held_out_are_warned_of(done: Done, monkeypatch: pytest.MonkeyPatch) -> None:
    assert done.workflow.report_.n_recordings_ == 6
    warning = "only 6 recordings held out: the share of the gap that closed is uncertain"
    assert sum(text.startswith(warning) for text in done.workflow.result_["warnings"]) == 1
    workflow = DiscrepancyWorkflow(RATE, **SMALL)
    workflow.simulator_ = None

    class Scored:
        fit = score = lambda self, *_, **__: self

    for n, expected in ((1, ["only 1 recording held out"]), (9, ["only 9 recordings held out"]), (10, [])):
        workflow.warnings_, Scored.n_recordings_ = [], n
        monkeypatch.setattr(_workflow, "GapReport", lambda *_, **__: Scored())
        workflow._judge(RIPPLE, {}, RIPPLE, {})
        assert [text.partition(":")[0] for text in workflow.warnings_] == expected


def test_the_result_is_what_the_command_prints(done: Done) -> None:
    found = done.workflow.result_
    stated = {
        "format", "verdict", "p", "effects", "ranking", "tie_group", "unknown", "next_measurement", "grr",
        "alternatives", "warnings",
    }  # fmt: skip
    assert stated <= set(found)
    assert found["format"] == "cyclofeat gap 1"
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert found["ranking"][0]["id"] == "hum"
    assert {row["id"] for row in found["ranking"]} == set(SMALL["library"])
    assert sum(row["probability"] for row in found["ranking"]) <= 1 + 1e-5
    assert isinstance(found["next_measurement"], str)


def test_the_report_is_written(done: Done, tmp_path: Path) -> None:
    text = done.workflow.to_html(tmp_path / "gap.html").read_text(encoding="utf-8")
    assert "hum" in text.lower()
    assert 'src="http' not in text


@pytest.mark.slow
def test_a_library_of_one_effect(done: Done) -> None:
    options = {**SMALL, "library": ["hum"]}
    found = DiscrepancyWorkflow(RATE, cache=done.folder, **options).fit(done.fit.X, y_fit=done.fit.counts)
    (named,) = found.result_["effects"]
    assert named["id"] == "hum"
    assert named["probability"] == 1.0
    assert found.result_["grr"] is None  # nothing is held out
    assert found.result_["alternatives"] == {}


def test_nothing_is_named_where_nothing_is_missing(recorded: Recorder, simulations: Path) -> None:
    fit = recorded([], COUNTS, seed=103)
    workflow = DiscrepancyWorkflow(RATE, cache=simulations, **SMALL)
    found = workflow.fit(fit.X, _Unread(), y_fit=fit.counts, y_hold=_Unread())
    assert found.result_["verdict"] == "unresolved"
    assert found.result_["effects"] == found.result_["ranking"] == found.result_["tie_group"] == []
    assert found.result_["grr"] is None
    assert not found.result_["unknown"]
    assert found.simulator_.effects == ()
    json.dumps(found.result_, allow_nan=False)


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
    workflow: DiscrepancyWorkflow
    said: list[str]
    reads: dict[str, list[tuple[str, ...]]]


@pytest.fixture(scope="module")
def watched(done: Done) -> _Seen:
    """Other recordings held out, every stage computed anew but for simulations."""
    shutil.rmtree(done.folder / "fits")
    said: list[str] = []
    reads: dict[str, list[tuple[str, ...]]] = {"X": [], "y": [], "groups": []}
    hold = done.hold
    given = {"X": 22 + 3 * (hold.X - 22)[::-1], "y": hold.counts[::-1], "groups": np.arange(len(hold.X))}
    held = {name: _Watched(values, said, reads[name]) for name, values in given.items()}
    workflow = DiscrepancyWorkflow(RATE, cache=done.folder, progress=said.append, **SMALL)
    workflow.fit(done.fit.X, held["X"], y_fit=done.fit.counts, y_hold=held["y"], groups_hold=held["groups"])
    return _Seen(workflow, said, reads)


def test_recordings_held_out_are_not_looked_at_before_the_last_stage(watched: _Seen) -> None:
    last = "judging on recordings held out"
    assert watched.said[-1] == last
    before = tuple(watched.said[:-1])
    assert {"comparing measurement and model", "naming what is missing", "fitting hum"} <= set(before)
    for name, reads in watched.reads.items():
        assert reads, name
        assert all(read == (*before, last) for read in reads), name


def test_other_recordings_held_out_change_nothing_but_the_last_stage(done: Done, watched: _Seen) -> None:
    first, other = done.workflow, watched.workflow
    assert other.result_["grr"] != first.result_["grr"]
    for name in ("verdict", "p", "effects", "ranking", "tie_group", "unknown", "loss", "verdict_after"):
        assert other.result_[name] == first.result_[name], name
    for one, two in ((first.locator_, other.locator_), (first.locator_after_, other.locator_after_)):
        assert two.table_ == one.table_
        assert np.array_equal(two.measured_, one.measured_)
        assert np.array_equal(two.simulated_, one.simulated_)
    assert other.ranker_.ranking_ == first.ranker_.ranking_
    assert other.ranker_.conformal_p_ == first.ranker_.conformal_p_
    for name in ("theta_", "theta_ci_", "identifiable_", "at_bound_", "loss_", "n_calls_"):
        assert getattr(other.fitter_, name) == getattr(first.fitter_, name), name


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
        (_Shaped(2, 2000), {"y": [0, 3]}, r"X_hold must hold windows of at least one output turn \(1.8 s\)"),
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

    monkeypatch.setattr(_null, "machine", simulated)
    held = {f"{name}_hold": values for name, values in options.items()}
    with pytest.raises(ValueError, match=message):
        DiscrepancyWorkflow(RATE, **SMALL).fit(RIPPLE, X, y_fit=[0, 0, 0, 0, 3, 3, 3, 3], **held)


@pytest.mark.usefixtures("first_stage")
def test_the_values_held_out_are_not_read_by_the_check(recorded: Recorder, simulations: Path) -> None:
    """Where nothing is judged, nothing of them is read, though all that goes with them is there."""
    bank = recorded([], COUNTS, seed=103)
    angle = 2 * np.pi * bank.speeds[:, None] * np.arange(N_SAMPLES)
    found = DiscrepancyWorkflow(RATE, cache=simulations, **SMALL).fit(
        bank.X, _Shaped(*bank.X.shape), y_fit=bank.counts, y_hold=bank.counts,
        groups_hold=np.arange(len(bank.X)), angle_hold=angle,
    )  # fmt: skip
    assert found.report_ is None


# Again from the cache


@pytest.mark.slow
def test_a_second_run_goes_on_from_the_cache(
    done: Done, watched: _Seen, monkeypatch: pytest.MonkeyPatch
) -> None:
    def simulated(*_: Any, **__: Any) -> None:
        raise AssertionError("simulated again")

    for module in (_null, _fit_model, _table):
        monkeypatch.setattr(module, "machine", simulated)
    again = DiscrepancyWorkflow(RATE, cache=done.folder, **SMALL)
    again.fit(done.fit.X, done.hold.X, y_fit=done.fit.counts, y_hold=done.hold.counts)
    expected = {k: v for k, v in done.workflow.result_.items() if k != "seconds"}
    assert {k: v for k, v in again.result_.items() if k != "seconds"} == expected
    # Another seed is another run.
    with pytest.raises(AssertionError, match="simulated again"):
        DiscrepancyWorkflow(RATE, cache=done.folder, random_state=1, **SMALL).fit(done.fit.X)


# Poor recordings


RIPPLE = np.random.default_rng(0).normal(22, 0.1, (8, N_SAMPLES))


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


@pytest.mark.usefixtures("first_stage")
def test_doubts_are_among_the_warnings(recorded: Recorder, simulations: Path) -> None:
    bank = recorded([], COUNTS, n=2, seed=104)
    found = DiscrepancyWorkflow(RATE, cache=simulations, **SMALL).fit(bank.X, y_fit=bank.counts)
    assert any(text.startswith("2 recordings") for text in found.result_["warnings"])
    assert any(text.startswith("one recording per class") for text in found.result_["warnings"])
    assert any(text.startswith("no tachometer") for text in found.result_["warnings"])


@pytest.mark.parametrize(
    ("X", "options", "message"),
    [
        (np.where(np.arange(N_SAMPLES) == 99, np.nan, RIPPLE), {}, "contains NaN"),
        (RIPPLE[:1], {}, "at least 2 recordings"),
        (RIPPLE[:, :2000], {}, r"at least one output turn \(1.8 s\), got 0.312 s"),
        (RIPPLE, {"y_fit": [0, 1]}, "y must hold one count per window"),
        (RIPPLE, {"y_fit": [0.5] * 8}, "y must hold whole numbers of worn lobes"),
        (RIPPLE, {"groups_fit": [1]}, "groups must hold one recording per window"),
        (RIPPLE, {"angle_fit": np.zeros((8, 3))}, "angle must have the shape of X"),
        (RIPPLE, {"angle_fit": np.zeros((8, N_SAMPLES))}, "angle must grow"),
    ],
)
def test_bad_input(X: np.ndarray, options: dict, message: str, simulations: Path) -> None:
    with pytest.raises(ValueError, match=message):
        DiscrepancyWorkflow(RATE, cache=simulations, **SMALL).fit(X, **options)


def test_effects_that_do_not_exist_are_named(done: Done) -> None:
    options = {**SMALL, "library": ["rust"]}
    with pytest.raises(ValueError, match="library must name different effects of pin_errors"):
        DiscrepancyWorkflow(RATE, cache=done.folder, **options).fit(done.fit.X, y_fit=done.fit.counts)


# Wrong conditions


@pytest.mark.usefixtures("first_stage")
@pytest.mark.parametrize(
    ("base", "family", "cell", "size"),
    [
        (dataclasses.replace(STEEL, load_torque=26.0), "amplitudes", "mean", 4.0),
        (
            dataclasses.replace(STEEL, input_speed=STEEL.input_speed * 0.98), "speed",
            "input speed by the mesh lines", -2.0,
        ),
    ],
    ids=["load", "speed"],
)  # fmt: skip
def test_a_wrong_condition_is_a_finding(
    base: CycloidalGearbox, family: str, cell: str, size: float, recorded: Recorder, simulations: Path
) -> None:
    bank = recorded([], COUNTS, seed=105, base=base)
    found = DiscrepancyWorkflow(RATE, cache=simulations, **SMALL).fit(bank.X, y_fit=bank.counts)
    assert found.result_["verdict"] == "disagree"
    assert found.locator_.family_p_[family] <= 0.03
    row = next(row for row in found.locator_.table_ if row.cell.name == cell and row.of == "mean")
    assert row.p <= 0.03
    assert row.effect == pytest.approx(size, rel=0.1)


# Whole chains that take longer


@pytest.mark.bench
def test_a_wrong_load_goes_through_the_whole_chain(recorded: Recorder, simulations: Path) -> None:
    """At one load it looks like an offset: the model with that predicts others of that load."""
    base = dataclasses.replace(STEEL, load_torque=23.0)
    fit, hold = (recorded([], counts, seed=s, base=base) for s, counts in ((106, COUNTS), (107, HOLD_COUNTS)))
    found = DiscrepancyWorkflow(RATE, cache=simulations, **SMALL)
    found.fit(fit.X, hold.X, y_fit=fit.counts, y_hold=hold.counts)
    assert found.result_["effects"][0]["id"] == "offset"
    assert found.result_["effects"][0]["theta"]["offset_nm"] == pytest.approx(1.0, rel=0.1)
    assert found.result_["grr"]["all"] > 0.5


@pytest.mark.bench
def test_two_effects_that_cancel_in_the_mean_are_no_crash(recorded: Recorder, simulations: Path) -> None:
    bank = recorded([Gain(1.05), Offset(-1.1)], COUNTS, seed=108)
    options = {**SMALL, "library": ["gain", "offset", "hum"]}
    found = DiscrepancyWorkflow(RATE, cache=simulations, **options).fit(bank.X, y_fit=bank.counts)
    mean = next(row for row in found.locator_.table_ if row.cell.name == "mean" and row.of == "mean")
    assert mean.p > 0.03  # they do cancel
    assert found.result_["verdict"] in ("disagree", "unresolved")
    json.dumps(found.result_, allow_nan=False)


@pytest.mark.bench
def test_all_alternatives_are_compared(done: Done) -> None:
    names = ("nothing", "retuned", "equaliser", "gaussian_process")
    options = {**SMALL, "baselines": names, "with_placebo": True}
    found = DiscrepancyWorkflow(RATE, cache=done.folder, **options)
    found.fit(done.fit.X, done.hold.X, y_fit=done.fit.counts, y_hold=done.hold.counts)
    assert set(found.result_["alternatives"]) == {*names, "placebo"}
    grr = found.result_["grr"]["all"]
    for name in ("nothing", "retuned", "placebo"):
        assert found.result_["alternatives"][name]["all"] < grr, name


@pytest.mark.bench
def test_with_a_tachometer_the_whole_chain_uses_it(done: Done) -> None:
    banks = (done.fit, done.hold)
    angles = [2 * np.pi * bank.speeds[:, None] * np.arange(N_SAMPLES) for bank in banks]
    found = DiscrepancyWorkflow(RATE, cache=done.folder, **SMALL)
    found.fit(
        done.fit.X, done.hold.X, y_fit=done.fit.counts, y_hold=done.hold.counts,
        angle_fit=angles[0], angle_hold=angles[1],
    )  # fmt: skip
    for locator in (found.locator_, found.locator_after_):
        assert "mesh lines against the tachometer" in [cell.name for cell in locator.cells_]
    assert [effect["id"] for effect in found.result_["effects"]] == ["hum"]
    assert found.result_["grr"]["all"] > 0.5
    assert not any("tachometer" in text for text in found.result_["warnings"])


def test_every_effect_says_what_separates_it() -> None:
    """What the result's next measurement is taken from."""
    assert all(len(kind.separated_by) > 20 for kind in effect_library().values())


@pytest.mark.parametrize(
    ("alone", "together", "told", "taken"),
    [
        (21.0, 0.9, False, True),  # one effect cannot be the whole truth, two can
        (21.0, 9.0, False, False),  # two are not the whole truth either
        (21.0, 9.0, True, True),
        (1.9, 0.9, False, False),  # one may be the whole truth
        (1.9, 0.9, True, True),
        (1.9, 1.8, True, False),  # two hardly explain more
    ],
)
def test_when_a_second_effect_is_taken(alone: float, together: float, told: bool, taken: bool) -> None:
    def candidate(names: tuple[str, ...], loss: float) -> _workflow.Candidate:
        fit = SimpleNamespace(
            loss_=loss, effects_=tuple(effect_library()[name]() for name in names),
            identifiable_={f"{name}.size": name == names[0] or told for name in names},
        )  # fmt: skip
        return _workflow.Candidate(names, 0.9, fit)

    class Workflow(DiscrepancyWorkflow):
        def _fitted_ranker(self, n_samples: int) -> Any:
            return SimpleNamespace(
                left_out_=(), table_=SimpleNamespace(n_failed=0), rank=lambda _: [], unknown_=False,
                classes_=("hum", "noise"),
            )  # fmt: skip

        def _singles(self, ranking: Any) -> Any:
            return [candidate(("hum",), alone)]

        def _pairs(self, first: Any) -> Any:
            return [candidate(("hum", "noise"), together)]

        def _fitted(self, proposals: Any, windows: Any, data: Any) -> Any:
            return proposals

        def _take(self, chosen: Any, windows: Any, data: Any) -> None:
            self.names_ = chosen.names
            self.locator_after_ = SimpleNamespace(verdict_="disagree")

    workflow = Workflow(RATE)
    workflow.locator_, workflow.warnings_ = None, []
    workflow._name(np.zeros((2, N_SAMPLES)), {})
    assert workflow.names_ == (("hum", "noise") if taken else ("hum",))
    assert workflow.unknown_ is ((together if taken else alone) > 2.5)
