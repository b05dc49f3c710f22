"""No module imports itself through others, with lazy and type-only imports counted."""

from __future__ import annotations

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from rooms import ROOMS, modules_of


def imports_of(name: str, path: Path, modules: dict[str, Path]) -> set[str]:
    """Modules that a file imports anywhere in its code."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    imported: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = package.split(".")
                base = ".".join([*parents[: len(parents) - node.level + 1], *filter(None, [node.module])])
            below = [f"{base}.{alias.name}" for alias in node.names]
            imported |= {one if one in modules else base for one in below}
    return {one for one in imported if one in modules and one != name}


def graph_of(rooms: dict[str, Path]) -> dict[str, set[str]]:
    modules = modules_of(rooms)
    return {name: imports_of(name, path, modules) for name, path in modules.items()}


@pytest.mark.slow
def test_no_import_circles():
    TopologicalSorter(graph_of(ROOMS)).prepare()  # raises CycleError, which names one


def test_a_lazy_and_a_type_only_import_are_seen(tmp_path):
    package = tmp_path / "house"
    (package / "room").mkdir(parents=True)
    (package / "__init__.py").write_text("", encoding="utf-8")
    (package / "room" / "__init__.py").write_text("from .one import f", encoding="utf-8")
    (package / "room" / "one.py").write_text("def f():\n    from house import two", encoding="utf-8")
    (package / "two.py").write_text("if TYPE_CHECKING:\n    from .room.one import f", encoding="utf-8")
    with pytest.raises(CycleError, match=r"house\.two.*house\.room\.one|house\.room\.one.*house\.two"):
        TopologicalSorter(graph_of({"house": package})).prepare()
