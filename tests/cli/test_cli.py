"""The command line: the way from nothing to a count, and every mistake on it."""

import argparse
import csv
import dataclasses
import io
import itertools
import json
import os
import re
import shlex
import subprocess
import sys
import weakref
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import small_model
from command import call, run

from cyclofeat import __version__
from cyclofeat.cli import COMMANDS, demo, main, make_parser
from cyclofeat.cli._options import Arguments
from cyclofeat.cli.inspect import _speed_text
from cyclofeat.counting import LobeModel, Protocol, evaluate
from cyclofeat.datasets import read_folder, read_recording, write_recording
from cyclofeat.datasets.readers import Entry, folder_entries
from cyclofeat.datasets.readers._read import ReadingOptions
from cyclofeat.models import load_model, save_model
from cyclofeat.simulators import (
    Offset,
    Quantisation,
    Rig,
    Scale,
    TorqueMeterLowPass,
    load_effects,
    unregister_effect,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, surrogates):
    """A model and some recordings as files."""
    folder = tmp_path_factory.mktemp("cli")
    save_model(
        folder / "model.joblib", LobeModel(n_splits=0, n_trees=60, random_state=0).fit(surrogates[12:])
    )
    for recording in surrogates[:8]:
        write_recording(folder / f"{recording.assembly}.npz", recording)
    write_recording(folder / "worn.csv", surrogates[11])  # fast enough for a whole output turn
    return folder


@pytest.fixture
def model(folder):
    """Options that name the folder's model."""
    return ["--model", folder / "model.joblib", "--trust"]


@pytest.fixture
def no_pictures(monkeypatch):
    """Reports whose pictures, which take seconds and have tests of their own, are empty."""
    drawn = {"image": "data:,", "alt": "", "width": 1, "height": 1}
    monkeypatch.setattr("cyclofeat.report._figures.draw_picture", lambda *_, **__: drawn)


