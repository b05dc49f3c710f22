"""``cyclofeat gap``: from folders of recordings to names, a report and a model that other commands take."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import cyclofeat.cli.gap
import cyclofeat.gap
from cyclofeat._base.training import import_jax
from cyclofeat.cli import main
from cyclofeat.gap import EffectPosterior, World, compare_recordings
from cyclofeat.recordings import Recording
from cyclofeat.simulators import Hum, Noise, Rig

RATE = 6400.0
NOISE = np.random.default_rng(0).normal(22, 0.1, (100, 23_040)).astype(np.float32)


def run(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of one call."""
    code = main(["gap", *(str(argument) for argument in arguments)])
    return code, *capsys.readouterr()


def write_folder(
    folder: Path, X: Sequence[np.ndarray], counts: Sequence[int], rate: float = RATE, **more: Sequence[Any]
) -> Path:
    """A folder of recordings with their table; ``more`` are columns of it.

    At 500 RPM and 22 Nm, and each recording of an assembly of its own, where they state nothing else.
    """
    folder.mkdir()
    n = len(counts)
    columns = {
        "sampling_rate": [rate] * n, "defect_count": counts, "run": [f"r{i}" for i in range(n)],
        "assembly": [f"{folder.name}_{i}" for i in range(n)], "speed": [500] * n, "load": [22] * n,
        "source": ["surrogate"] * n,
    } | more  # fmt: skip
    with (folder / "recordings.csv").open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["file", *columns])
        for i, values in enumerate(zip(*columns.values(), strict=True)):
            np.savez(folder / f"r{i}.npz", torque=X[i], sampling_rate=np.float64(rate))
            rows.writerow([f"r{i}.npz", *values])
    return folder


# What it hands to the workflow


class _Given(Exception):
    """What the command hands over."""

    def __init__(self, values: dict[str, Any]) -> None:
        self.values = values


@pytest.fixture
def learned(monkeypatch: pytest.MonkeyPatch) -> None:
    """A posterior in the package's and in any file, which nobody asks."""

    def load(path: Any = "packaged") -> SimpleNamespace:
        return SimpleNamespace(names_=("noise", "hum"), world=World(rig=Rig(effects=[Noise(0.1)])), path=path)

    monkeypatch.setattr(cyclofeat.gap, "load_posterior", load)


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch, learned: None) -> Callable[..., dict[str, Any]]:
    """What a call hands over, without any simulation."""

    def find(fit: list[Any], hold: list[Any] | None, **others: Any) -> None:
        raise _Given({"fit": fit, "hold": hold, **others})

    monkeypatch.setattr(cyclofeat.gap, "find_gap", find, raising=False)

    def call(*arguments: Any) -> dict[str, Any]:
        with pytest.raises(_Given) as found:
            main(["gap", *(str(argument) for argument in arguments)])
        return found.value.values

    return call


def test_speeds_and_loads_are_the_table_s_and_options_the_settings(given: Any, tmp_path: Path) -> None:
    folder = write_folder(
        tmp_path / "m", NOISE, [0, 3, 5, 3], speed=[400, 500, 600, 500], load=[10, 20, 30, -20]
    )
    found = given(folder)
    assert [(one.speed_rpm, one.load_nm) for one in found["fit"]] == [
        (400, 10), (500, 20), (600, 30), (500, -20),
    ]  # fmt: skip
    assert found["hold"] is None
    assert (found["model"], found["posterior"]) == (None, None)  # find_gap chooses
    assert not found["settings"].pictures
    options = ["--alpha", 0.1, "--seed", 4, "--jobs", 1, "--one-assembly", "--cache", tmp_path / "cache"]
    found = given(folder, *options, "--posterior", "mine.npz", "--out", tmp_path / "r.html")
    settings = found["settings"]
    assert (settings.alpha, settings.random_state, settings.n_jobs) == (0.1, 4, 1)
    assert settings.one_assembly
    assert settings.pictures
    assert settings.cache == str(tmp_path / "cache")
    assert found["posterior"].path == "mine.npz"


