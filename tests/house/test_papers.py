"""The page on the papers is complete: every statement, figure and table, with what the benchmark printed."""

from __future__ import annotations

import ast
import csv
import re
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")

from benchmarks import papers

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "papers.rst").read_text(encoding="utf-8")
SCRIPTS = {path.stem: path for path in (ROOT / "examples" / "papers").glob("plot_*.py")}
STATED = [*(f"B{n}" for n in range(1, 11)), *(f"A{n}" for n in range(1, 13))]
FIGURES = {("B", "fig", n) for n in range(1, 19)}
FIGURES |= {("A", "fig", n) for n in range(5, 21)} | {("A", "table", n) for n in range(4, 8)}
AGREES = {said: truth for truth, said in papers.AGREES.items()}


def figures_named(text: str, paper: str) -> set[tuple[str, str, int]]:
    """Figures and tables in text like "figs. 3, 4 and 6 to 8, table 2"."""
    found = set()
    for kind, numbers in re.findall(r"\b(fig|table)s?\.? (\d+(?:(?:, | and | to )\d+)*)", text):
        for part in re.split(", | and ", numbers):
            first, _, last = part.partition(" to ")
            found |= {(paper, kind, n) for n in range(int(first), int(last or first) + 1)}
    return found


def script_title(name: str) -> str:
    docstring = ast.get_docstring(ast.parse(SCRIPTS[name].read_text(encoding="utf-8")))
    return docstring.splitlines()[0]


def rows() -> dict[str, list[str]]:
    with (ROOT / "docs" / "papers_statements.csv").open(encoding="utf-8", newline="") as file:
        return {number: rest for number, *rest in csv.reader(file)}


def parts(cell: str) -> list[tuple[str, bool | None]]:
    """What the documentation's table says of each part, and whether it agrees."""
    found = [re.fullmatch(r"\* (.*) \(\*\*(.*)\*\*\)", line) for line in cell.splitlines()]
    return [(match[1], AGREES[match[2]]) for match in found]


def test_page_lists_every_statement_once():
    assert list(rows()) == STATED
    assert list(papers.STATEMENTS) == STATED
    assert ":file: papers_statements.csv" in PAGE


@pytest.mark.parametrize("number", STATED)
def test_row_names_source_script_and_the_verdict_that_its_parts_make(number):
    source, script, _ = papers.STATEMENTS[number]
    link, verdict, cell = rows()[number]
    assert script in SCRIPTS
    assert link == f":ref:`{source} <sphx_glr_gallery_papers_{script}.py>`"
    assert verdict == papers.verdict([("", "", agrees) for _, agrees in parts(cell)])


@pytest.mark.slow
@pytest.mark.parametrize("number", ["B1", "B4", "B5"])
def test_table_holds_what_the_benchmark_computes(number):
    """Those that take a second; the others are the same code."""
    _, _, compute = papers.STATEMENTS[number]
    computed = [(f"*{claim}*: {here}", bool(agrees)) for claim, here, agrees in compute()]
    assert computed == parts(rows()[number][2])


def test_page_has_every_figure_in_the_script_whose_title_names_it():
    listed = {}
    for text, script in re.findall(r"\* - ([AB] .*)\n +- :ref:`sphx_glr_gallery_papers_(\w+)\.py`", PAGE):
        listed[script] = figures_named(text, text[0])
    assert set().union(*listed.values()) == FIGURES
    for script, figures in listed.items():
        title = script_title(script)
        assert title.startswith("Paper ")
        assert figures_named(title, title[6]) == figures, script


def test_page_and_folder_name_the_same_scripts():
    assert set(re.findall(r"sphx_glr_gallery_papers_(\w+)\.py", PAGE)) == set(SCRIPTS)