def test_version_and_help_need_neither_numba_nor_scikit_learn():
    code = (
        "import sys; from cyclofeat.cli import main\n"
        "for words in (['--version'], ['--help'], ['count', '--help'], ['train', '--help']):\n"
        "    try: main(words)\n"
        "    except SystemExit as stop: assert stop.code == 0\n"
        "    assert len(words) > 1 or not {'cyclofeat.cli.count', 'numpy'} & set(sys.modules)\n"
        "assert not {'numba', 'sklearn', 'scipy', 'matplotlib'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"{__version__}\n")


def test_every_argument_of_reading_has_its_option():
    arguments = make_parser().parse_args(["inspect", "x.csv"])
    for field in dataclasses.fields(ReadingOptions):
        assert arguments.options[f"{field.name}="].startswith("--"), field.name
    assert arguments.options["angle_channel=False"] == "--no-angle"


def test_simulate_writes_what_it_says(capsys, tmp_path):
    file = tmp_path / "worn.npz"
    options = ["--worn-lobes", "1,5", "--wheels", "1", "--duration", "0.5", "--speeds", 750, "--loads", 11]
    out, _ = call(capsys, "simulate", *options, "--out", file)
    assert str(file) in out
    assert "Nm" in out
    recording = read_recording(file)
    assert recording.worn_lobes == (0, 4)
    assert (recording.source, recording.speed_rpm, recording.load_nm) == ("simulated", 750, 11)
    assert recording.duration == pytest.approx(0.5)
    assert recording.angle_is_absolute


@pytest.mark.slow
def test_simulate_writes_a_folder_with_its_manifest(capsys, tmp_path):
    conditions = ["--worn-counts", "0,3", "--speeds", 500, "--loads", "11,20:30"]
    options = [*conditions, "--rig", "r0", "--duration", 0.05]
    call(capsys, "simulate", "--out", tmp_path / "m", "--count", 7, *options)
    recordings = read_folder(tmp_path / "m")
    assert [r.defect_count for r in recordings] == [0, 3, 0, 3, 0, 3, 0]
    assert [r.load_nm == 11 or 20 < r.load_nm < 30 for r in recordings] == [True] * 7
    assert folder_entries(tmp_path / "m")[6].arguments["load_nm"] == recordings[6].load_nm
    assert len({r.assembly for r in recordings}) == 7
    for wrong, message in {
        ("--count", 7): "--force to overwrite", ("--count", 3, "--force"): "--count must be at least 4",
        ("--count", 7, "--worn-lobes", 1): "no effect with --count", (): "no effect without --count",
    }.items():  # fmt: skip
        code, _, err = run(capsys, "simulate", "--out", tmp_path / "m", *wrong, *options)
        assert (code, message in err) == (2, True), err


@pytest.mark.slow
@pytest.mark.parametrize("quantity", ["input_torque", "motor_current"])
def test_simulate_records_another_quantity(capsys, tmp_path, quantity):
    machine = ["--worn-count", 2, "--duration", 0.1, "--sampling-rate", 4_000, "--quantity", quantity]
    call(capsys, "simulate", *machine, "--out", tmp_path / "bare.csv")
    call(capsys, "simulate", *machine, "--rig", "R1", "--out", tmp_path / "r1.npz")
    for name in ("bare.csv", "r1.npz"):
        recording = read_recording(tmp_path / name)
        assert (recording.quantity, recording.n_samples, recording.defect_count) == (quantity, 400, 2)


def test_animate_writes_a_page(capsys, tmp_path):
    page = tmp_path / "gearbox.html"
    options = ["--worn-lobes", "1,5", "--duration", 0.05, "--frames", 20, "--out", page]
    out, _ = call(capsys, "animate", *options, "--json")
    assert json.loads(out) == {"file": str(page), "defect_count": 2, "duration_s": 0.05, "frames": 20}
    assert "2 worn lobes: 1, 5" in page.read_text(encoding="utf-8")


def test_animate_shows_the_assembly_that_simulate_records(capsys, tmp_path):
    Rig.r1().without("noise").to_json(tmp_path / "rig.json")
    machine = ["--rig", tmp_path / "rig.json", "--worn-count", 2, "--seed", 3, "--duration", 0.05]
    call(capsys, "simulate", *machine, "--sampling-rate", 6400, "--out", tmp_path / "a.npz")
    call(capsys, "animate", *machine, "--frames", 2, "--out", tmp_path / "a.html")
    recorded = read_recording(tmp_path / "a.npz")
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    machine = json.loads(re.search(r'id="machine">(.*?)</script>', page)[1])
    np.testing.assert_allclose(machine["trace"], recorded.torque, atol=1e-3)
    np.testing.assert_allclose(machine["phi"], recorded.angle[[0, -1]], atol=1e-4)
    assert "SIMULATED" in page


def test_a_rig_is_simulated_from_its_file(capsys, tmp_path):
    effects = [Offset(0.5), Quantisation(0.25)]
    Rig.r0().replace(name="mine", effects=effects).to_json(tmp_path / "mine.json")
    for name in ("a.npz", "b.csv"):
        code, out, err = run(
            capsys, "simulate", "--rig", tmp_path / "mine.json", "--worn-count", 2, "--seed", 3,
            "--duration", 0.1, "--no-angle", "--json", "--out", tmp_path / name,
        )  # fmt: skip
        assert (code, err) == (0, "")
        assert json.loads(out) == {"file": str(tmp_path / name), "defect_count": 2}
    one, other = (read_recording(tmp_path / name) for name in ("a.npz", "b.csv"))
    assert one.source == other.source == "surrogate"
    assert one.angle is None
    np.testing.assert_array_equal(one.torque, other.torque)
    np.testing.assert_array_equal(one.torque * 4, np.rint(one.torque * 4))
    assert one.meta["effects"] == [effect.to_dict() for effect in effects]


MINE = """
from cyclofeat.simulators import Effect

class UpsideDown(Effect):
    "Torque meter that is wired the wrong way round."

    def change_torque(self, torque, sampling_rate, random, context=None):
        return -torque
"""


@pytest.fixture
def mine(tmp_path):
    """A file with an effect of the user, which nobody knows afterwards."""
    (tmp_path / "mine.py").write_text(MINE, encoding="utf-8")
    yield tmp_path / "mine.py"
    unregister_effect("upside_down")


def test_a_rig_names_effects_of_the_user(capsys, mine, tmp_path):
    rig, plain, turned = (tmp_path / name for name in ("rig.json", "plain.npz", "turned.npz"))
    Rig.r0().to_json(rig)
    quick = ["--duration", 0.05, "--effects-from", mine]
    call(capsys, "simulate", "--rig", rig, *quick, "--out", plain)
    Rig.r0().with_effects(load_effects(mine)["upside_down"]()).to_json(rig)
    call(capsys, "simulate", "--rig", rig, *quick, "--out", turned)
    np.testing.assert_array_equal(read_recording(plain).torque, -read_recording(turned).torque)
    unregister_effect("upside_down")
    _, err = call(capsys, "simulate", "--rig", rig, "--out", turned, "--force", code=2)
    assert "upside_down" in err
    load_effects(mine)


@pytest.mark.parametrize(
    "command",
    [
        ["simulate", "--out", "x.npz", "--rig", "x.json"],
        ["animate", "--out", "x.html", "--rig", "x.json"],
        ["train", "--out", "x.skops", "--rig", "x.json"],
        ["campaign", "--verify", "x"],
        ["gap", "x", "--simulator", "x.json"],
    ],
    ids=lambda words: words[0],
)
def test_every_command_of_rigs_takes_effects_of_the_user(capsys, tmp_path, command):
    (tmp_path / "bad.py").write_text("1 / 0", encoding="utf-8")
    _, err = call(capsys, *command, "--effects-from", tmp_path / "bad.py", code=2)
    assert "bad.py, line 1: ZeroDivisionError" in err
    _, err = call(capsys, *command, "--effects-from", tmp_path / "absent.py", code=2)
    assert "absent.py: no such file" in err


@pytest.mark.slow
def test_training_states_how_many_assemblies_have_radial_wear(capsys, tmp_path):
    options = "--mixed-wear 60:200 --assemblies 6 --max-count 1 --windows 1 --sampling-rate 3200"
    out, _ = call(capsys, "train", "--rig", "r1", *options.split(), "--out", tmp_path / "m.joblib")
    assert "12 simulated assemblies of rig R1, seed 0, 3 of them with radial wear of 60 to 200 um" in out
    assert "depth of wear" not in out


@pytest.mark.slow
def test_training_simulates_the_effects_of_a_rig(capsys, tmp_path):
    possible = [(TorqueMeterLowPass(900.0),), (TorqueMeterLowPass(2000.0),)]
    mine = Rig.r0().replace(name="mine", effects=[Offset(0.5)], variants=possible)
    mine.replace(speeds_rpm=(330, 660), loads_nm=(11, 22)).to_json(tmp_path / "mine.json")
    out, err = call(
        capsys, "train", "--rig", tmp_path / "mine.json", "--assemblies", 2, "--max-count", 1,
        "--out", tmp_path / "m.joblib", "--jobs", 1,
    )  # fmt: skip
    assert "simulated assemblies of rig mine" in out
    speeds, loads = re.findall(r"([\d.]+) to ([\d.]+)", out.partition("for recordings")[2])[:2]
    assert 300 <= float(speeds[0]) < 500 < float(speeds[1]) <= 726  # a tenth beyond those of the recordings
    assert 10 <= float(loads[0]) < 16 < float(loads[1]) <= 24.2
    Rig.r0().replace(effects=[TorqueMeterLowPass(2e4)]).to_json(tmp_path / "high.json")
    options = ["--rig", tmp_path / "high.json", "--assemblies", 1, "--out", tmp_path / "n.joblib"]
    _, err = call(capsys, "train", *options, code=2)
    assert "cutoff_hz of torque_meter_low_pass must lie below the Nyquist frequency 12800 Hz" in err


@pytest.mark.slow
def test_training_notes_once_how_many_machines_could_not_be_simulated(capsys, tmp_path):
    """With contacts too stiff for the time step, which no option sets."""
    Rig.r1().with_added(Scale("contact_stiffness", (1, 1000))).to_json(tmp_path / "stiff.json")
    options = ["--rig", tmp_path / "stiff.json", "--assemblies", 2, "--max-count", 1, "--seed", 1]
    _, err = call(capsys, "train", *options, "--out", tmp_path / "m.joblib", "--jobs", 1)
    assert "2 of 4 machines could not be simulated: others were drawn in their place" in err
    assert "dt" not in err


def test_train_and_count(capsys, folder, tmp_path, monkeypatch):
    monkeypatch.setattr("cyclofeat.counting.LobeModel", partial(LobeModel, n_trees=30, n_splits=2))
    model = tmp_path / "small.joblib"
    out, _ = call(capsys, "train", folder, "--out", model)
    assert "counts: 0, 1, 3, 5\n" in out
    out, err = call(capsys, "count", folder / "worn.csv", "--model", model, "--trust", "--json")
    assert err == ""
    (result,) = json.loads(out)
    assert result["file"] == str(folder / "worn.csv")
    assert isinstance(result["defect_count"], int)
    assert set(result["probability"]) == {"0", "1", "3", "5"}
    assert len(result["lobe_probability"]) == 15
    assert all(isinstance(lobe, int) for lobe in result["worn_lobes_from_1"])
    assert result["warnings"] == []


@pytest.mark.slow
def test_train_learns_the_depth_of_the_wear(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("cyclofeat.counting.LobeModel", partial(LobeModel, n_trees=10, n_splits=0))
    (tmp_path / "known").mkdir()
    for one in small_model.recordings_with_wear(8, counts=(0, 3)):
        write_recording(tmp_path / "known" / f"{one.assembly}.npz", one)
    model = tmp_path / "wear.joblib"
    out, err = call(capsys, "train", tmp_path / "known", "--wear", "5:200", "--out", model)
    assert "depth of wear: 5 to 200 um in 2 output turns" in out
    assert "counts right with all windows at once" in out
    deep = small_model.recording((4, 5, 6), seed=77, turns=2, height=0.7)
    write_recording(tmp_path / "deep.npz", deep)
    counting = ["count", tmp_path / "deep.npz", "--model", model, "--trust"]
    out, _ = call(capsys, *counting, "--csv", tmp_path / "counts.csv")
    assert re.search(r"wear: .* um \(90 % interval", out)
    (row,) = csv.DictReader((tmp_path / "counts.csv").read_text(encoding="utf-8-sig").splitlines())
    (facts,) = json.loads(run(capsys, *counting, "--json")[1])
    assert facts["wear_um"] == float(row["wear_um"])
    assert 20 < facts["wear_um"] <= 200
    _, err = call(
        capsys, "train", tmp_path / "known", "--wear", "100:200", "--out", tmp_path / "n.joblib", code=2
    )
    assert "must state one depth from 100 to 200 um" in err


def test_too_low_a_rate_is_refused_before_anything_is_simulated(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("cyclofeat.datasets.make_rig_recordings", None)
    _, err = call(capsys, "train", "--out", tmp_path / "m.skops", "--sampling-rate", 1, code=2)
    assert err.startswith("cyclofeat: error: --sampling-rate of 1 Hz is too low at 625 RPM: 0 samples per ")


def test_simulated_training_with_wear_takes_five_turns(capsys, tmp_path, monkeypatch):
    asked = {}

    def stop(*arguments, **options):
        asked.update(options)
        raise ValueError("enough")

    monkeypatch.setattr("cyclofeat.datasets.make_rig_recordings", stop)
    for options, expected in (
        (["--wear", "5:200"], (5, (5.0, 200.0), 1)),
        (["--wear", "5:200", "--windows", "3"], (3, (5.0, 200.0), 1)),
        (["--mixed-wear", "60:200"], (2, (60.0, 200.0), 1 / 3)),
        ([], (2, None, 1)),
    ):
        call(capsys, "train", "--out", tmp_path / "m.joblib", *options, code=2)
        assert (asked["output_turns"], asked["wear_um"], asked["radial_share"]) == expected


def test_a_refused_recording_has_no_count(capsys, folder, tmp_path, model):
    worn = read_recording(folder / "worn.csv")
    clipped = worn.replace(torque=np.minimum(worn.torque, np.quantile(worn.torque, 0.56)))
    write_recording(tmp_path / "clipped.npz", clipped)
    out, _ = call(capsys, "count", tmp_path / "clipped.npz", *model, "--strict", code=3)
    answer = (
        r"clipped.npz: refused: 4[3-6]% of the samples are clipped .*\n  it would be \d worn lobes? \(prob"
    )
    assert re.search(answer, out)
    assert "npz: 4 worn lobes" not in out
    out, _ = call(capsys, "count", tmp_path / "clipped.npz", *model, "--json")
    (facts,) = json.loads(out)
    assert (facts["defect_count"], facts["refused"]) == (None, True)
    assert facts["refused_defect_count"] is not None
    for strict, expected in (([], 3), (["--no-strict"], 0)):
        out, _ = call(capsys, "watch", tmp_path, *model, "--once", "--settle", 0.01, *strict, code=expected)
        assert "clipped.npz: refused: 4" in out


def test_count_for_people_counts_lobes_from_one(capsys, folder, model):
    out, _ = call(capsys, "count", folder / "worn.csv", *model)
    recording = read_recording(folder / "worn.csv")
    assert out.splitlines()[0].startswith(f"{folder / 'worn.csv'}: {recording.defect_count} worn lobes (prob")
    assert "counted from 1" in out
    assert "simulated" in out.splitlines()[-1]
    assert out.count("worn.csv") == 1
    found = re.search(r"from 1 window of 0.98 output turns \((.*) s\), (.*) s unused", out)
    window, unused = map(float, found.groups())
    assert window == pytest.approx(0.98 * 15 / recording.mean_input_speed(), rel=5e-3)
    assert unused == pytest.approx(recording.duration - window, abs=5e-3)


def test_count_writes_a_report(capsys, folder, tmp_path, model, no_pictures):
    (tmp_path / "empty.csv").touch()
    report = tmp_path / "count.html"
    files = [folder / "worn.csv", tmp_path / "empty.csv"]
    out, err = call(capsys, "count", *files, "--report", report, *model, "--json", code=2)
    good, bad = json.loads(out)
    assert good["defect_count"] == 5
    assert "empty" in bad["error"]
    assert f"report: {report}" in err
    assert err.count("error: ") == 1
    page = report.read_text(encoding="utf-8")
    for part in ("SIMULATED", "5 worn lobes", str(folder / "worn.csv"), "not counted", "model.joblib"):
        assert part in page


def dropped(recording):
    torque = recording.torque.copy()
    torque[5_000 : 5_000 + round(0.0035 * torque.size)] = 0
    return {"torque": torque}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            lambda one: {"torque": np.minimum(one.torque, np.quantile(one.torque, 0.997))},
            "0.3 % of the samples are clipped at",
        ),
        (dropped, "0.35 % of the samples are dropouts"),
        (
            lambda one: {"speed_rpm": 60 * one.mean_input_speed() / 1.022},
            "RPM by its angle, +2.2 % off the nominal",
        ),
        (lambda _: {"meta": {"time_jitter": 0.2}}, "the times jitter by up to 0.2 samples"),
        (
            lambda _: {"meta": {"angle_from": "was made continuous"}},
            "the angle of the shaft was made continuous",
        ),
    ],
)
def test_count_warns_of_what_inspect_does(capsys, folder, tmp_path, model, no_pictures, spoil, words):
    recording = read_recording(folder / "worn.csv")
    recording = recording.replace(**spoil(recording))
    file, page = tmp_path / "worn.npz", tmp_path / "count.html"
    write_recording(file, recording)
    inspected, _ = call(capsys, "inspect", file, "--json")
    (warning,) = json.loads(inspected)[0]["warnings"]
    assert words in warning
    _, counted, _ = run(capsys, "count", file, *model, "--json")
    assert json.loads(counted)[0]["warnings"] == [warning]
    _, text, _ = run(capsys, "count", file, *model, "--report", page)
    assert text.count(f"note: {warning}") == 1
    assert page.read_text(encoding="utf-8").count(f"<li>{warning}") == 1
    _, text, _ = run(capsys, "watch", tmp_path, *model, "--once", "--settle", 0.01)
    assert text.count(f"note: {warning}") == 1


