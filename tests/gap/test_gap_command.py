"""``cyclofeat gap``: from folders of recordings to names, a report and a model that other commands take."""

from __future__ import annotations

import csv
import functools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cyclofeat.gap
from cyclofeat.cli import main
from cyclofeat.datasets import make_rig_recording, read_recording
from cyclofeat.gap import MAY_DIFFER, Bank, Comparison, GapSettings, Windows
from cyclofeat.simulators import Hum, LobeDefects, Rig

SMALL = {
    "n_after": 24, "n_report": 16, "n_null": 24, "n_sims": 48, "n_interval": 24,
    "n_permutations": 499, "baselines": ("nothing",), "with_placebo": False,
}  # fmt: skip
OPTIONS = ("--effects", "hum,offset", "--draws", "8", "--jobs", "1")
COUNTS, HOLD_COUNTS = (0, 3), (0, 3, 5)
RATE = 6400.0


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command with few simulations: their numbers are no options of it."""
    monkeypatch.setattr(cyclofeat.gap, "GapSettings", functools.partial(GapSettings, **SMALL))
    monkeypatch.setattr(cyclofeat.gap, "Comparison", functools.partial(Comparison, n_bank=24))


def run(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of one call."""
    code = main(["gap", *(str(argument) for argument in arguments)])
    return code, *capsys.readouterr()


def write_folder(
    folder: Path,
    X: Sequence[np.ndarray],
    counts: Sequence[int],
    rate: float = RATE,
    assemblies: Sequence[str] | None = None,
    **more: Sequence[Any],
) -> Path:
    """A folder of recordings with their table; ``more`` are arrays of the files or columns of the table.

    Without names each recording is of an assembly of its own.
    """
    folder.mkdir()
    columns = {name: values for name, values in more.items() if not isinstance(values[0], np.ndarray)}
    arrays = {name: values for name, values in more.items() if name not in columns}
    with (folder / "recordings.csv").open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(
            ["file", "sampling_rate", "defect_count", "run", "assembly", "speed", "load", "source", *columns]
        )
        for i, (torque, count) in enumerate(zip(X, counts, strict=True)):
            others = {name: values[i] for name, values in arrays.items()}
            np.savez(folder / f"r{i}.npz", torque=torque, sampling_rate=np.float64(rate), **others)
            own = [values[i] for values in columns.values()]
            assembly = f"{folder.name}_{i}" if assemblies is None else assemblies[i]
            rows.writerow([f"r{i}.npz", rate, count, f"r{i}", assembly, 500, 22, "surrogate", *own])
    return folder


@pytest.fixture(scope="module")
def banks(simulations: Path) -> tuple[Bank, Bank]:
    hum = Comparison(sampling_rate=RATE, rig=Rig(effects=[Hum(0.4)]), cache=simulations)
    return hum.bank(6, COUNTS, random_state=101), hum.bank(6, HOLD_COUNTS, random_state=102)


