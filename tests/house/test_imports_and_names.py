"""What code may import, what tests may look at inside a room, and one vocabulary for public names."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import re
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from rooms import MODULES, ROOMS, ROOT, modules_of

TESTS = ROOT / "tests"
MOST = 0.05  # share of the names imported by tests that may be private
# What to write instead.
FORBIDDEN = {"seed": "random_state", "duration_s": "duration", "fs": "sampling_rate"}
# Words that do not name the thing.
VAGUE = {"found", "own", "told", "kept", "there", "left", "alike"}


# -- no module imports itself through others, with lazy and type-only imports counted


def imports_of(name: str, path: Path, modules: dict[str, Path]) -> set[str]:
    """Modules that a file imports anywhere in its code."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    imported: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            if node.level:
                base = importlib.util.resolve_name(base, package)
            below = [f"{base}.{alias.name}" for alias in node.names]
            imported |= {one if one in modules else base for one in below}
    return {one for one in imported if one in modules and one != name}


def graph_of(rooms: dict[str, Path]) -> dict[str, set[str]]:
    modules = modules_of(rooms)
    return {name: imports_of(name, path, modules) for name, path in modules.items()}


@pytest.mark.slow
def test_no_import_circles():
    TopologicalSorter(graph_of(ROOMS)).prepare()  # raises CycleError, which names one


# -- tests go through public names


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


# -- the same thing has the same name everywhere


def parameters() -> Iterator[tuple[str, str]]:
    """Full name of each public function, class and method, with each of its parameters."""
    for package in (name for name, file in MODULES.items() if file.name == "__init__.py"):
        module = importlib.import_module(package)
        for name in getattr(module, "__all__", ()):
            value = getattr(module, name)
            if not callable(value) or not getattr(value, "__module__", "").startswith("cyclofeat"):
                continue
            members = [(name, value)]
            if inspect.isclass(value):
                members += [
                    (f"{name}.{method}", getattr(value, method))
                    for method in vars(value)
                    if not method.startswith("_") and callable(getattr(value, method))
                ]
            for full, function in members:
                try:
                    signature = inspect.signature(function)
                except (TypeError, ValueError):
                    continue
                for parameter in signature.parameters:
                    yield f"{module.__name__}.{full}", parameter


def wrong(parameter: str) -> str:
    """What is wrong with a parameter's name; empty if nothing is."""
    if parameter in FORBIDDEN:
        return f"is called {FORBIDDEN[parameter]} elsewhere"
    vague = VAGUE & set(parameter.split("_"))
    return f"names no thing: {vague.pop()!r}" if vague else ""


def test_public_signatures_keep_to_the_vocabulary():
    looked_at = list(parameters())
    assert len(looked_at) > 500
    bad = {f"{full}({parameter})": reason for full, parameter in looked_at if (reason := wrong(parameter))}
    assert bad == {}
