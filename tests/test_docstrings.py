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
    f"cyclofeat.{room}.{name}"
    for room in ("simulators", "datasets")
    for _, name, _ in pkgutil.iter_modules(importlib.import_module(f"cyclofeat.{room}").__path__)
}


# Their examples simulate or fit for half a minute and more.
LONG = {
    "cyclofeat.counting._lobes",
    "cyclofeat.gap._downstream",
    "cyclofeat.gap._fitter",
    "cyclofeat.gap._ranker",
    "cyclofeat.gap._report",
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
