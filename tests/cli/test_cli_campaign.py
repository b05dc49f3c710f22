"""``cyclofeat campaign``: from an example design to a folder of torque, and every mistake on the way."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from command import call, run, start

from cyclofeat.cli.campaign import example
from cyclofeat.datasets import read_folder, rig_preset
from cyclofeat.simulators import Campaign, CycloidalGearbox, GearboxParameter, Rig, load_campaign

QUICK = Rig.r0().replace(name="quick", gearbox=CycloidalGearbox.steel(ramp_time=0.02))
SMALL = Campaign(name="small", rig=QUICK, defect_counts=(0, 3), repeats=4, duration=0.02, runs_per_shard=3)


@pytest.fixture
def design(tmp_path):
    SMALL.to_json(tmp_path / "design.json")
    return tmp_path / "design.json"


def test_from_a_design_to_windows(capsys, design, tmp_path):
    out = tmp_path / "out"
    campaign = SMALL.replace(rig=QUICK.with_effects(GearboxParameter("load_torque", (15, 25))))
    campaign.to_json(design)
    text, err = call(capsys, "campaign", design, "--out", out, "--jobs", 1)
    assert text.startswith(f"{out}: 8 runs of 512 samples (8 ok), ")
    data = load_campaign(out, verify=True)
    assert data.campaign == campaign
    assert np.isfinite(np.asarray(data.X)).all()
    text, _ = call(capsys, "campaign", "--verify", out, "--json")
    size = sum(path.stat().st_size for path in out.iterdir() if path.name != "manifest.json")
    assert json.loads(text) == {
        "folder": str(out), "n_runs": 8, "n_samples": 512, "sampling_rate": 25600.0, "n_shards": 3,
        "bytes": size, "status": {"ok": 8},
    }  # fmt: skip
    recordings = read_folder(out, quantity="output_torque", sampling_rate=25_600)
    np.testing.assert_array_equal([recording.torque for recording in recordings], data.X)
    assert [recording.assembly for recording in recordings] == data.groups.tolist()
    loads = data.parameters["effects.gearbox_parameter_load_torque.value"]
    assert [recording.load_nm for recording in recordings] == loads.tolist()
    worn = [tuple(sorted(lobes - 1)) for lobes in data.parameters["worn_lobes_from_1"]]
    assert [recording.worn_lobes for recording in recordings] == worn
    code, text, err = run(capsys, "inspect", out, "--speed", 500)
    assert (code, text.count("500 RPM"), text.count("simulated"), err) == (0, 16, 8, "")
    assert "--speed contradicts the campaign" in run(capsys, "inspect", out, "--speed", 400)[2]


def test_the_kernel_of_the_design_or_of_the_call(capsys, design, tmp_path):
    for given, made_by in ([], "batch"), (["--kernel", "exact"], "exact"):
        out = tmp_path / made_by
        call(capsys, "campaign", design, "--out", out, "--jobs", 1, *given)
        assert (load_campaign(out).parameters["kernel"] == made_by).all()
    _, err = call(capsys, "campaign", design, "--out", out, "--jobs", 1, code=2)
    assert "another design: kernel is 'exact' there and 'auto' here" in err


def test_the_example_is_a_design_to_edit(capsys, tmp_path):
    file = tmp_path / "example.json"
    text, _ = call(capsys, "campaign", "--example", file)
    assert f"cyclofeat campaign {file} --out FOLDER" in text
    assert Campaign.from_json(file) == example()
    few = {"repeats": 1, "defect_counts": [0, 1], "duration": 0.01}
    edited = json.loads(file.read_text(encoding="utf-8")) | few
    file.write_text(json.dumps(edited), encoding="utf-8")
    text, _ = call(capsys, "campaign", file, "--out", tmp_path / "out", "--jobs", 1, "--json")
    assert json.loads(text)["status"] == {"ok": 2}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "campaign needs a design and --out FOLDER; 'cyclofeat campaign --example design.json'"),
        ("d.json", "campaign needs a design and --out FOLDER"),
        ("none.json --out o", "none.json: no such file"),
        ("--verify nowhere", "nowhere: holds no campaign"),
    ],
)
def test_mistakes_in_the_call(capsys, monkeypatch, tmp_path, arguments, message):
    monkeypatch.chdir(tmp_path)
    _, err = call(capsys, "campaign", *arguments.split(), code=2)
    assert message in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("name", ["published", "R1", "r2", "R9"])
def test_a_design_names_the_rigs_that_the_other_commands_name(capsys, tmp_path, name):
    file, out = tmp_path / "design.json", tmp_path / "out"
    design = {"rig": name, "defect_counts": [0], "repeats": 1, "duration": 0.01}
    file.write_text(json.dumps(design), encoding="utf-8")
    if name == "R9":
        _, err = call(capsys, "campaign", file, "--out", out, code=2)
        assert "design.json: rig: name must be one of ('R0', 'R1', 'R2', 'published'), got 'R9'" in err
        return
    call(capsys, "campaign", file, "--out", out, "--jobs", 1)
    assert load_campaign(out).campaign.rig == rig_preset(name)
    call(capsys, "campaign", file, "--out", out, "--jobs", 1)  # it knows itself again


def test_mistakes_in_the_work(capsys, design, tmp_path):
    out = tmp_path / "out"
    code, _, err = run(capsys, "campaign", design, "--out", out, "--jobs", 0)
    assert (code, "--jobs must be a whole number of workers" in err) == (2, True)
    call(capsys, "campaign", design, "--out", out, "--jobs", 1)
    with (out / "shard-00001.npy").open("r+b") as file:
        file.seek(500)
        file.write(b"\x01\x02")
    _, err = call(capsys, "campaign", "--verify", out, code=2)
    assert "shard-00001.npy: was changed" in err


def test_failed_runs_are_told_and_none_that_ended_is_an_error(capsys, tmp_path):
    stiff = Rig.r0().replace(gearbox=CycloidalGearbox.steel(ramp_time=0.0, stiffness_scale=1000.0))
    SMALL.replace(rig=stiff).to_json(tmp_path / "stiff.json")
    code, text, err = run(capsys, "campaign", tmp_path / "stiff.json", "--out", tmp_path / "out", "--jobs", 1)
    assert (code, err) == (2, "")
    assert "8 runs of 512 samples (8 diverged)" in text
    assert "first that failed, run 0 (counted from 0): simulation diverged at t = " in text


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="Windows sends Ctrl-C to all processes of a console")
def test_interrupted_from_the_keyboard_goes_on(design, tmp_path):
    SMALL.replace(repeats=200).to_json(design)
    out = tmp_path / "out"
    command = [sys.executable, "-m", "cyclofeat", "campaign", design, "--out", out, "--jobs", "1"]
    child = start(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    while not (out / "shard-00002.sha256").exists():
        assert child.poll() is None
        time.sleep(0.01)
    child.send_signal(signal.SIGINT)
    _, err = child.communicate(timeout=60)
    assert child.returncode == 130
    assert err.splitlines()[-1] == "cyclofeat: interrupted"
    assert not (out / "manifest.json").exists()
    assert not list(out.glob(".*"))