def test_count_does_not_repeat_what_it_says_itself(capsys, folder, tmp_path, model):
    recording = read_recording(folder / "worn.csv")
    write_recording(tmp_path / "worn.npz", recording.replace(angle=None, angle_is_absolute=False))
    options = [*model, "--json"]
    _, out, _ = run(capsys, "count", tmp_path / "worn.npz", *options)
    assert len([one for one in json.loads(out)[0]["warnings"] if "relative" in one]) == 1


def test_count_writes_a_table_row_by_row(capsys, folder, tmp_path, model):
    table = tmp_path / "counts.csv"
    options = [*model, "--csv", table]
    (tmp_path / "empty.csv").write_text("")
    _, err = call(capsys, "count", folder / "worn.csv", tmp_path / "empty.csv", *options, code=2)
    assert f"2 recordings: 1 counted, 1 of 1 as stated, 1 with an error\ntable: {table}" in err
    with table.open(encoding="utf-8-sig", newline="") as stream:
        counted, failed = csv.DictReader(stream)
    recording = read_recording(folder / "worn.csv")
    assert counted["file"] == str(folder / "worn.csv")
    assert int(counted["defect_count"]) == recording.defect_count
    assert 0 < float(counted["probability"]) <= 1
    assert len(counted["worn_lobes_from_1"].split()) == recording.defect_count
    assert counted["refused"] == "False"
    assert failed["defect_count"] == ""
    assert "empty" in failed["error"]


