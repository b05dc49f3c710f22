"""The gallery shows every transformer; its quickest example runs without a warning and draws.

"make docs" runs all of them, with the same checks (docs/_gallery.py).
"""

from __future__ import annotations

import ast
import importlib
import runpy
import warnings
from pathlib import Path

import numpy as np
import pytest

from cyclofeat import features

matplotlib = pytest.importorskip("matplotlib")

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted(p for p in (ROOT / "examples").rglob("plot_*.py") if p.parent.name != "papers")


@pytest.fixture
def pyplot(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "examples" / "features")  # as "python plot_....py" would
    return importlib.import_module("matplotlib.pyplot")


@pytest.mark.slow
def test_the_quickest_example_draws_without_a_warning(pyplot):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        runpy.run_path(str(ROOT / "examples" / "features" / "plot_high_pass.py"), run_name="__main__")
    figures = [pyplot.figure(number) for number in pyplot.get_fignums()]
    assert figures
    for figure in figures:
        figure.canvas.draw()
        axes = [ax for ax in figure.axes if ax.has_data()]
        assert axes
        for ax in axes:
            # An empty line or one of NaN alone would leave its axes as they were: from 0 to 1.
            assert np.isfinite(ax.dataLim.get_points()).all()
            assert ax.dataLim.width > 0 or ax.dataLim.height > 0


def imported_by(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {alias.name for node in found for alias in node.names}


@pytest.mark.parametrize("name", features.__all__)
def test_an_example_shows_it(name):
    # Its page in the documentation ends with the examples that import it.
    assert any(name in imported_by(path) for path in EXAMPLES)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_says_that_its_torque_is_simulated(path):
    assert "**surrogate**" in ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))).lower()


def test_measured_motions_are_fetched_once_and_checked(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "examples" / "gap")
    motions = importlib.import_module("_measured_motions")
    (tmp_path / "far.csv").write_text("time,position\n0,1\n0.5,2\n")
    address = (tmp_path / "far.csv").as_uri()

    def parse(text):
        rows = np.genfromtxt(text.decode().splitlines(), delimiter=",", names=True)
        return {name: rows[name].astype(np.float32) for name in rows.dtype.names}

    def fetch(checksum):
        keys = ("time", "position")
        return motions.fetch_recordings("near.npz", tmp_path, {"r1": address}, keys, parse, checksum)

    with pytest.raises(
        ValueError, match=r"near.npz must have the checksum 0, got \w{64}: remove it"
    ) as wrong:
        fetch("0")
    assert not (tmp_path / "near.npz").exists()
    checksum = str(wrong.value).partition(", got ")[2].partition(":")[0]
    (recording,) = fetch(checksum)
    assert recording["position"].tolist() == [1, 2]
    (tmp_path / "far.csv").unlink()
    assert fetch(checksum)[0]["time"].tolist() == [0, 0.5]
