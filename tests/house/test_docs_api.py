"""The API page lists every public name, and nothing that is not there."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "api.rst").read_text(encoding="utf-8")
PACKAGES = (
    "cyclofeat",
    "cyclofeat.counting",
    "cyclofeat.datasets",
    "cyclofeat.features",
    "cyclofeat.gap",
    "cyclofeat.history",
    "cyclofeat.models",
    "cyclofeat.plotting",
    "cyclofeat.recordings",
    "cyclofeat.report",
    "cyclofeat.serve",
    "cyclofeat.signal",
    "cyclofeat.simulators",
    "cyclofeat.simulators.effects",
)


def listed() -> dict[str, object]:
    """Full names in the page's tables, with what they are."""
    found = {}
    for part in re.split(r"^\.\. currentmodule:: ", PAGE, flags=re.MULTILINE)[1:]:
        module, _, text = part.partition("\n")
        for entry in re.findall(r"^   ((?:[a-z]+\.)?\w+)$", text, flags=re.MULTILINE):
            *inside, name = f"{module}.{entry}".split(".")
            found[f"{module}.{entry}"] = getattr(importlib.import_module(".".join(inside)), name)
    return found


LISTED = listed()


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_listed(package):
    module = importlib.import_module(package)
    public = [name for name in module.__all__ if not name.startswith("__")]
    assert public
    # A name that two packages export stands where it is found first; constants stand in the text.
    there = {id(value) for value in LISTED.values()}
    missing = [
        name for name in public if id(getattr(module, name)) not in there and f"``{name}``" not in PAGE
    ]
    assert not missing


def test_packages_with_public_names_are_all_looked_at():
    root = Path(importlib.import_module("cyclofeat").__file__).parents[1]
    rooms = {"cyclofeat": "cyclofeat", "simulators": "cyclofeat.simulators", "datasets": "cyclofeat.datasets"}
    found = set()
    for folder, name in rooms.items():
        for file in (root / folder).rglob("*.py"):
            parts = file.relative_to(root / folder).with_suffix("").parts
            private = any(part.startswith("_") and part != "__init__" for part in parts)
            # Modules of commands are no interface: their help describes them.
            private = private or parts[:1] == ("cli",)
            if not private and re.search(r"^__all__ = ", file.read_text(encoding="utf-8"), re.MULTILINE):
                found.add(".".join([name, *parts]).removesuffix(".__init__"))
    assert found == set(PACKAGES)


def test_no_name_is_listed_twice():
    names = [name.rpartition(".")[2] for name in LISTED]
    # Row (of the gap) and others may share a word with a module's, but not with another class.
    assert len(names) == len(set(names))


def test_every_entry_has_a_docstring():
    assert not [name for name, value in LISTED.items() if not (value.__doc__ or "").strip()]