def test_a_share_a_speed_a_load_or_a_folder_is_held_out(given: Any, tmp_path: Path) -> None:
    at = [(speed, load) for speed in (400, 500, 600) for load in (10, 20, 30)]
    folder = write_folder(
        tmp_path / "m", NOISE, [0] * 9, speed=[speed for speed, _ in at], load=[load for _, load in at]
    )
    for by, held in (("speed", {(500, load) for load in (10, 20, 30)}), ("load", {(s, 20) for s, _ in at})):
        found = given(folder, "--hold-out", by)
        assert {(one.speed_rpm, one.load_nm) for one in found["hold"]} == held
        assert len(found["fit"]) == 6
    other = write_folder(tmp_path / "other", NOISE, [0, 3])
    found = given(folder, "--hold-out", other)
    assert (len(found["fit"]), [one.defect_count for one in found["hold"]]) == (9, [0, 3])
    one_kind = write_folder(tmp_path / "same", NOISE, [0, 0, 0, 0, 3, 3, 3, 3])
    runs = []
    for seed in (0, 0, 4):
        found = given(one_kind, "--hold-out", "0.5", "--seed", seed)
        assert sorted(one.defect_count for one in found["hold"]) == [0, 0, 3, 3]
        runs.append([one.run for one in found["hold"]])
    assert runs[0] == runs[1] != runs[2]


def test_a_posterior_belongs_to_its_model(given: Any, tmp_path: Path, capsys: Any) -> None:
    """At whatever speed and load, and under whatever name."""
    folder = write_folder(tmp_path / "m", NOISE, [0, 3])
    rig = Rig(effects=[Noise(0.1)], name="mine")
    rig.replace(gearbox=rig.gearbox.replace(input_speed=40.0, load_torque=12.0)).to_json(tmp_path / "a.json")
    given(folder, "--simulator", tmp_path / "a.json", "--posterior", "packaged")
    assert given(folder, "--simulator", tmp_path / "a.json")["model"].name == "mine"
    rig.with_added(Hum(0.1)).to_json(tmp_path / "b.json")
    code, _, err = run(capsys, folder, "--simulator", tmp_path / "b.json", "--posterior", "packaged")
    assert code == 2
    assert "the packaged posterior was learned from another model" in err
    code, _, err = run(capsys, folder, "--simulator", tmp_path / "b.json", "--posterior", "mine.npz")
    assert "mine.npz was learned from another model" in err
    assert "--prepare FILE" in err


# Two folders


