"""The examples of counting run as they stand, are short, and say that their torque is simulated."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[2] / "examples" / "counting").glob("*.py"))
SAID = {
    "train": "locates lobes: True",
    "evaluate": "sets of counts: ",
    "export": "as before: True",
    "count": "the same backwards: ",
}


def test_every_step_has_its_example():
    assert {path.stem for path in EXAMPLES} == SAID.keys()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_is_short_and_says_that_its_torque_is_simulated(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 30
    assert "**surrogate**" in ast.get_docstring(ast.parse(text)).lower()


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path, capsys):
    if path.stem == "export":
        pytest.importorskip("skops")
    runpy.run_path(str(path), run_name="__main__")
    assert SAID[path.stem] in capsys.readouterr().out
