"""Campaigns: the design drawn as declared, the same bytes for any workers, and nothing lost whatever dies."""

from __future__ import annotations

import contextlib
import errno
import itertools
import json
import math
import os
import pickle
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import joblib
import llvmlite.binding as llvm
import numpy as np
import pyarrow.parquet as parquet
import pytest
from scipy.stats import loguniform, uniform

from cyclofeat._base import shards
from cyclofeat.simulators import (
    BrakeRotor,
    Campaign,
    Clearance,
    CycloidalGearbox,
    GearboxParameter,
    Hum,
    LobeDefects,
    Noise,
    PinErrors,
    Quantisation,
    Rig,
    load_campaign,
    run_campaign,
)
from cyclofeat.simulators.batch import runs as batch
from cyclofeat.simulators.campaign import WorkerLost, _design, _folder
from cyclofeat.simulators.campaign._folder import Shards
from cyclofeat.simulators.effects.library import label_effects

# Starts fast, hence settles fast: a run takes a hundredth of a second.
QUICK = Rig.r0().replace(name="quick", gearbox=CycloidalGearbox.steel(ramp_time=0.02))
LOAD = "gearbox_parameter_load_torque.value"
SMALL = Campaign(
    name="small",
    rig=QUICK.with_effects(GearboxParameter("load_torque", (15.0, 25.0))),
    defect_counts=(0, 2, 5),
    repeats=5,
    duration=0.02,
    depth=(0.3, 1.0),
    runs_per_shard=4,
)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a folder, hidden ones too."""
    return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """SMALL, made in one go in this process; not to be changed."""
    folder = tmp_path_factory.mktemp("campaign") / "whole"
    run_campaign(SMALL, folder)
    return folder


@pytest.fixture
def copied(whole: Path, tmp_path: Path) -> Path:
    """A copy of SMALL that a test may damage."""
    return Path(shutil.copytree(whole, tmp_path / "copy"))


# The design.


def test_classes_come_in_turn_and_more_repeats_append() -> None:
    plans = list(SMALL.plans())
    assert [plan.run for plan in plans] == list(range(15))
    assert [plan.defect_count for plan in plans] == [0, 2, 5] * 5
    assert list(SMALL.replace(repeats=9).plans())[:15] == plans
    assert len({plan.values[LOAD] for plan in plans}) == 15


@pytest.mark.parametrize("design", ["sobol", "random"])
@pytest.mark.parametrize(("first", "n_runs"), [(0, 1), (1, 3), (4, 4), (13, 2), (14, 9)])
def test_a_plan_is_the_same_wherever_one_begins(design: str, first: int, n_runs: int) -> None:
    campaign = SMALL.replace(design=design)
    assert list(campaign.plans(first, n_runs)) == list(campaign.plans())[first : first + n_runs]


def strata(values: list[float], low: float, high: float) -> list[int]:
    """Which of as many equal parts of the range each value lies in, sorted."""
    return sorted(int((value - low) / (high - low) * len(values)) for value in values)


def test_each_class_fills_every_range_evenly() -> None:
    # Sobol': of 2^k points exactly one lies in each 2^k-th of every range.
    rig = Rig.r1().with_effects(GearboxParameter("load_torque", (10, 30)), Noise(loguniform(0.01, 10)))
    campaign = Campaign(rig=rig, repeats=32, depth=(0.2, 1.0))
    runout = label_effects(rig.effects)["run_out"].runout
    plans = list(campaign.plans())
    for count in campaign.defect_counts:
        values = [plan.values for plan in plans if plan.defect_count == count]
        assert strata([v[LOAD] for v in values], 10, 30) == list(range(32))
        assert strata([math.log10(v["noise.rms_nm"]) for v in values], -2, 1) == list(range(32))
        assert strata([v["depth"] for v in values], 0.2, 1.0) == list(range(32))
        # A distribution is filled evenly in its probability.
        assert strata([runout.cdf(v["run_out.runout"]) for v in values], 0, 1) == list(range(32))


def test_a_random_design_is_uniform_and_classes_are_independent() -> None:
    rig = Rig(effects=[GearboxParameter("load_torque", (0, 1))])
    campaign = Campaign(rig=rig, defect_counts=(0, 1), repeats=500, design="random")
    healthy, worn = (
        np.array([plan.values[LOAD] for plan in campaign.plans() if plan.defect_count == count])
        for count in (0, 1)
    )
    for values in (healthy, worn):
        # Largest distance of the distribution from the straight line: above 1.95/sqrt(n) once in 1000.
        distance = np.abs(np.sort(values) - (np.arange(500) + 0.5) / 500).max()
        assert distance < 1.95 / math.sqrt(500)
    assert abs(np.corrcoef(healthy, worn)[0, 1]) < 0.15


def test_name_and_seed_make_other_assemblies() -> None:
    first, plan = [plan.values for plan in SMALL.plans()], next(SMALL.plans(3))
    state = _design.sample_of(SMALL, plan).random_state.generate_state(2).tolist()
    for other in (SMALL.replace(random_state=1), SMALL.replace(name="other")):
        assert [plan.values for plan in other.plans()] != first
        assert _design.sample_of(other, plan).random_state.generate_state(2).tolist() != state


def test_a_run_is_what_the_simulator_gives_for_its_values() -> None:
    # The way by hand: the rig's effects with numbers, the seed from its definition.
    varied = (
        GearboxParameter("load_torque", (15, 25)), PinErrors((1e-6, 1e-5)), Clearance((1e-6, 2e-5)),
        BrakeRotor((1e-4, 2e-4), 1e4, 0.02), Quantisation(0.05), Noise(uniform(0.0, 0.1)),
    )  # fmt: skip
    gearbox = CycloidalGearbox.steel(ramp_time=0.02)
    rig = Rig(gearbox, varied).with_added(Hum((0.1, 0.2)), Hum(uniform(0.5, 0.5)))
    campaign = Campaign(
        name="c", rig=rig, defect_counts=(3,), repeats=2, lobes="random", wheels=(1,), depth=(0.3, 0.9),
        duration=0.02, random_state=7,
    )  # fmt: skip
    plan = list(campaign.plans())[1]
    ((torque, row),) = _design.simulate_runs(campaign, [plan])
    values = plan.values
    assert tuple(values) == campaign.explored_names
    numbers = (
        GearboxParameter("load_torque", values[LOAD]), PinErrors(values["pin_errors.rms"]),
        Clearance(values["clearance.clearance"]), BrakeRotor(values["brake_rotor.inertia"], 1e4, 0.02),
        Quantisation(0.05), Noise(values["noise.rms_nm"]), Hum(values["hum.amplitude_nm"]),
        Hum(values["hum_2.amplitude_nm"]),
    )  # fmt: skip
    seed = np.random.SeedSequence([7, ord("c")], spawn_key=(1,))
    defects = LobeDefects.worn(
        [lobe - 1 for lobe in row["worn_lobes_from_1"]], wheels=(1,), depth=values["depth"]
    )
    run = Rig(gearbox, numbers).simulate(defects, duration=0.02, random_state=seed)
    assert torque is not None
    assert torque.dtype == np.float32
    np.testing.assert_array_equal(torque, run.torque_out.astype(np.float32))
    assert row["true_speed_rpm"] == pytest.approx(run.gearbox.input_speed * 30 / math.pi, abs=1e-6)
    assert row["start_angle_rad"] == pytest.approx(run.input_angle[0] % (30 * math.pi))
    assert len(set(row["worn_lobes_from_1"])) == 3
    assert row.items() >= {
        "true_load_nm": values[LOAD], "brake_inertia_kg_m2": values["brake_rotor.inertia"],
        "clearance_m": values["clearance.clearance"], "depth": values["depth"], "wheels_from_1": [2],
        "effects.quantisation.lsb_nm": 0.05,
        **{f"effects.{name}": value for name, value in values.items() if name != "depth"},
    }.items()  # fmt: skip
    assert 0.1 <= values["hum.amplitude_nm"] <= 0.2
    assert 0.5 <= values["hum_2.amplitude_nm"] <= 1.0


def test_a_run_states_the_effects_of_its_variant() -> None:
    rig = QUICK.replace(variants=[[Hum(0.1)], [Hum(0.3), Noise(0.4)]])
    campaign = SMALL.replace(rig=rig)
    rows = [result.row for result in _design.simulate_runs(campaign, list(campaign.plans()))]
    assert all(row.keys() == _design.table_columns(campaign).keys() for row in rows)
    second = [row["effects.hum.amplitude_nm"] == 0.3 for row in rows]
    assert 0 < sum(second) < len(rows)
    assert second == [row["effects.noise_2.rms_nm"] == 0.4 for row in rows]
    assert not any(math.isnan(row["effects.noise.rms_nm"]) for row in rows)


def test_shards_follow_from_the_number_of_runs_unless_they_are_stated(tmp_path: Path) -> None:
    shards = {n: Campaign(defect_counts=(0,), repeats=n) for n in (1, 20, 80, 1000, 10**6)}
    assert [one.shard_length for one in shards.values()] == [1, 1, 4, 50, 128]
    assert [one.n_shards for one in shards.values()] == [1, 20, 20, 20, 7813]
    stated = SMALL.replace(repeats=1000)
    assert (stated.shard_length, stated.n_shards) == (4, 750)
    # The shards of a folder must not change with a later rule, nor those of a design with its first repeats.
    short = SMALL.replace(runs_per_shard=None, repeats=8, duration=2 / 25_600)
    data = run_campaign(short, tmp_path / "out")
    assert data.campaign == short.replace(runs_per_shard=2)
    assert short.replace(repeats=1000).shard_length == 128
    assert len(run_campaign(short, tmp_path / "out").y) == 24  # it is the same campaign


def test_patterns_of_wear() -> None:
    def worn(**changes: object) -> list[tuple[list[int], list[int]]]:
        campaign = SMALL.replace(defect_counts=(3,), repeats=150, depth=1.0, **changes)
        found = (_design.draw_defects(campaign, plan) for plan in campaign.plans())
        return [(list(defects.worn_lobes), list(defects.wheels)) for defects in found]

    neighbours = {tuple(sorted((first + k) % 15 for k in range(3))) for first in range(15)}
    consecutive = worn()
    assert {tuple(lobes) for lobes, _ in consecutive} == neighbours
    assert {tuple(wheels) for _, wheels in consecutive} == {(0,), (0, 1)}
    scattered = worn(lobes="random", wheels=(0, 1))
    assert not {tuple(lobes) for lobes, _ in scattered} <= neighbours
    assert all(len(set(lobes)) == 3 and wheels == [0, 1] for lobes, wheels in scattered)


# The description.


def test_json_gives_the_design_back(tmp_path: Path) -> None:
    rig = Rig.r2().replace(name="mine").with_added(Hum((0.1, 0.3)), Quantisation(0.05))
    campaign = Campaign(
        name="Lauf Ä", rig=rig, defect_counts=(5, 0), wheels=(1, 0), depth=(0.1, 0.5),
        random_state=2**40, design="random",
    )  # fmt: skip
    campaign.to_json(tmp_path / "design.json")
    again = Campaign.from_json(tmp_path / "design.json")
    assert again == campaign
    assert again.wheels == (0, 1)
    assert campaign.to_dict()["wheels_from_1"] == [1, 2]
    assert pickle.loads(pickle.dumps(campaign)) == campaign
    assert Campaign.from_dict({"rig": "r2"}).rig == Rig.r2()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[1]", "must hold a JSON object"),
        ('{"repeat": 3}', "unknown key 'repeat' with value 3: did you mean 'repeats'?"),
        ('{"format": "cyclofeat campaign 9"}', "format must be 'cyclofeat campaign 3', got"),
        ('{"rig": {"effect": 1}}', "rig: unknown key 'effect' with value 1: did you mean 'effects'?"),
        ('{"rig": "R9"}', r"rig must be one of \('R0', 'R1', 'R2'\) or a Rig, got 'R9'"),
        ('{"repeats": 0}', "repeats must be at least 1, got 0"),
        ('{"name": ""}', "name must be a line of printable text, got ''"),
        ('{"defect_counts": [16]}', "defect_counts must be at most 15, got 16"),
        ('{"lobes": "all"}', "lobes must be 'consecutive' or 'random', got 'all'"),
        ('{"kernel": "fast"}', "kernel must be one of 'exact', 'batch', 'auto', got 'fast'"),
        ('{"integrator": "euler"}', "integrator must be one of 'midpoint', 'adams_bashforth', 'leapfrog'"),
        ('{"design": "grid"}', "design must be 'sobol' or 'random', got 'grid'"),
        ('{"wheels": [1]}', "unknown key 'wheels': name it 'wheels_from_1' and count wheels from 1"),
        ('{"wheels_from_1": [0]}', r"wheels_from_1 must be \[1\], \[2\] or \[1, 2\], got \[0\]"),
        ('{"wheels_from_1": "both"}', "wheels must be 'random'"),
        ('{"depth": 0}', "depth must lie above 0 and up to 1"),
        ('{"depth": [0.5, 0.2]}', "depth must lie above 0 and up to 1"),
        ('{"duration": 1e-6}', "duration must hold at least 2 samples at 25600 Hz, got 1e-06"),
        ('{"rig": {"effects": [{"effect": "noise", "rms_nm": [2, 1]}]}}', "rig: .*rms_nm of noise must be"),
    ],
)  # fmt: skip
def test_a_wrong_description_is_named(content: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "design.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=f"design.json: .*{message}"):
        Campaign.from_json(path)


# On disk.


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["loky", "threading"])
def test_the_same_bytes_for_any_workers(whole: Path, tmp_path: Path, backend: str) -> None:
    calls: list[tuple[int, int]] = []
    with joblib.parallel_config(backend=backend):
        run_campaign(
            SMALL, tmp_path / "two", n_jobs=2, progress=lambda done, total: calls.append((done, total))
        )
    assert contents(tmp_path / "two") == contents(whole)
    assert calls == [(done, 15) for done in range(1, 16)]


# Which kernel.


@pytest.mark.slow
@pytest.mark.parametrize(
    ("one", "other", "repeats", "most"),
    [
        ({"kernel": "exact"}, {"kernel": "auto"}, 5, 1e-3),
        ({"kernel": "exact"}, {"kernel": "exact", "integrator": "adams_bashforth"}, 2, 2e-3),
        ({"kernel": "batch"}, {"kernel": "batch", "integrator": "adams_bashforth"}, 2, 2e-3),
    ],
    ids=str,
)
def test_another_kernel_or_integrator_makes_the_same_assemblies(
    one: dict, other: dict, repeats: int, most: float
) -> None:
    campaign = SMALL.replace(duration=0.1, repeats=repeats)
    plans = list(campaign.plans())
    pairs = zip(*(_design.simulate_runs(campaign.replace(**c), plans) for c in (one, other)), strict=True)
    for (first, row), (second, row_of_second) in pairs:
        assert row == {**row_of_second, "kernel": one["kernel"]}
        assert row_of_second["kernel"] == other["kernel"].replace("auto", "batch")
        assert first is not None
        assert second is not None
        assert 0 < np.abs(first - second).max() < most * np.ptp(first)


STIFF = Rig.r0().replace(name="stiff", gearbox=CycloidalGearbox.steel(ramp_time=0.0))
STIFF = STIFF.with_effects(GearboxParameter("stiffness_scale", loguniform(0.01, 1000)))


def test_runs_that_fail_in_a_batch_have_the_exact_kernels_reason() -> None:
    campaign = SMALL.replace(rig=STIFF, depth=1.0)
    plans = list(campaign.plans())
    exact, batches = (
        _design.simulate_runs(campaign.replace(kernel=kernel), plans) for kernel in ("exact", "auto")
    )
    failed = [one.row for one in exact if one.torque is None]
    assert 0 < len(failed) < len(exact)
    assert [one.row for one in batches if one.torque is None] == failed
    assert {row["kernel"] for row in failed} == {"exact"}


@pytest.mark.slow
def test_what_batches_do_not_simulate_is_left_to_the_exact_kernel_or_refused(tmp_path: Path) -> None:
    coarse = QUICK.replace(gearbox=CycloidalGearbox.steel(ramp_time=0.02, profile_points=900))
    campaign = SMALL.replace(rig=coarse, depth=1.0, repeats=1)
    data = run_campaign(campaign, tmp_path / "auto")
    assert data.parameters["kernel"].tolist() == ["exact"] * 3
    with pytest.raises(
        ValueError,
        match="cannot be simulated, not even in its middle: kernel 'batch' does not simulate a poly",
    ):
        run_campaign(campaign.replace(kernel="batch"), tmp_path / "batch")
    assert not (tmp_path / "batch").exists()


@pytest.mark.slow
@pytest.mark.parametrize("n_together", [1, 4, 7])
def test_which_runs_share_a_batch_changes_no_byte(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, n_together: int
) -> None:
    assert (load_campaign(whole).parameters["kernel"] == "batch").all()

    def in_batches(_, plans, *__):  # type: ignore[no-untyped-def]
        left = iter(plans)
        while together := list(itertools.islice(left, n_together)):
            yield from _folder.simulate_task(SMALL, together, _folder.made_with())

    monkeypatch.setattr(_folder, "simulate_anywhere", in_batches)
    run_campaign(SMALL, tmp_path / "other")
    assert contents(tmp_path / "other") == contents(whole)


OTHER_PROCESSOR = textwrap.dedent(
    """
    import sys
    import llvmlite.binding
    features = llvmlite.binding.get_host_cpu_features() | {"avx512f": False}
    llvmlite.binding.get_host_cpu_features = lambda: features
    from cyclofeat.simulators import Campaign, run_campaign
    from cyclofeat.simulators.batch.runs import n_lanes
    data = run_campaign(Campaign.from_json(sys.argv[1]), sys.argv[2])
    print(n_lanes(), set(data.parameters["kernel"]))
    """
)


@pytest.mark.slow  # compiles both kernels
@pytest.mark.skipif(batch.n_lanes() != 16, reason="needs a processor with AVX-512")
@pytest.mark.parametrize("kernel", ["exact", "batch"])
def test_code_for_avx2_makes_the_bytes_of_code_for_avx512(tmp_path: Path, kernel: str) -> None:
    campaign = SMALL.replace(kernel=kernel, duration=0.1)
    run_campaign(campaign, tmp_path / "avx512")
    campaign.to_json(tmp_path / "design.json")
    features = llvm.get_host_cpu_features()
    given = ",".join(
        ("+" if there and "avx512" not in name else "-") + name for name, there in features.items()
    )
    environment = {
        "NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": given, "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
    }  # fmt: skip
    code = [sys.executable, "-c", OTHER_PROCESSOR, tmp_path / "design.json", tmp_path / "avx2"]
    done = subprocess.run(code, env=os.environ | environment, capture_output=True, text=True, check=True)
    assert done.stdout == f"8 {{'{kernel}'}}\n"
    assert contents(tmp_path / "avx2") == contents(tmp_path / "avx512")


def test_where_batches_cannot_be_compiled_a_campaign_does_not_change_to_other_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "compile_error", lambda: "no such vectors")
    with pytest.raises(RuntimeError, match="batches cannot be compiled: no such vectors; .* kernel='exact'"):
        run_campaign(SMALL, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.raises(RuntimeError, match="batches cannot be compiled: no such"):
        _folder.simulate_task(SMALL, list(SMALL.plans(0, 1)), _folder.made_with())
    assert run_campaign(SMALL.replace(kernel="exact", repeats=1), tmp_path / "out").ok.all()


# What lies there.


def test_what_lies_on_disk(whole: Path) -> None:
    assert sorted(contents(whole)) == sorted(
        ["campaign.json", "manifest.json", "parameters.parquet"]
        + [f"shard-{shard:05d}.{kind}" for shard in range(4) for kind in ("npy", "parquet", "sha256")]
    )
    blocks = [np.load(whole / f"shard-{shard:05d}.npy") for shard in range(4)]
    assert [block.shape for block in blocks] == [(4, 512)] * 3 + [(3, 512)]
    expected = np.array([one.torque for one in _design.simulate_runs(SMALL, list(SMALL.plans()))])
    np.testing.assert_array_equal(np.concatenate(blocks), expected)
    table = parquet.read_table(whole / "parameters.parquet")
    rows = [row for s in range(4) for row in parquet.read_table(whole / f"shard-{s:05d}.parquet").to_pylist()]
    assert table.to_pylist() == rows
    assert rows == [one.row for one in _design.simulate_runs(SMALL, list(SMALL.plans()))]
    assert Campaign.from_json(whole / "campaign.json") == SMALL
    manifest = json.loads((whole / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["status"] == {"ok": 15}
    assert manifest["source"] == "surrogate"
    assert {"cyclofeat", "numpy", "numba"} <= set(manifest["made_with"])
    digests = subprocess.run(
        ["sha256sum", *manifest["files"]], cwd=whole, capture_output=True, text=True, check=True
    ).stdout
    subprocess.run(["sha256sum", "--check", *sorted(whole.glob("*.sha256"))], cwd=whole, check=True)
    stated = "".join(f"{file['sha256']}  {name}\n" for name, file in manifest["files"].items())
    assert digests == stated


def test_load_gives_windows_labels_groups_and_parameters(whole: Path) -> None:
    data = load_campaign(whole, verify=True)
    assert data.X.shape == (15, 512)
    assert data.y.tolist() == [0, 2, 5] * 5
    assert len(set(data.groups)) == 15
    assert data.ok.all()
    assert data.campaign == SMALL
    frame = data.to_frame()
    assert frame["defect_count"].tolist() == data.y.tolist()
    assert [len(lobes) for lobes in frame["worn_lobes_from_1"]] == data.y.tolist()
    assert (frame["depth"][data.y == 0] == 0).all()
    assert frame["depth"][data.y > 0].between(0.3, 1.0).all()
    # The load is that explored, within the assembly's 3 %, and the torque's mean is near it.
    assert (abs(frame["true_load_nm"] / frame[f"effects.{LOAD}"] - 1) <= 0.03).all()
    quiet = load_campaign(whole)
    np.testing.assert_array_equal(np.asarray(quiet.X), np.asarray(data.X))


def test_a_table_of_runs_needs_pandas_and_says_so(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    data = load_campaign(whole)
    assert data.parameters["true_load_nm"].shape == data.y.shape
    with pytest.raises(ImportError, match="pip install pandas"):
        data.to_frame()


def test_one_shard_is_a_memmap(tmp_path: Path) -> None:
    data = run_campaign(SMALL.replace(repeats=1, runs_per_shard=3), tmp_path / "one")
    assert isinstance(data.X, np.memmap)
    assert data.X.shape == (3, 512)


KEYS = [
    0, -1, 14, np.int64(7), slice(None), slice(2, 9), slice(None, None, -3), slice(20, 30), [3, 3, 14, 0],
    np.array([11, 2]), np.arange(15) % 4 == 1, (slice(3, 8), 5), (2, slice(0, 512, 100)), (4, 9),
    ([8, 1], slice(5, 9)), (slice(1, 3), [0, 5, 7]), np.array([], dtype=int), (slice(None), -1),
]  # fmt: skip


@pytest.mark.parametrize("key", KEYS, ids=str)
def test_shards_index_as_one_array(whole: Path, key: object) -> None:
    shards = load_campaign(whole).X
    assert isinstance(shards, Shards)
    array = np.concatenate([np.load(path) for path in shards.paths])
    np.testing.assert_array_equal(shards[key], array[key])
    assert np.shape(shards[key]) == array[key].shape


def test_shards_are_read_on_demand(whole: Path) -> None:
    shards = load_campaign(whole).X
    array = np.asarray(shards)
    assert (len(shards), shards.ndim, shards.dtype) == (15, 2, np.float32)
    assert isinstance(shards[5], np.memmap)
    np.testing.assert_array_equal(list(shards), array)
    assert np.asarray(shards, dtype=np.float64).dtype == np.float64
    for wrong in (15, -16):
        with pytest.raises(IndexError, match=f"index {wrong} is out of bounds"):
            shards[wrong]
    for wrong_key in ((0, 1, 2), None, Ellipsis, np.zeros((2, 2), dtype=int)):
        with pytest.raises(IndexError, match="Shards take"):
            shards[wrong_key]
    with pytest.raises(ValueError, match="always a copy"):
        np.asarray(shards, copy=False)


def test_a_failed_run_is_a_row_with_its_reason(tmp_path: Path) -> None:
    data = run_campaign(
        SMALL.replace(rig=STIFF, defect_counts=(0, 1), repeats=4, depth=1.0), tmp_path / "stiff"
    )
    frame = data.to_frame()
    status = frame["status"].to_numpy()
    assert 0 < data.ok.sum() < 8
    assert set(status) <= {"ok", "diverged", "locked"}
    assert data.manifest["status"] == {name: int((status == name).sum()) for name in sorted(set(status))}
    torque = np.asarray(data.X)
    assert np.isfinite(torque[data.ok]).all()
    assert np.isnan(torque[~data.ok]).all()
    assert all("t = " in reason and "sleeve" in reason for reason in frame["reason"][~data.ok])
    assert (frame["reason"][data.ok] == "").all()
    # What is known of an assembly is there although the run failed, its start angle apart.
    assert frame["true_load_nm"].between(21, 23).all()
    assert frame["start_angle_rad"].isna().tolist() == (~data.ok).tolist()
    assert data.y.tolist() == [0, 1] * 4


@pytest.mark.slow
def test_values_that_contradict_each_other_are_a_row_too(tmp_path: Path) -> None:
    # The smallest damping would take longer than a minute to settle; the middle does not.
    rig = Rig.r1().replace(gearbox=CycloidalGearbox.steel(ramp_time=0.02, contact_damping=0.0))
    rig = rig.with_effects(BrakeRotor(0.02, 1e4, loguniform(1e-5, 0.5)))
    campaign = SMALL.replace(rig=rig, defect_counts=(0,), repeats=4, depth=1.0)
    data = run_campaign(campaign, tmp_path / "damping")
    invalid = data.parameters["status"] == "invalid"
    np.testing.assert_array_equal(invalid, data.parameters["settling_s"] > 60)
    assert 0 < invalid.sum() < 4
    assert data.to_frame()["reason"][invalid].str.contains("must have more damping").all()


def test_a_design_of_which_nothing_can_be_simulated_is_refused(tmp_path: Path) -> None:
    campaign = SMALL.replace(sampling_rate=200_000.0)
    with pytest.raises(ValueError, match="not even in its middle: sampling_rate must not"):
        run_campaign(campaign, tmp_path / "out")
    assert not (tmp_path / "out").exists()


# Resuming.


def quick_results(plans):  # type: ignore[no-untyped-def]
    """In place of the simulator: for tests of what happens to the files."""
    for plan in plans:
        torque = np.random.default_rng(plan.run).normal(size=SMALL.n_samples).astype(np.float32)
        row = {"run": plan.run, "assembly": f"small-0-{plan.run:07d}", "defect_count": plan.defect_count}
        yield _design.RunResult(
            torque, {**row, "status": "ok", "reason": "", "worn_lobes_from_1": [], "wheels_from_1": []}
        )


class Crash(BaseException):
    """As if the process ended here."""


@pytest.mark.slow
def test_a_crash_at_any_write_loses_at_most_one_shard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = SMALL.replace(runs_per_shard=8)
    made: list[int] = []

    def counted(_, plans, *__):  # type: ignore[no-untyped-def]
        for plan in plans:
            made.append(plan.run)
            yield from quick_results([plan])

    monkeypatch.setattr(_folder, "simulate_anywhere", counted)
    run_campaign(campaign, tmp_path / "whole")
    expected = contents(tmp_path / "whole")
    write_whole = shards.write_whole
    n_writes = 1 + 3 * campaign.n_shards + 2  # design, shards with their rows, table, manifest
    # Before the file is written, with half of it written beside, and with its name already given.
    # Before a later write is after the one in front of it.
    later = itertools.product(range(n_writes), ("within", "after"))
    for crash_at, moment in [(0, "before"), *later]:
        folder, seen = tmp_path / f"{crash_at}-{moment}", itertools.count()

        def dying(path: Path, write, durable, crash_at=crash_at, moment=moment, seen=seen):  # type: ignore[no-untyped-def]
            if next(seen) != crash_at:
                return write_whole(path, write, durable=durable)
            if moment == "within":
                path.with_name(f".{path.name}.0a.part").write_bytes(b"half of it")
            elif moment == "after":
                write_whole(path, write, durable=durable)
            raise Crash

        monkeypatch.setattr(shards, "write_whole", dying)
        with pytest.raises(Crash):
            run_campaign(campaign, folder)
        monkeypatch.setattr(shards, "write_whole", write_whole)
        made.clear()
        if (folder / "campaign.json").exists() and not (folder / "manifest.json").exists():
            with pytest.raises(ValueError, match=r"not finished, \d of 2 shards are there"):
                load_campaign(folder)
        run_campaign(campaign, folder)
        assert contents(folder) == expected, (crash_at, moment)
        finished = (crash_at - 1 + (moment == "after")) // 3 if crash_at else 0
        assert made == list(range(min(8 * finished, 15), 15)), (crash_at, moment)


def test_a_finished_campaign_is_left_alone(copied: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in copied.iterdir()}
    calls: list[tuple[int, int]] = []
    data = run_campaign(SMALL, copied, progress=lambda done, total: calls.append((done, total)))
    assert len(data.y) == 15
    assert calls == [(15, 15)]
    assert {path: path.stat().st_mtime_ns for path in copied.iterdir()} == before


CHANGED = ["shard-00002.npy", "shard-00001.parquet", "shard-00003.sha256", "parameters.parquet"]


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGED)
def test_a_changed_or_missing_file_is_named_and_mended(whole: Path, copied: Path, name: str) -> None:
    file = copied / name
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1  # one bit
    file.write_bytes(content)
    with pytest.raises(ValueError, match=f"{name}: was changed, its SHA-256"):
        load_campaign(copied, verify=True)
    if name.startswith("shard"):  # also in a campaign that is not finished
        (copied / "manifest.json").unlink()
    run_campaign(SMALL, copied)
    assert contents(copied) == contents(whole)
    file.write_bytes(content[:-1])
    (copied / "campaign.json").write_bytes((whole / "campaign.json").read_bytes() + b"\n")
    with pytest.raises(ValueError, match=r"campaign.json: was changed, \d+ bytes instead of"):
        load_campaign(copied)
    shutil.copy(whole / "campaign.json", copied)
    with pytest.raises(ValueError, match=f"{name}: was changed, {len(content) - 1} bytes instead of"):
        load_campaign(copied)
    file.unlink()
    with pytest.raises(FileNotFoundError, match=f"{name}: is missing; run the campaign again to mend it"):
        load_campaign(copied)
    run_campaign(SMALL, copied)
    assert contents(copied) == contents(whole)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"random_state": 1}, "random_state is 0 there and 1 here"),
        ({"rig": QUICK}, "rig.effects is .* there and .* here"),
        ({"kernel": "batch"}, "kernel is 'auto' there and 'batch' here"),
    ],
)
def test_a_folder_of_another_design_is_refused(whole: Path, changes: dict, message: str) -> None:
    before = contents(whole)
    with pytest.raises(ValueError, match=f"holds a campaign of another design: {message}"):
        run_campaign(SMALL.replace(**changes), whole)
    assert contents(whole) == before


def test_a_folder_made_with_other_versions_is_refused(copied: Path) -> None:
    design = json.loads((copied / "campaign.json").read_text(encoding="utf-8"))
    design["made_with"]["numba"] = "0.1"
    (copied / "campaign.json").write_text(json.dumps(design), encoding="utf-8")
    with pytest.raises(ValueError, match="begun with other versions: numba is '0.1' there and"):
        run_campaign(SMALL, copied)


def test_what_is_no_campaigns_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.doc").write_text("years of work", encoding="utf-8")
    with pytest.raises(ValueError, match=r"must be empty or hold a campaign, got 'thesis.doc'"):
        run_campaign(SMALL, tmp_path)
    with pytest.raises(NotADirectoryError, match="is not a folder"):
        run_campaign(SMALL, tmp_path / "thesis.doc")
    with pytest.raises(FileNotFoundError, match=r"holds no campaign \(no campaign.json\)"):
        load_campaign(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.doc"]


def test_damaged_descriptions_are_named(copied: Path) -> None:
    manifest = copied / "manifest.json"
    manifest.write_text('{"format": "another"}', encoding="utf-8")
    with pytest.raises(ValueError, match="manifest.json: is not of format"):
        load_campaign(copied)
    manifest.write_text("{", encoding="utf-8")
    with pytest.raises(ValueError, match="manifest.json: is not valid JSON"):
        load_campaign(copied)
    (copied / "campaign.json").write_text("[]", encoding="utf-8")
    with pytest.raises(ValueError, match="campaign.json: must hold a JSON object"):
        load_campaign(copied)


def test_two_do_not_write_to_one_folder_at_once(copied: Path) -> None:
    def start_another(*_: object) -> None:
        with pytest.raises(OSError, match="another process is at work on this campaign"):
            run_campaign(SMALL, copied)
        tried.append(True)

    tried: list[bool] = []
    run_campaign(SMALL, copied, progress=start_another)
    assert tried
    run_campaign(SMALL, copied)  # neither the refused nor the finished one still holds the lock


def test_without_pyarrow_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ImportError, match="pip install pyarrow"):
        run_campaign(SMALL, tmp_path / "out")
    assert not (tmp_path / "out").exists()


# A full disk.


@pytest.mark.slow
@pytest.mark.parametrize("call", ["write", "fsync"])
def test_a_full_disk_keeps_what_is_finished(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    folder = tmp_path / "out"

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    def fill_at(done: int, _: int) -> None:
        if done == 11:
            if call == "write":
                monkeypatch.setattr(_folder.np.lib.format, "write_array_header_1_0", full)
            else:
                monkeypatch.setattr(os, "fsync", full)

    with pytest.raises(OSError, match=r"the disk is full; 2 of 4 shards are finished and kept") as error:
        run_campaign(SMALL, folder, progress=fill_at)
    assert error.value.errno == errno.ENOSPC
    kept = contents(folder)
    assert sorted(name for name in kept if not name.endswith("sha256")) == [
        "campaign.json", "shard-00000.npy", "shard-00000.parquet", "shard-00001.npy", "shard-00001.parquet",
    ]  # fmt: skip
    monkeypatch.undo()
    run_campaign(SMALL, folder)
    assert contents(folder) == contents(whole)


def test_a_disk_too_small_is_found_out_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=15 * 512 * 4 - 1)
    monkeypatch.setattr(_folder.shutil, "disk_usage", lambda _: usage)
    with pytest.raises(OSError, match=r"4 shards to be made take 0.03072 MB, the disk has 0.03072 MB left"):
        run_campaign(SMALL, tmp_path / "out")


# Workers that die.


def kill_a_worker() -> None:
    """Kill the youngest of the worker processes that this one started."""
    import psutil

    workers = [
        child for child in psutil.Process().children(recursive=True) if "loky" in " ".join(child.cmdline())
    ]
    max(workers, key=lambda child: child.pid).kill()


@pytest.mark.slow
def test_a_killed_worker_process_is_an_error_and_nothing_finished_is_lost(
    whole: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "out"

    def kill_one(done: int, _: int) -> None:
        if done == 6:
            kill_a_worker()

    # Long enough that the others are not done before the loss is noticed.
    campaign = SMALL.replace(repeats=300)
    with pytest.raises(WorkerLost, match="a worker process died .* all finished shards are kept"):
        run_campaign(campaign, folder, n_jobs=2, progress=kill_one)
    kept = contents(folder)
    assert "shard-00000.parquet" in kept
    assert "manifest.json" not in kept
    for name, content in kept.items():
        if name in ("shard-00000.npy", "shard-00000.parquet"):
            assert content == (whole / name).read_bytes()


def test_a_worker_of_another_version_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    here, numbers = _folder.made_with(), itertools.count()
    monkeypatch.setattr(_folder, "made_with", lambda: {**here, "numpy": f"{next(numbers)}.0"})
    with pytest.raises(ValueError, match=r"a worker has numpy 2.0, the campaign 1.0: install the same"):
        run_campaign(SMALL, tmp_path / "out")


# A Dask cluster over loopback.


@contextlib.contextmanager
def cluster(n_workers: int = 2, processes: bool = True):  # type: ignore[no-untyped-def]
    import dask
    from distributed import LocalCluster

    options = {"dashboard_address": ":0", "protocol": "tcp", "host": "127.0.0.1", "threads_per_worker": 1}
    with (
        dask.config.set({"distributed.worker.multiprocessing-method": "spawn"}),
        LocalCluster(n_workers=n_workers, processes=processes, **options) as made,
    ):
        yield made


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_no_scheduler_no_workers_no_dask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_folder, "CONNECT_S", 0.5)
    monkeypatch.setattr(_folder, "NO_WORKER_S", 0.5)
    with pytest.raises(
        WorkerLost, match=r"no Dask scheduler answers at 'tcp://127.0.0.1:9' .* like tcp://host:8786"
    ):
        run_campaign(SMALL, tmp_path / "out", scheduler="tcp://127.0.0.1:9")
    with pytest.raises(WorkerLost, match="no Dask scheduler answers at 'magic://'"):
        run_campaign(SMALL, tmp_path / "out", scheduler="magic://")
    with (
        cluster(0, processes=False) as made,
        pytest.raises(WorkerLost, match="has had no worker for 0.5 s; all finished shards are kept"),
    ):
        run_campaign(SMALL, tmp_path / "out", scheduler=made.scheduler_address)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ImportError, match="pip install distributed"):
        run_campaign(SMALL, tmp_path / "out", scheduler="tcp://127.0.0.1:9")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_cluster_makes_the_same_bytes_without_one_worker_and_what_is_left_without_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_folder, "NO_WORKER_S", 2.0)
    monkeypatch.setattr(_folder, "LOOK_S", 0.5)
    campaign, folder = SMALL.replace(repeats=60), tmp_path / "cluster"
    run_campaign(campaign, tmp_path / "alone")
    killed: list[int] = []
    with cluster() as made:

        def end_workers(done: int, _: int) -> None:
            if done == 50:
                killed.append(next(iter(made.workers.values())).pid)
                os.kill(killed[0], signal.SIGKILL)
            if done == 110:
                made.scale(0)

        with pytest.raises(WorkerLost, match="no worker for 2 s; all finished shards are kept"):
            run_campaign(campaign, folder, scheduler=made.scheduler_address, progress=end_workers)
    assert len(killed) == 1
    assert 27 <= len(list(folder.glob("shard-*.npy"))) < campaign.n_shards
    assert not list(folder.glob(".*"))
    run_campaign(campaign, folder)
    assert contents(folder) == contents(tmp_path / "alone")
