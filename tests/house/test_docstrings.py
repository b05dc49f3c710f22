"""Every example in a docstring runs and prints what it says."""

import doctest
import importlib

import pytest
from rooms import MODULES

# Their examples simulate or fit for a second and more, or compile a kernel that no other example needs.
LONG = {
    "cyclofeat.counting.estimators.lobe_counter",
    "cyclofeat.counting.planning",
    "cyclofeat.gap._workflow",
    "cyclofeat.history.alarm",
    "cyclofeat.plotting._gap",
    "cyclofeat.report._gap",
    "cyclofeat.simulators._jit",
    "cyclofeat.simulators.effects._drive",
    "cyclofeat.simulators.held_output",
}
QUICK: dict[str, list[str]] = {}
for name in sorted(MODULES.keys() - LONG - {"cyclofeat.__main__"}):
    QUICK.setdefault(".".join(name.split(".")[:2]), []).append(name)


def test_all_rooms_are_walked():
    assert MODULES.keys() > LONG
    assert {f"cyclofeat.{room}" for room in ("features", "counting", "plotting", "report")} < QUICK.keys()


@pytest.mark.parametrize(
    "names",
    [*QUICK.values(), *(pytest.param([name], marks=pytest.mark.slow) for name in sorted(LONG))],
    ids=lambda names: names[0],
)
def test_examples(names):
    for name in names:
        failed, _ = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
        assert failed == 0, name
