"""The demonstration's path, on recordings that cost nothing to make."""

import argparse
import json
import sys
from functools import partial

import numpy as np
import pytest
from command import call
from small_model import recording

from cyclofeat.cli import demo
from cyclofeat.counting import LobeModel
from cyclofeat.models import load_model


@pytest.fixture
def made(monkeypatch):
    """Numbers of assemblies asked for; recordings that are no simulation take their place."""
    asked = []

    def rig_recordings(per_count, counts, *, random_state, **_):
        asked.append(per_count)
        random = np.random.default_rng(random_state)
        seeds = iter(range(1000 * random_state, 1000 * random_state + per_count * len(counts)))
        return [
            recording(tuple(int(lobe) for lobe in (random.integers(15) + np.arange(count)) % 15), next(seeds))
            for _ in range(per_count)
            for count in counts
        ]

    monkeypatch.setattr("cyclofeat.datasets.make_rig_recordings", rig_recordings)
    # A few trees do.
    monkeypatch.setattr("cyclofeat.counting.LobeModel", partial(LobeModel, n_trees=20))
    drawn = {"image": "data:,", "alt": "", "width": 1, "height": 1}
    monkeypatch.setattr("cyclofeat.report._figures.draw_picture", lambda *_, **__: drawn)
    return asked


@pytest.mark.slow
def test_the_demonstration_goes_from_recordings_to_pages(made, tmp_path):
    arguments = argparse.Namespace(out=tmp_path, n_jobs=1)
    printed, pages = demo.run(arguments, training_assemblies=5, file_assemblies=1)
    assert made == [5, 1]
    text = printed.text
    assert "counts right: 1.000" in text
    assert "of 8 recordings" in text
    assert "Cross-validated over 40 assemblies" in text
    assert json.loads(json.dumps(printed.json))["n_recordings"] == 8
    assert len(list((tmp_path / "recordings").glob("*.npz"))) == 8
    # safe to load: no word of trust
    assert load_model(tmp_path / "model.skops").card_["classes"] == list(range(8))
    for page in (tmp_path / "count.html", tmp_path / "evaluation.html"):
        assert str(page) in pages.text
        assert "SIMULATED" in page.read_text(encoding="utf-8")


def test_a_model_that_cannot_be_written_is_told_before_anything_is_simulated(
    capsys, made, monkeypatch, tmp_path
):
    monkeypatch.setitem(sys.modules, "skops.io", None)
    assert "pip install skops" in call(capsys, "demo", "--out", tmp_path / "demo", code=2)[1]
    assert made == []