@pytest.mark.slow
def test_a_report_of_many_files_needs_the_memory_of_few(capsys, folder, tmp_path, monkeypatch, model):
    alive = []

    def written(model, counted, path, *, failures, settings):
        seen = [weakref.ref(item.recording) for item in counted]
        alive.append([len(seen), sum(recording() is not None for recording in seen)])
        return path

    monkeypatch.setattr("cyclofeat.report.write_count_report", written)
    files = [folder / "worn.csv"] * 3
    call(capsys, "count", *files, "--report", tmp_path / "count.html", *model)
    assert alive == [[3, 0]]


@pytest.mark.slow
def test_a_refused_run_up_is_named_with_the_option_that_leaves_it_out(capsys, tmp_path):
    file = tmp_path / "run.npz"
    call(capsys, "simulate", "--worn-count", 4, "--duration", 3, "--out", file)
    _, out, _ = run(capsys, "inspect", file)
    (seconds,) = re.findall("warning:   run-up at the start: leave it out with --skip ([0-9.]+)", out)
    _, out, _ = run(capsys, "count", file, "--json")
    (refused,) = json.loads(out)
    assert refused["refused"]
    assert any(f"--skip {seconds}" in warning for warning in refused["warnings"])
    _, out, _ = run(capsys, "count", file, "--skip", seconds, "--json")
    (counted,) = json.loads(out)
    assert not any("run-up" in warning for warning in counted["warnings"])
    # The bare gearbox, without brake and noise, is quieter than the training, which is no reason to refuse.
    assert (counted["reason"], counted["defect_count"]) == ("", 4)
    assert not any("--skip" in warning for warning in counted["warnings"])


