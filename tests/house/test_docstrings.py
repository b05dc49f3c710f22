"""Every example in a docstring runs and prints what it says."""

import doctest
import importlib
import pkgutil

import pytest

import cyclofeat

WALKED = {name for _, name, _ in pkgutil.walk_packages(cyclofeat.__path__, "cyclofeat.")}
MODULES = (WALKED | {"cyclofeat"}) - {"cyclofeat.__main__"}


def test_all_rooms_are_walked():
    assert LONG < MODULES
    for room in ("features", "counting", "plotting", "report"):
        assert f"cyclofeat.{room}" in MODULES


# The rooms at the top level of the checkout are mapped, which a walk does not see.
MAPPED = {
    name
    for room in ("cyclofeat.simulators", "cyclofeat.datasets")
    for _, name, _ in pkgutil.walk_packages(importlib.import_module(room).__path__, f"{room}.")
}


# Their examples simulate or fit for a second and more.
LONG = {
    "cyclofeat.counting._lobes",
    "cyclofeat.gap.proof._downstream",
    "cyclofeat.gap.loops._loops",
    "cyclofeat.gap.proof._prove",
    "cyclofeat.gap.published._gap",
    "cyclofeat.gap.where._locate",
    "cyclofeat.report._gap",
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name in LONG else name
        for name in sorted(MODULES | MAPPED)
    ],
)
def test_examples(name, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    failed, _ = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert failed == 0
