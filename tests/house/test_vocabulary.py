"""Public names share one vocabulary: the same thing has the same name everywhere."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator

from rooms import MODULES

# What to write instead.
FORBIDDEN = {"seed": "random_state", "duration_s": "duration", "fs": "sampling_rate"}
# Words that do not name the thing.
VAGUE = {"found", "own", "told", "kept", "there", "left", "alike"}


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
