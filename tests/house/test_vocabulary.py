"""Public names share one vocabulary: the same thing has the same name everywhere."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from types import ModuleType

import cyclofeat

# What to write instead.
FORBIDDEN = {"seed": "random_state", "duration_s": "duration", "fs": "sampling_rate"}
# Words that do not name the thing.
VAGUE = {"found", "own", "told", "kept", "there", "left", "alike"}


def modules() -> Iterator[ModuleType]:
    """Every public module: none of its names begins with an underscore."""
    yield cyclofeat
    # They lie in folders of their own, which a walk through the root package does not reach.
    rooms = [importlib.import_module(f"cyclofeat.{room}") for room in ("simulators", "datasets")]
    yield from rooms
    for root in [cyclofeat, *rooms]:
        for info in pkgutil.walk_packages(root.__path__, f"{root.__name__}."):
            if not any(part.startswith("_") for part in info.name.split(".")):
                yield importlib.import_module(info.name)


def parameters() -> Iterator[tuple[str, str]]:
    """Full name of each public function, class and method, with each of its parameters."""
    for module in modules():
        made = [name for name, value in vars(module).items() if is_made_in(module, name, value)]
        for name in getattr(module, "__all__", made):
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


def is_made_in(module: ModuleType, name: str, value: object) -> bool:
    """True for a public function or class of the module."""
    return not name.startswith("_") and getattr(value, "__module__", "") == module.__name__


def wrong(parameter: str) -> str:
    """What is wrong with a parameter's name; empty if nothing is."""
    if parameter in FORBIDDEN:
        return f"is called {FORBIDDEN[parameter]} elsewhere"
    vague = VAGUE & set(parameter.split("_"))
    return f"names no thing: {vague.pop()!r}" if vague else ""


def test_public_signatures_keep_to_the_vocabulary():
    looked_at = list(parameters())
    assert len(looked_at) > 1000
    bad = {f"{full}({parameter})": reason for full, parameter in looked_at if (reason := wrong(parameter))}
    assert bad == {}


def test_every_public_module_states_its_names():
    bare = [module.__name__ for module in modules() if not hasattr(module, "__all__")]
    assert bare == []
