"""The demonstration's path, from nothing to pages."""

import argparse
import json
import sys

import pytest
from command import call

from cyclofeat.cli import demo
from cyclofeat.models import load_model


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
