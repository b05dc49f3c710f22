"""Public names: packages alone state them, and the API page lists exactly these."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable

import pytest
from rooms import MODULES, ROOT

PAGE = (ROOT / "docs" / "api.rst").read_text(encoding="utf-8")
STATING = {  # module that states public names: its file
    name: file
    for name, file in MODULES.items()
    if re.search(r"^__all__ = ", file.read_text(encoding="utf-8"), re.MULTILINE)
}


def listed_names() -> dict[str, object]:
    """Return what the page's tables list, by full name."""
    listed = {}
    for part in re.split(r"^\.\. currentmodule:: ", PAGE, flags=re.MULTILINE)[1:]:
        module, _, text = part.partition("\n")
        for entry in re.findall(r"^   ((?:[a-z]+\.)?\w+)$", text, flags=re.MULTILINE):
            *inside, name = f"{module}.{entry}".split(".")
            listed[f"{module}.{entry}"] = getattr(importlib.import_module(".".join(inside)), name)
    return listed


LISTED = listed_names()


def test_only_packages_state_public_names():
    assert not [name for name, file in STATING.items() if file.name != "__init__.py"]


# The page of commands describes these.
@pytest.mark.parametrize("package", sorted(STATING.keys() - {"cyclofeat.cli"}))
def test_every_public_name_is_listed(package):
    module = importlib.import_module(package)
    public = [name for name in module.__all__ if not name.startswith("__")]
    assert public
    # A name that two packages export stands where it is found first; constants stand in the text.
    values = {id(value) for value in LISTED.values()}
    assert not [
        name for name in public if id(getattr(module, name)) not in values and f"``{name}``" not in PAGE
    ]


def test_every_entry_is_public_once_and_has_a_docstring():
    for full_name, value in LISTED.items():
        package, _, name = full_name.rpartition(".")
        assert name in importlib.import_module(package).__all__, full_name
        assert (value.__doc__ or "").strip(), full_name
    names = [name.rpartition(".")[2] for name in LISTED]
    assert len(names) == len(set(names))


def public_functions() -> dict[str, Callable[..., object]]:
    """Return each exported function, and each method that an exported class defines, by full name."""
    functions = {}
    for full_name, value in LISTED.items():
        members = {"": value} if inspect.isfunction(value) else vars(value) if inspect.isclass(value) else {}
        for name, member in members.items():
            function = getattr(member, "__func__", member)  # of class and static methods
            if inspect.isfunction(function) and not name.startswith("_"):
                functions[f"{full_name}.{name}".rstrip(".")] = function
    return functions


def test_public_functions_state_what_they_take_and_return():
    lacking = []
    for name, function in public_functions().items():
        signature, text = inspect.signature(function), inspect.getdoc(function) or ""
        if signature.parameters.keys() - {"self", "cls"} and "Parameters\n---" not in text:
            lacking.append(f"Parameters of {name}")
        returns = signature.return_annotation not in ("None", None, inspect.Signature.empty)
        if returns and not re.search("^(Returns|Yields)\n---", text, re.MULTILINE):
            lacking.append(f"Returns of {name}")
    assert not lacking