@pytest.fixture(scope="module")
def folders(banks: tuple[Bank, Bank], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    top = tmp_path_factory.mktemp("measured")
    fit, hold = (
        write_folder(top / name, bank.X, bank.counts)
        for name, bank in zip(("fit", "hold"), banks, strict=True)
    )
    return fit, hold


# What it writes


@pytest.mark.bench
def test_folders_in_names_a_report_and_a_model_out(
    folders: tuple[Path, Path], simulations: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report, model = tmp_path / "report.html", tmp_path / "corrected.json"
    code, out, err = run(
        capsys, folders[0], "--hold-out", folders[1], "--cache", simulations, "--out", report,
        "--save-simulator", model, "--json", *OPTIONS,
    )  # fmt: skip
    assert code == 0, err
    result = json.loads(out)
    assert result["format"] == "cyclofeat gap 1"
    assert result["verdict"] == "disagree"
    assert result["effects"][0]["id"] == "hum"
    amplitude = result["effects"][0]["theta"]["amplitude_nm"]
    assert amplitude == pytest.approx(0.4, rel=0.1)
    assert result["grr"]["all"] > 0.5
    lines = err.splitlines()
    assert all(line.startswith("cyclofeat gap: ") for line in lines)
    assert lines[0] == "cyclofeat gap: comparing measurement and model"
    assert lines[-1] == "cyclofeat gap: judging on recordings held out"
    assert "hum" in report.read_text(encoding="utf-8").lower()
    _model_is_taken_elsewhere(model, amplitude, tmp_path, capsys)
    _same_for_people(folders, simulations, capsys)


def _model_is_taken_elsewhere(
    model: Path, amplitude: float, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By simulate, by all that makes rig recordings (train and campaigns), and as the next gap's model."""
    rig = Rig.from_json(model)
    assert rig.effects == (Hum(amplitude),)
    assert rig.gearbox == Rig().gearbox
    arguments = ["simulate", "--simulator", model, "--worn-count", "2", "--duration", "0.3", "--out"]
    assert main([str(argument) for argument in (*arguments, folder / "one.npz")]) == 0
    assert "surrogate" in capsys.readouterr().out
    one = read_recording(folder / "one.npz")
    assert one.meta["effects"] == [Hum(amplitude).to_dict()]
    made = make_rig_recording(rig, LobeDefects.healthy(), duration=0.1, random_state=0)
    assert made.meta["effects"] == one.meta["effects"]
    assert Rig.from_json(model).effects == (Hum(amplitude),)


def _same_for_people(
    folders: tuple[Path, Path], simulations: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same run from the cache, in words."""
    code, out, _ = run(capsys, folders[0], "--hold-out", folders[1], "--cache", simulations, *OPTIONS)
    assert code == 0
    lines = out.splitlines()
    assert lines[0].startswith("model and measurement disagree (p = ")
    assert lines[1].startswith("missing: hum (")
    assert lines[2].strip().startswith("amplitude_nm = 0.")
    assert any(line.startswith("held out: ") and "of the gap closed" in line for line in lines)
    assert lines[-1].startswith("note: ")


def test_a_model_that_has_the_effect_lacks_nothing(
    folders: tuple[Path, Path], simulations: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Rig(effects=[Hum(0.4)]).to_json(tmp_path / "right.json")
    code, out, err = run(
        capsys, folders[0], "--simulator", tmp_path / "right.json", "--cache", simulations, "--json",
        "--save-simulator", tmp_path / "same.json", *OPTIONS,
    )  # fmt: skip
    assert code == 0, err
    result = json.loads(out)
    assert result["verdict"] == "unresolved"
    assert result["effects"] == []
    assert Rig.from_json(tmp_path / "same.json").effects == (Hum(0.4),)


# What it reads


class _Given(Exception):
    """What the command hands to the workflow."""

    def __init__(self, values: dict[str, Any]) -> None:
        self.values = values


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Any]]:
    """What a call hands over, without any simulation."""

    def find(comparison: Comparison, fit: Windows, hold: Windows | None, **_: Any) -> None:
        measured = {"fit": fit, "hold": hold or Windows(None)}
        values = {
            f"{name}_{end}": value for end, one in measured.items() for name, value in vars(one).items()
        }
        raise _Given({"rate": comparison.sampling_rate, "population": comparison.population, **values})

    monkeypatch.setattr(cyclofeat.gap, "find_gap", find)

    def call(*arguments: Any) -> dict[str, Any]:
        with pytest.raises(_Given) as found:
            main(["gap", *(str(argument) for argument in arguments)])
        return found.value.values

    return call


NOISE = np.random.default_rng(0).normal(22, 0.1, (8, 23_040)).astype(np.float32)


def test_recordings_of_unequal_length_are_cut_into_windows(given: Any, tmp_path: Path) -> None:
    lengths = (11_520, 23_040, 14_000)
    folder = write_folder(tmp_path / "m", [NOISE[i, :n] for i, n in enumerate(lengths)], [0, 3, 5])
    found = given(folder)
    assert found["X_fit"].shape == (4, 11_520)
    assert np.array_equal(found["X_fit"][2], NOISE[1, 11_520:])
    assert found["y_fit"].tolist() == [0, 3, 3, 5]
    assert len(set(found["groups_fit"])) == 3
    assert found["groups_fit"][1] == found["groups_fit"][2]
    assert found["X_hold"] is None


def test_a_share_is_held_out_of_every_class(given: Any, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "m", NOISE[:, :11_520], [0, 0, 0, 0, 3, 3, 3, 3])
    found = given(folder, "--hold-out", "0.5")
    assert sorted(found["y_fit"]) == sorted(found["y_hold"]) == [0, 0, 3, 3]
    both = np.vstack([found["X_fit"], found["X_hold"]])
    assert sorted(both[:, 0].tolist()) == sorted(NOISE[:, 0].tolist())
    again, other = (given(folder, "--hold-out", "0.5", "--seed", seed) for seed in (0, 4))
    assert np.array_equal(again["X_hold"], found["X_hold"])
    assert not np.array_equal(other["X_hold"], found["X_hold"])


def test_an_assembly_is_held_out_as_a_whole(given: Any, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "m", NOISE[:, :11_520], [0, 0, 0, 0, 3, 3, 3, 3], assemblies="aabbccdd")
    found = given(folder, "--hold-out", "0.5")
    assert sorted(found["y_fit"]) == sorted(found["y_hold"]) == [0, 0, 3, 3]
    place = {row[0]: i // 2 for i, row in enumerate(NOISE)}
    fit, hold = ({place[float(row[0])] for row in found[name]} for name in ("X_fit", "X_hold"))
    assert len(fit) == len(hold) == 2
    assert not fit & hold


def test_a_rig_s_own_spread_is_what_may_differ(given: Any, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "m", NOISE[:2, :11_520], [0, 3])
    gearbox, rig = tmp_path / "gearbox.json", tmp_path / "rig.json"
    Rig(effects=[Hum(0.1)]).to_json(gearbox)
    Rig.r1().to_json(rig)
    (without, own) = (given(folder, "--simulator", file) for file in (gearbox, rig))
    assert without["population"].rig == Rig(effects=[Hum(0.1), *MAY_DIFFER])
    assert own["population"].rig == Rig.r1()


def test_an_angle_is_used_where_all_have_it(given: Any, tmp_path: Path) -> None:
    angle = [2 * np.pi * 8.3 * (1 + 0.001 * i) * np.arange(23_040) / RATE for i in range(2)]
    folder = write_folder(tmp_path / "m", NOISE[:2], [0, 3], angle=angle)
    found = given(folder)
    expected = [angle[i][k : k + 11_520] for i in range(2) for k in (0, 11_520)]
    assert found["angle_fit"] == pytest.approx(np.array(expected))
    assert given(folder, "--no-angle")["angle_fit"] is None
    (tmp_path / "more").mkdir()
    np.savez(
        tmp_path / "more" / "bare.npz", torque=NOISE[3], sampling_rate=RATE, defect_count=0, speed_rpm=500.0
    )
    assert given(folder, tmp_path / "more")["angle_fit"] is None


def test_a_tachometer_on_the_disc_gives_the_angle_of_the_input(given: Any, tmp_path: Path) -> None:
    """A disc turns backwards, once in 15 turns of the input."""
    phi = 2 * np.pi * 500 / 60 * np.arange(23_040) / RATE
    folder = write_folder(tmp_path / "m", NOISE[:2], [0, 3], angle=[-phi / 15] * 2, angle_of=["disc"] * 2)
    found = given(folder)["angle_fit"]
    assert found[:, -1] - found[:, 0] == pytest.approx(np.full(4, phi[11_519]), rel=1e-6)


# Two folders


def test_two_folders_of_recordings_need_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    noise = np.random.default_rng(1).normal(22, 0.1, (68, 12_000))
    noise[8:] += np.sin(2 * np.pi * 50 * np.arange(12_000) / RATE)
    measured = write_folder(tmp_path / "measured", noise[:8], [0, 3] * 4)
    runs = write_folder(tmp_path / "runs", noise[8:], [0, 3] * 30)
    code, out, err = run(capsys, measured, "--simulated", runs, "--json")
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert found["verdict"] == "disagree"
    assert found["effects"] == found["named"] == []
    code, out, _ = run(capsys, measured, "--simulated", runs)
    assert code == 0
    assert out.startswith("model and measurement disagree (p = ")
    code, _, err = run(capsys, measured, "--simulated", runs, "--hold-out", "0.4")
    assert (code, err) == (2, "cyclofeat: error: --hold-out has no effect with --simulated: leave it out\n")


# What it refuses


def bad_calls(folder: Path) -> dict[str, tuple[list[Any], str]]:
    """Calls, and what their one line says."""
    good = write_folder(folder / "good", NOISE[:4, :11_520], [0, 0, 3, 3])
    two_speeds = write_folder(folder / "speeds", NOISE[:2, :11_520], [0, 3])
    table = (two_speeds / "recordings.csv").read_text().replace("500,22", "500,22", 1)
    lines = table.splitlines()
    (two_speeds / "recordings.csv").write_text("\n".join([*lines[:2], lines[2].replace("500,22", "400,22")]))
    nan = NOISE[:2, :11_520].copy()
    nan[1, 7] = np.nan
    (folder / "empty").mkdir()
    (folder / "broken.json").write_text("{")
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
        "one speed": ([good, "--hold-out", "speed"], "--hold-out speed needs recordings at 3 speeds or more"),
        "small share": ([good, "--hold-out", "0.01"], "--hold-out 0.01 leaves 4 of 4 recordings to fit"),
        "hold-out absent": ([good, "--hold-out", folder / "absent"], "no such file"),
        "effects": ([good, "--effects", "rust"], "--effects must name different effects of pin_errors"),
        "alpha": ([good, "--alpha", "3"], "alpha"),
        "draws": ([good, "--draws", "0"], "n_draws"),
        "simulator": ([good, "--simulator", folder / "broken.json"], "broken.json"),
        "two speeds": ([two_speeds], "one nominal speed between them: give --speed"),
        "another disc": ([good, "--n-lobes", "11"], "discs have 15 lobes, those of the recordings 11"),
        "NaN": ([write_folder(folder / "nan", nan, [0, 3])], "r1.npz"),
        "short": ([write_folder(folder / "short", NOISE[:2, :2000], [0, 3])], "1.8 s"),
        "one": ([write_folder(folder / "one", NOISE[:1, :11_520], [0])], "at least 2 recordings"),
        "hold-out's rate": (
            [good, "--hold-out", write_folder(folder / "other", NOISE[:2], [0, 3], rate=12_800.0)],
            "--hold-out must hold recordings with the rate of MEASURED, 6400 Hz, got 12800 Hz",
        ),
    }  # fmt: skip


def test_what_cannot_be_is_one_clear_line(
    tmp_path: Path, simulations: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for what, (arguments, message) in bad_calls(tmp_path).items():
        code, out, err = run(capsys, *arguments, "--cache", simulations, "--jobs", 1)
        assert (code, out) == (2, ""), what
        lines = [line for line in err.splitlines() if not line.startswith("cyclofeat gap: ")]
        assert len(lines) == 1, what
        assert message in lines[0], what


def test_what_argparse_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in ([], [tmp_path, "--max-effects", "3"], [tmp_path, "--draws", "many"]):
        with pytest.raises(SystemExit) as stop:
            run(capsys, *arguments)
        assert stop.value.code == 2
        assert "error: " in capsys.readouterr().err


# Interrupted

SCRIPT = """
import functools, sys
import cyclofeat.gap
from cyclofeat.cli import main
cyclofeat.gap.GapSettings = functools.partial(cyclofeat.gap.GapSettings, **{small!r})
cyclofeat.gap.Comparison = functools.partial(cyclofeat.gap.Comparison, n_bank=40)
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.bench
def test_a_killed_run_goes_on_and_ends_the_same(
    folders: tuple[Path, Path], tmp_path: Path, simulations: Path
) -> None:
    script = tmp_path / "small.py"
    script.write_text(SCRIPT.format(small=SMALL))

    def command(cache: Path) -> list[str]:
        call = ["gap", folders[0], "--hold-out", folders[1], "--json", "--cache", cache, *OPTIONS]
        return [sys.executable, str(script), *map(str, call)]

    def result(cache: Path) -> dict[str, Any]:
        done = subprocess.run(command(cache), capture_output=True, text=True, check=True)
        return {key: value for key, value in json.loads(done.stdout).items() if key != "seconds"}

    expected = result(tmp_path / "whole")
    broken = tmp_path / "broken"
    for word in ("naming what is missing", "fitting hum"):
        process = subprocess.Popen(
            command(broken), stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
        )
        assert process.stderr is not None
        for line in process.stderr:
            if word in line:
                time.sleep(0.5)
                os.kill(process.pid, signal.SIGKILL)
                break
        process.stderr.close()
        assert process.wait() == -signal.SIGKILL
    assert (broken / "bank").is_dir()
    assert result(broken) == expected


def test_recordings_are_the_bank_s(banks: tuple[Bank, Bank]) -> None:
    """The folder's recordings are what the simulator with hum gives, of other seeds than the comparison's."""
    again = Comparison(sampling_rate=RATE, rig=Rig(effects=[Hum(0.4)])).bank(1, COUNTS, random_state=101)
    assert np.array_equal(again.X[0], banks[0].X[0])