@pytest.fixture
def labelled_files(tmp_path, monkeypatch):
    """Files of 18 assemblies with 0, 1 or 3 worn lobes, and models of few trees."""
    monkeypatch.setattr("cyclofeat.counting.LobeModel", partial(LobeModel, n_trees=20))
    known = small_model.labelled(per_count=6, turns=2)
    for one in known:
        write_recording(tmp_path / f"{one.assembly}.npz", one)
    return tmp_path, known


@pytest.mark.slow
def test_features_are_ranked_and_drawn(capsys, labelled_files):
    report = labelled_files[0] / "features.html"
    names = ["--features", "TorqueStatistics", "SpectralEntropy"]
    out, err = call(capsys, "features", labelled_files[0], *names, "--json", "--report", report)
    table = json.loads(out)
    assert len(table) == 11
    assert max(abs(row["trend"]) for row in table.values()) > 0.9
    assert "shannon_entropy_bits" in report.read_text(encoding="utf-8")
    _, err = call(capsys, "features", labelled_files[0], "--features", "Entropy", code=2)
    assert "'Entropy'" in err


@pytest.mark.slow
def test_evaluate_cross_validates_what_train_makes(capsys, labelled_files):
    folder, known = labelled_files
    report = folder / "evaluation.html"
    out, _ = call(capsys, "evaluate", folder, "--folds", 2, "--jobs", 1, "--json", "--report", report)
    result = json.loads(out)
    assert list(result) == ["trees", "Shannon entropy (papers)"]
    expected = evaluate(
        LobeModel(n_trees=20, n_splits=0, random_state=0), sorted(known, key=lambda one: one.assembly),
        protocol=Protocol(n_splits=2, random_state=0),
    )  # fmt: skip
    assert result["trees"] == json.loads(json.dumps(expected.to_dict()))
    assert (result["trees"]["n_recordings"], result["trees"]["windows"]["n_windows"]) == (18, 36)
    page = report.read_text(encoding="utf-8")
    for part in ("SIMULATED", "Exactly the right lobes", "2 folds", f"{expected.accuracy:.3f}", "Refusals"):
        assert part in page


@pytest.mark.slow
def test_each_quantity_of_a_folder_is_counted_by_its_own_packaged_model(capsys, tmp_path):
    quantities = ("input_torque", "output_torque")
    for quantity in quantities:
        recording = small_model.recording((2, 3, 4), seed=3).replace(quantity=quantity)
        write_recording(tmp_path / f"{quantity}.npz", recording)
    out, _ = call(capsys, "count", tmp_path, "--json", "--report", tmp_path / "count.html")
    assert [one["model"] for one in json.loads(out)] == ["packaged, input torque", "packaged, output torque"]
    page = (tmp_path / "count.html").read_text(encoding="utf-8")
    assert "packaged, input torque, packaged, output torque" in page
    assert "model for output torque trained on" in page


@pytest.mark.slow
def test_evaluate_tests_a_stored_model(capsys, labelled_files):
    folder, known = labelled_files
    model = small_model.shaft_model()
    save_model(folder / "model.skops", model)
    unlike = small_model.unlike_training().replace(defect_count=1, assembly="strange")
    write_recording(folder / "strange.npz", unlike.replace(torque=np.tile(unlike.torque, 2)))
    files = [folder / f"{one.assembly}.npz" for one in known] + [folder / "strange.npz"]
    out, err = call(capsys, "evaluate", *files, "--model", folder / "model.skops")
    assert "assemblies of the recordings have names of training assemblies, such as 'A0'" in err
    assert "19 recordings, assemblies: 19, tested as stored" in out
    n_right = sum(
        answer.defect_count == r.defect_count for answer, r in zip(model.count_all(known), known, strict=True)
    )
    assert re.search(rf"\b{n_right} of 19 agree with their labels \(0: \d of \d, 1: ", out)
    assert "refuses " in out
    assert " x its lines could as well be those of a disc at another speed than the stated ... RPM" in out
    out, _ = call(capsys, "evaluate", *files, "--model", folder / "model.skops", "--json")
    (scores,) = json.loads(out).values()
    answers = model.count_all([*known, unlike.replace(torque=np.tile(unlike.torque, 2))])
    assert scores["refused"] == np.mean([answer.refused for answer in answers])
    assert sum(scores["reasons"].values()) == sum(answer.refused for answer in answers)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="closes a descriptor of the shell")
def test_a_closed_standard_output_is_an_error():
    command = f"{sys.executable} -m cyclofeat plan --worn-count 3 --noise 0.5 >&-"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True)
    assert done.returncode == 2
    assert "standard output is closed" in done.stderr


@pytest.fixture
def small(tmp_path):
    """A folder of two small recordings with names beyond ASCII; its manifest leaves one out."""
    for name in ("Prüfung", "zweite"):
        (tmp_path / f"{name}.csv").write_text("torque [Nm]\n1\n2\n3\n", encoding="utf-8")
    (tmp_path / "recordings.csv").write_text("file,sampling_rate\nPrüfung.csv,1000\n", encoding="utf-16")
    return tmp_path


