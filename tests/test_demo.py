"""The demonstration's path, on recordings that cost nothing to make."""

import sys
from functools import partial

import numpy as np
import pytest
from small_model import recording

from cyclofeat import _demo
from cyclofeat.cli import main
from cyclofeat.counting import LobeModel, make_lobe_counter
from cyclofeat.persistence import load_model


@pytest.fixture
def made(monkeypatch):
    """What was asked for in place of simulated assemblies."""
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

    monkeypatch.setattr(_demo, "make_rig_recordings", rig_recordings)
    monkeypatch.setattr(_demo, "TRAINING_ASSEMBLIES", 5)
    monkeypatch.setattr(_demo, "FILE_ASSEMBLIES", 1)
    # A few trees do.
    monkeypatch.setattr(_demo, "make_lobe_counter", partial(make_lobe_counter, n_trees=20))
    monkeypatch.setattr(_demo.LobeModel, "train", partial(LobeModel.train, n_trees=20))
    drawn = {"light": "data:,", "dark": "data:,", "alt": "", "width": 1, "height": 1}
    monkeypatch.setattr("cyclofeat.report._figures.picture", lambda *_: drawn)
    return asked


def test_the_demonstration_goes_from_recordings_to_a_page(capsys, made, tmp_path):
    assert main(["demo", "--out", str(tmp_path / "demo"), "--jobs", "1"]) == 0
    assert made == [5, 1]
    out = capsys.readouterr().out
    assert "of 8 recordings" in out
    assert len(list((tmp_path / "demo" / "recordings").glob("*.npz"))) == 8
    # safe to load: no word of trust
    assert load_model(tmp_path / "demo" / "model.skops").card["classes"] == list(range(8))
    assert "SURROGATE" in (tmp_path / "demo" / "report.html").read_text(encoding="utf-8")


def test_a_model_that_cannot_be_written_is_told_before_anything_is_simulated(
    capsys, made, monkeypatch, tmp_path
):
    monkeypatch.setitem(sys.modules, "skops", None)
    assert main(["demo", "--out", str(tmp_path / "demo")]) == 2
    assert "pip install 'cyclofeat[export]'" in capsys.readouterr().err
    assert made == []