@pytest.mark.slow
def test_two_folders_of_recordings_need_no_model(
    tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = write_folder(tmp_path / "measured", NOISE[:8, :12_000], [0, 3] * 4)
    time = np.arange(12_000) / RATE
    with_line = NOISE[8:68, :12_000] + np.sin(2 * np.pi * 50 * time)
    runs = write_folder(tmp_path / "runs", with_line, [0, 3] * 30)
    results: list[Any] = []

    def compared(*given: Any, **settings: Any) -> Any:
        results.append(compare_recordings(*given, **settings))
        return results[0]

    monkeypatch.setattr(cyclofeat.gap, "compare_recordings", compared)
    code, out, err = run(capsys, measured, "--simulated", runs, "--out", tmp_path / "page.html", "--json")
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert found["format"] == "cyclofeat gap 2"
    assert found["verdict"] == "disagree"
    assert found["effects"] == found["named"] == []
    assert "<html" in (tmp_path / "page.html").read_text(encoding="utf-8")
    monkeypatch.setattr(cyclofeat.gap, "compare_recordings", lambda *_, **__: results[0])

    def fail(*_: Any, **__: Any) -> None:
        raise ValueError("no page")

    monkeypatch.setattr("cyclofeat.report.write_gap_report", fail)
    options = ("--simulated", runs, "--out", tmp_path / "other.html")
    code, out, err = run(capsys, measured, *options)  # what is finished is printed before the page
    assert (code, err) == (2, "cyclofeat: error: no page\n")
    assert out.startswith("Model and recordings disagree\n  recordings: ")
    assert json.loads(run(capsys, measured, *options, "--json")[1]) == found | {"error": "no page"}


# Preparation


@pytest.fixture
def prepared(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What is handed to simulation and learning, of which nothing is done."""
    asked: dict[str, Any] = {}

    def simulate(world: World, folder: Path, n: int, **others: Any) -> str:
        asked.update(world=world, folder=folder, n=n, **others)
        return "rigs"

    def fit(self: EffectPosterior, rigs: str, **_: Any) -> EffectPosterior:
        asked.update(rigs=rigs, seed=self.random_state)
        world = asked["world"]
        self.names_, self.n_rigs_, self.world_ = world.names, 96, world.to_dict()
        self.networks_: list[Any] = []
        return self

    def save(self: EffectPosterior, path: str) -> Path:
        Path(path).write_bytes(b"posterior")
        return Path(path)

    monkeypatch.setattr(cyclofeat.gap, "prepare_world", simulate)
    monkeypatch.setattr(EffectPosterior, "fit", fit)
    monkeypatch.setattr(EffectPosterior, "save", save)
    monkeypatch.setattr(cyclofeat.cli.gap, "import_jax", lambda: None)
    return asked


def test_a_posterior_is_prepared_for_one_s_own_model(
    prepared: dict[str, Any], tmp_path: Path, capsys: Any
) -> None:
    Rig(effects=[Noise(0.1)]).to_json(tmp_path / "mine.json")
    target = tmp_path / "mine.npz"
    code, out, err = run(
        capsys, "--prepare", target, "--simulator", tmp_path / "mine.json", "--cache", tmp_path / "cache",
        "--machines", 24, "--seed", 5, "--jobs", 2, "--quantity", "input_torque",
    )  # fmt: skip
    assert code == 0, err
    world = prepared["world"]
    assert world.quantity == "input_torque"
    assert (world.rig.effects, world.random_state) == ((Noise(0.1),), 5)
    assert "noise" not in world.names
    assert (world.speeds_rpm, world.sampling_rate) == (World().speeds_rpm, 25_600)
    assert (prepared["folder"], prepared["n"]) == (tmp_path / "cache" / "world", 24)
    assert (prepared["n_jobs"], prepared["rigs"], prepared["seed"]) == (2, "rigs", 5)
    assert target.read_bytes() == b"posterior"
    effects = len(World(rig=world.rig).names)
    assert out.strip() == (
        f"{target}: {effects} effects, learned from the input torque of 96 simulated rigs at 350 to 700 RPM, "
        "10 to 30 Nm and 25600 Hz"
    )


def test_a_posterior_is_prepared_for_the_conditions_of_recordings(
    prepared: dict[str, Any], tmp_path: Path, capsys: Any
) -> None:
    folder = write_folder(tmp_path / "m", NOISE, [0, 9], speed=[1000, 1500], load=[5, 5])
    options = ["--prepare", tmp_path / "p.npz", "--cache", tmp_path, "--effects", "hum,gain"]
    code, out, _ = run(capsys, folder, *options, "--json")
    assert code == 0
    found = json.loads(out)
    assert found["speeds_rpm"] == pytest.approx([900, 1650])
    assert found["loads_nm"] == pytest.approx([4.5, 5.5])
    assert (found["sampling_rate"], found["effects"]) == (RATE, ["hum", "gain"])
    assert (prepared["world"].most, max(prepared["world"].defect_counts)) == (2, 9)


def test_what_a_preparation_needs(
    prepared: dict[str, Any], tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "p.npz"
    for arguments, message in (
        (["--prepare", target], "--prepare needs --cache FOLDER"),
        (["--prepare", target, "--cache", __file__], f"--cache must name a folder, {__file__} is a file"),
        (
            ["--prepare", target, "--cache", tmp_path, "--machines", "0"],
            "--machines: must be a whole number of at least 1",
        ),
        (["--prepare", target, "--cache", tmp_path, "--effects", "rust"], "--effects must name different"),
        ([], "MEASURED must name recordings"),
    ):
        code, out, err = run(capsys, *arguments)
        assert (code, out, len(err.splitlines())) == (2, "", 1)
        assert message in err
    monkeypatch.setattr(cyclofeat.cli.gap, "import_jax", import_jax)
    monkeypatch.setitem(sys.modules, "jax", None)
    code, _, err = run(capsys, "--prepare", target, "--cache", tmp_path)
    assert code == 2
    assert err.endswith("training a network needs JAX and Optax: pip install jax optax\n")


# What it refuses


def bad_calls(folder: Path) -> dict[str, tuple[list[Any], str]]:
    """Calls, and what their one line says."""
    good = write_folder(folder / "good", NOISE, [0, 0, 3, 3])
    nan = NOISE[:2].copy()
    nan[1, 7] = np.nan
    (folder / "empty").mkdir()
    (folder / "broken.json").write_text("{", encoding="utf-8")
    return {
        "absent": ([folder / "absent"], "no such file"),
        "empty": ([folder / "empty"], "empty"),
        "no folder for the report": ([good, "--out", folder / "no" / "r.html"], "for --out does not exist"),
        "no folder for the model": (
            [good, "--save-simulator", folder / "no" / "m.json"], "for --save-simulator does not exist",
        ),
        "share": (
            [good, "--hold-out", "1.5"], "--hold-out must be a share between 0 and 1, speed or load, got 1.5",
        ),
        "small share": ([good, "--hold-out", "0.01"], "--hold-out 0.01 leaves 4 of 4 recordings to fit"),
        "one speed": ([good, "--hold-out", "speed"], "--hold-out speed needs recordings at 3 speeds or more"),
        "hold-out absent": ([good, "--hold-out", folder / "absent"], "no such file"),
        "alpha": ([good, "--alpha", "3"], "alpha"),
        "simulator": ([good, "--simulator", folder / "broken.json"], "broken.json"),
        "NaN": ([write_folder(folder / "nan", nan, [0, 3])], "r1.npz"),
        "no speed": (
            [write_folder(folder / "speed", NOISE, [0, 3], speed=["", ""]), "--simulated", good],
            "2 of 6 recordings state no nominal speed: give --speed (RPM)",
        ),
        "one": ([write_folder(folder / "one", NOISE, [0]), "--simulated", good], "at least 2 recordings"),
    }  # fmt: skip


def test_what_cannot_be_is_one_clear_line(tmp_path: Path, learned: None, capsys: Any) -> None:
    for what, (arguments, message) in bad_calls(tmp_path).items():
        jobs = [] if "--simulated" in arguments else ["--jobs", 1]
        code, out, err = run(capsys, *arguments, *jobs, "--quiet")
        assert (code, out, err.count("\n")) == (2, "", 1), what
        assert message in err, (what, err)


def test_a_posterior_that_is_absent(tmp_path: Path, capsys: Any) -> None:
    folder = write_folder(tmp_path / "m", NOISE, [0, 3])
    code, _, err = run(capsys, folder, "--posterior", tmp_path / "absent.npz")
    assert code == 2
    assert f"no such posterior: {tmp_path / 'absent.npz'}; write one with --prepare FILE" in err


def test_a_counter_for_the_corrected_model_is_tried_beside_the_packaged_one(
    monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    told: list[Any] = []

    class Counter:
        def __init__(self, right: int) -> None:
            self.right = right

        def count(self, recording: Any) -> SimpleNamespace:
            counted = recording.defect_count if recording.defect_count <= self.right else 0
            return SimpleNamespace(defect_count=counted, refused=recording.defect_count == 9)

    monkeypatch.setattr("cyclofeat.cli.train.run", told.append)
    monkeypatch.setattr("cyclofeat.models.load_model", lambda _: Counter(9))
    monkeypatch.setattr("cyclofeat.models.load_default_model", lambda _: Counter(2))
    recordings = [Recording(NOISE[0], RATE, speed_rpm=500, defect_count=n) for n in (0, 2, 3, 9)]
    typed = SimpleNamespace(save_simulator="c.json", train="c.skops", random_state=4, n_jobs=1)
    rows = cyclofeat.cli.gap.try_counters(typed, recordings)
    assert [(row["right"], row["refused"], row["n"]) for row in rows] == [(3, 1, 4), (2, 1, 4)]
    (trained,) = told
    assert (trained.rig, trained.out, trained.sampling_rate) == ("c.json", "c.skops", RATE)
    assert (trained.max_count, trained.random_state) == (9, 4)
    assert "minutes" in capsys.readouterr().err  # said beforehand