@pytest.mark.parametrize("option", [[], ["--json"]])
@pytest.mark.filterwarnings("default")
def test_a_terminal_that_knows_ascii_only_is_no_reason_to_fail(monkeypatch, small, option):
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="ascii"))
    assert main(["inspect", str(small), *option]) == 0
    assert rb"Pr\xfcfung.csv" in written.getvalue() or rb"Pr\u00fcfung.csv" in written.getvalue()


@pytest.mark.filterwarnings("default")
def test_a_warning_is_one_line_without_code(capsys, small):
    code, _, err = run(capsys, "inspect", small)
    assert (code, err) == (0, "cyclofeat: warning: recordings.csv does not name zweite.csv: not read\n")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
@pytest.mark.parametrize("option", [[], ["--json"]])
def test_a_full_disk_below_standard_output_is_an_error(capsys, monkeypatch, small, option):
    with open("/dev/full", "w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stdout", full)
        code = main(["inspect", str(small / "Prüfung.csv"), "--sampling-rate", "1000", *option])
    assert code == 2
    assert re.fullmatch(
        r"cyclofeat: error: standard output cannot be written: .*No space left.*\n", capsys.readouterr().err
    )


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
def test_a_full_disk_below_the_table_is_an_error_that_names_it(capsys, folder, model):
    code, out, err = run(capsys, "count", folder / "worn.csv", *model, "--csv", "/dev/full", "--force")
    assert (code, out) == (2, "")
    assert re.fullmatch(r"cyclofeat: error: .*No space left.*'/dev/full'\n", err)


def test_json_holds_the_answer_of_each_window(capsys, folder, model):
    out, _ = call(capsys, "count", folder / "worn.csv", *model, "--json")
    (answer,) = json.loads(out)
    assert len(answer["windows"]) == answer["n_windows"] >= 1
    for before, after in itertools.pairwise(answer["windows"]):
        assert before["start_s"] < before["stop_s"] <= after["start_s"] + 1e-3
    assert {one["reason"] for one in answer["windows"]} == {""}
    assert all(one["defect_count"] == answer["defect_count"] for one in answer["windows"])


