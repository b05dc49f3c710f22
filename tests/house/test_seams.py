"""Tests go through public names: what they may look at inside a room, and how little of it there is."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
MOST = 0.05  # share of the imported names that may be private


def is_private(name: str) -> bool:
    """Whether a dotted name lies in a private module or is private itself; the base is open to all rooms."""
    return any(part.startswith("_") and part not in ("_base", "__version__") for part in name.split("."))


def imported(text: str) -> Iterator[str]:
    """Full names that a module imports from cyclofeat."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "cyclofeat":
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] == "cyclofeat")


@pytest.mark.slow
def test_few_imports_of_tests_are_private() -> None:
    names = [
        (str(path.relative_to(TESTS)), name)
        for path in sorted(TESTS.rglob("*.py"))
        for name in imported(path.read_text(encoding="utf-8"))
    ]
    private = [(path, name) for path, name in names if is_private(name)]
    assert len(private) <= MOST * len(names), private


def test_no_private_constant_is_patched() -> None:
    """What a test has to change is a parameter, or a setting of a library."""
    name = r"_[A-Z][A-Z_]*"
    patched = re.compile(rf"""setattr\(\s*([\w.]+,\s*["']{name}["']|["']cyclofeat\.\S*\.{name}["'])""")
    found = [
        (str(path.relative_to(TESTS)), match.group(0))
        for path in sorted(TESTS.rglob("*.py"))
        if path != Path(__file__)
        for match in patched.finditer(path.read_text(encoding="utf-8"))
    ]
    assert not found
