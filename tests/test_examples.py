"""The gallery runs without a warning, draws, and shows every transformer."""

from __future__ import annotations

import ast
import importlib
import re
import runpy
import warnings
from pathlib import Path

import numpy as np
import pytest

from cyclofeat import features, scans

matplotlib = pytest.importorskip("matplotlib")

ROOT = Path(__file__).parents[1]
# "make papers" runs those of examples/papers, likewise without a warning.
EXAMPLES = sorted(p for p in (ROOT / "examples").rglob("plot_*.py") if p.parent.name != "papers")
FAST = {"plot_high_pass.py"}  # two recordings; the others simulate up to 48, once for all of them
SHOWN = [*features.__all__, "find_monotone_bands", "scan_wavelets"]


@pytest.fixture
def pyplot(monkeypatch):
    for folder in ("features", "gap"):
        monkeypatch.syspath_prepend(ROOT / "examples" / folder)  # as "python plot_....py" would
    matplotlib.use("Agg")
    plt = importlib.import_module("matplotlib.pyplot")
    plt.close("all")
    yield plt
    plt.close("all")


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=() if path.name in FAST else pytest.mark.slow)
        for path in EXAMPLES
    ],
)
def test_example_draws_without_a_warning(path, pyplot):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        runpy.run_path(str(path), run_name="__main__")
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


@pytest.mark.parametrize("name", SHOWN)
def test_docstring_names_an_example_that_shows_it(name):
    part = getattr(features, name, None) or getattr(scans, name)
    named = re.findall(r"``(examples/\S+\.py)``", part.__doc__)
    assert len(named) == 1
    assert name in imported_by(ROOT / named[0])


@pytest.mark.parametrize("name", SHOWN)
def test_api_page_lists(name):
    assert re.search(rf"^   {name}$", (ROOT / "docs" / "api.rst").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_says_that_its_torque_is_simulated(path):
    assert "**surrogate**" in ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))).lower()