def no_speed(folder):
    recording = read_recording(folder / "worn.csv")
    torque = 22 + np.random.default_rng(0).normal(size=recording.n_samples)
    recording = recording.replace(torque=torque, angle=None, angle_is_absolute=False, speed_rpm=None)
    write_recording(folder / "no_speed.npz", recording)
    return ["count", folder / "no_speed.npz"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda _: ["count", "absent.csv"], "no such file: absent.csv"),
        (no_speed, "nor a speed, and its output torque .* RPM: give --speed"),
    ],
)
def test_bad_recordings(capsys, folder, make, message, model):
    out, err = call(capsys, *make(folder), *model, "--json", code=2)
    assert err.startswith("cyclofeat: error: ")
    assert err.count("\n") == 1, "one clear line"
    assert re.search(message, err), err
    assert "error" in json.loads(out)[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            "train --out {folder}/m.skops --counter rows --lobes mixed",
            "--counter rows takes --lobes consecutive only, got mixed",
        ),
        (
            "train --out {folder}/m.skops --samples-per-turn 256",
            "--samples-per-turn takes at most 128 without --counter rows, got 256",
        ),
        ("train --out {folder}/m.skops --coarser absent.skops", "absent.skops does not exist"),
        ("count x.csv --model absent.joblib --trust", "absent.joblib does not exist"),
        ("count x.csv --model {folder}/model.joblib", "--trust"),
        ("count x.csv --model {folder}", "is a folder, no model file: those end in"),
        ("count x.csv --model {folder}/worn.csv --trust", "is no model file: those end in .skops or .joblib"),
        (
            "simulate --worn-lobes three --out x.npz",
            "--worn-lobes: must list different lobes counted from 1, like 1,5, got 'three'",
        ),
        ("simulate --worn-lobes 0,3 --out x.npz", "counted from 1, like 1,5, got '0,3'"),
        ("simulate --worn-lobes 1,1 --out x.npz", "different lobes counted from 1, like 1,5"),
        ("simulate --worn-count 16 --out x.npz", "lobe 15"),
        ("simulate --worn-count 1 --depth 2 --out x.npz", "depth must lie between 0"),
        ("simulate --worn-count 1 --wear-um 300 --out x.npz", "between 0 and 200 um"),
        ("simulate --duration -1 --out x.npz", "--duration: must be a positive"),
        ("simulate --duration 1e7 --out x.npz", "duration must take at most 1e.08 steps"),
        ("simulate --rig r3 --out x.npz", "--rig must be .*, published or .* no such file: r3"),
        ("train --rig r3 --out x.joblib", "--rig must be .*, published or .* no such file: r3"),
        ("simulate --rig {folder}/worn.csv --out x.npz", "worn.csv: is not valid JSON"),
        ("train --out absent/model.joblib", "folder absent for --out does not exist"),
        ("train absent --out {folder}/x.joblib", "no such file: absent"),
        ("count x.csv --model m --report {folder}", "--report must name a file"),
        ("evaluate x.csv --report {folder}", "--report must name a file"),
        ("evaluate", "required: FILE; see cyclofeat evaluate --help"),
        ("animate --out {folder}/no/a.html", "make it first"),
        ("animate --out {folder}/a.html --duration 21", "--duration must be at most 20 s"),
        ("evaluate {folder}/worn.csv", "fewer than --folds 5"),
        ("train --out m.skops --windows 0", "^cyclofeat: error: argument --windows: must be a wh"),
        ("train --out m.skops --max-count 16", "^cyclofeat: error: --max-count must be at most 1"),
        ("train --out m.skops --jobs 0", "^cyclofeat: error: --jobs must be .* of workers, or -"),
        ("train --out m.skops --wear 5:300", "^cyclofeat: error: argument --wear: must be LOW:HI"),
        ("plan --worn-count 2 --noise 1 --depth 3", "^cyclofeat: error: --depth must "),
    ],
)
def test_bad_arguments(capsys, folder, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    _, err = call(capsys, *arguments.format(folder=folder).split(), code=2)
    *notes, error = err.splitlines()
    assert all("free core" in note for note in notes), err
    assert re.search(message, error), err
    assert list(tmp_path.iterdir()) == []


# -- inspect, and what is said of files


def test_inspect_says_what_would_spoil_a_count(capsys, folder, tmp_path):
    recording = read_recording(folder / "worn.csv")
    clipped = np.minimum(recording.torque, np.quantile(recording.torque, 0.9))
    write_recording(tmp_path / "clipped.npz", recording.replace(torque=clipped))
    code, out, err = run(capsys, "inspect", folder / "worn.csv", tmp_path / "clipped.npz")
    assert (code, err) == (0, "")
    good, bad = out.split(str(tmp_path / "clipped.npz"))
    assert good.startswith(f"{folder / 'worn.csv'}: ")
    assert (good.count("worn.csv"), "warning" in good) == (1, False)
    for words in ("simulated", "RPM by its angle", "output turns", "clipped:   0 %"):
        assert words in good
    assert "warning:   10 % of the samples are clipped at" in bad


def test_inspect_prints_json_and_goes_on_after_a_bad_file(capsys, folder, tmp_path):
    (tmp_path / "rig.csv").write_text("Zeit [s];Drehmoment;Winkel\n0;1;0\n1;2;9\n2;4;18\n", encoding="utf-8")
    page = tmp_path / "page.html"
    files = tmp_path / "rig.csv", folder / "worn.csv"
    out, err = call(capsys, "inspect", *files, "--json", "--report", page, code=2)
    bad, good = json.loads(out)
    assert [result["file"] for result in (bad, good)] == [str(tmp_path / "rig.csv"), str(folder / "worn.csv")]
    assert "--angle-unit 'rad', 'deg' or 'rev', or --no-angle" in bad["error"]
    assert (err.count("\n"), f"report: {page}" in err) == (2, True)
    assert good["output_turns"] >= 1
    text = page.read_text(encoding="utf-8")
    assert "or --no-angle" in text
    assert text.count("application/json") == 1
    out, _ = call(capsys, "inspect", tmp_path / "rig.csv", "--angle-unit", "deg", "--speed", 1.5, "--json")
    (found,) = json.loads(out)
    assert found["speed_measured_rpm"] == pytest.approx(1.5)
    assert found["sampling_rate"] == 1


def test_no_error_in_one_file_is_lost_or_ends_the_others(capsys, folder, model, monkeypatch):
    read = Entry.read

    def read_or_fail(entry, **arguments):
        return {}["rows"] if entry.path.suffix == ".npz" else read(entry, **arguments)

    monkeypatch.setattr(Entry, "read", read_or_fail)
    files = [*sorted(folder.glob("R*.npz"))[:2], folder / "worn.csv"]
    code, out, _ = run(capsys, "count", *files, *model, "--json")
    *bad, good = json.loads(out)
    assert (code, "defect_count" in good, len(bad)) == (2, True, 2)
    assert re.fullmatch(r"KeyError: 'rows' \(test_cli\.py, line \d+\)", bad[0]["error"])
    code, _, err = run(capsys, "train", *files, "--out", folder / "m.skops")
    assert (code, err.count(".npz: KeyError"), err.count("\n")) == (2, 2, 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "give --sampling-rate (Hz), or --time-channel for a column of times"),
        (["--channel", "x"], "--channel 'x' does not exist"),
        (["--sampling-rate", 0], "--sampling-rate: must be a positive"),
        (["--sampling-rate", 5, "--no-angle", "--speed", -1], "--speed: must be a positive"),
        (["--sampling-rate", 5], "--angle-unit 'rad', 'deg' or 'rev', or --no-angle"),
        (["--sampling-rate", 5, "--angle-unit", "rad"], "--no-angle leaves the angle out"),
        (["--no-angle", "--angle-unit", "rad"], "--angle-unit has no effect with --no-angle"),
    ],
)
@pytest.mark.parametrize("command", ["inspect", "count", "evaluate", "train"])
def test_errors_of_reading_name_options_not_arguments(capsys, folder, tmp_path, command, options, message):
    (tmp_path / "rig.csv").write_text("torque,angle\n1,2\n2,2\n", encoding="utf-8")
    more = {
        "count": ["--model", folder / "model.joblib", "--trust"],
        "train": ["--out", tmp_path / "m.skops"],
    }
    _, err = call(capsys, command, tmp_path / "rig.csv", *options, *more.get(command, []), code=2)
    assert message in err
    assert re.search(r"[a-z]+_[a-z]+ ?=", err) is None, err


def test_count_names_each_speed_that_the_torque_allows(capsys, folder, tmp_path, monkeypatch, model):
    recording = read_recording(folder / "worn.csv")
    unknown = recording.replace(angle=None, angle_is_absolute=False, speed_rpm=None)
    write_recording(tmp_path / "unknown.npz", unknown)
    found = [SimpleNamespace(speed_hz=rpm / 60) for rpm in (250, 500)]
    monkeypatch.setattr("cyclofeat.counting.model.turning.search_speed", lambda *_: found)
    _, err = call(capsys, "count", tmp_path / "unknown.npz", *model, code=2)
    assert err.count("\n") == 1
    assert "its output torque allows 250 or 500 RPM: give --speed (nominal speed of the input in RPM)" in err
    call(capsys, "count", tmp_path / "unknown.npz", *model, "--speed", 500)


def test_a_manifest_describes_a_folder_to_every_command(capsys, folder, tmp_path, surrogates, model):
    lines = ["file,sampling_rate,angle_channel,angle_unit,defect_count,assembly,speed"]
    for recording in surrogates[:3]:
        name = f"{recording.assembly}.csv"
        np.savetxt(
            tmp_path / name, np.column_stack([recording.torque, recording.angle]), delimiter=",",
            header="torque [Nm],phi", comments="",
        )  # fmt: skip
        lines.append(f"{name},25600,phi,rad,{recording.defect_count},{recording.assembly},500")
    (tmp_path / "recordings.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    out, err = call(capsys, "count", tmp_path, *model, "--json")
    assert len(json.loads(out)) == 3
    (tmp_path / "recordings.csv").write_text(
        "\n".join([*lines, "x.csv,1,,,1,A,500"]) + "\n", encoding="utf-8"
    )
    _, err = call(capsys, "inspect", tmp_path, code=2)
    assert "recordings.csv: line 5: no such file: x.csv" in err


def test_an_error_states_the_path_even_if_its_words_hold_the_letters_of_the_folder(
    capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for name in ("m", "other"):  # "m" is also a letter of the message
        (tmp_path / name).mkdir()
        (tmp_path / name / "recordings.csv").write_text("file,sped\nx.csv,1\n", encoding="utf-8")
    for command in (["inspect", "m"], ["evaluate", "m", "other"]):
        assert run(capsys, *command)[2].startswith(
            "cyclofeat: error: m: recordings.csv: line 1: unknown column 'sped'"
        )


@pytest.mark.parametrize(
    ("words", "hint"), [("cuont a.npz", "count"), ("count a --quantity output-torque", "output_torque")]
)
def test_a_word_that_is_none_of_those_known_is_answered_with_the_nearest(words, hint, capsys):
    assert main(words.split()) == 2
    assert f" (did you mean {hint}?); see cyclofeat" in capsys.readouterr().err


@pytest.mark.parametrize("command", COMMANDS)
def test_help_ends_with_examples_that_are_understood(command, capsys):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    _, _, examples = capsys.readouterr().out.partition("\nexamples:\n")
    calls = examples.strip().splitlines()
    assert 1 <= len(calls) <= 2
    for line in calls:
        program, *words = shlex.split(line)
        assert program == "cyclofeat"
        assert make_parser().parse_args(words).command == command


def test_long_work_says_beforehand_about_how_long(capsys, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    Arguments().note_duration("simulating", 19.0)
    assert capsys.readouterr().err == ""
    Arguments().note_duration("simulating", 300.0)
    Arguments(n_jobs=1).note_duration("training", 60.0)
    expected = "simulating takes about 2 min on 2 free cores\ntraining takes about 60 s on 1 free core\n"
    assert capsys.readouterr().err == expected


def test_a_speed_as_stated_deviates_by_no_negative_zero():
    facts = {
        "speed_rpm": 500.0, "speed_measured_rpm": 499.999, "speed_from": "angle", "speed_deviation": -2e-6,
    }  # fmt: skip
    assert "+0.00 % against the nominal 500 RPM" in _speed_text(facts)


@pytest.mark.parametrize(
    ("command", "error"),
    [
        (
            "plan --json --worn-count 2 --noise x",
            "argument --noise: must be a positive, finite number, got 'x'",
        ),
        ("count --jsonl a.npz --model m.skops --loud", "unrecognized arguments: --loud"),
        ("count --jsonl a.npz --modle=m", "unrecognized arguments: --modle=m (did you mean --model?)"),
        (
            "plan --json --worn-count 2 --rig r1 --noise 1 --wheer",
            "unrecognized arguments: --wheer (did you mean --wear?)",
        ),
    ],
)
def test_an_error_of_usage_is_json_too_where_json_is_asked_for(command, error, capsys):
    out, err = call(capsys, *command.split(), code=2)
    error += f"; see cyclofeat {command.split()[0]} --help"
    assert (json.loads(out), err) == ({"error": error}, f"cyclofeat: error: {error}\n")


@pytest.mark.slow
def test_the_demonstration_goes_from_recordings_to_pages(no_pictures, tmp_path):
    arguments = argparse.Namespace(out=tmp_path, n_jobs=1, force=False)
    results = list(demo.run(arguments, assemblies=2, recordings=8))
    text = "\n".join(printed.text for printed in results)
    assert [line.split()[2] for line in text.splitlines() if line.startswith("$ cyclofeat ")] == [
        "train", "simulate", "count", "evaluate",
    ]  # fmt: skip
    assert "trained on: 16 simulated assemblies of rig R1" in text
    assert text.count("(probability ") == 8
    assert "8 recordings, assemblies: 8, tested as stored" in text
    assert json.loads(json.dumps(results[0].json))["command"].startswith("cyclofeat train --rig r1 ")
    assert len(list((tmp_path / "recordings").glob("*.npz"))) == 8
    # safe to load: no word of trust
    assert load_model(tmp_path / "model.skops").card_["classes"] == list(range(8))
    for page in (tmp_path / "count.html", tmp_path / "evaluation.html"):
        assert str(page) in results[-1].text
        assert "SIMULATED" in page.read_text(encoding="utf-8")


def test_a_model_that_cannot_be_written_is_told_before_anything_is_simulated(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "skops.io", None)
    monkeypatch.setattr("cyclofeat.datasets.make_rig_recordings", None)
    assert "pip install skops" in call(capsys, "demo", "--out", tmp_path / "demo", code=2)[1]
